"""A filter over a whole log, in one compiled call a stretch where both models are compiled."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Sequence
from typing import Any

import numpy as np

from slamkit.arrays import Array, Indices
from slamkit.belief.compressed import undisturbed
from slamkit.cycle import Status, call
from slamkit.cycle.run import run as run_steps
from slamkit.errors import InputError
from slamkit.filters.explain import failure
from slamkit.filters.inputs import NO_CONTROL, control_array
from slamkit.logs import History, Log, Schedule

Progress = bool | Callable[[int, int], None]

LONG_CALL = 0.05  #: [s] a compiled call over many steps that takes less is followed by one over four times as many


def run(filter: Any, log: Log, progress: Progress = False) -> History:
    """Run a filter over a log; :meth:`slamkit.filters.LandmarkFilter.run` has parameters and errors."""
    if not isinstance(log, Log):
        raise InputError(f"log is a {type(log).__name__}, expected a slamkit.Log")
    known, started = filter.dim_u, time.perf_counter()
    whole: _Run | None = None
    try:
        with undisturbed():
            whole = _Run(filter, log)
        whole.go(progress)
        return whole.history(time.perf_counter() - started)
    except BaseException as error:  # Ctrl-C, or whatever a model in Python or the caller's progress raises
        with undisturbed():
            if whole is None or whole.done == 0:
                vars(filter)["dim_u"] = known  # a control that could not be used says nothing
            if whole is not None:
                error.history = whole.history(time.perf_counter() - started)  # type: ignore[attr-defined]
        raise


class _Run:
    """One run: the arrays that compiled code reads and fills."""

    def __init__(self, filter: Any, log: Log) -> None:
        self.filter, self.log = filter, log
        self.schedule: Schedule = log.schedule
        K, M, k = len(self.schedule.times), len(log.observations), filter.dim_z
        if M and log.observations.shape[1] != k:
            columns = log.observations.shape[1]
            raise InputError(f"the log's observations have {columns} columns, the sensor's R {k}")
        controlled = bool(np.any(self.schedule.control >= 0))
        # Copies: compiled code takes no read-only arrays, and somebody may have frozen those of the log.
        self.controls: Array = np.array(log.controls, dtype=float) if controlled else NO_CONTROL[None]
        if controlled:
            filter._take_control_length(len(control_array(self.controls[0], filter.dim_u, filter.motion)))
        self.z: Array = np.array(log.observations, dtype=float) if M else np.empty((0, k))
        self.which: Indices = np.array(log.observation_ids, dtype=np.int64)
        self.poses, self.covariances = np.empty((K, 3)), np.empty((K, 3, 3))
        self.innovations, self.nis, self.accepted = np.empty((M, k)), np.empty(M), np.empty(M, dtype=np.bool_)
        self.slot_of: Indices = np.array([filter._belief.slots.get(i, -1) for i in log.landmark_ids], dtype=np.int64)
        widest = int(np.diff(self.schedule.first).max(initial=1))
        unseen = int(np.count_nonzero(self.slot_of < 0))
        filter._belief.reserve(0 if filter.compresses else unseen, widest, exactly=True)
        filter._belief.hint_final_size(unseen)
        filter._belief.state.scratch.steps_done = 0
        filter._before_run(log, self.schedule)

    @property
    def done(self) -> int:
        """Steps that the belief has taken; compiled code counts, so that an interrupt cannot come in between."""
        return self.filter._belief.state.scratch.steps_done  # type: ignore[no-any-return]

    def go(self, progress: Progress) -> None:
        """Take all steps; raise what refuses one."""
        K, stretch, report = len(self.schedule.times), 1, _reporter(progress, len(self.schedule.times))
        try:
            while self.done < K:
                begun = time.perf_counter()
                # An interrupt is heard between whole steps.
                with undisturbed():
                    status = self._call(min(self.done + stretch, K))
                    self._register_new_landmarks()
                    self._follow_up(status)
                if self.filter._models.compiled:
                    # A call is to take a while, but an interrupt is to be heard and progress to be seen.
                    stretch = 4 * stretch if time.perf_counter() - begun < LONG_CALL else max(1, stretch // 2)
                report(self.done)
        finally:
            report(None)

    def _call(self, end: int) -> int:
        """Take steps up to `end`, as many as one call can; the status of the last."""
        f, schedule, belief = self.filter, self.schedule, self.filter._belief

        def steps(end: int) -> int:
            call(
                run_steps, f._policy, f._models, belief.state, self.controls, schedule.dt, schedule.control,
                schedule.first, self.which, self.slot_of, self.z, self.done, end,
                self.poses, self.covariances, self.innovations, self.nis, self.accepted,
            )  # fmt: skip
            return int(belief.state.scratch.status)

        slot_of = self.slot_of.copy()
        one = self.done + 1
        status = steps(end) if f._models.compiled else int(Status.CAREFUL)
        if status == Status.CAREFUL:
            if f._models.compiled:
                slot_of, one = self.slot_of.copy(), self.done + 1
            status = f._undoing(lambda: steps(one))
            if status not in (Status.OK, Status.DUE):
                self.slot_of[:] = slot_of
        return status

    def _follow_up(self, status: int) -> None:
        """Do what a status asks for; raise if the next step was refused."""
        belief, done = self.filter._belief, self.done
        if status == Status.DUE:
            belief.flush_if_due()
        elif status != Status.OK:
            rows = slice(self.schedule.first[done], self.schedule.first[done + 1])
            if status == Status.FULL:
                belief.grow_for(self.slot_of[self.which[rows]])
                return
            ids = [self.log.landmark_ids[i] for i in self.which[rows]]
            u = self.controls[max(int(self.schedule.control[done]), 0)]
            where = f" at time {self.schedule.times[done]} s of the log"
            raise failure(self.filter, status, u, ids, self.z[rows], where)

    def _register_new_landmarks(self) -> None:
        """Name the landmarks that compiled code has started, in the order of their slots."""
        _register(self.filter._belief, self.log.landmark_ids, self.slot_of)

    def history(self, seconds: float) -> History:
        """What the steps that are done have given."""
        # An interrupt may come between a compiled stretch and the naming of the landmarks which that has started.
        self._register_new_landmarks()
        f, log, schedule, done = self.filter, self.log, self.schedule, self.done
        landmarks, landmark_covariances = f._marginals()
        index = {i: n for n, i in enumerate(f._belief.slots)}
        rows_of = np.array([index.get(i, -1) for i in log.landmark_ids], dtype=np.int64)
        seen = int(schedule.first[done])
        return History(
            filter=f.name,
            times=schedule.times[:done],
            poses=self.poses[:done],
            pose_covariances=self.covariances[:done],
            observation_times=np.repeat(schedule.times, np.diff(schedule.first))[:seen],
            observation_ids=rows_of[self.which[:seen]] if len(self.which) else np.empty(0, dtype=np.int64),
            innovations=self.innovations[:seen],
            nis=self.nis[:seen],
            accepted=self.accepted[:seen],
            landmark_ids=f._belief.ids,
            landmarks=landmarks,
            landmark_covariances=landmark_covariances,
            seconds=seconds,
        )


def _register(belief: Any, ids: Sequence[Hashable], slot_of: Indices) -> None:
    named = belief.base + 2 * len(belief.slots)
    if named < belief.dim:
        new = np.flatnonzero(slot_of >= named)
        for i in new[np.argsort(slot_of[new])]:
            belief.register(ids[i], int(slot_of[i]))


def _reporter(progress: Progress, total: int) -> Callable[[int | None], None]:
    """A function that is told how many steps are done, and None at the end."""
    if progress is False:
        return lambda done: None
    if callable(progress):
        tell = progress
        return lambda done: None if done is None else tell(done, total)
    from rich.progress import Progress as Bar

    bar = Bar(transient=True)
    task = bar.add_task("steps", total=total)
    bar.start()
    return lambda done: bar.stop() if done is None else bar.update(task, completed=done)
