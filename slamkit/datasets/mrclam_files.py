"""The files of an MRCLAM set: where they lie in a zip or a folder, and their tables."""

from __future__ import annotations

import re
import zipfile
import zlib
from collections.abc import Hashable, Iterator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import Literal

import numpy as np

from slamkit.arrays import Array, Indices
from slamkit.errors import LogFileError
from slamkit.logs import Table, read_table

Folder = Path | zipfile.Path
TruthKind = Literal["full", "sparse", "none"]

FIRST_LANDMARK = 6  #: subjects below this one are robots

BARCODES = "Barcodes.dat"
LANDMARKS = "Landmark_Groundtruth.dat"
_ODOMETRY_COLUMNS = ("time [s]", "forward velocity [m/s]", "angular velocity [rad/s]")
_MEASUREMENT_COLUMNS = ("time [s]", "barcode", "range [m]", "bearing [rad]")
_TRUTH_COLUMNS = ("time [s]", "x [m]", "y [m]", "heading [rad]")
_LANDMARK_COLUMNS = ("subject", "x [m]", "y [m]", "sd of x [m]", "sd of y [m]")
_BARCODE_COLUMNS = ("subject", "barcode")

_LATEST = 1e11  # [s], beyond any clock in seconds
_DAY = 86400.0  # [s]; a run takes less than an hour, so a stamp farther off is a garbled one


# -- where the files lie ----------------------------------------------------------------------------------------------


@contextmanager
def readable(path: object) -> Iterator[None]:
    """Turn every way in which reading a file or a zip can fail into one error that names it."""
    try:
        yield
    except (zipfile.BadZipFile, zlib.error, EOFError) as error:
        raise LogFileError(f"{path} is not a whole zip: {error}") from None
    except (OSError, RuntimeError) as error:  # zipfile raises the latter for encrypted and for exotic zips
        raise LogFileError(f"{path} cannot be read: {error}") from None


@contextmanager
def opened(path: str | PathLike[str]) -> Iterator[Folder]:
    """The folder with the set's files, inside the zip or on the disk."""
    place = Path(path)
    if place.is_dir():
        yield _set_folder(place, place)
    elif place.is_file():
        with readable(path):
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
            with readable(path):
                level = [below for folder in level for below in folder.iterdir() if below.is_dir()]
        found = [folder for folder in level if (folder / BARCODES).is_file()]
        if len(found) == 1:
            return found[0]
        if found:
            names = ", ".join(sorted(folder.name for folder in found))
            raise LogFileError(f"{path} holds {len(found)} sets, give one of them: {names}")
    zips = sorted(entry.name for entry in root.iterdir() if entry.name.endswith(".zip"))
    hint = f"; give one of its zips: {', '.join(zips)}" if zips else ""
    raise LogFileError(f"{path} holds no {BARCODES}, expected the zip or the folder of an MRCLAM set{hint}")


def robots_in(folder: Folder) -> tuple[int, ...]:
    """Numbers of the robots that have both commands and sightings."""
    kinds = ("Odometry", "Measurement")
    return tuple(
        robot
        for robot in range(1, FIRST_LANDMARK)
        if all((folder / f"Robot{robot}_{kind}.dat").is_file() for kind in kinds)
    )


def number_of_set(folder: Folder, path: Path) -> int | None:
    """The number in the name of the innermost folder that has one, else in the name that was given."""
    for name in (folder.name, path.absolute().name):
        if match := re.search(r"MR[A-Z]?LAM\D*([1-9])(?!\d)", name, re.IGNORECASE):
            return int(match[1])
    return None


# -- what is in them --------------------------------------------------------------------------------------------------


def read_commands(folder: Folder, robot: int) -> Array:
    """Commands of a robot (n, 3), at least one: time, forward and angular velocity."""
    table = _robot_file(folder, robot, "Odometry", _ODOMETRY_COLUMNS)
    if len(table.numbers) == 0:
        raise LogFileError(f"{table.name} holds no row, expected {', '.join(_ODOMETRY_COLUMNS)}")
    return table.numbers


def read_sightings(folder: Folder, robot: int, subject_of: dict[int, int]) -> tuple[Array, Indices]:
    """Sightings of a robot (n, 4): time, barcode, range, bearing; and the subject of each, 0 where there is none."""
    table = _robot_file(folder, robot, "Measurement", _MEASUREMENT_COLUMNS)
    barcodes, ranges = table.numbers[:, 1], table.numbers[:, 2]
    _require(table, barcodes == np.round(barcodes), "an integer as barcode")
    _require(table, ranges > 0, "a range > 0")
    known, which = np.unique(barcodes, return_inverse=True)
    subjects = np.array([subject_of.get(int(barcode), 0) for barcode in known], dtype=np.int64)
    return table.numbers, subjects[which]


def read_barcodes(folder: Folder) -> dict[int, int]:
    """Barcode → subject."""
    table = _table(folder / BARCODES, _BARCODE_COLUMNS)
    subject_of: dict[int, int] = {}
    for row, (subject, barcode) in enumerate(table.numbers):
        if subject != int(subject) or barcode != int(barcode) or subject < 1:
            raise _refused(table, row, "two integers: subject from 1, barcode")
        if int(barcode) in subject_of or int(subject) in subject_of.values():
            raise _refused(table, row, "each subject and each barcode once")
        subject_of[int(barcode)] = int(subject)
    if not subject_of:
        raise LogFileError(f"{table.name} holds no row, expected {', '.join(_BARCODE_COLUMNS)}")
    return subject_of


def read_landmarks(folder: Folder) -> dict[Hashable, Array]:
    """Subject → true position (2,) [m]; empty where the file is missing."""
    if not (folder / LANDMARKS).is_file():
        return {}
    table = _table(folder / LANDMARKS, _LANDMARK_COLUMNS)
    landmarks: dict[Hashable, Array] = {}
    for row, (subject, x, y, *_) in enumerate(table.numbers):
        if subject != int(subject) or subject < FIRST_LANDMARK:
            raise _refused(table, row, f"as subject an integer from {FIRST_LANDMARK}")
        if int(subject) in landmarks:
            raise _refused(table, row, "each subject once")
        landmarks[int(subject)] = np.array([x, y])
    return landmarks


def read_true_poses(folder: Folder, robot: int) -> tuple[TruthKind, Array]:
    """The kind of the file, and true poses (n, 4): time, x, y, heading."""
    full, sparse = folder / f"Robot{robot}_Groundtruth.dat", folder / f"Robot{robot}_Groundtruth_sparse.dat"
    if full.is_file():
        return "full", _stamped(full, _TRUTH_COLUMNS).numbers
    if sparse.is_file():
        return "sparse", _stamped(sparse, _TRUTH_COLUMNS).numbers
    return "none", np.empty((0, 4))


def _robot_file(folder: Folder, robot: int, kind: str, columns: tuple[str, ...]) -> Table:
    file = folder / f"Robot{robot}_{kind}.dat"
    if not file.is_file():
        others = ", ".join(map(str, robots_in(folder))) or "none"
        raise LogFileError(f"{file} is missing: robot {robot} cannot be read; robots that can: {others}")
    return _stamped(file, columns)


def _stamped(file: Folder, columns: tuple[str, ...]) -> Table:
    """A table whose first column is a time."""
    table = _table(file, columns)
    times = table.numbers[:, 0]
    _require(table, np.abs(times) <= _LATEST, "as time seconds on a clock, such as Unix time")
    if len(times):
        median = float(np.median(times))
        _require(table, np.abs(times - median) <= _DAY, f"a time within a day of the file's median {median:.3f} s")
    return table


def _table(file: Folder, columns: tuple[str, ...]) -> Table:
    with readable(file):
        content = file.read_bytes()
    return read_table(str(file), content, columns, delimiter=None)


def _require(table: Table, good: np.ndarray[tuple[int], np.dtype[np.bool_]], expected: str) -> None:
    """Refuse the first row that is not good."""
    if not good.all():
        raise _refused(table, int(np.argmin(good)), expected)


def _refused(table: Table, row: int, expected: str) -> LogFileError:
    numbers = " ".join(f"{number:.15g}" for number in table.numbers[row])
    return table.error(row, f"{numbers!r}, expected {expected}")
