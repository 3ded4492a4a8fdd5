"""The UTIAS multi-robot data set (MRCLAM): five robots and fifteen landmarks in a hall, nine sets.

Source: Leung, Halpern, Barfoot, Liu, "The UTIAS multi-robot cooperative localization and mapping dataset",
International Journal of Robotics Research 30(8), 2011, 969-974. Its authors ask to be cited.
"""

from __future__ import annotations

import re
import zipfile
import zlib
from collections.abc import Hashable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import StringIO
from operator import index
from os import PathLike
from pathlib import Path
from typing import Literal, NoReturn

import numpy as np
from numpy.typing import NDArray

from slamkit.datasets.dataset import DataSet, Option, Recording, Source
from slamkit.errors import InputError, LogFileError
from slamkit.logs import Log, Truth
from slamkit.models import RangeBearing, Unicycle
from slamkit.se2 import wrap

Array = NDArray[np.float64]
Folder = Path | zipfile.Path

COMMAND_DELAY = 0.22  #: by how much the motion lags the commands [s]: best fit of the true turn rates of set 1
RANGE_SCALE = 1.008  #: true over measured range, least squares over each robot of set 1, mean (1.000 to 1.016)
GATE = 30.0  #: largest NIS to accept; a tight gate locks a filter out of its own map
LONGEST_DELAY = 60.0  #: a longer delay [s] is taken for an error of units
LONGEST_INTERVAL = 0.5  #: a longer time [s] between two commands is reported as a gap; commands come at about 67 Hz
FIRST_LANDMARK = 6  #: subjects below this one are robots

_BARCODES = "Barcodes.dat"
_LANDMARKS = "Landmark_Groundtruth.dat"
_ODOMETRY_COLUMNS = ("time [s]", "forward velocity [m/s]", "angular velocity [rad/s]")
_MEASUREMENT_COLUMNS = ("time [s]", "barcode", "range [m]", "bearing [rad]")
_TRUTH_COLUMNS = ("time [s]", "x [m]", "y [m]", "heading [rad]")
_LANDMARK_COLUMNS = ("subject", "x [m]", "y [m]", "sd of x [m]", "sd of y [m]")
_BARCODE_COLUMNS = ("subject", "barcode")

# How set 1 was published: subject → barcode, x [m], y [m]; the positions of these two landmarks are exchanged. All six
# numbers are compared, so that a copy that was corrected already, in either file, is left as it is.
_EXCHANGED = {11: (18, 3.15071999, 2.38294871), 17: (61, 0.03596156, -2.84396626)}
_SAME_PLACE = 5e-3  # [m]
_LATEST = 1e11  # [s], beyond any clock in seconds
_DAY = 86400.0  # [s]; a run takes less than an hour, so a stamp farther off is a garbled one


@dataclass(frozen=True, eq=False)
class Mrclam:
    """One robot's log, and what the reader met on its way."""

    log: Log  #: controls (v [m/s], ω [rad/s]), observations (range [m], bearing [rad]), ids: subject numbers
    robot: int  #: whose log it is, 1 to 5
    set_number: int | None  #: 1 to 9; None where no name of a folder or zip tells
    time_offset: float  #: Unix time [s] of the log's time 0
    truth_kind: Literal["full", "sparse", "none"]  #: the file of true poses; never interpolate sparse ones
    landmarks_corrected: bool  #: True where set 1's exchanged landmarks were put right
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
    microsecond (a double holds a Unix time no better). Everything is sorted by time; of commands with one stamp the
    last in the file is kept. A command holds until the next one, through gaps too, the last one until the last event
    of the log. Sightings of robots and of unknown barcodes are left out. True poses are kept from the first event to
    the last.

    Parameters
    ----------
    path : str or path-like
        The set's zip, or the folder with its files; the files may lie up to two folders deep.
    robot : int
        1 to 5.
    delay : float
        How much later than stamped the commands act [s], 0 to 60. The robots' motion lags them by 0.20 to 0.25 s.
    correct_landmarks : bool
        Exchange landmarks 11 and 17 in the truth of set 1, where they are published the wrong way round (no sighting
        of them fits as they stand). The set is known by its content; no other set is touched.
    speed_scale : float
        Factor on the commanded forward speed, > 0 and at most 10. The true speed is 0.87 to 0.95 of the command.
    range_scale : float
        Factor on the measured ranges, > 0 and at most 10; 1 gives them as they are in the file. The cameras measure
        about 1 % short, and no noise model can make up for a map that is 1 % too small.

    Returns
    -------
    Mrclam

    Raises
    ------
    InputError
        A robot that the set has not got, or a `delay`, `speed_scale` or `range_scale` out of range.
    LogFileError
        A missing, damaged or truncated file or zip, or a row that does not fit: file, line and what was expected.
    """
    robot = _robot_number(robot)
    delay, speed_scale = _real("delay", delay), _real("speed_scale", speed_scale)
    range_scale = _real("range_scale", range_scale)
    if not 0 <= delay <= LONGEST_DELAY:
        raise InputError(f"delay is {delay}, expected 0 to {LONGEST_DELAY:g} seconds")
    for name, factor in (("speed_scale", speed_scale), ("range_scale", range_scale)):
        if not 0 < factor <= 10:
            raise InputError(f"{name} is {factor}, expected a factor > 0 and at most 10")
    with _opened(path) as folder:
        odometry = _robot_file(folder, robot, "Odometry", _ODOMETRY_COLUMNS)
        measurements = _robot_file(folder, robot, "Measurement", _MEASUREMENT_COLUMNS)
        subject_of = _barcodes(folder)
        landmarks = _landmarks(folder)
        kind, truth = _true_poses(folder, robot)
        set_number = _set_number(folder, Path(path))

    exchanged = _exchanged(subject_of, landmarks)
    if exchanged and correct_landmarks:
        landmarks[11], landmarks[17] = landmarks[17], landmarks[11]
    commands = odometry.values
    if len(commands) == 0:
        raise LogFileError(f"{odometry.name} holds no row, expected {', '.join(_ODOMETRY_COLUMNS)}")
    subjects = _subjects(measurements, subject_of)
    sighted = subjects >= FIRST_LANDMARK
    sightings = measurements.values[sighted]
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
    """Motion and sensor model with the noise that suits every robot of the sets.

    Found on set 1, where all five robots share it: σ_v 0.1 m/s and σ_ω 0.3 rad/s a command of about 15 ms, σ_r 0.28 m
    and σ_β 0.09 rad. The sensor's noise is about twice the scatter of single sightings (0.11-0.18 m, 0.01-0.03 rad):
    it has to stand for their bias too, which differs from robot to robot and does not average out.
    """
    return Unicycle(0.1, 0.3), RangeBearing(0.28, 0.09)


def robots(path: str | PathLike[str]) -> tuple[int, ...]:
    """Numbers of the robots that have both commands and sightings in the set's zip or folder.

    Raises
    ------
    LogFileError
        No such zip or folder, or one that holds no set.
    """
    with _opened(path) as folder:
        return _robots(folder)


def check_zip(path: str | PathLike[str]) -> None:
    """Make sure that a zip is whole and holds a set: every checksum, and the files without which nothing can be read.

    Raises
    ------
    LogFileError
        It is not a zip, or is cut short or damaged, or a file is missing; the message says which.
    """
    with _opened(path) as folder:
        if not isinstance(folder, zipfile.Path):
            raise LogFileError(f"{path} is a folder, expected a zip")
        with _readable(path):
            damaged = folder.root.testzip()
        if damaged is not None:
            raise LogFileError(f"{path} is damaged: the checksum of {damaged} does not fit")
        if not (folder / _LANDMARKS).is_file():
            raise LogFileError(f"{folder / _LANDMARKS} is missing")
        if not _robots(folder):
            raise LogFileError(f"{path} holds no robot with both an Odometry and a Measurement file")


@dataclass(frozen=True, eq=False)
class _Table:
    """The numbers of one file, and its text to find a row's line again."""

    name: str
    text: str
    values: Array  # (rows, columns)

    def refuse(self, row: int, expected: str) -> NoReturn:
        """Raise the error that names the line of a row."""
        lines = [(n, line) for n, line in _lines(self.text) if _fields(line)]
        number, line = lines[row]
        raise LogFileError(f"{self.name}, line {number}: {line.strip()!r}, expected {expected}")


def _real(name: str, value: float) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        raise InputError(f"{name} is {value!r}, expected a number") from None


def _robot_number(robot: int) -> int:
    try:
        number = index(robot)
    except TypeError:
        raise InputError(f"robot is {robot!r}, expected an integer from 1 to {FIRST_LANDMARK - 1}") from None
    if isinstance(robot, bool) or not 1 <= number < FIRST_LANDMARK:
        raise InputError(f"robot is {robot!r}, expected an integer from 1 to {FIRST_LANDMARK - 1}")
    return number


@contextmanager
def _readable(path: object) -> Iterator[None]:
    """Turn every way in which reading a file or a zip can fail into one error that names it."""
    try:
        yield
    except (zipfile.BadZipFile, zlib.error, EOFError) as error:
        raise LogFileError(f"{path} is not a whole zip: {error}") from None
    except (OSError, RuntimeError) as error:  # the latter is what zipfile says of encrypted and of exotic zips
        raise LogFileError(f"{path} cannot be read: {error}") from None


@contextmanager
def _opened(path: str | PathLike[str]) -> Iterator[Folder]:
    """The folder with the set's files, inside the zip or on the disk."""
    place = Path(path)
    if place.is_dir():
        yield _set_folder(place, place)
    elif place.is_file():
        with _readable(path):
            archive = zipfile.ZipFile(place)
        with archive:
            yield _set_folder(zipfile.Path(archive), place)
    else:
        raise LogFileError(f"{path} does not exist, expected the zip or the folder of an MRCLAM set")


def _set_folder(root: Folder, path: Path) -> Folder:
    """The one folder, at most two levels below the root, that holds Barcodes.dat."""
    level: list[Folder] = [root]
    for depth in range(3):
        if depth > 0:
            with _readable(path):
                level = [below for folder in level for below in folder.iterdir() if below.is_dir()]
        found = [folder for folder in level if (folder / _BARCODES).is_file()]
        if len(found) == 1:
            return found[0]
        if found:
            names = ", ".join(sorted(folder.name for folder in found))
            raise LogFileError(f"{path} holds {len(found)} sets, give one of them: {names}")
    zips = sorted(entry.name for entry in root.iterdir() if entry.name.endswith(".zip"))
    hint = f"; give one of its zips: {', '.join(zips)}" if zips else ""
    raise LogFileError(f"{path} holds no {_BARCODES}, expected the zip or the folder of an MRCLAM set{hint}")


def _robots(folder: Folder) -> tuple[int, ...]:
    kinds = ("Odometry", "Measurement")
    return tuple(
        robot
        for robot in range(1, FIRST_LANDMARK)
        if all((folder / f"Robot{robot}_{kind}.dat").is_file() for kind in kinds)
    )


def _set_number(folder: Folder, path: Path) -> int | None:
    """The number in the name of the innermost folder that has one, else in the name that was given."""
    for name in (folder.name, path.absolute().name):
        if match := re.search(r"MR[A-Z]?LAM\D*([1-9])(?!\d)", name, re.IGNORECASE):
            return int(match[1])
    return None


def _robot_file(folder: Folder, robot: int, kind: str, columns: tuple[str, ...]) -> _Table:
    file = folder / f"Robot{robot}_{kind}.dat"
    if not file.is_file():
        others = ", ".join(map(str, _robots(folder))) or "none"
        raise LogFileError(f"{file} is missing: robot {robot} cannot be read; robots that can: {others}")
    return _stamped(file, columns)


def _stamped(file: Folder, columns: tuple[str, ...]) -> _Table:
    """A table whose first column is a time."""
    table = _table(file, columns)
    times = table.values[:, 0]
    if np.any(wrong := np.abs(times) > _LATEST):
        table.refuse(int(np.argmax(wrong)), "as time seconds on a clock, such as Unix time")
    if len(times) and np.any(wrong := np.abs(times - np.median(times)) > _DAY):
        table.refuse(int(np.argmax(wrong)), f"a time within a day of the file's median {np.median(times):.3f} s")
    return table


def _table(file: Folder, columns: tuple[str, ...]) -> _Table:
    """Read a file of numbers; only when that fails look for the row that is to blame."""
    with _readable(file):
        text = file.read_bytes().decode("utf-8-sig", errors="replace")
    if not any(_fields(line) for _, line in _lines(text)):
        return _Table(str(file), text, np.empty((0, len(columns))))
    try:
        values = np.loadtxt(StringIO(text, newline=None), ndmin=2)
    except ValueError as error:
        reason = str(error)
    else:
        if values.shape[1] == len(columns) and np.isfinite(values).all():
            return _Table(str(file), text, values)
        reason = f"{values.shape[1]} columns"
    expected = f"{len(columns)} numbers: {', '.join(columns)}"
    for number, line in _lines(text):
        fields = _fields(line)
        if fields and not (len(fields) == len(columns) and all(map(_is_number, fields))):
            raise LogFileError(f"{file}, line {number}: {line.strip()!r}, expected {expected}")
    raise LogFileError(f"{file} cannot be read: {reason}; expected in every row {expected}")


def _lines(text: str) -> Iterator[tuple[int, str]]:
    return enumerate(StringIO(text, newline=None), 1)


def _fields(line: str) -> list[str]:
    return line.partition("#")[0].split()


def _is_number(field: str) -> bool:
    try:
        return bool(np.isfinite(float(field)))
    except ValueError:
        return False


def _barcodes(folder: Folder) -> dict[int, int]:
    """Barcode → subject."""
    table = _table(folder / _BARCODES, _BARCODE_COLUMNS)
    subject_of: dict[int, int] = {}
    for row, (subject, barcode) in enumerate(table.values):
        if subject != int(subject) or barcode != int(barcode) or subject < 1:
            table.refuse(row, "two integers: subject from 1, barcode")
        if int(barcode) in subject_of or int(subject) in subject_of.values():
            table.refuse(row, "each subject and each barcode once")
        subject_of[int(barcode)] = int(subject)
    if not subject_of:
        raise LogFileError(f"{table.name} holds no row, expected {', '.join(_BARCODE_COLUMNS)}")
    return subject_of


def _landmarks(folder: Folder) -> dict[Hashable, Array]:
    """Subject → true position (2,) [m]; empty where the file is missing."""
    if not (folder / _LANDMARKS).is_file():
        return {}
    table = _table(folder / _LANDMARKS, _LANDMARK_COLUMNS)
    landmarks: dict[Hashable, Array] = {}
    for row, (subject, x, y, *_) in enumerate(table.values):
        if subject != int(subject) or subject < FIRST_LANDMARK:
            table.refuse(row, f"as subject an integer from {FIRST_LANDMARK}")
        if int(subject) in landmarks:
            table.refuse(row, "each subject once")
        landmarks[int(subject)] = np.array([x, y])
    return landmarks


def _exchanged(subject_of: dict[int, int], landmarks: dict[Hashable, Array]) -> bool:
    """Whether this is set 1 as it was published."""
    return all(
        subject_of.get(barcode) == subject
        and subject in landmarks
        and bool(np.all(np.abs(landmarks[subject] - (x, y)) < _SAME_PLACE))
        for subject, (barcode, x, y) in _EXCHANGED.items()
    )


def _true_poses(folder: Folder, robot: int) -> tuple[Literal["full", "sparse", "none"], Array]:
    """True poses (n, 4): time, x, y, heading."""
    full, sparse = folder / f"Robot{robot}_Groundtruth.dat", folder / f"Robot{robot}_Groundtruth_sparse.dat"
    if full.is_file():
        return "full", _stamped(full, _TRUTH_COLUMNS).values
    if sparse.is_file():
        return "sparse", _stamped(sparse, _TRUTH_COLUMNS).values
    return "none", np.empty((0, 4))


def _subjects(measurements: _Table, subject_of: dict[int, int]) -> NDArray[np.int64]:
    """Subject of every sighting; 0 for a barcode that no subject has."""
    barcodes, ranges = measurements.values[:, 1], measurements.values[:, 2]
    for bad, expected in (
        (barcodes != np.round(barcodes), "an integer as barcode"),
        (ranges <= 0, "a range > 0"),
    ):
        if bad.any():
            measurements.refuse(int(np.argmax(bad)), expected)
    known, which = np.unique(barcodes, return_inverse=True)
    subjects = np.array([subject_of.get(int(barcode), 0) for barcode in known], dtype=np.int64)
    return subjects[which]


def _since(start: float, stamps: Array) -> Array:
    """Seconds from the start, to the microsecond: the last digits of a Unix time in a double are rounding."""
    return np.round(stamps - start, 6)


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
