"""A run with known errors, and empty axes, for the tests of figures."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import strategies as st
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from slamkit import se2
from slamkit.logs import History, Truth

FILTERS = ("ekf", "fej", "oc", "invariant", "iterated", "ideal", "robocentric", "ukf", "ukf-full", "oc-ukf")

SEEDS = st.integers(0, 2**32 - 1)


def run(seed: int = 0, K: int = 120, L: int = 6, M: int = 400, start: float = 0.0) -> tuple[History, Truth]:
    """A history whose errors are drawn from its covariances, and its truth."""
    rng = np.random.default_rng(seed)
    t = start + 0.5 * np.arange(1, K + 1)
    phi = 0.05 * np.arange(K)
    truth = np.stack([8 * np.cos(phi), 6 * np.sin(phi), se2.wrap(phi + np.pi / 2)], -1).reshape(K, 3)
    P = covariances(rng, K, 3, (0.1, 0.2, 0.05))
    places, C = rng.uniform(-10, 10, (L, 2)), covariances(rng, L, 2, (0.3, 0.1))
    error = np.einsum("kij,kj->ki", np.linalg.cholesky(P), rng.normal(size=(K, 3)))
    innovations = rng.normal(size=(M, 2))
    nis = np.sum(innovations**2, -1)
    nis[:L] = np.nan
    history = History(
        filter="ekf",
        times=t,
        poses=np.concatenate([(truth + error)[:, :2], se2.wrap((truth + error)[:, 2])[:, None]], -1),
        pose_covariances=P,
        observation_times=np.sort(rng.choice(t, M)) if K else np.zeros(M),
        observation_ids=rng.integers(0, max(L, 1), M),
        innovations=innovations,
        nis=nis,
        accepted=~(nis > 9.21),
        landmark_ids=tuple(f"L{i}" for i in range(L)),
        landmarks=places + np.einsum("lij,lj->li", np.linalg.cholesky(C), rng.normal(size=(L, 2))),
        landmark_covariances=C,
    )
    return history, Truth(t, truth, {f"L{i}": p for i, p in enumerate(places)})


def covariances(rng: np.random.Generator, n: int, d: int, scale: tuple[float, ...]) -> Any:
    A = rng.normal(size=(n, d, d)) * np.array(scale)[:, None]
    return A @ A.swapaxes(1, 2) + 1e-4 * np.eye(d)


def axes(n: int = 1, size: tuple[float, float] = (6.0, 4.0)) -> Any:
    panels = Figure(figsize=size, layout="constrained").subplots(n, 1)
    return panels


def draw(figure: Figure) -> Any:
    """Lay the figure out, draw it, and return the renderer."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return canvas.get_renderer()
