"""Odometry as turn, drive, turn."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from math import atan2, cos, hypot, pi, sin
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from slamkit import se2
from slamkit.arrays import Array, finite_array
from slamkit.compiled import compiled
from slamkit.models._base import (
    CONTROL_NOISE,
    MOTION_JACOBIANS,
    MOVE,
    PREDICT_ALL,
    CompiledMotion,
    no_pose_noise,
    noise_parameter,
    parameter,
)
from slamkit.protocols import MotionFunctions
from slamkit.se2 import wrap_angle


@compiled(MOVE)
def odometry_move(pose: Any, u: Any, dt: float, params: Any, out: Any) -> None:
    """Turn by rot1, drive by trans, turn by rot2."""
    out[0] = pose[0] + u[1] * cos(pose[2] + u[0])
    out[1] = pose[1] + u[1] * sin(pose[2] + u[0])
    out[2] = wrap_angle(pose[2] + u[0] + u[2])


@compiled(MOTION_JACOBIANS)
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


@compiled(PREDICT_ALL)
def odometry_predict_all(
    pose: Any, u: Any, dt: float, params: Any, out: Any, F: Any, G: Any, sigma: Any, noise: Any
) -> None:
    """The four functions in one, with one sine and one cosine."""
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
        A parameter is not a finite number ≥ 0.

    References
    ----------
    Thrun, Burgard & Fox, Probabilistic Robotics (2005), table 5.6.
    """

    alpha1: float = field(metadata=parameter("rad²/rad²", typical=0.05))
    alpha2: float = field(metadata=parameter("rad²/m²", typical=0.01))
    alpha3: float = field(metadata=parameter("m²/m²", typical=0.05))
    alpha4: float = field(metadata=parameter("m²/rad²", typical=0.01))

    functions: ClassVar[MotionFunctions] = MotionFunctions(
        odometry_move, odometry_jacobians, odometry_noise, no_pose_noise, odometry_predict_all
    )
    control_dim: ClassVar[int] = 3
    columns: ClassVar[tuple[str, ...]] = ("rot1", "trans", "rot2")

    def __post_init__(self) -> None:
        for name in ("alpha1", "alpha2", "alpha3", "alpha4"):
            object.__setattr__(self, name, noise_parameter(name, getattr(self, name), zero=True))

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
            (δ_rot1, δ_trans, δ_rot2). If the robot reverses, δ_trans is negative and δ_rot1 is not near π:
            |δ_rot1| ≤ π/2. A translation below 1e-9 m has no direction; then δ_rot1 is 0.

        Raises
        ------
        InputError
            A pose has a wrong shape or is not finite.
        """
        a, b = finite_array("before", before, (3,)), finite_array("after", after, (3,))
        dx, dy, turn = se2.between(a, b)
        trans = hypot(dx, dy)
        if trans < 1e-9:
            return np.array([0.0, trans, turn])
        first = atan2(dy, dx)
        if abs(first) > pi / 2:
            first, trans = float(se2.wrap(first + pi)), -trans
        return np.array([first, trans, float(se2.wrap(turn - first))])
