"""A study's folder: each part is stored as soon as it is finished, so that the study can be resumed."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from slamkit.arrays import Array
from slamkit.errors import InputError, LogFileError
from slamkit.logs import Field, PathLike, read_archive, reading, write_archive
from slamkit.study.fingerprint import fingerprint
from slamkit.study.gauge_check import GaugeCheck
from slamkit.study.tasks import Part, Task, all_tasks
from slamkit.study.trial import Trial

_STUDY = "study.npz"
_FACTS: dict[str, type] = {
    "slamkit": str, "simulated": bool, "world": str, "seed": int, "filters": dict, "world_content": str,
    "motion": str, "sensor": str, "start": str, "options": str, "diverged_at": float, "gauge_steps": int,
    "max_gap": float, "runs": int,
}  # fmt: skip
_STUDY_FIELDS = {"times": Field(np.float64, ("K",)), "start_time": Field(np.float64, ())}
_TRIAL_FIELDS = {
    "errors": Field(np.float64, ("K", 3), finite=False),
    "sigmas": Field(np.float64, ("K", 3), finite=False),
    "nees": Field(np.float64, ("K", 3), finite=False),
    "dof": Field(np.int64, ("K", 3), lower=0, upper=3),
}
_CHECK_FIELDS = {"times": Field(np.float64, ("n",)), "deviations": Field(np.float64, ("n",), lower=0.0)}
#: Types of the other fields of a trial and of a gauge check, by their annotation.
_TYPES: dict[str, tuple[type, ...]] = {
    "str": (str,), "str | None": (str, type(None)), "bool": (bool,), "int": (int,), "int | None": (int, type(None)),
    "float": (float,), "float | None": (float, type(None)),
}  # fmt: skip
_MOST_RUNS = 10**6


@dataclass(frozen=True)
class Store:
    """study.npz with the settings, one trial-….npz for each run, one gauge-….npz for each filter.

    A file holds numbers and text only, no pickled objects. Each part also holds a fingerprint of the study's settings,
    so that a part of another study is refused.
    """

    folder: Path
    facts: Mapping[str, Any]
    times: Array

    @classmethod
    def open(cls, folder: PathLike, facts: Mapping[str, Any], times: Array) -> Store:
        """Open a folder for a study with these settings; nothing is written yet but the folder itself.

        Raises
        ------
        InputError
            The folder cannot be made or written, or holds a study with other settings.
        LogFileError
            The study in it cannot be read.
        """
        folder = Path(folder)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"folder {folder} cannot be made: {error.strerror}") from None
        if not os.access(folder, os.W_OK):
            raise InputError(f"folder {folder} cannot be written")
        if (folder / _STUDY).exists():
            _refuse_other(folder, _read_study(folder)[0], facts)
        return cls(folder, facts, times)

    def begin(self, start_time: float, runs: int) -> None:
        """Write the settings."""
        path = self.folder / _STUDY
        if path.exists():
            runs = max(runs, _read_study(self.folder)[3])
        arrays = {"times": self.times, "start_time": np.array(float(start_time))}
        write_archive(path, "study", {**self.facts, "runs": runs}, arrays)

    def path(self, task: Task) -> Path:
        """The file of a part."""
        if task.run < 0:
            return self.folder / f"gauge-{list(self.facts['filters']).index(task.filter)}.npz"
        return self.folder / f"trial-{task.run:06d}.npz"

    def write(self, task: Task, part: Part) -> None:
        """Store a part."""
        mark = {"study": _mark(self.facts)}
        if isinstance(part, GaugeCheck):
            check = {**mark, "check": _scalars(part, _CHECK_FIELDS)}
            write_archive(self.path(task), "gauge check", check, {n: getattr(part, n) for n in _CHECK_FIELDS})
            return
        arrays = {f"{row}.{n}": getattr(t, n) for row, t in enumerate(part) for n in _TRIAL_FIELDS}
        trials = [_scalars(t, _TRIAL_FIELDS) for t in part]
        write_archive(self.path(task), "trial", {**mark, "trials": trials}, arrays)

    def read(self, tasks: Iterable[Task]) -> dict[Task, Part]:
        """The parts that are stored.

        Raises
        ------
        LogFileError
            A file is damaged, newer than this slamkit, or belongs to another study. The message names it.
        """
        parts: dict[Task, Part] = {}
        for task in tasks:
            path = self.path(task)
            if not path.exists():
                continue
            kind = "gauge check" if task.run < 0 else "trial"
            try:
                with reading(path, kind):
                    parts[task] = self._read_check(task) if task.run < 0 else self._read_trials(task)
            except LogFileError as error:
                raise LogFileError(f"{error}; remove the file to compute it again") from error
        return parts

    def _read_check(self, task: Task) -> GaugeCheck:
        types = {"study": str, "check": dict}
        facts, arrays = read_archive(self.path(task), "gauge check", _CHECK_FIELDS, types)
        self._refuse_foreign(facts)
        check = GaugeCheck(**_checked(GaugeCheck, facts["check"], _CHECK_FIELDS, arrays))
        if check.filter != task.filter:
            raise InputError(f"it is the check of {check.filter}, expected {task.filter}")
        return check

    def _read_trials(self, task: Task) -> list[Trial]:
        names = list(self.facts["filters"])
        wanted = {f"{row}.{n}": field for row in range(len(names)) for n, field in _TRIAL_FIELDS.items()}
        facts, arrays = read_archive(self.path(task), "trial", wanted, {"study": str, "trials": list})
        self._refuse_foreign(facts)
        trials = [
            Trial(**_checked(Trial, scalars, _TRIAL_FIELDS, {n: arrays[f"{row}.{n}"] for n in _TRIAL_FIELDS}))
            for row, scalars in enumerate(facts["trials"][: len(names)])
        ]
        if [t.filter for t in trials] != names or any(t.number != task.run for t in trials):
            raise InputError("it holds other trials than its name says, or of other filters")
        if len(arrays["0.errors"]) != len(self.times):
            raise InputError(f"it has {len(arrays['0.errors'])} steps, expected {len(self.times)}")
        return trials

    def _refuse_foreign(self, facts: Mapping[str, Any]) -> None:
        if facts["study"] != _mark(self.facts):
            raise InputError("it belongs to a study with other settings")


def load(folder: PathLike) -> tuple[Store, float, int, dict[Task, Part]]:
    """A complete study from its folder: store, time at which the first step begins, number of runs, parts.

    Raises
    ------
    LogFileError
        There is no study, it is unfinished, or a file is damaged or foreign. The message names it.
    """
    folder = Path(folder)
    facts, times, start_time, runs = _read_study(folder)
    tasks = all_tasks(facts["filters"], facts["gauge_steps"], runs)
    store = Store(folder, facts, times)
    parts = store.read(tasks)
    missing = [store.path(task).name for task in tasks if task not in parts]
    if missing:
        more = f" and {len(missing) - 1} more are" if len(missing) > 1 else " is"
        raise LogFileError(
            f"{folder} holds an unfinished study: {missing[0]}{more} missing; "
            "call compare with the same settings to continue"
        )
    return store, start_time, runs, parts


def _read_study(folder: Path) -> tuple[dict[str, Any], Array, float, int]:
    """Settings, times, time at which the first step begins, and number of runs."""
    path = folder / _STUDY
    with reading(path, "study"):
        facts, arrays = read_archive(path, "study", _STUDY_FIELDS, _FACTS)
        runs, times = facts.pop("runs"), arrays["times"]
        if not 1 <= runs <= _MOST_RUNS:
            raise InputError(f"runs is {runs}, expected 1 to {_MOST_RUNS}")
        if not facts["filters"] or not all(isinstance(v, str) for v in facts["filters"].values()):
            raise InputError(f"filters is {facts['filters']!r}, expected names and fingerprints")
        if facts["gauge_steps"] < 0 or np.any(np.diff(times) < 0):
            raise InputError("gauge_steps is negative, or times are not in order")
        return facts, times, float(arrays["start_time"]), runs


def _refuse_other(folder: Path, there: Mapping[str, Any], here: Mapping[str, Any]) -> None:
    """Refuse a folder with a study of other settings."""
    differing = [n for n in {**here, **there} if here.get(n) != there.get(n)]
    if list(there["filters"]) != list(here["filters"]) and "filters" not in differing:
        differing.append("filters")
    if not differing:
        return
    first = differing[0]
    pair: list[Any] = [there.get(first), here.get(first)]
    if first == "filters":
        if list(pair[0] or ()) != list(pair[1] or ()):
            pair = [", ".join(names or ()) for names in pair]
        else:  # the same names for other code: name the first
            pair = [next({n: v} for n, v in own.items() if v != other[n]) for own, other in (pair, pair[::-1])]
    raise InputError(
        f"{folder} holds a study with other settings: {', '.join(differing)} ({first} is {pair[0]!r} there, "
        f"{pair[1]!r} here); choose another folder, or the same settings"
    )


def _mark(facts: Mapping[str, Any]) -> str:
    """A short hash of a study's settings."""
    return fingerprint(json.dumps(dict(facts)))


def _scalars(part: Trial | GaugeCheck, arrays: Iterable[str]) -> dict[str, Any]:
    return {f.name: getattr(part, f.name) for f in fields(part) if f.name not in arrays}


def _checked(
    kind: type[Trial] | type[GaugeCheck], scalars: Any, fields_: Mapping[str, Field], arrays: Mapping[str, Any]
) -> dict[str, Any]:
    """All fields of a trial or gauge check, after checking the names, types and signs of those that are not arrays."""
    types = {f.name: _TYPES[str(f.type)] for f in fields(kind) if f.name not in fields_}
    if not isinstance(scalars, dict) or set(scalars) != set(types):
        raise InputError(f"a {kind.__name__} is {str(scalars)[:100]}, expected {', '.join(types)}")
    for name, expected in types.items():
        value = scalars[name]
        if type(value) not in expected:
            raise InputError(f"{name} is {str(value)[:100]}, expected {' or '.join(t.__name__ for t in expected)}")
        if type(value) is int and value < 0:
            raise InputError(f"{name} is {value}, expected at least 0")
    return {**scalars, **arrays}
