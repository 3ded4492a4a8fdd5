"""The filter that all others are compared with: hand-written C++ that processes a whole log in one call."""

from __future__ import annotations

from collections.abc import Callable
from ctypes import c_double, c_long
from typing import Any, ClassVar

import numpy as np
from _workload import SIGMA_BEARING, SIGMA_OMEGA, SIGMA_RANGE, SIGMA_V, START, Array, IntArray, Work
from numpy.ctypeslib import ndpointer

from contenders import ROUNDING, from_triangle
from contenders._build import library


def _library() -> Any:
    """The library of triangle.cpp with the types of its functions."""
    made = library("triangle.cpp")
    doubles, longs = ndpointer(np.float64, flags="C"), ndpointer(np.int64, flags="C")
    made.triangle_run.restype = c_long
    made.triangle_run.argtypes = [
        doubles, doubles, c_long, c_long, doubles, doubles, doubles, longs, longs, doubles, c_long, c_long, doubles,
    ]  # fmt: skip
    made.triangle_pass.restype = None
    made.triangle_pass.argtypes = [doubles, c_long, c_long, c_double]
    return made


class Triangle:
    """EKF on the lower triangle of P with contiguous rows. Every sighting is a rank-2 downdate."""

    tolerance: ClassVar[float] = ROUNDING
    defers: ClassVar[bool] = False
    grows: ClassVar[bool] = False

    def __init__(self, work: Work) -> None:
        self.library, self.work = _library(), work
        self.x, self.P, self.scratch = np.zeros(work.dim), np.zeros((work.dim, work.dim)), np.zeros(2 * work.dim)
        self.slots = 3 + 2 * work.ids
        self.sigmas = np.array([SIGMA_V, SIGMA_OMEGA, SIGMA_RANGE, SIGMA_BEARING])
        self.length = 3

    def start(self) -> None:
        """Map the landmarks."""
        self.x[:3], self.P[:3, :3] = self.work.pose, np.diag(START**2)
        self.length = 3
        self.ready(0, self.work.survey)()

    def ready(self, begin: int, end: int) -> Callable[[], object]:
        """One call for all the steps."""
        work = self.work
        rest = (work.controls, work.dt, work.first, self.slots, work.z, begin, end, self.sigmas)

        def go() -> None:
            self.length = self.library.triangle_run(self.x, self.P, work.dim, self.length, self.scratch, *rest)

        return go

    def joint(self, at: IntArray) -> tuple[Array, Array]:
        """State and a block of P."""
        return self.x, from_triangle(self.P, at)


class Passes:
    """Lower bound of every filter that touches all of P in a step: the triangle is read and written once."""

    def __init__(self, dim: int) -> None:
        self.library, self.P = _library(), np.ones((dim, dim))

    def __call__(self) -> None:
        """One pass."""
        dim = len(self.P)
        self.library.triangle_pass(self.P, dim, dim, 1.0)
