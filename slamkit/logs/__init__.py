"""Logs (what a robot did and saw) and histories (what a filter said of it).

Times are in seconds on any one clock. Everything is kept in flat arrays, sorted by time when the object is made:
the order of rows in a file never decides the order of events.
"""

from __future__ import annotations

import csv
import json
import os
import re
import zipfile
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slamkit.errors import InputError, LogFileError

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
PathLike = str | os.PathLike[str]


@dataclass(frozen=True, eq=False)
class Scan:
    """The landmarks sighted at one instant.

    Parameters
    ----------
    ids : sequence of hashable
        One id a sighting; no id twice.
    z : array_like (n, k)
        One measurement a row.
    """

    ids: Sequence[Hashable]
    z: ArrayLike

    def __len__(self) -> int:
        return len(self.ids)


@dataclass(frozen=True, eq=False)
class Truth:
    """What really happened, as far as it is known.

    Parameters
    ----------
    times : array_like (n,)
        Times [s] at which the pose is known; may be sparse, may be empty.
    poses : array_like (n, 3)
        True poses [m, m, rad].
    landmarks : mapping id → (2,), optional
        True positions [m].
    """

    times: Array
    poses: Array
    landmarks: Mapping[Hashable, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        times = _finite("truth times", self.times, 1)
        poses = _finite("truth poses", np.reshape(self.poses, (-1, 3)) if np.size(self.poses) == 0 else self.poses, 2)
        if poses.shape != (len(times), 3):
            raise InputError(f"truth poses have shape {poses.shape}, {len(times)} times need ({len(times)}, 3)")
        order = np.lexsort((*poses.T[::-1], times))
        object.__setattr__(self, "times", times[order])
        object.__setattr__(self, "poses", poses[order])
        landmarks = {i: _finite(f"truth of landmark {i!r}", p, 1) for i, p in self.landmarks.items()}
        for i, p in landmarks.items():
            if p.shape != (2,):
                raise InputError(f"truth of landmark {i!r} has shape {p.shape}, expected (2,)")
        object.__setattr__(self, "landmarks", landmarks)


class Schedule(NamedTuple):
    """A log as a sequence of steps: predict over `dt` with one control, then take the observations of that instant."""

    times: Array  #: (K,) time at the end of each step [s]
    dt: Array  #: (K,) duration of the prediction [s]; 0 where there is nothing to predict
    control: IntArray  #: (K,) row of ``Log.controls`` that acts in the step; -1 where dt is 0
    first: IntArray  #: (K + 1,) observations first[k] … first[k+1]-1 belong to step k


class LogStep(NamedTuple):
    """One step of a log as :meth:`Log.__iter__` yields it."""

    time: float
    u: Array | None
    dt: float
    scan: Scan


@dataclass(frozen=True, eq=False)
class Log:
    """Controls and observations of one run, with the truth where there is one.

    Parameters
    ----------
    control_times : array_like (T,)
        Time [s] from which each control acts; it acts until the next one's time, the last one until `end_time`.
    controls : array_like (T, m)
        Controls, in the motion model's units.
    observation_times : array_like (M,)
        Time [s] of each sighting.
    observation_ids : array_like (M,) of int
        Row of `landmark_ids` for each sighting.
    observations : array_like (M, k)
        Measurements, in the sensor model's units.
    landmark_ids : sequence of hashable (L,)
        The ids that occur, each once.
    end_time : float, optional
        When the last control stops acting [s]; by default the last time that occurs in controls or observations.
    increments : bool
        False: controls are rates (velocities), and a control that an observation interrupts is split in two
        predictions. True: each control is the whole motion up to the next control's time (odometry increments)
        and is never split; observations within the interval are taken at its end.
    truth : Truth, optional

    Raises
    ------
    InputError
        Wrong shapes, a value that is not finite, an unknown landmark row, neither a control nor an observation, an
        end before the last control, or an increment that has no interval in which to act.

    Notes
    -----
    Rows with one time are ordered by what they hold, so that permuting the rows of a log changes nothing: of several
    rates with one time the lexicographically largest acts; observations of one instant follow `observation_ids`, with
    the second sighting of a landmark after the first sighting of every other.
    """

    control_times: Array
    controls: Array
    observation_times: Array
    observation_ids: IntArray
    observations: Array
    landmark_ids: tuple[Hashable, ...]
    end_time: float | None = None
    increments: bool = False
    truth: Truth | None = None

    def __post_init__(self) -> None:
        ct = _finite("control_times", self.control_times, 1)
        u = _finite("controls", self.controls, 2)
        ot = _finite("observation_times", self.observation_times, 1)
        z = _finite("observations", self.observations, 2)
        index = np.asarray(self.observation_ids)
        ids = tuple(self.landmark_ids)
        if len(ct) == 0 and len(ot) == 0:
            raise InputError("the log is empty: it has neither a control nor an observation")
        if len(u) != len(ct):
            raise InputError(f"controls have {len(u)} rows, control_times {len(ct)}")
        if len(z) != len(ot) or index.shape != (len(ot),):
            raise InputError(
                f"observations have {len(z)} rows and observation_ids shape {index.shape}, "
                f"{len(ot)} observation_times need ({len(ot)}, k) and ({len(ot)},)"
            )
        if len(index) and not np.issubdtype(index.dtype, np.integer):
            raise InputError(f"observation_ids have dtype {index.dtype}, expected integers: rows of landmark_ids")
        try:
            distinct = len(set(ids))
        except TypeError as error:
            raise InputError(f"landmark_ids must be hashable: {error}") from None
        if distinct != len(ids):
            raise InputError("landmark_ids holds an id twice")
        if len(index) and (index.min() < 0 or index.max() >= len(ids)):
            raise InputError(
                f"observation_ids run from {index.min()} to {index.max()}, there are {len(ids)} landmark_ids"
            )
        end = np.concatenate([ct, ot]).max() if self.end_time is None else _finite("end_time", self.end_time, 0)
        if np.any(ct > end):
            raise InputError(f"end_time is {end}, expected a time not before the last control's {ct.max()}")
        by_control = np.lexsort((*u.T[::-1], ct))
        by_observation = np.lexsort((*z.T[::-1], index, ot))
        # In one instant: first the first sighting of each landmark, then the second of each that has one, …
        nth = _nth_in_run(ot[by_observation], index[by_observation])
        by_observation = by_observation[np.lexsort((index[by_observation], nth, ot[by_observation]))]
        for name, value in (
            ("control_times", ct[by_control]),
            ("controls", np.ascontiguousarray(u[by_control])),
            ("observation_times", ot[by_observation]),
            ("observation_ids", index.astype(np.int64)[by_observation]),
            ("observations", np.ascontiguousarray(z[by_observation])),
            ("landmark_ids", ids),
            ("end_time", float(end)),
            ("increments", bool(self.increments)),
        ):
            object.__setattr__(self, name, value)
        if self.increments and len(ct):
            self._check_increments()

    def _check_increments(self) -> None:
        """Refuse an increment of no duration: no step could take it, and its motion would be lost."""
        tied = np.flatnonzero(np.diff(self.control_times) == 0)
        if len(tied):
            raise InputError(f"two increments begin at {self.control_times[tied[0]]} s, expected one at a time")
        if self.control_times[-1] == self.end_time and np.any(self.controls[-1]):
            raise InputError(
                f"the last increment {self.controls[-1].tolist()} begins at {self.end_time} s, when the log ends; "
                "expected an end_time or an observation later than that, or a last increment of zero"
            )

    @cached_property
    def schedule(self) -> Schedule:
        """The log's events merged by time, as steps of one prediction and the sightings at its end."""
        assert self.end_time is not None  # __post_init__ sees to it
        ct, ot, end = self.control_times, self.observation_times, self.end_time
        breaks = np.append(ct, end) if len(ct) else ct
        if self.increments:
            # An increment is indivisible: its sightings wait for its end.
            at = np.searchsorted(breaks, ot)
            inside = (at > 0) & (at < len(breaks))
            ot = ot.copy()
            ot[inside] = breaks[at[inside]]
        cuts = self._repeats(ot)
        # Of what is nearly in order already a stable sort takes a few passes.
        instants = _distinct(np.sort(np.concatenate([breaks, _distinct(ot)]), kind="stable"))
        times = np.sort(np.concatenate([instants, ot[cuts]]), kind="stable")
        first = np.sort(np.concatenate([np.searchsorted(ot, instants), cuts]), kind="stable")
        dt = np.diff(times, prepend=times[0])
        control = np.searchsorted(ct, times) - 1  # the last that begins before times[k]
        acts = (dt > 0) & (control >= 0) & (times <= end)
        keep = acts | (np.diff(first, append=len(ot)) > 0)
        return Schedule(
            times[keep],
            np.where(acts, dt, 0.0)[keep],
            np.where(acts, control, -1)[keep],
            np.append(first[keep], len(ot)),
        )

    def _repeats(self, instants: Array) -> IntArray:
        """Observations at which a further step of the same instant begins, so that no step repeats a landmark.

        The cut falls where the sightings of one time begin, or the second sightings of one time: where it falls does
        not depend on the order of `landmark_ids`.
        """
        ids, times = self.observation_ids, self.observation_times
        if not np.any((instants[1:] == instants[:-1]) & (ids[1:] <= ids[:-1])):
            return np.empty(0, dtype=np.int64)
        order = np.lexsort((ids, instants))
        same = (np.diff(instants[order]) == 0) & (np.diff(ids[order]) == 0)
        before = np.full(len(ids), -1)  # the sighting before this one of the same landmark in the same instant
        before[order[1:][same]] = order[:-1][same]
        groups = np.flatnonzero(np.append(True, (np.diff(times) > 0) | (np.diff(ids) <= 0)))
        latest = np.maximum.reduceat(before, groups)
        cuts: list[int] = []
        begin = 0
        for group in np.flatnonzero(latest >= 0):
            if latest[group] >= begin:
                begin = int(groups[group])
                cuts.append(begin)
        return np.array(cuts, dtype=np.int64)

    def __iter__(self) -> Iterator[LogStep]:
        """Steps in order: ``time, u, dt, scan``; dt is 0 (and u None) where there is nothing to predict."""
        s = self.schedule
        for k in range(len(s.times)):
            rows = slice(s.first[k], s.first[k + 1])
            ids = tuple(self.landmark_ids[i] for i in self.observation_ids[rows])
            u = self.controls[s.control[k]] if s.dt[k] > 0 else None
            yield LogStep(float(s.times[k]), u, float(s.dt[k]), Scan(ids, self.observations[rows]))

    def __len__(self) -> int:
        """Number of steps."""
        return len(self.schedule.times)

    def save(self, path: PathLike) -> None:
        """Write the log to one file (npz, without pickle); :meth:`load` gives it back exactly.

        Parameters
        ----------
        path : path
            File to write, under exactly this name; a file that is there is replaced once the new one is complete.

        Raises
        ------
        InputError
            A landmark id that a file cannot hold: ids may be int, str, float, bool, None and tuples of these.
        """
        facts: dict[str, Any] = {
            "landmark_ids": [encode_id(i) for i in self.landmark_ids],
            "end_time": self.end_time,
            "increments": self.increments,
            "truth": None,
        }
        arrays: dict[str, Array | IntArray] = {
            "control_times": self.control_times,
            "controls": self.controls,
            "observation_times": self.observation_times,
            "observation_ids": self.observation_ids,
            "observations": self.observations,
        }
        if self.truth is not None:
            facts["truth"] = [encode_id(i) for i in self.truth.landmarks]
            arrays["truth_times"], arrays["truth_poses"] = self.truth.times, self.truth.poses
            arrays["truth_landmarks"] = np.reshape(list(self.truth.landmarks.values()), (-1, 2))
        write_archive(path, "Log", facts, arrays)

    @classmethod
    def load(cls, path: PathLike) -> Log:
        """Read what :meth:`save` wrote.

        Raises
        ------
        LogFileError
            The file is missing, damaged, or holds something else; the message names it.
        """
        with reading(path, "Log"):
            facts, arrays = read_archive(path, "Log")
            ids, truth = facts.pop("landmark_ids"), facts.pop("truth")
            if truth is not None:
                landmarks = zip(map(decode_id, truth), arrays.pop("truth_landmarks"), strict=True)
                truth = Truth(arrays.pop("truth_times"), arrays.pop("truth_poses"), dict(landmarks))
            fields: dict[str, Any] = arrays | facts
            return cls(**fields, landmark_ids=tuple(map(decode_id, ids)), truth=truth)

    def write_csv(
        self,
        folder: PathLike,
        *,
        controls: Sequence[str] | None = None,
        observations: Sequence[str] | None = None,
    ) -> None:
        """Write the log as a folder of CSV files that a person can read and change.

        Parameters
        ----------
        folder : path
            Where controls.csv and observations.csv go and, with a truth, truth.csv and landmarks.csv.
        controls : sequence of str, optional
            Names of the control columns, as :meth:`read_csv` knows them. By default v, omega for two rates,
            rot1, trans, rot2 for three increments, else u1, u2, … for rates and d1, d2, … for increments.
        observations : sequence of str, optional
            Names of the measurement columns: range, bearing (the default for two) or x, y or z1, z2, …

        Raises
        ------
        InputError
            Column names that do not fit the log; an id of a landmark that would not come back as it is (an int does,
            and a printable str without # and outer spaces that is not an integer's digits); observations later than
            `end_time`, which this form cannot express; or a file of another log that would become a part of this one.
            Nothing is written then.

        Notes
        -----
        Numbers come back to the bit. Where the last control acts beyond the last event, a row of zero control at
        `end_time` says so. Landmarks that were never sighted are not kept in `landmark_ids`.
        """
        folder = Path(folder)
        m, k = self.controls.shape[1], self.observations.shape[1]
        names = _chosen("control", controls, _INCREMENTS if self.increments else _RATES, m)
        measured = _chosen("observation", observations, _MEASUREMENTS, k)
        ct, u = self.control_times, self.controls
        last = np.concatenate([ct, self.observation_times]).max()
        if self.end_time is not None and len(ct) and self.end_time != last:
            if self.end_time < last:
                raise InputError(
                    f"the controls end at {self.end_time} s, before the last observation at {last} s: the CSV form "
                    "cannot say so; use save"
                )
            ct, u = np.append(ct, self.end_time), np.vstack([u, np.zeros(m)])
        ids = {row: _csv_id(self.landmark_ids[row]) for row in dict.fromkeys(self.observation_ids.tolist())}
        files = {
            "controls.csv": _csv_text(("t", *names), _csv_columns(ct, u)),
            "observations.csv": _csv_text(
                ("t", "id", *measured),
                [
                    *_csv_columns(self.observation_times),
                    [ids[row] for row in self.observation_ids.tolist()],
                    *_csv_columns(self.observations),
                ],
            ),
        }
        if self.truth is not None:
            files["truth.csv"] = _csv_text(_TRUTH_COLUMNS, _csv_columns(self.truth.times, self.truth.poses))
            if self.truth.landmarks:
                positions = _csv_columns(np.array(list(self.truth.landmarks.values())))
                files["landmarks.csv"] = _csv_text(
                    _LANDMARK_COLUMNS, [[_csv_id(i) for i in self.truth.landmarks], *positions]
                )
        for name in ("truth.csv", "landmarks.csv"):
            if name not in files and (folder / name).exists():
                raise InputError(
                    f"{folder / name} belongs to another log and would become a part of this one; remove it"
                )
        _write_texts(folder, files)

    @classmethod
    def read_csv(cls, folder: PathLike) -> Log:
        """Read a log from a folder of CSV files.

        Parameters
        ----------
        folder : path
            It holds controls.csv: columns ``t,v,omega`` or ``t,u1,u2,…`` (rates), ``t,rot1,trans,rot2`` or
            ``t,d1,d2,…`` (increments); observations.csv: ``t,id,range,bearing`` or ``t,id,x,y`` or
            ``t,id,z1,z2,…``; and, optionally, truth.csv: ``t,x,y,theta``; landmarks.csv: ``id,x,y`` (true positions).

        Returns
        -------
        Log
            Ids are int where they are an integer's digits, else str; `landmark_ids` has the ints, then the strs, in
            ascending order. The last control acts until the last time of controls and observations.

        Raises
        ------
        LogFileError
            A file is missing or not UTF-8 text, a header is missing or unknown, a row has the wrong number of
            fields, a field is not a finite number, a landmark is given twice: file, line, what was given and what was
            expected.

        Notes
        -----
        Rows may stand in any order. Blank lines, comments (from # to the end of a line), spaces around fields, a byte
        order mark and any line ends are allowed.
        """
        folder = Path(folder)
        controls, sightings = _read_controls(folder), _read_observations(folder)
        ids = sorted(set(names := sightings.ids), key=_ints_first)
        row_of = {i: row for row, i in enumerate(ids)}
        try:
            return cls(
                control_times=controls.numbers[:, 0],
                controls=controls.numbers[:, 1:],
                observation_times=sightings.numbers[:, 0],
                observation_ids=np.array([row_of[i] for i in names], dtype=np.int64),
                observations=sightings.numbers[:, 1:],
                landmark_ids=tuple(ids),
                increments=_are_increments(controls.names[1:]),
                truth=_read_truth(folder),
            )
        except LogFileError:
            raise
        except InputError as error:
            raise LogFileError(f"{folder}: {error}") from None


@dataclass(frozen=True, eq=False)
class History:
    """What a filter said while it ran over a log.

    Arrays over the K steps hold the belief after the step's observations; arrays over the M observations stand in
    the log's order.
    """

    filter: str  #: name of the estimator
    times: Array  #: (K,) [s]
    poses: Array  #: (K, 3) [m, m, rad]
    pose_covariances: Array  #: (K, 3, 3)
    observation_times: Array  #: (M,) [s], of the step that took them
    observation_ids: IntArray  #: (M,) rows of `landmark_ids`; -1 where the id is not in the final map
    innovations: Array  #: (M, k) z - ẑ; NaN where the sighting started a landmark
    nis: Array  #: (M,) yᵀS⁻¹y; NaN where the sighting started a landmark
    accepted: NDArray[np.bool_]  #: (M,) False where the gate refused the sighting
    landmark_ids: tuple[Hashable, ...]  #: ids in the order of the final map
    landmarks: Array  #: (L, 2) final map [m]
    landmark_covariances: Array  #: (L, 2, 2) [m²]
    seconds: float = float("nan")  #: wall-clock time of the run [s]

    @property
    def dof(self) -> int:
        """Degrees of freedom of one innovation."""
        return int(self.innovations.shape[1])

    @property
    def rejected(self) -> int:
        """Number of sightings that the gate refused."""
        return int(np.count_nonzero(~self.accepted))

    def save(self, path: PathLike) -> None:
        """Write the history to one file (npz, without pickle); :meth:`load` gives it back exactly.

        Parameters
        ----------
        path : path
            File to write, under exactly this name; a file that is there is replaced once the new one is complete.

        Raises
        ------
        InputError
            A landmark id that a file cannot hold (see :meth:`Log.save`), or arrays that do not fit together.
        """
        facts = {
            "filter": self.filter,
            "landmark_ids": [encode_id(i) for i in self.landmark_ids],
            "seconds": float(self.seconds),
        }
        self._check_shapes()
        write_archive(path, "History", facts, {name: getattr(self, name) for name in _HISTORY_ARRAYS})

    @classmethod
    def load(cls, path: PathLike) -> History:
        """Read what :meth:`save` wrote.

        Raises
        ------
        LogFileError
            The file is missing, damaged, or holds something else; the message names it.
        """
        with reading(path, "History"):
            facts, arrays = read_archive(path, "History")
            ids = tuple(map(decode_id, facts.pop("landmark_ids")))
            fields: dict[str, Any] = arrays | facts
            history = cls(**fields, landmark_ids=ids)
            history._check_shapes()
            return history

    def _check_shapes(self) -> None:
        sizes = {"K": len(self.times), "M": len(self.observation_times), "L": len(self.landmark_ids)}
        for name, (kind, shape) in _HISTORY_ARRAYS.items():
            array = np.asarray(getattr(self, name))
            expected = tuple(sizes.get(str(n), n) for n in shape)
            if array.ndim == len(shape) == 2 and shape[1] == "k":
                expected = (expected[0], array.shape[1])
            if array.dtype != kind or array.shape != expected:
                raise InputError(f"{name} has shape {array.shape} of {array.dtype}, expected {expected} of {kind}")

    def write_tum(self, path: PathLike) -> None:
        """Write the trajectory in the TUM form; see :func:`write_tum`."""
        write_tum(path, self.times, self.poses)

    def write_csv(self, folder: PathLike) -> None:
        """Write trajectory.csv and map.csv.

        Parameters
        ----------
        folder : path
            trajectory.csv has a row a step: ``t,x,y,theta,sxx,sxy,sxtheta,syy,sytheta,sthetatheta`` [s, m, m, rad
            and the covariance's entries in their products]; map.csv a row a landmark: ``id,x,y,sxx,sxy,syy``
            [m, m, m²].

        Raises
        ------
        InputError
            A landmark id that is neither int nor str (see :meth:`Log.write_csv`); nothing is written then.
        """
        P, S = self.pose_covariances, self.landmark_covariances
        names = ("sxx", "sxy", "sxtheta", "syy", "sytheta", "sthetatheta")
        files = {
            "trajectory.csv": _csv_text(
                (*_TRUTH_COLUMNS, *names), _csv_columns(self.times, self.poses, P[:, *np.triu_indices(3)])
            ),
            "map.csv": _csv_text(
                (*_LANDMARK_COLUMNS, "sxx", "sxy", "syy"),
                [[_csv_id(i) for i in self.landmark_ids], *_csv_columns(self.landmarks, S[:, *np.triu_indices(2)])],
            ),
        }
        _write_texts(Path(folder), files)


#: The arrays of a History: dtype and shape; K steps, M observations of k numbers, L landmarks.
_HISTORY_ARRAYS: dict[str, tuple[type, tuple[str | int, ...]]] = {
    "times": (np.float64, ("K",)),
    "poses": (np.float64, ("K", 3)),
    "pose_covariances": (np.float64, ("K", 3, 3)),
    "observation_times": (np.float64, ("M",)),
    "observation_ids": (np.int64, ("M",)),
    "innovations": (np.float64, ("M", "k")),
    "nis": (np.float64, ("M",)),
    "accepted": (np.bool_, ("M",)),
    "landmarks": (np.float64, ("L", 2)),
    "landmark_covariances": (np.float64, ("L", 2, 2)),
}


def write_tum(path: PathLike, times: ArrayLike, poses: ArrayLike) -> None:
    """Write a trajectory in the TUM form, one line a pose: ``t x y z qx qy qz qw`` with z = qx = qy = 0.

    Parameters
    ----------
    path : path
        File to write; a file that is there is replaced once the new one is complete.
    times : array_like (K,)
        Times [s], never decreasing. Of several poses with one time the last is written.
    poses : array_like (K, 3)
        Poses [m, m, rad]; the heading becomes the unit quaternion (0, 0, sin θ/2, cos θ/2).

    Raises
    ------
    InputError
        Wrong shapes, a value that is not finite, or times that step back.

    Notes
    -----
    Source: Sturm, Engelhard, Endres, Burgard, Cremers, "A benchmark for the evaluation of RGB-D SLAM systems", IROS
    2012: the benchmark's trajectory files.
    """
    t, x = _finite("times", times, 1), _finite("poses", poses, 2)
    if x.shape != (len(t), 3):
        raise InputError(f"poses have shape {x.shape}, {len(t)} times need ({len(t)}, 3)")
    back = np.flatnonzero(np.diff(t) < 0)
    if len(back):
        raise InputError(f"times step back from {t[back[0]]} to {t[back[0] + 1]} s at row {back[0] + 1}")
    last = np.diff(t, append=np.inf) > 0
    t, x = t[last], x[last]
    zero = np.zeros(len(t))
    columns = _csv_columns(t, x[:, :2], zero, zero, zero, np.sin(x[:, 2] / 2), np.cos(x[:, 2] / 2))
    with replacing(path) as file:
        file.write("".join(f"{' '.join(row)}\n" for row in zip(*columns, strict=True)).encode())


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
        As :meth:`Log.read_csv`.
    """
    folder = Path(folder)
    return _read_controls(folder).names[1:], _read_observations(folder).names[2:]


def encode_id(landmark_id: Hashable) -> Any:
    """A landmark id as a value of JSON: tuples become lists, NumPy's numbers Python's.

    Raises
    ------
    InputError
        It is not an int, str, float (other than NaN, which equals no id), bool, None or a tuple of these.
    """
    i: Any = landmark_id.item() if isinstance(landmark_id, np.generic) else landmark_id
    if type(i) is tuple:
        return [encode_id(part) for part in i]
    # Subclasses would come back as their base: an IntEnum as an int.
    if i is None or type(i) in (bool, int, str) or (type(i) is float and i == i):
        return i
    raise InputError(
        f"landmark id {landmark_id!r} is a {type(landmark_id).__name__}; a file holds ids that are int, str, float "
        "(not NaN), bool, None or tuples of these"
    )


def decode_id(value: Any) -> Hashable:
    """The landmark id that :func:`encode_id` made a value of JSON; ValueError if there is none."""
    if isinstance(value, list):
        return tuple(decode_id(part) for part in value)
    if isinstance(value, dict):
        raise ValueError(f"no landmark id: {value!r}")
    id_: Hashable = value
    return id_


def write_archive(path: PathLike, kind: str, facts: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays and facts to an npz file that holds no pickle and no date: the same content, the same bytes.

    Parameters
    ----------
    path : path
        File to write, under exactly this name.
    kind : str
        What it is; :func:`read_archive` refuses another kind.
    facts : mapping
        What JSON can hold.
    arrays : mapping name → ndarray
        Arrays without Python objects.
    """
    text = json.dumps({"slamkit": kind, "version": 1, "facts": dict(facts)})
    members = {"slamkit": np.array(text), **arrays}
    with replacing(path) as file, zipfile.ZipFile(file, "w") as archive:
        for name, array in members.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, np.asarray(array), allow_pickle=False)


def read_archive(path: PathLike, kind: str) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Facts and arrays that :func:`write_archive` wrote; call it within :func:`reading`.

    Raises
    ------
    LogFileError
        The file holds another kind, or comes from a later version of slamkit.
    """
    with open(path, "rb") as file:
        if not zipfile.is_zipfile(file):
            raise LogFileError(f"{path} is no npz file, or a truncated one; expected a slamkit {kind}")
        file.seek(0)
        with np.load(file, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    header = json.loads(str(arrays.pop("slamkit")))
    if header["slamkit"] != kind:
        raise LogFileError(f"{path} holds a slamkit {header['slamkit']}, expected a {kind}")
    if header["version"] != 1:
        raise LogFileError(f"{path} has version {header['version']} of slamkit's files, expected version 1")
    return header["facts"], arrays


@contextmanager
def reading(path: PathLike, kind: str) -> Iterator[None]:
    """Whatever goes wrong inside becomes a LogFileError that names the file."""
    try:
        yield
    except LogFileError:
        raise
    # A damaged file can make zipfile, zlib, NumPy, json and a constructor raise nearly anything.
    except Exception as error:
        raise LogFileError(f"{path} cannot be read as a slamkit {kind}: {type(error).__name__}: {error}") from error


@contextmanager
def replacing(path: PathLike) -> Iterator[IO[bytes]]:
    """A file that takes the place of `path` when all of it is written, and leaves no trace if that fails."""
    target = Path(os.path.realpath(path))
    temporary = target.with_name(f".{target.name}.{os.urandom(8).hex()}.tmp")
    try:
        with open(temporary, "xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, target)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


# The CSV form. A naming is a function from the number of columns to the names that they may have.

_TRUTH_COLUMNS = ("t", "x", "y", "theta")
_LANDMARK_COLUMNS = ("id", "x", "y")

_Naming = Callable[[int], list[tuple[str, ...]]]


def _naming(letter: str, *known: tuple[str, ...]) -> _Naming:
    """The known names of so many columns, the default first; then the letter with numbers."""
    return lambda n: [*(names for names in known if len(names) == n), tuple(f"{letter}{i + 1}" for i in range(n))]


_RATES = _naming("u", ("v", "omega"))
_INCREMENTS = _naming("d", ("rot1", "trans", "rot2"))
_MEASUREMENTS = _naming("z", ("range", "bearing"), ("x", "y"))


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


class _Table(NamedTuple):
    """A CSV file whose header was known and whose rows were sound."""

    path: Path
    names: tuple[str, ...]
    ids: list[int | str]  #: one a row where there is a column id, else empty
    numbers: Array  #: (n, columns other than id)
    lines: list[int]  #: line of each row


def _read_controls(folder: Path) -> _Table:
    def known(names: tuple[str, ...]) -> bool:
        n = len(names) - 1
        return names[:1] == ("t",) and names[1:] in [*_RATES(n), *_INCREMENTS(n)]

    table = _read_table(folder / "controls.csv", known, "t,v,omega or t,rot1,trans,rot2 or t,u1,u2,… or t,d1,d2,…")
    if _are_increments(table.names[1:]):
        line_of: dict[float, int] = {}
        for t, line in zip(table.numbers[:, 0].tolist(), table.lines, strict=True):
            if t in line_of:
                raise LogFileError(
                    f"{table.path}:{line}: an increment begins at {t} s as on line {line_of[t]}, expected one at a time"
                )
            line_of[t] = line
    return table


def _read_observations(folder: Path) -> _Table:
    def known(names: tuple[str, ...]) -> bool:
        return names[:2] == ("t", "id") and names[2:] in _MEASUREMENTS(len(names) - 2)

    return _read_table(folder / "observations.csv", known, "t,id,range,bearing or t,id,x,y or t,id,z1,z2,…")


def _read_truth(folder: Path) -> Truth | None:
    poses = _read_optional(folder / "truth.csv", _TRUTH_COLUMNS)
    landmarks = _read_optional(folder / "landmarks.csv", _LANDMARK_COLUMNS)
    if poses is None and landmarks is None:
        return None
    positions: dict[Hashable, Array] = {}
    if landmarks is not None:
        line_of: dict[Hashable, int] = {}
        for i, position, line in zip(landmarks.ids, landmarks.numbers, landmarks.lines, strict=True):
            if i in line_of:
                raise LogFileError(
                    f"{landmarks.path}:{line}: landmark {i!r} was given on line {line_of[i]}, expected once"
                )
            line_of[i], positions[i] = line, position
    numbers = np.empty((0, 4)) if poses is None else poses.numbers
    return Truth(numbers[:, 0], numbers[:, 1:], positions)


def _read_optional(path: Path, names: tuple[str, ...]) -> _Table | None:
    return _read_table(path, lambda given: given == names, ",".join(names)) if path.exists() else None


def _read_table(path: Path, known: Callable[[tuple[str, ...]], bool], expected: str) -> _Table:
    rows = _read_rows(path)
    header = next(rows, None)
    if header is None:
        raise LogFileError(f"{path}: the file is empty, expected the header {expected}")
    at, names = header[0], tuple(header[1])
    if not known(names):
        raise LogFileError(f"{path}:{at}: header is {','.join(names)!r}, expected {expected}")
    column = names.index("id") if "id" in names else None
    ids: list[int | str] = []
    numbers: list[list[float]] = []
    lines: list[int] = []
    for line, fields in rows:
        if len(fields) != len(names):
            raise LogFileError(
                f"{path}:{line}: {len(fields)} fields {','.join(fields)!r}, expected {len(names)}: {','.join(names)}"
            )
        if column is not None:
            text = fields.pop(column)
            if not text:
                raise LogFileError(f"{path}:{line}: the id is empty, expected an integer or a name")
            ids.append(_id_of(text))
        try:
            numbers.append([_number(field) for field in fields])
        except ValueError:
            bad = next(field for field in fields if not _is_number(field))
            raise LogFileError(f"{path}:{line}: {bad!r} is not a number, expected {','.join(names)}") from None
        lines.append(line)
    array = np.reshape(np.array(numbers, dtype=float), (len(lines), len(names) - (column is not None)))
    broken = np.flatnonzero(~np.isfinite(array).all(axis=1))
    if len(broken):
        row = broken[0]
        value = array[row][~np.isfinite(array[row])][0]
        raise LogFileError(f"{path}:{lines[row]}: {value} is not finite, expected {','.join(names)}")
    return _Table(path, names, ids, array, lines)


def _read_rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Line number and fields of every row that holds any."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise LogFileError(f"{path} cannot be read: {error.strerror}; a log's folder holds this file") from None
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        number = content.count(b"\n", 0, error.start) + 1
        raise LogFileError(f"{path}:{number}: byte {content[error.start]:#04x}, expected UTF-8 text") from None
    for number, line in enumerate(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), 1):
        row = line.partition("#")[0].strip()
        if row:
            try:
                yield number, _fields(row)
            except csv.Error as error:
                raise LogFileError(f"{path}:{number}: {row!r}: {error}, expected fields between commas") from None


def _fields(row: str) -> list[str]:
    fields = next(csv.reader([row], skipinitialspace=True, strict=True)) if '"' in row else row.split(",")
    return [field.strip() for field in fields]


def _number(field: str) -> float:
    # Python reads 1_000 as a thousand; no other program writes it so.
    return float("" if "_" in field else field)


def _is_number(field: str) -> bool:
    try:
        _number(field)
    except ValueError:
        return False
    return True


def _id_of(text: str) -> int | str:
    """An int where the text is the digits of one; beyond 640 Python may refuse to convert them."""
    return int(text) if re.fullmatch("[+-]?[0-9]{1,640}", text) else text


def _ints_first(landmark_id: int | str) -> tuple[bool, int, str]:
    return (False, landmark_id, "") if isinstance(landmark_id, int) else (True, 0, landmark_id)


def _csv_id(landmark_id: Hashable) -> str:
    """An id as the field from which it comes back as it is."""
    i: Any = landmark_id.item() if isinstance(landmark_id, np.generic) else landmark_id
    if type(i) in (int, str):
        text = str(i)
        field = '"' + text.replace('"', '""') + '"' if "," in text or '"' in text else text
        row = f"0,{field}"
        if text.isprintable() and "#" not in text and _fields(row) == ["0", text] and text and _id_of(text) == i:
            return field
    raise InputError(
        f"landmark id {landmark_id!r} would not come back from a CSV file; expected an int, or a printable "
        "str that is not an integer's digits and has no # and no outer space; use save"
    )


def _csv_columns(*arrays: Array) -> list[list[str]]:
    """Columns of arrays (n,) or (n, m) as text from which every number comes back to the bit."""
    return [list(map(repr, column)) for a in arrays for column in np.atleast_2d(a.T).tolist()]


def _csv_text(names: Iterable[str], columns: Sequence[Sequence[str]]) -> str:
    return "".join(f"{','.join(row)}\n" for row in [tuple(names), *zip(*columns, strict=True)])


def _write_texts(folder: Path, texts: Mapping[str, str]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        with replacing(folder / name) as file:
            file.write(text.encode())


def _distinct(values: Array) -> Array:
    """Each value of a sorted array once."""
    changes = np.flatnonzero(values[1:] != values[:-1]) + 1
    return np.concatenate([values[:1], values[changes]])


def _nth_in_run(*columns: Array | IntArray) -> IntArray:
    """For each row of sorted columns: how many rows before it are equal to it."""
    rows = np.arange(len(columns[0]))
    begins = np.append(True, np.any([np.diff(column) != 0 for column in columns], axis=0))[: len(rows)]
    return rows - np.maximum.accumulate(np.where(begins, rows, 0))


def _finite(name: str, value: Any, ndim: int) -> Array:
    try:
        a = np.array(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} must be numbers, given {type(value).__name__}: {error}") from None
    if a.ndim != ndim:
        raise InputError(f"{name} has shape {a.shape}, expected {ndim} dimension{'' if ndim == 1 else 's'}")
    if ndim == 0 and not np.isfinite(a):
        raise InputError(f"{name} is {a}, expected a finite number")
    if not np.all(np.isfinite(a)):
        row = int(np.argwhere(~np.isfinite(a))[0][0])
        raise InputError(f"{name} is not finite at row {row}: {a[row]}")
    return a
