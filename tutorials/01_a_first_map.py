"""A first map: a simulated robot drives two loops while EKF-SLAM maps twenty landmarks."""

# %% [markdown]
# # 01 · A first map
#
# A robot that only counts its own motion gets lost. Every step adds a small error, and nothing removes it. A robot
# that also sights landmarks can do better, even if it does not know where the landmarks are. It estimates its own pose
# and the landmarks **together**. This is simultaneous localisation and mapping (SLAM). This tutorial does it with an
# extended Kalman filter (EKF).
#
# The tutorial shows how to
#
# - call a filter step by step,
# - simulate a world,
# - run a filter over a log,
# - compare the result with dead reckoning, which uses the motion alone and ignores the landmarks.
#
# | symbol | shape | meaning |
# |---|---|---|
# | x_r = (x, y, θ) | (3,) | pose of the robot [m, m, rad]; the heading is counter-clockwise from the x axis |
# | l = (l_x, l_y) | (2,) | position of a landmark [m] |
# | x | (D,), D = 3 + 2N | the state: the pose, then N landmarks |
# | P | (D, D) | covariance of the state |
# | u = (v, ω) | (2,) | control: speed [m/s] and turn rate [rad/s] |
# | z = (r, β) | (2,) | sighting: range [m] and bearing [rad], measured from the robot's x axis |
# | R | (2, 2) | covariance of the noise of a sighting |

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

FIGURES = Path(os.environ.get("SLAMKIT_FIGURES") or "figures")

# %% [markdown]
# ## Three things a filter does
#
# **Predict.** The robot drives. The motion model f has the Jacobians F = ∂f/∂x_r and G = ∂f/∂u, and Σ_u is the
# covariance of the control noise. The filter computes
#
#     x_r ← f(x_r, u, dt)        P_rr ← F P_rr Fᵀ + G Σ_u Gᵀ
#
# The uncertainty grows. The model says by how much: here 0.1 m/s in speed and 0.05 rad/s in turn rate.

# %%
ekf = EKFSLAM(Unicycle(sigma_v=0.1, sigma_omega=0.05), RangeBearing(sigma_range=0.1, sigma_bearing=0.02))
ekf.predict(u=(1.0, 0.0), dt=1.0)
print(f"sd of x after one step of 1 m: {np.sqrt(ekf.pose_covariance[0, 0]):.4f} m")

# %% [markdown]
# **Start a landmark.** A sighting with an unknown id adds a new landmark to the state. Let g(x_r, z) be the position
# of the landmark, with G_x = ∂g/∂x_r and G_z = ∂g/∂z. Then
#
#     l = g(x_r, z)        P_ll = G_x P_rr G_xᵀ + G_z R G_zᵀ
#
# The landmark is uncertain for two reasons: the sighting is noisy, and the pose of the robot is uncertain.

# %%
ekf.observe("tree", z=(2.0, 0.0))
print(f"the tree is started at: {ekf.landmarks['tree'][0]:.3f} m")

# %% [markdown]
# **Update.** A sighting of a known landmark corrects the whole state. Let h(x) be the predicted sighting and H =
# ∂h/∂x. Then
#
#     y = z − h(x)        S = H P Hᵀ + R        K = P Hᵀ S⁻¹
#     x ← x + K y         P ← P − K S Kᵀ
#
# y is the innovation: the difference between the sighting and its prediction. S is its covariance. K is the gain.
#
# Here the robot drives another metre towards the tree. The filter now expects the tree at 1 m, but sights it at 1.3 m.
# Either the robot has driven less than expected, or the tree is farther away. The filter divides the difference
# between the two according to their covariances.

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
# `loop_world` is a circle of 10 m radius between two rings of landmarks. The robot sights landmarks at a distance of
# 0.5 to 5 m. One loop takes 251 s, and we drive two loops. `simulate` returns a log with noisy odometry, noisy
# sightings and the truth. The filters never see the truth.
#
# All random numbers come from the generator that you pass. The same seed gives the same log.

# %%
world = loop_world("range-bearing")
world = replace(world, controls=world.controls[:503])  # one control a second
log = simulate(world, np.random.default_rng(1))
assert log.truth is not None
print(f"sightings in the log: {len(log.observations)}")

# %% [markdown]
# ## Dead reckoning, then SLAM
#
# Dead reckoning is the prediction alone. EKF-SLAM gets the same controls and also the sightings.
#
# Both start at the true pose, because in SLAM the start *defines* the frame of the map. A filter object holds the
# state of one run. Make a new one for every run.

# %%
times, dead_reckoning = evaluate.dead_reckoning(log, world.motion)
ekf = EKFSLAM(world.motion, world.sensor, pose=world.pose, pose_covariance=world.pose_covariance)
history = ekf.run(log)

# %% [markdown]
# The `History` holds the result of every step: poses, covariances, innovations and the final map.
# `trajectory.evaluate` compares it with the truth. RMSE is the root mean square error,
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
# During the first loop every landmark is new. The robot places new landmarks while its own pose becomes less and less
# certain, so the uncertainty grows. At the end of the loop it sights the first landmarks again. It placed those when
# its pose was still well known, so the uncertainty drops. This is a *loop closure*. It needs no special code: the
# update spreads the information through the covariances between all landmarks. The next tutorial looks at them.

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
# Left: the map. If the filter is right about its own uncertainty, an ellipse contains its landmark or pose with a
# probability of 95 %. Right: the distance from the truth over time, with the distance that the filter claims.

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
# - The state holds the pose and the map. One covariance P describes the uncertainty of all of it.
# - A prediction makes the pose less certain. A sighting of a known landmark makes it more certain. A new landmark
#   extends the state.
# - Without landmarks the error grows without bound. With landmarks it grows until the loop is closed.
# - A filter gives an estimate *and* a claim about its accuracy. Check both. The later tutorials show how.
