"""Why the covariance becomes dense: every landmark shares the robot's error, and shared errors are correlated."""

# %% [markdown]
# # 02 · The covariance, and why it becomes dense
#
# EKF-SLAM keeps one covariance P over the pose and every landmark. You might expect most of it to be zero: the first
# and the last landmark of a run were never seen at the same time. This tutorial shows that P becomes dense, why it
# must, what goes wrong if you drop the correlations, and what they cost.
#
# | symbol | shape | meaning |
# |---|---|---|
# | P | (D, D), D = 3 + 2N | covariance of the pose and N landmarks [m², m·rad, rad²] |
# | P_rr, P_lr | (3, 3), (2, 3) | block of the robot; block of a landmark with the robot |
# | G_x = ∂g/∂x_r | (2, 3) | how a new landmark moves when the pose that placed it moves |
# | ρ_ij = P_ij / √(P_ii P_jj) | scalar | correlation of two entries of the state, between −1 and 1 |

# %%
import os
import time
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one thread for everything whose time is compared

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from slamkit import EKFSLAM, Scan, evaluate, plots, simulate
from slamkit.models import RangeBearing, Unicycle
from slamkit.simulate import loop_world

FIGURES = Path(os.environ.get("SLAMKIT_FIGURES") or "figures")

# %% [markdown]
# ## A landmark inherits the robot's error
#
# The filter places a new landmark from the estimated pose: l = g(x_r, z). Let s be the state before. The covariance of
# the landmark with s is
#
#     P_ls = G_x P_rs
#
# Everything that is correlated with the robot becomes correlated with the landmark. If the robot is 10 cm farther left
# than estimated, so are all the landmarks that it places. For two landmarks a and b placed from one pose, the same
# rule applied twice gives
#
#     P_ab = G_a P_rr G_bᵀ
#
# The two are correlated at once, although no sighting has compared them:

# %%
motion, sensor = Unicycle(sigma_v=0.1, sigma_omega=0.05), RangeBearing(sigma_range=0.1, sigma_bearing=0.02)
P_rr = np.diag([0.5**2, 0.5**2, 0.1**2])  # [m², m², rad²]
z_a, z_b = np.array([4.0, 0.8]), np.array([4.0, -0.8])
ekf = EKFSLAM(motion, sensor, pose_covariance=P_rr)
ekf.observe_scan({"a": z_a, "b": z_b})

G_a, _ = sensor.inverse_jacobians(np.zeros(3), z_a)
G_b, _ = sensor.inverse_jacobians(np.zeros(3), z_b)
by_hand = G_a @ P_rr @ G_b.T
print(f"largest difference between the equation and the filter: {np.abs(by_hand - ekf.P[3:5, 5:7]).max():.1e}")
print(f"correlation of the two landmarks' x: {plots.correlation(ekf.P)[3, 5]:.2f}")

# %% [markdown]
# ## Watching it fill
#
# This is the loop world of tutorial 01, for a little more than one loop. After every step we compute the correlations
# between entries of different blocks. The share with |ρ| > 0.1 shows how dense P is. The share with |ρ| > 0.9 shows
# how many of the correlations are strong.

# %%
world = loop_world("range-bearing")
world = replace(world, controls=world.controls[:350])
log = simulate(world, np.random.default_rng(1))
assert log.truth is not None
ekf = EKFSLAM(world.motion, world.sensor, world.pose, world.pose_covariance)
times: list[float] = []
covariances: list[NDArray[np.float64]] = []
for step in log:
    if step.u is not None:
        ekf.predict(step.u, step.dt)
    ekf.observe_scan(step.scan)
    if ekf.landmarks:
        times.append(step.time)
        covariances.append(ekf.P)
P = covariances[-1]
print(f"share of |correlation| > 0.1 at the end: {plots.correlation_density(P, 0.1):.2f}")
print(f"share of |correlation| > 0.9 at the end: {plots.correlation_density(P, 0.9):.2f}")

# %% [markdown]
# The strong correlations appear with the loop closure. A sighting of the first landmark shows the filter how far it
# has drifted. The correlations pass this correction on to every landmark that the robot placed on the way. They are
# what holds the map together.
#
# ## What goes wrong without them
#
# Suppose we set the correlations between blocks to zero after every step and keep only the diagonal blocks. That would
# be cheap, but it is wrong. The landmarks carry the robot's own drift. Without the correlations the filter treats this
# drift as independent information when it sights them again, and it becomes certain of a wrong answer.
#
# The NEES ε = eᵀ P_rr⁻¹ e is the squared error e of the pose in units of the claimed covariance. If the claim is
# right, its mean is 3, one for each component.

# %%
forgetful = EKFSLAM(world.motion, world.sensor, world.pose, world.pose_covariance)
honest = EKFSLAM(world.motion, world.sensor, world.pose, world.pose_covariance)
for name, f, forget in (("all of P", honest, False), ("blocks only", forgetful, True)):
    poses, claims = [], []
    for step in log:
        if step.u is not None:
            f.predict(step.u, step.dt)
        f.observe_scan(step.scan)
        if forget:
            block = np.append([0, 0, 0], 1 + np.arange(2 * len(f.landmarks)) // 2)
            f.P = np.where(block[:, None] == block, f.P, 0.0)
        poses.append(f.pose)
        claims.append(f.pose_covariance)
    nees = evaluate.pose_nees(np.array(poses), np.array(claims), log.truth.poses[1:]).values
    error = np.linalg.norm(np.array(poses)[:, :2] - log.truth.poses[1:, :2], axis=1)
    print(f"{name}: position RMSE: {np.sqrt(np.mean(error**2)):.2f} m")
    print(f"{name}: mean NEES: {nees.mean():.1f}")

# %% [markdown]
# In this run the filter without correlations is not far off. But it claims an accuracy that it does not have. That
# misleads everything that uses the claim, for example a planner, or a gate that decides which sightings to accept.

# %% [markdown]
# ## What it costs
#
# P has D² entries of 8 bytes. A prediction moves only the pose, so it changes only the pose's rows: O(D). A sighting
# changes everything that is correlated with the landmark, which is everything. The form of the update matters:
#
#     textbook:   P ← (I − K H) P                                a product of D × D matrices, O(D³)
#     slamkit:    P ← P − wᵀ w,   w = L⁻¹ H P,   S = L Lᵀ        a rank-2 change of one triangle, O(D²) at most
#
# The textbook form below works on P alone, so it does not include the other work of a filter step.


# %%
def textbook_update(P: NDArray[np.float64], H: NDArray[np.float64], R: NDArray[np.float64]) -> NDArray[np.float64]:
    """P after one sighting, as it is usually written down."""
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    updated: NDArray[np.float64] = (np.eye(len(P)) - K @ H) @ P
    return updated


def median_seconds(repeats: int, f: EKFSLAM, scan: Scan, dense: bool) -> float:
    """Time of one step with the sightings of a scan [s]."""
    spent = []
    for _ in range(repeats):
        P = f.P
        before = time.perf_counter()
        if dense:
            for landmark in scan.ids:
                s = 3 + 2 * f.landmark_ids.index(landmark)
                H = np.zeros((2, len(P)))
                H[:, :3], H[:, s : s + 2] = sensor.jacobians(f.pose, f.landmarks[landmark])
                P = textbook_update(P, H, sensor.R)
        else:
            f.step((0.0, 0.0), 0.1, scan)
        spent.append(time.perf_counter() - before)
    return float(np.median(spent))


rng = np.random.default_rng(0)
sizes, memory, quick, slow = [10, 30, 100, 300], [], [], []
print("  N     P [MB]   slamkit [µs]   textbook [µs]   for a step of 8 sightings")
for n in sizes:
    positions = rng.uniform(-20, 20, (n, 2))
    f = EKFSLAM(motion, sensor, pose_covariance=1e-4 * np.eye(3))
    f.observe_scan({i: sensor.predict(np.zeros(3), p) for i, p in enumerate(positions)})
    seen = rng.choice(n, 8, replace=False).tolist()
    scan = Scan(tuple(seen), np.array([sensor.predict(np.zeros(3), positions[i]) for i in seen]))
    memory.append(f.P.nbytes / 1e6)
    quick.append(1e6 * median_seconds(50, f, scan, dense=False))
    slow.append(1e6 * median_seconds(5, f, scan, dense=True))
    print(f"{n:3d}   {memory[-1]:8.3f}   {quick[-1]:12.0f}   {slow[-1]:13.0f}")
print(f"textbook over slamkit at N = {sizes[-1]}: {slow[-1] / quick[-1]:.0f} times")

# %% [markdown]
# ## The figure
#
# Top: the correlations at three moments. The pose comes first, then the landmarks in the order of their first
# sighting. The checked pattern comes from x and y. Bottom: the shares over time, and memory and time against the size
# of the map.

# %%
figure = plt.figure(figsize=(11, 7.4), layout="constrained")
(above,), (below,) = figure.subfigures(2, 1, squeeze=False, height_ratios=[1.15, 1])
moments = [30, 200, 349]
images = above.subplots(1, 3)
for ax, k in zip(images, moments, strict=True):
    plots.plot_correlation(ax, covariances[k], time=times[k], max_ids=0, colorbar=False)
above.colorbar(images[-1].images[0], ax=images, shrink=0.85, pad=0.015, label="correlation ρ")

left, middle, right = below.subplots(1, 3, width_ratios=[1.7, 1, 1])
plots.plot_density(left, covariances, times, thresholds=(0.1, 0.5, 0.9))
for k in moments:
    left.axvline(times[k], color="0.6", linewidth=0.8)
middle.loglog(sizes, memory, color="black", marker="s", markersize=4)
middle.set(xlabel="landmarks N", ylabel="memory of P [MB]")
right.loglog(sizes, slow, color="0.45", linestyle="--", marker="^", markersize=4, label="textbook, (I − KH) P")
right.loglog(sizes, quick, color=plots.style("ekf").color, marker="o", markersize=4, label="slamkit")
right.set(xlabel="landmarks N", ylabel="one step, 8 sightings [µs]")
right.legend(loc="upper left", frameon=False, fontsize="small")
for ax in (middle, right):
    ax.set_xticks(sizes, [str(n) for n in sizes])
    ax.minorticks_off()
    ax.grid(color="0.9")

FIGURES.mkdir(parents=True, exist_ok=True)
print("figure:", plots.save(figure, FIGURES / "02_why_the_covariance_becomes_dense.png", dpi=150))

# %% [markdown]
# ## Key points
#
# - The robot places every landmark, so each landmark shares the robot's error. Its covariance with the rest of the
#   state is not zero.
# - The correlations carry a loop closure back to every landmark. A filter that drops them becomes certain of a wrong
#   answer.
# - Memory is O(D²). A good update is O(D²), the textbook form is O(D³).
