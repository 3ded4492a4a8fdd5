"""Models that break one law each."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import numba
import numpy as np
from model_examples import PI
from own_models import (
    Differential,
    Mounted,
    Polar,
    Scooter,
    numba_control_noise,
    numba_linearise,
    numba_motion_jacobians,
    numba_move,
    numba_predict_all,
    numba_residual,
)

from slamkit.arrays import Array
from slamkit.models import Unicycle


def breaks(law: str, *, alone: bool = True) -> Callable[[type], type]:
    """Note on the class which law it breaks, and whether it keeps all the others."""

    def note(model: type) -> type:
        model.law, model.alone = law, alone  # type: ignore[attr-defined]
        BROKEN.append(model)
        return model

    return note


BROKEN: list[type] = []


@breaks("F is ∂move/∂pose")
class WrongF(Differential):
    def jacobians(self, pose: Array, u: Array, dt: float) -> tuple[Array, Array]:
        F, G = super().jacobians(pose, u, dt)
        F[0, 2] *= -1
        return F, G


@breaks("G is ∂move/∂u")
class SlightlyWrongG(Differential):
    def jacobians(self, pose: Array, u: Array, dt: float) -> tuple[Array, Array]:
        F, G = super().jacobians(pose, u, dt)
        return F, G * (1 + 1e-5)


@breaks("G is ∂move/∂u")
class EulerG(Differential):
    def jacobians(self, pose: Array, u: Array, dt: float) -> tuple[Array, Array]:
        F, G = super().jacobians(pose, u, dt)
        G[:2] = dt / 2 * np.array([[np.cos(pose[2])] * 2, [np.sin(pose[2])] * 2])
        return F, G


@breaks("move is continuous as u goes to zero", alone=False)
class Quotient(Differential):
    def move(self, pose: Array, u: Array, dt: float) -> Array:
        v, omega = u  # a unicycle that divides by its turn rate
        if omega == 0:
            return np.array([pose[0] + v * dt * np.cos(pose[2]), pose[1] + v * dt * np.sin(pose[2]), pose[2]])
        t = pose[2] + omega * dt
        x, y = v / omega * (np.sin(t) - np.sin(pose[2])), v / omega * (np.cos(pose[2]) - np.cos(t))
        return np.array([pose[0] + x, pose[1] + y, t])

    def jacobians(self, pose: Array, u: Array, dt: float) -> tuple[Array, Array]:
        return Unicycle(0, 0).jacobians(pose, u, dt)


@breaks("move is finite", alone=False)
class Division(Quotient):
    def move(self, pose: Array, u: Array, dt: float) -> Array:
        return super().move(pose, u, dt) + 0 / np.float64(u[1])


@breaks("jacobians is finite")
class InfiniteJacobian(Differential):
    def jacobians(self, pose: Array, u: Array, dt: float) -> tuple[Array, Array]:
        F, G = super().jacobians(pose, u, dt)
        return F, G if u.any() else G * np.nan


@breaks("move takes the heading as an angle")
class HeadingAsNumber(Differential):
    def move(self, pose: Array, u: Array, dt: float) -> Array:
        return np.add(super().move(pose, u, dt), [0, 0, 0.01 * pose[2]])

    def jacobians(self, pose: Array, u: Array, dt: float) -> tuple[Array, Array]:
        F, G = super().jacobians(pose, u, dt)
        return F + np.diag([0, 0, 0.01]), G


@breaks("control_noise is symmetric positive semidefinite")
class NegativeNoise(Differential):
    def control_noise(self, u: Array, dt: float) -> Array:
        return np.diag([u[0], 1.0])


@breaks("control_noise is symmetric positive semidefinite")
class AsymmetricNoise(Differential):
    def control_noise(self, u: Array, dt: float) -> Array:
        return np.array([[1.0, 0.1], [0.0, 1.0]])


@breaks("pose_noise is symmetric positive semidefinite")
class NegativePoseNoise(Differential):
    def pose_noise(self, pose: Array, u: Array, dt: float) -> Array:
        return np.diag([0.0, 0.0, -1e-9])


@breaks("pose_noise is finite")
class NotANumberNoise(Differential):
    def pose_noise(self, pose: Array, u: Array, dt: float) -> Array:
        return np.full((3, 3), np.inf)


@breaks("control_noise gives float64 arrays of the right shape")
class NoiseShape(Differential):
    def control_noise(self, u: Array, dt: float) -> Array:
        return np.eye(3)


@breaks("move gives float64 arrays of the right shape", alone=False)
class ColumnPose(Differential):
    def move(self, pose: Array, u: Array, dt: float) -> Array:
        return super().move(pose, u, dt)[:, None]


@breaks("move gives float64 arrays of the right shape")
class SinglePrecision(Differential):
    def move(self, pose: Array, u: Array, dt: float) -> Any:
        return super().move(pose, u, dt).astype(np.float32)


@breaks("jacobians gives float64 arrays of the right shape")
class OnlyF(Differential):
    def jacobians(self, pose: Array, u: Array, dt: float) -> Any:
        return super().jacobians(pose, u, dt)[0]


@breaks("pose_noise raises no error")
class Raises(Differential):
    def pose_noise(self, pose: Array, u: Array, dt: float) -> Array:
        raise RuntimeError("no noise here")


@breaks("move raises no error")
class Limited(Differential):
    def move(self, pose: Array, u: Array, dt: float) -> Array:
        if u.max() > 1.0:
            raise ValueError("too fast")
        return super().move(pose, u, dt)


@breaks("move leaves its arguments alone", alone=False)
class InPlace(Differential):
    def move(self, pose: Array, u: Array, dt: float) -> Array:
        moved = super().move(pose, u, dt)
        pose += 0.1
        return moved


@breaks("move gives new arrays")
class SameArray(Differential):
    def move(self, pose: Array, u: Array, dt: float) -> Array:
        return super().move(pose, u, dt) if u.any() else pose


@breaks("move gives new arrays")
class Buffer(Differential):
    out: ClassVar[Array] = np.empty(3)

    def move(self, pose: Array, u: Array, dt: float) -> Array:
        Buffer.out[:] = super().move(pose, u, dt)
        return Buffer.out


@breaks("control_noise is deterministic", alone=False)
class Dice(Differential):
    def control_noise(self, u: Array, dt: float) -> Array:
        return super().control_noise(u, dt) + np.eye(2) * np.random.default_rng().uniform()


@breaks("survives pickle")
class NoPickle(Differential):
    def __reduce__(self) -> Any:
        raise TypeError("not today")

    def __deepcopy__(self, memo: object) -> Any:
        return self


@breaks("survives deepcopy")
class ForgetfulCopy(Differential):
    def __deepcopy__(self, memo: object) -> Any:
        return ForgetfulCopy(self.width * 2)


@breaks("functions.control_noise agrees with control_noise")
class OtherNoise(Scooter):
    def control_noise(self, u: Array, dt: float) -> Array:
        return 2 * super().control_noise(u, dt)


@breaks("functions holds one function a method")
class HalfCompiled(Scooter):
    functions = (numba_move, numba_motion_jacobians)


@breaks("functions fit into a compiled run")
class NotCompiled(Scooter):
    functions = Scooter.functions._replace(control_noise=numba_control_noise.py_func)


@breaks("functions.pose_noise raises no error", alone=False)
class BadSignature(Scooter):
    functions = Scooter.functions._replace(pose_noise=numba_control_noise)


@breaks("params is a float64 vector")
class IntegerParams(Scooter):
    def __init__(self) -> None:
        self.params = np.array([1, 2])


@breaks("H_pose is ∂predict/∂pose")
class WrongHPose(Polar):
    def jacobians(self, pose: Array, landmark: Array) -> tuple[Array, Array]:
        H_pose, H = super().jacobians(pose, landmark)
        H_pose[0, 2] = 1.0
        return H_pose, H


@breaks("H_landmark is ∂predict/∂landmark")
class WrongHLandmark(Polar):
    def jacobians(self, pose: Array, landmark: Array) -> tuple[Array, Array]:
        H_pose, H = super().jacobians(pose, landmark)
        return H_pose, H[::-1].copy()


@breaks("H_landmark is ∂predict/∂landmark")
class WrongOnlyBehind(Polar):
    def jacobians(self, pose: Array, landmark: Array) -> tuple[Array, Array]:
        H_pose, H = super().jacobians(pose, landmark)
        return H_pose, -H if abs(self.predict(pose, landmark)[0]) > 3.1415 else H


@breaks("G_pose is ∂invert/∂pose")
class WrongGPose(Polar):
    def inverse_jacobians(self, pose: Array, z: Array) -> tuple[Array, Array]:
        G_pose, G_z = super().inverse_jacobians(pose, z)
        G_pose[:, 2] *= 1.0001
        return G_pose, G_z


@breaks("G_z is ∂invert/∂z")
class WrongGZ(Polar):
    def inverse_jacobians(self, pose: Array, z: Array) -> tuple[Array, Array]:
        G_pose, G_z = super().inverse_jacobians(pose, z)
        return G_pose, G_z[:, ::-1].copy()


@breaks("predict undoes invert")
class WrongInverse(Polar):
    def invert(self, pose: Array, z: Array) -> Array:
        return super().invert(pose, z) + 1e-6


@breaks("predict takes the heading as an angle", alone=False)
class PredictHeading(Polar):
    def predict(self, pose: Array, landmark: Array) -> Array:
        return np.add(super().predict(pose, landmark), [0, 0.01 * pose[2]])


@breaks("invert takes the heading as an angle", alone=False)
class InvertHeading(Polar):
    def invert(self, pose: Array, z: Array) -> Array:
        return np.add(super().invert(pose, z), [0.01 * pose[2]])


@breaks("residual wraps angles", alone=False)
class NoWrap(Polar):
    def residual(self, z: Array, z_hat: Array) -> Array:
        return z - z_hat


@breaks("residual wraps angles")
class WrapsOnce(Polar):
    def residual(self, z: Array, z_hat: Array) -> Array:
        d = z - z_hat
        return d - [2 * PI if d[0] >= PI else -2 * PI if d[0] < -PI else 0.0, 0.0]


@breaks("residual is z - z_hat apart from whole turns", alone=False)
class Reversed(Polar):
    def residual(self, z: Array, z_hat: Array) -> Array:
        return super().residual(z_hat, z)


@breaks("residual is z - z_hat apart from whole turns")
class WrapsHalf(Polar):
    def residual(self, z: Array, z_hat: Array) -> Array:
        d = super().residual(z, z_hat)
        return np.array([(d[0] + PI / 2) % PI - PI / 2, d[1]])


@breaks("residual is z - z_hat apart from whole turns", alone=False)
class WrapsToPositive(Polar):
    def residual(self, z: Array, z_hat: Array) -> Array:
        return np.array([(z[0] - z_hat[0]) % (2 * PI), z[1] - z_hat[1]])


@breaks("residual is zero at z = z_hat")
class Offset(Polar):
    def residual(self, z: Array, z_hat: Array) -> Array:
        return super().residual(z, z_hat) + 1e-12


@breaks("predict is finite")
class OnlyAhead(Polar):
    def predict(self, pose: Array, landmark: Array) -> Array:
        z = super().predict(pose, landmark)
        return z if abs(z[0]) < 1.5 else z * np.nan


@breaks("predict is finite")
class InfiniteWhenNear(Polar):
    def predict(self, pose: Array, landmark: Array) -> Array:
        z = super().predict(pose, landmark)
        return np.where(np.isnan(z), np.inf, z)


@breaks("invert gives float64 arrays of the right shape")
class InvertsToPose(Polar):
    def invert(self, pose: Array, z: Array) -> Array:
        return np.append(super().invert(pose, z), 0.0)


@breaks("R is a symmetric positive definite float64 matrix")
class SemidefiniteR(Polar):
    def __init__(self) -> None:
        self.R = np.diag([0.1, 0.0])


@breaks("R is a symmetric positive definite float64 matrix")
class AsymmetricR(Polar):
    def __init__(self) -> None:
        self.R = np.array([[0.1, 0.01], [0.0, 0.1]])


@breaks("R is a symmetric positive definite float64 matrix")
class VectorR(Polar):
    def __init__(self) -> None:
        self.R = np.array([0.1, 0.1])


@breaks("R is finite")
class InfiniteR(Polar):
    def __init__(self) -> None:
        self.R = np.diag([0.1, np.inf])


@breaks("R raises no error")
class RaisingR(Polar):
    def __init__(self) -> None:
        pass

    @property
    def R(self) -> Array:  # type: ignore[override]  # noqa: N802
        raise RuntimeError("no R yet")


@breaks("predict leaves its arguments alone")
class MovesLandmark(Polar):
    def predict(self, pose: Array, landmark: Array) -> Array:
        z = super().predict(pose, landmark)
        landmark -= pose[:2]
        return z


@breaks("residual gives new arrays", alone=False)
class ResidualInPlace(Polar):
    def residual(self, z: Array, z_hat: Array) -> Array:
        z[:] = super().residual(z, z_hat)
        return z


@numba.njit
def numba_still(pose, u, dt, params, out, F, G, sigma, noise):  # type: ignore[no-untyped-def]
    numba_predict_all(pose, u, dt, params, out, F, G, sigma, noise)
    noise[2, 2] = 0.0


@breaks("predict_all is move, jacobians, control_noise and pose_noise")
class Still(Scooter):
    functions = Scooter.functions._replace(predict_all=numba_still)


@numba.njit
def numba_turned(pose, landmark, z, params, z_hat, y, H_pose, H_landmark):  # type: ignore[no-untyped-def]
    numba_linearise(pose, landmark, z, params, z_hat, y, H_pose, H_landmark)
    numba_residual(z_hat, z, params, y)


@breaks("linearise is predict, residual and jacobians")
class Turned(Mounted):
    functions = Mounted.functions._replace(linearise=numba_turned)


@breaks("functions.linearise raises no error", alone=False)
class WrongLinearise(Mounted):
    functions = Mounted.functions._replace(linearise=numba_still)


@numba.njit
def numba_unfinished(pose, z, params, out):  # type: ignore[no-untyped-def]
    c, s = np.cos(pose[2] + params[0]), np.sin(pose[2] + params[0])
    out[0] = pose[0] + c * z[0] - s * z[1]


@breaks("functions.invert agrees with invert")
class Unfinished(Mounted):
    functions = Mounted.functions._replace(invert=numba_unfinished)
