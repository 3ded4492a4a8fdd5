"""The listing's bug: two lines in the wrong order remove the uncertainty of new landmarks, and the filter diverges."""

# %% [markdown]
# # 04 · The listing's bug
#
# A widely copied EKF-SLAM listing adds a new landmark to the covariance in two steps. First it writes the landmark's
# own block. Then it assigns the landmark's whole column and row. The second step **overwrites the block with zeros**.
# The result says that the landmark is exactly known and yet correlated with the rest of the state. No random variable
# has such a covariance.
#
# This tutorial writes the filter of the listing in plain NumPy, once with the bug and once without. It shows what the
# bug does, and two checks that find it. slamkit's own filter runs beside them.
#
# | symbol | shape | meaning |
# |---|---|---|
# | P | (D, D) | covariance of the pose (x, y, θ) [m, m, rad] and the landmarks so far |
# | P_rr, P_sr | (3, 3), (D, 3) | block of the pose; columns of the pose |
# | G_x, G_z | (2, 3), (2, 2) | derivatives of the new landmark by the pose and by the sighting z = (r, β) |
# | R | (2, 2) | covariance of the noise of a sighting |
# | ε = eᵀ P_rr⁻¹ e | scalar | NEES: the squared error e of the pose in units of the claimed covariance |

# %%
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import ArrayLike, NDArray

from slamkit import EKFSLAM, InputError, evaluate, plots, simulate
from slamkit.errors import DivergenceError
from slamkit.se2 import wrap
from slamkit.simulate import lesson_world

FIGURES = Path(os.environ.get("SLAMKIT_FIGURES") or "figures")
Array = NDArray[np.float64]

# %% [markdown]
# ## What must be written
#
# A new landmark l = g(x_r, z) adds three blocks to P:
#
#     P_ll = G_x P_rr G_xᵀ + G_z R G_zᵀ        P_sl = P_sr G_xᵀ        P_ls = P_slᵀ
#
# The right order writes each block once. The wrong order writes P_ll first and then assigns the column `[:, D:]` down
# to the last row. It computes the last two rows from entries that are still zero, so it replaces P_ll by zeros.


# %%
def augment_right(P: Array, G_x: Array, P_ll: Array) -> Array:
    """[P, P_sl; P_ls, P_ll]."""
    P_sl = P[:, :3] @ G_x.T
    return np.block([[P, P_sl], [P_sl.T, P_ll]])


def augment_wrong(P: Array, G_x: Array, P_ll: Array) -> Array:
    """The blocks in the order of the listing."""
    D = len(P)
    bigger = np.zeros((D + 2, D + 2))
    bigger[:D, :D] = P
    bigger[D:, D:] = P_ll
    bigger[:, D:] = bigger[:, :3] @ G_x.T  # the whole column: overwrites P_ll
    bigger[D:, :] = bigger[:, D:].T
    return bigger


# %% [markdown]
# ## Around them, the listing's filter
#
# The matrices are dense, and the filter processes one sighting after the other. Everything except the initialisation
# is right. The models are a unicycle with noise on the pose, and range and bearing.

# %%
world = lesson_world()
motion, sensor = world.motion, world.sensor


class ListingEKF:
    """EKF-SLAM as listings write it, with the initialisation as an argument."""

    def __init__(self, augment: Callable[[Array, Array, Array], Array]) -> None:
        self.x, self.P = np.array(world.pose), np.array(world.pose_covariance)
        self.slots: dict[object, int] = {}
        self.augment = augment

    def predict(self, u: ArrayLike, dt: float) -> None:
        control = np.asarray(u, dtype=float)
        F = np.eye(len(self.x))
        F[:3, :3], _ = motion.jacobians(self.x[:3], control, dt)
        Q = motion.pose_noise(self.x[:3], control, dt)
        self.x[:3] = motion.move(self.x[:3], control, dt)
        self.P = F @ self.P @ F.T
        self.P[:3, :3] += Q

    def observe(self, landmark_id: object, z: Array) -> None:
        pose = self.x[:3]
        if landmark_id not in self.slots:
            G_x, G_z = sensor.inverse_jacobians(pose, z)
            P_ll = G_x @ self.P[:3, :3] @ G_x.T + G_z @ sensor.R @ G_z.T
            self.P = self.augment(self.P, G_x, P_ll)
            self.slots[landmark_id] = len(self.x)
            self.x = np.append(self.x, sensor.invert(pose, z))
            return
        at = slice(self.slots[landmark_id], self.slots[landmark_id] + 2)
        H = np.zeros((2, len(self.x)))
        H[:, :3], H[:, at] = sensor.jacobians(pose, self.x[at])
        S = H @ self.P @ H.T + sensor.R
        K = self.P @ H.T @ np.linalg.inv(S)
        self.x = self.x + K @ sensor.residual(z, sensor.predict(pose, self.x[at]))
        self.x[2] = wrap(self.x[2])
        self.P = (np.eye(len(self.x)) - K @ H) @ self.P


# %% [markdown]
# ## The first check: P must be positive semidefinite
#
# A covariance has no negative eigenvalue, because vᵀ P v is the variance of vᵀ x for every v. With the bug, one step
# and one sighting are enough to break this law.

# %%
right, wrong = ListingEKF(augment_right), ListingEKF(augment_wrong)
for name, f in (("right", right), ("wrong", wrong)):
    f.predict((0.5, 0.1), 0.2)
    for n, z in enumerate([(5.0, 0.0), (7.0, 0.7), (6.0, 1.2)], 1):
        f.observe(n, np.array(z))
        print(f"{name}, smallest eigenvalue of P after landmark {n}: {np.linalg.eigvalsh(f.P)[0]:.2e}")

# %% [markdown]
# slamkit writes each block once. It also refuses such a matrix when you assign it:

# %%
ekf = EKFSLAM(motion, sensor, world.pose, world.pose_covariance)
ekf.step((0.5, 0.1), 0.2, {1: (5.0, 0.0), 2: (7.0, 0.7), 3: (6.0, 1.2)})
print(f"slamkit, smallest eigenvalue of P after landmark 3: {np.linalg.eigvalsh(ekf.P)[0]:.2e}")
try:
    ekf.P = wrong.P
except InputError as error:
    print("slamkit refuses the listing's P:", error)

# %% [markdown]
# ## The demo diverges
#
# The robot drives for three seconds among three landmarks that are always in sight. We run this demo fifty times with
# different noise, with three filters: the listing's, the corrected listing, and slamkit's.

# %%
RUNS = 50
Record = dict[str, list[NDArray[Any]]]
names = ("wrong", "right", "slamkit")
poses: Record = {name: [] for name in names}  # of each run (K, 3)
claims: Record = {name: [] for name in names}  # (K, 3, 3)
lowest: Record = {name: [] for name in names}  # (K,) smallest eigenvalue of the whole P
truths: list[Array] = []
for rng in np.random.default_rng(7).spawn(RUNS):
    log = simulate(world, rng)
    assert log.truth is not None
    truths.append(log.truth.poses[1:])
    ekf = EKFSLAM(motion, sensor, world.pose, world.pose_covariance)
    listings = {"wrong": ListingEKF(augment_wrong), "right": ListingEKF(augment_right)}
    steps: Record = {name: [] for name in names}
    for step in log:
        assert step.u is not None
        ekf.step(step.u, step.dt, step.scan)
        steps["slamkit"].append(np.block([[ekf.x], [ekf.P]]))
        for name, f in listings.items():
            f.predict(step.u, step.dt)
            for landmark_id, sighting in zip(step.scan.ids, np.asarray(step.scan.z, dtype=float), strict=True):
                f.observe(landmark_id, sighting)
            steps[name].append(np.block([[f.x], [f.P]]))
    for name, rows in steps.items():
        beliefs = np.array(rows)  # (K, 1 + D, D): the mean above the covariance
        poses[name].append(beliefs[:, 0, :3])
        claims[name].append(beliefs[:, 1:4, :3])
        lowest[name].append(np.linalg.eigvalsh(beliefs[:, 1:])[:, 0])

truth = np.array(truths)
distance = {name: np.linalg.norm(np.array(p)[..., :2] - truth[..., :2], axis=-1) for name, p in poses.items()}
for name in names:
    last = distance[name][:, -1]
    print(f"{name}, median final error: {np.median(last):.2f} m")
    print(f"{name}, largest error of any run: {distance[name].max():.2f} m")
apart = np.abs(np.array(poses["right"]) - np.array(poses["slamkit"])).max()
print(f"largest difference between the listing put right and slamkit: {apart:.1e}")

# %% [markdown]
# Nothing crashes and nothing warns. After three seconds, half of the listing's runs are off by more than half a metre.
# The right filter stays within a few decimetres. Some of the wrong runs jump far away: an indefinite P can make S = H
# P Hᵀ + R almost singular.
#
# ## The second check: NEES
#
# The NEES compares the error with the claim. If the claim is right, ε is χ² distributed with three degrees of freedom.
# Its mean is 3, it is below 7.81 in 95 % of all cases, and it is never negative. The NEES needs the truth, so this
# check belongs in a simulation.

# %%
suspicious = {}
for name in names:
    e = evaluate.state_error(np.array(poses[name]), truth)
    epsilon = np.einsum("rki,rki->rk", e, np.linalg.solve(np.array(claims[name]), e[..., None])[..., 0])
    suspicious[name] = 100 * np.mean((epsilon < 0) | (epsilon > 7.815), axis=0)  # share of the runs, at each step
    print(f"{name}, runs with an impossible or too large NEES at the end: {suspicious[name][-1]:.0f} %")
    print(f"{name}, runs with a negative NEES at some time: {100 * np.mean((epsilon < 0).any(axis=1)):.0f} %")

# %% [markdown]
# Here we compute the formula directly, to see the impossible values. slamkit's own function raises an error instead:

# %%
try:
    evaluate.pose_nees(np.array(poses["wrong"]), np.array(claims["wrong"]), truth)
except DivergenceError as error:
    print("evaluate.pose_nees says:", error)
M = len(truth)
mean = evaluate.pose_nees(np.array(poses["slamkit"]), np.array(claims["slamkit"]), truth).values.mean(axis=0)
band = evaluate.chi2_bounds(3, M)
print(f"slamkit, mean NEES over {M} runs at the end: {mean[-1]:.2f}")
print(f"95 % band of that mean: {float(band.lower):.2f} to {float(band.upper):.2f}")

# %% [markdown]
# ## The figure
#
# Left: the first of the fifty runs. Right: all runs, with the smallest eigenvalue of P, the position error, and the
# share of runs with a suspicious NEES. A right filter shows a share of 5 %.

# %%
figure = plt.figure(figsize=(11, 5.8), layout="constrained")
panels = figure.subplot_mosaic(
    [["map", "eigenvalue"], ["map", "error"], ["map", "nees"]], width_ratios=[1, 1.25], sharex=False
)
looks = {"wrong": ("black", ":", "the listing"), "slamkit": (plots.style("ekf").color, "-", "slamkit")}
seconds = world.dt * np.arange(1, truth.shape[1] + 1)

ax = panels["map"]
ax.plot(*truth[0, :, :2].T, color="0.6", linewidth=5, label="truth")
for name, (color, line, label) in looks.items():
    way = poses[name][0]
    ax.plot(*way[:, :2].T, color=color, linestyle=line, marker=".", label=label)
ax.set(xlabel="x [m]", ylabel="y [m]", title="one run")
ax.set_aspect("equal", adjustable="datalim")
ax.legend(loc="best", frameon=False)

for name, (color, line, _) in looks.items():
    panels["eigenvalue"].plot(seconds, np.array(lowest[name]).T, color=color, linestyle=line, linewidth=0.7)
    panels["error"].plot(seconds, distance[name].T, color=color, linestyle=line, linewidth=0.7)
    panels["nees"].plot(seconds, suspicious[name], color=color, linestyle=line, marker=".")
panels["eigenvalue"].axhline(0, color="0.5", linewidth=0.8)
panels["eigenvalue"].set_yscale("symlog", linthresh=1e-4)
panels["eigenvalue"].set(ylabel="smallest\neigenvalue of P", title=f"{M} runs")
panels["error"].set(ylabel="position\nerror [m]", yscale="log")
panels["nees"].axhline(5, color="0.5", linewidth=0.8)
panels["nees"].set(xlabel="time [s]", ylabel="runs with a\nsuspicious NEES [%]", ylim=(-3, 103))
for row in ("eigenvalue", "error"):
    panels[row].tick_params(labelbottom=False)
figure.align_ylabels([panels[row] for row in ("eigenvalue", "error", "nees")])

FIGURES.mkdir(parents=True, exist_ok=True)
print("figure:", plots.save(figure, FIGURES / "04_the_listings_bug.png", dpi=150))

# %% [markdown]
# ## Key points
#
# - A new landmark adds three blocks. Write each of them once. Never assign a whole column over an existing block.
# - The bug raises no error. It makes P indefinite, and the estimate moves away from the truth.
# - Check the eigenvalues of P in every test. This check needs no truth and finds the bug at the first landmark.
# - Check the NEES in every simulation. It finds this bug and every other one that makes a filter overconfident.
