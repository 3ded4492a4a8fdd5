"""What a motion model, a sensor model and a landmark filter must offer.

A model is any object with these methods; no base class is needed. Write them in plain NumPy, and every filter
accepts the model. If the model also offers its methods as compiled functions (see :class:`MotionFunctions` and
:class:`SensorFunctions`), whole runs are compiled.

Letters: pose (3,) = x [m], y [m], θ [rad]; landmark (2,) = x [m], y [m]; u (m,) control; z (k,) measurement;
dt [s] > 0.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from slamkit.arrays import Array
from slamkit.compiled import Compiled
from slamkit.errors import ModelError


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
        """The measurement (k,) of this landmark that is expected at this pose."""
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
    """A motion model as compiled functions that write into their last arguments.

    Each one is decorated with ``numba.njit`` or :func:`slamkit.compiled.compiled`. `params` is the model's
    one-dimensional float64 array.
    """

    move: Callable[..., None]  #: (pose, u, dt, params, out (3,))
    jacobians: Callable[..., None]  #: (pose, u, dt, params, F (3, 3), G (3, m))
    control_noise: Callable[..., None]  #: (u, dt, params, out (m, m))
    pose_noise: Callable[..., None]  #: (pose, u, dt, params, out (3, 3))
    #: Optional: a fused version of the other four functions, for speed.
    #: (pose, u, dt, params, moved (3,), F (3, 3), G (3, m), control noise (m, m), pose noise (3, 3))
    predict_all: Callable[..., None] | None = None


class SensorFunctions(NamedTuple):
    """A sensor model as compiled functions that write into their last arguments.

    Each one is decorated with ``numba.njit`` or :func:`slamkit.compiled.compiled`. `params` is the model's
    one-dimensional float64 array.
    """

    predict: Callable[..., None]  #: (pose, landmark, params, out (k,))
    jacobians: Callable[..., None]  #: (pose, landmark, params, H_pose (k, 3), H_landmark (k, 2))
    residual: Callable[..., None]  #: (z, z_hat, params, out (k,))
    invert: Callable[..., None]  #: (pose, z, params, out (2,))
    inverse_jacobians: Callable[..., None]  #: (pose, z, params, G_pose (2, 3), G_z (2, k))
    #: Optional: a fused version of `predict`, `residual` and `jacobians`, for speed.
    #: (pose, landmark, z, params, z_hat (k,), residual (k,), H_pose (k, 3), H_landmark (k, 2))
    linearise: Callable[..., None] | None = None


class LandmarkFilter(Protocol):
    """What every estimator of slamkit offers, whichever filterpy class it derives from."""

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


#: The methods of each protocol.
METHODS: dict[Any, tuple[str, ...]] = {
    MotionModel: ("move", "jacobians", "control_noise", "pose_noise"),
    SensorModel: ("predict", "jacobians", "residual", "invert", "inverse_jacobians"),
}
#: The optional function among the compiled functions of each protocol.
_FUSED: dict[Any, str] = {MotionModel: "predict_all", SensorModel: "linearise"}
_HOW = "one decorated with numba.njit or slamkit.compiled.compiled"


def require_model(model: object, protocol: type, what: str) -> None:
    """Check that an object is a model that a filter can use.

    Parameters
    ----------
    model : object
        What was given.
    protocol : type
        :class:`MotionModel` or :class:`SensorModel`.
    what : str
        What a message calls it, such as ``"motion"``.

    Raises
    ------
    ModelError
        It is a class instead of an instance, lacks a method, has an attribute in place of a method, or its
        `functions` or `params` are not what compiled code can use. The message says what was given and what was
        expected.
    """
    expected = f"see slamkit.protocols.{protocol.__name__}"
    if isinstance(model, type):
        raise ModelError(f"{what} is the class {model.__name__}, expected an instance: {model.__name__}(…)")
    name, methods = type(model).__name__, METHODS[protocol]
    needed = methods if protocol is MotionModel else ("R", *methods)
    missing = [n for n in needed if not hasattr(model, n)]
    if missing:
        raise ModelError(f"{what} is a {name}, which has no {', '.join(missing)}: {expected}")
    for method in methods:
        if not callable(value := getattr(model, method)):
            raise ModelError(f"{what} is a {name} whose {method} is {_described(value)}, expected a method: {expected}")
    functions = getattr(model, "functions", None)
    if functions is None:
        return
    for function in (*methods, _FUSED[protocol]):
        value = getattr(functions, function, None)
        if value is None and function == _FUSED[protocol]:
            continue
        if not is_compiled(value):
            given = "missing" if value is None else _described(value)
            raise ModelError(f"{what} is a {name} whose functions.{function} is {given}, expected {_HOW}")
    params = np.asarray(getattr(model, "params", ()))
    if params.ndim != 1 or params.dtype.kind not in "fiub":
        raise ModelError(f"{what} is a {name} whose params is {_described(params)}, expected a vector of real numbers")


def is_compiled(function: object) -> bool:
    """Whether compiled code can call this: a Numba function, or one of :func:`slamkit.compiled.compiled`."""
    # `py_func` tells a Numba function without an import of Numba.
    return isinstance(function, Compiled) or (callable(function) and hasattr(function, "py_func"))


def _described(value: object) -> str:
    if callable(value):
        return f"the plain Python function {getattr(value, '__name__', type(value).__name__)}"
    return " ".join(repr(value).split())[:80]
