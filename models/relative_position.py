"""Relative position: the landmark in robot axes.

With Δ = l - p, C = R(θ) and b = CᵀΔ (the landmark in robot axes), the measurement is z = h(b). Therefore
H_landmark = H_b Cᵀ and H_pose = -H_b Cᵀ[I, J Δ] with H_b = ∂h/∂b.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from math import cos, sin
from typing import Any, ClassVar

import numpy as np

from slamkit.arrays import Array
from slamkit.compiled import compiled
from slamkit.models._base import (
    INVERSE_JACOBIANS,
    INVERT,
    LINEARISE,
    PREDICT,
    RESIDUAL,
    SENSOR_JACOBIANS,
    CompiledSensor,
    frozen,
    noise_parameter,
    parameter,
)
from slamkit.protocols import SensorFunctions


@compiled(PREDICT)
def relative_position(pose: Any, landmark: Any, params: Any, out: Any) -> None:
    """z = Cᵀ(l - p)."""
    dx, dy = landmark[0] - pose[0], landmark[1] - pose[1]
    c, s = cos(pose[2]), sin(pose[2])
    out[0] = c * dx + s * dy
    out[1] = c * dy - s * dx


@compiled(SENSOR_JACOBIANS)
def relative_position_jacobians(pose: Any, landmark: Any, params: Any, H_pose: Any, H_landmark: Any) -> None:
    """∂z/∂(p, θ) = -Cᵀ[I, J(l - p)], ∂z/∂l = Cᵀ."""
    dx, dy = landmark[0] - pose[0], landmark[1] - pose[1]
    c, s = cos(pose[2]), sin(pose[2])
    H_landmark[0, 0] = H_landmark[1, 1] = c
    H_landmark[0, 1] = s
    H_landmark[1, 0] = -s
    H_pose[0, 0] = H_pose[1, 1] = -c
    H_pose[0, 1] = -s
    H_pose[1, 0] = s
    H_pose[0, 2] = c * dy - s * dx
    H_pose[1, 2] = -c * dx - s * dy


@compiled(RESIDUAL)
def difference(z: Any, z_hat: Any, params: Any, out: Any) -> None:
    """z - ẑ."""
    out[0] = z[0] - z_hat[0]
    out[1] = z[1] - z_hat[1]


@compiled(INVERT)
def relative_position_invert(pose: Any, z: Any, params: Any, out: Any) -> None:
    """l = p + C z."""
    c, s = cos(pose[2]), sin(pose[2])
    out[0] = pose[0] + c * z[0] - s * z[1]
    out[1] = pose[1] + s * z[0] + c * z[1]


@compiled(INVERSE_JACOBIANS)
def relative_position_inverse_jacobians(pose: Any, z: Any, params: Any, G_pose: Any, G_z: Any) -> None:
    """∂l/∂(p, θ) = [I, J(l - p)], ∂l/∂z = C."""
    c, s = cos(pose[2]), sin(pose[2])
    G_pose[0, 0] = G_pose[1, 1] = 1.0
    G_pose[0, 1] = G_pose[1, 0] = 0.0
    G_pose[0, 2] = -(s * z[0] + c * z[1])
    G_pose[1, 2] = c * z[0] - s * z[1]
    G_z[0, 0] = G_z[1, 1] = c
    G_z[0, 1] = -s
    G_z[1, 0] = s


@compiled(LINEARISE)
def relative_position_linearise(
    pose: Any, landmark: Any, z: Any, params: Any, z_hat: Any, y: Any, H_pose: Any, H_landmark: Any
) -> None:
    """`predict`, `residual` and `jacobians` in one, with one sine and one cosine."""
    dx, dy = landmark[0] - pose[0], landmark[1] - pose[1]
    c, s = cos(pose[2]), sin(pose[2])
    z_hat[0], z_hat[1] = c * dx + s * dy, c * dy - s * dx
    y[0], y[1] = z[0] - z_hat[0], z[1] - z_hat[1]
    H_landmark[0, 0] = H_landmark[1, 1] = c
    H_landmark[0, 1], H_landmark[1, 0] = s, -s
    H_pose[0, 0] = H_pose[1, 1] = -c
    H_pose[0, 1], H_pose[1, 0] = -s, s
    H_pose[0, 2], H_pose[1, 2] = z_hat[1], -z_hat[0]


@dataclass(frozen=True)
class RelativePosition(CompiledSensor):
    """The landmark's position in robot axes: z = Cᵀ(l - p) [m, m]. It is defined everywhere, even at range zero.

    Parameters
    ----------
    sigma : float
        Standard deviation of each coordinate [m], > 0.

    Raises
    ------
    InputError
        `sigma` is not a finite number > 0.

    References
    ----------
    Huang, Mourikis & Roumeliotis, IJRR 29(5):502-528 (2010), equation 9.
    """

    sigma: float = field(metadata=parameter("m", typical=0.1))

    functions: ClassVar[SensorFunctions] = SensorFunctions(
        relative_position,
        relative_position_jacobians,
        difference,
        relative_position_invert,
        relative_position_inverse_jacobians,
        relative_position_linearise,
    )
    columns: ClassVar[tuple[str, ...]] = ("x", "y")

    def __post_init__(self) -> None:
        object.__setattr__(self, "sigma", noise_parameter("sigma", self.sigma, zero=False))

    @cached_property
    def R(self) -> Array:  # noqa: N802
        """σ² I₂ [m²]."""
        return frozen(np.eye(2) * self.sigma**2)
