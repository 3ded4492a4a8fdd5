"""The family: every estimator over the same runs, compared in accuracy, consistency and cost."""

# %% [markdown]
# # 08 · The family, side by side
#
# slamkit has ten estimators. They accept the same models, the same calls and the same logs. They differ in one thing:
# where they linearise. This tutorial runs them over the same twenty logs and compares accuracy, consistency and the
# cost of a step. It shows that the inconsistency of the standard EKF lies entirely in the gauge, and it ends with
# advice on which filter to use.
#
# | name | where it linearises |
# |---|---|
# | `ekf` | at the current estimate |
# | `iterated` | at the maximum a posteriori estimate of each update |
# | `ukf`, `ukf-full` | by regression over sigma points, of the pose and one landmark or of the whole state |
# | `robocentric` | at the current estimate, in the robot's frame |
# | `fej` | at first estimates |
# | `oc`, `oc-ukf` | near the estimates, so that the gauge stays unobservable |
# | `invariant` | at the current estimate, in an error whose gauge is constant |
# | `ideal` | at the truth: a reference for simulations only |
#
# | symbol | shape | meaning |
# |---|---|---|
# | X, X̂ | (3,) | true and estimated pose, as rigid motions |
# | g = log(X̂⁻¹ X) | (3,) | error of the pose in robot coordinates |
# | r | (2N,) | errors of the landmarks **in robot coordinates**, that is, of Cᵀ(l − p) with C = R(θ) |
# | P_gg, P_gr, P_rr | (3, 3), (3, 2N), (2N, 2N) | blocks of the covariance that the filter claims for (g, r) |
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

FIGURES = Path(os.environ.get("SLAMKIT_FIGURES") or "figures")
Array = NDArray[np.float64]

# %% [markdown]
# ## The same runs for all
#
# `compare` simulates run k from the seed and k alone, and gives the same log to every filter. All filters share the
# luck of a run, so differences *between* filters, run by run, are much more precise than the numbers themselves. The
# study records a filter that fails and does not drop it. (`jobs=1` uses one process. The default uses all cores.)

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
# The tenth filter, `ukf-full`, is not in the study. Its sigma points span the whole state, so a step costs O(D³).
# `ukf` uses sigma points of the pose and one landmark, and gives the same answer:

# %%
log = simulate(world, np.random.default_rng(1))
partial, full = (
    FILTERS[name](world.motion, world.sensor, world.pose, world.pose_covariance) for name in ("ukf", "ukf-full")
)
for f in (partial, full):
    copy.deepcopy(f).run(log)  # compiles the filter, or loads its machine code
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
# There are two groups. `ekf`, `ukf` and `iterated` are less accurate. The others are about as accurate as the ideal
# filter. But the standard errors are large, because most of the error is the luck of the run, which all filters share.
# In some runs the EKF is the more accurate one. Accuracy alone is a weak criterion.
#
# ## Consistency, and where it is lost
#
# SLAM estimates two things. The positions of the landmarks *as the robot sees them* have the error r. They are
# measured. The position and rotation of robot and map together have the error g. They are not measured. The NEES
# splits exactly into a part for each:
#
#     ε = rᵀ P_rr⁻¹ r                                                              relative map, 2N
#       + (g − P_gr P_rr⁻¹ r)ᵀ (P_gg − P_gr P_rr⁻¹ P_rg)⁻¹ (g − P_gr P_rr⁻¹ r)     gauge, 3
#
# with 2N and 3 degrees of freedom. If the filter is consistent, each part divided by its degrees of freedom has mean
# 1. Here is the split at the end of the five loops:

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
# The standard EKF is consistent about the relative map. We take the difference to a filter that keeps its gauge, run
# by run:

# %%
for part, values in (("relative", relative), ("gauge", gauges)):
    print(f"ekf minus invariant, {part} NEES per dof: {mean(values['ekf'] - values['invariant'])}")

# %% [markdown]
# **All of the difference is in the gauge.** A single run shows it too. Take the run in which the EKF is most
# overconfident. Move the true robot and the true map by one rigid motion T, so that the true robot coincides with the
# estimated one:
#
#     X → T X,   lᵢ → T lᵢ,   T = X̂ X⁻¹
#
# No sighting changes. Only the three numbers of T were wrong:

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
# ## Which filters keep the gauge
#
# These are the three tests of tutorial 07, on the first hundred steps of the first run, from an uncertain start (0.1 m
# and 5°).

# %%
for name in names:
    s = summary[name]
    nullity = "-" if s["nullity"] is None else s["nullity"]
    print(
        f"{name}, gauge deviation falls by: {100 * s['gauge_deviation_drop']:4.1f} %, nullity {nullity}, "
        f"stochastic gauge {s['stochastic_gauge_m']:.0e} m"
    )

# %% [markdown]
# The `ukf` replaces the derivative by a regression and still learns the gauge. The `iterated` EKF finds the better
# optimum in every update and claims to learn even more. The `oc-ukf` keeps its gauge deviation. But its regressions
# depend on how uncertain the pose is, so its relative map does too. The third test finds this.
#
# Keeping the gauge has a price. A filter that linearises away from its estimate loses consistency in the relative map.
# This is true even of the ideal EKF, because its innovations are those of the estimate. The invariant EKF does not pay
# this price. Run by run, the others compare with it as follows:

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
# The cost does not decide the choice. A consistent filter costs little more than the EKF.
#
# ## Which one, when
#
# | use | when |
# |---|---|
# | `invariant` | by default: consistent in both parts, and no linearisation points to choose |
# | `fej` | the gauge must be kept with the smallest change to an EKF; depends on the quality of the first estimates |
# | `oc` | the gauge must be kept with linearisation points closer to the newest estimates than those of `fej` |
# | `oc-ukf` | sigma points are wanted instead of derivatives |
# | `ekf` | only the relative map matters |
# | `iterated`, `ukf` | for comparison: a better optimum or a regression does not keep the gauge |
# | `robocentric` | for comparison: it keeps the gauge, but its changes of frame cost consistency in the relative map |
# | `ideal` | as a reference in simulations |
#
# This is one simulated world. On a real robot the noise does not follow the models, and the order may differ. The page
# `docs/results/mrclam.md` has a table for the logs of MRCLAM.
#
# ## The figure
#
# Top: the two parts of the NEES per degree of freedom, with the 95 % band of twenty runs. Bottom: the gauge deviation,
# which must not fall, and the heading of the EKF, with its errors in all runs, three times their RMSE, and the claimed
# ±3σ.

# %%
figure = study.overview()
FIGURES.mkdir(parents=True, exist_ok=True)
print("figure:", plots.save(figure, FIGURES / "08_the_family.png", dpi=150))

# %% [markdown]
# ## Key points
#
# - Compare filters over the same runs, run by run. The differences are more precise than the numbers.
# - The NEES splits into the relative map, which is measured, and the gauge, which is not.
# - The relative map of the standard EKF is as consistent as that of the best filter. Its inconsistency is in the
#   gauge.
# - Iterating and sigma points do not help. A filter must keep the null space.
# - A filter that keeps it costs little more. Among these, the invariant filter was consistent in both parts.
