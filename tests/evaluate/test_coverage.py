"""Laws of the coverage curve."""

from __future__ import annotations

import numpy as np
from draws import seeds
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from slamkit.evaluate import (
    coverage,
)


def test_coverage_of_credible_draws_is_the_diagonal_and_its_error_is_known() -> None:
    # 400 runs of 50 independent steps of mixed dof, seed 11: a share at level p has the standard error √(p(1-p)/20000).
    rng = np.random.default_rng(11)
    dof = rng.integers(1, 6, size=(400, 50))
    eps = rng.chisquare(dof)
    curve = coverage(eps, dof)
    sigma = np.sqrt(curve.levels * (1 - curve.levels) / 20000)
    assert np.all(np.abs(curve.share - curve.levels) < 4 * sigma)
    np.testing.assert_allclose(curve.standard_error, sigma, rtol=0.25)
    assert np.all(coverage(2 * eps, dof).share < curve.levels) and np.all(coverage(eps / 2, dof).share > curve.levels)


@given(seeds, st.integers(1, 5), st.integers(1, 6))
def test_coverage_is_the_empirical_distribution_of_the_transform(seed: int, runs: int, steps: int) -> None:
    rng = np.random.default_rng(seed)
    eps, dof = rng.chisquare(3, size=(runs, steps)), rng.integers(0, 4, size=(runs, steps))
    dof[0, 0] = 3
    levels = np.array([0.0, 0.1, 0.5, 0.9, 1.0])
    transform = stats.chi2.cdf(eps, np.maximum(dof, 1))
    shares = [
        [np.mean(transform[i][dof[i] > 0] <= level) for level in levels] for i in range(runs) if np.any(dof[i] > 0)
    ]
    curve = coverage(eps, dof, levels)
    np.testing.assert_allclose(curve.share, np.mean(shares, axis=0), atol=1e-12)
    assert np.all(np.diff(curve.share) >= 0) and curve.share[-1] == 1
