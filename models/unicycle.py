"""Unicycle models: on the exact arc, and in the first-order (Euler) form.

With a = ω·dt/2 and sinc(a) = sin(a)/a the exact arc is p' = p + v·dt·sinc(a)·(cos(θ+a), sin(θ+a)), θ' = θ + ω·dt.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from math import cos, sin
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from slamkit.arrays import Array, covariance
from slamkit.compiled import compiled
from slamkit.models._base import (
    CONTROL_NOISE,
    MOTION_JACOBIANS,
    MOVE,
    POSE_NOISE,
    PREDICT_ALL,
    CompiledMotion,
    noise_parameter,
    parameter,
)
from slamkit.protocols import MotionFunctions
from slamkit.se2 import wrap_angle


@compiled("real(real)")
def sinc(a: float) -> float:
    """sin(a)/a, and 1 at a = 0. Near 0 a series replaces the quotient; it is exact to rounding."""
    if abs(a) < 1e-2:
        s = a * a
        return 1.0 - s / 6.0 * (1.0 - s / 20.0 * (1.0 - s / 42.0))
    return sin(a) / a


@compiled("real(real)")
def sinc_slope(a: float) -> float:
    """d sinc(a)/da = (a cos a - sin a)/a², and 0 at a = 0."""
    if abs(a) < 1e-1:
        s = a * a
        return -a / 3.0 * (1.0 - s / 10.0 * (1.0 - s / 28.0 * (1.0 - s / 54.0 * (1.0 - s / 88.0))))
    return (a * cos(a) - sin(a)) / (a * a)


@compiled(MOVE)
def arc_move(pose: Any, u: Any, dt: float, params: Any, out: Any) -> None:
    """Move along the exact arc."""
    a = 0.5 * u[1] * dt
    d = u[0] * dt * sinc(a)
    out[0] = pose[0] + d * cos(pose[2] + a)
    out[1] = pose[1] + d * sin(pose[2] + a)
    out[2] = wrap_angle(pose[2] + u[1] * dt)


@compiled(MOTION_JACOBIANS)
def arc_jacobians(pose: Any, u: Any, dt: float, params: Any, F: Any, G: Any) -> None:
    """F = [I, J(p' - p); 0 1] and G = ∂(p', θ')/∂(v, ω) of the exact arc."""
    a = 0.5 * u[1] * dt
    c, s = cos(pose[2] + a), sin(pose[2] + a)
    per_v = dt * sinc(a)
    d = u[0] * per_v
    slope = 0.5 * dt * u[0] * dt * sinc_slope(a)  # ∂d/∂ω
    turn = 0.5 * dt * d  # ∂(θ + a)/∂ω times the chord
    F[:, :] = 0.0
    F[0, 0] = F[1, 1] = F[2, 2] = 1.0
    F[0, 2] = -d * s
    F[1, 2] = d * c
    G[0, 0] = per_v * c
    G[1, 0] = per_v * s
    G[2, 0] = 0.0
    G[0, 1] = slope * c - turn * s
    G[1, 1] = slope * s + turn * c
    G[2, 1] = dt


@compiled(MOVE)
def euler_move(pose: Any, u: Any, dt: float, params: Any, out: Any) -> None:
    """Move straight along the old heading, then turn."""
    out[0] = pose[0] + u[0] * dt * cos(pose[2])
    out[1] = pose[1] + u[0] * dt * sin(pose[2])
    out[2] = wrap_angle(pose[2] + u[1] * dt)


@compiled(MOTION_JACOBIANS)
def euler_jacobians(pose: Any, u: Any, dt: float, params: Any, F: Any, G: Any) -> None:
    """F = [I, J(p' - p); 0 1] and G = ∂(p', θ')/∂(v, ω) of the Euler step."""
    c, s = cos(pose[2]), sin(pose[2])
    F[:, :] = 0.0
    F[0, 0] = F[1, 1] = F[2, 2] = 1.0
    F[0, 2] = -u[0] * dt * s
    F[1, 2] = u[0] * dt * c
    G[:, :] = 0.0
    G[0, 0] = dt * c
    G[1, 0] = dt * s
    G[2, 1] = dt


@compiled(CONTROL_NOISE)
def unicycle_noise(u: Any, dt: float, params: Any, out: Any) -> None:
    """diag(σ_v², σ_ω²)."""
    out[0, 0] = params[0] * params[0]
    out[1, 1] = params[1] * params[1]
    out[0, 1] = out[1, 0] = 0.0


@compiled(POSE_NOISE)
def unicycle_pose_noise(pose: Any, u: Any, dt: float, params: Any, out: Any) -> None:
    """The constant matrix that follows the two standard deviations in `params`."""
    for i in range(3):
        for j in range(3):
            out[i, j] = params[2 + 3 * i + j]


@compiled(PREDICT_ALL)
def arc_predict_all(
    pose: Any, u: Any, dt: float, params: Any, out: Any, F: Any, G: Any, sigma: Any, noise: Any
) -> None:
    """The four functions of the exact arc in one. It reads each argument once, before it writes anything."""
    x, y, heading, v, omega, sigma_v, sigma_omega = pose[0], pose[1], pose[2], u[0], u[1], params[0], params[1]
    a = 0.5 * omega * dt
    c, s, part = cos(heading + a), sin(heading + a), sinc(a)
    d, per_v, slope = v * dt * part, dt * part, 0.5 * dt * v * dt * sinc_slope(a)
    turn = 0.5 * dt * (v * per_v)
    out[0], out[1], out[2] = x + d * c, y + d * s, wrap_angle(heading + omega * dt)
    F[:, :] = 0.0
    F[0, 0] = F[1, 1] = F[2, 2] = 1.0
    F[0, 2], F[1, 2] = -(v * per_v) * s, v * per_v * c
    G[0, 0], G[1, 0], G[2, 0] = per_v * c, per_v * s, 0.0
    G[0, 1], G[1, 1], G[2, 1] = slope * c - turn * s, slope * s + turn * c, dt
    sigma[0, 0], sigma[1, 1] = sigma_v * sigma_v, sigma_omega * sigma_omega
    sigma[0, 1] = sigma[1, 0] = 0.0
    for i in range(3):
        for j in range(3):
            noise[i, j] = params[2 + 3 * i + j]


@dataclass(frozen=True, init=False, repr=False)
class Unicycle(CompiledMotion):
    """Unicycle on an exact arc; the control u = (v [m/s], ω [rad/s]) is constant over dt.

    The model is smooth through ω = 0: it has no threshold below which it drives a straight line instead.

    Parameters
    ----------
    sigma_v : float
        Standard deviation of the speed's noise [m/s], ≥ 0.
    sigma_omega : float
        Standard deviation of the turn rate's noise [rad/s], ≥ 0.
    pose_noise : array_like (3, 3), optional
        Covariance [m², m·rad, rad²] added to the pose at every step, independent of its duration; zero by default.

    Raises
    ------
    InputError
        A standard deviation is not a finite number ≥ 0, or `pose_noise` is not symmetric positive semidefinite.

    References
    ----------
    Thrun, Burgard & Fox, Probabilistic Robotics (2005), equation 5.9, written with sinc instead of v/ω.
    """

    sigma_v: float = field(metadata=parameter("m/s", typical=0.1))
    sigma_omega: float = field(metadata=parameter("rad/s", typical=0.1))
    pose_covariance: tuple[tuple[float, ...], ...]  #: the rows of `pose_noise`

    functions: ClassVar[MotionFunctions] = MotionFunctions(
        arc_move, arc_jacobians, unicycle_noise, unicycle_pose_noise, arc_predict_all
    )
    control_dim: ClassVar[int] = 2
    columns: ClassVar[tuple[str, ...]] = ("v", "omega")

    def __init__(self, sigma_v: float, sigma_omega: float, pose_noise: ArrayLike | None = None) -> None:
        extra = np.zeros((3, 3)) if pose_noise is None else covariance("pose_noise", pose_noise, 3)
        object.__setattr__(self, "sigma_v", noise_parameter("sigma_v", sigma_v, zero=True))
        object.__setattr__(self, "sigma_omega", noise_parameter("sigma_omega", sigma_omega, zero=True))
        object.__setattr__(self, "pose_covariance", tuple(tuple(row) for row in extra.tolist()))

    @cached_property
    def params(self) -> Array:
        """(σ_v, σ_ω, pose noise row by row)."""
        return np.concatenate([[self.sigma_v, self.sigma_omega], np.ravel(self.pose_covariance)])

    def arguments(self) -> dict[str, Any]:
        """The constructor's arguments."""
        return {"sigma_v": self.sigma_v, "sigma_omega": self.sigma_omega, "pose_noise": self.pose_covariance}

    def __repr__(self) -> str:
        shown = {n: v for n, v in self.arguments().items() if n != "pose_noise" or np.any(v)}
        return f"{type(self).__name__}({', '.join(f'{n}={v!r}' for n, v in shown.items())})"


@dataclass(frozen=True, init=False, repr=False)
class EulerUnicycle(Unicycle):
    """Unicycle that moves straight along its old heading, then turns: the first-order form of :class:`Unicycle`.

    It has the same control, parameters and errors as :class:`Unicycle`. This is the textbook's simplification. Its
    direction is wrong by O(ω·dt), so prefer :class:`Unicycle` unless you compare with results of this model.
    """

    functions: ClassVar[MotionFunctions] = MotionFunctions(
        euler_move, euler_jacobians, unicycle_noise, unicycle_pose_noise
    )
    columns: ClassVar[tuple[str, ...]] = ()
