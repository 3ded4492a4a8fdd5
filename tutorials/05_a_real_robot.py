"""A real robot: twenty-five minutes of the UTIAS data set, from the published log to a map."""

# %% [markdown]
# # 05 · A real robot
#
# In the UTIAS multi-robot data set (MRCLAM), five small robots drive among fifteen landmarks in a hall. A
# motion-capture system records their positions (Leung, Halpern, Barfoot & Liu, The International Journal of Robotics
# Research 30(8), 2011, 969-974). Nothing is simulated. The motion lags the commands by 0.2 s. The robots are slower
# than commanded. Ranges are short by 1 %. Some barcodes are misread, and the published positions of two landmarks are
# exchanged.
#
# This tutorial reads the log of one robot, makes a map from it, and shows how far to trust the result.
#
# The data are not part of slamkit. Fetch them with `slamkit fetch mrclam 1 --folder data/mrclam`, and set the
# environment variable `SLAMKIT_DATA` to the folder `data`.
#
# | symbol | shape | meaning |
# |---|---|---|
# | u = (v, ω) | (2,) | commanded speed [m/s] and turn rate [rad/s], about 67 times a second |
# | z = (r, β) | (2,) | range [m] and bearing [rad] of a landmark |
# | y, S | (2,), (2, 2) | innovation z − ẑ, and the covariance that the filter claims for it |
# | T | (3,) | rigid motion that aligns the estimated trajectory with the true one [m, m, rad] |

# %%
import os
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from slamkit import EKFSLAM, evaluate, plots, se2
from slamkit.datasets import mrclam
from slamkit.evaluate import trajectory
from slamkit.models import RangeBearing

FIGURES = Path(os.environ.get("SLAMKIT_FIGURES") or "figures")
DATA = Path(os.environ.get("SLAMKIT_DATA") or "data")
NAMES = ("MRCLAM1.zip", "MRCLAM_Dataset1.zip")  # two names under which set 1 is found
ZIP = next((path for name in NAMES if (path := DATA / "mrclam" / name).is_file()), DATA / "mrclam" / NAMES[0])
if not ZIP.is_file():
    print(f"skipped: {DATA / 'mrclam'} holds no {ZIP.name}; set SLAMKIT_DATA to the folder that holds mrclam")
    raise SystemExit(0)

# %% [markdown]
# ## What is in the log
#
# The reader handles the known faults of the files. It counts everything that it leaves out.

# %%
data = mrclam.read(ZIP, robot=3)
log = data.log
print(f"minutes: {log.schedule.times[-1] / 60:.1f}")
print(f"commands: {len(log.controls)}")
print(f"sightings of landmarks: {len(log.observations)}")
print(f"left out, sightings of other robots: {data.robot_sightings}")
print(f"left out, sightings of unknown barcodes: {data.unknown_barcodes}")
print(f"left out, commands with a repeated stamp: {data.repeated_stamps}")
print(f"gaps between commands longer than 0.5 s: {len(data.gaps)}")
print(f"the two exchanged landmarks put right: {data.landmarks_corrected}")

# %% [markdown]
# ## Run it
#
# `mrclam.models()` returns a unicycle and a range-bearing sensor, with noise that suits all five robots. The gate
# rejects sightings that do not fit the estimate. It uses the NIS,
#
#     NIS = yᵀ S⁻¹ y
#
# If the filter's claims are right, the NIS is χ² distributed with two degrees of freedom. Then less than one sighting
# in a million exceeds `mrclam.GATE`, which is 30. A rejected sighting is therefore a fault such as a misread barcode,
# or the filter is lost.
#
# The filter knows nothing about the hall. It starts at (0, 0, 0), and this start defines the frame of its map.

# %%
motion, sensor = mrclam.models()
ekf = EKFSLAM(motion, sensor, gate=mrclam.GATE)
history = ekf.run(log)
times, dead_reckoning = evaluate.dead_reckoning(log, motion)
print(f"time for the whole log: {history.seconds:.2f} s")
print(f"landmarks in the map: {len(ekf.landmarks)}")
print(f"rejected sightings: {history.rejected}")

# %% [markdown]
# ## How good is it?
#
# The truth is in the frame of the hall. So we first find the rigid motion T = (t, φ) that aligns the trajectories,
#
#     T = argmin Σ |R(φ) p_k + t − p_k*|²        over the times t_k for which there is a true position p_k*
#
# and then compare everything in one frame. The root of this mean square is the absolute trajectory error (ATE). The
# landmarks are moved by the same T and get no alignment of their own. Dead reckoning gets its own alignment.

# %%
slam = trajectory.evaluate(history.times, history.poses, log.truth, ekf.landmarks)
lost = trajectory.evaluate(times, dead_reckoning, log.truth)
print(f"dead reckoning, ATE: {lost.ate_m:.2f} m")
print(f"EKF-SLAM, ATE: {slam.ate_m:.2f} m")
print(f"EKF-SLAM, landmark RMSE: {slam.landmark_rmse_m:.3f} m")
print(f"EKF-SLAM, heading RMSE: {slam.heading_rmse_deg:.1f} deg")

# %% [markdown]
# ## Is it right about its own uncertainty?
#
# The NIS needs no truth, so you can check it on a real robot. Its mean should be 2.

# %%
print(f"mean NIS: {np.nanmean(history.nis):.2f}")

# %% [markdown]
# The mean is much smaller: the filter expects larger innovations than it gets. This is intended. The noise in
# `mrclam.models()` is about twice the scatter of single sightings, because it must also cover their **bias**. A bias
# differs from robot to robot, and it does not average out as noise does.
#
# What happens if we use the scatter alone, 0.15 m and 0.03 rad? We test all five robots.

# %%
scatter = RangeBearing(0.15, 0.03)
for robot in mrclam.robots(ZIP):
    its_log = mrclam.load(ZIP, robot)
    for name, its_sensor in (("mrclam.models()", sensor), ("scatter alone", scatter)):
        f = EKFSLAM(motion, its_sensor, gate=mrclam.GATE)
        said = f.run(its_log)
        result = trajectory.evaluate(said.times, said.poses, its_log.truth, f.landmarks)
        print(f"robot {robot}, {name}, landmark RMSE: {result.landmark_rmse_m:.3f} m, rejected: {said.rejected}")

# %% [markdown]
# Some robots gain a little and others lose. One loses part of its map: its filter has become so certain of a wrong
# answer that it rejects hundreds of good sightings, and nothing can correct it any more. On real data, too much
# claimed uncertainty costs some accuracy. Too little is dangerous.

# %% [markdown]
# ## The figure
#
# Left: the map in the frame of the hall. Dead reckoning is moved by the same T, because it started at the same pose.
# Right: the distance from the true position in that frame, and the NIS with its bounds.

# %%
figure = plt.figure(figsize=(12, 6), layout="constrained")
panels = figure.subplot_mosaic([["map", "error"], ["map", "nis"]], width_ratios=[1.05, 1])
plots.plot_map(panels["map"], history, log.truth, (times, dead_reckoning), slam.alignment)

assert log.truth is not None
rows, true_rows = trajectory.nearest(history.times, log.truth.times, tolerance=0.1)
for name, poses in (("dead_reckoning", se2.compose(slam.alignment, dead_reckoning)), ("ekf", slam.poses)):
    error = np.linalg.norm(poses[rows, :2] - log.truth.poses[true_rows, :2], axis=1)
    look = plots.style(name)
    panels["error"].plot(times[rows], error, color=look.color, linestyle=look.linestyle, label=look.label)
panels["error"].set(ylabel="distance from the truth [m]", xlim=(0, times[-1]))
panels["error"].set_ylim(0, 1.15 * panels["error"].get_ylim()[1])
panels["error"].tick_params(labelbottom=False)
panels["error"].legend(loc="upper left", frameon=False, ncols=2)
plots.plot_nis(panels["nis"], history)

FIGURES.mkdir(parents=True, exist_ok=True)
print("figure:", plots.save(figure, FIGURES / "05_a_real_robot.png", dpi=150))

# %% [markdown]
# ## Key points
#
# - Real logs have lags, gaps, biases and wrong labels. A reader must handle them and report what it left out.
# - Align before you compare. The frame of SLAM is the robot's start and not the hall.
# - One set of parameters must serve all robots. Parameters tuned to one run prove nothing.
# - The noise of a model must cover everything that the model leaves out, including bias.
