"""The robocentric filter against a dense filter in its own frame, against the EKF, and on what it is made for."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from math import pi
from typing import Any

import filterpy.kalman
import numpy as np
import pytest
from family import MOTIONS, ORDERS, P0, SENSORS, control_for, drive
from hypothesis import given, settings
from hypothesis import strategies as st

from slamkit import EKFSLAM, InputError, RobocentricEKFSLAM, simulate
from slamkit.evaluate import gauge, pose_nees
from slamkit.filters.robocentric import compose
from slamkit.models import RangeBearing, RelativePosition, Unicycle
from slamkit.se2 import wrap
from slamkit.simulate import World, loop_world, standing_world

POSE = (0.3, -0.2, 3.0)
every_order = pytest.mark.parametrize("order", ORDERS)
every_motion = pytest.mark.parametrize("motion", MOTIONS)
every_sensor = pytest.mark.parametrize("sensor", SENSORS)


def make(motion: str = "unicycle", sensor: str = "range-bearing", **options: Any) -> Any:
    return RobocentricEKFSLAM(MOTIONS[motion], SENSORS[sensor], POSE, P0, **options)


def between_frames(motion: str = "unicycle", sensor: str = "range-bearing") -> Any:
    """A filter with a map whose robot has left the frame of its last composition."""
    f = make(motion, sensor)
    f.run(drive(f.motion, f.sensor))
    rng = np.random.default_rng(4)
    for _ in range(3):
        f.predict(control_for(f.motion, rng), 0.5)
    return f


class Dense:
    """The same estimator as the paper writes it down, with full matrices whose derivatives are complex steps.

    s = (r, B, l₁ …), B the frame of the start, whose pose in the world is `start`.
    """

    def __init__(self, motion: Any, sensor: Any, start: Any, P: Any, batch: bool) -> None:
        self.motion, self.sensor, self.start, self.batch = motion, sensor, np.array(start), batch
        self.slots: dict[Any, int] = {}
        self.s, self.P = np.concatenate([self.start, self.start]), np.zeros((6, 6))
        self.P[:3, :3] = P
        self.pass_through(self.composed)

    @staticmethod
    def derivative(f: Callable[[Any], Any], x: Any) -> Any:
        return np.array([np.imag(f(x + 1e-30j * e)) / 1e-30 for e in np.eye(len(x))]).T

    @staticmethod
    def seen_from(a: Any, points: Any) -> Any:
        c, s, x, y = np.cos(a[2]), np.sin(a[2]), points[0::2] - a[0], points[1::2] - a[1]
        return np.array([c * x + s * y, c * y - s * x]).T.ravel()

    def composed(self, s: Any) -> Any:
        r, B = s[:3], s[3:6]
        moved = self.seen_from(r, B[:2]), B[2:] - r[2:], self.seen_from(r, s[6:])
        return np.concatenate([r - r, *moved])

    def world(self, s: Any) -> Any:
        turned = self.start[2] - s[5]
        c, n = np.cos(turned), np.sin(turned)
        points = np.concatenate([s[:2], s[6:]])
        x, y = points[0::2] - s[3], points[1::2] - s[4]
        out = np.array([self.start[0] + c * x - n * y, self.start[1] + n * x + c * y]).T.ravel()
        return np.concatenate([out[:2], [s[2] + turned], out[2:]])

    def moved(self, both: Any, dt: float) -> Any:
        s, u = both[:-2], both[-2:]
        half = u[1] * dt / 2
        chord = u[0] * dt * np.sin(half) / half
        step = [chord * np.cos(s[2] + half), chord * np.sin(s[2] + half), 2 * half]
        return np.concatenate([s[:3] + np.array(step), s[3:]])

    def sighting(self, s: Any, slot: int) -> Any:
        b = self.seen_from(s[:3], s[slot : slot + 2])
        if isinstance(self.sensor, RelativePosition):
            return b
        # The branch of the arc tangent has no part in its derivative.
        return np.array([np.sqrt(b[0] ** 2 + b[1] ** 2), np.arctan(b[1] / b[0])])

    def grown(self, both: Any) -> Any:
        s, z = both[:-2], both[-2:]
        b = z if isinstance(self.sensor, RelativePosition) else np.array([z[0] * np.cos(z[1]), z[0] * np.sin(z[1])])
        c, n = np.cos(s[2]), np.sin(s[2])
        return np.concatenate([s, [s[0] + c * b[0] - n * b[1], s[1] + n * b[0] + c * b[1]]])

    def pass_through(self, f: Callable[[Any], Any], x: Any = None, noise: Any = None) -> None:
        """s ← f(s), or f((s, x)) with noise on x; P through the whole Jacobian."""
        n = len(self.s)
        both = self.s if x is None else np.concatenate([self.s, x])
        A = self.derivative(f, both)
        self.s = np.real(f(both))
        self.P = A[:, :n] @ self.P @ A[:, :n].T
        if x is not None:
            self.P += A[:, n:] @ noise @ A[:, n:].T

    def correct(self, seen: Any) -> None:
        H = np.vstack([self.derivative(partial(self.sighting, slot=self.slots[i]), self.s) for i, _ in seen])
        y = []
        for i, z in seen:
            slot = self.slots[i]
            y.append(self.sensor.residual(z, self.sensor.predict(self.s[:3], self.s[slot : slot + 2])))
        R = np.kron(np.eye(len(seen)), self.sensor.R)
        K = np.linalg.solve(H @ self.P @ H.T + R, H @ self.P).T
        self.s = self.s + K @ np.concatenate(y)
        kept = np.eye(len(self.s)) - K @ H
        self.P = kept @ self.P @ kept.T + K @ R @ K.T

    def step(self, u: Any, dt: float, scan: Any) -> None:
        self.pass_through(partial(self.moved, dt=dt), u, self.motion.control_noise(u, dt))
        sightings = list(zip(scan.ids, scan.z, strict=True))
        known = [(i, z) for i, z in sightings if i in self.slots]
        if self.batch and known:
            self.correct(known)
        for i, z in sightings:
            if i not in self.slots:
                self.slots[i] = len(self.s)
                self.pass_through(self.grown, z, np.asarray(self.sensor.R))
            elif not self.batch:
                self.correct([(i, z)])
        if known:
            self.pass_through(self.composed)

    def belief(self) -> tuple[Any, Any]:
        W = self.derivative(self.world, self.s)
        x = self.world(self.s)
        x[2] = wrap(x[2])
        return x, W @ self.P @ W.T


@every_order
@every_sensor
def test_it_is_the_dense_filter(order: str, sensor: str) -> None:
    f = make(sensor=sensor, order=order)
    dense = Dense(f.motion, f.sensor, POSE, P0, order == "batch")
    log = drive(f.motion, f.sensor, steps=60)
    sizes = set()
    for step in log:
        f.step(step.u, step.dt, step.scan)
        dense.step(step.u, step.dt, step.scan)
        x, P = dense.belief()
        sizes.add(len(x))
        np.testing.assert_allclose(f.x, x, atol=1e-10)
        np.testing.assert_allclose(f.P, P, atol=1e-10)
        np.testing.assert_allclose(f.pose, x[:3], atol=1e-10)
        np.testing.assert_allclose(f.pose_covariance, P[:3, :3], atol=1e-10)
    assert len(sizes) > 1, "the map did not grow on the way"
    assert tuple(dense.slots) == f.landmark_ids


@every_order
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=20)
def test_where_everything_is_linear_it_is_the_ekf(order: str, seed: int) -> None:
    """An exactly known heading leaves nothing to linearise, and no frame is better than another."""
    motion, sensor, P = Unicycle(0.1, 0.0), RelativePosition(0.15), np.diag([0.02, 0.03, 0.0])
    a, b = (kind(motion, sensor, POSE, P, order) for kind in (RobocentricEKFSLAM, EKFSLAM))
    log = drive(motion, sensor, seed=seed)
    left, right = a.run(log), b.run(log)
    np.testing.assert_allclose(left.poses, right.poses, atol=1e-10)
    np.testing.assert_allclose(left.pose_covariances, right.pose_covariances, atol=1e-10)
    np.testing.assert_allclose(left.innovations, right.innovations, atol=1e-10)
    np.testing.assert_allclose(left.nis, right.nis, atol=1e-8)
    np.testing.assert_allclose(a.x, b.x, atol=1e-10)
    np.testing.assert_allclose(a.P, b.P, atol=1e-10)


@every_order
@pytest.mark.parametrize("sensor", [RangeBearing, RelativePosition])
def test_to_first_order_it_is_the_ekf(order: str, sensor: Any) -> None:
    """A tenth of all noise: estimates differ by a hundredth, covariances by a thousandth."""

    def differences(noise: float) -> tuple[float, float]:
        R = (0.1 * noise, 0.03 * noise) if sensor is RangeBearing else (0.1 * noise,)
        angle = 2 * pi * np.arange(6) / 6
        world = World(
            name="circle",
            landmarks=dict(enumerate(np.column_stack([4 * np.cos(angle), 3 + 4 * np.sin(angle)]))),
            motion=Unicycle(0.1 * noise, 0.05 * noise),
            sensor=sensor(*R),
            controls=np.tile([0.5, 0.2], (40, 1)),
            dt=1.0,
            pose=np.array(POSE),
            pose_covariance=P0 * noise**2,
        )
        log = simulate(world, np.random.default_rng(7))
        a, b = (
            kind(world.motion, world.sensor, world.pose, world.pose_covariance, order)
            for kind in (RobocentricEKFSLAM, EKFSLAM)
        )
        a.run(log)
        b.run(log)
        return float(np.abs(a.x - b.x).max()), float(np.abs(a.P - b.P).max())

    (x, P), (x_small, P_small) = differences(0.01), differences(0.001)
    assert x > 1e-5
    assert P > 1e-9
    assert x_small < x / 70
    assert P_small < P / 500


@every_order
@every_sensor
@given(x=st.floats(-1e3, 1e3), y=st.floats(-1e3, 1e3), theta=st.floats(-pi, pi))
@settings(max_examples=10)
def test_it_does_not_depend_on_the_worlds_frame(order: str, sensor: str, x: float, y: float, theta: float) -> None:
    motion, model = MOTIONS["unicycle"], SENSORS[sensor]
    log = drive(motion, model, steps=20)
    off = gauge.equivariance(RobocentricEKFSLAM, motion, model, log, (x, y, theta), POSE, P0, order=order)
    assert off <= 1e-9


@every_order
@pytest.mark.parametrize("degrees", [1.0, 5.0, 20.0])
def test_an_uncertain_start_says_nothing_of_the_relative_map(order: str, degrees: float) -> None:
    w = replace(loop_world(), controls=loop_world().controls[:300])
    log, P = simulate(w, np.random.default_rng(3)), np.diag([1e-4, 1e-4, np.radians(degrees) ** 2])
    assert gauge.stochastic_gauge(RobocentricEKFSLAM, w.motion, w.sensor, log, P, w.pose, order=order) <= 1e-9


@pytest.mark.parametrize("degrees", [0.5, 5.0, 20.0])
def test_a_standing_robot_learns_no_heading(degrees: float) -> None:
    w = standing_world(np.radians(degrees))
    f = RobocentricEKFSLAM(w.motion, w.sensor, w.pose, w.pose_covariance)
    f.run(simulate(w, np.random.default_rng(0)))
    assert np.degrees(np.sqrt(f.pose_covariance[2, 2])) == pytest.approx(degrees, rel=1e-9)


def test_ten_loops_leave_it_more_consistent_than_the_ekf() -> None:
    w, nees = loop_world(), {}
    logs = [simulate(w, np.random.default_rng(seed)) for seed in range(10)]
    for kind in (EKFSLAM, RobocentricEKFSLAM):
        values = []
        for log in logs:
            f = kind(w.motion, w.sensor, w.pose, w.pose_covariance)
            history = f.run(log)
            truth: Any = log.truth
            poses = truth.poses[np.searchsorted(truth.times, history.times - 1e-6)]
            values.append(np.nanmean(pose_nees(history.poses, history.pose_covariances, poses).values))
        nees[kind.name] = np.mean(values)
    assert nees["robocentric"] < 0.6 * nees["ekf"]
    assert nees["robocentric"] < 5.0


@every_motion
@every_sensor
def test_the_change_of_frame_is_the_one_that_carries_the_covariance(motion: str, sensor: str) -> None:
    f = between_frames(motion, sensor)
    before, pose, A = f._belief.covariance, f._belief.mean[:3].copy(), np.eye(f._belief.dim)
    compose(f._belief.state)
    f._change_frame(A, pose)
    np.testing.assert_allclose(A @ before @ A.T, f._belief.covariance, atol=1e-14)


@every_motion
@every_sensor
def test_composition_does_not_change_what_is_reported(motion: str, sensor: str) -> None:
    f = between_frames(motion, sensor)
    state, x, P = f._belief.state, f.x, f.P
    assert np.hypot(*state.belief.mean[:2]) > 0.1, "the robot has not left its frame"
    pose, covariance = f.pose, f.pose_covariance
    compose(state)
    D = f._belief.dim
    assert np.array_equal(state.belief.mean[:3], np.zeros(3))
    assert np.array_equal(np.tril(state.belief.cov[:D, :D])[:, :3], np.zeros((D, 3)))
    np.testing.assert_allclose(f.x, x, atol=1e-12)
    np.testing.assert_allclose(f.P, P, atol=1e-12)
    np.testing.assert_allclose(f.pose, pose, atol=1e-12)
    np.testing.assert_allclose(f.pose_covariance, covariance, atol=1e-12)


@every_motion
def test_a_prediction_is_the_ekfs(motion: str) -> None:
    """Noise along the world's axes included: F and Q are those of the world, again and again from the same frame."""
    f = between_frames(motion)
    g = EKFSLAM(f.motion, f.sensor, POSE, P0)
    g.run(drive(f.motion, f.sensor))
    g.x, g.P = f.x, f.P
    rng = np.random.default_rng(6)
    for u in [control_for(f.motion, rng) for _ in range(3)]:
        map_before = f.P[3:, 3:]
        f.predict(u, 0.3)
        g.predict(u, 0.3)
        assert np.array_equal(f.P[3:, 3:], map_before)
        for name in ("x", "P", "F", "Q"):
            np.testing.assert_allclose(getattr(f, name), getattr(g, name), atol=1e-12, err_msg=name)


@every_sensor
def test_y_S_and_K_are_those_of_the_world(sensor: str) -> None:  # noqa: N802
    f = between_frames(sensor=sensor)
    i = f.landmark_ids[2]
    x, P, slot = f.x, f.P, 7
    z = f.sensor.predict(x[:3], x[slot : slot + 2]) + 0.05
    H = np.zeros((2, len(x)))
    H[:, :3], H[:, slot : slot + 2] = f.sensor.jacobians(x[:3], x[slot : slot + 2])
    f.observe(i, z)
    S = H @ P @ H.T + f.sensor.R
    np.testing.assert_allclose(f.y, [0.05, 0.05], atol=1e-12)
    np.testing.assert_allclose(f.S, S, atol=1e-12)
    np.testing.assert_allclose(f.K, P @ H.T @ np.linalg.inv(S), atol=1e-11)
    K = f.K
    f.predict((1.0, 0.3), 0.5)
    assert np.array_equal(f.K, K)


def test_an_extra_sensor_between_frames_is_filterpys_update() -> None:
    f = between_frames()
    dense = filterpy.kalman.ExtendedKalmanFilter(f.dim_x, 2)
    dense.x, dense.P = f.x.copy(), f.P.copy()

    def jacobian(x: Any) -> Any:
        H = np.zeros((2, len(x)))
        H[:, :2], H[:, 2] = np.eye(2), 0.4 * np.array([-np.sin(x[2]), np.cos(x[2])])
        return H

    def antenna(x: Any) -> Any:
        return x[:2] + 0.4 * np.array([np.cos(x[2]), np.sin(x[2])])

    fix = antenna(f.x) + np.array([0.1, -0.05])
    f.update(fix, jacobian, antenna, R=1e-3)
    dense.update(fix, jacobian, antenna, R=np.eye(2) * 1e-3)
    for name in ("x", "P", "K", "S", "y", "z"):
        np.testing.assert_allclose(getattr(f, name), getattr(dense, name), atol=1e-12, err_msg=name)
    assert f.log_likelihood == pytest.approx(dense.log_likelihood, rel=1e-9)


def test_x_and_P_keep_each_other_between_frames() -> None:  # noqa: N802
    f = between_frames()
    x, P = f.x, f.P
    f.x = x + 0.1
    np.testing.assert_allclose(f.x, x + 0.1, atol=1e-13)
    np.testing.assert_allclose(f.P, P, atol=1e-13)
    f.P = 2 * P
    np.testing.assert_allclose(f.x, x + 0.1, atol=1e-13)
    np.testing.assert_allclose(f.P, 2 * P, atol=1e-13)


def test_reading_changes_nothing() -> None:
    a, b = make(), make()
    for step in drive(a.motion, a.sensor):
        a.predict(step.u, step.dt)
        b.predict(step.u, step.dt)
        _ = a.x, a.P, a.K, a.pose, a.pose_covariance, a.landmarks, a.marginal(a.landmark_ids, pose=True), a.F, a.Q
        _ = copy.deepcopy(a)
        a.observe_scan(step.scan)
        b.observe_scan(step.scan)
        _ = a.x, a.P, a.pose_covariance
    assert np.array_equal(a.x, b.x)
    assert np.array_equal(a.P, b.P)


def test_a_landmark_on_the_robot_is_told_with_its_distance() -> None:
    f = between_frames()
    x = f.x.copy()
    x[3:5] = x[:2] + np.array([3e-8, 4e-8])
    f.x = x
    with pytest.raises(InputError, match=r"lies 5e-08 m from the robot"):
        f.observe(f.landmark_ids[0], (0.5, 0.0))
