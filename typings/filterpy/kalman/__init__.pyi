"""The part of filterpy.kalman 2.0 that slamkit derives from or compares itself with."""

from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

_Array: TypeAlias = NDArray[np.float64]
_Binary: TypeAlias = Callable[[Any, Any], Any]
_Mean: TypeAlias = Callable[[_Array, _Array], _Array]
_Root: TypeAlias = Callable[[_Array], _Array]
_Transform: TypeAlias = Callable[..., tuple[_Array, _Array]]

class _SigmaPoints(Protocol):
    @property
    def Wm(self) -> _Array: ...
    @property
    def Wc(self) -> _Array: ...
    def num_sigmas(self) -> int: ...
    def sigma_points(self, x: Any, P: Any) -> _Array: ...

def unscented_transform(
    sigmas: _Array,
    Wm: _Array,
    Wc: _Array,
    noise_cov: _Array | None = None,
    mean_fn: _Mean | None = None,
    residual_fn: _Binary | None = None,
) -> tuple[_Array, _Array]: ...

class MerweScaledSigmaPoints:
    n: int
    alpha: float
    beta: float
    kappa: float
    sqrt: _Root
    subtract: _Binary
    Wm: _Array
    Wc: _Array
    def __init__(
        self,
        n: int,
        alpha: float,
        beta: float,
        kappa: float,
        sqrt_method: _Root | None = None,
        subtract: _Binary | None = None,
    ) -> None: ...
    def num_sigmas(self) -> int: ...
    def sigma_points(self, x: ArrayLike, P: ArrayLike) -> _Array: ...
    def _compute_weights(self) -> None: ...

class JulierSigmaPoints:
    n: int
    kappa: float
    sqrt: _Root
    subtract: _Binary
    Wm: _Array
    Wc: _Array
    def __init__(
        self, n: int, kappa: float = 0.0, sqrt_method: _Root | None = None, subtract: _Binary | None = None
    ) -> None: ...
    def num_sigmas(self) -> int: ...
    def sigma_points(self, x: ArrayLike, P: ArrayLike) -> _Array: ...
    def _compute_weights(self) -> None: ...

class KalmanFilter:
    dim_x: int
    dim_z: int
    dim_u: int
    x: _Array
    P: _Array
    Q: _Array
    B: _Array | None
    F: _Array
    H: _Array
    R: _Array
    M: _Array
    z: Any
    K: _Array
    y: _Array
    S: _Array
    SI: _Array
    x_prior: _Array
    P_prior: _Array
    x_post: _Array
    P_post: _Array
    inv: _Root
    alpha: float
    _alpha_sq: float
    _I: _Array
    _log_likelihood: float | None
    _likelihood: float | None
    _mahalanobis: float | None
    def __init__(self, dim_x: int, dim_z: int, dim_u: int = 0) -> None: ...
    def predict(
        self,
        u: ArrayLike | None = None,
        B: _Array | None = None,
        F: _Array | None = None,
        Q: _Array | float | None = None,
    ) -> None: ...
    def update(self, z: ArrayLike | None, R: _Array | float | None = None, H: _Array | None = None) -> None: ...
    @property
    def log_likelihood(self) -> float: ...
    @property
    def likelihood(self) -> float: ...
    @property
    def mahalanobis(self) -> float: ...

class ExtendedKalmanFilter:
    dim_x: int
    dim_z: int
    dim_u: int
    x: _Array
    P: _Array
    B: _Array | float
    F: _Array
    R: _Array
    Q: _Array
    z: Any
    K: _Array
    y: _Array
    S: _Array
    SI: _Array
    x_prior: _Array
    P_prior: _Array
    x_post: _Array
    P_post: _Array
    _I: _Array
    _log_likelihood: float | None
    _likelihood: float | None
    _mahalanobis: float | None
    def __init__(self, dim_x: int, dim_z: int, dim_u: int = 0) -> None: ...
    def predict_update(
        self,
        z: ArrayLike,
        HJacobian: Callable[..., _Array],
        Hx: Callable[..., Any],
        args: Any = (),
        hx_args: Any = (),
        u: ArrayLike = 0,
    ) -> None: ...
    def update(
        self,
        z: ArrayLike | None,
        HJacobian: Callable[..., _Array],
        Hx: Callable[..., Any],
        R: _Array | float | None = None,
        args: Any = (),
        hx_args: Any = (),
        residual: _Binary = ...,
    ) -> None: ...
    def predict_x(self, u: ArrayLike = 0) -> None: ...
    def predict(self, u: ArrayLike = 0) -> None: ...
    @property
    def log_likelihood(self) -> float: ...
    @property
    def likelihood(self) -> float: ...
    @property
    def mahalanobis(self) -> float: ...

class UnscentedKalmanFilter:
    x: _Array
    P: _Array
    Q: _Array
    R: _Array
    z: Any
    K: _Array
    y: _Array
    S: _Array
    SI: _Array
    x_prior: _Array
    P_prior: _Array
    x_post: _Array
    P_post: _Array
    points_fn: _SigmaPoints
    Wm: _Array
    Wc: _Array
    sigmas_f: _Array
    sigmas_h: _Array
    hx: Callable[..., Any]
    fx: Callable[..., Any]
    x_mean: _Mean | None
    z_mean: _Mean | None
    residual_x: _Binary
    residual_z: _Binary
    state_add: _Binary
    msqrt: _Root
    inv: _Root
    _dim_x: int
    _dim_z: int
    _dt: float
    _num_sigmas: int
    _log_likelihood: float | None
    _likelihood: float | None
    _mahalanobis: float | None
    def __init__(
        self,
        dim_x: int,
        dim_z: int,
        dt: float,
        hx: Callable[..., Any],
        fx: Callable[..., Any],
        points: _SigmaPoints,
        sqrt_fn: _Root | None = None,
        x_mean_fn: _Mean | None = None,
        z_mean_fn: _Mean | None = None,
        residual_x: _Binary | None = None,
        residual_z: _Binary | None = None,
        state_add: _Binary | None = None,
    ) -> None: ...
    def predict(
        self,
        dt: float | None = None,
        UT: _Transform | None = None,
        fx: Callable[..., Any] | None = None,
        **fx_args: Any,
    ) -> None: ...
    def update(
        self,
        z: ArrayLike | None,
        R: _Array | float | None = None,
        UT: _Transform | None = None,
        hx: Callable[..., Any] | None = None,
        **hx_args: Any,
    ) -> None: ...
    def cross_variance(self, x: _Array, z: _Array, sigmas_f: _Array, sigmas_h: _Array) -> _Array: ...
    def compute_process_sigmas(self, dt: float, fx: Callable[..., Any] | None = None, **fx_args: Any) -> None: ...
    def batch_filter(
        self,
        zs: Sequence[Any],
        Rs: Sequence[_Array] | None = None,
        dts: Sequence[float] | None = None,
        UT: _Transform | None = None,
        saver: Any = None,
    ) -> tuple[_Array, _Array]: ...
    def rts_smoother(
        self,
        Xs: _Array,
        Ps: _Array,
        Qs: Sequence[_Array] | None = None,
        dts: float | Sequence[float] | None = None,
        UT: _Transform | None = None,
    ) -> tuple[_Array, _Array, _Array]: ...
    @property
    def log_likelihood(self) -> float: ...
    @property
    def likelihood(self) -> float: ...
    @property
    def mahalanobis(self) -> float: ...
