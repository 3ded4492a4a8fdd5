"""Random covariances, and errors drawn from them."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from slamkit.arrays import Array

seeds = st.integers(0, 2**32 - 1)


def covariances(rng: np.random.Generator, *shape: int) -> Array:
    """Random covariances, of shape (*shape, shape[-1]), well conditioned."""
    root = rng.normal(size=(*shape, shape[-1]))
    return root @ root.mT + 0.1 * np.eye(shape[-1])


def sampled(rng: np.random.Generator, P: Array) -> Array:
    """Draws from N(0, P) (..., d)."""
    return (np.linalg.cholesky(P) @ rng.normal(size=(*P.shape[:-1], 1)))[..., 0]
