"""Laws of the gauge: what a filter must not learn, and how that is measured."""

from __future__ import annotations

import copy
from dataclasses import replace
from functools import cache
from itertools import pairwise
from typing import Any, Literal

import numpy as np
import pytest
from family import ORDERS, SENSORS, PlainMotion, PlainSensor
from hypothesis import given, settings
from hypothesis import strategies as st

from slamkit import FirstEstimatesEKFSLAM, InputError, Log, SlamkitError, se2, simulate
from slamkit.compiled import compiled
from slamkit.cycle.standard import start as standard_start
from slamkit.evaluate import gauge
from slamkit.filters import FILTERS
from slamkit.models import Unicycle
from slamkit.simulate import loop_world
from slamkit.study import GAUGE_COVARIANCE, GAUGE_MOTION

#: Whether an estimator keeps the gauge unlearnt; None: not exactly, and no law says how far. A new one adds a line.
KEEPS: dict[str, bool | None] = {
    "ekf": False,
    "iterated": False,
    "fej": True,
    "oc": True,
    "invariant": True,
    "ideal": True,
    "robocentric": None,
    "ukf": False,
    "ukf-full": False,
    "oc-ukf": True,
}
KEEPERS = [name for name in FILTERS if KEEPS.get(name)]
LEARNERS = [name for name in FILTERS if KEEPS.get(name) is False]
every_filter = pytest.mark.parametrize("name", FILTERS)
every_order = pytest.mark.parametrize("order", ORDERS)
every_sensor = pytest.mark.parametrize("sensor", SENSORS)
decided = pytest.mark.parametrize("name", KEEPERS + LEARNERS)
keepers, learners = pytest.mark.parametrize("name", KEEPERS), pytest.mark.parametrize("name", LEARNERS)
#: A mean over sigma points depends on how uncertain the frame is, even where the gauge is kept.
keepers_without_sigma_points = pytest.mark.parametrize("name", [name for name in KEEPERS if "ukf" not in name])

P0 = np.diag([0.1, 0.2, np.deg2rad(5.0)]) ** 2
EPS = np.finfo(float).eps
transforms = st.tuples(st.floats(-50, 50), st.floats(-50, 50), st.floats(-3.1, 3.1)).map(np.array)


@cache
def world(sensor: str = "relative", steps: int = 41) -> Any:
    w = gauge.observability_world()
    return replace(w, sensor=SENSORS[sensor], controls=np.tile(w.controls[:1], (steps, 1)), pose_covariance=P0)


@cache
def log_of(sensor: str = "relative", steps: int = 41, seed: int = 0) -> Log:
    return simulate(world(sensor, steps), np.random.default_rng(seed))


def told(name: str, log: Log) -> dict[str, Any]:
    """What this estimator's constructor wants beyond the models."""
    return {"truth": log.truth} if name == "ideal" else {}


def make(name: str, log: Log, sensor: str = "relative", P: Any = P0, **options: Any) -> Any:
    w = world(sensor)
    return FILTERS[name](w.motion, w.sensor, w.pose, P, **told(name, log), **options)


def grown(name: str, steps: int = 41, **options: Any) -> Any:
    log = log_of(steps=steps)
    f = make(name, log, **options)
    f.run(log)
    return f


def brute_deviation(f: Any) -> float:
    N = gauge.null_directions(f)
    return float(np.sqrt(np.linalg.inv(N.T @ np.linalg.solve(f.P, N))[2, 2]))


def moved(t: Any, x: Any) -> Any:
    """A state after a rigid motion of robot and map."""
    return np.concatenate([se2.compose(t, x[:3]), se2.transform(t, x[3:].reshape(-1, 2)).ravel()])


def test_every_filter_is_said_to_keep_its_gauge_or_not() -> None:
    assert set(FILTERS) <= set(KEEPS), "add the new estimator to KEEPS"


# -- null directions


@pytest.mark.parametrize("name", ["ekf", "invariant", "iterated"])
def test_null_directions_are_rigid_motions_of_the_state(name: str) -> None:
    f, h = grown(name), 1e-6
    difference = [(moved(h * e, f.x) - moved(-h * e, f.x)) / (2 * h) for e in np.eye(3)]
    np.testing.assert_allclose(gauge.null_directions(f), np.transpose(difference), atol=1e-8)


def test_ideal_null_directions_are_rigid_motions_of_the_truth() -> None:
    truth = log_of().truth
    assert truth is not None
    f, h = grown("ideal"), 1e-6
    x = np.concatenate([truth.poses[-1], *[truth.landmarks[i] for i in f.landmark_ids]])
    difference = [(moved(h * e, x) - moved(-h * e, x)) / (2 * h) for e in np.eye(3)]
    np.testing.assert_allclose(gauge.null_directions(f), np.transpose(difference), atol=1e-8)


def test_first_estimates_stay_in_the_null_directions() -> None:
    log = log_of()
    f, first = make("fej", log), {}
    for step in log:
        moment = copy.deepcopy(f)
        moment.predict(step.u, step.dt)
        f.step(step.u, step.dt, step.scan)
        first |= {i: p for i, p in f.landmarks.items() if i not in first}
        J = np.array([[0.0, -1.0], [1.0, 0.0]])
        N = gauge.null_directions(f)
        np.testing.assert_allclose(N[:2, 2], J @ moment.pose[:2], atol=1e-14)
        np.testing.assert_allclose(N[3:, 2], np.concatenate([J @ first[i] for i in f.landmark_ids]), atol=1e-14)


@keepers
@every_order
@every_sensor
def test_prediction_carries_the_null_directions_on(name: str, order: str, sensor: str) -> None:
    log = log_of(sensor)
    f = make(name, log, sensor, order=order)
    before = None
    for step in log:
        if before is not None:
            # An estimator that chooses its lever arms with the scan in hand must be given the scan.
            f.step(step.u, step.dt, step.scan)
            if name != "invariant":  # whose N moves on with the mean within the scan, too
                np.testing.assert_allclose(f.F @ before, gauge.null_directions(f), atol=1e-12)
        else:
            f.step(step.u, step.dt, step.scan)
        before = gauge.null_directions(f)


# -- nullity


@decided
@every_order
@every_sensor
def test_nullity_is_three_unless_the_heading_is_learnt(name: str, order: str, sensor: str) -> None:
    log = log_of(sensor)
    f = make(name, log, sensor, order=order)
    found = gauge.nullity(f, log)
    values = found.singular_values
    assert len(f.landmark_ids) == 0  # a copy made the run
    assert values.shape == (13,) and np.all(np.diff(values) <= 0)
    assert found.nullity == (3 if KEEPS[name] else 2)
    # A regression is not blind to where the map lies: what is cubic in the heading remains, as α².
    # Sigma points of the whole state lie farther out.
    remains = {"ukf": 1e-6, "ukf-full": 2e-6}.get(name)
    assert np.all(values[-found.nullity :] < (2e-13 if remains is None else remains * values[0]))
    assert np.all(values[: -found.nullity] > 1e-2)


@every_order
@every_sensor
def test_the_standard_matrix_is_that_of_the_textbook(order: str, sensor: str) -> None:
    """One landmark a scan, so that every Jacobian can be had from the outside."""
    w, rng = world(sensor), np.random.default_rng(3)
    f = FILTERS["ekf"](w.motion, w.sensor, w.pose, P0, order=order)
    for i, p in w.landmarks.items():
        f.observe(i, w.sensor.predict(w.pose, p))
    start, root = copy.deepcopy(f), np.linalg.cholesky(w.sensor.R)
    times, ids, z, rows, Phi = [], [], [], [], np.eye(13)
    pose = w.pose
    for k, u in enumerate(w.controls):
        pose = w.motion.move(pose, u, w.dt)
        times.append((k + 1) * w.dt)
        ids.append(k % 5)
        z.append(w.sensor.predict(pose, w.landmarks[k % 5]) + root @ rng.normal(size=2))
        F = np.eye(13)
        F[:3, :3] = w.motion.jacobians(f.pose, u, w.dt)[0]
        Phi = F @ Phi
        f.predict(u, w.dt)
        H, slot = np.zeros((2, 13)), 3 + 2 * ids[-1]
        H[:, :3], H[:, slot : slot + 2] = w.sensor.jacobians(f.pose, f.landmarks[ids[-1]])
        rows.append(np.linalg.solve(root, H @ Phi))
        f.observe(ids[-1], z[-1])
    log = Log(np.arange(len(times)) * w.dt, w.controls, times, ids, z, tuple(range(5)))
    expected = np.linalg.svd(np.concatenate(rows), compute_uv=False)
    np.testing.assert_allclose(gauge.nullity(start, log).singular_values, expected, atol=1e-10 * expected[0])


@decided
def test_plain_models_have_the_same_nullity(name: str) -> None:
    log, w = log_of(), world()
    plain = FILTERS[name](PlainMotion(w.motion), PlainSensor(w.sensor), w.pose, P0, **told(name, log))
    a, b = gauge.nullity(make(name, log), log), gauge.nullity(plain, log)
    np.testing.assert_allclose(a.singular_values, b.singular_values, atol=1e-9 * a.singular_values[0])


def test_landmarks_that_nothing_ties_together_add_to_the_nullity() -> None:
    w = world()
    log = Log([0.0], [(0.0, 0.0)], [1.0], [0], [(2.0, 0.3)], (0, "never seen"))
    found = gauge.nullity(FILTERS["ekf"](w.motion, w.sensor), log)
    assert found.singular_values.shape == (5,)
    assert found.nullity == 3
    empty = gauge.nullity(
        FILTERS["ekf"](w.motion, w.sensor), Log([0.0], [(0.0, 0.0)], [], [], np.empty((0, 2)), (), 1.0)
    )
    assert empty.nullity == 3


@compiled("void(models, state, index, index, vector)", generic=True)
def published_start(models: Any, state: Any, slot: int, place: int, z: Any) -> None:
    """G_x = [I, J(l - p_{k|k})], with the lever arm at the updated position, as published."""
    standard_start(models, state, slot, place, z)
    state.points[slot : slot + 2] = state.mean[slot : slot + 2]


class Published(FirstEstimatesEKFSLAM):
    """First estimates but for the initialisation."""

    functions = FirstEstimatesEKFSLAM.functions._replace(start=published_start)


def test_a_wrong_initialisation_shows() -> None:
    log, w = _with_a_late_landmark(log_of()), world()
    right, wrong = (kind(w.motion, w.sensor, w.pose, P0) for kind in (FirstEstimatesEKFSLAM, Published))
    assert gauge.nullity(right, log).nullity == 3
    assert gauge.nullity(wrong, log).nullity == 2
    plain = PlainMotion(w.motion), PlainSensor(w.sensor)
    assert gauge.stochastic_gauge(FirstEstimatesEKFSLAM, *plain, log, P0, w.pose) < 1e-11
    assert gauge.stochastic_gauge(Published, *plain, log, P0, w.pose) > 1e-6


def _with_a_late_landmark(log: Log) -> Log:
    """Landmark 4 is not sighted in the first half, and the last in each scan: the position is updated before it."""
    keep = (log.observation_ids != 4) | (log.observation_times > log.observation_times[-1] / 2)
    return replace(
        log,
        observation_times=log.observation_times[keep],
        observation_ids=log.observation_ids[keep],
        observations=log.observations[keep],
    )


@keepers
@every_order
def test_a_late_landmark_is_no_exception(name: str, order: str) -> None:
    log = _with_a_late_landmark(log_of())
    f = make(name, log, order=order)
    assert gauge.nullity(f, log).nullity == 3
    d = gauge.gauge_deviations(f, log)
    assert gauge.gauge_drop(d) <= 1e-9 * d[0]


@pytest.mark.parametrize("tolerance", [0.0, -1.0, 1.0, np.nan])
def test_tolerances_that_are_no_share(tolerance: float) -> None:
    with pytest.raises(InputError, match="tolerance"):
        gauge.nullity(make("ekf", log_of()), log_of(), tolerance)


# -- gauge deviation


@every_filter
@every_order
def test_gauge_deviation_is_that_of_the_heading_given_the_relative_map(name: str, order: str) -> None:
    log = log_of(steps=120)
    f = make(name, log, order=order)
    deviations = gauge.gauge_deviations(f, log)
    assert len(f.landmark_ids) == 0 and deviations.shape == (len(log),)
    for k, step in enumerate(log):
        f.step(step.u, step.dt, step.scan)
        if k % 7 == 0:
            assert deviations[k] == pytest.approx(brute_deviation(f), rel=1e-9)
            assert gauge.gauge_deviation(f) == pytest.approx(deviations[k], rel=1e-12)


@keepers
@every_order
@every_sensor
def test_gauge_deviation_never_falls(name: str, order: str, sensor: str) -> None:
    log = log_of(sensor, 120)
    d = gauge.gauge_deviations(make(name, log, sensor, order=order), log)
    assert d[0] >= np.deg2rad(5.0) * (1 - 1e-9)
    assert gauge.gauge_drop(d) <= 1e-9 * d[0]


@learners
@every_order
@every_sensor
def test_gauge_deviation_falls_where_the_heading_is_learnt(name: str, order: str, sensor: str) -> None:
    log = log_of(sensor, 120)
    assert gauge.gauge_drop(gauge.gauge_deviations(make(name, log, sensor, order=order), log)) > np.deg2rad(0.5)


@keepers
def test_a_known_start_leaves_no_gauge_to_learn(name: str) -> None:
    log, w = log_of(), replace(world(), motion=Unicycle(0.0, 0.0))
    f = FILTERS[name](w.motion, w.sensor, w.pose, None, **told(name, log))
    f.run(log)
    assert gauge.gauge_deviation(f) <= 1e-8


def test_gauge_deviation_of_a_bare_pose_is_that_of_its_heading() -> None:
    f = make("ekf", log_of())
    assert gauge.gauge_deviation(f) == pytest.approx(np.deg2rad(5.0))


def test_a_map_that_is_claimed_to_be_exact_is_refused() -> None:
    f = grown("ekf")
    f.P = np.zeros(f.P.shape)
    for act in (lambda: gauge.gauge_deviation(f), lambda: gauge.nees_split(f, f.pose, f.landmarks)):
        with pytest.raises(SlamkitError, match="not positive definite"):
            act()


@given(st.lists(st.floats(0, 10), max_size=8))
def test_gauge_drop_is_the_largest_fall(d: list[float]) -> None:
    falls = [a - b for i, a in enumerate(d) for b in d[i:]]
    assert gauge.gauge_drop(d) == max(falls, default=0.0)


# -- stochastic gauge and equivariance


@keepers_without_sigma_points
@every_order
@every_sensor
@pytest.mark.parametrize("degrees", [1.0, 5.0, 20.0])
def test_an_uncertain_frame_changes_nothing_relative(name: str, order: str, sensor: str, degrees: float) -> None:
    log, w = log_of(sensor, 120), world(sensor)
    P = np.array([[0.04, 0.01, 0.0], [0.01, 0.09, 0.0], [0.0, 0.0, np.deg2rad(degrees) ** 2]])
    off = gauge.stochastic_gauge(FILTERS[name], w.motion, w.sensor, log, P, w.pose, order=order, **told(name, log))
    assert off <= 1e-9


@learners
@every_sensor
def test_an_uncertain_frame_changes_what_a_learner_says(name: str, sensor: str) -> None:
    log, w = log_of(sensor, 120), world(sensor)
    assert gauge.stochastic_gauge(FILTERS[name], w.motion, w.sensor, log, P0, w.pose) > 1e-4


def test_the_stochastic_gauge_is_the_difference_of_two_runs() -> None:
    log, w = log_of(), world()
    ends = []
    for P in (None, P0):
        f = FILTERS["ekf"](w.motion, w.sensor, w.pose, P)
        seen = []
        for step in log:
            f.step(step.u, step.dt, step.scan)
            seen.append([se2.transform(se2.inverse(f.pose), p) for p in f.landmarks.values()])
        ends.append(np.array(seen))
    expected = np.linalg.norm(ends[0] - ends[1], axis=-1).max()
    assert gauge.stochastic_gauge(FILTERS["ekf"], w.motion, w.sensor, log, P0, w.pose) == pytest.approx(expected)


@every_filter
@every_order
@every_sensor
@settings(max_examples=4)
@given(T=transforms)
def test_estimates_move_with_the_frame(name: str, order: str, sensor: str, T: Any) -> None:
    log, w = log_of(sensor), world(sensor)
    off = gauge.equivariance(FILTERS[name], w.motion, w.sensor, log, T, w.pose, P0, order=order, **told(name, log))
    assert off <= 1e-9


@every_filter
@pytest.mark.parametrize(("sensor", "P"), [("relative", GAUGE_COVARIANCE), ("range-bearing", None)])
def test_a_longer_run_moves_with_the_frame(name: str, sensor: Literal["relative", "range-bearing"], P: Any) -> None:
    """On the loop world, under the motion that `slamkit compare` takes: rounding adds up over 200 steps."""
    w = loop_world(sensor)
    log = simulate(replace(w, controls=w.controls[:200]), np.random.default_rng(0))
    off = gauge.equivariance(FILTERS[name], w.motion, w.sensor, log, GAUGE_MOTION, w.pose, P, **told(name, log))
    assert off <= 1e-9


def test_equivariance_is_the_difference_of_two_runs() -> None:
    """By brute force, with a pose noise that does depend on the axes."""
    log, T = log_of(), np.array([3.0, -2.0, 0.8])
    motion, w = Unicycle(0.05, 0.05, pose_noise=np.diag([1e-2, 1e-4, 1e-5])), world()
    c, s = np.cos(T[2]), np.sin(T[2])
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    a = FILTERS["ekf"](motion, w.sensor, w.pose, P0)
    b = FILTERS["ekf"](motion, w.sensor, se2.compose(T, w.pose), R @ P0 @ R.T)
    expected = 0.0
    for step in log:
        for f in (a, b):
            f.step(step.u, step.dt, step.scan)
        A = np.eye(b.dim_x)
        A[:3, :3] = R
        for k in range(3, len(A), 2):
            A[k : k + 2, k : k + 2] = R[:2, :2]
        error = b.x - moved(T, a.x)
        error[2] = se2.wrap(error[2])
        expected = max(expected, np.abs(error).max(), np.abs(b.P - A @ a.P @ A.T).max())
    found = gauge.equivariance(FILTERS["ekf"], motion, w.sensor, log, T, w.pose, P0)
    assert found == pytest.approx(expected)
    assert found > 1e-4


def test_a_gate_that_splits_the_maps_is_named() -> None:
    log, w = log_of(), world()

    def forgetful(*arguments: Any) -> Any:
        f = FILTERS["ekf"](*arguments)
        if np.any(arguments[3]):
            f.observe("only here", (1.0, 1.0))
        return f

    with pytest.raises(InputError, match="different maps"):
        gauge.stochastic_gauge(forgetful, w.motion, w.sensor, log, P0)


# -- the split of NEES


def truth_of(log: Log) -> tuple[Any, dict[Any, Any]]:
    assert log.truth is not None
    return log.truth.poses[-1], dict(log.truth.landmarks)


@every_filter
def test_the_parts_of_nees_sum_to_the_whole(name: str) -> None:
    f, log = grown(name), log_of()
    pose, landmarks = truth_of(log)
    found = gauge.nees_split(f, pose, landmarks)
    # B and the errors anew, by finite differences around the points at which this estimator takes its lever arms.
    points = _lever_points(f)

    def body(x: Any) -> Any:
        g = se2.log(se2.between(np.r_[points[:2], f.pose[2]], x[:3]))
        g[:2] += se2.rotation(f.pose[2]).T @ (np.array([[0, -1], [1, 0]]) @ (f.pose[:2] - points[:2])) * g[2]
        return np.concatenate([g, ((x[3:].reshape(-1, 2) - x[:2]) @ se2.rotation(x[2])).ravel()])

    h, at = 1e-6, np.concatenate([points[:2], f.x[2:3], points[3:]])
    B = np.transpose([(body(at + h * e) - body(at - h * e)) / (2 * h) for e in np.eye(len(at))])
    true = np.concatenate([pose, *[landmarks[i] for i in f.landmark_ids]])
    e = np.concatenate([se2.log(se2.between(f.pose, pose)), (body(true) - body(f.x))[3:]])
    whole = e @ np.linalg.solve(B @ f.P @ B.T, e)
    assert found.total == pytest.approx(whole, rel=1e-4)
    assert (found.gauge_dof, found.relative_dof) == (3, 10)
    assert found.relative_per_dof == pytest.approx(found.relative / 10)


def _lever_points(f: Any) -> Any:
    """Positions from the rotation's column of N: J p turned back."""
    column = gauge.null_directions(f)[:, 2]
    out = np.zeros_like(column)
    out[0], out[1] = column[1], -column[0]
    out[3::2], out[4::2] = column[4::2], -column[3::2]
    return out


@every_filter
@settings(max_examples=10)
@given(T=transforms)
def test_a_rigid_motion_of_the_truth_is_gauge_alone(name: str, T: Any) -> None:
    f, (pose, landmarks) = grown(name), truth_of(log_of())
    here = gauge.nees_split(f, pose, landmarks)
    there = gauge.nees_split(f, se2.compose(T, pose), {i: se2.transform(T, p) for i, p in landmarks.items()})
    assert there.relative == pytest.approx(here.relative, rel=1e-6)
    if np.abs(T).max() > 1e-3:
        assert abs(there.gauge - here.gauge) > 1e-9


@pytest.mark.parametrize("name", [n for n in FILTERS if n != "ideal"])
@settings(max_examples=5)
@given(T=transforms)
def test_the_split_does_not_depend_on_the_frame(name: str, T: Any) -> None:
    log, w = log_of(), world()
    pose, landmarks = truth_of(log)
    c, s = np.cos(T[2]), np.sin(T[2])
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    f = FILTERS[name](w.motion, w.sensor, se2.compose(T, w.pose), R @ P0 @ R.T)
    f.run(log)
    a = gauge.nees_split(grown(name), pose, landmarks)
    b = gauge.nees_split(f, se2.compose(T, pose), {i: se2.transform(T, p) for i, p in landmarks.items()})
    assert a.gauge == pytest.approx(b.gauge, rel=1e-6)
    assert a.relative == pytest.approx(b.relative, rel=1e-6)


@keepers_without_sigma_points
def test_both_parts_are_chi_square_where_the_gauge_is_kept(name: str) -> None:
    runs = []
    for seed in range(60):
        log = log_of(steps=30, seed=seed)
        w = world()
        f = FILTERS[name](w.motion, w.sensor, w.pose, P0, **told(name, log))
        f.run(log)
        found = gauge.nees_split(f, *truth_of(log))
        runs.append((found.gauge, found.relative))
    # Bounds four standard errors wide: √(2 d / M) each.
    M, (g, r) = len(runs), np.mean(runs, axis=0)
    assert abs(g - 3) < 4 * np.sqrt(2 * 3 / M)
    assert abs(r - 10) < 4 * np.sqrt(2 * 10 / M)


def test_a_start_that_is_known_exactly_counts_where_it_is_uncertain() -> None:
    w = replace(world(), motion=Unicycle(0.0, 0.0), pose_covariance=np.zeros((3, 3)))
    log = simulate(w, np.random.default_rng(5))
    f = FILTERS["ekf"](w.motion, w.sensor, w.pose)
    f.run(log)
    pose, landmarks = truth_of(log)
    found = gauge.nees_split(f, pose, landmarks)
    assert found.gauge_dof == 0 and found.gauge == 0
    with pytest.raises(SlamkitError, match="exactly"):
        gauge.nees_split(f, pose + np.array([0.0, 0.0, 0.1]), landmarks)


def test_the_truth_must_be_whole() -> None:
    f, (pose, landmarks) = grown("ekf"), truth_of(log_of())
    with pytest.raises(InputError, match="truth_landmarks lack 0"):
        gauge.nees_split(f, pose, {i: p for i, p in landmarks.items() if i != 0})
    for bad in (pose[:2], pose * np.nan, "abc"):
        with pytest.raises(InputError, match="truth_pose"):
            gauge.nees_split(f, bad, landmarks)
    with pytest.raises(InputError, match="landmark 0"):
        gauge.nees_split(f, pose, landmarks | {0: (1.0, 2.0, 3.0)})


# -- convergence


@keepers
@every_order
@every_sensor
def test_the_lower_bound_holds_where_the_gauge_is_kept(name: str, order: str, sensor: str) -> None:
    log, w = log_of(sensor, 120), world(sensor)
    f = make(name, log, sensor, order=order)
    start = log.truth.poses[0] if name == "ideal" and log.truth is not None else w.pose
    for k, step in enumerate(log):
        f.step(step.u, step.dt, step.scan)
        if k % 10 == 0:
            assert gauge.lower_bound_gap(f, P0, start) > -1e-12


@learners
@every_sensor
def test_the_lower_bound_is_broken_where_the_heading_is_learnt(name: str, sensor: str) -> None:
    log, w = log_of(sensor, 120), world(sensor)
    f = make(name, log, sensor)
    f.run(log)
    assert gauge.lower_bound_gap(f, P0, w.pose) < -1e-3


def test_the_lower_bound_is_that_of_the_first_sightings() -> None:
    """With no noise of motion and a nearly perfect sensor the map's covariance is A₀ P₀ A₀ᵀ and hardly more."""
    w = world()
    f = FILTERS["ekf"](Unicycle(0.0, 0.0), type(w.sensor)(1e-7), w.pose, P0)
    for i, p in w.landmarks.items():
        f.observe(i, f.sensor.predict(f.pose, p))
    assert 0 < gauge.lower_bound_gap(f, P0, w.pose) < 2e-14
    assert gauge.lower_bound_gap(f, 2 * P0, w.pose) < -0.1


@keepers
def test_the_relative_map_converges(name: str) -> None:
    sizes = []
    for steps in (30, 120, 480):
        f = grown(name, steps)
        P = gauge.relative_map_covariance(f)
        N = gauge.null_directions(f)[3:]
        assert np.array_equal(P, P.T)
        assert np.abs(P @ N).max() < 1e-12
        values = np.linalg.eigvalsh(P)
        assert values[0] > -1e-15 and np.sum(values > 1e-9) == 2 * 5 - 3
        sizes.append(values[-1])
    assert all(later < 0.5 * earlier for earlier, later in pairwise(sizes))


def test_the_relative_covariance_ignores_the_gauge() -> None:
    f = grown("ekf")
    P, N = gauge.relative_map_covariance(f), gauge.null_directions(f)
    f.P = f.P + N @ np.diag([3.0, 2.0, 1.0]) @ N.T
    np.testing.assert_allclose(gauge.relative_map_covariance(f), P, atol=1e-12)


def test_maps_too_small_and_shapes_that_do_not_fit() -> None:
    log = log_of()
    f = make("ekf", log)
    with pytest.raises(InputError, match="map is empty"):
        gauge.lower_bound_gap(f, P0, (0, 0, 0))
    f.observe(1, (2.0, 0.0))
    with pytest.raises(InputError, match="at least 2"):
        gauge.relative_map_covariance(f)
    with pytest.raises(InputError, match=r"pose_covariance has shape \(2, 2\)"):
        gauge.lower_bound_gap(f, np.eye(2), (0, 0, 0))
    with pytest.raises(InputError, match="T has shape"):
        gauge.equivariance(FILTERS["ekf"], f.motion, f.sensor, log, (0.0, 1.0))
    with pytest.raises(InputError, match="deviations"):
        gauge.gauge_drop([[1.0]])


@every_sensor
def test_regressions_on_the_whole_state_see_what_those_on_a_part_see(sensor: str) -> None:
    """They are dense, but what they hold of other landmarks than the one in sight is of the order of α²."""
    log = log_of(sensor)
    part, whole = (gauge.nullity(make(name, log, sensor), log).singular_values for name in ("ukf", "ukf-full"))
    np.testing.assert_allclose(whole[:-2], part[:-2], rtol=1e-3)
    f = make("ukf-full", log, sensor)
    f.run(log)
    H, _ = f._regression(f._belief.slots[3])
    own = np.r_[0:3, 9:11]
    expected = np.hstack(f.sensor.jacobians(f.pose, f.landmarks[3]))
    np.testing.assert_allclose(H[:, own], expected, atol=0.05)
    assert np.abs(np.delete(H, own, axis=1)).max() < 1e-3


@every_order
@every_sensor
def test_the_robocentric_matrix_holds_what_the_filter_learns(order: str, sensor: str) -> None:
    """Without motion noise the landmarks seen by the robot have the matrix's information, whatever their axes."""
    exact = replace(world(sensor), motion=Unicycle(0.0, 0.0))
    log = _with_a_late_landmark(simulate(exact, np.random.default_rng(1)))
    f = FILTERS["robocentric"](exact.motion, exact.sensor, exact.pose, P0, order=order)
    found = gauge.nullity(f, log)
    f.run(log)
    assert found.nullity == 3
    assert np.all(found.singular_values[-3:] < 1e-12)
    _, information = np.linalg.slogdet(np.linalg.inv(gauge._body_covariance(f)[3:, 3:]))
    np.testing.assert_allclose(2 * np.log(found.singular_values[:-3]).sum(), information, atol=1e-9)
