"""A model of your own: a motion model and a sensor model in plain NumPy, checked, used in filters, then compiled."""

# %% [markdown]
# # 03 · A model of your own
#
# A slamkit filter accepts any object that has the methods of a model. You do not inherit from a base class and you do
# not register anything. This tutorial writes
#
# - a **motion model** for a robot with two driven wheels, whose encoders measure how far each wheel has rolled,
# - a **sensor model** with bearing and *inverse* range, such as a camera that knows the size of the landmarks.
#
# It checks both models, runs them in a filter, and then compiles them. The compiled models give the same answers.
#
# | symbol | shape | meaning |
# |---|---|---|
# | pose = (p, θ) = (x, y, θ) | (3,) | pose of the robot [m, m, rad] |
# | u = (a, b) | (2,) | distance that the left and the right wheel roll in one step [m] |
# | w | scalar | distance between the wheels [m] |
# | l | (2,) | position of a landmark [m] |
# | z = (β, i) | (2,) | bearing [rad] and inverse range [1/m] |
# | R | (2, 2) | covariance of the noise of z |

# %%
import os
import time
from dataclasses import dataclass, replace
from functools import cached_property
from math import atan2, cos, nan, pi, sin, sqrt
from pathlib import Path
from typing import Any, ClassVar

import matplotlib.pyplot as plt
import numba
import numpy as np
from numpy.typing import NDArray

from slamkit import EKFSLAM, InvariantEKFSLAM, ModelError, evaluate, plots, simulate
from slamkit.compiled import compiled
from slamkit.evaluate import trajectory
from slamkit.models import check_model
from slamkit.protocols import MotionFunctions, MotionModel, SensorFunctions, SensorModel
from slamkit.se2 import wrap
from slamkit.simulate import loop_world

FIGURES = Path(os.environ.get("SLAMKIT_FIGURES") or "figures")
Array = NDArray[np.float64]

# %% [markdown]
# ## The motion model
#
# The wheels roll a and b. The middle of the axle moves by their mean d, and the robot turns by φ:
#
#     d = (a + b)/2        φ = (b − a)/w        θ_m = θ + φ/2
#     p' = p + d (cos θ_m, sin θ_m)             θ' = θ + φ
#
# A filter also needs the derivatives. With J = [0 −1; 1 0],
#
#     F = ∂(p', θ')/∂pose = [I, J(p' − p); 0 1]
#     G = ∂(p', θ')/∂u,   with ∂d/∂a = ∂d/∂b = 1/2   and   −∂φ/∂a = ∂φ/∂b = 1/w
#
# `control_noise` is the covariance of u. A wheel that rolls farther slips more, so the variance of each distance is k²
# times its length. `pose_noise` is for disturbances that act on the pose directly, such as a push. Here there are
# none.


# %%
@dataclass(frozen=True)
class TwoWheels:
    """Two driven wheels `width` [m] apart; `slip` is the standard deviation of a distance of one metre [√m]."""

    width: float
    slip: float

    def move(self, pose: Array, u: Array, dt: float) -> Array:
        d, phi = (u[0] + u[1]) / 2, (u[1] - u[0]) / self.width
        middle = pose[2] + phi / 2
        return np.array([pose[0] + d * np.cos(middle), pose[1] + d * np.sin(middle), wrap(pose[2] + phi)])

    def jacobians(self, pose: Array, u: Array, dt: float) -> tuple[Array, Array]:
        d, phi = (u[0] + u[1]) / 2, (u[1] - u[0]) / self.width
        c, s = np.cos(pose[2] + phi / 2), np.sin(pose[2] + phi / 2)
        F = np.array([[1, 0, -d * s], [0, 1, d * c], [0, 0, 1]])
        turn = d / (2 * self.width)  # how far the end of the step moves sideways when φ changes
        G = np.array(
            [
                [c / 2 + turn * s, c / 2 - turn * s],
                [s / 2 - turn * c, s / 2 + turn * c],
                [-1 / self.width, 1 / self.width],
            ]
        )
        return F, G

    def control_noise(self, u: Array, dt: float) -> Array:
        return self.slip**2 * np.diag(np.abs(u))

    def pose_noise(self, pose: Array, u: Array, dt: float) -> Array:
        return np.zeros((3, 3))


# %% [markdown]
# ## The sensor model
#
# With Δ = l − p and r = |Δ|,
#
#     z = (atan2(Δy, Δx) − θ, 1/r)
#     ∂z/∂l = [−Δy/r²  Δx/r²; −Δx/r³  −Δy/r³]        ∂z/∂(p, θ) = [−∂z/∂l, (−1, 0)ᵀ]
#
# `residual` subtracts two measurements and wraps the bearing to [−π, π). `invert` returns the position of a landmark
# with a given sighting: l = p + (cos(θ + β), sin(θ + β))/i. The filter uses it to start new landmarks.


# %%
@dataclass(frozen=True)
class SizeCamera:
    """Bearing and inverse range, with standard deviations in [rad] and [1/m]."""

    sigma_bearing: float
    sigma_inverse: float

    @property
    def R(self) -> Array:  # noqa: N802
        return np.diag([self.sigma_bearing**2, self.sigma_inverse**2])

    def predict(self, pose: Array, landmark: Array) -> Array:
        dx, dy = landmark - pose[:2]
        return np.array([wrap(np.arctan2(dy, dx) - pose[2]), 1 / np.hypot(dx, dy)])

    def jacobians(self, pose: Array, landmark: Array) -> tuple[Array, Array]:
        dx, dy = landmark - pose[:2]
        r = np.hypot(dx, dy)
        H_landmark = np.array([[-dy / r**2, dx / r**2], [-dx / r**3, -dy / r**3]])
        return np.column_stack([-H_landmark, [-1.0, 0.0]]), H_landmark

    def residual(self, z: Array, z_hat: Array) -> Array:
        return np.array([wrap(z[0] - z_hat[0]), z[1] - z_hat[1]])

    def invert(self, pose: Array, z: Array) -> Array:
        r = 1 / z[1] if z[1] > 0 else np.nan  # no landmark has this sighting: the filter refuses NaN
        return np.array([pose[0] + r * np.cos(pose[2] + z[0]), pose[1] + r * np.sin(pose[2] + z[0])])

    def inverse_jacobians(self, pose: Array, z: Array) -> tuple[Array, Array]:
        c, s, r = np.cos(pose[2] + z[0]), np.sin(pose[2] + z[0]), 1 / z[1]
        G_pose = np.array([[1.0, 0.0, -r * s], [0.0, 1.0, r * c]])
        G_z = np.array([[-r * s, -c * r**2], [r * c, -s * r**2]])
        return G_pose, G_z


wheels, camera = TwoWheels(width=0.4, slip=0.02), SizeCamera(sigma_bearing=0.02, sigma_inverse=0.01)

# %% [markdown]
# ## Check before you trust
#
# `check_model` tests every law that a filter relies on. It compares each Jacobian with a numeric one, at random points
# and at difficult ones (bearings at ±π, a landmark straight behind, a robot at rest). It checks that `predict` undoes
# `invert`, that angles wrap, and that covariances are valid. If everything is right, it prints and raises nothing.

# %%
check_model(wheels)
check_model(camera)

# %% [markdown]
# A wrong sign in a Jacobian raises no error. It makes the filter worse without a sign, and it can take weeks to find.
# Here is an example: this class assumes that a left turn of the robot moves a landmark to the left.


# %%
class WrongSign(SizeCamera):
    def jacobians(self, pose: Array, landmark: Array) -> tuple[Array, Array]:
        H_pose, H_landmark = super().jacobians(pose, landmark)
        return H_pose * [1, 1, -1], H_landmark


try:
    check_model(WrongSign(0.02, 0.01))
except ModelError as error:
    print("check_model says:", *str(error).splitlines()[:2], sep="\n  ")

# %% [markdown]
# ## Plug it in
#
# This is the loop world again, with two driven wheels and the camera. The controls are distances and not speeds. Each
# one is the whole motion of its step; `increments=True` says so.

# %%
loop = loop_world("range-bearing")
v, omega = loop.controls[0] * loop.dt  # forward and turn of one step
world = replace(
    loop,
    name="loop, two wheels, camera",
    motion=wheels,
    sensor=camera,
    controls=np.tile([v - omega * wheels.width / 2, v + omega * wheels.width / 2], (500, 1)),
    increments=True,
)
log = simulate(world, np.random.default_rng(2))
assert log.truth is not None
ekf = EKFSLAM(wheels, camera, world.pose, world.pose_covariance)
history = ekf.run(log)
dead_reckoning = evaluate.dead_reckoning(log, wheels)

slam = trajectory.evaluate(history.times, history.poses, log.truth, ekf.landmarks, aligned=False)
lost = trajectory.evaluate(*dead_reckoning, log.truth, aligned=False)
print(f"dead reckoning, position RMSE: {lost.ate_m:.2f} m")
print(f"EKF-SLAM with our models, position RMSE: {slam.ate_m:.2f} m")

# %% [markdown]
# Every other filter accepts the models too. (A single run cannot show which filter is better. See tutorial 06.)

# %%
other = InvariantEKFSLAM(wheels, camera, world.pose, world.pose_covariance)
said = other.run(log)
invariant = trajectory.evaluate(said.times, said.poses, log.truth, aligned=False)
print(f"invariant EKF with our models, position RMSE: {invariant.ate_m:.2f} m")

# %% [markdown]
# ## The same, compiled
#
# A model in plain Python is slow: most of the time of a step is spent in the models. If both models also offer their
# methods as compiled functions, slamkit compiles the whole run.
#
# Such a function takes the arguments of the method, then the parameters `params` of the model, then the arrays that it
# fills. Write it in the subset of Python that Numba compiles, with loops and scalars instead of array expressions.


# %%
def move(pose: Any, u: Any, dt: float, params: Any, out: Any) -> None:
    d, phi = (u[0] + u[1]) / 2, (u[1] - u[0]) / params[0]
    out[0] = pose[0] + d * cos(pose[2] + phi / 2)
    out[1] = pose[1] + d * sin(pose[2] + phi / 2)
    out[2] = (pose[2] + phi + pi) % (2 * pi) - pi


def motion_jacobians(pose: Any, u: Any, dt: float, params: Any, F: Any, G: Any) -> None:
    d, phi = (u[0] + u[1]) / 2, (u[1] - u[0]) / params[0]
    c, s, turn = cos(pose[2] + phi / 2), sin(pose[2] + phi / 2), d / (2 * params[0])
    F[:, :] = 0.0
    F[0, 0] = F[1, 1] = F[2, 2] = 1.0
    F[0, 2], F[1, 2] = -d * s, d * c
    G[0, 0], G[0, 1] = c / 2 + turn * s, c / 2 - turn * s
    G[1, 0], G[1, 1] = s / 2 - turn * c, s / 2 + turn * c
    G[2, 0], G[2, 1] = -1 / params[0], 1 / params[0]


def control_noise(u: Any, dt: float, params: Any, out: Any) -> None:
    out[:, :] = 0.0
    for i in range(2):
        out[i, i] = params[1] ** 2 * abs(u[i])


def pose_noise(pose: Any, u: Any, dt: float, params: Any, out: Any) -> None:
    out[:, :] = 0.0


def predict(pose: Any, landmark: Any, params: Any, out: Any) -> None:
    dx, dy = landmark[0] - pose[0], landmark[1] - pose[1]
    out[0] = (atan2(dy, dx) - pose[2] + pi) % (2 * pi) - pi
    out[1] = 1 / sqrt(dx * dx + dy * dy)


def sensor_jacobians(pose: Any, landmark: Any, params: Any, H_pose: Any, H_landmark: Any) -> None:
    dx, dy = landmark[0] - pose[0], landmark[1] - pose[1]
    r = sqrt(dx * dx + dy * dy)
    H_landmark[0, 0], H_landmark[0, 1] = -dy / r**2, dx / r**2
    H_landmark[1, 0], H_landmark[1, 1] = -dx / r**3, -dy / r**3
    for i in range(2):
        H_pose[i, 0], H_pose[i, 1] = -H_landmark[i, 0], -H_landmark[i, 1]
    H_pose[0, 2], H_pose[1, 2] = -1.0, 0.0


def residual(z: Any, z_hat: Any, params: Any, out: Any) -> None:
    out[0] = (z[0] - z_hat[0] + pi) % (2 * pi) - pi
    out[1] = z[1] - z_hat[1]


def invert(pose: Any, z: Any, params: Any, out: Any) -> None:
    r = 1 / z[1] if z[1] > 0 else nan
    out[0] = pose[0] + r * cos(pose[2] + z[0])
    out[1] = pose[1] + r * sin(pose[2] + z[0])


def inverse_jacobians(pose: Any, z: Any, params: Any, G_pose: Any, G_z: Any) -> None:
    c, s, r = cos(pose[2] + z[0]), sin(pose[2] + z[0]), 1 / z[1]
    G_pose[0, 0], G_pose[0, 1], G_pose[0, 2] = 1.0, 0.0, -r * s
    G_pose[1, 0], G_pose[1, 1], G_pose[1, 2] = 0.0, 1.0, r * c
    G_z[0, 0], G_z[0, 1] = -r * s, -c * r * r
    G_z[1, 0], G_z[1, 1] = r * c, -s * r * r


# %% [markdown]
# There are two ways to compile these functions. Numba's own `njit` needs nothing else, but it compiles again in every
# process. slamkit's `compiled` takes the types of the arguments, compiles at the first call, and keeps the result on
# disk.
#
# The class gets two more attributes, `functions` and `params`. Its methods stay the same. `check_model` compares the
# functions with the methods.


# %%
class NumbaWheels(TwoWheels):
    functions: ClassVar[MotionFunctions] = MotionFunctions(
        *[numba.njit(f) for f in (move, motion_jacobians, control_noise, pose_noise)]
    )

    @cached_property
    def params(self) -> Array:
        return np.array([self.width, self.slip])


class NumbaCamera(SizeCamera):
    functions: ClassVar[SensorFunctions] = SensorFunctions(
        *[numba.njit(f) for f in (predict, sensor_jacobians, residual, invert, inverse_jacobians)]
    )
    params: ClassVar[Array] = np.empty(0)  # only R depends on the numbers of this model


class CompiledWheels(NumbaWheels):
    functions = MotionFunctions(
        compiled("void(vector, vector, real, vector, vector)")(move),
        compiled("void(vector, vector, real, vector, matrix, matrix)")(motion_jacobians),
        compiled("void(vector, real, vector, matrix)")(control_noise),
        compiled("void(vector, vector, real, vector, matrix)")(pose_noise),
    )


class CompiledCamera(NumbaCamera):
    functions = SensorFunctions(
        compiled("void(vector, vector, vector, vector)")(predict),
        compiled("void(vector, vector, vector, matrix, matrix)")(sensor_jacobians),
        compiled("void(vector, vector, vector, vector)")(residual),
        compiled("void(vector, vector, vector, vector)")(invert),
        compiled("void(vector, vector, vector, matrix, matrix)")(inverse_jacobians),
    )


pairs: dict[str, tuple[MotionModel, SensorModel]] = {
    "plain NumPy": (wheels, camera),
    "numba.njit": (NumbaWheels(0.4, 0.02), NumbaCamera(0.02, 0.01)),
    "slamkit.compiled": (CompiledWheels(0.4, 0.02), CompiledCamera(0.02, 0.01)),
}
microseconds = {}
for name, (motion, sensor) in pairs.items():
    check_model(motion)
    check_model(sensor)
    spent = []
    for _ in range(4):  # the first run compiles; we take the shortest
        f = EKFSLAM(motion, sensor, world.pose, world.pose_covariance)
        before = time.perf_counter()
        again = f.run(log)
        spent.append(time.perf_counter() - before)
    microseconds[name] = 1e6 * min(spent) / len(log)
    difference = max(np.abs(again.poses - history.poses).max(), np.abs(again.landmarks - history.landmarks).max())
    print(f"{name}, time of a step: {microseconds[name]:.0f} µs")
    print(f"{name}, largest difference from plain NumPy: {difference:.1e} m")

ratio = microseconds["plain NumPy"] / microseconds["slamkit.compiled"]
print(f"a step of plain NumPy over a compiled one: {ratio:.0f} times")

# %% [markdown]
# ## The figure
#
# Left: the map. Right: the time of a step with each form of the models.

# %%
figure = plt.figure(figsize=(10.5, 5.6), layout="constrained")
left, right = figure.subplots(1, 2, width_ratios=[1.7, 1])
plots.plot_map(left, history, log.truth, dead_reckoning)
bars = right.barh(list(microseconds), list(microseconds.values()), color=["0.65", "0.45", plots.style("ekf").color])
right.bar_label(bars, fmt="%.0f µs", padding=4)
right.invert_yaxis()
right.set(xlabel="time of a step [µs]", xlim=(0, 1.25 * max(microseconds.values())))
right.set_title("the same models, the same numbers", fontsize="medium")
right.spines[["top", "right"]].set_visible(False)

FIGURES.mkdir(parents=True, exist_ok=True)
print("figure:", plots.save(figure, FIGURES / "03_a_model_of_your_own.png", dpi=150))

# %% [markdown]
# ## Key points
#
# - A model is a class with the methods of the protocol, in plain NumPy. Every filter accepts it.
# - `check_model` finds a wrong sign before a filter hides it. Run it in the tests of your own project.
# - If the class also has `functions` and `params`, slamkit compiles whole runs. The results agree up to rounding, and
#   the run is faster.
