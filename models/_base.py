"""What the built-in models share: the protocol's methods on top of compiled functions."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slamkit.errors import InputError
from slamkit.protocols import MotionFunctions, SensorFunctions

Array = NDArray[np.float64]


def _numbers(name: str, value: ArrayLike) -> Array:
    try:
        return np.array(value, dtype=float, order="C")
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} must hold numbers in equal rows: {error}") from None


def vector(name: str, value: ArrayLike, length: int) -> Array:
    """`value` as a new float vector of the given length, or an InputError that says what it is.

    New, because compiled functions take neither a read-only array nor one with gaps.
    """
    a = _numbers(name, value)
    if a.shape != (length,):
        raise InputError(f"{name} has shape {a.shape}, expected ({length},)")
    return a


def standard_deviation(name: str, value: float, *, zero: bool) -> float:
    """A finite, non-negative (or positive) float, or an InputError."""
    try:
        sigma = float(value)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{name} is {value!r}, expected a number") from None
    square = sigma * sigma  # 1e-200 is positive, but as a variance it is zero
    if sigma < 0 or not np.isfinite(square) or (square == 0 and not zero):
        raise InputError(f"{name} is {sigma}, expected a finite number {'≥' if zero else '>'} 0, its square likewise")
    return sigma


def covariance(name: str, value: ArrayLike, size: int) -> Array:
    """`value` as a symmetric positive semidefinite matrix of the given size, or an InputError."""
    a = _numbers(name, value)
    if a.shape != (size, size):
        raise InputError(f"{name} has shape {a.shape}, expected ({size}, {size})")
    if not np.all(np.isfinite(a)):
        raise InputError(f"{name} is not finite")
    scale = float(np.abs(a).max(initial=0.0))
    if np.abs(a - a.T).max(initial=0.0) > 1e-9 * scale:
        raise InputError(f"{name} is not symmetric: it differs from its transpose by {np.abs(a - a.T).max():.3g}")
    smallest = float(np.linalg.eigvalsh(a)[0])
    if smallest < -1e-12 * scale:
        raise InputError(f"{name} is not positive semidefinite: smallest eigenvalue {smallest:.3g}")
    symmetric: Array = (a + a.T) / 2
    return symmetric


def frozen(a: Array) -> Array:
    """The same array, now read-only: what a frozen model hands out must not change it."""
    a.flags.writeable = False
    return a


class CompiledMotion:
    """Methods of :class:`slamkit.protocols.MotionModel` on top of four compiled functions.

    A subclass sets the class attributes `functions` and `control_dim` and the property `params`.
    """

    functions: MotionFunctions
    control_dim: int  #: m, the length of a control

    @cached_property
    def params(self) -> Array:
        """The model's parameters as one float64 vector, in the order that its functions read them."""
        raise AttributeError(f"{type(self).__name__} sets no params")

    def move(self, pose: ArrayLike, u: ArrayLike, dt: float) -> Array:
        """Pose (3,) [m, m, rad] after the control u (m,) has acted for dt [s]."""
        out = np.empty(3)
        self.functions.move(vector("pose", pose, 3), vector("u", u, self.control_dim), float(dt), self.params, out)
        return out

    def jacobians(self, pose: ArrayLike, u: ArrayLike, dt: float) -> tuple[Array, Array]:
        """F (3, 3) = ∂move/∂pose and G (3, m) = ∂move/∂u."""
        F, G = np.empty((3, 3)), np.empty((3, self.control_dim))
        args = vector("pose", pose, 3), vector("u", u, self.control_dim), float(dt)
        self.functions.jacobians(*args, self.params, F, G)
        return F, G

    def control_noise(self, u: ArrayLike, dt: float) -> Array:
        """Covariance (m, m) of the control's noise over a step."""
        out = np.empty((self.control_dim, self.control_dim))
        self.functions.control_noise(vector("u", u, self.control_dim), float(dt), self.params, out)
        return out

    def pose_noise(self, pose: ArrayLike, u: ArrayLike, dt: float) -> Array:
        """Covariance (3, 3) that a step adds to the pose directly."""
        out = np.empty((3, 3))
        args = vector("pose", pose, 3), vector("u", u, self.control_dim), float(dt)
        self.functions.pose_noise(*args, self.params, out)
        return out


class CompiledSensor:
    """Methods of :class:`slamkit.protocols.SensorModel` on top of five compiled functions.

    A subclass sets the class attribute `functions` and the properties `params` and `R`.
    """

    functions: SensorFunctions

    @cached_property
    def params(self) -> Array:
        """The model's parameters as one float64 vector, in the order that its functions read them."""
        return np.empty(0)

    @property
    def R(self) -> Array:  # noqa: N802
        """Measurement noise covariance (k, k)."""
        raise AttributeError(f"{type(self).__name__} sets no R")

    def predict(self, pose: ArrayLike, landmark: ArrayLike) -> Array:
        """The measurement (k,) that this pose (3,) would make of this landmark (2,)."""
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
        """z - z_hat (k,), with angles wrapped to [-π, π); NaN where z cannot be a measurement."""
        k = len(self.R)
        out = np.empty(k)
        self.functions.residual(vector("z", z, k), vector("z_hat", z_hat, k), self.params, out)
        return out

    def invert(self, pose: ArrayLike, z: ArrayLike) -> Array:
        """The landmark (2,) that this pose (3,) sees as z (k,)."""
        out = np.empty(2)
        self.functions.invert(vector("pose", pose, 3), vector("z", z, len(self.R)), self.params, out)
        return out

    def inverse_jacobians(self, pose: ArrayLike, z: ArrayLike) -> tuple[Array, Array]:
        """∂invert/∂pose (2, 3) and ∂invert/∂z (2, k)."""
        k = len(self.R)
        G_pose, G_z = np.empty((2, 3)), np.empty((2, k))
        self.functions.inverse_jacobians(vector("pose", pose, 3), vector("z", z, k), self.params, G_pose, G_z)
        return G_pose, G_z
