"""Laws of the whiteness of innovations."""

from __future__ import annotations

import numpy as np
import pytest
from draws import covariances, sampled, seeds
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from slamkit.arrays import Array
from slamkit.evaluate import (
    chi2_bounds,
    nis,
    whiteness,
)


def ljung_box(y: Array, lags: int) -> float:
    """The scalar statistic, written out."""
    K, total = len(y), sum(v * v for v in y)
    r = [sum(y[t] * y[t + lag] for t in range(K - lag)) / total for lag in range(1, lags + 1)]
    return float(K * (K + 2) * sum(r_l**2 / (K - lag) for lag, r_l in enumerate(r, start=1)))


@given(seeds, st.integers(1, 9))
@settings(max_examples=25)
def test_scalar_whiteness_is_the_ljung_box_test(seed: int, lags: int) -> None:
    y = np.random.default_rng(seed).normal(size=40)
    w = whiteness(y[:, None], lags=lags)
    assert w.statistic == pytest.approx(ljung_box(y, lags)) and w.dof == lags
    assert w.p_value == pytest.approx(stats.chi2.sf(ljung_box(y, lags), lags))
    assert w.lags.tolist() == list(range(1, lags + 1)) and np.all(np.abs(w.correlation) <= 1)


@pytest.mark.parametrize("k", [1, 2, 3])
def test_white_innovations_pass_at_the_stated_rate(k: int) -> None:
    # 600 runs of 500 innovations, seed 2: p-values are uniform, one lag stays inside its bound in 95 % of the runs.
    # The variances fall as a filter's do when it converges: unless each is whitened by its own, few innovations count.
    rng = np.random.default_rng(2)
    S = covariances(rng, 600, 500, k) * np.geomspace(1, 1e-4, 500)[:, None, None]
    w = whiteness(sampled(rng, S), S, lags=10)
    assert stats.kstest(w.p_value, "uniform").pvalue > 1e-3
    assert np.mean(np.abs(w.correlation) < w.bound) == pytest.approx(0.95, abs=4 * np.sqrt(0.95 * 0.05 / 6000))
    assert np.std(w.correlation, axis=0) == pytest.approx(w.bound / stats.norm.ppf(0.975), rel=0.12)


def test_coloured_biased_and_crosswise_correlated_innovations_fail() -> None:
    rng = np.random.default_rng(4)
    white = rng.normal(size=(20, 2000, 2))
    assert np.mean(whiteness(white).p_value > 0.01) >= 0.9
    coloured = white.copy()
    for t in range(1, 2000):
        coloured[:, t] += 0.2 * coloured[:, t - 1]
    w = whiteness(coloured)
    assert np.all(w.p_value < 1e-6) and np.all(w.correlation[:, 0] > w.bound[0])
    np.testing.assert_allclose(w.correlation[:, 0], 0.2, atol=0.06)
    assert np.all(whiteness(white + 0.3).p_value < 1e-6)
    crosswise = np.stack([white[:, 1:, 0], white[:, 1:, 1] + 0.3 * white[:, :-1, 0]], axis=-1)
    assert np.all(whiteness(crosswise).p_value < 1e-6)


@given(seeds)
@settings(max_examples=25)
def test_whiteness_ignores_units(seed: int) -> None:
    rng = np.random.default_rng(seed)
    S = covariances(rng, 200, 2)
    y = sampled(rng, S)
    T = np.diag(10.0 ** rng.uniform(-3, 3, 2)) @ np.array([[1, 0.3], [0, 1]])
    plain, scaled = whiteness(y, lags=5), whiteness(y @ T.T, lags=5)
    np.testing.assert_allclose(scaled.correlation, plain.correlation, atol=1e-9)
    assert scaled.statistic == pytest.approx(plain.statistic)
    plain, scaled = whiteness(y, S, lags=5), whiteness(y, 7 * S, lags=5)
    assert scaled.statistic == pytest.approx(plain.statistic)


def kalman_innovations(rng: np.random.Generator, runs: int, steps: int, assumed_q: float) -> tuple[Array, Array]:
    """Innovations and their variances of a Kalman filter on a random walk whose true increments have variance 0.1."""
    x, m, P = np.zeros(runs), np.zeros(runs), 0.0
    y, S = np.empty((runs, steps, 1)), np.empty((runs, steps, 1, 1))
    for t in range(steps):
        x = x + np.sqrt(0.1) * rng.normal(size=runs)
        P += assumed_q
        y[:, t, 0], S[:, t] = x + rng.normal(size=runs) - m, P + 1.0
        gain = P / (P + 1.0)
        m, P = m + gain * y[:, t, 0], (1 - gain) * P
    return y, S


def test_nis_and_whiteness_tell_a_right_filter_from_a_wrong_one() -> None:
    # 50 runs of 1000 steps, seed 8.
    bounds = chi2_bounds(1, 50)
    verdict = {}
    for q in (0.1, 0.001):
        y, S = kalman_innovations(np.random.default_rng(8), 50, 1000, q)
        mean = nis(y, S).values.mean(axis=0)
        verdict[q] = np.mean((bounds.lower < mean) & (mean < bounds.upper)), np.mean(whiteness(y, S).p_value > 0.05)
    assert verdict[0.1][0] == pytest.approx(0.95, abs=0.03) and verdict[0.1][1] > 0.85
    assert verdict[0.001][0] < 0.2 and verdict[0.001][1] == 0
