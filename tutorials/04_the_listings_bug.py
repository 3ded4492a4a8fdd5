"""The listing's bug: two lines in the wrong order make every landmark certain, and the filter diverges."""

# %% [markdown]
# # 04 · The listing's bug
#
# A widely copied EKF-SLAM listing puts a new landmark into the covariance in two steps. First it writes the landmark's
# own block, then it assigns the landmark's whole column and row. The second step **overwrites the block with zeros**:
# the landmark is taken for exactly known, and yet correlated with the rest. No Gaussian is like that.
#
# This tutorial writes the bug in plain NumPy, shows what it does, and how two cheap checks catch it.
#
# | symbol | shape | meaning |
# |---|---|---|
# | P | (D, D) | covariance before, of the pose and the landmarks so far |
# | G_x, G_z | (2, 3), (2, 2) | derivative of the new landmark by the pose and by the sighting |
# | P_ll = G_x P_rr G_xᵀ + G_z R G_zᵀ | (2, 2) | the new landmark's own block |
# | P_sl = P_sr G_xᵀ | (D, 2) | its covariance with everything before |
# | ε = eᵀ P_rr⁻¹ e | scalar | NEES, the squared error of the pose in units of what is claimed |

# %%
import os
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from slamkit import EKFSLAM, plots, simulate
from slamkit.consistency import chi2_bounds
from slamkit.se2 import wrap
from slamkit.simulate import lesson_world

FIGURES = Path(os.environ.get("SLAMKIT_FIGURES") or Path(__file__).resolve().parent / "figures")
world = lesson_world()
motion, sensor = world.motion, world.sensor

# %% [markdown]
# ## The two ways to write it
#
# Right: three blocks, each written once. Wrong: the block first, and then whole columns of a matrix in which the new
# rows of P are still zero.


# %%
def augment_right(P, G_x, block):
    """[P, P_sl; P_lsᵀ, P_ll]."""
    cross = P[:, :3] @ G_x.T
    return np.block([[P, cross], [cross.T, block]])


def augment_wrong(P, G_x, block):
    """The listing's order: the last two assignments overwrite what the first one wrote."""
    D = len(P)
    bigger = np.zeros((D + 2, D + 2))
    bigger[:D, :D] = P
    bigger[D:, D:] = block
    bigger[:, D:] = bigger[:, :3] @ G_x.T  # the whole column, down to the block
    bigger[D:, :] = bigger[:, D:].T
    return bigger


# %% [markdown]
# ## Around them, the textbook filter
#
# Dense matrices, as in the listing; everything but the initialisation is right.


# %%
class TextbookEKF:
    def __init__(self, augment):
        self.x, self.P, self.slots = np.zeros(3), np.array(world.pose_covariance), {}
        self.augment = augment

    def predict(self, u, dt):
        F, G = motion.jacobians(self.x[:3], u, dt)
        Q = G @ motion.control_noise(u, dt) @ G.T + motion.pose_noise(self.x[:3], u, dt)
        self.x[:3] = motion.move(self.x[:3], u, dt)
        whole = np.eye(len(self.x))
        whole[:3, :3] = F
        self.P = whole @ self.P @ whole.T
        self.P[:3, :3] += Q

    def observe(self, i, z):
        pose = self.x[:3]
        if i not in self.slots:
            G_x, G_z = sensor.inverse_jacobians(pose, z)
            block = G_x @ self.P[:3, :3] @ G_x.T + G_z @ sensor.R @ G_z.T
            self.slots[i] = len(self.x)
            self.P = self.augment(self.P, G_x, block)
            self.x = np.append(self.x, sensor.invert(pose, z))
            return
        s = self.slots[i]
        H = np.zeros((2, len(self.x)))
        H[:, :3], H[:, s : s + 2] = sensor.jacobians(pose, self.x[s : s + 2])
        S = H @ self.P @ H.T + sensor.R
        K = self.P @ H.T @ np.linalg.inv(S)
        self.x = self.x + K @ sensor.residual(z, sensor.predict(pose, self.x[s : s + 2]))
        self.x[2] = wrap(self.x[2])
        self.P = (np.eye(len(self.x)) - K @ H) @ self.P


# %% [markdown]
# ## The covariance is broken from the first landmark on
#
# One prediction and one sighting are enough. A covariance has no negative eigenvalue; this one has.

# %%
for name, augment in (("right", augment_right), ("wrong", augment_wrong)):
    f = TextbookEKF(augment)
    f.predict(np.array([0.5, 0.1]), 0.2)
    smallest = []
    for i, z in enumerate([(5.0, 0.0), (7.0, 0.7), (6.0, 1.2)]):
        f.observe(i, np.array(z))
        smallest.append(np.linalg.eigvalsh(f.P)[0])
    print(
        f"{name}: smallest eigenvalue after the first, second, third landmark: "
        + ", ".join(f"{e:.1e}" for e in smallest)
    )

# %% [markdown]
# ## The demo diverges
#
# The lesson's robot drives for three seconds among three landmarks. We follow both filters and slamkit's over 40 runs
# with different noise, and look at the pose's NEES
#
#     ε = eᵀ P_rr⁻¹ e,        mean 3 if the claim is right
#
# A negative ε is possible for the broken filter only: it claims a negative variance in the direction of its error.

# %%
RUNS, SEED = 40, 7
errors = {name: [] for name in ("right", "wrong", "slamkit")}
nees = {name: [] for name in errors}
lowest = {name: [] for name in errors}
for generator in np.random.default_rng(SEED).spawn(RUNS):
    log = simulate(world, generator)
    ekf = EKFSLAM(motion, sensor, world.pose, world.pose_covariance)
    books = {"right": TextbookEKF(augment_right), "wrong": TextbookEKF(augment_wrong)}
    rows = {name: ([], [], []) for name in errors}
    for k, step in enumerate(log):
        ekf.step(step.u, step.dt, step.scan)
        for book in books.values():
            book.predict(step.u, step.dt)
            for i, z in zip(step.scan.ids, step.scan.z, strict=True):
                book.observe(i, z)
        for name, x, P in [(n, b.x, b.P) for n, b in books.items()] + [("slamkit", ekf.x, ekf.P)]:
            e = x[:3] - log.truth.poses[k + 1]
            e[2] = wrap(e[2])
            rows[name][0].append(np.hypot(e[0], e[1]))
            rows[name][1].append(e @ np.linalg.solve(P[:3, :3], e))
            rows[name][2].append(np.linalg.eigvalsh(P)[0])
    for name in errors:
        for into, values in zip((errors, nees, lowest), rows[name], strict=True):
            into[name].append(values)
errors, nees, lowest = ({n: np.array(v) for n, v in table.items()} for table in (errors, nees, lowest))
for name in errors:
    rmse = np.sqrt(np.mean(errors[name][:, -1] ** 2))
    print(
        f"{name}: final position RMSE {rmse:.3f} m, mean NEES of the last step {nees[name][:, -1].mean():.3g}, "
        f"smallest eigenvalue {lowest[name].min():.1e}"
    )
difference = np.abs(errors["right"] - errors["slamkit"]).max()
print(f"largest difference between the right listing and slamkit: {difference:.1e} m")

# %% [markdown]
# ## Two checks that catch it
#
# 1. **P must be positive semidefinite.** `np.linalg.eigvalsh(P)[0] >= 0` fails at the very first landmark.
# 2. **The NEES must stay in its band.** Over M runs its mean lies in χ²(3M)/M with 95 %. It needs the truth, so it is a
#    test for a simulation; the broken filter misses the band at once.

# %%
band = chi2_bounds(3, RUNS)
low, high = float(band.lower), float(band.upper)
inside = {name: float(np.mean((v.mean(axis=0) > low) & (v.mean(axis=0) < high))) for name, v in nees.items()}
print(f"95 % band of the mean NEES over {RUNS} runs: {low:.2f} to {high:.2f}")
for name, share in inside.items():
    print(f"{name}: share of steps inside the band: {share:.2f}")

# %% [markdown]
# ## The figure

# %%
seconds = np.arange(1, nees["right"].shape[1] + 1) * world.dt
looks = {
    "wrong": ("C3", "-", "the listing"),
    "right": ("0.35", "--", "blocks written right"),
    "slamkit": (plots.style("ekf").color, ":", "slamkit"),
}
figure, axes = plt.subplots(1, 3, figsize=(11.5, 3.9), layout="constrained")
for name, (color, line, label) in looks.items():
    width = 3 if name == "slamkit" else 1.6
    axes[0].plot(seconds, lowest[name].min(axis=0), color=color, linestyle=line, linewidth=width, label=label)
    axes[1].plot(seconds, np.sqrt(np.mean(errors[name] ** 2, axis=0)), color=color, linestyle=line, linewidth=width)
    axes[2].plot(seconds, nees[name].mean(axis=0), color=color, linestyle=line, linewidth=width)
axes[0].set(ylabel="smallest eigenvalue of P, worst run", yscale="symlog")
axes[0].set_yscale("symlog", linthresh=1e-4)
axes[0].axhline(0, color="0.7", linewidth=0.8)
axes[1].set(ylabel="RMSE of the position [m]", yscale="log")
axes[2].axhspan(low, high, color="0.85", zorder=0, label="95 % band")
axes[2].set(ylabel="mean NEES of the pose")
axes[2].set_yscale("symlog", linthresh=10)
axes[2].legend(frameon=False)
for ax in axes:
    ax.set_xlabel("time [s]")
figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False)

FIGURES.mkdir(parents=True, exist_ok=True)
print("figure:", plots.save(figure, FIGURES / "04_the_listings_bug.png", dpi=150))

# %% [markdown]
# ## Key points
#
# - A new landmark's covariance has three blocks. Write each once; never assign a whole column afterwards.
# - The bug crashes nothing. It makes P indefinite, and the filter walks away from the truth.
# - Check the eigenvalues of P in every test, and the NEES in every simulation.
