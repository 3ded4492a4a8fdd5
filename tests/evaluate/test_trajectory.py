"""Laws of the accuracy of trajectories and maps."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from numpy.typing import NDArray

from slamkit import logs, se2
from slamkit.errors import InputError
from slamkit.evaluate.trajectory import Evaluation, align, evaluate, nearest, relative_error

Array = NDArray[np.float64]

# Both take lists and any ids, which their annotations do not say.
Log: Any = logs.Log
Truth: Any = logs.Truth

coordinate = st.floats(-100, 100)
angle = st.floats(-np.pi, np.pi, exclude_max=True)
motions = st.tuples(coordinate, coordinate, angle).map(np.array)
seeds = st.integers(0, 2**32)
stamps = st.lists(st.floats(0, 50), max_size=30).map(lambda t: np.array(t, dtype=float))


def trajectory(seed: int, n: int = 40) -> tuple[Array, Array]:
    """Times (n,) and poses (n, 3) of a random drive."""
    rng = np.random.default_rng(seed)
    poses = [rng.normal(size=3)]
    for _ in range(n - 1):
        poses.append(se2.compose(poses[-1], rng.normal([0.5, 0.0, 0.0], [0.1, 0.1, 0.3])))
    return np.cumsum(rng.uniform(0.5, 1.5, n)), np.array(poses)


def noisy(poses: Array, seed: int, sigma: float = 0.1) -> Array:
    rng = np.random.default_rng(seed + 1)
    return se2.compose(poses, rng.normal(0, sigma, poses.shape))


def error_sum(pose: Array, estimate: Array, truth: Array) -> float:
    return float(np.sum((se2.transform(pose, estimate) - truth) ** 2))


def numbers(*values: float | None) -> Array:
    return np.array(values, dtype=float)


def fields(e: Evaluation) -> Array:
    return numbers(e.ate_m, e.heading_rmse_deg, e.landmark_rmse_m, e.matched, e.matched_landmarks)


# nearest


@given(stamps, stamps, st.floats(0, 3))
def test_pairs_are_mutually_nearest_and_within_the_tolerance(a: Array, b: Array, tolerance: float) -> None:
    rows, truth_rows = nearest(a, b, tolerance)
    assert len(set(rows.tolist())) == len(rows) == len(set(truth_rows.tolist())) == len(truth_rows)
    assert np.all(np.diff(a[rows]) >= 0) and np.all(np.diff(b[truth_rows]) >= 0)
    for i, j in zip(rows, truth_rows, strict=True):
        gap = abs(a[i] - b[j])
        assert gap <= tolerance
        assert gap == np.abs(b - a[i]).min() == np.abs(a - b[j]).min()


@given(stamps, stamps, st.floats(0, 3))
def test_no_pair_is_missed(a: Array, b: Array, tolerance: float) -> None:
    rows, truth_rows = nearest(a, b, tolerance)
    left, right = set(range(len(a))) - set(rows.tolist()), set(range(len(b))) - set(truth_rows.tolist())
    for i in left:
        for j in right:
            gap = abs(a[i] - b[j])
            alone = gap < np.min(np.abs(np.delete(b, j) - a[i]), initial=np.inf)
            assert not (alone and gap <= tolerance and gap < np.min(np.abs(np.delete(a, i) - b[j]), initial=np.inf))


@given(st.lists(st.integers(0, 1000), unique=True, max_size=20), st.randoms(use_true_random=False))
def test_the_order_of_rows_does_not_matter(grid: list[int], random: Any) -> None:
    a, b = np.array(grid, dtype=float), np.arange(0.0, 1000.0, 7.0)
    order = np.array(random.sample(range(len(a)), len(a)), dtype=np.int64)
    rows, truth_rows = nearest(a, b, 3.5)
    again, truth_again = nearest(a[order], b, 3.5)
    np.testing.assert_array_equal(order[again], rows)
    np.testing.assert_array_equal(truth_again, truth_rows)


def test_ties_go_to_the_earlier_and_equal_stamps_to_the_last() -> None:
    assert [r.tolist() for r in nearest([1.0], [0.0, 2.0], 1.0)] == [[0], [0]]
    assert [r.tolist() for r in nearest([1.0, 1.0, 1.0], [1.0], 0.0)] == [[2], [0]]
    assert [r.tolist() for r in nearest([0.9], [0.0, 0.8, 0.8], 1.0)] == [[0], [2]]


def test_a_sparse_truth_is_counted_once() -> None:
    times = np.arange(0, 600, 0.015)
    truth = np.array([3.0041, 200.5, 599.0, 700.0])
    rows, truth_rows = nearest(times, truth, 0.05)
    assert truth_rows.tolist() == [0, 1, 2]
    assert np.abs(times[rows] - truth[:3]).max() <= 0.0075 + 1e-12


# align


@given(motions, seeds, st.integers(2, 50))
def test_alignment_recovers_a_rigid_motion(motion: Array, seed: int, n: int) -> None:
    points = np.random.default_rng(seed).normal(0, 10, (n, 2))
    found = align(points, se2.transform(motion, points))
    spread = np.abs(points - points.mean(0)).max()
    assert abs(se2.wrap(found[2] - motion[2])) < 1e-12 * max(1.0, 100 / spread)
    np.testing.assert_allclose(se2.transform(found, points), se2.transform(motion, points), atol=1e-11)


@given(seeds, st.integers(2, 30), motions)
def test_no_other_rigid_motion_is_closer(seed: int, n: int, step: Array) -> None:
    rng = np.random.default_rng(seed)
    estimate, truth = rng.normal(size=(2, n, 2))
    best = align(estimate, truth)
    for scale in (1.0, 1e-2, 1e-4):
        other = se2.compose(best, scale * step)
        assert error_sum(best, estimate, truth) <= error_sum(other, estimate, truth) * (1 + 1e-9)


def test_a_mirror_image_is_turned_and_never_reflected() -> None:
    points = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 1.0], [0.0, 2.0]])
    found = align(points, points * [1, -1])
    assert error_sum(found, points, points * [1, -1]) > 0.1


@given(seeds, st.integers(2, 30))
def test_alignment_and_its_inverse_agree(seed: int, n: int) -> None:
    estimate, truth = np.random.default_rng(seed).normal(size=(2, n, 2))
    there, back = align(estimate, truth), align(truth, estimate)
    np.testing.assert_allclose(np.abs(se2.wrap(there[2] + back[2])), 0, atol=1e-9)


@given(coordinate, coordinate, coordinate, coordinate, st.integers(1, 20), st.booleans())
def test_without_a_direction_only_the_centroids_meet(
    a: float, b: float, c: float, d: float, n: int, only_one: bool
) -> None:
    estimate = np.tile([a, b], (n, 1))
    truth = np.tile([c, d], (n, 1)) if only_one else np.random.default_rng(n).normal(size=(n, 2))
    found = align(estimate, truth)
    assert found[2] == 0
    np.testing.assert_allclose(found[:2], truth.mean(0) - [a, b], atol=1e-12)


def test_of_no_points_or_of_a_figure_that_fits_every_way_the_rotation_is_none() -> None:
    assert align(np.empty((0, 2)), np.empty((0, 2))).tolist() == [0, 0, 0]
    assert align([], []).tolist() == [0, 0, 0]
    square = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
    assert align(square + np.array([5.3, 0.1]), square * [1, -1])[2] == 0


def test_a_half_turn_is_found() -> None:
    points = np.array([[1.0, 0.0], [-1.0, 0.0], [3.0, 1.0]])
    assert abs(align(points, -points)[2]) == pytest.approx(np.pi)


# evaluate


@given(seeds, motions)
def test_ate_is_the_same_in_every_frame(seed: int, motion: Array) -> None:
    times, poses = trajectory(seed)
    truth = Truth(times, poses, {i: poses[i, :2] + 1 for i in range(5)})
    estimate = noisy(poses, seed)
    landmarks = {i: estimate[i, :2] + 1 for i in range(5)}
    a = evaluate(times, estimate, truth, landmarks)
    b = evaluate(
        times, se2.compose(motion, estimate), truth, {i: se2.transform(motion, p) for i, p in landmarks.items()}
    )
    np.testing.assert_allclose(fields(a), fields(b), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(a.poses[:, :2], b.poses[:, :2], atol=1e-9)
    np.testing.assert_allclose(a.landmarks[3], b.landmarks[3], atol=1e-9)
    np.testing.assert_allclose(se2.wrap(a.poses[:, 2] - b.poses[:, 2]), 0, atol=1e-9)


@given(seeds, motions)
def test_a_rigid_copy_has_no_error(seed: int, motion: Array) -> None:
    times, poses = trajectory(seed)
    landmarks = {i: poses[i, :2] + i for i in range(5)}
    e = evaluate(
        times,
        se2.compose(motion, poses),
        Truth(times, poses, landmarks),
        {i: se2.transform(motion, p) for i, p in landmarks.items()},
    )
    assert e.ate_m is not None and e.heading_rmse_deg is not None and e.landmark_rmse_m is not None
    assert max(e.ate_m, e.heading_rmse_deg, e.landmark_rmse_m) < 1e-9
    np.testing.assert_allclose(e.poses[:, :2], poses[:, :2], atol=1e-9)
    assert (e.matched, e.matched_landmarks) == (40, 5)


@given(seeds, motions)
def test_alignment_never_makes_ate_larger(seed: int, motion: Array) -> None:
    times, poses = trajectory(seed)
    estimate = se2.compose(motion, noisy(poses, seed))
    with_it, without = (evaluate(times, estimate, Truth(times, poses), aligned=a) for a in (True, False))
    assert with_it.ate_m is not None and without.ate_m is not None
    assert with_it.ate_m <= without.ate_m + 1e-9
    assert without.alignment.tolist() == [0, 0, 0]
    np.testing.assert_allclose(without.poses, estimate, atol=1e-12)


@given(motions)
def test_without_alignment_the_offset_is_the_error(motion: Array) -> None:
    times, poses = trajectory(0)
    moved = poses + motion
    e = evaluate(times, moved, Truth(times, poses, {"a": (1, 2)}), {"a": np.array([1, 2]) + motion[:2]}, aligned=False)
    assert e.ate_m == pytest.approx(np.hypot(*motion[:2]), abs=1e-9)
    assert e.landmark_rmse_m == pytest.approx(np.hypot(*motion[:2]), abs=1e-9)
    assert e.heading_rmse_deg == pytest.approx(np.rad2deg(abs(motion[2])), abs=1e-9)


def test_root_mean_square_is_over_the_lengths() -> None:
    times, poses = np.arange(2.0), np.zeros((2, 3))
    moved = np.array([[3.0, 4.0, np.pi - 0.1], [0.0, 0.0, 0.0]])
    truth = Truth(times, poses, {1: (0, 0), 2: (0, 0)})
    e = evaluate(times, moved, truth, {1: (0, 5), 2: (12, 0), 3: (99, 99)}, aligned=False)
    assert e.ate_m == pytest.approx(np.sqrt(25 / 2))
    assert e.landmark_rmse_m == pytest.approx(np.sqrt((25 + 144) / 2))
    assert e.heading_rmse_deg == pytest.approx(np.rad2deg(np.pi - 0.1) / np.sqrt(2))
    assert e.matched_landmarks == 2


def test_heading_errors_wrap() -> None:
    times, poses = trajectory(1)
    poses[:, 2] = np.pi - 0.01
    turned = poses.copy()
    turned[:, 2] = -np.pi + 0.01
    e = evaluate(times, turned, Truth(times, poses), aligned=False)
    assert e.heading_rmse_deg == pytest.approx(np.rad2deg(0.02))


@given(seeds, st.randoms(use_true_random=False))
def test_neither_order_of_rows_nor_of_landmarks_matters(seed: int, random: Any) -> None:
    times, poses = trajectory(seed)
    truth, estimate = Truth(times, poses, {i: poses[i, :2] for i in range(6)}), noisy(poses, seed)
    landmarks = {i: estimate[i, :2] for i in range(6)}
    order = random.sample(range(40), 40)
    shuffled = {i: landmarks[i] for i in random.sample(range(6), 6)}
    a, b = evaluate(times, estimate, truth, landmarks), evaluate(times[order], estimate[order], truth, shuffled)
    np.testing.assert_allclose(fields(a), fields(b), rtol=1e-9)
    np.testing.assert_allclose(a.poses[order], b.poses, atol=1e-9)


def test_a_sparse_truth_is_matched_and_the_rest_left_out() -> None:
    times, poses = trajectory(2)
    seen = [3, 17, 30]
    estimate = poses.copy()
    estimate[[i for i in range(40) if i not in seen], :2] += 50
    e = evaluate(times, estimate, Truth(times[seen] + 0.01, poses[seen]), max_gap=0.02)
    assert e.matched == 3
    assert e.ate_m is not None and e.ate_m < 1e-9
    assert evaluate(times, estimate, Truth(times[seen] + 0.01, poses[seen]), max_gap=0.005).matched == 0


@pytest.mark.parametrize("truth", [None, Truth(np.empty(0), np.empty((0, 3)), {"a": np.zeros(2)})])
def test_where_there_is_no_truth_there_is_no_number(truth: logs.Truth | None) -> None:
    times, poses = trajectory(0)
    e = evaluate(times, poses, truth, {"a": (1.0, 2.0)})
    assert (e.ate_m, e.heading_rmse_deg, e.landmark_rmse_m, e.matched) == (None, None, None, 0)
    np.testing.assert_allclose(e.poses, poses, atol=1e-12)
    assert relative_error(times, poses, truth, seconds=1.0) == relative_error(times, poses, truth, metres=1.0)
    assert relative_error(times, poses, truth, seconds=1.0).translation_rmse_m is None
    known = evaluate(times, poses, truth, {"a": (3.0, 4.0)}, aligned=False).landmark_rmse_m
    assert known == (None if truth is None else 5.0)


def test_no_error_is_given_for_fewer_than_three_matched_poses() -> None:
    """The estimate drives east and the robot drove north: two matches hide that, and one hides everything."""
    t = np.arange(20.0)
    east, north = np.column_stack([t, 0 * t, 0 * t]), np.column_stack([0 * t, t, 0 * t + np.pi / 2])
    for n in (1, 2):
        e = evaluate(t, east, Truth(t[:n], north[:n], {"a": (0.0, 1.0)}), {"a": (1.0, 0.0)})
        assert (e.ate_m, e.heading_rmse_deg, e.landmark_rmse_m) == (None, None, None)
        assert (e.matched, e.matched_landmarks, e.aligned_by) == (n, 1, None)
        known = evaluate(t, east, Truth(t[:n], north[:n]), aligned=False)
        assert known.heading_rmse_deg == pytest.approx(90)
        assert known.ate_m == pytest.approx([0, 1][n - 1])
    whole = evaluate(t, east, Truth(t[:3], north[:3], {"a": (0.0, 1.0)}), {"a": (1.0, 0.0)})
    assert (whole.matched, whole.aligned_by) == (3, "poses")
    assert fields(whole)[:3] == pytest.approx([0, 0, 0], abs=1e-9)


def test_one_true_pose_aligns_positions_only() -> None:
    times, poses = trajectory(0)
    e = evaluate(times, poses + np.array([1, 2, 0.3]), Truth(times[:1], poses[:1]))
    np.testing.assert_allclose(e.alignment, [-1, -2, 0], atol=1e-12)
    np.testing.assert_allclose(e.poses[:, :2], poses[:, :2], atol=1e-12)
    np.testing.assert_allclose(e.poses[0, 2], se2.wrap(poses[0, 2] + 0.3), atol=1e-12)


@pytest.mark.parametrize("moves", [(False, False), (True, False), (False, True)])
def test_a_robot_that_stands_still_gives_no_heading_error(moves: tuple[bool, bool]) -> None:
    times, poses = trajectory(0)
    still = np.tile([1.0, 2.0, 0.3], (40, 1))
    estimate, truth = (poses if m else still for m in moves)
    e = evaluate(times, estimate, Truth(times, truth, {"a": (0.0, 1.0)}), {"a": (1.0, 0.0)})
    assert (e.heading_rmse_deg, e.landmark_rmse_m, e.matched, e.aligned_by) == (None, None, 40, None)
    assert e.ate_m == pytest.approx(np.sqrt(np.var(poses[:, :2], axis=0).sum()) if any(moves) else 0)


@pytest.mark.parametrize("matched", [0, 1, 2])
@given(seed=seeds, motion=motions)
def test_a_map_with_a_truth_is_scored_where_the_path_has_too_little(matched: int, seed: int, motion: Array) -> None:
    times, poses = trajectory(seed)
    places = {i: poses[i, :2] + i for i in range(5)}
    truth = Truth(times[:matched], poses[:matched], places)
    copy = {i: se2.transform(motion, p) for i, p in places.items()}
    e = evaluate(times, se2.compose(motion, poses), truth, copy)
    assert e.landmark_rmse_m == pytest.approx(0, abs=1e-9)
    assert (e.ate_m, e.heading_rmse_deg, e.matched, e.matched_landmarks) == (None, None, matched, 5)
    assert e.aligned_by == "landmarks"
    np.testing.assert_allclose(e.poses[:, :2], poses[:, :2], atol=1e-9)
    offset = copy | {0: copy[0] + np.array([0.1, 0.0])}
    found = evaluate(times, poses, truth, offset).landmark_rmse_m
    # The alignment takes up less than half of what one of five landmarks is off.
    assert found is not None and 0.02 < found < 0.1 / np.sqrt(5)


def test_two_landmarks_do_not_score_a_map() -> None:
    truth = Truth([], [], {"a": (0.0, 0.0), "b": (1.0, 0.0)})
    e = evaluate([], [], truth, {"a": (5.0, 0.0), "b": (7.0, 0.0), "c": (0.0, 0.0)})
    assert (e.landmark_rmse_m, e.matched_landmarks, e.aligned_by) == (None, 2, None)


def test_where_the_path_suffices_the_map_does_not_choose_the_alignment() -> None:
    times, poses = trajectory(3)
    places = {i: poses[i, :2] for i in range(5)}
    off = {i: p + np.array([1.0, 0.0]) for i, p in places.items()}
    e = evaluate(times, poses, Truth(times, poses, places), off)
    assert e.aligned_by == "poses" and e.landmark_rmse_m == pytest.approx(1.0)


# relative_error


@given(seeds, motions, st.sampled_from([{"seconds": 4.0}, {"metres": 3.0}]))
def test_relative_error_is_the_same_in_every_frame(seed: int, motion: Array, length: dict[str, float]) -> None:
    times, poses = trajectory(seed)
    truth, estimate = Truth(times, poses), noisy(poses, seed)
    a = relative_error(times, estimate, truth, **length)
    b = relative_error(times, se2.compose(motion, estimate), truth, **length)
    assert a.pairs == b.pairs
    assume(a.pairs > 0)
    np.testing.assert_allclose(
        numbers(a.translation_rmse_m, a.rotation_rmse_deg),
        numbers(b.translation_rmse_m, b.rotation_rmse_deg),
        rtol=1e-7,
    )
    c = relative_error(times, se2.compose(motion, poses), truth, **length)
    assert c.translation_rmse_m == pytest.approx(0, abs=1e-9)
    assert c.rotation_rmse_deg == pytest.approx(0, abs=1e-9)


@given(st.floats(-0.2, 0.2), st.integers(1, 20))
def test_a_drift_per_time_shows_as_that_drift(rate: float, n: int) -> None:
    times = np.arange(50.0)
    straight = np.column_stack([times, np.zeros(50), np.zeros(50)])
    fast = straight * [1 + rate, 1, 1]
    e = relative_error(times, fast, Truth(times, straight), seconds=float(n))
    assert e.pairs == 50 - n
    assert e.translation_rmse_m == pytest.approx(abs(rate) * n, abs=1e-9)
    turned = relative_error(times, straight + times[:, None] * [0, 0, 0.01], Truth(times, straight), seconds=float(n))
    assert turned.rotation_rmse_deg == pytest.approx(np.rad2deg(0.01) * n)


def test_distance_is_along_the_true_path() -> None:
    times = np.arange(101.0)
    there_and_back = np.column_stack([np.minimum(times, 100 - times), np.zeros(101), np.zeros(101)])
    e = relative_error(times, there_and_back, Truth(times, there_and_back), metres=70.0)
    assert e.pairs == 31
    assert relative_error(times, there_and_back, Truth(times, there_and_back), metres=101.0).pairs == 0


def test_no_stretch_reaches_over_a_gap() -> None:
    times = np.append(np.arange(5.0), np.arange(300.0, 305.0))
    poses = np.zeros((10, 3))
    assert relative_error(times, poses, Truth(times, poses), seconds=3.0).pairs == 4
    assert relative_error(times, poses, Truth(times, poses), seconds=100.0).pairs == 0


def test_relative_error_does_not_depend_on_the_order_of_rows() -> None:
    times, poses = trajectory(5)
    truth, estimate = Truth(times, poses), noisy(poses, 5)
    order = np.random.default_rng(0).permutation(40)
    assert relative_error(times[order], estimate[order], truth, seconds=4.0) == relative_error(
        times, estimate, truth, seconds=4.0
    )


@pytest.mark.parametrize("wrong", [{}, {"seconds": 1.0, "metres": 1.0}, {"seconds": 0.0}, {"metres": np.inf}])
def test_a_stretch_has_one_positive_length(wrong: dict[str, float]) -> None:
    times, poses = trajectory(0)
    with pytest.raises(InputError, match=r"seconds|metres"):
        relative_error(times, poses, Truth(times, poses), **wrong)


# bad input

shaped = array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4).flatmap(
    lambda shape: arrays(float, shape, elements=st.floats(-1e3, 1e3))
)


@settings(max_examples=200)
@given(shaped, shaped)
def test_every_shape_gives_an_answer_or_an_input_error(a: Array, b: Array) -> None:
    truth = Truth(np.arange(3.0), np.zeros((3, 3)), {0: np.zeros(2)})
    right: dict[str, tuple[Any, bool]] = {
        "nearest": (lambda: nearest(a, b, 1.0), a.ndim == b.ndim == 1),
        "align": (
            lambda: align(a, b),
            (a.shape == b.shape and a.ndim == 2 and a.shape[1] == 2) or all(x.shape in ((0,), (0, 2)) for x in (a, b)),
        ),
        "evaluate": (
            lambda: evaluate(a, b, truth),
            a.ndim == 1 and (b.shape == (len(a), 3) or (len(a) == 0 and b.shape == (0,))),
        ),
        "relative_error": (
            lambda: relative_error(a, b, truth, seconds=1.0),
            a.ndim == 1 and (b.shape == (len(a), 3) or (len(a) == 0 and b.shape == (0,))),
        ),
        "landmark": (lambda: evaluate([], [], truth, {0: a}), a.shape == (2,)),
    }
    for call, fits in right.values():
        if fits:
            call()
        else:
            with pytest.raises(InputError, match=r"shape|as many"):
                call()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_refused_with_its_place(bad: float) -> None:
    times, poses = trajectory(0)
    truth = Truth(times, poses)
    broken, stamps = poses.copy(), times.copy()
    broken[4, 1] = stamps[4] = bad
    for call in (
        lambda: nearest(stamps, times, 1.0),
        lambda: nearest(times, stamps, 1.0),
        lambda: align(broken[:, :2], poses[:, :2]),
        lambda: evaluate(times, broken, truth),
        lambda: evaluate(stamps, poses, truth),
        lambda: relative_error(times, broken, truth, seconds=1.0),
    ):
        with pytest.raises(InputError, match="row 4"):
            call()
    with pytest.raises(InputError, match="landmark 'a'"):
        evaluate(times, poses, truth, {"a": (0.0, bad)})
    with pytest.raises(InputError, match="tolerance"):
        nearest(times, times, -1.0)
    with pytest.raises(InputError, match="numbers"):
        align("north", poses[:, :2])


def test_complex_values_are_refused() -> None:
    times, poses = trajectory(0)
    truth = Truth(times, poses)
    for call in (
        lambda: nearest(times * 1j, times, 1.0),
        lambda: align(poses[:, :2], poses[:, :2] * 1j),
        lambda: evaluate(times, poses * (1 + 0j), truth),
        lambda: relative_error(times, poses * 1j, truth, seconds=1.0),
        lambda: evaluate(times, poses, truth, {"a": [1j, 0.0]}),
        lambda: evaluate(times, poses, truth, max_gap="a"),  # type: ignore[arg-type]
        lambda: relative_error(times, poses, truth, seconds=10**400),
    ):
        with pytest.raises(InputError):
            call()
