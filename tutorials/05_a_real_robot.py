"""A real robot: twenty-five minutes of the UTIAS data set, from the log as it was published to a map."""

# %% [markdown]
# # 05 · A real robot
#
# MRCLAM (Leung, Halpern, Barfoot & Liu, IJRR 30(8), 2011) has five small robots driving among fifteen landmarks in a
# hall, with the truth from a motion-capture system. Nothing in it is simulated: the motion lags the commands by 0.2 s,
# the robots are slower than commanded, ranges are short by 1 %, barcodes are misread, and the published positions of
# two landmarks are exchanged. The reader copes with what can be coped with, and counts the rest.
#
# The data are not part of slamkit. Point `SLAMKIT_DATA` to a folder that holds `mrclam/MRCLAM_Dataset1.zip`, or fetch
# it: `slamkit fetch mrclam 1 --folder data/mrclam`.
#
# | symbol | shape | meaning |
# |---|---|---|
# | u = (v, ω) | (2,) | commanded speed [m/s] and turn rate [rad/s], about 67 a second |
# | z = (r, β) | (2,) | range [m] and bearing [rad] of a landmark |
# | ATE | scalar | RMSE of the position after the best rigid alignment of the trajectory [m] |

# %%
import os
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from slamkit import EKFSLAM, metrics, plots
from slamkit.datasets import mrclam

FIGURES = Path(os.environ.get("SLAMKIT_FIGURES") or Path(__file__).resolve().parent / "figures")
DATA = Path(os.environ.get("SLAMKIT_DATA") or Path(__file__).resolve().parents[1].parent / "shared" / "data")
SET = DATA / "mrclam" / "MRCLAM_Dataset1.zip"
if not SET.is_file():
    print(f"skipped: {SET.name} is not in the data folder; set SLAMKIT_DATA to the folder that holds mrclam/")
    sys.exit(0)

# %% [markdown]
# ## What is in the log

# %%
read = mrclam.read(SET, robot=3)
log = read.log
print(f"commands: {len(log.controls)}, sightings: {len(log.observations)}, minutes: {log.end_time / 60:.1f}")
print(f"left out: {read.robot_sightings} sightings of other robots, {read.unknown_barcodes} unknown barcodes")
print(f"commands with a repeated stamp: {read.repeated_stamps}, gaps longer than 0.5 s: {len(read.gaps)}")
print(f"landmarks 11 and 17 exchanged back: {read.landmarks_corrected}")

# %% [markdown]
# ## Run it
#
# `mrclam.models()` gives the noise that suits all five robots. The gate refuses a sighting whose NIS is above 30: with
# two degrees of freedom that happens to a good sighting less than once in a million times.

# %%
motion, sensor = mrclam.models()
ekf = EKFSLAM(motion, sensor, gate=mrclam.GATE)
history = ekf.run(log)
times, dead = metrics.dead_reckoning(log, motion)
result = metrics.evaluate(history.times, history.poses, log.truth, ekf.landmarks)
lost = metrics.evaluate(times, dead, log.truth)
print(f"dead reckoning, ATE: {lost.ate_m:.2f} m")
print(f"EKF-SLAM, ATE: {result.ate_m:.2f} m")
print(f"EKF-SLAM, landmark RMSE: {result.landmark_rmse_m:.3f} m")
print(f"EKF-SLAM, heading RMSE: {result.heading_rmse_deg:.1f} deg")
print(f"refused sightings: {history.rejected}")
print(f"time for the whole log: {history.seconds:.2f} s, {history.seconds / len(history.times) * 1e6:.1f} µs a step")

# %% [markdown]
# ## Is it right about its uncertainty?
#
# The mean NIS should be 2, the dimension of a sighting. It is smaller: the noise of the sensor model is set above the
# scatter of single sightings, because it has to stand for their bias too, which does not average out. A filter that was
# given the scatter alone would be sure of a wrong map.

# %%
mean_nis = float(np.nanmean(history.nis))
print(f"mean NIS: {mean_nis:.2f} (2 if the noise were white and as large as stated)")

# %% [markdown]
# ## The figure
#
# The frame of SLAM is where the robot started; the alignment moves the result onto the truth for display.

# %%
figure, ax = plt.subplots(figsize=(7.4, 6.6), layout="constrained")
aligned = plots.plot_map(
    ax, history, log.truth, (times, metrics.evaluate(times, dead, log.truth).poses), alignment=result.alignment
)
FIGURES.mkdir(parents=True, exist_ok=True)
print("figure:", plots.save(figure, FIGURES / "05_a_real_robot.png", dpi=150))

# %% [markdown]
# ## Key points
#
# - Real logs have lags, gaps, biases and wrong labels. A reader must handle them, and say what it left out.
# - One set of parameters has to serve all robots; noise that is tuned to one run explains nothing.
# - Align before you compare: the frame of SLAM is the robot's start, not the laboratory's.
