"""Gauge freedom: no sighting says how robot and map are turned as one, yet the standard EKF claims to learn it."""

# %% [markdown]
# # 07 · Gauge freedom
#
# A robot stands still and looks three hundred times at five landmarks. It learns the map ever better. What it cannot
# learn is its own heading: turn the robot and all landmarks together, and every sighting stays the same. The standard
# EKF learns it all the same. This tutorial shows that it does, shows in equations *how*, and shows three tests that
# tell a filter that does from one that does not: nullity, gauge deviation and the stochastic-gauge test.
#
# | symbol | shape | meaning |
# |---|---|---|
# | p, θ, lᵢ | (2,), scalar, (2,) | position [m] and heading [rad] of the robot, position of a landmark [m] |
# | s = (p, θ, l₁ … l_N) | (D,), D = 3 + 2N | the state |
# | T | (3,) | a rigid motion of the plane: a shift [m, m] and a turn [rad] |
# | N | (D, 3) | the null directions: how s moves when robot and map are shifted and turned as one |
# | n | (D,) | its third column, the turn |
# | H | (2, D) | Jacobian of a sighting by s; R (2, 2) is the covariance of its noise |
# | J = [0 −1; 1 0] | (2, 2) | a quarter turn |

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

FIGURES = Path(os.environ.get("SLAMKIT_FIGURES") or Path(__file__).resolve().parent / "figures")

# %% [markdown]
# ## What no sighting sees
#
# Five landmarks, ten metres off. Move the robot and all of them by any T, and predict the sightings anew:

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
# These motions, the three of the plane, are the **gauge** of SLAM. A small one moves the state along the columns of
#
#     N = [I J p; 0 1; I J l₁; …; I J l_N]
#
# (two shifts, and a turn about the world's origin, which moves each point x by J x). No sighting changes, so
#
#     H N = 0
#
# if H and N are taken at the same state. That the robot does not know its heading is no defect of the map: the map is
# right up to T, and where T matters, the start or a compass has to give it.
#
# ## A robot that stands still
#
# The robot's heading is known to σ₀ at the start, and nothing it sees says more. After 300 scans, what is claimed?

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
# The claim of the standard EKF falls, and the error does not. And it is absurd: from 2° on it hardly matters how much
# was known. A robot that starts with 20° ends with about the claim of one that starts with 2°.
#
# ## How it is learnt, in equations
#
# The robot does not move, so all that happens is updates. In the inverse of P, the information matrix, they simply add
# up. With P₀ the covariance when the map has just been started, and one term for each later sighting,
#
#     P_k⁻¹ = P_0⁻¹ + Σ_j H_jᵀ R⁻¹ H_j
#
# Let n₀ be the turn as it looks at that start. The information along it is 1/σ₀² then, and later
#
#     n₀ᵀ P_k⁻¹ n₀ = 1/σ₀² + Σ_j |R^(−1/2) H_j n₀|²
#
# and the sum should be zero. It is zero if every H_j has the same null direction. But the standard EKF takes H_j at its
# estimate ŝ_j, whose null direction is n_j = n(ŝ_j), and that moves with every correction:
#
#     H_j n₀ = H_j (n₀ − n_j) ≠ 0,        n₀ − n_j = (J (p̂₀ − p̂_j), 0, J (l̂₁,₀ − l̂₁,_j), …)
#
# So once the estimate of a landmark has moved by some decimetres, every further sighting of it counts as information on
# the heading. Nothing in the sighting says so: the innovation y does not enter P, only H does. That is all there is to
# it. Let us add it up by hand, from H alone, and compare it with the covariance of the filter. (`order="batch"`: the
# whole scan is linearised at one ŝ_j.)

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
# ## How it is avoided
#
# The lever arms in H, from the robot to the landmark, must be taken where they do not move. The **first-estimates** EKF
# takes them at the first estimate of every landmark and the predicted position of the robot; the rotation and the
# innovation stay at the newest estimate. So H_j n₀ = 0 in every scan. The **observability-constrained** EKF looks for
# the points nearest to the estimates of which that is true. The **invariant** EKF changes the coordinates of the error
# until N is constant. The **ideal** EKF has the truth, which does not move either.

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
# For a robot that moves, with Φ_k the Jacobian of a step, stack what each sighting sees of the initial state:
#
#     O = [R^(−1/2) H_0; R^(−1/2) H_1 Φ_0; R^(−1/2) H_2 Φ_1 Φ_0; …]
#
# Its null space holds what no sighting has seen. It must have the dimension of the gauge: **three**. The Jacobians are
# those that the filter really used, so the test judges the filter. Forty steps among five landmarks:

# %%
course = gauge.observability_world()
log = simulate(course, np.random.default_rng(1))
family = ("ekf", "fej", "oc", "invariant", "ideal")


def options(name: str, log: Log) -> dict[str, Any]:
    """What a filter needs beside its models: the truth, for the ideal one."""
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
# Two for the standard EKF: the columns of N that shift are the same at every estimate, so the shifts are safe. The
# turn is not.
#
# ## Test 2: gauge deviation
#
#     √[(Nᵀ P⁻¹ N)⁻¹]_θθ
#
# is what the filter claims for the turn of robot and map as one, in degrees. Motion may make it grow; nothing that the
# robot sees may make it fall.

# %%
for name in family:
    print(f"{name}, gauge deviation falls by: {np.degrees(gauge.gauge_drop(deviations[name])):.3f} deg")

# %% [markdown]
# ## Test 3: the stochastic gauge
#
# The first two tests look at matrices. The third looks at what a user gets. Run the same data twice, from an exactly
# known start and from an uncertain one. What lies where *as the robot sees it*, Cᵀ(l − p), cannot depend on that. A
# filter that mixes the gauge with the map answers differently. On 300 steps of the loop world, the largest difference:

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
# There is a weaker test that everybody passes: put the whole problem into another frame, and every estimate must move
# with it. The standard EKF does. So it is not the choice of the frame that it is sensitive to, but how *uncertain* the
# frame is.

# %%
for name in family:
    off = gauge.equivariance(FILTERS[name], loop.motion, loop.sensor, log, T, **options(name, log))
    print(f"{name}, equivariance, largest deviation: {off:.1e}")

# %% [markdown]
# ## The figure
#
# Above, the standing robot: the deviation that is claimed for the heading, scan by scan (the mean of ten runs, for six
# values of σ₀), and at the end, beside the error. Below, the moving one: the singular values of O, of which the last
# three must be zero (here: rounding); and the stochastic-gauge test.

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
# - Robot and map, moved as one, give the same sightings. These three directions, the gauge, may never be learnt.
# - The standard EKF claims to learn the turn: each H is taken where the estimate is just then, and no turn is null to
#   all of them.
# - It takes no bad luck and no bad data: the lever arms in H alone decide.
# - Nullity must be 3, the gauge deviation must not fall, and an uncertain start must not change the relative map.
# - First estimates, the observability constraint and the invariant error give all sightings one null space.
