"""Car-like vehicle with a steered front axle, seen from a sensor that is mounted on it.

All positions are in vehicle axes, with the middle of the rear axle as origin: the sensor is a m ahead and b m to the
left, the wheel with the speed encoder is H m to the left, the wheelbase is L. With t = tan α the rear axle moves at
v_c = v/(1 - t H/L) and turns at ω = v_c t/L, so the sensor moves at w = (v_c - ω b, ω a) in vehicle axes. With
h = ω·dt/2 the exact arc is p' = p + dt·sinc(h)·R(θ + h) w, θ' = θ + ω·dt.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import cached_property
from math import cos, nan, sin
from typing import Any, ClassVar

import numpy as np

from slamkit.arrays import Array, finite_number
from slamkit.compiled import compiled
from slamkit.models._base import (
    MOTION_JACOBIANS,
    MOVE,
    CompiledMotion,
    no_pose_noise,
    noise_parameter,
    parameter,
)
from slamkit.models.unicycle import sinc, sinc_slope, unicycle_noise
from slamkit.protocols import MotionFunctions
from slamkit.se2 import wrap_angle


@compiled("real(real, vector)")
def axle_speed_per_encoder_speed(alpha: float, params: Any) -> float:
    """v_c/v = 1/(1 - tan(α) H/L); NaN if the vehicle cannot steer so far."""
    wheelbase, encoder = params[2], params[3]
    c = cos(alpha)
    scale = c - sin(alpha) * encoder / wheelbase  # (1 - tan(α) H/L) cos α
    return c / scale if c > 0.0 and scale > 0.0 else nan


@compiled(MOVE)
def ackermann_move(pose: Any, u: Any, dt: float, params: Any, out: Any) -> None:
    """Move along the exact arc."""
    wheelbase, ahead, left = params[2], params[4], params[5]
    speed = u[0] * axle_speed_per_encoder_speed(u[1], params)
    omega = speed * sin(u[1]) / (cos(u[1]) * wheelbase)
    h = 0.5 * omega * dt
    c, s, d = cos(pose[2] + h), sin(pose[2] + h), dt * sinc(h)
    w_x, w_y = speed - omega * left, omega * ahead
    out[0] = pose[0] + d * (c * w_x - s * w_y)
    out[1] = pose[1] + d * (s * w_x + c * w_y)
    out[2] = wrap_angle(pose[2] + omega * dt)


@compiled(MOTION_JACOBIANS)
def ackermann_jacobians(pose: Any, u: Any, dt: float, params: Any, F: Any, G: Any) -> None:
    """F = [I, J(p' - p); 0 1] and G = ∂(p', θ')/∂(v, α), where ∂v_c/∂α = v_c (H/L) sec²α/(1 - t H/L)."""
    wheelbase, encoder, ahead, left = params[2], params[3], params[4], params[5]
    per_v = axle_speed_per_encoder_speed(u[1], params)
    speed, tangent = u[0] * per_v, sin(u[1]) / cos(u[1])
    secant2 = 1.0 + tangent * tangent
    omega = speed * tangent / wheelbase
    h = 0.5 * omega * dt
    c, s, d, slope = cos(pose[2] + h), sin(pose[2] + h), dt * sinc(h), dt * sinc_slope(h)
    w_x, w_y = speed - omega * left, omega * ahead
    x, y = c * w_x - s * w_y, s * w_x + c * w_y  # R(θ + h) w
    F[:, :] = 0.0
    F[0, 0] = F[1, 1] = F[2, 2] = 1.0
    F[0, 2] = -d * y
    F[1, 2] = d * x
    for j in range(2):
        # derivatives of v_c and ω with respect to v (j = 0) or α (j = 1)
        speed_j = per_v if j == 0 else speed * per_v * encoder / wheelbase * secant2
        omega_j = (speed_j * tangent + (0.0 if j == 0 else speed * secant2)) / wheelbase
        h_j = 0.5 * dt * omega_j
        a, b = speed_j - omega_j * left, omega_j * ahead
        G[0, j] = slope * h_j * x - d * h_j * y + d * (c * a - s * b)
        G[1, j] = slope * h_j * y + d * h_j * x + d * (s * a + c * b)
        G[2, j] = omega_j * dt


@dataclass(frozen=True)
class Ackermann(CompiledMotion):
    """Vehicle with a steered front axle; the control u = (v [m/s], α [rad]) is constant over dt.

    v is the speed that the encoder at a rear wheel measures, α the steering angle, positive to the left. The pose is
    that of the sensor. The vehicle of the Victoria Park data set has a wheelbase of 2.83 m, the encoder 0.76 m to the
    left, and the laser 3.78 m ahead and 0.5 m to the left.

    A steering angle of a quarter turn or more, or one at which the centre of the turn reaches the encoder's wheel,
    gives NaN: the vehicle cannot steer so far.

    Parameters
    ----------
    sigma_v : float
        Standard deviation of the speed's noise [m/s], ≥ 0.
    sigma_alpha : float
        Standard deviation of the steering angle's noise [rad], ≥ 0.
    wheelbase : float
        L, distance between the axles [m], > 0.
    encoder_left : float
        H, distance of the encoder's wheel to the left of the rear axle's middle [m]; negative to the right.
    ahead : float
        a, distance of the sensor ahead of the rear axle [m]; negative behind it.
    left : float
        b, distance of the sensor to the left of the rear axle's middle [m]; negative to the right.

    Raises
    ------
    InputError
        A standard deviation is not a finite number ≥ 0, the wheelbase is not a finite number > 0, or another distance
        is not a finite number.

    References
    ----------
    Guivant & Nebot, IEEE Transactions on Robotics and Automation 17(3):242-257 (2001), with an exact arc in place of
    the first-order step.
    """

    sigma_v: float = field(metadata=parameter("m/s", typical=0.5))
    sigma_alpha: float = field(metadata=parameter("rad", typical=0.05))
    wheelbase: float = field(metadata=parameter("m", typical=2.83))
    encoder_left: float = field(default=0.0, metadata=parameter("m", typical=0.76))
    ahead: float = field(default=0.0, metadata=parameter("m", typical=3.78))
    left: float = field(default=0.0, metadata=parameter("m", typical=0.5))

    functions: ClassVar[MotionFunctions] = MotionFunctions(
        ackermann_move, ackermann_jacobians, unicycle_noise, no_pose_noise
    )
    control_dim: ClassVar[int] = 2

    def __post_init__(self) -> None:
        for name in ("sigma_v", "sigma_alpha"):
            object.__setattr__(self, name, noise_parameter(name, getattr(self, name), zero=True))
        object.__setattr__(self, "wheelbase", finite_number("wheelbase", self.wheelbase, above=0.0, unit="metres"))
        for name in ("encoder_left", "ahead", "left"):
            object.__setattr__(self, name, finite_number(name, getattr(self, name), unit="metres"))

    @cached_property
    def params(self) -> Array:
        """(σ_v, σ_α, L, H, a, b)."""
        return np.array([getattr(self, f.name) for f in fields(self)])
