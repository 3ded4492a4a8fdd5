"""Laws that every filter keeps, whatever its models."""

from __future__ import annotations

import copy
import pickle
from pathlib import Path
from typing import Any

import filterpy.kalman
import numba
import numpy as np
import pytest
from family import (
    ALL,
    FILTERS,
    MOTIONS,
    ROUNDING,
    SENSORS,
    PlainMotion,
    PlainSensor,
    control_for,
    drive,
    extra_sensor,
)
from filter_examples import (
    all_filters,
    every_filter,
    every_motion,
    every_order,
    every_sensor,
    grown,
    make,
    same,
    untouched,
)
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from slamkit import InputError, Log, ModelError, Scan, SlamkitError
from slamkit.models import RangeBearing, Unicycle
from slamkit.protocols import SensorFunctions
from slamkit.se2 import wrap


@all_filters
@every_order
@every_motion
@every_sensor
def test_a_run_is_its_steps(name: str, order: str, motion: str, sensor: str) -> None:
    a, b = make(name, motion, sensor, order=order), make(name, motion, sensor, order=order)
    log = drive(a.motion, a.sensor)
    history = a.run(log)
    if name == "ideal":
        b = make(name, motion, sensor, order=order, truth=log.truth)
    for k, step in enumerate(log):
        if step.dt:
            b.step(step.u, step.dt, step.scan)
        else:
            b.observe_scan(step.scan)
        np.testing.assert_allclose(history.poses[k], b.pose, atol=ROUNDING[name])
        np.testing.assert_allclose(history.pose_covariances[k], b.pose_covariance, atol=ROUNDING[name])
    np.testing.assert_allclose(a.P, b.P, atol=ROUNDING[name])
    np.testing.assert_allclose(history.landmarks, list(b.landmarks.values()), atol=ROUNDING[name])
    started = np.isnan(history.nis)
    assert started.sum() == len(log.landmark_ids)
    assert history.accepted.all()
    assert np.isfinite(history.innovations[~started]).all()


@all_filters
@every_order
@every_sensor
def test_a_plain_model_gives_the_same_history(name: str, order: str, sensor: str) -> None:
    built_in = make(name, sensor=sensor, order=order)
    plain = make(name, PlainMotion(built_in.motion), PlainSensor(built_in.sensor), order=order)
    log = drive(built_in.motion, built_in.sensor)
    a, b = built_in.run(log), plain.run(log)
    tolerance = 10 * ROUNDING[name]
    for field in ("poses", "pose_covariances", "innovations", "nis", "landmarks", "landmark_covariances"):
        np.testing.assert_allclose(getattr(a, field), getattr(b, field), atol=tolerance, rtol=tolerance, err_msg=field)
    assert np.array_equal(a.accepted, b.accepted)


@all_filters
def test_numba_functions_of_a_user_plug_in(name: str) -> None:
    class Mine(PlainSensor):
        params = np.empty(0)
        functions = SensorFunctions(*[numba.njit(f.function) for f in _inlined()])

    built_in = make(name, sensor="relative")
    mine = make(name, sensor=Mine(built_in.sensor))
    assert mine._models.compiled
    log = drive(built_in.motion, built_in.sensor)
    np.testing.assert_allclose(built_in.run(log).poses, mine.run(log).poses, atol=10 * ROUNDING[name])


def test_numba_functions_may_be_compiled_for_arrays_already() -> None:
    """With explicit signatures Numba compiles them once, for its own arrays, and refuses any others."""
    v, m = numba.float64[::1], numba.float64[:, ::1]
    kinds = {"vector": v, "matrix": m, "void": numba.void}

    class Mine(PlainSensor):
        params = np.empty(0)
        functions = SensorFunctions(*[numba.njit(eval(f.signature, kinds))(f.function) for f in _inlined()])

    built_in = make("ekf", sensor="relative")
    mine = make("ekf", sensor=Mine(built_in.sensor))
    log = drive(built_in.motion, built_in.sensor)
    np.testing.assert_allclose(built_in.run(log).poses, mine.run(log).poses, atol=10 * ROUNDING["ekf"])


def _inlined() -> Any:
    """The relative-position functions need nothing from elsewhere, so they stand for a user's own."""
    from slamkit.models import RelativePosition

    return RelativePosition.functions


@all_filters
@every_order
@every_sensor
def test_covariance_stays_symmetric_and_positive_definite(name: str, order: str, sensor: str) -> None:
    f = make(name, sensor=sensor, order=order)
    f.run(drive(f.motion, f.sensor, steps=600, landmarks=12))
    P = f.P
    assert np.array_equal(P, P.T)
    assert np.linalg.eigvalsh(P)[0] > 0
    np.testing.assert_allclose(f.pose_covariance, P[:3, :3], rtol=1e-12)
    np.testing.assert_allclose(f.pose, f.x[:3])


@every_filter
def test_prediction_touches_the_pose_only(name: str) -> None:
    f = grown(name)
    x, P = f.x, f.P
    f.predict(control_for(f.motion, np.random.default_rng(2)), 0.3)
    assert np.array_equal(f.x[3:], x[3:])
    assert np.array_equal(f.P[3:, 3:], P[3:, 3:])
    np.testing.assert_allclose(f.P, f.F @ P @ f.F.T + f.Q, atol=ROUNDING[name])


@all_filters
def test_marginals_are_blocks_of_the_whole(name: str) -> None:
    f = grown(name)
    ids = [f.landmark_ids[4], f.landmark_ids[1]]
    at = [*range(3), 11, 12, 5, 6]
    mean, covariance = f.marginal(ids, pose=True)
    assert np.array_equal(mean, f.x[at])
    assert np.array_equal(covariance, f.P[np.ix_(at, at)])
    assert np.array_equal(f.marginal(ids)[1], covariance[3:, 3:])
    with pytest.raises(InputError, match="no landmark 'nobody'"):
        f.marginal(["nobody"])


@every_filter
def test_removal_marginalises(name: str) -> None:
    f = grown(name)
    x, P, gone = f.x, f.P, f.landmark_ids[2]
    keep = np.r_[0:7, 9 : len(x)]
    f.remove(gone)
    assert gone not in f.landmarks
    assert np.array_equal(f.x, x[keep])
    assert np.array_equal(f.P, P[np.ix_(keep, keep)])
    log = drive(f.motion, f.sensor, seed=9)
    f.run(log)
    assert gone in f.landmarks
    assert np.linalg.eigvalsh(f.P)[0] > 0
    with pytest.raises(InputError, match="no landmark"):
        f.remove("nobody")


@all_filters
@every_order
def test_copies_and_files_continue_bit_for_bit(name: str, order: str, tmp_path: Path) -> None:
    f = grown(name, order=order)
    path = tmp_path / "filter.npz"
    f.save(path)
    copies = [copy.deepcopy(f), pickle.loads(pickle.dumps(f)), type(f).load(path)]
    later = drive(f.motion, f.sensor, seed=3)
    if name == "ideal":
        for filter_ in (f, *copies):
            filter_.truth, filter_.time = later.truth, 0.0
    for other in copies:
        assert same(f, other)
        assert repr(f) == repr(other)
    expected = f.run(later)
    for other in copies:
        got = other.run(later)
        assert same(f, other)
        assert np.array_equal(expected.poses, got.poses)
        assert np.array_equal(expected.nis, got.nis, equal_nan=True)


@every_filter
def test_a_copy_is_independent(name: str) -> None:
    f = grown(name)
    other, P = copy.deepcopy(f), f.P
    other.predict((1.0, 0.1), 0.5)
    other.remove(other.landmark_ids[0])
    assert np.array_equal(f.P, P)


def test_files_that_are_not_filters(tmp_path: Path) -> None:
    f, path = grown("ekf"), tmp_path / "f.npz"
    f.save(path)
    whole = path.read_bytes()
    for cut in (0, 10, len(whole) // 2, len(whole) - 5):
        path.write_bytes(whole[:cut])
        with pytest.raises(SlamkitError, match=r"f\.npz"):
            type(f).load(path)
    with pytest.raises(SlamkitError, match=r"absent\.npz"):
        type(f).load(tmp_path / "absent.npz")


@every_filter
def test_filterpys_update_for_a_compass_and_a_gps(name: str) -> None:
    f = grown(name)
    dense = filterpy.kalman.ExtendedKalmanFilter(f.dim_x, 1)
    dense.x, dense.P = f.x.copy(), f.P.copy()

    def compass_jacobian(x: Any) -> Any:
        H = np.zeros((1, len(x)))
        H[0, 2] = 1.0
        return H

    def heading(x: Any) -> Any:
        return x[2:3]

    def turn(a: Any, b: Any) -> Any:
        return wrap(a - b)

    z, R = np.array([f.pose[2] + 0.05]), np.array([[1e-3]])
    extra_sensor(f, z, heading, compass_jacobian, R=R, residual=turn)
    dense.update(z, compass_jacobian, heading, R=R, residual=turn)
    # A compass is linear, so every filter agrees with the dense update; the invariant one moves the mean along a curve.
    unscented = isinstance(f, filterpy.kalman.UnscentedKalmanFilter)
    tolerance = 1e-6 if unscented else 1e-12
    assert f.mahalanobis == pytest.approx(dense.mahalanobis, rel=1e-6)
    if name != "invariant":
        np.testing.assert_allclose(f.x, dense.x, atol=tolerance)
        np.testing.assert_allclose(f.P, dense.P, atol=tolerance)
        np.testing.assert_allclose(f.K, dense.K, atol=tolerance)

    def gps_jacobian(x: Any) -> Any:
        H = np.zeros((2, len(x)))
        H[:, :2] = np.eye(2)
        H[:, 2] = 0.4 * np.array([-np.sin(x[2]), np.cos(x[2])])
        return H

    def antenna(x: Any) -> Any:
        return x[:2] + 0.4 * np.array([np.cos(x[2]), np.sin(x[2])])

    before = np.diag(f.P)[:2]
    fix = antenna(f.x) + 0.01
    extra_sensor(f, fix, antenna, gps_jacobian, R=1e-4)
    assert np.all(np.diag(f.P)[:2] < before)
    np.testing.assert_allclose(antenna(f.x), fix, atol=0.02)
    assert np.linalg.eigvalsh(f.P)[0] > 0
    for bad in (np.nan, [1.0, np.nan], [1.0, 2.0, 3.0]):
        P = f.P
        with pytest.raises((InputError, ValueError)):
            extra_sensor(f, bad, antenna, gps_jacobian, R=1e-4)
        assert np.array_equal(f.P, P)


def test_filterpys_arguments_for_an_extra_sensor() -> None:
    """args and hx_args reach the two functions, a lone argument without a tuple too; None measures nothing."""
    f = grown("ekf")
    P = f.P
    f.update(None, None, None)
    assert np.array_equal(f.P, P)
    f.update(
        1.0, lambda x, k: k * np.eye(1, len(x)), lambda x, k: k * x[:1], R=0.1, args=2.0, hx_args=(2.0,)
    )  # fmt: skip
    assert f.S[0, 0] == pytest.approx(4 * P[0, 0] + 0.1)


@all_filters
def test_predict_update_is_refused(name: str) -> None:
    with pytest.raises(TypeError, match=r"predict\(u, dt\).*update"):
        make(name).predict_update(0, None, None)


@every_filter
def test_x_and_P_are_assigned_not_poked(name: str) -> None:  # noqa: N802
    f = grown(name)
    with pytest.raises(ValueError, match="read-only"):
        f.P[0, 0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        f.x[0] = 1.0
    doubled = 2 * f.P
    f.P = doubled
    np.testing.assert_allclose(f.P, doubled, rtol=1e-14)
    moved = f.x + 0.1
    f.x = moved
    np.testing.assert_allclose(f.x, moved)
    for bad in (-doubled, doubled[:3], doubled * np.nan, np.triu(doubled)):
        with pytest.raises(InputError):
            f.P = bad
        np.testing.assert_allclose(f.P, doubled, rtol=1e-14)


@every_filter
def test_every_attribute_of_filterpys_filter_is_there(name: str) -> None:
    """Fails loudly when filterpy gains or renames an attribute that its users, or its own methods, may read."""
    kind = ALL[name]
    base = next(b for b in kind.__mro__ if b.__module__.startswith("filterpy"))
    assert base in (filterpy.kalman.ExtendedKalmanFilter, filterpy.kalman.UnscentedKalmanFilter)
    plain = filterpy.kalman.ExtendedKalmanFilter(3, 2)
    f = grown(name, snapshots=True)
    f.predict((1.0, 0.1), 0.5)
    f.observe(f.landmark_ids[0], f.sensor.predict(f.pose, f.landmarks[f.landmark_ids[0]]))
    private = {"_log_likelihood", "_likelihood", "_mahalanobis"}  # the properties that read them are overridden
    assert {n for n in vars(plain) if n.startswith("_")} == private | {"_I"}
    for attribute in set(vars(plain)) - private:
        assert hasattr(f, attribute), attribute
    assert f._I.shape == f.P.shape


@every_filter
def test_priors_and_posteriors_are_opt_in(name: str) -> None:
    with pytest.raises(SlamkitError, match="snapshots=True"):
        _ = grown(name).x_prior
    f = make(name, snapshots=True)
    f.step((1.0, 0.1), 0.5, {1: (2.0, 0.1)})
    f.step((1.0, 0.1), 0.5, {1: (1.6, 0.1)})
    assert np.trace(f.P_prior) > np.trace(f.P_post)
    assert np.array_equal(f.x_post, f.x)
    g = make(name)
    g.step((1.0, 0.1), 0.5, {1: (2.0, 0.1)})
    g.step((1.0, 0.1), 0.5, {1: (1.6, 0.1)})
    np.testing.assert_allclose(f.P, g.P, atol=1e-14)


@all_filters
def test_a_refused_step_leaves_priors_and_posteriors(name: str) -> None:
    f = make(name, snapshots=True)
    log = drive(f.motion, f.sensor)
    if name == "ideal":
        f = make(name, snapshots=True, truth=log.truth)
    steps = [step for step in log if step.dt and len(step.scan.ids)]
    for step in steps[:3]:
        f.step(step.u, step.dt, step.scan)
    before, twin = (f.x_prior, f.P_prior, f.x_post, f.P_post), copy.deepcopy(f)
    with pytest.raises(InputError):
        f.step(steps[3].u, steps[3].dt, {steps[3].scan.ids[0]: (np.nan, 0.0)})
    for a, b in zip(before, (f.x_prior, f.P_prior, f.x_post, f.P_post), strict=True):
        assert np.array_equal(a, b)
    for h in (f, twin):
        h.step(steps[3].u, steps[3].dt, steps[3].scan)
    assert same(f, twin)


@every_filter
@every_order
@pytest.mark.parametrize("outliers", [(2,), (1, 2), (2, 3), (1, 3)])
def test_a_scan_with_outliers_is_the_scan_without_them(name: str, order: str, outliers: tuple[int, ...]) -> None:
    f = make(name, order=order, gate=20.0)
    places = {1: (4.0, 0.0), 2: (3.0, 1.0), 3: (5.0, -1.0)}
    f.observe_scan(places)
    other = copy.deepcopy(f)
    seen = {i: (9.0, 0.5) if i in outliers else z for i, z in places.items()}
    history = f.run(Log([0.0], [(0.0, 0.0)], [1.0, 1.0, 1.0], [0, 1, 2], list(seen.values()), (1, 2, 3)))
    assert history.accepted.tolist() == [i not in outliers for i in places]
    assert history.rejected == len(outliers)
    assert all(history.nis[i - 1] > 20 for i in outliers)
    other.step((0.0, 0.0), 1.0, {i: z for i, z in places.items() if i not in outliers})
    np.testing.assert_allclose(f.x, other.x, atol=1e-14)
    np.testing.assert_allclose(f.P, other.P, atol=1e-14)


@every_filter
@every_order
def test_a_gate_can_be_set_later(name: str, order: str) -> None:
    late, early = make(name, order=order), make(name, order=order, gate=20.0)
    places = {1: (4.0, 0.0), 2: (3.0, 1.0), 3: (5.0, -1.0)}
    for f in (late, early):
        f.observe_scan(places)
    late.gate = 20.0
    for bad in (-1.0, 0.0, np.nan):
        with pytest.raises(InputError, match="gate is"):
            late.gate = bad
    assert late.gate == 20.0
    copies = [copy.deepcopy(late), pickle.loads(pickle.dumps(late))]
    for f in (late, early, *copies):
        f.step((0.0, 0.0), 1.0, {**places, 2: (9.0, 0.5)})
    assert all(same(f, early) for f in (late, *copies))
    late.gate = None
    x = late.x
    late.observe(2, (9.0, 0.5))
    assert np.abs(late.x - x).max() > 1e-3


@every_filter
@every_order
@every_sensor
def test_a_refused_sighting_has_a_gain_of_zero(name: str, order: str, sensor: str) -> None:
    """y and S are its own, however many sightings the update before it had; nothing was learnt."""
    f = make(name, sensor=sensor, order=order, gate=25.0)
    f.run(drive(f.motion, f.sensor))
    first, second = f.landmark_ids[:2]
    z = {i: f.sensor.predict(f.pose, f.landmarks[i]) for i in (first, second)}
    x, P = f.x, f.P
    far = {i: z[i] + 5.0 for i in z}
    f.observe(first, far[first])
    Hp, Hl = f.sensor.jacobians(f.pose, f.landmarks[first])
    assert f.K.shape == (len(x), 2) and not np.any(f.K)
    # The mean over sigma points is not the measurement of the mean.
    np.testing.assert_allclose(f.y, f.sensor.residual(far[first], z[first]), atol=0.1 if "ukf" in name else 1e-6)
    assert np.array_equal(f.z, far[first])
    if name in ("ekf", "iterated"):
        H = np.hstack([Hp, Hl])
        np.testing.assert_allclose(f.S, H @ f.marginal([first], pose=True)[1] @ H.T + f.R, rtol=1e-9)
    assert f.mahalanobis**2 == pytest.approx(f.y @ np.linalg.solve(f.S, f.y), rel=1e-9)
    assert f.mahalanobis**2 > 25.0
    f.observe_scan(far)
    rows = 4 if order == "batch" else 2
    assert f.K.shape == (len(x), rows) and not np.any(f.K)
    assert f.mahalanobis**2 == pytest.approx(f.y @ np.linalg.solve(f.S, f.y), rel=1e-9)
    assert np.array_equal(f.x, x)
    assert np.array_equal(f.P, P)
    f.observe(first, z[first])
    assert np.any(f.K) and np.trace(f.P) < np.trace(P)


@every_filter
def test_ids_may_be_anything_hashable(name: str) -> None:
    f = make(name)
    ids = [7, "seven", (7, "a"), 7.5, None, frozenset({1})]
    for n, i in enumerate(ids):
        f.observe(i, (3.0 + n, 0.1 * n))
    assert list(f.landmarks) == ids
    assert list(f.landmark_ids) == ids
    with pytest.raises(InputError, match="hashable"):
        f.observe([1], (3.0, 0.1))


@all_filters
def test_progress_is_told(name: str) -> None:
    f, told = make(name), []
    log = drive(f.motion, f.sensor, steps=700)
    f.run(log, progress=lambda done, total: told.append((done, total)))
    assert told[-1] == (len(log), len(log))
    assert [d for d, _ in told] == sorted(d for d, _ in told)


# -- bad input: a clear error, an untouched belief

bad_numbers = st.sampled_from([np.nan, np.inf, -np.inf])
shapes = st.sampled_from([(), (1,), (3,), (4,), (2, 2), (0,)])


FAMILY = {name: grown(name) for name in FILTERS}


@every_filter
@given(bad=bad_numbers, at=st.integers(0, 1))
def test_controls_that_are_not_finite(name: str, bad: float, at: int) -> None:
    f, u = FAMILY[name], [1.0, 0.2]
    u[at] = bad
    untouched(f, lambda: f.predict(u, 0.1))
    untouched(f, lambda: f.step(u, 0.1, {}))
    untouched(f, lambda: f.step(u, 0.1, {f.landmark_ids[0]: (2.0, 0.1)}))


@every_filter
@given(shape=shapes)
def test_wrong_shapes(name: str, shape: tuple[int, ...]) -> None:
    f, value = FAMILY[name], np.ones(shape)
    untouched(f, lambda: f.predict(value, 0.1))
    untouched(f, lambda: f.observe(f.landmark_ids[0], value))
    untouched(f, lambda: f.observe("new", value))
    untouched(f, lambda: f.step((1.0, 0.0), 0.1, {"new": value, f.landmark_ids[0]: value}))
    untouched(f, lambda: f.step((1.0, 0.0), 0.1, value))
    untouched(f, lambda: setattr(f, "x", value))
    untouched(f, lambda: setattr(f, "P", value))


@every_filter
@given(dt=st.one_of(st.floats(max_value=0.0), bad_numbers, st.sampled_from([None, "x", (1, 2)])))
def test_durations_that_are_not_positive(name: str, dt: Any) -> None:
    f = FAMILY[name]
    untouched(f, lambda: f.predict((1.0, 0.0), dt))
    untouched(f, lambda: f.step((1.0, 0.0), dt, {f.landmark_ids[0]: (2.0, 0.1)}))


@every_filter
@given(
    bad=st.one_of(st.floats(max_value=-1e-300), bad_numbers),
    place=st.integers(0, 2),
    bearing=st.floats(-10, 10),
    known=st.booleans(),
)
def test_measurements_that_cannot_be(name: str, bad: float, place: int, bearing: float, known: bool) -> None:
    f = FAMILY[name]
    ids = list(f.landmark_ids[:3])
    if not known:
        ids[place] = "new"
    z = np.array([[2.0, bearing]] * 3)
    z[place, 0] = bad
    untouched(f, lambda: f.step((1.0, 0.0), 0.1, Scan(ids, z)))
    untouched(f, lambda: f.observe(ids[place], z[place]))


@every_filter
@given(z=arrays(float, (2, 2), elements=st.floats(0.1, 5)))
def test_an_id_twice_in_a_scan(name: str, z: Any) -> None:
    f = FAMILY[name]
    untouched(f, lambda: f.step((1.0, 0.0), 0.1, Scan(["new", "new"], z)))
    untouched(f, lambda: f.observe_scan(Scan([f.landmark_ids[0]] * 2, z)))


@every_filter
def test_a_landmark_on_the_robot(name: str) -> None:
    f = copy.deepcopy(FAMILY[name])
    x = f.x.copy()
    x[3:5] = x[:2] + 1e-8
    f.x = x
    untouched(f, lambda: f.observe(f.landmark_ids[0], (0.5, 0.0)))
    untouched(f, lambda: f.observe("new", (0.0, 0.0)))


@every_filter
def test_constructor_arguments(name: str) -> None:
    kind, m, s = FILTERS[name], MOTIONS["unicycle"], SENSORS["range-bearing"]
    for P in (-np.eye(3), np.eye(2), np.full((3, 3), np.nan), np.array([[1, 2, 0], [0, 1, 0], [0, 0, 1.0]]), "x"):
        with pytest.raises(InputError, match="pose_covariance"):
            kind(m, s, pose_covariance=P)
    for pose in ((0, 0), (0, 0, np.nan), "abc", None):
        with pytest.raises(InputError, match="pose"):
            kind(m, s, pose=pose)
    for options in ({"order": "random"}, {"gate": -1.0}, {"gate": np.nan}):
        with pytest.raises(InputError, match=next(iter(options))):
            kind(m, s, **options)
    with pytest.raises(ModelError, match="move"):
        kind(s, s)
    with pytest.raises(ModelError, match="predict"):
        kind(m, m)

    class BadR(PlainSensor):
        R = np.array([[1.0, 0.0], [0.0, -1.0]])

    with pytest.raises(InputError, match="R"):
        kind(m, BadR(s))


@every_filter
def test_a_model_that_raises_leaves_the_belief(name: str) -> None:
    class Shy(PlainSensor):
        patience = np.inf

        def predict(self, pose: Any, landmark: Any) -> Any:
            self.patience -= 1
            if self.patience < 0:
                raise RuntimeError("the model had enough")
            return super().predict(pose, landmark)

    f = make(name, sensor=Shy(SENSORS["range-bearing"]))
    for i in range(4):
        f.observe(i, (3.0, 0.5 * i))
    f.step((1.0, 0.1), 0.1, {0: (3.0, 0.0)})
    f.sensor.patience = 6  # the check of the scan asks four times, the first update at least once
    x, P = f.x, f.P
    with pytest.raises(RuntimeError, match="had enough"):
        f.step((1.0, 0.1), 0.1, {i: (3.0, 0.5 * i) for i in range(4)})
    assert np.array_equal(f.x, x)
    assert np.array_equal(f.P, P)


@every_filter
def test_a_model_that_returns_a_wrong_shape(name: str) -> None:
    class Flat(PlainMotion):
        def control_noise(self, u: Any, dt: float) -> Any:
            return np.eye(3)

    f = make(name, motion=Flat(MOTIONS["unicycle"]))
    x = f.x
    with pytest.raises(ModelError, match=r"Flat\.control_noise gave shape \(3, 3\), expected \(2, 2\)"):
        f.predict((1.0, 0.0), 0.1)
    assert np.array_equal(f.x, x)


@every_filter
def test_a_run_that_fails_keeps_what_was_recorded(name: str) -> None:
    f = make(name)
    log = drive(f.motion, f.sensor)
    z = log.observations.copy()
    row = int(log.schedule.first[20])
    z[row, 0] = -1.0
    bad = Log(log.control_times, log.controls, log.observation_times, log.observation_ids, z, log.landmark_ids)
    with pytest.raises(InputError, match=r"range is -1\.0 m.* at time 8\.") as caught:
        f.run(bad)
    history = caught.value.history  # type: ignore[attr-defined]
    assert len(history.times) == 20
    assert np.array_equal(f.pose, history.poses[-1])
    with pytest.raises(InputError, match="columns"):
        f.run(Log([0.0], [(1.0, 0.0)], [1.0], [0], [(1.0, 0.0, 0.0)], (1,)))
    with pytest.raises(InputError, match="u has shape"):
        f.run(Log([0.0], [(1.0, 0.0, 0.0)], [1.0], [0], [(1.0, 0.0)], (1,)))
    with pytest.raises(InputError, match=r"expected a slamkit\.Log"):
        f.run([1, 2, 3])


def test_a_scan_on_an_exactly_known_pose_needs_no_jitter() -> None:
    f = FILTERS["ekf"](Unicycle(0, 0), RangeBearing(0.1, 0.02))
    f.step((1.0, 0.0), 1.0, {1: (2.0, 0.1)})
    f.step((1.0, 0.0), 1.0, {1: (1.05, 0.2)})
    assert np.array_equal(f.pose_covariance, np.zeros((3, 3)))
    assert np.isfinite(f.mahalanobis)


def test_the_ideal_filters_clock_is_at_the_last_good_step() -> None:
    """After a run that failed or was interrupted, too: from there it goes on."""
    f, g = make("ideal"), make("ideal")
    log = drive(f.motion, f.sensor)
    g.run(log)
    z = log.observations.copy()
    z[int(log.schedule.first[20]), 0] = -1.0
    facts = log.control_times, log.controls, log.observation_times, log.observation_ids
    with pytest.raises(InputError) as caught:
        f.run(Log(*facts, z, log.landmark_ids, truth=log.truth))
    assert f.time == caught.value.history.times[-1] == log.schedule.times[19]  # type: ignore[attr-defined]
    for step in list(log)[20:]:
        f.step(step.u, step.dt, step.scan)
    assert same(f, g)

    def interrupt(done: int, total: int) -> None:
        raise KeyboardInterrupt

    f = make("ideal")
    with pytest.raises(KeyboardInterrupt) as stopped:
        f.run(log, interrupt)
    assert f.time == stopped.value.history.times[-1] < log.schedule.times[-1]  # type: ignore[attr-defined]


def test_the_ideal_filter_refuses_without_the_truth() -> None:
    f = make("ideal")
    log = drive(f.motion, f.sensor)
    bare = Log(
        log.control_times, log.controls, log.observation_times, log.observation_ids, log.observations, log.landmark_ids
    )
    for act in (lambda: f.run(bare), lambda: f.predict((1.0, 0.0), 0.1), lambda: f.observe(1, (2.0, 0.0))):
        with pytest.raises(InputError, match="truth"):
            act()
    f.run(log)
    with pytest.raises(InputError, match="no landmark 'new'"):
        f.observe("new", (2.0, 0.0))
    with pytest.raises(InputError, match="no pose at"):
        f.predict((1.0, 0.0), 0.123)
