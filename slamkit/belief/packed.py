"""The covariance of a large map between flushes: a lower triangle, packed in panels."""

from __future__ import annotations

from typing import Any

from slamkit.compiled import compiled

#: Rows of one panel of the packed triangle: panel p is a matrix (PANEL, PANEL (p + 1)), diagonal blocks are square.
PANEL = 64


def packed_bytes(dim: int) -> int:
    """Bytes of a packed triangle of `dim` rows."""
    panels = -(-dim // PANEL)
    return 4 * PANEL**2 * panels * (panels + 1)


@compiled("index(index, index)")
def packed_index(i: int, j: int) -> Any:
    """Where entry (i, j), i ≥ j, of the packed triangle stands."""
    p = i // PANEL
    return PANEL * (p + 1) * (i - PANEL // 2 * p) + j


@compiled("void(matrix, index, vector)")
def pack(M: Any, n: int, store: Any) -> None:
    """Pack the lower triangle of M (n, n)."""
    for i in range(n):
        row, start = M[i], packed_index(i, 0)
        for j in range(i + 1):
            store[start + j] = row[j]


@compiled("void(vector, matrix)")
def expand(store: Any, M: Any) -> None:
    """First n columns of M (n, lead), symmetric, ← a packed triangle.

    Eight rows of M at a time take what stands above the diagonal.
    """
    n, lead = M.shape
    flat = M.reshape(n * lead)
    for first in range(0, n, PANEL):
        width, last = first + PANEL, min(first + PANEL, n)
        start = packed_index(first, 0)
        panel = store[start : start + PANEL * width]
        for i in range(last - first):
            row, a = M[first + i], panel[i * width :]
            for j in range(first + i + 1):
                row[j] = a[j]
        for left in range(0, first, 8):
            at = left * lead + first
            for i in range(last - first):
                a = panel[i * width + left : i * width + left + 8]
                for j in range(8):
                    flat[at + j * lead + i] = a[j]
        for j in range(first, last):
            for i in range(j + 1, last):
                M[j, i] = panel[(i - first) * width + j]


@compiled("void(vector, index, index)")
def squeeze(store: Any, slot: int, n: int) -> None:
    """Take rows and columns slot, slot + 1 out of a packed triangle of n rows, in place."""
    for i in range(slot + 2, n):
        source, target = packed_index(i, 0), packed_index(i - 2, 0)
        for j in range(slot):
            store[target + j] = store[source + j]
        for j in range(slot + 2, i + 1):
            store[target + j - 2] = store[source + j]
