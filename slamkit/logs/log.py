"""What a robot did and saw in one run."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from slamkit.arrays import Array, Indices, finite_array, finite_number
from slamkit.errors import InputError, LogFileError
from slamkit.logs import csv
from slamkit.logs.archive import Field, decode_id, encode_id, read_archive, reading, write_archive
from slamkit.logs.atomic import PathLike
from slamkit.logs.display import count, html_table, span
from slamkit.logs.scan import LogStep, Scan
from slamkit.logs.schedule import Schedule, make_schedule, order_of_controls, order_of_observations
from slamkit.logs.truth import Truth


@dataclass(frozen=True, eq=False, repr=False)
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
        False: controls are rates (velocities). A control that an observation interrupts is split into two
        predictions. True: each control is the whole motion up to the next control's time (odometry increments) and is
        never split; observations within the interval are used at its end.
    truth : Truth, optional

    Raises
    ------
    InputError
        Wrong shapes, a value that is not a finite number, an unknown landmark row, neither a control nor an
        observation, an end before the last control, or an increment that has no interval in which to act.

    Notes
    -----
    The log keeps copies of its arrays, sorted by time, so the order of rows never decides the order of events. Rows
    of one time are ordered by their values. Of several rates with one time the lexicographically largest acts.
    Observations of one instant follow `observation_ids`, with the second sighting of a landmark after the first
    sighting of every other.
    """

    control_times: Array
    controls: Array
    observation_times: Array
    observation_ids: Indices
    observations: Array
    landmark_ids: tuple[Hashable, ...]
    end_time: float | None = None
    increments: bool = False
    truth: Truth | None = None

    def __post_init__(self) -> None:
        ct = finite_array("control_times", self.control_times, (-1,))
        u = finite_array("controls", self.controls, (-1, -1))
        ot = finite_array("observation_times", self.observation_times, (-1,))
        z = finite_array("observations", self.observations, (-1, -1))
        ids = self._check_ids()
        if len(ct) == 0 and len(ot) == 0:
            raise InputError("the log is empty: it has neither a control nor an observation")
        if len(u) != len(ct):
            raise InputError(f"controls have {len(u)} rows, control_times {len(ct)}")
        index = self._check_rows(len(ot), len(z), len(ids))
        if self.end_time is None:
            end = float(np.concatenate([ct, ot]).max())
        else:
            end = finite_number("end_time", self.end_time, unit="seconds")
        if np.any(ct > end):
            raise InputError(f"end_time is {end}, expected a time not before the last control's {ct.max()}")
        if not isinstance(self.increments, bool | np.bool_):
            raise InputError(f"increments is {self.increments!r}, expected True or False")
        if not isinstance(self.truth, Truth | None):
            raise InputError(f"truth is a {type(self.truth).__name__}, expected a Truth or None")
        by_control, by_observation = order_of_controls(ct, u), order_of_observations(ot, index, z)
        for name, value in (
            ("control_times", ct[by_control]),
            ("controls", np.ascontiguousarray(u[by_control])),
            ("observation_times", ot[by_observation]),
            ("observation_ids", index[by_observation]),
            ("observations", np.ascontiguousarray(z[by_observation])),
            ("landmark_ids", ids),
            ("end_time", end),
            ("increments", bool(self.increments)),
        ):
            object.__setattr__(self, name, value)
        if self.increments and len(ct):
            self._check_increments()

    def _check_ids(self) -> tuple[Hashable, ...]:
        given: object = self.landmark_ids
        if isinstance(given, str | bytes):
            raise InputError(f"landmark_ids is {given!r}, expected a sequence of ids such as a tuple")
        try:
            ids = tuple(self.landmark_ids)
            distinct = len(set(ids))
        except TypeError as error:
            raise InputError(f"landmark_ids must be a sequence of hashable ids: {error}") from None
        if distinct != len(ids):
            raise InputError("landmark_ids holds an id twice")
        return ids

    def _check_rows(self, M: int, rows: int, L: int) -> Indices:
        """The rows of `landmark_ids`, for M times and so many rows of measurements."""
        try:
            index = np.asarray(self.observation_ids)
        except (TypeError, ValueError) as error:
            raise InputError(f"observation_ids must be integers: {error}") from None
        if rows != M or index.shape != (M,):
            raise InputError(
                f"observations have {rows} rows and observation_ids shape {index.shape}, "
                f"{M} observation_times need ({M}, k) and ({M},)"
            )
        if M and (not np.issubdtype(index.dtype, np.integer) or np.ma.is_masked(self.observation_ids)):
            raise InputError(f"observation_ids have dtype {index.dtype}, expected integers: rows of landmark_ids")
        if M and (index.min() < 0 or index.max() >= L):
            raise InputError(f"observation_ids run from {index.min()} to {index.max()}, there are {L} landmark_ids")
        return index.astype(np.int64)

    def _check_increments(self) -> None:
        """Refuse an increment of no duration: no step could use it, and its motion would be lost."""
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
        assert self.end_time is not None  # __post_init__ fills it in
        return make_schedule(
            self.control_times, self.observation_times, self.observation_ids, self.end_time, self.increments
        )

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

    def __repr__(self) -> str:
        kind = "increment" if self.increments else "control"
        parts = [count(len(self.controls), kind), self._sightings(), self._span()]
        return f"Log({', '.join(parts + ['truth'] * (self.truth is not None))})"

    def _repr_html_(self) -> str:
        kind = "increments" if self.increments else "rates"
        rows = {
            "controls": f"{len(self.controls)} {kind} of {count(self.controls.shape[1], 'number')}",
            "sightings": f"{self._sightings()}, of {count(self.observations.shape[1], 'number')}",
            "time": self._span(),
            "truth": "none" if self.truth is None else self.truth.summary(),
        }
        return html_table("Log", rows)

    def _sightings(self) -> str:
        n = len(np.unique(self.observation_ids))
        return f"{count(len(self.observations), 'sighting')} of {count(n, 'landmark')}"

    def _span(self) -> str:
        return span(self.control_times, self.observation_times, np.array([self.end_time] * bool(len(self.controls))))

    def head(self, steps: int) -> Log:
        """The first steps of the schedule, as a log.

        Parameters
        ----------
        steps : int
            How many, at least 1.

        Returns
        -------
        Log
            Its schedule is the first `steps` steps of this log's. A filter that runs over it is where it would be
            after that many steps of the whole log. Controls and observations of later steps are left out; a rate that
            acts beyond the last step ends with it. `landmark_ids` and the true landmarks stay complete. True poses
            are kept up to the first one after the last step, so that every step finds the same nearest true pose as
            in the whole log. The log itself is returned where it has no more steps.

        Raises
        ------
        InputError
            `steps` is not an integer of at least 1.
        """
        if isinstance(steps, bool) or not isinstance(steps, int | np.integer) or steps < 1:
            raise InputError(f"steps is {steps!r}, expected an integer of at least 1")
        s = self.schedule
        if steps >= len(s.times):
            return self
        last, seen = float(s.times[steps - 1]), int(s.first[steps])
        acting = self.control_times < last
        assert self.end_time is not None  # __post_init__ fills it in
        return replace(
            self,
            control_times=self.control_times[acting],
            controls=self.controls[acting],
            observation_times=self.observation_times[:seen],
            observation_ids=self.observation_ids[:seen],
            observations=self.observations[:seen],
            end_time=min(last, self.end_time),
            truth=None if self.truth is None else self.truth.until(last),
        )

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
        truth = self.truth
        facts: dict[str, Any] = {
            "landmark_ids": [encode_id(i) for i in self.landmark_ids],
            "end_time": self.end_time,
            "increments": self.increments,
            "truth": None if truth is None else [encode_id(i) for i in truth.landmarks],
        }
        arrays = {name: getattr(self, name) for name in _ARRAYS if name not in _TRUTH_ARRAYS}
        if truth is not None:
            positions = np.reshape(list(truth.landmarks.values()), (-1, 2))
            arrays |= dict(zip(_TRUTH_ARRAYS, (truth.times, truth.poses, positions), strict=True))
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
            facts, arrays = read_archive(path, "Log", _ARRAYS, _FACTS)
            ids, named = facts.pop("landmark_ids"), facts.pop("truth")
            of_truth = [arrays.pop(name) for name in _TRUTH_ARRAYS if name in arrays]
            if len(of_truth) != (0 if named is None else len(_TRUTH_ARRAYS)):
                raise InputError(f"it has {len(of_truth)} of the {len(_TRUTH_ARRAYS)} arrays of a truth")
            truth = None
            if named is not None:
                times, poses, positions = of_truth
                landmarks = dict(zip(map(decode_id, named), positions, strict=True))
                if len(landmarks) != len(named):
                    raise InputError("its truth holds a landmark twice")
                truth = Truth(times, poses, landmarks)
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
            Nothing is written, because the column names do not fit the log; or the id of a landmark would not come
            back as it is (an int does, and a printable str without # and outer spaces that is not an integer's
            digits); or observations are later than `end_time`, which this form cannot express; or the folder holds a
            truth.csv or landmarks.csv of another log, which would become a part of this one.

        Notes
        -----
        Numbers come back to the last bit. Where the last control acts beyond the last event, a row of zero control at
        `end_time` says so. Landmarks that were never sighted are not kept in `landmark_ids`.

        The files are replaced together. If the program is killed while it writes, :meth:`read_csv` finds all of the
        old files or all of the new ones.
        """
        csv.write_log(self, folder, controls, observations)

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
            A file is missing or not UTF-8 text, a header is missing or unknown, a row has the wrong number of fields,
            a field is not a finite number, a landmark is given twice. The message names the file, the line, what was
            given and what was expected.

        Notes
        -----
        Rows may stand in any order. Blank lines, comments (from # to the end of a line), spaces around fields, a byte
        order mark and any line ends are allowed.
        """
        fields = csv.read_log(folder)
        try:
            return cls(**fields)
        except LogFileError:
            raise
        except InputError as error:
            raise LogFileError(f"{folder}: {error}") from None


_TRUTH_ARRAYS = ("truth_times", "truth_poses", "truth_landmarks")

# What a file of a log holds: T controls of m numbers, M observations of k numbers, n true poses.
_ARRAYS = {
    "control_times": Field(np.float64, ("T",)),
    "controls": Field(np.float64, ("T", "m")),
    "observation_times": Field(np.float64, ("M",)),
    "observation_ids": Field(np.int64, ("M",), lower=0),
    "observations": Field(np.float64, ("M", "k")),
    "truth_times": Field(np.float64, ("n",), optional=True),
    "truth_poses": Field(np.float64, ("n", 3), optional=True),
    "truth_landmarks": Field(np.float64, ("l", 2), optional=True),
}
_FACTS: dict[str, type | tuple[type, ...]] = {
    "landmark_ids": list,
    "end_time": float,
    "increments": bool,
    "truth": (list, type(None)),
}
