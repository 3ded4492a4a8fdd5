"""Where everything is linear, every filter is the Kalman filter."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from family import ALL, ORDERS
from filterpy.kalman import KalmanFilter

from slamkit import Scan, Truth
from slamkit.models import RelativePosition, Unicycle
from slamkit.se2 import rotation


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("name", ALL)
def test_with_a_known_heading_every_filter_is_the_kalman_filter(name: str, order: str) -> None:
    """The heading is known exactly and kept, so positions are linear in all that is uncertain."""
    rng, theta, dt, N = np.random.default_rng(11), 0.7, 0.5, 4
    motion, sensor = Unicycle(0.2, 0.0, pose_noise=np.diag([1e-3, 2e-3, 0.0])), RelativePosition(0.1)
    places, pose = rng.uniform(-5, 5, (N, 2)), np.array([0.5, -0.5, theta])
    P0 = np.diag([0.04, 0.02, 0.0])
    steps = 60
    C, heading = rotation(theta), np.array([np.cos(theta), np.sin(theta)])
    path = pose[:2] + np.outer(np.arange(steps + 1) * dt * 0.3, heading)
    truth = Truth(
        np.arange(steps + 1) * dt,
        np.column_stack([path, np.full(steps + 1, theta)]),
        dict(enumerate(places)),
    )
    options: dict[str, Any] = {"truth": truth} if name == "ideal" else {}
    f = ALL[name](motion, sensor, pose, P0, order, **options)

    # The first scan starts every landmark; from there on the state has its full length.
    first = np.array([C.T @ (p - path[0]) for p in places]) + 0.1 * rng.normal(size=(N, 2))
    f.observe_scan(Scan(list(range(N)), first))
    D = 2 + 2 * N
    plain = KalmanFilter(D, 2 * N)
    G = np.vstack([np.eye(2)] * (N + 1))
    plain.x = np.concatenate([pose[:2], *[pose[:2] + C @ z for z in first]])
    plain.P = G @ P0[:2, :2] @ G.T
    plain.P[2:, 2:] += np.kron(np.eye(N), 0.01 * np.eye(2))
    plain.F, plain.R = np.eye(D), 0.01 * np.eye(2 * N)
    plain.Q = np.zeros((D, D))
    plain.Q[:2, :2] = (0.2 * dt) ** 2 * np.outer(heading, heading) + np.diag([1e-3, 2e-3])
    plain.B, plain.H = np.zeros((D, 1)), np.hstack([np.vstack([-C.T] * N), np.kron(np.eye(N), C.T)])
    plain.B[:2, 0] = dt * heading

    at = np.r_[0:2, 3 : 3 + 2 * N]
    for k in range(steps):
        z = np.array([C.T @ (p - path[k + 1]) for p in places]) + 0.1 * rng.normal(size=(N, 2))
        f.step((0.3, 0.0), dt, Scan(list(range(N)), z))
        plain.predict(u=np.array([0.3]))
        plain.update(z.ravel())
        np.testing.assert_allclose(f.x[at], plain.x, atol=1e-10, rtol=0)
        np.testing.assert_allclose(f.P[np.ix_(at, at)], plain.P, atol=1e-10, rtol=0)
    assert f.pose[2] == pytest.approx(theta, abs=1e-12)
