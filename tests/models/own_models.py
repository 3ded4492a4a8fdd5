"""Models as a user writes them: in plain NumPy, or as Numba functions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numba
import numpy as np

from slamkit import se2
from slamkit.arrays import Array
from slamkit.models import Unicycle
from slamkit.protocols import MotionFunctions, SensorFunctions


@dataclass(frozen=True)
class Differential:
    """Two driven wheels, control (left, right) [m/s], in plain NumPy; exact arc."""

    width: float = 0.4

    def _twist(self, u: Array) -> tuple[float, float]:
        return (u[0] + u[1]) / 2, (u[1] - u[0]) / self.width

    def move(self, pose: Array, u: Array, dt: float) -> Array:
        v, omega = self._twist(u)
        return se2.compose(pose, se2.exp([v * dt, 0.0, omega * dt]))

    def jacobians(self, pose: Array, u: Array, dt: float) -> tuple[Array, Array]:
        v, omega = self._twist(u)
        x, y, _ = self.move(pose, u, dt) - pose
        F = np.array([[1, 0, -y], [0, 1, x], [0, 0, 1.0]])
        unicycle = Unicycle(0, 0).jacobians(pose, [v, omega], dt)[1]
        return F, unicycle @ np.array([[0.5, 0.5], [-1 / self.width, 1 / self.width]])

    def control_noise(self, u: Array, dt: float) -> Array:
        return np.diag(0.01 * u**2)

    def pose_noise(self, pose: Array, u: Array, dt: float) -> Array:
        return np.zeros((3, 3))


class Omnidirectional:
    """Three wheels: control (vx, vy, ω) in robot axes, Euler step; says nothing of its control's length."""

    def move(self, pose: Array, u: Array, dt: float) -> Array:
        return pose + dt * np.array([*(se2.rotation(pose[2]) @ u[:2]), u[2]])

    def jacobians(self, pose: Array, u: Array, dt: float) -> tuple[Array, Array]:
        C = se2.rotation(pose[2])
        F, G = np.eye(3), dt * np.eye(3)
        F[:2, 2] = dt * C @ [-u[1], u[0]]
        G[:2, :2] = dt * C
        return F, G

    def control_noise(self, u: Array, dt: float) -> Array:
        return 0.01 * np.eye(3)

    def pose_noise(self, pose: Array, u: Array, dt: float) -> Array:
        return 0.001 * dt * np.eye(3)


class Polar:
    """Bearing and range, in this order, in plain NumPy; refuses a landmark within 5 cm."""

    def __init__(self) -> None:
        self.R = np.array([[0.01, 0.001], [0.001, 0.04]])

    def predict(self, pose: Array, landmark: Array) -> Array:
        dx, dy = landmark - pose[:2]
        r = np.hypot(dx, dy)
        return np.array([se2.wrap(np.arctan2(dy, dx) - pose[2]), r if r > 0.05 else np.nan])

    def jacobians(self, pose: Array, landmark: Array) -> tuple[Array, Array]:
        dx, dy = landmark - pose[:2]
        r = np.hypot(dx, dy)
        H = np.array([[-dy / r**2, dx / r**2], [dx / r, dy / r]])
        return np.column_stack([-H, [-1.0, 0.0]]), H

    def residual(self, z: Array, z_hat: Array) -> Array:
        d = z - z_hat
        return np.array([se2.wrap(d[0]), d[1]])

    def invert(self, pose: Array, z: Array) -> Array:
        a = pose[2] + z[0]
        return np.array([pose[0] + z[1] * np.cos(a), pose[1] + z[1] * np.sin(a)])

    def inverse_jacobians(self, pose: Array, z: Array) -> tuple[Array, Array]:
        c, s = np.cos(pose[2] + z[0]), np.sin(pose[2] + z[0])
        across = z[1] * np.array([-s, c])
        return np.column_stack([np.eye(2), across]), np.column_stack([across, [c, s]])


class PositionAndRange:
    """Three numbers a sighting: the position in robot axes, and the range again."""

    R: ClassVar[Array] = np.diag([0.01, 0.01, 0.04])

    def predict(self, pose: Array, landmark: Array) -> Array:
        b = se2.rotation(pose[2]).T @ (landmark - pose[:2])
        return np.array([*b, np.hypot(*b)])

    def jacobians(self, pose: Array, landmark: Array) -> tuple[Array, Array]:
        d = landmark - pose[:2]
        H_b = np.vstack([np.eye(2), se2.rotation(pose[2]).T @ d / np.hypot(*d)])
        H = H_b @ se2.rotation(pose[2]).T
        return -H @ np.array([[1, 0, -d[1]], [0, 1, d[0]]]), H

    def residual(self, z: Array, z_hat: Array) -> Array:
        return z - z_hat

    def invert(self, pose: Array, z: Array) -> Array:
        return se2.transform(pose, z[:2])

    def inverse_jacobians(self, pose: Array, z: Array) -> tuple[Array, Array]:
        C = se2.rotation(pose[2])
        return np.column_stack([np.eye(2), C @ [-z[1], z[0]]]), np.column_stack([C, np.zeros(2)])


@numba.njit
def numba_predict(pose, landmark, params, out):  # type: ignore[no-untyped-def]
    c, s = np.cos(pose[2] + params[0]), np.sin(pose[2] + params[0])
    dx, dy = landmark[0] - pose[0], landmark[1] - pose[1]
    out[0], out[1] = c * dx + s * dy, c * dy - s * dx


@numba.njit
def numba_jacobians(pose, landmark, params, H_pose, H_landmark):  # type: ignore[no-untyped-def]
    c, s = np.cos(pose[2] + params[0]), np.sin(pose[2] + params[0])
    dx, dy = landmark[0] - pose[0], landmark[1] - pose[1]
    H_landmark[0, 0], H_landmark[0, 1], H_landmark[1, 0], H_landmark[1, 1] = c, s, -s, c
    H_pose[0, 0], H_pose[0, 1], H_pose[1, 0], H_pose[1, 1] = -c, -s, s, -c
    H_pose[0, 2], H_pose[1, 2] = c * dy - s * dx, -c * dx - s * dy


@numba.njit
def numba_residual(z, z_hat, params, out):  # type: ignore[no-untyped-def]
    out[0], out[1] = z[0] - z_hat[0], z[1] - z_hat[1]


@numba.njit
def numba_invert(pose, z, params, out):  # type: ignore[no-untyped-def]
    c, s = np.cos(pose[2] + params[0]), np.sin(pose[2] + params[0])
    out[0], out[1] = pose[0] + c * z[0] - s * z[1], pose[1] + s * z[0] + c * z[1]


@numba.njit
def numba_inverse_jacobians(pose, z, params, G_pose, G_z):  # type: ignore[no-untyped-def]
    c, s = np.cos(pose[2] + params[0]), np.sin(pose[2] + params[0])
    G_z[0, 0], G_z[0, 1], G_z[1, 0], G_z[1, 1] = c, -s, s, c
    G_pose[0, 0], G_pose[0, 1], G_pose[1, 0], G_pose[1, 1] = 1.0, 0.0, 0.0, 1.0
    G_pose[0, 2], G_pose[1, 2] = -s * z[0] - c * z[1], c * z[0] - s * z[1]


class Mounted:
    """Relative position by a sensor that is mounted askew, as plain Numba functions."""

    functions: Any = SensorFunctions(
        numba_predict, numba_jacobians, numba_residual, numba_invert, numba_inverse_jacobians
    )

    def __init__(self) -> None:
        self.R, self.params = 0.01 * np.eye(2), np.array([0.3])

    def _call(self, function: str, *arguments: Any, shapes: tuple[tuple[int, ...], ...]) -> tuple[Array, ...]:
        outs = tuple(np.empty(s) for s in shapes)
        getattr(Mounted.functions, function)(*arguments, self.params, *outs)
        return outs

    def predict(self, pose: Array, landmark: Array) -> Array:
        return self._call("predict", pose, landmark, shapes=((2,),))[0]

    def jacobians(self, pose: Array, landmark: Array) -> tuple[Array, ...]:
        return self._call("jacobians", pose, landmark, shapes=((2, 3), (2, 2)))

    def residual(self, z: Array, z_hat: Array) -> Array:
        return self._call("residual", z, z_hat, shapes=((2,),))[0]

    def invert(self, pose: Array, z: Array) -> Array:
        return self._call("invert", pose, z, shapes=((2,),))[0]

    def inverse_jacobians(self, pose: Array, z: Array) -> tuple[Array, ...]:
        return self._call("inverse_jacobians", pose, z, shapes=((2, 3), (2, 2)))


@numba.njit
def numba_linearise(pose, landmark, z, params, z_hat, y, H_pose, H_landmark):  # type: ignore[no-untyped-def]
    numba_predict(pose, landmark, params, z_hat)
    numba_residual(z, z_hat, params, y)
    numba_jacobians(pose, landmark, params, H_pose, H_landmark)


class Watcher(Mounted):
    """It says at one blow what it sees."""

    functions = Mounted.functions._replace(linearise=numba_linearise)


@numba.njit
def numba_move(pose, u, dt, params, out):  # type: ignore[no-untyped-def]
    out[0] = pose[0] + u[0] * dt * np.cos(pose[2])
    out[1] = pose[1] + u[0] * dt * np.sin(pose[2])
    out[2] = pose[2] + u[1] * dt


@numba.njit
def numba_motion_jacobians(pose, u, dt, params, F, G):  # type: ignore[no-untyped-def]
    c, s = np.cos(pose[2]), np.sin(pose[2])
    F[:, :] = 0.0
    F[0, 0] = F[1, 1] = F[2, 2] = 1.0
    F[0, 2], F[1, 2] = -u[0] * dt * s, u[0] * dt * c
    G[:, :] = 0.0
    G[0, 0], G[1, 0], G[2, 1] = dt * c, dt * s, dt


@numba.njit
def numba_control_noise(u, dt, params, out):  # type: ignore[no-untyped-def]
    out[:, :] = 0.0
    out[0, 0] = out[1, 1] = params[0]


@numba.njit
def numba_pose_noise(pose, u, dt, params, out):  # type: ignore[no-untyped-def]
    out[:, :] = 0.0
    out[0, 0] = out[1, 1] = out[2, 2] = params[1]


@numba.njit
def numba_predict_all(pose, u, dt, params, out, F, G, sigma, noise):  # type: ignore[no-untyped-def]
    numba_move(pose, u, dt, params, out)
    numba_motion_jacobians(pose, u, dt, params, F, G)
    numba_control_noise(u, dt, params, sigma)
    numba_pose_noise(pose, u, dt, params, noise)


class Scooter:
    """Euler unicycle as plain Numba functions."""

    functions: Any = MotionFunctions(numba_move, numba_motion_jacobians, numba_control_noise, numba_pose_noise)
    control_dim = 2

    def __init__(self) -> None:
        self.params = np.array([0.04, 1e-4])

    def move(self, pose: Array, u: Array, dt: float) -> Array:
        out = np.empty(3)
        numba_move(pose, u, dt, self.params, out)
        return out

    def jacobians(self, pose: Array, u: Array, dt: float) -> tuple[Array, Array]:
        F, G = np.empty((3, 3)), np.empty((3, 2))
        numba_motion_jacobians(pose, u, dt, self.params, F, G)
        return F, G

    def control_noise(self, u: Array, dt: float) -> Array:
        return np.diag([float(self.params[0])] * 2)

    def pose_noise(self, pose: Array, u: Array, dt: float) -> Array:
        return np.diag([float(self.params[1])] * 3)


class Driven(Scooter):
    """It says at one blow what it does."""

    functions = Scooter.functions._replace(predict_all=numba_predict_all)
