"""A symmetric matrix in memory that is lent out: whoever reads all of P at every step need not wait for a copy."""

from __future__ import annotations

import weakref
from typing import Any

import numpy as np

from slamkit.arrays import Array
from slamkit.compiled import TILE, aligned


class LentMatrix:
    """Room for a symmetric matrix whose rows start at cache lines.

    Parameters
    ----------
    capacity : int
        Rows and columns, a multiple of 64.

    Attributes
    ----------
    capacity : int
    row_stride : int
        Entries from the start of one row to that of the next: an odd number of cache lines, for the caches keep few
        lines of those that are a power of two apart.
    store : ndarray (capacity · lead,)
        The entries, row after row; zero at first.
    """

    def __init__(self, capacity: int) -> None:
        self.capacity, self.row_stride = capacity, capacity + TILE
        self.store = aligned(capacity * self.row_stride)
        self._address = self.store.ctypes.data
        self._room = np.empty(0)
        self._loans: weakref.WeakSet[_Loan] = weakref.WeakSet()

    def room(self, n: int) -> Array:
        """Memory (n,) to work in, from a cache line on; the same at every call."""
        if len(self._room) < n:
            self._room = aligned(n)
        return self._room[:n]

    @staticmethod
    def bytes(capacity: int) -> int:
        """Bytes of a matrix of that capacity."""
        return 8 * capacity * (capacity + TILE)

    @property
    def lent(self) -> bool:
        """Whether somebody still holds what `lend` gave, or a part of it."""
        return len(self._loans) > 0

    def lend(self, n: int) -> Array:
        """The first n rows and columns, read-only; as long as somebody holds them, nobody may write to the store."""
        loan = _Loan(self.store, self._address, self.row_stride, n)
        self._loans.add(loan)
        return np.asarray(loan)


class _Loan:
    """What every array that shows the matrix holds on to, and nobody else."""

    def __init__(self, store: Array, address: int, lead: int, n: int) -> None:
        self._store = store
        self.__array_interface__: dict[str, Any] = {
            "shape": (n, n),
            "strides": (lead * store.itemsize, store.itemsize),
            "typestr": store.dtype.str,
            "data": (address, True),
            "version": 3,
        }
