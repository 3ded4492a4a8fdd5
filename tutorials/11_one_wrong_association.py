"""One wrong association: two ids are swapped in one scan, and what becomes of pose, map, NIS and NEES."""

# %% [markdown]
# # 11 · One wrong association
#
# A filter is told which landmark it sees. What if it is told wrong, once? Here two landmarks change names in one scan,
# in a log of seven loops with thousands of sightings. Every sighting before is right, and every one after.
#
# This tutorial shows what the one scan does at once, which part of the damage later data heal and which they never do,
# and why; and what a gate does about it, with the cases in which it does nothing, or worse.
#
# | symbol | shape | meaning |
# |---|---|---|
# | y, S | (2,), (2, 2) | innovation of a sighting and its covariance |
# | NIS = yᵀ S⁻¹ y | scalar | surprise of a sighting, 2 on the average; needs no truth |
# | NEES = eᵀ P_rr⁻¹ e | scalar | squared error e of the pose in units of what is claimed, 3 on the average |
# | δ | (2,) | what the wrong name adds to a sighting [m, rad] |
# | H, R | (2, D), (2, 2) | Jacobian and noise of that sighting |
# | N | (D, 3) | the gauge: rigid motions of robot and map as a whole |
# | T | (3,) | rigid motion that lays one map onto another [m, m, rad] |

# %%
import os
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from slamkit import EKFSLAM, InvariantEKFSLAM, Log, evaluate, plots, se2, simulate
from slamkit.evaluate import trajectory
from slamkit.simulate import loop_world

FIGURES = Path(os.environ.get("SLAMKIT_FIGURES") or Path(__file__).resolve().parent / "figures")
Array = NDArray[np.float64]
filters = (EKFSLAM, InvariantEKFSLAM)

# %% [markdown]
# ## Two names change places
#
# The robot of the loop world is on its third loop. At 620 s it sees three landmarks, and we exchange the ids of two of
# them. The measurements stay as they are.


# %%
def swap(log: Log, time: float, pair: tuple[int, int]) -> Log:
    """The log with two ids exchanged in the scan of one instant."""
    a, b = (log.landmark_ids.index(i) for i in pair)
    ids, now = log.observation_ids.copy(), log.observation_times == time
    ids[now & (log.observation_ids == a)], ids[now & (log.observation_ids == b)] = b, a
    return replace(log, observation_ids=ids)


WHEN, PAIR = 620.0, (3, 4)
world = loop_world("range-bearing")
world = replace(world, controls=world.controls[:1759])
logs = [simulate(world, np.random.default_rng(seed)) for seed in np.random.SeedSequence(1).spawn(12)]
log = logs[0]
wrong = swap(log, WHEN, PAIR)
print(f"sightings in the log: {len(log.observations)}")
print(f"sightings with a wrong name: {np.sum(np.any(log.observations != wrong.observations, axis=1))}")
print(f"distance between the two landmarks: {np.linalg.norm(world.landmarks[3] - world.landmarks[4]):.2f} m")

# %% [markdown]
# ## At once
#
# We run the standard EKF over both logs and compare. The sightings of the scan come one after the other.

# %%
right_run = EKFSLAM(world.motion, world.sensor, world.pose, world.pose_covariance).run(log)
ekf = EKFSLAM(world.motion, world.sensor, world.pose, world.pose_covariance)
run = ekf.run(wrong)
k = int(WHEN) - 1  # the step that ends at this time
now = run.observation_times == WHEN
names = np.array(run.landmark_ids)[run.observation_ids[now]]
print(f"largest NIS of the scan, names right: {right_run.nis[now].max():.1f}")
print(f"smallest NIS of the swapped two: {run.nis[now][np.isin(names, PAIR)].min():.0f}")
moved = run.poses[k] - right_run.poses[k]
print(f"the position jumps by: {np.linalg.norm(moved[:2]):.2f} m")
print(f"the heading jumps by: {np.degrees(abs(se2.wrap(moved[2]))):.0f} deg")

# %% [markdown]
# With two names exchanged the scene looks as if the robot had turned. The filter does what it can to believe that: it
# turns the robot, and what is left over it puts into the map.
#
# ## Afterwards
#
# The next scan has the names right, and says so: its NIS is huge, too. Then the surprise dies away, within a minute.

# %%
since_then = run.observation_times - WHEN
last_loop = run.observation_times > run.times[-1] - 251
print(f"mean NIS, the next 10 s: {run.nis[(since_then > 0) & (since_then <= 10)].mean():.0f}")
print(f"mean NIS, 50 to 100 s later: {run.nis[(since_then > 50) & (since_then <= 100)].mean():.2f}")
print(f"mean NIS, the last loop: {run.nis[last_loop].mean():.2f}")
print(f"mean NIS, the last loop, names right: {right_run.nis[last_loop].mean():.2f}")

# %% [markdown]
# By the NIS everything is well again, and who has only a robot and no truth will think so. Is it?
#
# We lay the map of the swapped log onto that of the right one by the rigid motion T that fits best, `trajectory.align`.
# T says how far the scan has moved and turned the map *as a whole*, and the remainder how far it has *deformed* it.
# Both as the root mean square over the landmarks, in metres, while the log goes on. Beside the standard EKF runs the
# invariant one, which keeps its gauge (see below).


# %%
def damage(landmarks: Array, reference: Array) -> tuple[float, float, float]:
    """Displacement as a whole [m], its turn [deg], and deformation [m] of one map against another."""
    T = trajectory.align(reference, landmarks)
    laid = se2.transform(T, reference)
    lengths = [np.sqrt(np.mean(np.sum(d**2, axis=1))) for d in (laid - reference, landmarks - laid)]
    return lengths[0], np.degrees(T[2]), lengths[1]


series: dict[str, Array] = {}
for kind in filters:
    models = world.motion, world.sensor, world.pose, world.pose_covariance
    right, f = kind(*models), kind(*models)
    rows = []
    for step, swapped in zip(log, wrong, strict=True):
        assert step.u is not None and swapped.u is not None
        right.step(step.u, step.dt, step.scan)
        f.step(swapped.u, swapped.dt, swapped.scan)
        if step.time >= WHEN:
            whole, turn, bent = damage(*(np.array(list(g.landmarks.values())) for g in (f, right)))
            rows.append((step.time - WHEN, whole, turn, bent))
    series[f.name] = np.array(rows).T
for name, (since, whole, turn, bent) in series.items():
    for late in (10, len(since) - 1):
        print(f"{name}, {since[late]:.0f} s later, map displaced by: {whole[late]:.2f} m")
        print(f"{name}, {since[late]:.0f} s later, map turned by: {abs(turn[late]):.1f} deg")
        print(f"{name}, {since[late]:.0f} s later, map deformed by: {100 * bent[late]:.1f} cm")

# %% [markdown]
# The deformation goes, in both filters. The displacement goes in one of them only.
#
# ## Why
#
# A filter adds up information: a sighting with the Jacobian H adds HᵀR⁻¹H to the matrix and HᵀR⁻¹z to the vector, and
# nothing that comes later takes either out. So a wrong name leaves HᵀR⁻¹δ in the sum for good, and its share of the
# estimate of the map after k steps is, in a linear world,
#
#     d_k = P_k Hᵀ R⁻¹ δ
#
# It becomes less only as P_k becomes less: later data do not undo the error, they outvote it. And a map's covariance
# has two parts (tutorial 10). What the landmarks know of each other goes to zero as 1/t, t counted from the start, and
# the deformation goes with it:

# %%
for name, (since, _, _, bent) in series.items():
    expected = (WHEN + since[10]) / (WHEN + since[-1])
    print(f"{name}, ratio of the deformations over that of 1/t: {bent[-1] / bent[10] / expected:.2f}")

# %% [markdown]
# What the filter knows of the place of the whole map, along its gauge N, goes nowhere, because nothing measures it. An
# error there stays.
#
# In a filter that keeps its gauge every sighting has H N = 0, with one N for the whole run. So the wrong one has
# nothing to say about N either: Nᵀ HᵀR⁻¹ δ = 0, and the map as a whole is off only while it is deformed. That is the
# invariant EKF. The standard EKF takes its Jacobians where the estimate is, and this scan throws the estimate about.
# Before the jump, within it and after it H belongs to different N, and between them the sightings seem to measure how
# the world is turned. Nobody will ever contradict them.
#
# The claim knows nothing of it. So we ask for the NEES, over twelve runs.


# %%
def both(
    kind: type[EKFSLAM] | type[InvariantEKFSLAM], time: float, pair: tuple[int, int], gate: float | None
) -> dict[str, Array]:
    """Each run with right names and with two of them swapped; one row a run in every entry."""
    rows: dict[str, list[object]] = {}

    def note(name: str, value: object) -> None:
        rows.setdefault(name, []).append(value)

    for log in logs:
        assert log.truth is not None
        maps = []
        for case, data in (("right", log), ("swapped", swap(log, time, pair))):
            f = kind(world.motion, world.sensor, world.pose, world.pose_covariance, gate=gate)
            said = f.run(data)
            maps.append(np.array([f.landmarks[i] for i in world.landmarks]))
            at, late = said.observation_times == time, said.observation_times > said.times[-1] - 251
            poses, P = said.poses, said.pose_covariances
            note(f"nees {case}", evaluate.pose_nees(poses, P, log.truth.poses[1:]).values)
            note(f"nis {case}", np.mean(said.nis[late & said.accepted]))
            note(f"refused then {case}", np.sum(~said.accepted & at))
            note(f"refused later {case}", np.sum(~said.accepted & ~at))
        _, turn, bent = damage(maps[1], maps[0])
        note("turn", turn)
        note("bent", bent)
        apart = np.linalg.norm(maps[1] - maps[0], axis=1)
        exchanged = np.isin(list(world.landmarks), pair)
        note("pair", np.mean(apart[exchanged]))
        note("others", np.mean(apart[~exchanged]))
    return {name: np.array(values) for name, values in rows.items()}


def rms(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


results = {kind.name: both(kind, WHEN, PAIR, gate=None) for kind in filters}
for name, result in results.items():
    for case in ("right", "swapped"):
        nees = evaluate.summary(result[f"nees {case}"][:, -251:], dof=3)
        print(f"{name}, {case}, mean NEES of the last loop: {nees.mean:.1f} ± {nees.standard_error:.1f}")
    raised = result["nees swapped"][:, -251:].mean(axis=1) > result["nees right"][:, -251:].mean(axis=1)
    print(f"{name}, runs of {len(logs)} whose NEES the swap has raised: {raised.sum()}")
    print(f"{name}, turn of the map at the end, root mean square: {rms(result['turn']):.1f} deg")

# %% [markdown]
# The standard EKF's NEES is too large without any wrong name, for the reason that the invariant EKF's is not. The wrong
# scan multiplies it, and four loops of good data have not brought it back. (Where it has not raised it, the map
# happened to be turned the other way before.) The invariant EKF's is raised where the robot passes the two landmarks,
# in each loop by less.
#
# ## A gate
#
# The swapped sightings had an NIS of nearly a thousand and more, where χ² with two degrees of freedom exceeds 13.8 once
# in a thousand. A gate refuses whatever lies above. The standard EKF again, with a gate:

# %%
GATE = -2 * np.log(0.001)
result = both(EKFSLAM, WHEN, PAIR, GATE)
print(f"gate, wrong sightings refused, of {2 * len(logs)}: {result['refused then swapped'].sum()}")
print(f"gate, right sightings refused, a run: {result['refused later swapped'].mean():.1f}")
print(f"gate, turn of the map at the end, root mean square: {rms(result['turn']):.3f} deg")

# %% [markdown]
# All of them are refused, and what remains is a scan that was missed. The price is one right sighting in a thousand.
#
# ## What a gate does not see
#
# **Landmarks that stand close together.** We plant one 0.2 m from landmark 3, and swap these two:

# %%
close = replace(world, landmarks={**world.landmarks, 20: world.landmarks[3] + [0.2, 0.0]})
twins = simulate(close, np.random.default_rng(1))
maps = []
for data in (twins, swap(twins, WHEN, (3, 20))):
    f = EKFSLAM(world.motion, world.sensor, world.pose, world.pose_covariance, gate=GATE)
    run_close = f.run(data)
    maps.append(np.array(list(f.landmarks.values())))
then = run_close.observation_times == WHEN
print(f"close, sightings refused in that scan: {np.sum(~run_close.accepted & then)}")
print(f"close, largest NIS of the scan: {run_close.nis[then].max():.1f}")
whole, _, bent = damage(maps[1], maps[0])
print(f"close, map displaced by: {1000 * whole:.1f} mm")
print(f"close, map deformed by: {1000 * bent:.1f} mm")

# %% [markdown]
# They pass. But what fits so well cannot do much harm: the gate lets through what is small against the noise, and that
# is what it should do, once in a while.
#
# **Landmarks that are new.** There is no innovation at a first sighting, so there is nothing to gate. We swap the two
# landmarks of the first scan, when the robot sees nothing else:

# %%
cases = {"EKF": (EKFSLAM, None), "invariant EKF": (InvariantEKFSLAM, None), "EKF with a gate": (EKFSLAM, GATE)}
for label, (kind, gate) in cases.items():
    result = both(kind, 1.0, (14, 15), gate)
    nees = evaluate.summary(result["nees swapped"][:, -251:], dof=3)
    print(f"first sight, {label}, NIS of the last loop: {result['nis swapped'].mean():.2f}")
    print(f"first sight, {label}, mean NEES of the last loop: {nees.mean:.0f} ± {nees.standard_error:.0f}")
    print(f"first sight, {label}, the two landmarks are off by: {result['pair'].mean():.1f} m")
    print(f"first sight, {label}, the others are off by: {result['others'].mean():.1f} m")
    print(f"first sight, {label}, the map is turned by: {rms(result['turn']):.0f} deg")
    print(f"first sight, {label}, the map is deformed by: {100 * rms(result['bent']):.0f} cm")
    print(f"first sight, {label}, right sightings refused, a run: {result['refused later swapped'].mean():.0f}")

# %% [markdown]
# Without a gate the two landmarks stay where the first scan has put them, each in the other's place, and the whole
# world is turned round to fit. What lies where in it is right to centimetres, and the NIS is as it should be. The
# invariant EKF fares no better: the first scan defines the frame, and H N = 0 says something of small errors, not of
# half a turn.
#
# With the gate it is the *right* names that are refused, hundreds of times. The two landmarks stay wrong for ever, and
# the rest of the map pays for a pair that it may no longer see. A gate keeps out what contradicts the map. It cannot
# tell which of the two is wrong.
#
# ## The figure
#
# Above, the first run of the EKF with names swapped at 620 s, without a gate: the map in the end, and the NIS.
# Below left, the mean NEES of the pose over all the runs, with names swapped (bold) and right (thin). Below right, what
# the scan has done to the map of the first run, as a whole (bold) and by deformation (thin, with markers).

# %%
figure = plt.figure(figsize=(11.5, 9), layout="constrained")
(chart, surprise), (errors, healing) = figure.subplots(2, 2, height_ratios=[1.2, 1])
plots.plot_map(chart, run, log.truth, pose_ellipses=0)
plots.plot_nis(surprise, run)
surprise.axhline(GATE, color="black", linestyle="--", linewidth=0.9)
surprise.annotate("gate", (run.times[-1], GATE), xytext=(-4, 3), textcoords="offset points", ha="right")

band = evaluate.chi2_bounds(3, len(logs))
errors.axhspan(float(band.lower), float(band.upper), color="0.8", label=f"95 % band, {len(logs)} runs")
for name, result in results.items():
    look = plots.style(name)
    for case, width in (("swapped", 1.8), ("right", 0.7)):
        mean = result[f"nees {case}"].mean(axis=0)
        label = f"{look.label}, names {case}"
        errors.semilogy(run.times, mean, color=look.color, linestyle=look.linestyle, linewidth=width, label=label)
errors.set(xlabel="time [s]", ylabel="mean NEES of the pose", xlim=(0, run.times[-1]), ylim=(1, None))
errors.legend(loc="best", frameon=False, fontsize="small")

for name, (since, whole, _, bent) in series.items():
    look = plots.style(name)
    line = {"color": look.color, "linestyle": look.linestyle}
    healing.loglog(since[1:], whole[1:], linewidth=1.8, label=f"{look.label}, as a whole", **line)
    at = [1, 3, 10, 30, 100, 300, 700]
    healing.loglog(
        since[1:], bent[1:], linewidth=0.7, marker=look.marker, markevery=[i - 1 for i in at], markersize=5,
        label=f"{look.label}, deformation", **line,
    )  # fmt: skip
healing.set(xlabel="time since the wrong scan [s]", ylabel="the map's displacement\nby the wrong scan [m]")
healing.legend(loc="lower left", frameon=False, fontsize="small")

FIGURES.mkdir(parents=True, exist_ok=True)
print("figure:", plots.save(figure, FIGURES / "11_one_wrong_association.png", dpi=150))

# %% [markdown]
# ## Key points
#
# - A wrong association adds wrong information for good. Later data can outvote it where they measure something.
# - What lies where in the map heals, as 1/t. Where the map lies in the world does not: nothing that comes later has
#   anything to say of it. The standard EKF lets one scan turn it; a filter that keeps its gauge does not, unless it is
#   the first scan.
# - The NIS is soon normal again. It cannot tell you that the map is turned; the NEES can, and needs the truth.
# - Gate. It refuses what cannot be, at the price of a few good sightings. It does not protect new landmarks, and what
#   is wrong in the map it defends.
