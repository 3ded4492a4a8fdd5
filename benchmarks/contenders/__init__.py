"""The filters of the scaling benchmark, all with the same interface."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import ClassVar, Protocol

import numpy as np
from _workload import Array, IntArray, Work

#: Tolerance in standard deviations for filters that do the same arithmetic in another order, over thousands of steps.
ROUNDING = 1e-7


class MissingError(Exception):
    """This machine lacks something that a contender needs."""


class Contender(Protocol):
    """One way to do the work. Its constructor raises `MissingError` if something that it needs is missing."""

    tolerance: ClassVar[float]  #: largest disagreement with slamkit, in standard deviations
    defers: ClassVar[bool]  #: whether it defers work to later steps, so that only many steps show what one costs

    grows: ClassVar[bool]  #: whether steps become slower with the number of steps taken

    def __init__(self, work: Work) -> None: ...

    def start(self) -> None:
        """Go to the end of the survey. Not timed."""
        ...

    def ready(self, begin: int, end: int) -> Callable[[], object]:
        """Prepare the steps begin … end-1. The returned function takes them; only it is timed."""
        ...

    def joint(self, at: IntArray) -> tuple[Array, Array]:
        """State (D,) and the covariance (n, n) of its entries `at`, in the order pose, landmark 0, landmark 1, …."""
        ...


#: Name in tables and figures → module and class. A module is imported only in the process of its contender.
CONTENDERS = {
    "C++, one triangle": "triangle:Triangle",
    "slamkit, run": "slamkit_ekf:Run",
    "slamkit, step": "slamkit_ekf:Step",
    "slamkit, step, spread flush": "slamkit_ekf:Spread",
    "slamkit, predict + observe": "slamkit_ekf:Calls",
    "slamkit, step + read P": "slamkit_ekf:Read",
    "slamkit, step + hold P": "slamkit_ekf:Hold",
    "MRPT": "mrpt:Davison",
    "iSAM2": "isam2:Smoother",
    "iSAM2 + covariance": "isam2:Joint",
    "NumPy, textbook": "dense:Textbook",
    "filterpy, dense": "dense:Filterpy",
}


def contender(name: str) -> type[Contender]:
    """The class of a contender."""
    module, _, cls = CONTENDERS[name].partition(":")
    found: type[Contender] = getattr(import_module(f"contenders.{module}"), cls)
    return found


def from_triangle(P: Array, at: IntArray) -> Array:
    """Covariance (n, n) of some entries from the lower triangle of P."""
    row, column = np.meshgrid(at, at, indexing="ij")
    block: Array = P[np.maximum(row, column), np.minimum(row, column)]
    return block
