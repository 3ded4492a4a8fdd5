"""Laws of NEES, NIS, their bounds and their summary."""

from __future__ import annotations

import numpy as np
import pytest
from draws import covariances, sampled, seeds
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from slamkit.arrays import Array
from slamkit.errors import DivergenceError
from slamkit.evaluate import (
    chi2_bounds,
    heading_nees,
    landmark_nees,
    nees,
    pose_nees,
    position_nees,
    state_error,
    state_nees,
    summary,
)
from slamkit.evaluate.normalized_squares import ATOL, RTOL, _eigenspace_squares

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
    values, rank = _eigenspace_squares(e, P, RTOL, ATOL, np.arange(6), (6,))
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


# --- summary ---------------------------------------------------------------------------------------------------------


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
