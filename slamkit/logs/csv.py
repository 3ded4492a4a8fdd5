"""A log as a folder of CSV files that a person can read and change: the columns, the ids, reading and writing."""

from __future__ import annotations

import re
from collections.abc import Callable, Hashable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from slamkit.arrays import Array
from slamkit.errors import InputError, LogFileError
from slamkit.logs.atomic import PathLike, finish_interrupted, read_files, write_files
from slamkit.logs.text_tables import Table, csv_text, read_table, split_row, text_columns
from slamkit.logs.truth import Truth

if TYPE_CHECKING:
    from slamkit.logs.log import Log

CONTROLS, OBSERVATIONS, TRUTH, LANDMARKS = "controls.csv", "observations.csv", "truth.csv", "landmarks.csv"
TRUTH_COLUMNS = ("t", "x", "y", "theta")
LANDMARK_COLUMNS = ("id", "x", "y")

# A naming is a function from the number of columns to the names that they may have.
_Naming = Callable[[int], list[tuple[str, ...]]]


def _naming(letter: str, *known: tuple[str, ...]) -> _Naming:
    """The known names of that many columns, the default first; then the letter with numbers."""
    return lambda n: [*(names for names in known if len(names) == n), tuple(f"{letter}{i + 1}" for i in range(n))]


_RATES = _naming("u", ("v", "omega"))
_INCREMENTS = _naming("d", ("rot1", "trans", "rot2"))
_MEASUREMENTS = _naming("z", ("range", "bearing"), ("x", "y"))


def csv_columns(folder: PathLike) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of the control and of the measurement columns of a log's CSV folder: they tell which models made it.

    Returns
    -------
    controls : tuple of str
        E.g. ``("v", "omega")`` or ``("rot1", "trans", "rot2")``.
    measurements : tuple of str
        E.g. ``("range", "bearing")`` or ``("x", "y")``.

    Raises
    ------
    LogFileError
        A file is missing or broken, as for :meth:`slamkit.logs.Log.read_csv`.
    """
    files = _Files(Path(folder), (CONTROLS, OBSERVATIONS))
    return files.controls().columns[1:], files.observations().columns[2:]


def read_log(folder: PathLike) -> dict[str, Any]:
    """The arguments of the :class:`slamkit.logs.Log` that a folder of CSV files holds; see ``Log.read_csv``."""
    files = _Files(Path(folder), (CONTROLS, OBSERVATIONS, TRUTH, LANDMARKS))
    controls, sightings = files.controls(), files.observations()
    names = [_id_of(text) for text in sightings.texts]
    ids = sorted(set(names), key=_integers_first)
    row_of = {i: row for row, i in enumerate(ids)}
    return {
        "control_times": controls.numbers[:, 0],
        "controls": controls.numbers[:, 1:],
        "observation_times": sightings.numbers[:, 0],
        "observation_ids": np.array([row_of[i] for i in names], dtype=np.int64),
        "observations": sightings.numbers[:, 1:],
        "landmark_ids": tuple(ids),
        "increments": _are_increments(controls.columns[1:]),
        "truth": files.truth(),
    }


def write_log(
    log: Log, folder: PathLike, controls: Sequence[str] | None = None, observations: Sequence[str] | None = None
) -> None:
    """Write the folder that :func:`read_log` reads; see ``Log.write_csv``."""
    folder = Path(folder)
    m, k = log.controls.shape[1], log.observations.shape[1]
    names = _chosen("control", controls, _INCREMENTS if log.increments else _RATES, m)
    measured = _chosen("observation", observations, _MEASUREMENTS, k)
    ct, u = log.control_times, log.controls
    last = np.concatenate([ct, log.observation_times]).max()
    if log.end_time is not None and len(ct) and log.end_time != last:
        if log.end_time < last:
            raise InputError(
                f"the controls end at {log.end_time} s, before the last observation at {last} s; the CSV form "
                "cannot express that: use save"
            )
        ct, u = np.append(ct, log.end_time), np.vstack([u, np.zeros(m)])
    ids = {row: csv_id(log.landmark_ids[row]) for row in dict.fromkeys(log.observation_ids.tolist())}
    sighted = [ids[row] for row in log.observation_ids.tolist()]
    sightings = [*text_columns(log.observation_times), sighted, *text_columns(log.observations)]
    contents = {
        CONTROLS: csv_text(("t", *names), text_columns(ct, u)),
        OBSERVATIONS: csv_text(("t", "id", *measured), sightings),
    }
    if log.truth is not None:
        contents[TRUTH] = csv_text(TRUTH_COLUMNS, text_columns(log.truth.times, log.truth.poses))
        if log.truth.landmarks:
            positions = text_columns(np.array(list(log.truth.landmarks.values())))
            contents[LANDMARKS] = csv_text(LANDMARK_COLUMNS, [[csv_id(i) for i in log.truth.landmarks], *positions])
    finish_interrupted(folder)
    for name in (TRUTH, LANDMARKS):
        if name not in contents and (folder / name).exists():
            raise InputError(f"{folder / name} belongs to another log and would become a part of this one; remove it")
    write_files(folder, contents)


def csv_id(landmark_id: Hashable) -> str:
    """The field of a CSV file from which an id comes back as it is.

    Raises
    ------
    InputError
        There is no such field.
    """
    i: Any = landmark_id.item() if isinstance(landmark_id, np.generic) else landmark_id
    if type(i) in (int, str):
        text = str(i)
        field = '"' + text.replace('"', '""') + '"' if "," in text or '"' in text else text
        row = f"0,{field}"
        if text.isprintable() and "#" not in text and split_row(row) == ["0", text] and text and _id_of(text) == i:
            return field
    raise InputError(
        f"landmark id {landmark_id!r} would not come back from a CSV file; expected an int, or a printable "
        "str that is not an integer's digits and has no # and no outer space; use save"
    )


class _Files:
    """The files of a log's folder, all read at once, so that they belong to one log."""

    def __init__(self, folder: Path, names: Iterable[str]) -> None:
        self.folder = folder
        try:
            self.contents = read_files(folder, names)
        except OSError as error:
            raise LogFileError(f"{error.filename} cannot be read: {error.strerror}") from None

    def controls(self) -> Table:
        def known(names: tuple[str, ...]) -> bool:
            n = len(names) - 1
            return names[:1] == ("t",) and names[1:] in [*_RATES(n), *_INCREMENTS(n)]

        table = self._table(CONTROLS, known, "t,v,omega or t,rot1,trans,rot2 or t,u1,u2,… or t,d1,d2,…")
        if _are_increments(table.columns[1:]):
            row_of: dict[float, int] = {}
            for row, t in enumerate(table.numbers[:, 0].tolist()):
                if t in row_of:
                    line = table.line(row_of[t])
                    raise table.error(row, f"an increment begins at {t} s as on line {line}, expected one at a time")
                row_of[t] = row
        return table

    def observations(self) -> Table:
        def known(names: tuple[str, ...]) -> bool:
            return names[:2] == ("t", "id") and names[2:] in _MEASUREMENTS(len(names) - 2)

        return self._table(OBSERVATIONS, known, "t,id,range,bearing or t,id,x,y or t,id,z1,z2,…")

    def truth(self) -> Truth | None:
        poses = self._optional(TRUTH, TRUTH_COLUMNS)
        landmarks = self._optional(LANDMARKS, LANDMARK_COLUMNS)
        if poses is None and landmarks is None:
            return None
        positions: dict[Hashable, Array] = {}
        row_of: dict[Hashable, int] = {}
        if landmarks is not None:
            for row, (text, position) in enumerate(zip(landmarks.texts, landmarks.numbers, strict=True)):
                i = _id_of(text)
                if i in row_of:
                    line = landmarks.line(row_of[i])
                    raise landmarks.error(row, f"landmark {i!r} was given on line {line}, expected once")
                row_of[i], positions[i] = row, position
        numbers = np.empty((0, 4)) if poses is None else poses.numbers
        return Truth(numbers[:, 0], numbers[:, 1:], positions)

    def _optional(self, name: str, columns: tuple[str, ...]) -> Table | None:
        return self._table(name, lambda given: given == columns, ",".join(columns)) if name in self.contents else None

    def _table(self, name: str, known: Callable[[tuple[str, ...]], bool], expected: str) -> Table:
        path = self.folder / name
        if name not in self.contents:
            raise LogFileError(f"{path} cannot be read: No such file or directory; a log's folder holds this file")
        return read_table(path, self.contents[name], header=(known, expected), text_column="id")


def _are_increments(names: tuple[str, ...]) -> bool:
    return names not in _RATES(len(names))


def _chosen(what: str, names: Sequence[str] | None, naming: _Naming, n: int) -> tuple[str, ...]:
    known = naming(n)
    chosen = known[0] if names is None else tuple(names)
    if chosen not in known:
        raise InputError(
            f"{what} columns {','.join(chosen)} for {n} numbers a row, expected {' or '.join(map(','.join, known))}"
        )
    return chosen


def _id_of(text: str) -> int | str:
    """An int where the text is the digits of one; Python may refuse to convert more than 640."""
    return int(text) if re.fullmatch("[+-]?[0-9]{1,640}", text) else text


def _integers_first(landmark_id: int | str) -> tuple[bool, int, str]:
    return (False, landmark_id, "") if isinstance(landmark_id, int) else (True, 0, landmark_id)
