"""Consistency: whether the covariance of a filter is right, and how many runs it takes to find out."""

# %% [markdown]
# # 06 · Consistency
#
# A filter gives an estimate and a covariance. Planning, gating and fusion use both. A filter is *consistent* if its
# error has zero mean and the covariance that it claims. This tutorial measures consistency on fifty simulated runs
# with the NEES and its χ² band. It shows
#
# - why one run says very little, however many steps it has,
# - what mean, median, exceedance and coverage each add,
# - what the NIS, which needs no truth, can detect and what it cannot.
#
# | symbol | shape | meaning |
# |---|---|---|
# | e = x̂ − x | (d,) | error of the estimate; here of the pose, d = 3 [m, m, rad], with the heading wrapped |
# | P | (d, d) | covariance of the estimate, as the filter claims it |
# | ε = eᵀ P⁻¹ e | scalar | NEES, the normalised estimation error squared |
# | y, S | (2,), (2, 2) | innovation z − ẑ, and the covariance that the filter claims for it |
# | ν = yᵀ S⁻¹ y | scalar | NIS, the normalised innovation squared |
# | M, K | scalars | number of runs, and of steps in each run |

# %%
import os
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from slamkit import EKFSLAM, InvariantEKFSLAM, evaluate, plots, simulate
from slamkit.models import RelativePosition
from slamkit.simulate import loop_world

FIGURES = Path(os.environ.get("SLAMKIT_FIGURES") or "figures")

# %% [markdown]
# ## The NEES
#
# An error of 10 cm is large for a filter that claims 1 cm and small for one that claims 1 m. So we measure the error
# in units of the claim. With P = L Lᵀ, the whitened error w = L⁻¹ e has covariance I if the claim is right, and
#
#     ε = eᵀ P⁻¹ e = w₁² + … + w_d²
#
# is a sum of d squared standard normal variables. It is χ² distributed with d degrees of freedom, mean d and variance
# 2d. For d = 3, it is below 7.81 with a probability of 95 %. This holds for every P, whatever its correlations:

# %%
rng = np.random.default_rng(1)
P = np.array([[0.04, 0.03, 0.002], [0.03, 0.09, 0.01], [0.002, 0.01, 0.0025]])  # [m², m·rad, rad²]
e = rng.multivariate_normal(np.zeros(3), P, size=100_000)
nees = evaluate.nees(e, P).values
print(f"right claim, mean NEES: {nees.mean():.2f}")
print(f"right claim, share of the NEES below 7.815: {np.mean(nees < 7.815):.3f}")
print(f"claimed deviations are half of the true ones, mean NEES: {evaluate.nees(e, P / 4).values.mean():.2f}")

# %% [markdown]
# If the mean is above d, the filter is overconfident. If it is below d, the filter claims too much uncertainty.
#
# ## Fifty runs
#
# The world is the loop world of tutorial 01 with a sensor of relative positions (R = 0.1² I m²). The robot drives four
# loops, fifty times, with one map and new noise in every run. Three filters get the same logs:
#
# - the standard EKF,
# - the invariant EKF, which tutorials 07 and 08 explain,
# - the invariant EKF with a wrong sensor noise: 0.07 m instead of 0.1 m.

# %%
RUNS = 50
world = loop_world()
world = replace(world, controls=world.controls[:1000])
too_good = RelativePosition(0.07)
candidates = {
    "ekf": (EKFSLAM, world.sensor),
    "invariant": (InvariantEKFSLAM, world.sensor),
    "wrong noise": (InvariantEKFSLAM, too_good),
}
names = {"ekf": "EKF", "invariant": "invariant EKF", "wrong noise": "wrong noise"}
epsilon = {name: np.empty((RUNS, len(world.controls))) for name in candidates}  # (M, K)
nis = {name: np.empty(RUNS) for name in candidates}  # mean of each run
for run, rng in enumerate(np.random.default_rng(1).spawn(RUNS)):
    log = simulate(world, rng)
    assert log.truth is not None
    for name, (Filter, sensor) in candidates.items():
        history = Filter(world.motion, sensor, world.pose, world.pose_covariance).run(log)
        truth = log.truth.poses[1:]  # the truth has one more row: the start
        epsilon[name][run] = evaluate.pose_nees(history.poses, history.pose_covariances, truth).values
        nis[name][run] = np.nanmean(history.nis)  # NaN where a sighting started a landmark
per_run = {name: eps.mean(axis=1) for name, eps in epsilon.items()}  # (M,)

# %% [markdown]
# ## One run says little
#
# A run has a thousand steps, and a mean over a thousand values should be precise. If the values were independent, the
# mean of a consistent filter would lie between χ²_{Kd}(0.025)/K and χ²_{Kd}(0.975)/K. In how many runs does it?

# %%
K = len(world.controls)
naive = evaluate.chi2_bounds(3, K)
inside = (per_run["invariant"] > naive.lower) & (per_run["invariant"] < naive.upper)
print(f"band of a mean over {K} independent steps: {float(naive.lower):.2f} to {float(naive.upper):.2f}")
print(f"invariant EKF, runs whose mean lies in that band: {inside.sum()} of {RUNS}")
print(f"invariant EKF, lowest mean NEES of a run: {per_run['invariant'].min():.1f}")
print(f"invariant EKF, highest mean NEES of a run: {per_run['invariant'].max():.1f}")

# %% [markdown]
# In hardly any, and this is not the filter's fault. The error at one step is the error at the step before plus a small
# change, so the values of ε are **correlated**. If the map is turned by 4°, it stays turned by about 4° for the rest
# of the run, and the thousand steps repeat this one draw. How many independent values is a run worth? The mean of n of
# them has the variance Var(ε)/n, so
#
#     n = Var(ε) / Var(mean of a run)

# %%
for steps in (250, K):
    beginning = epsilon["invariant"][:, :steps]
    worth = beginning.var() / beginning.mean(axis=1).var(ddof=1)
    print(f"invariant EKF, independent values that {steps} steps are worth: {worth:.1f}")
lag = 100
deviation = epsilon["invariant"] - epsilon["invariant"].mean()
correlation = np.mean(deviation[:, lag:] * deviation[:, :-lag]) / np.mean(deviation**2)
print(f"invariant EKF, correlation of the NEES with that of {lag} steps before: {correlation:.2f}")
wrong_way = np.mean(per_run["ekf"] < per_run["invariant"])
print(f"share of the runs in which the EKF's mean NEES is lower than the invariant one's: {wrong_way:.2f}")

# %% [markdown]
# A thousand steps are worth two or three independent values. One loop is worth nearly as many, so longer runs hardly
# help. More runs do. **Inference is over runs.** If you compare two filters by a single run, you sometimes prefer the
# wrong one: in these runs about every sixth time.
#
# ## What a χ² band says
#
# Choose one step, for example the last. The M values of ε at this step come from independent runs. For a consistent
# filter, their mean lies with 95 % probability within
#
#     χ²_{Md}(0.025)/M … χ²_{Md}(0.975)/M
#
# The band says no more than that. It holds for one step that was chosen beforehand. A curve over time does not have to
# be inside for 95 % of its steps, and being inside proves nothing, because neighbouring steps repeat the same draw.

# %%
band = evaluate.chi2_bounds(3, RUNS)
print(f"95 % band of the mean over {RUNS} runs: {float(band.lower):.2f} to {float(band.upper):.2f}")
for name, eps in epsilon.items():
    print(f"{names[name]}, mean NEES at the last step: {eps[:, -1].mean():.2f}")

# %% [markdown]
# ## Mean, median, exceedance
#
# The band uses only the last step. To use all steps, let each run count once, by its own mean. The standard error of
# the mean over runs is s/√M, where s is the standard deviation of the run means. This holds whatever the correlation
# within a run.
#
# A few bad runs can dominate a mean. So `evaluate.summary` also gives the median, the mean without the lowest and
# the highest tenth, and the share of runs above a limit, which is 6 for a pose. A single χ²₃ value has a median of
# 2.37 and exceeds 6 with a probability of 11 %. The mean of a run scatters less, so its median lies between 2.37 and
# 3.

# %%
for name, eps in epsilon.items():
    s = evaluate.summary(eps, dof=3)
    print(f"{names[name]}, mean NEES: {s.mean:.2f} ± {s.standard_error:.2f}")
    print(f"{names[name]}, median NEES: {s.median:.2f}")
    print(f"{names[name]}, trimmed mean NEES: {s.trimmed_mean:.2f}")
    print(f"{names[name]}, share of runs above 6: {s.share_above:.2f}")
worst = np.sort(per_run["ekf"])[-3:]
print(f"EKF, share of the sum of all runs that its three worst runs hold: {worst.sum() / per_run['ekf'].sum():.2f}")

# %% [markdown]
# ## Coverage
#
# The claim of a filter can be read as a region: the ellipsoid that contains the truth with probability p. How often is
# the truth inside, for every p? The answer is the coverage curve,
#
#     share of the values with F_χ²(ε) ≤ p
#
# For a consistent filter the curve is the diagonal. A curve below the diagonal means overconfidence. A share is
# bounded, so no single run can dominate it. It is also what the user of an uncertainty ellipse needs to know.

# %%
levels = np.linspace(0.01, 0.99, 99)
curves = {name: evaluate.coverage(eps, 3, levels) for name, eps in epsilon.items()}
for name, curve in curves.items():
    at = np.searchsorted(levels, 0.95 - 1e-9)
    print(
        f"{names[name]}, truth inside the 95 % region: "
        f"{100 * curve.share[at]:.1f} % ± {100 * curve.standard_error[at]:.1f} %"
    )

# %% [markdown]
# ## The NIS, and what it cannot see
#
# All of this needs the truth. The NIS does not. It compares the innovation with the covariance that the filter
# expected. For a consistent filter it is χ² distributed, with as many degrees of freedom as a sighting has numbers:
# two.

# %%
for name, values in nis.items():
    print(f"{names[name]}, mean NIS: {values.mean():.3f} ± {values.std(ddof=1) / np.sqrt(RUNS):.3f}")

# %% [markdown]
# The NIS detects the wrong noise at once. For the standard EKF, which is clearly overconfident, it reports no fault:
# its value is the same as that of the invariant EKF. The reason is that the EKF is overconfident about something on
# which no sighting depends: the rotation of the whole map in the world. The next tutorial is about this.
#
# ## The figure
#
# Top left: the NEES of two runs of the invariant filter, those with the lowest and the highest mean, with the 95 %
# band of a single value. Top right: the mean over the fifty runs. Bottom left: the mean of each run as one dot, with
# the mean (line) and the median (dashes) over the runs. Bottom right: the coverage with its standard error.

# %%
figure = plt.figure(figsize=(11, 7.6), layout="constrained")
panels = figure.subplot_mosaic([["runs", "nees"], ["dots", "coverage"]])
seconds = world.dt * np.arange(1, K + 1)
drawn = ("ekf", "invariant")

ax = panels["runs"]
single = evaluate.chi2_bounds(3)
ax.axhspan(float(single.lower), float(single.upper), facecolor="0.5", alpha=0.3, linewidth=0, label="95% band, 1 run")
order = np.argsort(per_run["invariant"])
for run, color in ((order[0], plots.style("invariant").color), (order[-1], "black")):
    label = f"one run, mean {per_run['invariant'][run]:.1f}"
    ax.plot(seconds, epsilon["invariant"][run], color=color, linewidth=0.8, label=label)
ax.set(xlabel="time [s]", ylabel="pose NEES, invariant EKF", yscale="log", ylim=(0.02, 60), xlim=(0, seconds[-1]))
ax.set_yticks([0.1, 1, 10], ["0.1", "1", "10"])
ax.legend(loc="lower left", bbox_to_anchor=(0, 1), frameon=False, fontsize="small", ncols=3)

plots.plot_nees(panels["nees"], seconds, {n: epsilon[n] for n in drawn}, 3, label="pose NEES, mean over runs")

ax = panels["dots"]
for name in drawn:
    look, ordered = plots.style(name), np.sort(per_run[name])
    ranks = np.arange(1, RUNS + 1)
    ax.plot(ranks, ordered, color=look.color, marker=look.marker, markersize=4, linestyle="none", label=look.label)
    ax.axhline(ordered.mean(), color=look.color, linewidth=1.2, label="mean over the runs")
    ax.axhline(np.median(ordered), color=look.color, linewidth=1.2, linestyle="--", label="median")
ax.set(xlabel="runs, in the order of their means", ylabel="mean pose NEES of a run", yscale="log")
ax.set_yticks([1, 3, 10, 30], ["1", "3", "10", "30"])
ax.legend(loc="upper left", frameon=False, fontsize="small", ncols=2)

plots.plot_coverage(panels["coverage"], levels, {n: curves[n].share for n in drawn})
for name in drawn:
    share, error = 100 * curves[name].share, 100 * curves[name].standard_error
    panels["coverage"].fill_between(
        100 * levels, share - error, share + error, color=plots.style(name).color, alpha=0.2, linewidth=0
    )

FIGURES.mkdir(parents=True, exist_ok=True)
print("figure:", plots.save(figure, FIGURES / "06_consistency.png", dpi=150))

# %% [markdown]
# ## Key points
#
# - The NEES is the squared error in units of the claim. For a consistent filter its mean is d.
# - The steps of one run are correlated. A run is worth only a few independent values. Do the inference over runs.
# - A χ² band holds for a mean over independent runs at one step. It does not hold for a mean over steps.
# - Look at the mean, the median, the share of bad runs and the coverage. A single run can dominate a mean.
# - The NIS needs no truth. It detects wrong noise, but not overconfidence about something that no sighting measures.
