"""Why the covariance becomes dense: every landmark inherits the robot's error, and what is shared is correlated."""

# %% [markdown]
# # 02 · The covariance, and why it becomes dense
#
# EKF-SLAM keeps one covariance P over the pose and every landmark. One might hope that most of it is zero: what has the
# first landmark to do with the last one, which was never seen at the same time? This tutorial shows that the opposite
# is true, that it has to be so, and what it costs.
#
# | symbol | shape | meaning |
# |---|---|---|
# | P | (D, D), D = 3 + 2N | covariance of the pose and N landmarks |
# | P_rr, P_lr | (3, 3), (2, 3) | blocks of the robot, and of a landmark with the robot |
# | ρ_ij = P_ij / √(P_ii P_jj) | scalar | correlation of two entries, between −1 and 1 |

# %%
import os
import time
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from slamkit import EKFSLAM, Scan, plots, simulate
from slamkit.models import RangeBearing, Unicycle
from slamkit.simulate import loop_world

FIGURES = Path(os.environ.get("SLAMKIT_FIGURES") or Path(__file__).resolve().parent / "figures")

# %% [markdown]
# ## A landmark inherits the robot's error
#
# A new landmark is placed from the robot's estimate: l = g(x_r, z). Its covariance with everything that was there
# before is
#
#     P_l,s = G_x P_r,s        with G_x = ∂g/∂x_r
#
# So whatever the robot is correlated with, the landmark is too. If the robot stands 10 cm further left than it
# believes, so do all the landmarks that it places.
#
# Two landmarks that are placed from one uncertain pose are correlated at once, though no sighting ever compared them:

# %%
motion, sensor = Unicycle(0.1, 0.05), RangeBearing(0.1, 0.02)
ekf = EKFSLAM(motion, sensor, pose_covariance=np.diag([0.25, 0.25, 0.01]))
ekf.observe_scan({"left": (4.0, 0.8), "right": (4.0, -0.8)})
rho = plots.correlation(ekf.P)
print(f"correlation of the two landmarks' x: {rho[3, 5]:.3f}")

# %% [markdown]
# ## Watching it fill
#
# The same over the first loop of the simulated world. At some moments we take P apart into correlations. The share
# of pairs with |ρ| > 0.1 says how dense it is, the share with |ρ| > 0.9 how strong the ties are.

# %%
world = loop_world("range-bearing")
log = simulate(world, np.random.default_rng(1))
ekf = EKFSLAM(world.motion, world.sensor, world.pose, world.pose_covariance)
moments, shots, times, density = (30, 120, 300), [], [], {0.1: [], 0.9: []}
for k, step in enumerate(log):
    if k > moments[-1]:
        break
    ekf.step(step.u, step.dt, step.scan)
    if len(ekf.landmarks) > 1:
        times.append(step.time)
        for threshold, shares in density.items():
            shares.append(plots.correlation_density(ekf.P, threshold=threshold))
    if k in moments:
        shots.append((step.time, ekf.P, ekf.landmark_ids))
print(f"share of |correlation| > 0.1 at the end: {density[0.1][-1]:.2f}")
print(f"share of |correlation| > 0.9 at the end: {density[0.9][-1]:.2f}")

# %% [markdown]
# ## What it costs
#
# P has D² entries, of which one triangle, D²/2, has to be kept. A prediction moves the pose, so it touches the pose's
# rows only: O(D). A sighting changes everything that is correlated with what it saw, and that is everything: O(D²).
# slamkit's update is a symmetric rank-2 change of one triangle, P ← P − wᵀw. The textbook's (I − KH) P multiplies two
# D × D matrices: O(D³).

# %%
rng = np.random.default_rng(0)
print("  N   memory of P   one step of 8 sightings")
cost = []
for n in (10, 30, 100, 300):
    positions = rng.uniform(-20, 20, (n, 2))
    f = EKFSLAM(motion, sensor, pose_covariance=np.eye(3) * 1e-4)
    f.observe_scan({i: sensor.predict(np.zeros(3), p) for i, p in enumerate(positions)})
    seen = rng.choice(n, 8, replace=False)
    scan = Scan(seen.tolist(), np.array([sensor.predict(np.zeros(3), positions[i]) for i in seen]))
    spent = []
    for _ in range(60):
        before = time.perf_counter()
        f.step((0.0, 0.0), 0.1, scan)
        spent.append(time.perf_counter() - before)
    D = 3 + 2 * n
    cost.append((n, 8 * D * D, float(np.median(spent))))
    print(f"{n:4d}   {8 * D * D / 1e6:8.3f} MB   {np.median(spent) * 1e6:8.1f} µs")

# %% [markdown]
# ## The figure
#
# Above, the correlations at three moments, the last one after the loop is closed; the pose comes first, then the
# landmarks in the order in which they were met. Below, the shares over time.

# %%
figure = plt.figure(figsize=(10, 6.6), layout="constrained")
grid = figure.add_gridspec(2, 3, height_ratios=[1.35, 1])
for column, (at, P, ids) in enumerate(shots):
    plots.plot_correlation(figure.add_subplot(grid[0, column]), P, ids, time=at)
loop = 2 * np.pi / 0.025  # duration of one loop [s]
below = figure.add_subplot(grid[1, :])
look = plots.style("ekf")
for (threshold, shares), line in zip(density.items(), ("-", "--"), strict=True):
    below.plot(times, shares, color=look.color, linestyle=line, label=f"|ρ| > {threshold}")
below.axvline(loop, color="0.5", linewidth=0.8)
below.annotate("loop closed", (loop, 0.05), xycoords=("data", "axes fraction"), ha="right", rotation=90)
below.set(xlabel="time [s]", ylabel="share of all pairs", ylim=(0, 1.02), xlim=(0, times[-1]))
below.legend(loc="center left", frameon=False)

FIGURES.mkdir(parents=True, exist_ok=True)
print("figure:", plots.save(figure, FIGURES / "02_why_the_covariance_becomes_dense.png", dpi=150))

# %% [markdown]
# ## Key points
#
# - A landmark is placed by the robot, so it shares the robot's error: its covariance with all the rest is not zero.
# - The correlations are no nuisance. They carry a loop closure back to every landmark.
# - A sighting must touch all of P: O(D²) if it is done well, O(D³) if it is not. Memory is O(D²) either way.
