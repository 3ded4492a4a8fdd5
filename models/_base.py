"""What the built-in models share: types of compiled functions, checks of parameters, methods on compiled functions."""

from __future__ import annotations

from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from slamkit.arrays import Array, finite_number, real_array
from slamkit.compiled import compiled
from slamkit.errors import InputError
from slamkit.protocols import MotionFunctions, SensorFunctions

# Types of a motion model's compiled functions, as `slamkit.protocols.MotionFunctions` lists them.
MOVE = "void(vector, vector, real, vector, vector)"
MOTION_JACOBIANS = "void(vector, vector, real, vector, matrix, matrix)"
CONTROL_NOISE = "void(vector, real, vector, matrix)"
POSE_NOISE = "void(vector, vector, real, vector, matrix)"
PREDICT_ALL = "void(vector, vector, real, vector, vector, matrix, matrix, matrix, matrix)"

# Types of a sensor model's compiled functions, as `slamkit.protocols.SensorFunctions` lists them.
PREDICT = RESIDUAL = INVERT = "void(vector, vector, vector, vector)"
SENSOR_JACOBIANS = INVERSE_JACOBIANS = "void(vector, vector, vector, matrix, matrix)"
LINEARISE = "void(vector, vector, vector, vector, vector, vector, matrix, matrix)"


@compiled(POSE_NOISE)
def no_pose_noise(pose: Any, u: Any, dt: float, params: Any, out: Any) -> None:
    """Zero: all of the noise is in the control."""
    out[:, :] = 0.0


def vector(name: str, value: ArrayLike, length: int) -> Array:
    """`value` as a new float vector of the given length, or an InputError. NaN and infinity are allowed."""
    a = real_array(name, value)
    if a.shape != (length,):
        raise InputError(f"{name} has shape {a.shape}, expected ({length},)")
    return a


def duration(value: float) -> float:
    """`value` as a float, or an InputError. NaN and infinity are allowed."""
    a = real_array("dt", value)
    if a.ndim:
        raise InputError(f"dt has shape {a.shape}, expected a number")
    return float(a)


def noise_parameter(name: str, value: float, *, zero: bool) -> float:
    """A finite number > 0 (or ≥ 0 if `zero`) as a float, or an InputError.

    Its square must be such a number too: 1e-200 is positive, but as a variance it is zero.
    """
    number = finite_number(name, value, lower=0.0)
    square = number * number
    if not np.isfinite(square) or (square == 0 and not zero):
        raise InputError(f"{name} is {number}, expected a finite number {'≥' if zero else '>'} 0 (and its square too)")
    return number


def frozen(a: Array) -> Array:
    """The same array, made read-only, so that nobody changes a frozen model through it."""
    a.flags.writeable = False
    return a


def parameter(unit: str, typical: float) -> dict[str, Any]:
    """What a dataclass field says about a parameter: its unit, and a value to start with."""
    return {"unit": unit, "typical": typical}


class _Value:
    """A model that is copied and pickled without what it has cached."""

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name not in ("params", "R")}


class CompiledMotion(_Value):
    """Methods of :class:`slamkit.protocols.MotionModel` on top of four compiled functions.

    A subclass sets the class attributes `functions` and `control_dim` and the property `params`.
    """

    functions: ClassVar[MotionFunctions]
    control_dim: ClassVar[int]  #: m, the length of a control
    columns: ClassVar[tuple[str, ...]] = ()  #: names of the control in a CSV file, if they identify the model

    @cached_property
    def params(self) -> Array:
        """The model's parameters as one float64 vector, in the order in which its functions read them."""
        raise AttributeError(f"{type(self).__name__} sets no params")

    def move(self, pose: ArrayLike, u: ArrayLike, dt: float) -> Array:
        """Pose (3,) [m, m, rad] after the control u (m,) has acted for dt [s]."""
        out = np.empty(3)
        self.functions.move(*self._arguments(pose, u, dt), self.params, out)
        return out

    def jacobians(self, pose: ArrayLike, u: ArrayLike, dt: float) -> tuple[Array, Array]:
        """F (3, 3) = ∂move/∂pose and G (3, m) = ∂move/∂u."""
        F, G = np.empty((3, 3)), np.empty((3, self.control_dim))
        self.functions.jacobians(*self._arguments(pose, u, dt), self.params, F, G)
        return F, G

    def control_noise(self, u: ArrayLike, dt: float) -> Array:
        """Covariance (m, m) of the control's noise over a step."""
        out = np.empty((self.control_dim, self.control_dim))
        self.functions.control_noise(vector("u", u, self.control_dim), duration(dt), self.params, out)
        return out

    def pose_noise(self, pose: ArrayLike, u: ArrayLike, dt: float) -> Array:
        """Covariance (3, 3) that a step adds to the pose directly."""
        out = np.empty((3, 3))
        self.functions.pose_noise(*self._arguments(pose, u, dt), self.params, out)
        return out

    def _arguments(self, pose: ArrayLike, u: ArrayLike, dt: float) -> tuple[Array, Array, float]:
        return vector("pose", pose, 3), vector("u", u, self.control_dim), duration(dt)


class CompiledSensor(_Value):
    """Methods of :class:`slamkit.protocols.SensorModel` on top of five compiled functions.

    A subclass sets the class attribute `functions` and the properties `params` and `R`.
    """

    functions: ClassVar[SensorFunctions]
    columns: ClassVar[tuple[str, ...]] = ()  #: names of a measurement in a CSV file, if they identify the model

    @cached_property
    def params(self) -> Array:
        """The model's parameters as one float64 vector, in the order in which its functions read them."""
        return np.empty(0)

    @property
    def R(self) -> Array:  # noqa: N802
        """Measurement noise covariance (k, k)."""
        raise AttributeError(f"{type(self).__name__} sets no R")

    def predict(self, pose: ArrayLike, landmark: ArrayLike) -> Array:
        """The measurement (k,) of this landmark (2,) that is expected at this pose (3,)."""
        out = np.empty(len(self.R))
        self.functions.predict(vector("pose", pose, 3), vector("landmark", landmark, 2), self.params, out)
        return out

    def jacobians(self, pose: ArrayLike, landmark: ArrayLike) -> tuple[Array, Array]:
        """∂z/∂pose (k, 3) and ∂z/∂landmark (k, 2)."""
        H_pose, H_landmark = np.empty((len(self.R), 3)), np.empty((len(self.R), 2))
        args = vector("pose", pose, 3), vector("landmark", landmark, 2), self.params
        self.functions.jacobians(*args, H_pose, H_landmark)
        return H_pose, H_landmark

    def residual(self, z: ArrayLike, z_hat: ArrayLike) -> Array:
        """z - z_hat (k,), with angles wrapped to [-π, π); NaN if z is not a possible measurement."""
        k = len(self.R)
        out = np.empty(k)
        self.functions.residual(vector("z", z, k), vector("z_hat", z_hat, k), self.params, out)
        return out

    def invert(self, pose: ArrayLike, z: ArrayLike) -> Array:
        """The landmark (2,) that is measured as z (k,) from this pose (3,)."""
        out = np.empty(2)
        self.functions.invert(vector("pose", pose, 3), vector("z", z, len(self.R)), self.params, out)
        return out

    def inverse_jacobians(self, pose: ArrayLike, z: ArrayLike) -> tuple[Array, Array]:
        """∂invert/∂pose (2, 3) and ∂invert/∂z (2, k)."""
        k = len(self.R)
        G_pose, G_z = np.empty((2, 3)), np.empty((2, k))
        self.functions.inverse_jacobians(vector("pose", pose, 3), vector("z", z, k), self.params, G_pose, G_z)
        return G_pose, G_z
