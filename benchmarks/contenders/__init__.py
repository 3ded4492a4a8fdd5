"""The filters that the benchmark of scaling compares, each behind the same few calls."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import ClassVar, Protocol

import numpy as np
from _workload import Array, IntArray, Work

#: Standard deviations by which filters may differ after thousands of steps that do the same in another order.
ROUNDING = 1e-7


class MissingError(Exception):
    """What a contender needs is not on this machine."""


class Contender(Protocol):
    """One way to do the work. Making it raises `MissingError` where something that it needs is not there."""

    tolerance: ClassVar[float]  #: how far it may be from slamkit, in standard deviations
    defers: ClassVar[bool]  #: whether it puts work off to later steps, so that only many steps tell what one costs

    grows: ClassVar[bool]  #: whether a step takes the longer the more it has taken before

    def __init__(self, work: Work) -> None: ...

    def start(self) -> None:
        """Go to the end of the survey; not timed."""
        ...

    def ready(self, begin: int, end: int) -> Callable[[], object]:
        """Prepare steps begin … end-1; what is returned takes them, and is timed."""
        ...

    def joint(self, at: IntArray) -> tuple[Array, Array]:
        """State (D,) and the covariance (n, n) of its entries `at`, in the order pose, landmark 0, landmark 1, …."""
        ...


#: Name in tables and figures → module and class; a module is imported only where its contender runs.
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
