"""The UTIAS multi-robot data set (MRCLAM): five robots and fifteen landmarks in a hall, nine sets.

Source: Leung, Halpern, Barfoot, Liu, "The UTIAS multi-robot cooperative localization and mapping dataset",
International Journal of Robotics Research 30(8), 2011, 969-974. Its authors ask to be cited.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from operator import index
from os import PathLike
from pathlib import Path
from zipfile import Path as ZipPath

import numpy as np

from slamkit.arrays import Array, finite_number
from slamkit.datasets.dataset import DataSet, Option, Recording, Source
from slamkit.datasets.mrclam_files import (
    FIRST_LANDMARK,
    LANDMARKS,
    TruthKind,
    number_of_set,
    opened,
    read_barcodes,
    read_commands,
    read_landmarks,
    read_sightings,
    read_true_poses,
    readable,
    robots_in,
)
from slamkit.errors import InputError, LogFileError
from slamkit.logs import Log, Truth
from slamkit.models import RangeBearing, Unicycle
from slamkit.se2 import wrap

COMMAND_DELAY = 0.22  #: by how much the motion lags the commands [s]: best fit of the true turn rates of set 1
RANGE_SCALE = 1.008  #: true over measured range, least squares over each robot of set 1, mean (1.000 to 1.016)
GATE = 30.0  #: largest NIS to accept; with a tight gate a filter rejects its own map
LONGEST_DELAY = 60.0  #: a longer delay [s] is refused as a mistake of units
LONGEST_INTERVAL = 0.5  #: a longer time [s] between two commands is reported as a gap; commands come at about 67 Hz

# How set 1 was published: subject → barcode, x [m], y [m]. The positions of these two landmarks are exchanged. All six
# numbers are compared, so a copy that has been corrected in either file is not changed.
_EXCHANGED = {11: (18, 3.15071999, 2.38294871), 17: (61, 0.03596156, -2.84396626)}
_SAME_PLACE = 5e-3  # [m]


@dataclass(frozen=True, eq=False)
class Mrclam:
    """One robot's log, and what the reader found, left out or corrected."""

    log: Log  #: controls (v [m/s], ω [rad/s]), observations (range [m], bearing [rad]), ids: subject numbers
    robot: int  #: whose log it is, 1 to 5
    set_number: int | None  #: 1 to 9; None where no folder or zip has the number in its name
    time_offset: float  #: Unix time [s] of the log's time 0
    truth_kind: TruthKind  #: the file of true poses; never interpolate sparse ones
    landmarks_corrected: bool  #: True where the exchanged landmarks of set 1 were corrected
    robot_sightings: int  #: sightings of other robots, left out
    unknown_barcodes: int  #: sightings of a barcode that Barcodes.dat does not list, left out
    repeated_stamps: int  #: commands left out, because a later row of the file has the same stamp
    backward_stamps: int  #: commands with an earlier stamp than the row before, sorted in
    gaps: Array  #: (G, 2) beginning and end [s] of each time without a new command, longer than LONGEST_INTERVAL


def load(
    path: str | PathLike[str],
    robot: int,
    *,
    delay: float = COMMAND_DELAY,
    correct_landmarks: bool = True,
    speed_scale: float = 1.0,
    range_scale: float = RANGE_SCALE,
) -> Log:
    """Read the log of one robot; :func:`read` gives the same log with an account of what was left out.

    Parameters and errors are those of :func:`read`.
    """
    return read(
        path, robot, delay=delay, correct_landmarks=correct_landmarks, speed_scale=speed_scale, range_scale=range_scale
    ).log


def read(
    path: str | PathLike[str],
    robot: int,
    *,
    delay: float = COMMAND_DELAY,
    correct_landmarks: bool = True,
    speed_scale: float = 1.0,
    range_scale: float = RANGE_SCALE,
) -> Mrclam:
    """Read one robot's commands, its sightings of landmarks, and the truth as far as there is one.

    Times are in seconds from the robot's first command or landmark sighting, whichever is earlier, rounded to the
    microsecond, because a double cannot hold a Unix time more exactly. Everything is sorted by time. Of commands with
    one stamp the last in the file is kept. A command acts until the next one, also through gaps; the last one acts
    until the last event of the log. Sightings of robots and of unknown barcodes are left out. True poses are kept
    from the first event to the last.

    Parameters
    ----------
    path : str or path-like
        The set's zip, or the folder with its files; the files may lie up to two folders deep.
    robot : int
        1 to 5.
    delay : float
        How much later than stamped the commands act [s], 0 to 60. The robots move 0.20 to 0.25 s after a command.
    correct_landmarks : bool
        Exchange landmarks 11 and 17 in the truth of set 1. They were published the wrong way round: no sighting of
        them fits. The set is recognised by its content; no other set is changed.
    speed_scale : float
        Factor on the commanded forward speed, > 0 and at most 10. The true speed is 0.87 to 0.95 of the command.
    range_scale : float
        Factor on the measured ranges, > 0 and at most 10; 1 gives them as they are in the file. The cameras measure
        about 1 % short. Without the factor the map is 1 % too small, and no noise model corrects that.

    Returns
    -------
    Mrclam

    Raises
    ------
    InputError
        The set has no such robot, or a `delay`, `speed_scale` or `range_scale` out of range.
    LogFileError
        A file or zip is missing, damaged or truncated, or a row is not as expected. The message names the file, the
        line and what was expected.
    """
    robot = _robot_number(robot)
    delay = finite_number("delay", delay, lower=0, upper=LONGEST_DELAY, unit="seconds")
    speed_scale = finite_number("speed_scale", speed_scale, above=0, upper=10)
    range_scale = finite_number("range_scale", range_scale, above=0, upper=10)
    with opened(path) as folder:
        commands = read_commands(folder, robot)
        subject_of = read_barcodes(folder)
        observed, subjects = read_sightings(folder, robot, subject_of)
        landmarks = read_landmarks(folder)
        kind, truth = read_true_poses(folder, robot)
        set_number = number_of_set(folder, Path(path))

    exchanged = _exchanged(subject_of, landmarks)
    if exchanged and correct_landmarks:
        landmarks[11], landmarks[17] = landmarks[17], landmarks[11]
    sighted = subjects >= FIRST_LANDMARK
    sightings = observed[sighted]
    landmark_ids, rows = np.unique(subjects[sighted], return_inverse=True)

    start = min(commands[:, 0].min(), sightings[:, 0].min(initial=np.inf))
    stamps = _since(start, commands[:, 0])
    backward = np.count_nonzero(np.diff(stamps) < 0)
    order = np.argsort(stamps, kind="stable")
    kept = order[np.diff(stamps[order], append=np.inf) > 0]
    control_times = stamps[kept] + delay
    wide = np.flatnonzero(np.diff(stamps[kept]) > LONGEST_INTERVAL)
    observation_times = _since(start, sightings[:, 0])
    end = max(control_times.max(), observation_times.max(initial=-np.inf))
    true_times = _since(start, truth[:, 0])
    within = (true_times >= 0) & (true_times <= end)
    log = Log(
        control_times=control_times,
        controls=commands[kept, 1:] * (speed_scale, 1.0),
        observation_times=observation_times,
        observation_ids=rows,
        observations=sightings[:, 2:] * (range_scale, 1.0),
        landmark_ids=tuple(landmark_ids.tolist()),
        end_time=end,
        truth=None
        if kind == "none" and not landmarks
        else Truth(
            times=true_times[within],
            poses=np.column_stack([truth[within, 1:3], wrap(truth[within, 3])]),
            landmarks=landmarks,
        ),
    )
    return Mrclam(
        log=log,
        robot=robot,
        set_number=1 if exchanged else set_number,
        time_offset=float(start),
        truth_kind=kind,
        landmarks_corrected=exchanged and correct_landmarks,
        robot_sightings=int(np.count_nonzero((subjects > 0) & ~sighted)),
        unknown_barcodes=int(np.count_nonzero(subjects == 0)),
        repeated_stamps=len(commands) - len(kept),
        backward_stamps=int(backward),
        gaps=np.column_stack([control_times[wide], control_times[wide + 1]]),
    )


def models() -> tuple[Unicycle, RangeBearing]:
    """The motion and the sensor model, with noise that suits every robot of the sets.

    Found on set 1, where all five robots share it: σ_v 0.1 m/s and σ_ω 0.3 rad/s a command of about 15 ms, σ_r 0.28 m
    and σ_β 0.09 rad. The noise of the sensor is about twice the scatter of single sightings (0.11-0.18 m,
    0.01-0.03 rad), because it also covers their bias, which differs from robot to robot and does not average out.
    """
    return Unicycle(0.1, 0.3), RangeBearing(0.28, 0.09)


def robots(path: str | PathLike[str]) -> tuple[int, ...]:
    """Numbers of the robots that have both commands and sightings in the set's zip or folder.

    Raises
    ------
    LogFileError
        There is no such zip or folder, or it holds no set.
    """
    with opened(path) as folder:
        return robots_in(folder)


def check_zip(path: str | PathLike[str]) -> None:
    """Check that a zip is whole and holds a set: every checksum, and the files that every set needs.

    Raises
    ------
    LogFileError
        It is not a zip, it is truncated or damaged, or a file is missing; the message says which.
    """
    with opened(path) as folder:
        if not isinstance(folder, ZipPath):
            raise LogFileError(f"{path} is a folder, expected a zip")
        with readable(path):
            damaged = folder.root.testzip()
        if damaged is not None:
            raise LogFileError(f"{path} is damaged: the checksum of {damaged} does not fit")
        if not (folder / LANDMARKS).is_file():
            raise LogFileError(f"{folder / LANDMARKS} is missing")
        if not robots_in(folder):
            raise LogFileError(f"{path} holds no robot with both an Odometry and a Measurement file")


def recording(
    path: str | PathLike[str],
    robot: int,
    *,
    delay: float = COMMAND_DELAY,
    correct_landmarks: bool = True,
    speed_scale: float = 1.0,
    range_scale: float = RANGE_SCALE,
) -> Recording:
    """Read the log of one robot with the default models and a few sentences about what was left out.

    Parameters and errors are those of :func:`read`.
    """
    data = read(
        path, robot, delay=delay, correct_landmarks=correct_landmarks, speed_scale=speed_scale, range_scale=range_scale
    )
    motion, sensor = models()
    of_set = "MRCLAM" if data.set_number is None else f"MRCLAM set {data.set_number}"
    notes = [f"Left out: {data.robot_sightings} sightings of robots, {data.unknown_barcodes} of unknown barcodes"]
    return Recording(data.log, f"{of_set}, robot {data.robot}", motion, sensor, GATE, notes=tuple(notes))


MRCLAM = DataSet(
    name="mrclam",
    description="UTIAS multi-robot data set (MRCLAM): five robots and fifteen landmarks in a hall, nine sets.",
    citation="Leung, Halpern, Barfoot, Liu, The UTIAS multi-robot cooperative localization and mapping dataset, "
    "International Journal of Robotics Research 30(8), 2011, 969-974",
    path="PATH",
    path_help="Zip or folder of an MRCLAM set, as it was downloaded.",
    reader=recording,
    options=(
        Option("robot", int, "Whose log: 1 to 5.", metavar="K"),
        Option("delay", float, "How much later than stamped the commands act (s), 0 to 60.", COMMAND_DELAY),
        Option("correct_landmarks", bool, "Exchange landmarks 11 and 17 in the truth of set 1.", True),
        Option("speed_scale", float, "Factor on the commanded forward speed.", 1.0),
        Option("range_scale", float, "Factor on the measured ranges.", RANGE_SCALE),
    ),
    source=Source("ftp://asrl3.utias.utoronto.ca/MRCLAM", "MRCLAM{number}.zip", range(1, 10), check_zip),
)


def _robot_number(robot: int) -> int:
    try:
        number = index(robot)
    except TypeError:
        number = 0
    if isinstance(robot, bool) or not 1 <= number < FIRST_LANDMARK:
        raise InputError(f"robot is {robot!r}, expected an integer from 1 to {FIRST_LANDMARK - 1}")
    return number


def _exchanged(subject_of: dict[int, int], landmarks: dict[Hashable, Array]) -> bool:
    """True for set 1 as it was published."""
    return all(
        subject_of.get(barcode) == subject
        and subject in landmarks
        and bool(np.all(np.abs(landmarks[subject] - (x, y)) < _SAME_PLACE))
        for subject, (barcode, x, y) in _EXCHANGED.items()
    )


def _since(start: float, stamps: Array) -> Array:
    """Seconds from the start, rounded to the microsecond; further digits of a Unix time in a double mean nothing."""
    return np.round(stamps - start, 6)
