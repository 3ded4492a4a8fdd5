"""What a motion model, a sensor model and a landmark filter must offer.

A model is any object with these methods; no base class is needed. Write them in plain NumPy and every filter
takes the model. A model whose methods are also compiled functions (see :class:`MotionFunctions` and
:class:`SensorFunctions`) lets whole runs compile.

Letters: pose (3,) = x [m], y [m], θ [rad]; landmark (2,) = x [m], y [m]; u (m,) control; z (k,) measurement;
dt [s] > 0.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@runtime_checkable
class MotionModel(Protocol):
    """``pose' = move(pose, u + w, dt)`` with w ~ N(0, control_noise), plus N(0, pose_noise) on the pose."""

    def move(self, pose: Array, u: Array, dt: float) -> Array:
        """Pose (3,) after the control u (m,) has acted for dt [s]; the heading need not be wrapped."""
        ...

    def jacobians(self, pose: Array, u: Array, dt: float) -> tuple[Array, Array]:
        """F (3, 3) = ∂move/∂pose and G (3, m) = ∂move/∂u."""
        ...

    def control_noise(self, u: Array, dt: float) -> Array:
        """Covariance (m, m) of the control's noise over this step."""
        ...

    def pose_noise(self, pose: Array, u: Array, dt: float) -> Array:
        """Covariance (3, 3) that the step adds to the pose directly."""
        ...


@runtime_checkable
class SensorModel(Protocol):
    """``z = predict(pose, landmark) + v`` with v ~ N(0, R)."""

    @property
    def R(self) -> Array:  # noqa: N802  (the letter of the mathematics)
        """Measurement noise covariance (k, k)."""
        ...

    def predict(self, pose: Array, landmark: Array) -> Array:
        """The measurement (k,) that this pose would make of this landmark."""
        ...

    def jacobians(self, pose: Array, landmark: Array) -> tuple[Array, Array]:
        """∂z/∂pose (k, 3) and ∂z/∂landmark (k, 2)."""
        ...

    def residual(self, z: Array, z_hat: Array) -> Array:
        """z - z_hat (k,), with angles wrapped to [-π, π)."""
        ...

    def invert(self, pose: Array, z: Array) -> Array:
        """The landmark (2,) for which predict(pose, landmark) is z."""
        ...

    def inverse_jacobians(self, pose: Array, z: Array) -> tuple[Array, Array]:
        """∂invert/∂pose (2, 3) and ∂invert/∂z (2, k)."""
        ...


class MotionFunctions(NamedTuple):
    """A motion model as functions that write into their last arguments, ready to be compiled.

    Each is a Numba function or one wrapped by :func:`slamkit.compiled.compiled`; `params` is the model's
    one-dimensional float64 array. The last may be missing: it does at one blow, and so faster, what the others do.
    """

    move: Callable[..., None]  #: (pose, u, dt, params, out (3,))
    jacobians: Callable[..., None]  #: (pose, u, dt, params, F (3, 3), G (3, m))
    control_noise: Callable[..., None]  #: (u, dt, params, out (m, m))
    pose_noise: Callable[..., None]  #: (pose, u, dt, params, out (3, 3))
    #: (pose, u, dt, params, moved (3,), F (3, 3), G (3, m), control noise (m, m), pose noise (3, 3))
    drive: Callable[..., None] | None = None


class SensorFunctions(NamedTuple):
    """A sensor model as functions that write into their last arguments, ready to be compiled.

    The last may be missing: it does at one blow, and so faster, what `predict`, `residual` and `jacobians` do.
    """

    predict: Callable[..., None]  #: (pose, landmark, params, out (k,))
    jacobians: Callable[..., None]  #: (pose, landmark, params, H_pose (k, 3), H_landmark (k, 2))
    residual: Callable[..., None]  #: (z, z_hat, params, out (k,))
    invert: Callable[..., None]  #: (pose, z, params, out (2,))
    inverse_jacobians: Callable[..., None]  #: (pose, z, params, G_pose (2, 3), G_z (2, k))
    #: (pose, landmark, z, params, z_hat (k,), residual (k,), H_pose (k, 3), H_landmark (k, 2))
    sight: Callable[..., None] | None = None


class LandmarkFilter(Protocol):
    """What every estimator of slamkit offers, whatever filterpy class it derives from."""

    @property
    def pose(self) -> Array: ...
    @property
    def pose_covariance(self) -> Array: ...
    @property
    def landmarks(self) -> Mapping[Hashable, Array]: ...
    def predict(self, u: Any, dt: float) -> None: ...
    def observe(self, landmark_id: Hashable, z: Any) -> None: ...
    def step(self, u: Any, dt: float, scan: Any) -> None: ...
    def run(self, log: Any) -> Any: ...
