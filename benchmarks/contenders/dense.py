"""Filters with dense matrices in NumPy: filterpy's, and the textbook's."""

from __future__ import annotations

from collections.abc import Callable
from math import atan2, cos, hypot, pi, sin
from typing import Any, ClassVar

import numpy as np
from _workload import SIGMA_BEARING, SIGMA_OMEGA, SIGMA_RANGE, SIGMA_V, Array, IntArray, Work
from filterpy.kalman import ExtendedKalmanFilter

from contenders import ROUNDING

R = np.diag([SIGMA_RANGE**2, SIGMA_BEARING**2])
Steps = list[tuple[Array, float, list[tuple[int, Array]]]]


# -- the models of a textbook filter: plain Python on scalars, dense matrices -----------------------------------------


def move(pose: Array, u: Array, dt: float) -> tuple[list[float], Array, Array]:
    """Exact arc: new pose, ∂/∂pose (3, 3), and covariance of the noise (3, 3)."""
    (x, y, theta), (v, omega) = pose.tolist(), u.tolist()
    a = omega * dt / 2
    sinc, slope = (sin(a) / a, (cos(a) - sin(a) / a) / a) if abs(a) > 1e-4 else (1 - a * a / 6, -a / 3)
    c, s = cos(theta + a), sin(theta + a)
    dx, dy = v * dt * sinc * c, v * dt * sinc * s
    F = np.array([[1.0, 0.0, -dy], [0.0, 1.0, dx], [0.0, 0.0, 1.0]])
    h = v * dt * dt / 2
    G = np.array([[dt * sinc * c, h * (slope * c - sinc * s)], [dt * sinc * s, h * (slope * s + sinc * c)], [0.0, dt]])
    return [x + dx, y + dy, theta + omega * dt], F, (G * (SIGMA_V**2, SIGMA_OMEGA**2)) @ G.T


def predicted(x: Array, slot: int) -> Array:
    """Range and bearing."""
    dx, dy = x[slot] - x[0], x[slot + 1] - x[1]
    return np.array([hypot(dx, dy), atan2(dy, dx) - x[2]])


def jacobian(x: Array, slot: int) -> Array:
    """∂z/∂x (2, D)."""
    dx, dy = x[slot] - x[0], x[slot + 1] - x[1]
    q = dx * dx + dy * dy
    r = hypot(dx, dy)
    H = np.zeros((2, len(x)))
    H[:, :3] = (-dx / r, -dy / r, 0.0), (dy / q, -dx / q, -1.0)
    H[:, slot : slot + 2] = (dx / r, dy / r), (-dy / q, dx / q)
    return H


def residual(z: Array, z_hat: Array) -> Array:
    """The difference z - z_hat with a wrapped bearing."""
    y = z - z_hat
    y[1] = (y[1] + pi) % (2 * pi) - pi
    return y


def _steps(work: Work, begin: int, end: int) -> Steps:
    """Control, duration and sightings (slot, z) of each step."""
    return [
        (
            work.controls[k],
            float(work.dt[k]),
            [(3 + 2 * int(work.ids[m]), work.z[m]) for m in range(work.first[k], work.first[k + 1])],
        )
        for k in range(begin, end)
    ]


# -- the filters ------------------------------------------------------------------------------------------------------


class Filterpy(ExtendedKalmanFilter):
    """filterpy's ExtendedKalmanFilter, unchanged: dense F and Q for a prediction, a dense update for each sighting."""

    tolerance: ClassVar[float] = ROUNDING
    defers: ClassVar[bool] = False
    grows: ClassVar[bool] = False

    def __init__(self, work: Work) -> None:
        super().__init__(work.dim, 2)
        self.work, self.R, self.dt = work, R, 0.0

    def predict_x(self, u: Any = 0) -> None:
        """The motion model, called by filterpy from `predict`."""
        self.x[:3], self.F[:3, :3], self.Q[:3, :3] = move(self.x[:3], u, self.dt)

    def start(self) -> None:
        """Copy slamkit's map, because a state cannot grow in filterpy."""
        mapped = self.work.surveyed()
        self.x, self.P, self.F, self.Q = mapped.x.copy(), mapped.P.copy(), np.eye(self.dim_x), np.zeros_like(self.P)

    def ready(self, begin: int, end: int) -> Callable[[], object]:
        """The arguments of each call."""
        steps = _steps(self.work, begin, end)

        def go() -> None:
            for u, dt, sightings in steps:
                self.dt = dt
                self.predict(u)
                for slot, z in sightings:
                    self.update(z, jacobian, predicted, args=(slot,), hx_args=(slot,), residual=residual)

        return go

    def joint(self, at: IntArray) -> tuple[Array, Array]:
        """State and a block of P."""
        return self.x, self.P[np.ix_(at, at)]


class Textbook:
    """EKF-SLAM in NumPy as textbooks write it (Thrun, Burgard & Fox 2005, table 10.1): P = F P Fᵀ + Q, (I - K H) P."""

    tolerance: ClassVar[float] = ROUNDING
    defers: ClassVar[bool] = False
    grows: ClassVar[bool] = False

    def __init__(self, work: Work) -> None:
        self.work = work

    def start(self) -> None:
        """Copy slamkit's map: the initialisation of landmarks is not compared."""
        mapped = self.work.surveyed()
        self.x, self.P = mapped.x.copy(), mapped.P.copy()

    def ready(self, begin: int, end: int) -> Callable[[], object]:
        """The arguments of each step."""
        steps = _steps(self.work, begin, end)

        def go() -> None:
            x, P, identity = self.x, self.P, np.eye(len(self.x))
            for u, dt, sightings in steps:
                F, Q = identity.copy(), np.zeros_like(P)
                x[:3], F[:3, :3], Q[:3, :3] = move(x[:3], u, dt)
                P = F @ P @ F.T + Q
                for slot, z in sightings:
                    H = jacobian(x, slot)
                    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
                    x += K @ residual(z, predicted(x, slot))
                    P = (identity - K @ H) @ P
            self.P = P

        return go

    def joint(self, at: IntArray) -> tuple[Array, Array]:
        """State and a block of P."""
        return self.x, self.P[np.ix_(at, at)]
