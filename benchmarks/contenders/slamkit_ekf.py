"""slamkit's standard EKF, in the ways in which it can be called.

What is timed ends with a flush: nothing is left over that would have to be paid later.
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

FLUSH_WORK = 2e8  #: multiply-adds that a step may spend on a flush where it is spread


class Run:
    """`EKFSLAM.run`: merges the log by time, takes every step, and returns a history of all of it."""

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
        """Let the filter before go, so that its memory does not count as the new one's."""
        vars(self).pop("filter", None)

    def ready(self, begin: int, end: int) -> Callable[[], object]:
        """A log of the steps."""
        log = self.work.log(begin, end)

        def go() -> None:
            self.filter.run(log)
            self.filter.flush()

        return go

    def joint(self, at: IntArray) -> tuple[Array, Array]:
        """State and a block of P, without the whole of it."""
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
        """Seconds (end - begin,) that each step takes."""
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
    """`EKFSLAM.step` with a bound on the work of a step: a flush is spread over as many as it needs."""

    def start(self) -> None:
        """Map the landmarks."""
        self._drop()
        self.filter = self.work.surveyed(Storage(flush_work=FLUSH_WORK))


class Read(Step):
    """`EKFSLAM.step`, and the whole of P read after each."""

    held: ClassVar[int] = 0  #: how many of them are held on to

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
    """The same, where one P is held until the next has been read."""

    held: ClassVar[int] = 1


class Calls(Step):
    """`EKFSLAM.predict`, then `observe` for one sighting after the other."""

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
