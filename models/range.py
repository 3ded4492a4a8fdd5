"""Range alone.

With Δ = l - p the measurement is z = |Δ|. It says nothing of the direction, so it has no inverse.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from math import nan, sqrt
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

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
    refuse_negative_ranges,
)
from slamkit.protocols import SensorFunctions


@compiled(PREDICT)
def distance(pose: Any, landmark: Any, params: Any, out: Any) -> None:
    """z = |l - p|; NaN closer than the smallest range, where the range has no derivative."""
    dx, dy = landmark[0] - pose[0], landmark[1] - pose[1]
    r = sqrt(dx * dx + dy * dy)
    out[0] = nan if r < SMALLEST_RANGE else r


@compiled(SENSOR_JACOBIANS)
def distance_jacobians(pose: Any, landmark: Any, params: Any, H_pose: Any, H_landmark: Any) -> None:
    """∂z/∂(p, θ) = [-Δx/r -Δy/r 0], ∂z/∂l = [Δx/r Δy/r]."""
    dx, dy = landmark[0] - pose[0], landmark[1] - pose[1]
    r = sqrt(dx * dx + dy * dy)
    if r < SMALLEST_RANGE:
        r = nan
    H_landmark[0, 0] = dx / r
    H_landmark[0, 1] = dy / r
    H_pose[0, 0] = -dx / r
    H_pose[0, 1] = -dy / r
    H_pose[0, 2] = 0.0


@compiled(RESIDUAL)
def distance_residual(z: Any, z_hat: Any, params: Any, out: Any) -> None:
    """z - ẑ; NaN if the measured range is negative."""
    out[0] = z[0] - z_hat[0] if z[0] >= 0.0 else nan


@compiled(LINEARISE)
def distance_linearise(
    pose: Any, landmark: Any, z: Any, params: Any, z_hat: Any, y: Any, H_pose: Any, H_landmark: Any
) -> None:
    """`predict`, `residual` and `jacobians` in one. It reads each argument once, before it writes anything."""
    dx, dy, measured = landmark[0] - pose[0], landmark[1] - pose[1], z[0]
    r = sqrt(dx * dx + dy * dy)
    if r < SMALLEST_RANGE:
        r = nan
    a, b = dx / r, dy / r
    z_hat[0], y[0] = r, measured - r if measured >= 0.0 else nan
    H_landmark[0, 0], H_landmark[0, 1] = a, b
    H_pose[0, 0], H_pose[0, 1], H_pose[0, 2] = -a, -b, 0.0


@dataclass(frozen=True)
class Range(CompiledSensor):
    """Range alone: z = (r [m],), such as that of a radio beacon.

    A range does not determine a position, so this sensor has no inverse: neither `invert` nor `inverse_jacobians`.
    A measured range of zero is valid; a landmark closer than 1e-6 m to the robot is refused, because there the range
    has no derivative.

    Parameters
    ----------
    sigma : float
        Standard deviation of the range [m], > 0.

    Raises
    ------
    InputError
        `sigma` is not a finite number > 0.

    References
    ----------
    Thrun, Burgard & Fox, Probabilistic Robotics (2005), section 6.6, first row of equation 6.40.
    """

    sigma: float = field(metadata=parameter("m", typical=0.1))

    functions: ClassVar[SensorFunctions] = SensorFunctions(
        distance, distance_jacobians, distance_residual, linearise=distance_linearise
    )
    columns: ClassVar[tuple[str, ...]] = ("range",)

    def __post_init__(self) -> None:
        object.__setattr__(self, "sigma", noise_parameter("sigma", self.sigma, zero=False))

    @cached_property
    def R(self) -> Array:  # noqa: N802
        """(σ²) [m²]."""
        return frozen(np.array([[self.sigma**2]]))

    def validate(self, z: ArrayLike) -> None:
        """Raise an InputError that names the first measurement (..., 1) with a negative range."""
        refuse_negative_ranges(z)
