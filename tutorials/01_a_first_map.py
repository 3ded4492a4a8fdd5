"""A first map: a simulated robot drives two loops, and EKF-SLAM maps twenty landmarks while it drives."""

# %% [markdown]
# # 01 · A first map
#
# A robot that only counts its own motion gets lost: every step adds a little error, and nothing ever takes it away.
# A robot that also sights landmarks can do better, even if nobody has told it where they are. It estimates its own
# pose and the landmarks **together**. That is SLAM, simultaneous localisation and mapping, and this tutorial does it
# with an extended Kalman filter (EKF).
#
# It shows how to feed a filter by hand, how to simulate a world, how to run a filter over a log, and how to compare the
# result with dead reckoning, which is what is left of SLAM when the landmarks are taken away.
#
# | symbol | shape | meaning |
# |---|---|---|
# | x_r = (x, y, θ) | (3,) | pose of the robot [m, m, rad], heading counter-clockwise from the x axis |
# | l = (l_x, l_y) | (2,) | position of a landmark [m] |
# | x | (D,), D = 3 + 2N | the state: the pose, then N landmarks |
# | P | (D, D) | covariance of the state |
# | u = (v, ω) | (2,) | control: speed [m/s] and turn rate [rad/s] |
# | z = (r, β) | (2,) | sighting: range [m] and bearing [rad], from the robot's x axis |
# | R | (2, 2) | covariance of a sighting's noise |

# %%
import os
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from slamkit import EKFSLAM, evaluate, plots, simulate
from slamkit.evaluate import trajectory
from slamkit.models import RangeBearing, Unicycle
from slamkit.simulate import loop_world

FIGURES = Path(os.environ.get("SLAMKIT_FIGURES") or Path(__file__).resolve().parent / "figures")

# %% [markdown]
# ## Three things a filter does
#
# **Predict.** The robot drives. With the motion model f, its Jacobians F = ∂f/∂x_r and G = ∂f/∂u, and the covariance
# Σ_u of the control's noise,
#
#     x_r ← f(x_r, u, dt)        P_rr ← F P_rr Fᵀ + G Σ_u Gᵀ
#
# The uncertainty grows. A model says how much: here 0.1 m/s in speed and 0.05 rad/s in turn rate.

# %%
ekf = EKFSLAM(Unicycle(sigma_v=0.1, sigma_omega=0.05), RangeBearing(sigma_range=0.1, sigma_bearing=0.02))
ekf.predict(u=(1.0, 0.0), dt=1.0)
print(f"sd of x after one step of 1 m: {np.sqrt(ekf.pose_covariance[0, 0]):.4f} m")

# %% [markdown]
# **Start a landmark.** A sighting with an id that the filter has not met puts a new landmark into the state. With
# g(x_r, z) the place where the landmark must be, G_x = ∂g/∂x_r and G_z = ∂g/∂z,
#
#     l = g(x_r, z)        P_ll = G_x P_rr G_xᵀ + G_z R G_zᵀ
#
# The landmark is uncertain because the sighting is noisy, **and** because the robot does not know where it stands.

# %%
ekf.observe("tree", z=(2.0, 0.0))
print(f"the tree is started at: {ekf.landmarks['tree'][0]:.3f} m")

# %% [markdown]
# **Update.** A sighting of a known landmark corrects everything. With the predicted sighting h(x) and H = ∂h/∂x,
#
#     y = z − h(x)        S = H P Hᵀ + R        K = P Hᵀ S⁻¹
#     x ← x + K y         P ← P − K S Kᵀ
#
# y is the innovation, what the sighting says that the filter did not know; S is its covariance; K is the gain.
#
# Here the robot drives another metre towards the tree. The tree should then be 1 m away. It is seen at 1.3 m, so the
# robot has come less far than it believed, or the tree stands farther off: the filter shares the surprise out
# according to the covariances.

# %%
ekf.predict(u=(1.0, 0.0), dt=1.0)
before = ekf.pose_covariance
ekf.observe("tree", z=(1.3, 0.0))
print(f"innovation in range: {ekf.y[0]:.3f} m")
print(f"sd of x before the update: {np.sqrt(before[0, 0]):.4f} m")
print(f"sd of x after the update: {np.sqrt(ekf.pose_covariance[0, 0]):.4f} m")
print(f"the robot moves back to x: {ekf.pose[0]:.3f} m")
print(f"the tree moves on to x: {ekf.landmarks['tree'][0]:.3f} m")

# %% [markdown]
# ## A world
#
# `loop_world` is a circle of 10 m radius between two rings of landmarks, which the robot sees when they are within
# 0.5 to 5 m. One loop takes 251 s; we drive two. `simulate` gives a log: what the odometry counted and what the sensor
# saw, both with noise, and the truth, which no filter gets to see.
#
# All randomness comes from the generator that you pass in. The same seed gives the same log.

# %%
world = loop_world("range-bearing")
world = replace(world, controls=world.controls[:503])  # one control a second
log = simulate(world, np.random.default_rng(1))
assert log.truth is not None
print(f"sightings in the log: {len(log.observations)}")

# %% [markdown]
# ## Dead reckoning, then SLAM
#
# Dead reckoning is the prediction alone. EKF-SLAM gets the same controls, and the sightings on top.
#
# Both start at the true pose: in SLAM the start *defines* the frame of the map. A filter is used once; make a new one
# for every run.

# %%
times, dead_reckoning = evaluate.dead_reckoning(log, world.motion)
ekf = EKFSLAM(world.motion, world.sensor, pose=world.pose, pose_covariance=world.pose_covariance)
history = ekf.run(log)

# %% [markdown]
# The `History` holds what the filter said after every step: poses, covariances, innovations, and the final map.
# `trajectory.evaluate` compares it with the truth; RMSE is the root mean square error,
#
#     RMSE = √( mean over all steps of |estimated − true position|² )

# %%
slam = trajectory.evaluate(history.times, history.poses, log.truth, ekf.landmarks, aligned=False)
lost = trajectory.evaluate(times, dead_reckoning, log.truth, aligned=False)
print(f"landmarks in the map: {len(ekf.landmarks)}")
print(f"dead reckoning, position RMSE: {lost.ate_m:.2f} m")
print(f"EKF-SLAM, position RMSE: {slam.ate_m:.2f} m")
print(f"EKF-SLAM, landmark RMSE: {slam.landmark_rmse_m:.2f} m")

# %% [markdown]
# ## Closing the loop
#
# During the first loop every landmark is new, and new landmarks are placed by a robot that is ever less sure of itself.
# So its uncertainty grows. When it comes back to the first landmarks, which it placed when it still knew where it was,
# the uncertainty collapses. This is a *loop closure*, and nobody has to program it: the update does it, through the
# covariances that tie all landmarks together. The next tutorial looks at them.

# %%
# The largest eigenvalue of a covariance is the variance in the direction that is known worst.
spread = np.sqrt(np.linalg.eigvalsh(history.pose_covariances[:, :2, :2])[:, -1])  # [m]
closed = 1 + int(np.argmin(np.diff(spread)))  # the step in which the claim falls most
print(f"the loop is closed after: {history.times[closed]:.0f} s")
print(f"claimed sd of the position before: {spread[closed - 1]:.2f} m")
print(f"claimed sd of the position after: {spread[closed]:.2f} m")

# %% [markdown]
# ## The figure
#
# Left, the map. An ellipse holds its landmark, or its pose, with a probability of 95 % — if the filter is right about
# its own uncertainty. Right, the distance from the truth over time, beside what the filter claims.

# %%
figure = plt.figure(figsize=(11, 5.4), layout="constrained")
left, right = figure.subplots(1, 2, width_ratios=[1.15, 1])
plots.plot_map(left, history, log.truth, (times, dead_reckoning))

truth = log.truth.poses[1:, :2]  # the truth has one more row: the start
for name, poses in (("dead_reckoning", dead_reckoning), ("ekf", history.poses)):
    look = plots.style(name)
    error = np.linalg.norm(poses[:, :2] - truth, axis=1)
    right.plot(times, error, color=look.color, linestyle=look.linestyle, label=look.label)
reach = np.sqrt(5.991) * spread  # the χ² of two degrees of freedom stays below 5.991 with 95 %
right.fill_between(times, reach, color=plots.style("ekf").color, alpha=0.2, label="95 % claim of the EKF")
right.axvline(times[closed], color="0.5", linewidth=0.8)
right.text(times[closed] + 5, 0.97, "loop closed", transform=right.get_xaxis_transform(), va="top")
right.set(xlabel="time [s]", ylabel="distance from the truth [m]", xlim=(0, times[-1]))
right.set_ylim(bottom=0)
right.legend(loc="upper left", frameon=False)

FIGURES.mkdir(parents=True, exist_ok=True)
print("figure:", plots.save(figure, FIGURES / "01_a_first_map.png", dpi=150))

# %% [markdown]
# ## Key points
#
# - The state holds the pose and the map; one covariance P says how sure the filter is of all of it.
# - Predicting makes the robot less sure, sighting a known landmark makes it surer, a new landmark extends the state.
# - Without landmarks the error grows without bound. With them it grows until the loop is closed.
# - A filter gives an estimate *and* a claim of how good it is. Check both: the later tutorials do.
