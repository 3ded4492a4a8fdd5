"""A symmetric matrix whose memory is lent to its readers: reading all of P after every step costs no copy."""

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
        """Working memory (n,) that starts at a cache line; the same at every call."""
        if len(self._room) < n:
            self._room = aligned(n)
        return self._room[:n]

    @staticmethod
    def bytes(capacity: int) -> int:
        """Bytes of a matrix of that capacity."""
        return 8 * capacity * (capacity + TILE)

    @property
    def lent(self) -> bool:
        """Whether a reader still holds what `lend` gave, or a part of it."""
        return len(self._loans) > 0

    def lend(self, n: int) -> Array:
        """The first n rows and columns, read-only. The store must not be written to while a reader holds them."""
        loan = _Loan(self.store, self._address, self.row_stride, n)
        self._loans.add(loan)
        return np.asarray(loan)


class _Loan:
    """The object that keeps the memory alive. Every array that shows the matrix refers to it, and nothing else does."""

    def __init__(self, store: Array, address: int, lead: int, n: int) -> None:
        self._store = store
        self.__array_interface__: dict[str, Any] = {
            "shape": (n, n),
            "strides": (lead * store.itemsize, store.itemsize),
            "typestr": store.dtype.str,
            "data": (address, True),
            "version": 3,
        }
