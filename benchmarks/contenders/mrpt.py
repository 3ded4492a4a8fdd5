"""MRPT's CRangeBearingKFSLAM2D, if MRPT is installed (on Debian: apt install libmrpt-slam-dev).

Only the calls are compiled here; the filter is that of the packaged library. MRPT_ROOT is the folder with include/mrpt
and lib, by default /usr. For libraries in a folder unknown to the system, set LD_LIBRARY_PATH.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from ctypes import c_char_p, c_double, c_long, c_void_p
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from _workload import SIGMA_BEARING, SIGMA_OMEGA, SIGMA_RANGE, SIGMA_V, Array, IntArray, Work
from numpy.ctypeslib import ndpointer

from contenders import MissingError
from contenders._build import library

LIBRARIES = ("mrpt-slam", "mrpt-obs", "mrpt-poses", "mrpt-bayes", "mrpt-math")


def _library() -> Any:
    """The library of mrpt.cpp with the types of its functions."""
    root = Path(os.environ.get("MRPT_ROOT", "/usr"))
    modules = sorted((root / "include" / "mrpt").glob("*/include"))
    found = next((root / "lib").glob("**/libmrpt-slam.so"), None)
    if not modules or found is None:
        raise MissingError(
            f"no MRPT under {root} (Debian: apt install libmrpt-slam-dev; MRPT_ROOT names another place)"
        )
    headers = [root / "include", root / "include" / "eigen3", *modules]
    made = library(
        "mrpt.cpp",
        tuple(f"-I{folder}" for folder in headers),
        (f"-L{found.parent}", f"-Wl,-rpath,{found.parent}", *(f"-l{name}" for name in LIBRARIES)),
    )
    doubles, longs = ndpointer(np.float64, flags="C"), ndpointer(np.int64, flags="C")
    made.mrpt_new.restype = c_void_p
    made.mrpt_new.argtypes = [c_long, doubles, doubles, doubles, c_long]
    made.mrpt_prepare.argtypes = [
        c_void_p, doubles, doubles, longs, longs, doubles, c_long, c_long, doubles, c_double,
    ]  # fmt: skip
    made.mrpt_read.argtypes = [c_void_p, doubles, doubles]
    for function in (made.mrpt_run, made.mrpt_free):
        function.argtypes = [c_void_p]
    made.mrpt_run.restype = c_char_p
    for function in (made.mrpt_prepare, made.mrpt_read, made.mrpt_free):
        function.restype = None
    return made


class Davison:
    """The fastest form, kfEKFAlaDavison: one scalar update at a time, on both triangles of the covariance.

    It has slamkit's models: the arc and its noise are passed as an odometry increment, the standard deviations of the
    sensor as options. The update differs in three ways. It computes the Jacobians of all sightings before the
    first update, it computes both residuals of a sighting before the first scalar update, and it stores measurements in
    single precision. An EKF that does the same agrees with it to rounding (tests/test_contenders.py).
    """

    tolerance: ClassVar[float] = 0.3  # the largest difference seen is 0.12, at 2000 landmarks
    defers: ClassVar[bool] = False
    grows: ClassVar[bool] = False
    method: ClassVar[int] = 1

    def __init__(self, work: Work) -> None:
        self.library, self.work = _library(), work
        self.sigmas = np.array([SIGMA_V, SIGMA_OMEGA, SIGMA_RANGE, SIGMA_BEARING])
        # MRPT predicts all landmarks up to 15 m beyond the range of the sensor: use the longest range of the drive.
        self.reach = float(work.z[work.first[work.survey] :, 0].max())
        self.filter: Any = None

    def start(self) -> None:
        """Copy slamkit's map: the initialisation of landmarks is not compared."""
        mapped = self.work.surveyed()
        if self.filter is not None:
            self.library.mrpt_free(self.filter)
        self.filter = self.library.mrpt_new(self.work.dim, mapped.x.copy(), mapped.P.copy(), self.sigmas, self.method)

    def ready(self, begin: int, end: int) -> Callable[[], object]:
        """Convert the steps to MRPT's actions and sensory frames."""
        work = self.work
        self.library.mrpt_prepare(
            self.filter, work.controls, work.dt, work.first, work.ids, work.z, begin, end, self.sigmas, self.reach
        )
        return self._run

    def _run(self) -> None:
        complaint = self.library.mrpt_run(self.filter)
        if complaint is not None:
            raise RuntimeError(complaint.decode(errors="replace"))

    def joint(self, at: IntArray) -> tuple[Array, Array]:
        """State and a block of P."""
        x, P = np.empty(self.work.dim), np.empty((self.work.dim, self.work.dim))
        self.library.mrpt_read(self.filter, x, P)
        return x, P[np.ix_(at, at)]
