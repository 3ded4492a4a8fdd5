"""Motion models: unicycle (exact arc and Euler) and odometry.

Each is ``pose' = move(pose, u + w, dt)`` with w ~ N(0, control_noise), plus N(0, pose_noise) on the pose.
With a = ω·dt/2 and sinc(a) = sin(a)/a the exact arc is p' = p + v·dt·sinc(a)·(cos(θ+a), sin(θ+a)), θ' = θ + ω·dt.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import atan2, cos, hypot, pi, sin
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slamkit import se2
from slamkit.compiled import compiled
from slamkit.errors import InputError
from slamkit.models._base import CompiledMotion, covariance, standard_deviation, vector
from slamkit.protocols import MotionFunctions
from slamkit.se2 import wrap_angle

Array = NDArray[np.float64]
MOVE = "void(vector, vector, real, vector, vector)"
JACOBIANS = "void(vector, vector, real, vector, matrix, matrix)"
CONTROL_NOISE = "void(vector, real, vector, matrix)"
POSE_NOISE = "void(vector, vector, real, vector, matrix)"
DRIVE = "void(vector, vector, real, vector, vector, matrix, matrix, matrix, matrix)"


@compiled("real(real)")
def sinc(a: float) -> float:
    """sin(a)/a, continued by 1 at 0. The series is exact to rounding where the quotient is 0/0 or close to it."""
    if abs(a) < 1e-2:
        s = a * a
        return 1.0 - s / 6.0 * (1.0 - s / 20.0 * (1.0 - s / 42.0))
    return sin(a) / a


@compiled("real(real)")
def sinc_slope(a: float) -> float:
    """d sinc(a)/da = (a cos a - sin a)/a², continued by 0 at 0."""
    if abs(a) < 1e-1:
        s = a * a
        return -a / 3.0 * (1.0 - s / 10.0 * (1.0 - s / 28.0 * (1.0 - s / 54.0 * (1.0 - s / 88.0))))
    return (a * cos(a) - sin(a)) / (a * a)


@compiled(MOVE)
def arc_move(pose: Any, u: Any, dt: float, params: Any, out: Any) -> None:
    """Exact arc."""
    a = 0.5 * u[1] * dt
    d = u[0] * dt * sinc(a)
    out[0] = pose[0] + d * cos(pose[2] + a)
    out[1] = pose[1] + d * sin(pose[2] + a)
    out[2] = wrap_angle(pose[2] + u[1] * dt)


@compiled(JACOBIANS)
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
    """Straight line along the old heading."""
    out[0] = pose[0] + u[0] * dt * cos(pose[2])
    out[1] = pose[1] + u[0] * dt * sin(pose[2])
    out[2] = wrap_angle(pose[2] + u[1] * dt)


@compiled(JACOBIANS)
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
    """The constant matrix behind the two standard deviations."""
    for i in range(3):
        for j in range(3):
            out[i, j] = params[2 + 3 * i + j]


@compiled(DRIVE)
def arc_drive(pose: Any, u: Any, dt: float, params: Any, out: Any, F: Any, G: Any, sigma: Any, noise: Any) -> None:
    """All of the exact arc, to the bit; each argument is read once, before anything is written."""
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


@dataclass(frozen=True, init=False)
class Unicycle(CompiledMotion):
    """Unicycle on an exact arc; control u = (v [m/s], ω [rad/s]) held over dt.

    Smooth through ω = 0: there is no threshold at which a straight line takes over.

    Parameters
    ----------
    sigma_v : float
        Standard deviation of the speed's noise [m/s], ≥ 0.
    sigma_omega : float
        Standard deviation of the turn rate's noise [rad/s], ≥ 0.
    pose_noise : array_like (3, 3), optional
        Covariance [m², m·rad, rad²] added to the pose at every step, whatever its duration; none by default.

    Raises
    ------
    InputError
        A standard deviation is negative or not finite, or `pose_noise` is not symmetric positive semidefinite.

    References
    ----------
    Thrun, Burgard & Fox, Probabilistic Robotics (2005), equation 5.9, written with sinc instead of v/ω.
    """

    sigma_v: float
    sigma_omega: float
    pose_covariance: tuple[tuple[float, ...], ...]  #: `pose_noise` as it was given

    functions: ClassVar[MotionFunctions] = MotionFunctions(  # type: ignore[misc]
        arc_move, arc_jacobians, unicycle_noise, unicycle_pose_noise, arc_drive
    )
    control_dim: ClassVar[int] = 2  # type: ignore[misc]

    def __init__(self, sigma_v: float, sigma_omega: float, pose_noise: ArrayLike | None = None) -> None:
        extra = np.zeros((3, 3)) if pose_noise is None else covariance("pose_noise", pose_noise, 3)
        object.__setattr__(self, "sigma_v", standard_deviation("sigma_v", sigma_v, zero=True))
        object.__setattr__(self, "sigma_omega", standard_deviation("sigma_omega", sigma_omega, zero=True))
        object.__setattr__(self, "pose_covariance", tuple(tuple(row) for row in extra.tolist()))

    @cached_property
    def params(self) -> Array:
        """(σ_v, σ_ω, pose noise row by row)."""
        return np.concatenate([[self.sigma_v, self.sigma_omega], np.ravel(self.pose_covariance)])


@dataclass(frozen=True, init=False)
class EulerUnicycle(Unicycle):
    """Unicycle that moves straight along its old heading, then turns: the first-order form of :class:`Unicycle`.

    Same control, parameters and errors. The textbook's simplification; it errs by O(ω·dt) in direction, so prefer
    :class:`Unicycle` unless you compare with results that were made with it.
    """

    functions: ClassVar[MotionFunctions] = MotionFunctions(  # type: ignore[misc]
        euler_move, euler_jacobians, unicycle_noise, unicycle_pose_noise
    )


@compiled(MOVE)
def odometry_move(pose: Any, u: Any, dt: float, params: Any, out: Any) -> None:
    """Turn, drive, turn."""
    out[0] = pose[0] + u[1] * cos(pose[2] + u[0])
    out[1] = pose[1] + u[1] * sin(pose[2] + u[0])
    out[2] = wrap_angle(pose[2] + u[0] + u[2])


@compiled(JACOBIANS)
def odometry_jacobians(pose: Any, u: Any, dt: float, params: Any, F: Any, G: Any) -> None:
    """F = [I, J(p' - p); 0 1], G = ∂(p', θ')/∂(rot1, trans, rot2)."""
    c, s = cos(pose[2] + u[0]), sin(pose[2] + u[0])
    F[:, :] = 0.0
    F[0, 0] = F[1, 1] = F[2, 2] = 1.0
    F[0, 2] = G[0, 0] = -u[1] * s
    F[1, 2] = G[1, 0] = u[1] * c
    G[0, 1] = c
    G[1, 1] = s
    G[2, 1] = 0.0
    G[0, 2] = G[1, 2] = 0.0
    G[2, 0] = G[2, 2] = 1.0


@compiled(CONTROL_NOISE)
def odometry_noise(u: Any, dt: float, params: Any, out: Any) -> None:
    """Variances of Thrun, Burgard & Fox (2005), table 5.6."""
    first, trans, second = u[0] * u[0], u[1] * u[1], u[2] * u[2]
    out[:, :] = 0.0
    out[0, 0] = params[0] * first + params[1] * trans
    out[1, 1] = params[2] * trans + params[3] * (first + second)
    out[2, 2] = params[0] * second + params[1] * trans


@compiled(POSE_NOISE)
def no_pose_noise(pose: Any, u: Any, dt: float, params: Any, out: Any) -> None:
    """Zero: all the noise is in the control."""
    out[:, :] = 0.0


@compiled(DRIVE)
def odometry_drive(pose: Any, u: Any, dt: float, params: Any, out: Any, F: Any, G: Any, sigma: Any, noise: Any) -> None:
    """All of them, with one sine and cosine."""
    heading, rot1, trans, rot2 = pose[2], u[0], u[1], u[2]
    c, s = cos(heading + rot1), sin(heading + rot1)
    out[0], out[1] = pose[0] + trans * c, pose[1] + trans * s
    out[2] = wrap_angle(heading + rot1 + rot2)
    odometry_noise(u, dt, params, sigma)
    no_pose_noise(pose, u, dt, params, noise)
    F[:, :] = 0.0
    F[0, 0] = F[1, 1] = F[2, 2] = 1.0
    F[0, 2] = G[0, 0] = -trans * s
    F[1, 2] = G[1, 0] = trans * c
    G[0, 1], G[1, 1], G[2, 1] = c, s, 0.0
    G[0, 2] = G[1, 2] = 0.0
    G[2, 0] = G[2, 2] = 1.0


@dataclass(frozen=True)
class Odometry(CompiledMotion):
    """Odometry as turn, drive, turn; control u = (δ_rot1 [rad], δ_trans [m], δ_rot2 [rad]) over the whole step.

    Variances: α₁δ_rot1² + α₂δ_trans², α₃δ_trans² + α₄(δ_rot1² + δ_rot2²), α₁δ_rot2² + α₂δ_trans².

    Parameters
    ----------
    alpha1 : float
        Rotation variance by rotation [rad²/rad²], ≥ 0.
    alpha2 : float
        Rotation variance by translation [rad²/m²], ≥ 0.
    alpha3 : float
        Translation variance by translation [m²/m²], ≥ 0.
    alpha4 : float
        Translation variance by rotation [m²/rad²], ≥ 0.

    Raises
    ------
    InputError
        A parameter is negative or not finite.

    References
    ----------
    Thrun, Burgard & Fox, Probabilistic Robotics (2005), table 5.6.
    """

    alpha1: float
    alpha2: float
    alpha3: float
    alpha4: float

    functions: ClassVar[MotionFunctions] = MotionFunctions(  # type: ignore[misc]
        odometry_move, odometry_jacobians, odometry_noise, no_pose_noise, odometry_drive
    )
    control_dim: ClassVar[int] = 3  # type: ignore[misc]

    def __post_init__(self) -> None:
        for name in ("alpha1", "alpha2", "alpha3", "alpha4"):
            object.__setattr__(self, name, standard_deviation(name, getattr(self, name), zero=True))

    @cached_property
    def params(self) -> Array:
        """(α₁, α₂, α₃, α₄)."""
        return np.array([self.alpha1, self.alpha2, self.alpha3, self.alpha4])

    @staticmethod
    def control_between(before: ArrayLike, after: ArrayLike) -> Array:
        """The control (3,) that leads from one odometry pose to the next.

        Parameters
        ----------
        before, after : array_like (3,)
            Consecutive odometry poses [m, m, rad], in the odometry's own frame.

        Returns
        -------
        ndarray (3,)
            (δ_rot1, δ_trans, δ_rot2). A robot in reverse gets a negative δ_trans instead of a δ_rot1 near π, so
            |δ_rot1| ≤ π/2; a translation below 1e-9 m has no direction, so δ_rot1 = 0.

        Raises
        ------
        InputError
            A pose has a wrong shape or is not finite.
        """
        a, b = vector("before", before, 3), vector("after", after, 3)
        for name, pose in (("before", a), ("after", b)):
            if not np.all(np.isfinite(pose)):
                raise InputError(f"{name} is {pose}, expected a finite pose")
        dx, dy, turn = se2.between(a, b)
        trans = hypot(dx, dy)
        if trans < 1e-9:
            return np.array([0.0, trans, turn])
        first = atan2(dy, dx)
        if abs(first) > pi / 2:
            first, trans = float(se2.wrap(first + pi)), -trans
        return np.array([first, trans, float(se2.wrap(turn - first))])
