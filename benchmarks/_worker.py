"""A contender in a process of its own, which sleeps while the others have their turn."""

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

SAMPLE = 0.2  # [s]; no sample is shorter
WINDOW = 50  # steps of the drive over which a filter is sampled that is the slower the more steps it has taken
MANY, LONG = 1000, 5.0  # a filter that puts work off is sampled over so many steps, or seconds where that is shorter
LIMIT = 900.0  # [s]; no call of a worker may take longer


class Track:
    """One contender on its way along the work."""

    def __init__(self, name: str, work: Work) -> None:
        self.work = work
        self.contender: Contender = contender(name)(work)
        self._restart()

    def _restart(self) -> None:
        self.contender.start()
        self.at = self.work.survey

    def advance(self, steps: int) -> float:
        """Seconds that the next steps take; from the survey's end again where the work has no more."""
        if self.at + steps > self.work.steps:
            self._restart()
        taken = seconds(self.contender.ready(self.at, self.at + steps))
        self.at += steps
        return taken

    def position(self) -> int:
        """Steps of the drive that are behind it."""
        return self.at - self.work.survey

    def belief(self, steps: int, entries: IntArray) -> tuple[Array, Array]:
        """State (D,) and covariance (n, n) of some entries after so many steps of the drive."""
        if steps > self.position():
            self.advance(steps - self.position())
        x, block = self.contender.joint(entries)
        return np.array(x), np.array(block)

    def calibrate(self) -> int:
        """Steps in a row that make a good sample; fewer where the work has no more, which is then done repeatedly.

        A filter's first call, and what `run` does once a log, cost as much as hundreds of steps: no short sample tells
        how long a step takes.
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
        """Seconds a step."""
        taken, done = 0.0, 0
        while taken < SAMPLE:
            if self.contender.grows:
                self._restart()
            taken += self.advance(steps)
            done += steps
        return taken / done

    def aged(self, steps: int) -> float:
        """Seconds a step after so many steps of the drive."""
        self._restart()
        self.advance(steps)
        return self.advance(WINDOW) / WINDOW

    def worst(self, steps: int, repeats: int) -> Array:
        """Seconds (steps,) of each step called by itself, the least of some repeats: what the machine did apart."""
        runs = []
        for _ in range(repeats):
            self._restart()
            runs.append(self.contender.times(self.work.survey, self.work.survey + steps))  # type: ignore[attr-defined]
        least: Array = np.min(runs, axis=0)
        return least


class Floors:
    """What this machine needs for the least that a filter can do which touches all of P in a step."""

    def __init__(self, dim: int) -> None:
        self.passes = Passes(dim)
        self.rows = np.random.default_rng(0).standard_normal((2 * SIGHTINGS, dim)).T

    def sample(self) -> tuple[float, float]:
        """Seconds of one pass over the triangle, and of the 8 D² multiply-adds that 8 sightings cost as one dsyrk."""
        return _each(self.passes), _each(self._multiply)

    def _multiply(self) -> None:
        # BLAS counts by columns: the transpose's upper triangle is P's lower one.
        dsyrk(-1e-30, self.rows, 1.0, self.passes.P.T, overwrite_c=1)


def _each(go: Callable[[], object]) -> float:
    """Seconds of one call, from so many in a row that they make a sample."""
    calls, taken = 1, 0.0
    while taken < SAMPLE:
        calls *= 4
        taken = seconds(partial(_repeat, go, calls))
    return taken / calls


def _repeat(go: Callable[[], object], calls: int) -> None:
    for _ in range(calls):
        go()


def peak(name: str, small: Work, work: Work) -> float:
    """Bytes that a contender adds at its peak to a process that has done a small work, survey and flush, before.

    So the interpreter, the compiled code and the work itself do not count; what the contender allocates does.

    Raises
    ------
    MissingError
        The system is not Linux: no other tells a process to measure its peak anew.
    """
    Track(name, small).advance(small.steps - small.survey)
    gc.collect()
    before = _forget_peak()
    track = Track(name, work)
    track.advance(min(track.calibrate(), MANY))
    return _memory("VmHWM") - before


def _forget_peak() -> float:
    """Have the system take the present memory [bytes], which is returned, for the process's peak."""
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        raise MissingError("the peak of a process can be measured on Linux alone") from None
    return _memory("VmRSS")


def _memory(field: str) -> float:
    """What the system says of this process [bytes]."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024.0 * int(next(line for line in lines if line.startswith(f"{field}:")).split()[1])


def _serve(pipe: Connection) -> None:
    """Make what is asked for, call its methods, and send back what they return or raise."""
    held: Any = None
    while True:
        method, arguments = pipe.recv()
        try:
            if method == "make":
                held = None  # the old one goes before the new one comes: there may not be room for both
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
    """The near end of such a process."""

    def __init__(self) -> None:
        context = get_context("spawn")
        self._pipe, far = context.Pipe()
        self._process = context.Process(target=_serve, args=(far,), daemon=True)
        self._process.start()
        far.close()

    def __call__(self, method: Any, *arguments: Any) -> Any:
        """Have the far end call a method of what it holds, or a function, and wait for the result.

        Raises
        ------
        TimeoutError
            It takes longer than `LIMIT`.
        RuntimeError
            The process has ended.
        Exception
            Whatever the call raises.
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
