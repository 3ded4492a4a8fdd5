"""Gauge freedom: no sighting measures how robot and map are turned together, but the standard EKF claims it."""

# %% [markdown]
# # 07 · Gauge freedom
#
# A robot stands still and sights five landmarks three hundred times. Its map becomes more and more accurate. It cannot
# learn its own heading: if you turn the robot and all landmarks together, every sighting stays the same. But the
# standard EKF claims to learn it. This tutorial shows this, explains it with equations, and shows three tests that
# find filters with this fault: nullity, gauge deviation and the stochastic-gauge test.
#
# | symbol | shape | meaning |
# |---|---|---|
# | p, θ, lᵢ | (2,), scalar, (2,) | position [m] and heading [rad] of the robot, position of a landmark [m] |
# | s = (p, θ, l₁ … l_N) | (D,), D = 3 + 2N | the state |
# | T | (3,) | a rigid motion of the plane: a shift [m, m] and a turn [rad] |
# | N | (D, 3) | the null directions: how s moves when robot and map are shifted and turned together |
# | n | (D,) | third column of N: the turn |
# | H | (2, D) | Jacobian of a sighting by s; R (2, 2) is the covariance of its noise |
# | J = [0 −1; 1 0] | (2, 2) | rotation by a quarter turn |

# %%
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from slamkit import EKFSLAM, FirstEstimatesEKFSLAM, Log, plots, se2, simulate
from slamkit.evaluate import gauge
from slamkit.filters import FILTERS
from slamkit.simulate import loop_world, standing_world

FIGURES = Path(os.environ.get("SLAMKIT_FIGURES") or "figures")

# %% [markdown]
# ## What no sighting sees
#
# There are five landmarks at a distance of ten metres. Move the robot and all landmarks by any T, and predict the
# sightings again:

# %%
world = standing_world(np.deg2rad(5.0))
sensor = world.sensor
places = np.array(list(world.landmarks.values()))  # (5, 2)
T = np.array([7.0, -2.0, 1.3])
moved_pose, moved_places = se2.compose(T, world.pose), se2.transform(T, places)
difference = max(
    np.abs(sensor.residual(sensor.predict(moved_pose, b), sensor.predict(world.pose, a))).max()
    for a, b in zip(places, moved_places, strict=True)
)
print(f"robot and map moved as one, largest change of a sighting: {difference:.1e}")

# %% [markdown]
# These motions are the three rigid motions of the plane. They are the **gauge** of SLAM. A small one moves the state
# along the columns of
#
#     N = [I J p; 0 1; I J l₁; …; I J l_N]
#
# The first two columns are shifts. The third is a turn about the origin of the world, which moves each point x by J x.
# No sighting changes, so
#
#     H N = 0
#
# if H and N are evaluated at the same state. A map without a known heading is not wrong: it is right up to T. Where T
# matters, the start or a compass must provide it.
#
# ## A robot that stands still
#
# At the start the heading is known with standard deviation σ₀, and no sighting adds information about it. What does
# the filter claim after 300 scans?

# %%
RUNS = 10
starts = np.array([0.5, 1.0, 2.0, 5.0, 10.0, 20.0])  # σ₀ [deg]
filters = {"ekf": EKFSLAM, "fej": FirstEstimatesEKFSLAM}
claims = {name: np.empty((len(starts), RUNS, len(world.controls))) for name in filters}  # σ_θ after each scan [deg]
errors = {name: np.empty((len(starts), RUNS)) for name in filters}  # of the heading at the end [deg]
for row, start in enumerate(starts):
    standing = standing_world(np.deg2rad(start))
    for run, rng in enumerate(np.random.default_rng(1).spawn(RUNS)):
        log = simulate(standing, rng)
        assert log.truth is not None
        for name, Filter in filters.items():
            history = Filter(standing.motion, sensor, standing.pose, standing.pose_covariance).run(log)
            claims[name][row, run] = np.degrees(np.sqrt(history.pose_covariances[:, 2, 2]))
            errors[name][row, run] = np.degrees(se2.wrap(history.poses[-1, 2] - log.truth.poses[-1, 2]))
final = {name: values[..., -1].mean(axis=1) for name, values in claims.items()}  # (6,) [deg]
rmse = {name: np.sqrt(np.mean(values**2, axis=1)) for name, values in errors.items()}  # (6,) [deg]
spread = claims["ekf"][..., -1].std(axis=1, ddof=1) / np.sqrt(RUNS)
for row, start in enumerate(starts):
    print(f"from {start:g} deg, EKF claims: {final['ekf'][row]:.3f} ± {spread[row]:.3f} deg")
    print(f"from {start:g} deg, EKF is off by: {rmse['ekf'][row]:.2f} deg (RMSE)")
    print(f"from {start:g} deg, first-estimates EKF claims: {final['fej'][row]:.3f} deg")
    print(f"from {start:g} deg, first-estimates EKF is off by: {rmse['fej'][row]:.2f} deg (RMSE)")

# %% [markdown]
# The claim of the standard EKF falls, but the error does not. From 2° on, the claim hardly depends on σ₀: a robot that
# starts with 20° ends with about the same claim as one that starts with 2°.
#
# ## How the EKF learns it, in equations
#
# The robot does not move, so there are only updates. In the inverse of P, the information matrix, updates add up. Let
# P₀ be the covariance when the map has just been started. Each later sighting adds one term:
#
#     P_k⁻¹ = P_0⁻¹ + Σ_j H_jᵀ R⁻¹ H_j
#
# Let n₀ be the turn at that start. The information along it is 1/σ₀² at first, and later
#
#     n₀ᵀ P_k⁻¹ n₀ = 1/σ₀² + Σ_j |R^(−1/2) H_j n₀|²
#
# The sum should be zero. It is zero if every H_j has the same null direction. But the standard EKF evaluates H_j at
# its estimate ŝ_j. The null direction there is n_j = n(ŝ_j), and it moves with every correction:
#
#     H_j n₀ = H_j (n₀ − n_j) ≠ 0,        n₀ − n_j = (J (p̂₀ − p̂_j), 0, J (l̂₁,₀ − l̂₁,_j), …)
#
# When the estimate of a landmark has moved by some decimetres, every further sighting of it counts as information
# about the heading. This does not depend on what is measured: the innovation y does not enter P, only H does.
#
# We now compute the sum from H alone and compare it with the covariance of the filter. (`order="batch"` linearises the
# whole scan at one ŝ_j.)

# %%
log = simulate(world, np.random.default_rng(1))
steps = list(log)
ekf = EKFSLAM(world.motion, sensor, world.pose, world.pose_covariance, order="batch")
ekf.observe_scan(steps[0].scan)  # starts the five landmarks
n_start = gauge.null_directions(ekf)[:, 2]
whiten = np.linalg.inv(np.linalg.cholesky(sensor.R))
information = n_start @ np.linalg.solve(ekf.P, n_start)
print(f"information on the turn when the map has been started: {information:.2f} / rad²")
print(f"1/σ₀²: {1 / np.deg2rad(5.0) ** 2:.2f} / rad²")
learnt = 0.0
for step in steps[1:]:
    for row, landmark in enumerate(ekf.landmark_ids):
        H_pose, H_landmark = sensor.jacobians(ekf.pose, ekf.landmarks[landmark])
        along = H_pose @ n_start[:3] + H_landmark @ n_start[3 + 2 * row : 5 + 2 * row]  # H n₀
        learnt += float(np.sum((whiten @ along) ** 2))
    ekf.observe_scan(step.scan)
claimed = n_start @ np.linalg.solve(ekf.P, n_start)
print(f"learnt in {len(steps) - 1} scans, by hand: {learnt:.2f} / rad²")
print(f"learnt in {len(steps) - 1} scans, by the filter's covariance: {claimed - information:.2f} / rad²")
print(f"relative difference: {abs(claimed - information - learnt) / learnt:.1e}")

# %% [markdown]
# ## How to avoid it
#
# H contains the vectors from the robot to the landmark. They must be evaluated at points that do not move. The
# **first-estimates** EKF uses the first estimate of every landmark and the predicted position of the robot. The
# rotation and the innovation use the newest estimate. Then H_j n₀ = 0 in every scan. The **observability-constrained**
# EKF uses the points nearest to the estimates for which this holds. The **invariant** EKF changes the coordinates of
# the error so that N is constant. The **ideal** EKF uses the truth, which does not move.

# %%
for name in ("fej", "oc", "invariant"):
    f = FILTERS[name](world.motion, sensor, world.pose, world.pose_covariance, order="batch")
    for step in steps:
        f.observe_scan(step.scan)
    print(f"{name}, gauge deviation after {len(steps)} scans: {np.degrees(gauge.gauge_deviation(f)):.6f} deg")
print(f"ekf, gauge deviation after {len(steps)} scans: {np.degrees(gauge.gauge_deviation(ekf)):.6f} deg")

# %% [markdown]
# ## Test 1: nullity
#
# Now the robot moves. Let Φ_k be the Jacobian of a step. Stack what each sighting measures of the initial state:
#
#     O = [R^(−1/2) H_0; R^(−1/2) H_1 Φ_0; R^(−1/2) H_2 Φ_1 Φ_0; …]
#
# The null space of O contains the directions that no sighting has measured. Its dimension, the nullity, must be that
# of the gauge: **three**. The test uses the Jacobians that the filter really used, so it judges the filter. Here are
# forty steps among five landmarks:

# %%
course = gauge.observability_world()
log = simulate(course, np.random.default_rng(1))
family = ("ekf", "fej", "oc", "invariant", "ideal")


def options(name: str, log: Log) -> dict[str, Any]:
    """Options of a filter: the ideal filter needs the truth."""
    return {"truth": log.truth} if name == "ideal" else {}


values, deviations = {}, {}
for name in family:
    f = FILTERS[name](course.motion, course.sensor, course.pose, course.pose_covariance, **options(name, log))
    found = gauge.nullity(f, log)
    values[name] = found.singular_values
    deviations[name] = gauge.gauge_deviations(f, log)
    print(f"{name}, nullity: {found.nullity}")
    print(f"{name}, third smallest singular value: {found.singular_values[-3]:.1e}")

# %% [markdown]
# The nullity of the standard EKF is two. The two columns of N for shifts are the same at every estimate, so the shifts
# remain unobservable. The turn does not.
#
# ## Test 2: gauge deviation
#
#     √[(Nᵀ P⁻¹ N)⁻¹]_θθ
#
# is the standard deviation that the filter claims for the turn of robot and map together. Motion may increase it. No
# sighting may decrease it.

# %%
for name in family:
    print(f"{name}, gauge deviation falls by: {np.degrees(gauge.gauge_drop(deviations[name])):.3f} deg")

# %% [markdown]
# ## Test 3: the stochastic gauge
#
# The first two tests look at matrices. The third looks at the estimates. Run the same data twice, once from an exactly
# known start and once from an uncertain one. The landmarks *as the robot sees them*, Cᵀ(l − p) with C the rotation by
# θ, must not depend on it. A filter that mixes the gauge with the map gives different answers. This is the largest
# difference on 300 steps of the loop world:

# %%
loop = loop_world()
log = simulate(replace(loop, controls=loop.controls[:300]), np.random.default_rng(1))
angles = (1.0, 5.0, 20.0)  # σ₀ [deg]
apart: dict[str, list[float]] = {name: [] for name in family}  # [m]
for name in family:
    for angle in angles:
        P0 = np.diag([0.1**2, 0.1**2, np.deg2rad(angle) ** 2])
        largest = gauge.stochastic_gauge(FILTERS[name], loop.motion, loop.sensor, log, P0, **options(name, log))
        apart[name].append(largest)
        print(f"{name}, stochastic gauge at {angle:.0f} deg: {largest:.1e} m")

# %% [markdown]
# There is a weaker test that all filters pass: transform the whole problem to another frame, and every estimate must
# transform with it. The standard EKF passes it. Its fault does not depend on the choice of the frame, but on how
# *uncertain* the frame is.

# %%
for name in family:
    off = gauge.equivariance(FILTERS[name], loop.motion, loop.sensor, log, T, **options(name, log))
    print(f"{name}, equivariance, largest deviation: {off:.1e}")

# %% [markdown]
# ## The figure
#
# Top: the standing robot. Left is the claimed standard deviation of the heading after each scan (mean of ten runs, for
# six values of σ₀). Right is the claim at the end with the error. Bottom: the moving robot. Left are the singular
# values of O, of which the last three must be zero up to rounding. Right is the stochastic-gauge test.

# %%
figure = plt.figure(figsize=(11, 7.8), layout="constrained")
panels = figure.subplot_mosaic([["scans", "end"], ["values", "apart"]])
ekf_look, fej_look = plots.style("ekf"), plots.style("fej")

ax = panels["scans"]
scans = np.arange(1, claims["ekf"].shape[-1] + 1)
for row in range(len(starts)):
    for name, look in (("ekf", ekf_look), ("fej", fej_look)):
        label = look.label if row == 0 else None
        ax.plot(scans, claims[name][row].mean(axis=0), color=look.color, linestyle=look.linestyle, label=label)
ax.set(xlabel="scans", ylabel="claimed σ of the heading [deg]", xscale="log", yscale="log", xlim=(1, scans[-1]))
ax.set_ylim(bottom=0.2)
ax.legend(loc="lower left", frameon=False)

ax = panels["end"]
ax.plot(starts, starts, color="0.55", linewidth=3, alpha=0.6, label="nothing is learnt")
for name, look in (("ekf", ekf_look), ("fej", fej_look)):
    (line,) = ax.plot(starts, final[name], color=look.color, linestyle=look.linestyle, marker=look.marker)
    line.set_label(f"{look.label}, claimed")
    (points,) = ax.plot(starts, rmse[name], color=look.color, linestyle="none", marker=look.marker, fillstyle="none")
    points.set_label(f"{look.label}, RMSE")
ax.set(xlabel="σ of the heading at the start [deg]", ylabel="at the end [deg]", xscale="log", yscale="log")
ax.legend(loc="upper left", frameon=False, fontsize="small")

ax = panels["values"]
for name in family:
    look = plots.style(name)
    ax.plot(
        np.arange(1, len(values[name]) + 1), values[name], color=look.color, linestyle=look.linestyle,
        marker=look.marker, label=look.label,
    )  # fmt: skip
ax.set(xlabel="number of the singular value", ylabel="singular value of O", yscale="log")
ax.legend(loc="lower left", frameon=False)

ax = panels["apart"]
for name in family:
    look = plots.style(name)
    ax.plot(angles, apart[name], color=look.color, linestyle=look.linestyle, marker=look.marker, label=look.label)
ax.set(xlabel="σ of the heading at the start [deg]", ylabel="largest change of the relative map [m]", yscale="log")
ax.set_xticks(angles, [f"{angle:g}" for angle in angles])
ax.legend(loc="center right", frameon=False)
for ax in (panels["scans"], panels["end"]):
    ax.set_yticks([0.5, 1, 2, 5, 10, 20], ["0.5", "1", "2", "5", "10", "20"])
    ax.minorticks_off()
panels["scans"].set_xticks([1, 3, 10, 30, 100, 300], ["1", "3", "10", "30", "100", "300"])
panels["end"].set_xticks(starts, [f"{start:g}" for start in starts])

FIGURES.mkdir(parents=True, exist_ok=True)
print("figure:", plots.save(figure, FIGURES / "07_gauge_freedom.png", dpi=150))

# %% [markdown]
# ## Key points
#
# - If robot and map move together, all sightings stay the same. These three directions are the gauge. A filter must
#   not gain information about them.
# - The standard EKF claims to learn the turn. It evaluates each H at the current estimate, so the sightings have no
#   common null direction for the turn.
# - This needs no bad luck and no bad data. It follows from the linearisation points in H alone.
# - The nullity must be 3, the gauge deviation must not fall, and an uncertain start must not change the relative map.
# - First estimates, the observability constraint and the invariant error give all sightings the same null space.
