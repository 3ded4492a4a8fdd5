"""The standard EKF against the worked demo, filterpy's dense filter and itself."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from family import MOTIONS, ORDERS, P0, SENSORS, drive
from filterpy.kalman import ExtendedKalmanFilter

from slamkit import EKFSLAM
from slamkit.models import RangeBearing, Unicycle
from slamkit.se2 import wrap

LESSON = Path(__file__).parents[1] / "lesson_demo.json"


def lesson_filter(lesson: dict[str, Any]) -> EKFSLAM:
    motion = Unicycle(0.0, 0.0, pose_noise=lesson["Q"])
    r, b = np.sqrt(np.diag(lesson["R"]))
    return EKFSLAM(motion, RangeBearing(r, b), pose_covariance=lesson["P0"])


@pytest.fixture(scope="module")
def lesson() -> dict[str, Any]:
    return json.loads(LESSON.read_text())


def test_lesson_demo(lesson: dict[str, Any]) -> None:
    f = lesson_filter(lesson)
    for step in lesson["steps"]:
        *u, dt = step["u"]
        f.step(u, dt, {i: (r, b) for i, r, b in step["scan"]})
        np.testing.assert_allclose(f.x, step["mean"], atol=1e-9, rtol=0)
        np.testing.assert_allclose(f.pose_covariance, step["pose_cov"], atol=1e-9, rtol=0)
    np.testing.assert_allclose(f.P, lesson["final_cov"], atol=1e-9, rtol=0)


def test_lesson_single_step(lesson: dict[str, Any]) -> None:
    f, single = lesson_filter(lesson), lesson["single_step"]
    *u, dt = single["u"]
    f.step(u, dt, {i: (r, b) for i, r, b in single["scan"]})
    np.testing.assert_allclose(f.x, single["mean"], atol=1e-9, rtol=0)
    np.testing.assert_allclose(f.P, single["cov"], atol=1e-9, rtol=0)


def test_lesson_single_update(lesson: dict[str, Any]) -> None:
    single = lesson["single_update"]
    x = np.array(single["jacobian_at"], dtype=float)
    r, b = np.sqrt(np.diag(lesson["R"]))
    H = np.hstack(RangeBearing(r, b).jacobians(x[:3], x[3:]))
    np.testing.assert_allclose(H, single["jacobian"], atol=1e-9, rtol=0)
    f = EKFSLAM(Unicycle(0, 0), RangeBearing(r, b), pose=single["mean0"][:3])
    f.observe("m", f.sensor.predict(np.array(single["mean0"][:3]), np.array(single["mean0"][3:])))
    f.x, f.P = single["mean0"], single["cov0"]
    f.observe("m", single["z"])
    np.testing.assert_allclose(f.x, single["mean"], atol=1e-9, rtol=0)
    np.testing.assert_allclose(f.P, single["cov"], atol=1e-9, rtol=0)


class DenseEKF:
    """EKF-SLAM with filterpy's own update and dense matrices throughout: the reference, not a design."""

    def __init__(self, motion: Any, sensor: Any, pose: Any, P: Any, *, batch: bool) -> None:
        self.motion, self.sensor, self.batch = motion, sensor, batch
        self.slots: dict[Any, int] = {}
        self.f = ExtendedKalmanFilter(3, len(sensor.R))
        self.resize(np.array(pose, dtype=float), np.array(P, dtype=float))

    def resize(self, x: Any, P: Any) -> None:
        self.f.x, self.f.P, self.f.dim_x, self.f._I = x, P, len(x), np.eye(len(x))

    def predict(self, u: Any, dt: float) -> None:
        x, D = self.f.x.copy(), self.f.dim_x
        F, G = self.motion.jacobians(x[:3], u, dt)
        Fd, Qd = np.eye(D), np.zeros((D, D))
        Fd[:3, :3] = F
        Qd[:3, :3] = G @ self.motion.control_noise(u, dt) @ G.T + self.motion.pose_noise(x[:3], u, dt)
        x[:3] = self.motion.move(x[:3], u, dt)
        self.f.x, self.f.P = x, Fd @ self.f.P @ Fd.T + Qd

    def update(self, ids: list[Any], z: Any) -> None:
        k, n = len(self.sensor.R), len(ids)

        def h(x: Any) -> Any:
            return np.concatenate([self.sensor.predict(x[:3], x[self.slots[i] : self.slots[i] + 2]) for i in ids])

        def jacobian(x: Any) -> Any:
            H = np.zeros((n * k, len(x)))
            for j, i in enumerate(ids):
                s = self.slots[i]
                rows = slice(j * k, (j + 1) * k)
                H[rows, :3], H[rows, s : s + 2] = self.sensor.jacobians(x[:3], x[s : s + 2])
            return H

        def residual(a: Any, b: Any) -> Any:
            pairs = zip(a.reshape(n, k), b.reshape(n, k), strict=True)
            return np.concatenate([self.sensor.residual(*p) for p in pairs])

        self.f.update(np.ravel(z), jacobian, h, R=np.kron(np.eye(n), self.sensor.R), residual=residual)
        self.f.x[2] = wrap(self.f.x[2])

    def augment(self, i: Any, z: Any) -> None:
        x, P = self.f.x, self.f.P
        Gx, Gz = self.sensor.inverse_jacobians(x[:3], z)
        cross = Gx @ P[:3]
        block = Gx @ P[:3, :3] @ Gx.T + Gz @ self.sensor.R @ Gz.T
        self.slots[i] = len(x)
        self.resize(np.append(x, self.sensor.invert(x[:3], z)), np.block([[P, cross.T], [cross, block]]))

    def take(self, scan: Any) -> None:
        pairs = list(zip(scan.ids, scan.z, strict=True))
        known = [p for p in pairs if p[0] in self.slots]
        if self.batch:
            if known:
                self.update([i for i, _ in known], np.array([z for _, z in known]))
            for i, z in pairs:
                if i not in self.slots:
                    self.augment(i, z)
        else:
            for i, z in pairs:
                if i in self.slots:
                    self.update([i], z)
                else:
                    self.augment(i, z)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("sensor", SENSORS)
@pytest.mark.parametrize("motion", MOTIONS)
def test_equals_filterpys_dense_update(motion: str, sensor: str, order: str) -> None:
    m, s = MOTIONS[motion], SENSORS[sensor]
    log = drive(m, s)
    pose = (0.3, -0.2, 3.0)
    sparse = EKFSLAM(m, s, pose, P0, order)
    dense = DenseEKF(m, s, pose, P0, batch=order == "batch")
    for step in log:
        if step.dt:
            sparse.predict(step.u, step.dt)
            dense.predict(step.u, step.dt)
        sparse.observe_scan(step.scan)
        dense.take(step.scan)
        np.testing.assert_allclose(sparse.x, dense.f.x, atol=1e-12, rtol=1e-12)
        np.testing.assert_allclose(sparse.P, dense.f.P, atol=1e-12, rtol=1e-12)
    for name in ("y", "S", "SI", "K", "z"):
        np.testing.assert_allclose(getattr(sparse, name), getattr(dense.f, name), atol=1e-10, rtol=1e-10, err_msg=name)
    for name in ("log_likelihood", "likelihood", "mahalanobis"):
        assert getattr(sparse, name) == pytest.approx(getattr(dense.f, name), rel=1e-9)
    assert sparse.dim_x == 3 + 2 * len(log.landmark_ids)


def test_the_listings_defect_is_absent() -> None:
    """P stays symmetric and positive definite through 50 initialisations and 10,000 updates."""
    rng = np.random.default_rng(5)
    sensor, motion = RangeBearing(0.1, 0.03), Unicycle(0.1, 0.05)
    f = EKFSLAM(motion, sensor, pose_covariance=P0)
    positions = rng.uniform(-20, 20, (50, 2))
    for i, p in enumerate(positions):
        f.observe(i, sensor.predict(np.zeros(3), p) + rng.normal(size=2) * [0.1, 0.03])
        P = f.P
        assert np.array_equal(P, P.T)
        assert np.linalg.eigvalsh(P)[0] > 0
    pose, u = np.zeros(3), np.array([1.0, 0.2])
    for k in range(2000):
        pose = motion.move(pose, u + rng.normal(size=2) * [0.1, 0.05], 0.1)
        seen = rng.choice(50, 5, replace=False)
        z = {int(i): sensor.predict(pose, positions[i]) + rng.normal(size=2) * [0.1, 0.03] for i in seen}
        f.step(u, 0.1, z)
        if k % 100 == 99:
            P = f.P
            assert np.array_equal(P, P.T)
            assert np.linalg.eigvalsh(P)[0] > 0
