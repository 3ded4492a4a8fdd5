"""The family: every estimator over the same runs, and what sets them apart: accuracy, consistency, cost."""

# %% [markdown]
# # 08 · The family, side by side
#
# slamkit has ten estimators. They take the same models, the same calls and the same logs, and differ in one thing:
# where they linearise. This tutorial runs them over the same twenty logs and judges them by the same numbers: how far
# they are off, whether they know it, and what a step costs. It shows that all that is inconsistent in the standard EKF
# is a gauge that it claims to have learnt, and ends with which filter to use when.
#
# | name | where it linearises |
# |---|---|
# | `ekf` | at the current estimate |
# | `iterated` | at the maximum a posteriori estimate of each update |
# | `ukf`, `ukf-full` | nowhere: a regression over sigma points, of the pose and one landmark or of the whole state |
# | `robocentric` | at the current estimate, in the robot's frame |
# | `fej` | at first estimates |
# | `oc`, `oc-ukf` | near the estimates, so that the gauge stays unobservable |
# | `invariant` | at the current estimate, in an error whose gauge is constant |
# | `ideal` | at the truth: the yardstick, which only a simulation knows |
#
# | symbol | shape | meaning |
# |---|---|---|
# | X, X̂ | (3,) | true and estimated pose, as rigid motions |
# | g = log(X̂⁻¹ X) | (3,) | the error of the pose, seen from the robot |
# | r | (2N,) | the errors of the landmarks **as the robot sees them**, of Cᵀ(l − p) with C = R(θ) |
# | P_gg, P_gr, P_rr | (3, 3), (3, 2N), (2N, 2N) | the covariance that the filter claims for (g, r), in blocks |
# | ε | scalar | NEES of the whole state; χ² with 3 + 2N degrees of freedom if the filter is consistent |

# %%
import copy
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slamkit import EKFSLAM, plots, se2, simulate
from slamkit.evaluate import gauge
from slamkit.filters import FILTERS
from slamkit.simulate import loop_world
from slamkit.study import compare

FIGURES = Path(os.environ.get("SLAMKIT_FIGURES") or Path(__file__).resolve().parent / "figures")
Array = NDArray[np.float64]

# %% [markdown]
# ## The same runs for all
#
# `compare` simulates run k from the seed and k alone, and gives its log to every filter. So whatever bad luck a run
# has, all filters share, and differences *between* filters, run by run, are far sharper than the numbers themselves. A
# filter that fails would be recorded, not dropped. (`jobs=1` takes one process; without it, all cores.)

# %%
RUNS = 20
names = ("ekf", "iterated", "ukf", "robocentric", "fej", "oc", "oc-ukf", "invariant", "ideal")
loop = loop_world()
world = replace(loop, controls=loop.controls[:1255])  # five loops
study = compare(names, world, runs=RUNS, seed=1, jobs=1, gauge_steps=100)
summary = study.summary()
print(f"failed or diverged runs: {len(study.failures)}")


def mean(values: Array) -> str:
    """Mean over the runs (M,) with its standard error."""
    return f"{values.mean():.3f} ± {values.std(ddof=1) / np.sqrt(len(values)):.3f}"


# %% [markdown]
# The tenth, `ukf-full`, is not among them. Its sigma points span the whole state, so that a step costs O(D³); `ukf`
# takes them over the pose and one landmark, and says the same:

# %%
log = simulate(world, np.random.default_rng(1))
partial, full = (
    FILTERS[name](world.motion, world.sensor, world.pose, world.pose_covariance) for name in ("ukf", "ukf-full")
)
for f in (partial, full):
    copy.deepcopy(f).run(log)  # makes the machine code, or loads it
seconds = [f.run(log).seconds for f in (partial, full)]
apart = np.abs(partial.x - full.x) / np.sqrt(np.diag(partial.P))
print(f"ukf and ukf-full, largest difference in standard deviations: {apart.max():.1e}")
print(f"time of a step, ukf-full over ukf: {seconds[1] / seconds[0]:.0f} times")

# %% [markdown]
# ## Accuracy

# %%
for name in names:
    s = summary[name]
    print(
        f"{name}, position RMSE: {s['position_rmse_m']:.3f} ± {s['position_rmse_m_se']:.3f} m, "
        f"heading {s['heading_rmse_deg']:.2f}°, landmarks {s['landmark_rmse_m']:.3f} m"
    )
square = {name: np.array([t.mean_square_error[0] for t in study.trials[name]]) for name in names}  # (M,) [m²]
print(f"runs in which the EKF is farther off than the invariant EKF: {np.sum(square['ekf'] > square['invariant'])}")

# %% [markdown]
# Two groups. The filters from `robocentric` down are about as accurate as the ideal one; `ekf`, `ukf` and `iterated`
# are worse. But the standard errors are wide, since most of the error is the luck of the run, which is the same for
# all, and in some runs the EKF is the better one. Accuracy alone would be a weak judge.
#
# ## Consistency, and where it is lost
#
# What SLAM estimates has two parts. What lies where *as the robot sees it*, r, is measured. Where robot and map lie as
# one, g, is not. The NEES splits exactly into what is claimed of the one and of the other:
#
#     ε = rᵀ P_rr⁻¹ r                                                              relative map, 2N
#       + (g − P_gr P_rr⁻¹ r)ᵀ (P_gg − P_gr P_rr⁻¹ P_rg)⁻¹ (g − P_gr P_rr⁻¹ r)     gauge, 3
#
# with 2N and 3 degrees of freedom. Divided by these, both have the mean 1 if the filter is consistent. At the end of
# the five loops:

# %%
relative = {name: np.array([t.relative_nees / t.relative_dof for t in study.trials[name]]) for name in names}  # (M,)
gauges = {name: np.array([t.gauge_nees / t.gauge_dof for t in study.trials[name]]) for name in names}  # (M,)
for name in names:
    print(f"{name}, relative NEES per dof: {mean(relative[name])}, median {np.median(relative[name]):.2f}")
for name in names:
    print(f"{name}, gauge NEES per dof: {mean(gauges[name])}, median {np.median(gauges[name]):.2f}")
s = summary["ekf"]
print(f"95 % band of the gauge NEES per dof: {s['gauge_nees_low'] / 3:.2f} to {s['gauge_nees_high'] / 3:.2f}")

# %% [markdown]
# The relative map of the standard EKF is right: it is off by just what is claimed. So take the difference to a filter
# that keeps its gauge, run by run:

# %%
for part, values in (("relative", relative), ("gauge", gauges)):
    print(f"ekf minus invariant, {part} NEES per dof: {mean(values['ekf'] - values['invariant'])}")

# %% [markdown]
# **All of it is gauge.** To see it in a single run, take the one in which the EKF is most overconfident, and move the
# true robot and the true map by one rigid motion T, so that the true robot comes to lie on the estimated one:
#
#     X → T X,   lᵢ → T lᵢ,   T = X̂ X⁻¹
#
# No sighting changes. Three numbers are all that was wrong:

# %%
worst = int(np.argmax(gauges["ekf"]))
_, log = study.rerun(worst, "ekf")
assert log.truth is not None
ekf = EKFSLAM(world.motion, world.sensor, world.pose, world.pose_covariance)
ekf.run(log)
X = log.truth.poses[-1]
T = se2.compose(ekf.pose, se2.inverse(X))
moved = {i: se2.transform(T, place) for i, place in log.truth.landmarks.items()}
print(f"the worst run of the EKF, claimed deviation of the heading: {np.degrees(np.sqrt(ekf.P[2, 2])):.2f} deg")
print(f"the worst run of the EKF, error of the heading: {np.degrees(abs(T[2])):.2f} deg")
for when, split in (
    ("as it is", gauge.nees_split(ekf, X, log.truth.landmarks)),
    ("moved by T", gauge.nees_split(ekf, se2.compose(T, X), moved)),
):
    print(f"{when}, gauge NEES (3): {split.gauge:.2f}")
    print(f"{when}, relative NEES ({split.relative_dof}): {split.relative:.2f}")
    print(f"{when}, NEES of the whole state per dof: {split.total / (split.gauge_dof + split.relative_dof):.2f}")

# %% [markdown]
# ## Who keeps the gauge
#
# The three tests of the last tutorial, on the first hundred steps of the first run, from an uncertain start (0.1 m and
# 5°). The Jacobians of `robocentric` are not in the frame of the world, so that it has no nullity to record.

# %%
for name in names:
    s = summary[name]
    nullity = "-" if s["nullity"] is None else s["nullity"]
    print(
        f"{name}, gauge deviation falls by: {100 * s['gauge_deviation_drop']:4.1f} %, nullity {nullity}, "
        f"stochastic gauge {s['stochastic_gauge_m']:.0e} m"
    )

# %% [markdown]
# The `ukf` replaces the derivative and learns the gauge none the less, and the `iterated` EKF, whose every update is
# the better optimum, claims to learn even more. The `oc-ukf` keeps its gauge deviation; but its regressions depend on
# how uncertain the pose is, so that its relative map does too, and the third test finds that.
#
# Keeping the gauge has a price. Whoever linearises elsewhere than at the estimate pays for it in the relative map; even
# the ideal EKF does, for its innovations are those of the estimate. Run by run, against the one that does not pay:

# %%
for name in names:
    if name != "invariant":
        print(f"{name}, excess of relative NEES per dof over invariant: {mean(relative[name] - relative['invariant'])}")

# %% [markdown]
# ## Cost

# %%
for name in names:
    print(f"{name}, time of a step: {1e6 * summary[name]['seconds_per_step']:.1f} µs")
slowest = max(summary[name]["seconds_per_step"] for name in names) / summary["ekf"]["seconds_per_step"]
print(f"time of a step, the slowest of the nine over the EKF: {slowest:.1f} times")

# %% [markdown]
# None of them is so much dearer that cost would decide, and a consistent one costs little more than the EKF.
#
# ## Which one, when
#
# | use | where |
# |---|---|
# | `invariant` | by default: right in both parts, and no linearisation point to choose |
# | `fej` | the gauge must be kept with the least change to an EKF; it lives with its first estimates, good or bad |
# | `oc` | likewise, with points that stay nearer to the newest estimates |
# | `oc-ukf` | sigma points are wanted in place of derivatives |
# | `ekf` | only the relative map matters |
# | `iterated`, `ukf` | to compare with: neither a better optimum nor a regression keeps the gauge |
# | `robocentric` | to compare with: it keeps the gauge, and its changes of frame cost exactness |
# | `ideal` | in a simulation, as the yardstick |
#
# That is one world. On a real robot the noise is no longer what the models say, and the order may differ: the README
# has a table for the logs of MRCLAM.
#
# ## The figure
#
# Above, the two parts of the NEES per degree of freedom, with the 95 % band of twenty runs. Below, the gauge deviation,
# which may not fall, and the heading of the EKF: its errors in all runs, three times their RMSE, and the ±3σ that it
# claims.

# %%
figure = study.overview()
FIGURES.mkdir(parents=True, exist_ok=True)
print("figure:", plots.save(figure, FIGURES / "08_the_family.png", dpi=150))

# %% [markdown]
# ## Key points
#
# - Compare filters over the same runs, and run by run: the differences are sharper than the numbers.
# - The NEES splits into the relative map, which is measured, and the gauge, which is not.
# - The relative map of the standard EKF is as consistent as the best one's. All that it is wrong about is its gauge.
# - Neither iterating nor sigma points help: what has to be kept is the null space.
# - A filter that keeps it costs little more. Of these, the invariant one was right in both parts.
