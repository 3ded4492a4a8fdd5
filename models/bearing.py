"""Bearing alone.

With Δ = l - p and q = ΔᵀΔ the measurement is z = atan2(Δy, Δx) - θ. It says nothing of the range, so it has no inverse.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from math import atan2, inf, nan
from typing import Any, ClassVar

import numpy as np

from slamkit.arrays import Array
from slamkit.compiled import compiled
from slamkit.models._base import (
    LINEARISE,
    PREDICT,
    RESIDUAL,
    SENSOR_JACOBIANS,
    SMALLEST_RANGE,
    CompiledSensor,
    frozen,
    noise_parameter,
    parameter,
)
from slamkit.protocols import SensorFunctions
from slamkit.se2 import wrap_angle


@compiled(PREDICT)
def bearing(pose: Any, landmark: Any, params: Any, out: Any) -> None:
    """z = atan2(Δy, Δx) - θ; NaN closer than the smallest range, or infinitely far."""
    dx, dy = landmark[0] - pose[0], landmark[1] - pose[1]
    q = dx * dx + dy * dy
    defined = SMALLEST_RANGE * SMALLEST_RANGE <= q < inf
    out[0] = wrap_angle(atan2(dy, dx) - pose[2]) if defined else nan


@compiled(SENSOR_JACOBIANS)
def bearing_jacobians(pose: Any, landmark: Any, params: Any, H_pose: Any, H_landmark: Any) -> None:
    """∂z/∂(p, θ) = [Δy/q -Δx/q -1], ∂z/∂l = [-Δy/q Δx/q]."""
    dx, dy = landmark[0] - pose[0], landmark[1] - pose[1]
    q = dx * dx + dy * dy
    if q < SMALLEST_RANGE * SMALLEST_RANGE:
        q = nan
    H_landmark[0, 0] = -dy / q
    H_landmark[0, 1] = dx / q
    H_pose[0, 0] = dy / q
    H_pose[0, 1] = -dx / q
    H_pose[0, 2] = -1.0


@compiled(RESIDUAL)
def bearing_residual(z: Any, z_hat: Any, params: Any, out: Any) -> None:
    """z - ẑ, wrapped."""
    out[0] = wrap_angle(z[0] - z_hat[0])


@compiled(LINEARISE)
def bearing_linearise(
    pose: Any, landmark: Any, z: Any, params: Any, z_hat: Any, y: Any, H_pose: Any, H_landmark: Any
) -> None:
    """`predict`, `residual` and `jacobians` in one. It reads each argument once, before it writes anything."""
    dx, dy, heading, measured = landmark[0] - pose[0], landmark[1] - pose[1], pose[2], z[0]
    q = dx * dx + dy * dy
    if q < SMALLEST_RANGE * SMALLEST_RANGE:
        q = nan
    expected = wrap_angle(atan2(dy, dx) - heading) if q < inf else nan
    a, b = dy / q, dx / q
    z_hat[0], y[0] = expected, wrap_angle(measured - expected)
    H_landmark[0, 0], H_landmark[0, 1] = -a, b
    H_pose[0, 0], H_pose[0, 1], H_pose[0, 2] = a, -b, -1.0


@dataclass(frozen=True)
class Bearing(CompiledSensor):
    """Bearing alone: z = (β [rad],), counter-clockwise from the robot's x axis, such as that of a camera.

    A bearing does not determine a position, so this sensor has no inverse: neither `invert` nor `inverse_jacobians`.
    A landmark closer than 1e-6 m to the robot has no bearing.

    Parameters
    ----------
    sigma : float
        Standard deviation of the bearing [rad], > 0.

    Raises
    ------
    InputError
        `sigma` is not a finite number > 0.

    References
    ----------
    Thrun, Burgard & Fox, Probabilistic Robotics (2005), section 6.6, second row of equation 6.40.
    """

    sigma: float = field(metadata=parameter("rad", typical=0.035))

    functions: ClassVar[SensorFunctions] = SensorFunctions(
        bearing, bearing_jacobians, bearing_residual, linearise=bearing_linearise
    )
    columns: ClassVar[tuple[str, ...]] = ("bearing",)

    def __post_init__(self) -> None:
        object.__setattr__(self, "sigma", noise_parameter("sigma", self.sigma, zero=False))

    @cached_property
    def R(self) -> Array:  # noqa: N802
        """(σ²) [rad²]."""
        return frozen(np.array([[self.sigma**2]]))
