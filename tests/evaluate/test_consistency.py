"""Laws of the consistency statistics."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import stats

from slamkit.errors import DivergenceError, InputError
from slamkit.evaluate import consistency
from slamkit.evaluate.consistency import (
    chi2_bounds,
    coverage,
    heading_nees,
    inclination,
    landmark_nees,
    nci,
    nees,
    nis,
    pose_nees,
    position_nees,
    state_error,
    state_nees,
    summary,
    whiteness,
)

Array = NDArray[np.float64]
seeds = st.integers(0, 2**32 - 1)


def covariances(rng: np.random.Generator, *shape: int) -> Array:
    """Random covariances, of shape (*shape, shape[-1]), well conditioned."""
    root = rng.normal(size=(*shape, shape[-1]))
    return root @ root.mT + 0.1 * np.eye(shape[-1])


def sampled(rng: np.random.Generator, P: Array) -> Array:
    """Draws from N(0, P) (..., d)."""
    return (np.linalg.cholesky(P) @ rng.normal(size=(*P.shape[:-1], 1)))[..., 0]


# --- bounds ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("dof", "runs", "lower", "upper"),
    [(1, 50, 0.647, 1.428), (2, 50, 1.484, 2.591), (3, 50, 2.360, 3.716), (3, 100, 2.539, 3.499)],
)
def test_bounds_are_the_tabulated_ones(dof: int, runs: int, lower: float, upper: float) -> None:
    bounds = chi2_bounds(dof, runs)
    assert round(float(bounds.lower), 3) == lower
    assert round(float(bounds.upper), 3) == upper


@given(st.floats(0.1, 500), st.integers(1, 2000), st.floats(0.01, 0.9999))
def test_bounds_hold_their_probability(dof: float, runs: int, probability: float) -> None:
    bounds = chi2_bounds(dof, runs, probability)
    below = stats.chi2.cdf(bounds.lower * runs, runs * dof)
    above = stats.chi2.sf(bounds.upper * runs, runs * dof)
    assert below == pytest.approx((1 - probability) / 2, rel=1e-6)
    assert above == pytest.approx((1 - probability) / 2, rel=1e-6)


def test_bounds_broadcast_and_are_zero_without_freedom() -> None:
    bounds = chi2_bounds([[0], [3]], [1, 50, 100])
    assert bounds.lower.shape == bounds.upper.shape == (2, 3)
    assert not bounds.lower[0].any() and not bounds.upper[0].any()
    assert bounds.upper[1, 1] == chi2_bounds(3, 50).upper


# --- NEES -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("d", [1, 2, 3, 5])
def test_mean_nees_of_credible_draws_is_inside_its_bounds_at_their_rate(d: int) -> None:
    # 50 runs, 2000 independent steps, seed 7: the share inside has a standard error of 0.0049.
    rng = np.random.default_rng(7)
    P = covariances(rng, 50, 2000, d)
    e = sampled(rng, P)
    bounds = chi2_bounds(d, 50)

    def inside(covariance: Array) -> float:
        mean = nees(e, covariance).values.mean(axis=0)
        return float(np.mean((bounds.lower <= mean) & (mean <= bounds.upper)))

    assert inside(P) == pytest.approx(0.95, abs=3 * 0.0049)
    assert inside(P / 2) < 0.2
    assert inside(P * 2) < 0.2


@given(seeds, st.integers(1, 8))
def test_nees_is_invariant_under_linear_maps(seed: int, d: int) -> None:
    rng = np.random.default_rng(seed)
    P = covariances(rng, 4, d)
    e = 3 * sampled(rng, P)
    U, V = (np.linalg.qr(rng.normal(size=(d, d)))[0] for _ in range(2))
    T = U * 10.0 ** rng.uniform(-1, 1, d) @ V
    before, after = nees(e, P), nees(e @ T.T, T @ P @ T.T)
    np.testing.assert_allclose(after.values, before.values, rtol=1e-8)
    assert np.all(before.dof == d) and np.all(after.dof == d)
    np.testing.assert_allclose(
        before.values, np.einsum("...i,...i", e, np.linalg.solve(P, e[..., None])[..., 0]), rtol=1e-8
    )


@given(seeds, st.integers(1, 7), st.integers(1, 7))
def test_rank_deficient_nees_is_that_of_the_subspace(seed: int, d: int, r: int) -> None:
    r = min(d, r)
    rng = np.random.default_rng(seed)
    P, B = covariances(rng, 5, r), np.linalg.qr(rng.normal(size=(d, d)))[0][:, :r]
    x = sampled(rng, P)
    inside, whole = nees(x, P), nees(x @ B.T, B @ P @ B.T)
    np.testing.assert_allclose(whole.values, inside.values, rtol=1e-8)
    assert np.all(whole.dof == r)
    np.testing.assert_allclose(whole.per_dof, inside.values / r, rtol=1e-8)


@given(seeds, st.integers(2, 7), st.floats(-4, 4))
def test_error_outside_the_eigenspace_is_loud(seed: int, d: int, exponent: float) -> None:
    rng = np.random.default_rng(seed)
    B = np.linalg.qr(rng.normal(size=(d, d)))[0]
    P = np.zeros((2, 3, d, d))
    P[:] = B[:, 1:] @ covariances(rng, d - 1) @ B[:, 1:].T
    e = sampled(rng, P + np.outer(B[:, 0], B[:, 0])) @ B
    e[..., 0] = 0.0
    e = e @ B.T
    assert np.all(nees(e, P).dof == d - 1)
    e[1, 2] += 10.0**exponent * B[:, 0]
    with pytest.raises(DivergenceError, match=rf"at \(1, 2\) leaves the eigenspace .*rank {d - 1} of {d}"):
        nees(e, P)


def test_an_exactly_known_state_allows_rounding_and_nothing_more() -> None:
    known = nees([0.0, 1e-15, -1e-15], np.zeros((3, 3)))
    assert known.values == 0 and known.dof == 0 and np.isnan(known.per_dof)
    with pytest.raises(DivergenceError, match="rank 0 of 3"):
        nees([0.0, 1e-6, 0.0], np.zeros((3, 3)))
    with pytest.raises(DivergenceError):
        nees([0.0, 1e-12, 0.0], np.zeros((3, 3)), atol=0)
    # A standard deviation of 1e-10 m is below the resolution, unless there is none.
    tiny = 1e-20 * np.eye(3)
    assert nees([0.0, 1e-10, 0.0], tiny).dof == 0
    unlimited = nees([0.0, 1e-10, 0.0], tiny, atol=0)
    assert unlimited.dof == 3 and unlimited.values == pytest.approx(1)


@given(seeds, st.integers(1, 6), st.floats(-16, 0))
def test_both_paths_agree_and_a_stack_is_its_members(seed: int, d: int, exponent: float) -> None:
    rng = np.random.default_rng(seed)
    Q = np.linalg.qr(rng.normal(size=(6, d, d)))[0]
    lam = 10 ** (exponent * rng.uniform(size=(6, d)))
    lam[0] = 0
    P = (Q * lam[:, None, :]) @ Q.mT
    P = (P + P.mT) / 2
    e = (Q @ (np.sqrt(lam) * rng.normal(size=(6, d)))[..., None])[..., 0]
    stack = nees(e, P)
    values, rank = consistency._eigenspace_squares(e, P, consistency.RTOL, consistency.ATOL, np.arange(6), (6,))
    smallest = np.where(lam > 0, lam, 1).min(axis=1)
    # Rounding in P is eps λ_max, of which an eigenvalue λ takes a share of eps λ_max/λ.
    for i in range(6):
        alone = nees(e[i], P[i])
        assert alone.values == pytest.approx(stack.values[i], rel=1e-12) and alone.dof == stack.dof[i] == rank[i]
        assert values[i] == pytest.approx(stack.values[i], rel=1e-13 / max(smallest[i], 1e-12) + 1e-10)


def test_neither_triangle_of_a_covariance_is_preferred() -> None:
    P = np.array([[1.0, 0.5], [0.5 + 1e-10, 1.0]])
    assert nees([1.0, -1.0], P).values == nees([1.0, -1.0], P.T).values


def test_indefinite_covariance_is_loud() -> None:
    P = np.broadcast_to(np.eye(3), (4, 3, 3)).copy()
    P[2, :2, :2] = [[1.0, 1.001], [1.001, 1.0]]
    with pytest.raises(DivergenceError, match=r"at \(2,\) is not positive semi-definite"):
        nees(np.zeros((4, 3)), P)


# --- pose, landmarks, state -----------------------------------------------------------------------------------------


@given(seeds, st.integers(-3, 3))
def test_headings_are_compared_as_angles(seed: int, turns: int) -> None:
    rng = np.random.default_rng(seed)
    truth, P = rng.normal(size=(6, 3)), 0.01 * covariances(rng, 6, 3)
    truth[:, 2] = np.pi + rng.normal(size=6) * 1e-3
    poses = truth + 0.1 * rng.normal(size=(6, 3))
    turned = poses + np.array([0, 0, 2 * np.pi * turns])
    for f in (pose_nees, heading_nees, position_nees):
        np.testing.assert_allclose(f(turned, P, truth).values, f(poses, P, truth).values, rtol=1e-7)
    assert np.all(np.abs(state_error(turned, truth)[:, 2]) < 1)
    assert state_error([0, 0, np.pi], [0, 0, 0])[2] == -np.pi


@given(seeds)
def test_pose_nees_splits_where_position_and_heading_are_independent_and_dominates_them_always(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth, poses, P = rng.normal(size=(5, 3)), rng.normal(size=(5, 3)), covariances(rng, 5, 3)
    whole, position, heading = (f(poses, P, truth) for f in (pose_nees, position_nees, heading_nees))
    assert whole.dof.tolist() == [3] * 5 and position.dof.tolist() == [2] * 5 and heading.dof.tolist() == [1] * 5
    assert np.all(whole.values >= np.maximum(position.values, heading.values) * (1 - 1e-9))
    P[:, :2, 2] = P[:, 2, :2] = 0
    np.testing.assert_allclose(pose_nees(poses, P, truth).values, position.values + heading.values, rtol=1e-9)


@given(seeds, st.integers(0, 6))
def test_state_nees_is_pose_plus_landmarks_where_they_are_independent(seed: int, N: int) -> None:
    rng = np.random.default_rng(seed)
    d = 3 + 2 * N
    truth, state = rng.normal(size=(4, d)), rng.normal(size=(4, d))
    truth[:, 2] += 2 * np.pi
    P_pose, P_landmarks = covariances(rng, 4, 3), covariances(rng, 4, N, 2)
    P = np.zeros((4, d, d))
    P[:, :3, :3] = P_pose
    for i in range(N):
        P[:, 3 + 2 * i : 5 + 2 * i, 3 + 2 * i : 5 + 2 * i] = P_landmarks[:, i]
    each = landmark_nees(state[:, 3:].reshape(4, N, 2), P_landmarks, truth[:, 3:].reshape(4, N, 2))
    assert each.values.shape == (4, N) and np.all(each.dof == 2)
    parts = pose_nees(state[:, :3], P_pose, truth[:, :3]).values + each.values.sum(axis=1)
    whole = state_nees(state, P, truth)
    np.testing.assert_allclose(whole.values, parts, rtol=1e-9)
    assert np.all(whole.dof == d)


# --- summary and coverage -------------------------------------------------------------------------------------------


@given(seeds, st.integers(2, 60), st.integers(1, 5))
def test_summary_counts_runs_not_steps(seed: int, runs: int, copies: int) -> None:
    rng = np.random.default_rng(seed)
    values = rng.chisquare(3, size=runs)
    s = summary(values, 3)
    # Steps that repeat what the run has said already add no information.
    assert summary(np.repeat(values[:, None], copies, axis=1), 3).standard_error == pytest.approx(s.standard_error)
    assert s.standard_error == pytest.approx(stats.sem(values))
    assert s.mean == pytest.approx(values.mean()) and s.median == pytest.approx(np.median(values))
    assert s.trimmed_mean == pytest.approx(stats.trim_mean(values, 0.1))
    assert s.share_above == np.mean(values > 6) and s.limit == pytest.approx(6) and s.runs == runs
    shuffled = summary(rng.permutation(values), 3)
    assert shuffled.mean == pytest.approx(s.mean) and shuffled.trimmed_mean == pytest.approx(s.trimmed_mean)


def test_one_diverged_run_carries_the_mean_alone() -> None:
    values = np.random.default_rng(3).chisquare(3, size=50)
    good, bad = summary(values, 3), summary(np.append(values[:-1], 1e6), 3)
    assert bad.mean > 1e4 and bad.standard_error > 1e4
    assert abs(bad.median - good.median) < 0.3 and abs(bad.trimmed_mean - good.trimmed_mean) < 0.3
    assert bad.share_above - good.share_above in (0, pytest.approx(0.02))


@given(st.floats(0.2, 400))
def test_default_limit_is_passed_equally_often_for_every_dof(dof: float) -> None:
    assert stats.chi2.sf(summary([1.0], dof).limit, dof) == pytest.approx(stats.chi2.sf(6, 3), rel=1e-6)
    assert np.isnan(summary([1.0], dof).standard_error)
    assert summary([1.0, 3.0], dof, limit=2.0).share_above == 0.5


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


# --- credibility ----------------------------------------------------------------------------------------------------


@given(seeds, st.integers(1, 4), st.floats(0.05, 20))
def test_credibility_is_measured_against_the_sample_mean_square_error(seed: int, d: int, c: float) -> None:
    rng = np.random.default_rng(seed)
    e = sampled(rng, covariances(rng, 30, 5, d))
    attained = np.einsum("mti,mtj->tij", e, e) / 30
    np.testing.assert_allclose(nci(e, attained), 0, atol=1e-6)
    np.testing.assert_allclose(inclination(e, c * attained), -10 * np.log10(c), atol=1e-6)
    np.testing.assert_allclose(nci(e, c * attained), abs(10 * np.log10(c)), atol=1e-6)
    P = covariances(rng, 30, 5, d)
    assert nci(e, P).shape == (5,)
    assert np.all(np.abs(inclination(e, P)) <= nci(e, P) + 1e-12)


def test_credible_estimator_tends_to_zero_and_inclination_has_the_right_sign() -> None:
    # 4000 runs, 20 steps, seed 5; a credible estimator's index falls as the root of the number of runs.
    rng = np.random.default_rng(5)
    P = np.broadcast_to(covariances(rng, 20, 3), (4000, 20, 3, 3))
    e = sampled(rng, P)
    assert np.all(nci(e, P) < 0.2)
    assert np.mean(nci(e[:160], P[:160])) == pytest.approx(5 * np.mean(nci(e, P)), rel=0.3)
    assert np.all(np.abs(inclination(e, P)) < 0.2)
    np.testing.assert_allclose(inclination(e, P / 4), 10 * np.log10(4), atol=0.2)
    assert np.all(inclination(e, P / 4) > 0) and np.all(inclination(e, 4 * P) < 0)
    T = rng.normal(size=(3, 3)) + 3 * np.eye(3)
    np.testing.assert_allclose(nci(e @ T.T, T @ P @ T.T), nci(e, P), rtol=1e-7)


def test_credibility_is_undefined_where_nothing_is_uncertain() -> None:
    rng = np.random.default_rng(1)
    P = np.broadcast_to(np.eye(3), (10, 3, 3, 3)).copy()
    e = sampled(rng, P)
    e[:, 0], P[:, 0] = 0, 0  # nothing uncertain
    e[:, 1, 2] = 0  # claimed rank 3, attained 2
    assert np.isnan(nci(e, P)).tolist() == [True, True, False]
    P[:, 1, 2, 2] = 0  # both of rank 2
    assert np.isnan(inclination(e, P)).tolist() == [True, False, False]
    with pytest.raises(InputError, match="3 runs"):
        nci(e[:3], P[:3])


# --- innovations ----------------------------------------------------------------------------------------------------


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


# --- bad input ------------------------------------------------------------------------------------------------------

GOOD: dict[str, tuple[Callable[..., Any], tuple[Array, ...]]] = {
    "nees": (nees, (np.zeros((6, 4, 3)), np.tile(np.eye(3), (6, 4, 1, 1)))),
    "nis": (nis, (np.zeros((6, 2)), np.tile(np.eye(2), (6, 1, 1)))),
    "pose_nees": (pose_nees, (np.zeros((6, 3)), np.tile(np.eye(3), (6, 1, 1)), np.zeros((6, 3)))),
    "position_nees": (position_nees, (np.zeros((6, 3)), np.tile(np.eye(3), (6, 1, 1)), np.zeros((6, 3)))),
    "heading_nees": (heading_nees, (np.zeros((6, 3)), np.tile(np.eye(3), (6, 1, 1)), np.zeros((6, 3)))),
    "landmark_nees": (landmark_nees, (np.zeros((6, 2)), np.tile(np.eye(2), (6, 1, 1)), np.zeros((6, 2)))),
    "state_nees": (state_nees, (np.zeros((6, 7)), np.tile(np.eye(7), (6, 1, 1)), np.zeros((6, 7)))),
    "state_error": (state_error, (np.zeros((6, 5)), np.zeros((6, 5)))),
    "chi2_bounds": (chi2_bounds, (np.ones((6, 4)), np.ones((6, 4)))),
    "summary": (lambda v: summary(v, 3), (np.ones((6, 4)),)),
    "coverage": (coverage, (np.ones((6, 4)), np.ones((6, 4)))),
    "levels": (lambda p: coverage([1.0], 3, p), (np.linspace(0, 1, 5),)),
    "nci": (nci, (np.ones((6, 4, 2)), np.tile(np.eye(2), (6, 4, 1, 1)))),
    "inclination": (inclination, (np.ones((6, 4, 2)), np.tile(np.eye(2), (6, 4, 1, 1)))),
    "whiteness": (
        lambda y, S: whiteness(y, S, lags=3),
        (np.random.default_rng(0).normal(size=(9, 2)), np.tile(np.eye(2), (9, 1, 1))),
    ),
}


@pytest.mark.parametrize("name", GOOD)
@given(data=st.data())
@settings(max_examples=20)
def test_values_that_are_not_finite_are_refused(name: str, data: st.DataObject) -> None:
    f, arguments = GOOD[name]
    f(*arguments)
    which = data.draw(st.integers(0, len(arguments) - 1))
    broken = arguments[which].copy()
    broken[np.unravel_index(data.draw(st.integers(0, broken.size - 1)), broken.shape)] = data.draw(
        st.sampled_from([np.nan, np.inf, -np.inf])
    )
    with pytest.raises(InputError, match="not finite"):
        f(*arguments[:which], broken, *arguments[which + 1 :])


@pytest.mark.parametrize("name", [name for name, (_, arguments) in GOOD.items() if len(arguments) > 1])
@given(data=st.data())
@settings(max_examples=20)
def test_shapes_that_do_not_fit_are_refused(name: str, data: st.DataObject) -> None:
    f, arguments = GOOD[name]
    which = data.draw(st.integers(0, len(arguments) - 1))
    axis = data.draw(st.integers(0, arguments[which].ndim - 1))
    # One more along any one axis, whatever it means, fits nothing else.
    broken = np.concatenate([arguments[which], np.take(arguments[which], [0], axis)], axis)
    with pytest.raises(InputError):
        f(*arguments[:which], broken, *arguments[which + 1 :])
    with pytest.raises(InputError, match="must be numbers"):
        f(*arguments[:which], "a string", *arguments[which + 1 :])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: nees(1.0, np.eye(1)), "error has shape"),
        (lambda: nees(np.zeros((4, 0)), np.zeros((4, 0, 0))), "not empty"),
        (lambda: nees(np.zeros((2, 2)), np.stack([np.eye(2), [[1, 0.1], [0, 1]]])), r"not symmetric at \(1,\)"),
        (lambda: nees([0.0], [[1.0]], rtol=-1), "rtol"),
        (lambda: nees([0.0], [[1.0]], atol=np.nan), "atol"),
        (lambda: pose_nees(np.zeros(5), np.eye(5), np.zeros(5)), "5 components"),
        (lambda: state_error(np.zeros(2), np.zeros(2)), "d ≥ 3"),
        (lambda: landmark_nees(np.zeros(3), np.eye(3), np.zeros(3)), r"\(\.\.\., 2\)"),
        (lambda: chi2_bounds(-1, 50), "dof"),
        (lambda: chi2_bounds(3, 0), "runs"),
        (lambda: chi2_bounds(3, 2.5), "runs"),
        (lambda: chi2_bounds(3, 50, 1.0), "probability"),
        (lambda: chi2_bounds(3, 50, float("nan")), "probability"),
        (lambda: summary([], 3), "values"),
        (lambda: summary(np.ones((3, 0)), 3), "no run, or no step"),
        (lambda: summary([1.0, -1e-9], 3), "negative"),
        (lambda: summary([1.0], 0), "dof"),
        (lambda: summary([1.0], 3, limit=float("nan")), "limit"),
        (lambda: coverage([1.0], 0), "every dof"),
        (lambda: coverage([1.0], 3, [0.5, 0.5]), "ascending"),
        (lambda: coverage([1.0], 3, [0.5, 1.5]), "ascending"),
        (lambda: nci(np.ones((5, 2)), np.ones((7, 5, 2, 2)) * np.eye(2)), "expected"),
        (lambda: whiteness(np.ones((9, 2)), lags=3), "span"),
        (lambda: whiteness(np.eye(9), lags=9), "lags"),
        (lambda: whiteness(np.eye(9), lags=0), "lags"),
        (lambda: whiteness(np.eye(9), lags=2.0), "lags"),  # type: ignore[arg-type]
        (lambda: whiteness(np.eye(9), -np.eye(9), lags=2), "positive definite"),
    ],
)
def test_bad_calls_say_what_was_wrong(call: Callable[[], object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        call()
