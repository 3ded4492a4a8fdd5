"""slamkit's standard EKF, called in different ways.

Each timed function ends with a flush, so that no deferred work is left.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from time import perf_counter
from typing import ClassVar

import numpy as np
from _workload import Array, IntArray, Work

from contenders import ROUNDING
from slamkit import Scan, Storage

FLUSH_WORK = 2e8  #: multiply-adds of a spread flush per step


class Run:
    """`EKFSLAM.run`: it merges the log by time, takes every step, and returns the history."""

    tolerance: ClassVar[float] = ROUNDING
    defers: ClassVar[bool] = True
    grows: ClassVar[bool] = False

    def __init__(self, work: Work) -> None:
        self.work = work

    def start(self) -> None:
        """Map the landmarks."""
        self._drop()
        self.filter = self.work.surveyed()

    def _drop(self) -> None:
        """Delete the previous filter, so that its memory is not counted."""
        vars(self).pop("filter", None)

    def ready(self, begin: int, end: int) -> Callable[[], object]:
        """Convert the steps to a log."""
        log = self.work.log(begin, end)

        def go() -> None:
            self.filter.run(log)
            self.filter.flush()

        return go

    def joint(self, at: IntArray) -> tuple[Array, Array]:
        """State and a block of P, without unfolding the whole P."""
        slots = at[at >= 3] - 3
        mean_slots, inverse = np.unique(slots // 2, return_inverse=True)
        _, block = self.filter.marginal(mean_slots.tolist(), pose=True)
        rows = np.concatenate([at[at < 3], 3 + 2 * inverse + slots % 2])
        return self.filter.x, block[np.ix_(rows, rows)]


class Step(Run):
    """`EKFSLAM.step`, called from Python."""

    def ready(self, begin: int, end: int) -> Callable[[], object]:
        """The arguments of each step."""
        step, arguments = self.filter.step, self._arguments(begin, end)

        def go() -> None:
            for u, dt, scan in arguments:
                step(u, dt, scan)
            self.filter.flush()

        return go

    def times(self, begin: int, end: int) -> Array:
        """Time of each step (end - begin,) [s]."""
        step, arguments = self.filter.step, self._arguments(begin, end)
        marks = [perf_counter()]
        for u, dt, scan in arguments:
            step(u, dt, scan)
            marks.append(perf_counter())
        return np.diff(marks)

    def _arguments(self, begin: int, end: int) -> list[tuple[Array, float, Scan]]:
        work = self.work
        return [(work.controls[k], float(work.dt[k]), work.scan(k)) for k in range(begin, end)]


class Spread(Step):
    """`EKFSLAM.step` with a bound on the work of a step: a flush is spread over several steps."""

    def start(self) -> None:
        """Map the landmarks."""
        self._drop()
        self.filter = self.work.surveyed(Storage(flush_work=FLUSH_WORK))


class Read(Step):
    """`EKFSLAM.step`, with the whole P read after each step."""

    held: ClassVar[int] = 0  #: number of earlier P that stay referenced

    def ready(self, begin: int, end: int) -> Callable[[], object]:
        """The arguments of each step."""
        f, arguments = self.filter, self._arguments(begin, end)

        def go() -> None:
            held: deque[Array] = deque(maxlen=self.held)
            for u, dt, scan in arguments:
                f.step(u, dt, scan)
                held.append(f.P)

        return go


class Hold(Read):
    """`EKFSLAM.step` with P read after each step, where each P stays referenced until the next one is read."""

    held: ClassVar[int] = 1


class Calls(Step):
    """`EKFSLAM.predict`, then `EKFSLAM.observe` for each sighting."""

    def ready(self, begin: int, end: int) -> Callable[[], object]:
        """The arguments of each call."""
        predict, observe, work = self.filter.predict, self.filter.observe, self.work
        steps = [
            (work.controls[k], float(work.dt[k]), list(zip(scan.ids, np.asarray(scan.z), strict=True)))
            for k in range(begin, end)
            for scan in [work.scan(k)]
        ]

        def go() -> None:
            for u, dt, sightings in steps:
                predict(u, dt)
                for landmark, z in sightings:
                    observe(landmark, z)
            self.filter.flush()

        return go
