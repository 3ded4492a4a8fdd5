"""A model of your own: a sensor and a motion model in plain NumPy, checked, plugged in, and then compiled."""

# %% [markdown]
# # 03 · A model of your own
#
# A filter of slamkit takes any object that has the methods of a model. There is nothing to inherit from and nothing to
# register. This tutorial writes a sensor that measures **bearing and inverse range** (as a camera does that knows the
# size of what it sees), checks it, runs it, and then compiles it, with the same answers.
#
# | symbol | shape | meaning |
# |---|---|---|
# | pose = (x, y, θ) | (3,) | [m, m, rad] |
# | landmark = l | (2,) | [m] |
# | z = (β, 1/r) | (2,) | bearing [rad], inverse range [1/m] |
# | R | (2, 2) | covariance of z's noise |

# %%
import os
import time
from functools import cached_property
from math import atan2, cos, nan, sin, sqrt
from pathlib import Path

import matplotlib.pyplot as plt
import numba
import numpy as np

from slamkit import EKFSLAM, check_model, metrics, plots, simulate
from slamkit.compiled import compiled
from slamkit.errors import ModelError
from slamkit.models import Unicycle
from slamkit.protocols import SensorFunctions
from slamkit.se2 import wrap, wrap_angle
from slamkit.simulate import loop_world

FIGURES = Path(os.environ.get("SLAMKIT_FIGURES") or Path(__file__).resolve().parent / "figures")

# %% [markdown]
# ## The sensor
#
# With Δ = l − p and q = ΔᵀΔ = r²,
#
#     z = (atan2(Δy, Δx) − θ, q^(−1/2))
#     ∂z/∂l = [−Δy/q  Δx/q; −Δx/r³  −Δy/r³]        ∂z/∂(p, θ) = [−∂z/∂l, (−1, 0)ᵀ]
#
# `invert` answers where a landmark must be that is seen like this; a filter starts landmarks with it.


# %%
class CameraOfKnownSize:
    """Bearing [rad] and inverse range [1/m]."""

    def __init__(self, sigma_bearing, sigma_inverse_range):
        self.R = np.diag([sigma_bearing**2, sigma_inverse_range**2])

    def predict(self, pose, landmark):
        dx, dy = landmark - pose[:2]
        return np.array([float(wrap(np.arctan2(dy, dx) - pose[2])), 1 / np.hypot(dx, dy)])

    def jacobians(self, pose, landmark):
        dx, dy = landmark - pose[:2]
        q = dx**2 + dy**2
        H_landmark = np.array([[-dy / q, dx / q], [-dx / q**1.5, -dy / q**1.5]])
        return np.column_stack([-H_landmark, [-1.0, 0.0]]), H_landmark

    def residual(self, z, z_hat):
        return np.array([float(wrap(z[0] - z_hat[0])), z[1] - z_hat[1]])

    def invert(self, pose, z):
        return pose[:2] + np.array([np.cos(pose[2] + z[0]), np.sin(pose[2] + z[0])]) / z[1]

    def inverse_jacobians(self, pose, z):
        c, s, r = np.cos(pose[2] + z[0]), np.sin(pose[2] + z[0]), 1 / z[1]
        G_z = np.array([[-r * s, -c * r**2], [r * c, -s * r**2]])
        return np.column_stack([np.eye(2), G_z[:, 0]]), G_z


camera = CameraOfKnownSize(0.02, 0.01)

# %% [markdown]
# ## Check it before you trust it
#
# `check_model` compares every Jacobian with a numeric one, at random points and at nasty ones (bearings at ±π, the
# landmark behind, tiny ranges), asks whether `invert` inverts, whether R is a covariance, and more. A wrong sign does
# not crash a filter, it makes it quietly worse. Here is one:

# %%
check_model(camera)
print("the camera keeps the protocol")


class WrongSign(CameraOfKnownSize):
    def jacobians(self, pose, landmark):
        H_pose, H_landmark = super().jacobians(pose, landmark)
        return H_pose * [1, 1, -1], H_landmark


try:
    check_model(WrongSign(0.02, 0.01))
except ModelError as error:
    print("found:", str(error).splitlines()[1].strip()[:90])

# %% [markdown]
# ## Plug it in
#
# The world is the loop world, seen through our camera. The filter is the standard EKF; any other takes the model too.

# %%
base = loop_world("range-bearing")
world = type(base)(
    name="loop, camera", landmarks=base.landmarks, motion=base.motion, sensor=camera, controls=base.controls[:500],
    dt=base.dt, pose=base.pose, pose_covariance=base.pose_covariance, max_range=base.max_range,
    min_range=base.min_range, odometry=True,
)  # fmt: skip
log = simulate(world, np.random.default_rng(2))
plain = EKFSLAM(world.motion, camera, world.pose, world.pose_covariance)
history = plain.run(log)
result = metrics.evaluate(history.times, history.poses, log.truth, plain.landmarks, aligned=False)
dead = metrics.evaluate(*metrics.dead_reckoning(log, world.motion), log.truth, aligned=False)
print(f"dead reckoning, position RMSE: {dead.ate_m:.2f} m")
print(f"EKF-SLAM with the camera, position RMSE: {result.ate_m:.2f} m")

# %% [markdown]
# ## A motion model is as short
#
# It needs `move`, `jacobians` (F = ∂move/∂pose, G = ∂move/∂u), `control_noise` and `pose_noise`. This one inherits the
# arc of `Unicycle` and slips: its noise grows with the speed.


# %%
class SlippingUnicycle:
    """A unicycle whose speed is known to 5 % and whose turn rate gets worse with speed."""

    arc = Unicycle(0.0, 0.0)

    def move(self, pose, u, dt):
        return self.arc.move(pose, u, dt)

    def jacobians(self, pose, u, dt):
        return self.arc.jacobians(pose, u, dt)

    def control_noise(self, u, dt):
        return np.diag([(0.05 * u[0]) ** 2 + 1e-8, (0.1 * u[0]) ** 2 + 1e-8])

    def pose_noise(self, pose, u, dt):
        return np.zeros((3, 3))


check_model(SlippingUnicycle())
slipping = EKFSLAM(SlippingUnicycle(), camera, world.pose, world.pose_covariance)
slipping.run(log)
print(f"the slipping model maps {len(slipping.landmarks)} landmarks as well")

# %% [markdown]
# ## The same, compiled
#
# A model in plain Python runs at the speed of plain Python. The same functions in the form (inputs…, params, outputs…)
# compile, and then the whole run does. Two decorators work: slamkit's own, which compiles at the first call and keeps
# the result on disk, and Numba's plain `njit`.


# %%
@compiled("void(vector, vector, vector, vector)")
def predict(pose, landmark, params, out):
    dx, dy = landmark[0] - pose[0], landmark[1] - pose[1]
    out[0] = wrap_angle(atan2(dy, dx) - pose[2])
    out[1] = 1.0 / sqrt(dx * dx + dy * dy)


@compiled("void(vector, vector, vector, matrix, matrix)")
def jacobians(pose, landmark, params, H_pose, H_landmark):
    dx, dy = landmark[0] - pose[0], landmark[1] - pose[1]
    q = dx * dx + dy * dy
    r3 = q * sqrt(q)
    H_landmark[0, 0], H_landmark[0, 1] = -dy / q, dx / q
    H_landmark[1, 0], H_landmark[1, 1] = -dx / r3, -dy / r3
    for i in range(2):
        H_pose[i, 0], H_pose[i, 1] = -H_landmark[i, 0], -H_landmark[i, 1]
    H_pose[0, 2], H_pose[1, 2] = -1.0, 0.0


@compiled("void(vector, vector, vector, vector)")
def residual(z, z_hat, params, out):
    out[0] = wrap_angle(z[0] - z_hat[0])
    out[1] = z[1] - z_hat[1]


@numba.njit
def invert(pose, z, params, out):
    r = 1.0 / z[1] if z[1] > 0.0 else nan
    out[0] = pose[0] + r * cos(pose[2] + z[0])
    out[1] = pose[1] + r * sin(pose[2] + z[0])


@numba.njit
def inverse_jacobians(pose, z, params, G_pose, G_z):
    c, s, r = cos(pose[2] + z[0]), sin(pose[2] + z[0]), 1.0 / z[1]
    G_pose[0, 0], G_pose[0, 1], G_pose[0, 2] = 1.0, 0.0, -r * s
    G_pose[1, 0], G_pose[1, 1], G_pose[1, 2] = 0.0, 1.0, r * c
    G_z[0, 0], G_z[0, 1] = -r * s, -c * r * r
    G_z[1, 0], G_z[1, 1] = r * c, -s * r * r


class FastCamera(CameraOfKnownSize):
    """The same camera; `functions` and `params` are all that compiling needs."""

    functions = SensorFunctions(predict, jacobians, residual, invert, inverse_jacobians)

    @cached_property
    def params(self):
        return np.empty(0)


check_model(FastCamera(0.02, 0.01))
timing = {}
for name, sensor in (("plain Python", camera), ("compiled", FastCamera(0.02, 0.01))):
    EKFSLAM(world.motion, sensor, world.pose, world.pose_covariance).run(log)  # compiles, the first time
    fresh = EKFSLAM(world.motion, sensor, world.pose, world.pose_covariance)
    before = time.perf_counter()
    again = fresh.run(log)
    timing[name] = (time.perf_counter() - before) / len(log)
    print(f"{name}: {timing[name] * 1e6:.0f} µs a step")
difference = float(np.abs(again.poses - history.poses).max())
print(f"largest difference between the two: {difference:.1e}")

# %% [markdown]
# ## The figure

# %%
figure, axes = plt.subplots(1, 2, figsize=(10.5, 5), width_ratios=[1.6, 1], layout="constrained")
plots.plot_map(axes[0], history, log.truth, metrics.dead_reckoning(log, world.motion))
bars = axes[1].bar(list(timing), [t * 1e6 for t in timing.values()], color=[plots.style("ekf").color, "0.6"], width=0.6)
axes[1].bar_label(bars, fmt="%.0f µs")
axes[1].set(ylabel="time of a step [µs]", yscale="log")

FIGURES.mkdir(parents=True, exist_ok=True)
print("figure:", plots.save(figure, FIGURES / "03_a_model_of_your_own.png", dpi=150))

# %% [markdown]
# ## Key points
#
# - A model is a class with the protocol's methods, in plain NumPy. Every filter takes it.
# - `check_model` finds the wrong sign before a filter hides it.
# - The same functions, compiled, let whole runs compile: same numbers, many times faster.
