"""Range and bearing.

With Δ = l - p, C = R(θ) and b = CᵀΔ (the landmark in robot axes), the measurement is z = h(b). Therefore
H_landmark = H_b Cᵀ and H_pose = -H_b Cᵀ[I, J Δ] with H_b = ∂h/∂b.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from math import atan2, cos, nan, sin, sqrt
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from slamkit.arrays import Array
from slamkit.compiled import compiled
from slamkit.errors import InputError
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
from slamkit.se2 import wrap_angle

#: A landmark closer than this [m] has no bearing.
SMALLEST_RANGE = 1e-6


@compiled(PREDICT)
def range_bearing(pose: Any, landmark: Any, params: Any, out: Any) -> None:
    """z = (r, atan2(Δy, Δx) - θ); NaN closer than the smallest range, where there is no bearing."""
    dx, dy = landmark[0] - pose[0], landmark[1] - pose[1]
    r = sqrt(dx * dx + dy * dy)
    if r < SMALLEST_RANGE:
        r = nan
    out[0] = r
    out[1] = wrap_angle(atan2(dy, dx) - pose[2])


@compiled(SENSOR_JACOBIANS)
def range_bearing_jacobians(pose: Any, landmark: Any, params: Any, H_pose: Any, H_landmark: Any) -> None:
    """∂z/∂(p, θ) = [-Δx/r -Δy/r 0; Δy/q -Δx/q -1], ∂z/∂l = [Δx/r Δy/r; -Δy/q Δx/q], q = r²."""
    dx, dy = landmark[0] - pose[0], landmark[1] - pose[1]
    q = dx * dx + dy * dy
    r = sqrt(q)
    if r < SMALLEST_RANGE:
        r = q = nan
    H_landmark[0, 0] = dx / r
    H_landmark[0, 1] = dy / r
    H_landmark[1, 0] = -dy / q
    H_landmark[1, 1] = dx / q
    H_pose[0, 0] = -dx / r
    H_pose[0, 1] = -dy / r
    H_pose[0, 2] = 0.0
    H_pose[1, 0] = dy / q
    H_pose[1, 1] = -dx / q
    H_pose[1, 2] = -1.0


@compiled(RESIDUAL)
def range_bearing_residual(z: Any, z_hat: Any, params: Any, out: Any) -> None:
    """z - ẑ with the bearing wrapped; NaN if the measured range is negative."""
    out[0] = z[0] - z_hat[0] if z[0] >= 0.0 else nan
    out[1] = wrap_angle(z[1] - z_hat[1])


@compiled(INVERT)
def range_bearing_invert(pose: Any, z: Any, params: Any, out: Any) -> None:
    """l = p + r (cos(θ + β), sin(θ + β)); NaN below the smallest range."""
    r = z[0] if z[0] >= SMALLEST_RANGE else nan
    out[0] = pose[0] + r * cos(pose[2] + z[1])
    out[1] = pose[1] + r * sin(pose[2] + z[1])


@compiled(INVERSE_JACOBIANS)
def range_bearing_inverse_jacobians(pose: Any, z: Any, params: Any, G_pose: Any, G_z: Any) -> None:
    """∂l/∂(p, θ) = [I, J(l - p)], ∂l/∂(r, β)."""
    c, s = cos(pose[2] + z[1]), sin(pose[2] + z[1])
    G_pose[0, 0] = G_pose[1, 1] = 1.0
    G_pose[0, 1] = G_pose[1, 0] = 0.0
    G_pose[0, 2] = G_z[0, 1] = -z[0] * s
    G_pose[1, 2] = G_z[1, 1] = z[0] * c
    G_z[0, 0] = c
    G_z[1, 0] = s


@compiled(LINEARISE)
def range_bearing_linearise(
    pose: Any, landmark: Any, z: Any, params: Any, z_hat: Any, y: Any, H_pose: Any, H_landmark: Any
) -> None:
    """`predict`, `residual` and `jacobians` in one. It reads each argument once, before it writes anything."""
    dx, dy, heading = landmark[0] - pose[0], landmark[1] - pose[1], pose[2]
    distance, angle = z[0], z[1]
    q = dx * dx + dy * dy
    r = sqrt(q)
    if r < SMALLEST_RANGE:
        r = q = nan
    bearing = wrap_angle(atan2(dy, dx) - heading)
    a, b, c, d = dx / r, dy / r, dy / q, dx / q
    z_hat[0], z_hat[1] = r, bearing
    y[0] = distance - r if distance >= 0.0 else nan
    y[1] = wrap_angle(angle - bearing)
    H_landmark[0, 0], H_landmark[0, 1], H_landmark[1, 0], H_landmark[1, 1] = a, b, -c, d
    H_pose[0, 0], H_pose[0, 1], H_pose[0, 2] = -a, -b, 0.0
    H_pose[1, 0], H_pose[1, 1], H_pose[1, 2] = c, -d, -1.0


@dataclass(frozen=True)
class RangeBearing(CompiledSensor):
    """Range and bearing: z = (r [m], β [rad]), β counter-clockwise from the robot's x axis.

    A measured range of zero is valid for a known landmark, but cannot initialise a new one. A landmark closer than
    1e-6 m to the robot has no bearing; filters refuse the sighting with an error that says so.

    Parameters
    ----------
    sigma_range : float
        Standard deviation of the range [m], > 0.
    sigma_bearing : float
        Standard deviation of the bearing [rad], > 0.

    Raises
    ------
    InputError
        A standard deviation is not a finite number > 0.

    References
    ----------
    Thrun, Burgard & Fox, Probabilistic Robotics (2005), section 6.6.
    """

    sigma_range: float = field(metadata=parameter("m", typical=0.1))
    sigma_bearing: float = field(metadata=parameter("rad", typical=0.035))

    functions: ClassVar[SensorFunctions] = SensorFunctions(
        range_bearing,
        range_bearing_jacobians,
        range_bearing_residual,
        range_bearing_invert,
        range_bearing_inverse_jacobians,
        range_bearing_linearise,
    )
    columns: ClassVar[tuple[str, ...]] = ("range", "bearing")

    def __post_init__(self) -> None:
        for name in ("sigma_range", "sigma_bearing"):
            object.__setattr__(self, name, noise_parameter(name, getattr(self, name), zero=False))

    @cached_property
    def R(self) -> Array:  # noqa: N802
        """diag(σ_r², σ_β²) [m², rad²]."""
        return frozen(np.diag([self.sigma_range**2, self.sigma_bearing**2]))

    def validate(self, z: ArrayLike) -> None:
        """Raise an InputError that names the first measurement (..., 2) with a negative range."""
        ranges = np.asarray(z, dtype=float)[..., 0]
        if np.any(ranges < 0):
            raise InputError(f"range is {np.extract(ranges < 0, ranges)[0]} m, expected a range ≥ 0")
