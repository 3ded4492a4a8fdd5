"""A contender in a process of its own, which sleeps while others are measured."""

from __future__ import annotations

import gc
from collections.abc import Callable
from functools import partial
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from _measure import seconds
from _workload import SIGHTINGS, Array, IntArray, Work
from contenders import Contender, MissingError, contender
from contenders.triangle import Passes
from scipy.linalg.blas import dsyrk

SAMPLE = 0.2  # [s]; least duration of a sample
WINDOW = 50  # steps of a sample of a filter whose steps become slower over time
MANY, LONG = 1000, 5.0  # a sample of a filter that defers work has this many steps, or seconds if that is shorter
LIMIT = 900.0  # [s]; longest duration of a call of a worker


class Track:
    """One contender and its position in the work."""

    def __init__(self, name: str, work: Work) -> None:
        self.work = work
        self.contender: Contender = contender(name)(work)
        self._restart()

    def _restart(self) -> None:
        self.contender.start()
        self.at = self.work.survey

    def advance(self, steps: int) -> float:
        """Time of the next steps [s]. Restarts after the survey if fewer are left."""
        if self.at + steps > self.work.steps:
            self._restart()
        taken = seconds(self.contender.ready(self.at, self.at + steps))
        self.at += steps
        return taken

    def position(self) -> int:
        """Number of steps of the drive that are done."""
        return self.at - self.work.survey

    def belief(self, steps: int, entries: IntArray) -> tuple[Array, Array]:
        """State (D,), and covariance (n, n) of some entries, after this many steps of the drive."""
        if steps > self.position():
            self.advance(steps - self.position())
        x, block = self.contender.joint(entries)
        return np.array(x), np.array(block)

    def calibrate(self) -> int:
        """Number of consecutive steps of a good sample. If the work has fewer, a sample repeats them.

        The first call of a filter, and what `run` does once per log, cost as much as hundreds of steps, so a short
        sample does not show how long a step takes.
        """
        most = self.work.steps - self.work.survey
        if self.contender.grows:
            return min(WINDOW, most)
        steps = 1
        while steps < most:
            taken = self.advance(steps)
            if taken >= (LONG / 2 if self.contender.defers else SAMPLE) or (
                self.contender.defers and steps >= MANY and taken >= SAMPLE
            ):
                break
            steps = min(4 * steps, most)
        return steps

    def sample(self, steps: int) -> float:
        """Time of a step [s]."""
        taken, done = 0.0, 0
        while taken < SAMPLE:
            if self.contender.grows:
                self._restart()
            taken += self.advance(steps)
            done += steps
        return taken / done

    def aged(self, steps: int) -> float:
        """Time of a step [s] after this many steps of the drive."""
        self._restart()
        self.advance(steps)
        return self.advance(WINDOW) / WINDOW

    def worst(self, steps: int, repeats: int) -> Array:
        """Time of each single step (steps,) [s]: the least of several repeats, to exclude other load."""
        runs = []
        for _ in range(repeats):
            self._restart()
            runs.append(self.contender.times(self.work.survey, self.work.survey + steps))  # type: ignore[attr-defined]
        least: Array = np.min(runs, axis=0)
        return least


class Floors:
    """Times of the least work of any filter that touches all of P in a step."""

    def __init__(self, dim: int) -> None:
        self.passes = Passes(dim)
        self.rows = np.random.default_rng(0).standard_normal((2 * SIGHTINGS, dim)).T

    def sample(self) -> tuple[float, float]:
        """Time of one pass over the triangle, and of the 8 D² multiply-adds of 8 sightings as one dsyrk [s]."""
        return _each(self.passes), _each(self._multiply)

    def _multiply(self) -> None:
        # BLAS stores columns first: the upper triangle of the transpose is the lower triangle of P.
        dsyrk(-1e-30, self.rows, 1.0, self.passes.P.T, overwrite_c=1)


def _each(go: Callable[[], object]) -> float:
    """Time of one call [s], from enough calls in a row for a sample."""
    calls, taken = 1, 0.0
    while taken < SAMPLE:
        calls *= 4
        taken = seconds(partial(_repeat, go, calls))
    return taken / calls


def _repeat(go: Callable[[], object], calls: int) -> None:
    for _ in range(calls):
        go()


def peak(name: str, small: Work, work: Work) -> float:
    """Peak memory of a contender [bytes], above that of its process after a small work with survey and flush.

    The interpreter, the compiled code and the work itself do not count. What the contender allocates does.

    Raises
    ------
    MissingError
        The system is not Linux. Only Linux lets a process reset its peak.
    """
    Track(name, small).advance(small.steps - small.survey)
    gc.collect()
    before = _forget_peak()
    track = Track(name, work)
    track.advance(min(track.calibrate(), MANY))
    return _memory("VmHWM") - before


def _forget_peak() -> float:
    """Reset the peak memory of this process to its present memory, and return that [bytes]."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        raise MissingError("the peak memory of a process can be measured only on Linux") from None
    return _memory("VmRSS")


def _memory(field: str) -> float:
    """One memory field of this process [bytes]."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024.0 * int(next(line for line in lines if line.startswith(f"{field}:")).split()[1])


def _serve(pipe: Connection) -> None:
    """Make the requested object, call its methods, and send back what they return or raise."""
    held: Any = None
    while True:
        method, arguments = pipe.recv()
        try:
            if method == "make":
                held = None  # delete the old object first: there may not be memory for both
                cls, *arguments = arguments
                held, result = cls(*arguments), None
            elif method == "drop":
                held = result = None
            elif callable(method):
                result = method(*arguments)
            else:
                result = getattr(held, method)(*arguments)
        except Exception as error:
            pipe.send(error)
        else:
            pipe.send(result)


class Worker:
    """A process that holds one object, as its parent sees it."""

    def __init__(self) -> None:
        context = get_context("spawn")
        self._pipe, far = context.Pipe()
        self._process = context.Process(target=_serve, args=(far,), daemon=True)
        self._process.start()
        far.close()

    def __call__(self, method: Any, *arguments: Any) -> Any:
        """Call a method of the object that the process holds, or a function in the process, and wait for the result.

        Raises
        ------
        TimeoutError
            The call takes longer than `LIMIT`.
        RuntimeError
            The process has ended.
        Exception
            Any error of the call.
        """
        self._pipe.send((method, arguments))
        if not self._pipe.poll(LIMIT):
            raise TimeoutError(f"no answer within {LIMIT:g} s")
        try:
            result = self._pipe.recv()
        except EOFError:
            self._process.join()
            raise RuntimeError(f"its process ended with exit code {self._process.exitcode}") from None
        if isinstance(result, Exception):
            raise result
        return result

    def close(self) -> None:
        """End the process."""
        self._process.terminate()
        self._process.join()
