"""The part of a large map that rests: its covariance is corrected only at a flush, exactly.

A small belief is all active. In a large one only landmarks seen since the last flush are active; the others are updated
at the next flush (Guivant & Nebot, IEEE TRA 17(3):242-257, 2001, with an active set that grows).

The covariance as of the last flush is P⁰, in ``state.resting.store``. Every correction since then is kept in small
matrices. Let A be what is active, A₀ the C = ``state.resting.columns`` coordinates that rested at the flush and are
active now, b the coordinates that still rest, and M = P⁰[A₀, b]. Then

    P_Ab = Φ M,    P_bb = P⁰_bb - Mᵀ Ψ M,    x_b = x⁰_b + Mᵀ ϑ.

A landmark l of A₀ is expressed as l - p - J (l - p) θ at the means of the flush, relative to the pose (p, θ). The
uncertainty of the frame itself is large and common to l and the pose; that of the map is small. In coordinates of the
map Ψ, ϑ and Φ would form small numbers as differences of large ones, and lose three digits over a long drive.

C = 0 where nothing rests. Then all of this is empty, and the active part is everything, in the order of the map.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

import numpy as np
from scipy.linalg.blas import dgemm
from scipy.linalg.lapack import dpstrf

from slamkit.arrays import Array, Indices
from slamkit.belief.active import to_map_coordinates
from slamkit.belief.flush import keep_base_only, rows_at_flush, scaled, unscaled, write_active
from slamkit.belief.layout import BASE, BLOCK
from slamkit.belief.lent import LentMatrix
from slamkit.belief.packed import PANEL, expand, pack, packed_bytes, packed_index
from slamkit.belief.room import FLUSH_START, Room
from slamkit.belief.square import flush_factors, flush_square, rows_at_flush_square
from slamkit.belief.storage import half_of_cache
from slamkit.compiled import TILE, UNROLLED

#: Steps for which a filter that does not profit from deferring does without, before it tries again; and how many of
#: them a copy of P takes away, which is cheaper to read from a filter that defers.
STAY, READ = 1000.0, 20.0


class Compressed(Room):
    """A belief in which landmarks may rest."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        #: L⁻¹ H P (r, D) of the last update, once the active part no longer holds it.
        self._whole_w: Array | None = None
        #: The store, where it is square, and another that it may change places with.
        self._squares: list[LentMatrix] = []
        #: Flushes since the last that was due for another reason than that P was read.
        self._reads = 0

    def flush_if_due(self) -> None:
        """What a step asks for when it returns `Status.DUE`: begin to compress, begin a flush, or go on with one."""
        with undisturbed():
            if self._pending:
                self._correct_rows(self.storage.flush_work)
            else:
                self._pack()
                self._reads, plain = 0, self._plain_is_cheaper
                self._begin_flush()
                if self.storage.flush_work is None:
                    self._correct_rows(None)
                if plain:
                    self._unfold()

    @property
    def _plain_is_cheaper(self) -> bool:
        """Whether the steps since the last flush, and the next flush, cost more than steps in which nothing rests.

        Counted in multiply-adds, which cost the same as long as the caches hold P. A flush of a small map is products
        of small matrices, with as many multiply-adds again for gathering and writing.
        """
        s, C, whole = self.state, int(self.state.resting.columns), self.dim
        own_choice = self.storage.compress_above is None and self.storage.flush_work is None
        if C == 0 or not own_choice or 8 * whole**2 > min(half_of_cache(), self.storage.cap / 2):
            return False
        flush = C * whole * (whole / 2 + 3 * C) + 3 * FLUSH_START
        return bool(s.resting.spent + flush > s.resting.spent_plain)

    def _unfold(self) -> None:
        """After a flush make everything active, in the order of the map, for `STAY` steps."""
        whole, s = self.dim, self.state
        P, kept = np.empty((whole, whole)), s.values
        expand(s.resting.store, P)
        resting = kept["resting"]
        kept["belief"] |= {"active": whole, "cov": P, "mean": resting["mean"][:whole]}
        kept["belief"] |= {"linearised_at": resting["linearised_at"][:whole], "owner": np.arange(whole)}
        kept["belief"] |= {"local": np.r_[:whole, s.belief.local[whole:]]}
        for name in ("mean", "linearised_at", "store", "V"):
            del resting[name]
        resting |= {"columns": 0, "corrected": 0}
        self._lay_out(kept, whole, self._sightings, columns=0, room=len(s.belief.local))
        self.state.resting.stays = STAY

    def flush(self) -> None:
        """Update every resting landmark; then only the base is active. Without resting landmarks it does nothing."""
        if not self.compressed:
            return
        if self.state.resting.row_stride and self.dim <= self._squares[0].capacity:
            if self.active > BASE or not self._rested:
                self._begin_flush()
            return
        with undisturbed():
            self._pack()
            self._correct_rows(None)
            if self.active > BASE or not self._rested:
                self._begin_flush()
                self._correct_rows(None)

    def _unpack(self) -> bool:
        """Make the store square, so that P can be read from it directly. False if there is no room for two stores."""
        s = self.state
        capacity = min(len(s.resting.mean), -(-6 * self.dim // (5 * PANEL)) * PANEL)
        if 2 * LentMatrix.bytes(capacity) > self.storage.cap:
            return False
        square = LentMatrix(capacity)
        expand(s.resting.store, square.store.reshape(capacity, square.row_stride)[: self.dim])
        self._squares = [square]
        s.resting.row_stride = square.row_stride
        s.resting.store = square.store
        return True

    def _pack(self) -> None:
        """Make the store a packed triangle, which everything but reading P at every step uses."""
        s = self.state
        if s.resting.row_stride:
            square, store = self._squares[0], np.zeros(packed_bytes(len(s.resting.mean)) // 8)
            stored = square.store.reshape(square.capacity, square.row_stride)
            pack(stored, min(self.dim, square.capacity), store)
            self._squares = []
            s.resting.row_stride = 0
            s.resting.store = store

    def __getstate__(self) -> dict[str, Any]:
        # Copies of a square store would share its memory, or lie across the cache lines.
        self._pack()
        return self.__dict__

    @property
    def _pending(self) -> bool:
        return bool(self.state.resting.V.shape[1])

    @property
    def _Psi(self) -> Array:  # noqa: N802
        """Ψ (C, C), symmetric."""
        C = int(self.state.resting.columns)
        lower: Array = np.tril(-self.state.resting.minus_Psi[:C, :C])
        return lower + np.tril(lower, -1).T

    @property
    def _rested(self) -> bool:
        """Whether the base's rows in the store are as they are now."""
        s = self.state
        base = np.arange(BASE)
        here, now = np.tril(self._entries(base, base)), np.tril(s.belief.cov[:BASE, :BASE])
        still = bool(np.array_equal(s.resting.Phi[:BASE, :BASE], np.eye(BASE)))
        return (
            still
            and bool(np.array_equal(here, now))
            and bool(np.array_equal(s.resting.mean[:BASE], s.belief.mean[:BASE]))
        )

    def _begin_flush(self) -> None:
        """Move everything active, except the base, to the part that rests. Its correction is then pending.

        That of a square store is done at once.
        """
        if self.state.resting.row_stride:
            self._flush_square()
            return
        s, D, whole, C = self.state, self.active, self.dim, int(self.state.resting.columns)
        self._grow_store(whole)
        if C == 0:
            self._keep_gain(np.zeros((whole, 0)))
            pack(s.belief.cov, D, s.resting.store)
            s.resting.mean[:D], s.resting.linearised_at[:D] = s.belief.mean[:D], s.belief.linearised_at[:D]
        else:
            owner, V = s.belief.owner[:D], np.zeros((-(-whole // PANEL) * PANEL, C))
            rows_at_flush(s, V[:whole])
            self._keep_gain(V[:whole])
            moved, cross = V[:whole] @ s.resting.theta[:C], V[:whole] @ s.resting.Phi[:D, :C].T
            V[owner] = 0.0
            V = V @ _half(s, C)[0].T
            # Everything that allocates memory is done; from here on the belief changes.
            s.resting.mean[:whole] += moved
            write_active(s, cross)
            s.resting.mean[owner], s.resting.linearised_at[owner] = s.belief.mean[:D], s.belief.linearised_at[:D]
            s.resting.V = V
            s.resting.corrected = 0
        self._keep_base()

    def _keep_base(self) -> None:
        """Everything active has been written to the store: from now on only the base is active."""
        s = self.state
        if len(s.resting.theta) < BASE:
            kept = s.values
            s.belief.local[s.belief.owner[: self.active]] = -1
            kept["belief"]["active"] = BASE
            capacity = BASE + 8 * BLOCK * max(4, self._sightings // 4)
            self._lay_out(kept, capacity, self._sightings, capacity, len(s.belief.local))
            s = self.state
        keep_base_only(s)
        if self.storage.flush_work is not None:
            # So that the beginning of the next flush is within the work of a step as well.
            s.resting.most_columns = max(4 * BASE, np.sqrt(self.storage.flush_work / (6 * self.dim)))

    def _flush_square(self) -> None:
        """Flush a square store at once, both triangles: in place, or into other memory if the store is lent."""
        s, C, n = self.state, int(self.state.resting.columns), -(-self.dim // TILE) * TILE
        rows = int(s.last.rows) if s.last.active >= 0 else 0
        square = self._squares[0]
        target = square if not square.lent else self._another_square()
        M = np.empty((C, n))
        rows_at_flush_square(s, M)
        added = np.empty(BASE + self.active - C, dtype=np.int64)
        X, rank = _half(s, C, 1 + len(added) + rows)
        flush_factors(s, rank, X, added)
        W, V, gain = X @ M, target.room(n * rank), np.empty((rows, self.dim))
        # Everything that allocates memory is done; from here on the belief changes.
        if rows:
            self._whole_w = gain  # not asked for before it is filled
        same = target is square
        cached = 8 * n * square.row_stride * (1 if same else 2) <= half_of_cache()
        if same:
            flush_square(s, target.store, same, cached, W, V, added, gain)
            return
        with undisturbed():
            flush_square(s, target.store, same, cached, W, V, added, gain)
            self._squares = [target, square]
            s.resting.store = target.store

    def _another_square(self) -> LentMatrix:
        """Memory for a square store that no reader holds. Two suffice for a reader that holds one P at a time."""
        free = [square for square in self._squares[1:] if not square.lent]
        return free[0] if free else LentMatrix(self._squares[0].capacity)

    def _grow_store(self, whole: int) -> None:
        """Make the store and the vectors beside it as long as the map.

        Two packed triangles, for a moment, are no more than one full matrix; and NumPy gives a new one large pages,
        which halves the time of what goes down a column.
        """
        s = self.state
        need, have = -(-whole // PANEL), len(s.resting.mean) // PANEL
        if need > have:
            self.storage.afford(packed_bytes(whole), f"the covariance of {(whole - self.base) // BLOCK} landmarks")
            panels = max(need, 6 * have // 5, -(-self._expected // PANEL))
            if packed_bytes(PANEL * panels) > self.storage.cap:
                panels = need
            grown = {n: np.zeros(PANEL * panels) for n in ("mean", "linearised_at")}
            grown["store"] = np.zeros(PANEL * PANEL * panels * (panels + 1) // 2)
            for name, array in grown.items():
                old = getattr(s.resting, name)
                array[: len(old)] = old
            for name, array in grown.items():
                setattr(s.resting, name, array)

    def _gain_rows(self, M: Array) -> Array:
        """`gain_rows` from what is active, and from M = P⁰[:, A₀] (D, C) for what was not at the last update."""
        s, rows, D = self.state, int(self.state.last.rows), int(self.state.last.active)
        out = np.asarray(s.last.g[:rows, : M.shape[1]] @ M.T) if M.shape[1] else np.zeros((rows, len(M)))
        out[:, s.last.dim :] = 0.0
        out[:, s.belief.owner[:D]] = s.last.w[:rows, :D]
        return out

    def _keep_gain(self, M: Array) -> None:
        """Save what `gain_rows` needs before the active part changes."""
        if self.state.last.active >= 0 and self.state.last.rows > 0:
            self._whole_w, self.state.last.active = self._gain_rows(M), -1

    def _correct_rows(self, work: float | None) -> None:
        """P_bb ← P_bb - Mᵀ Ψ M, panel by panel from ``state.resting.corrected`` on, until the work is spent."""
        s = self.state
        rank, whole = s.resting.V.shape[1], len(s.resting.V)
        if rank == 0:
            return
        spent = 0.0
        while s.resting.corrected < whole and (work is None or spent < work):
            row = int(s.resting.corrected)
            width = row + PANEL
            start = packed_index(row, 0)
            panel = s.resting.store[start : start + PANEL * width].reshape(PANEL, width)
            # BLAS sees the transpose, (width, PANEL) in its own order, and works in place.
            dgemm(-1.0, s.resting.V[:width].T, s.resting.V[row:width].T, 1.0, panel.T, trans_a=True, overwrite_c=True)
            s.resting.corrected = width
            spent += PANEL * width * rank
        if s.resting.corrected >= whole:
            s.resting.V = np.zeros((0, 0))

    def _entries(self, rows: Indices, columns: Indices) -> Array:
        """P⁰[rows, columns] (…, p, q) of lists (…, p) and (…, q), as the last flush leaves it."""
        s = self.state
        i, j = np.maximum(rows[..., None], columns[..., None, :]), np.minimum(rows[..., None], columns[..., None, :])
        p, lead = i // PANEL, s.resting.row_stride
        out: Array = s.resting.store[lead * i + j if lead else PANEL * (p + 1) * (i - PANEL // 2 * p) + j]
        if self._pending:
            out -= np.where(i >= s.resting.corrected, s.resting.V[rows] @ s.resting.V[columns].swapaxes(-1, -2), 0.0)
        return out

    def _resting_rows(self, at: Indices) -> Array:
        """P⁰[at, A₀] (…, C)."""
        s = self.state
        rows = self._entries(at, s.resting.activated[: s.resting.columns])
        to_map_coordinates(s, rows.reshape(-1, rows.shape[-1]))
        return rows


@contextmanager
def undisturbed() -> Iterator[None]:
    """Defer Ctrl-C within the block. A flush can take seconds, and half a flush leaves no valid covariance."""
    ours = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(ours):
        yield
        return
    heard: list[tuple[int, FrameType | None]] = []
    signal.signal(signal.SIGINT, lambda *interrupt: heard.append(interrupt))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, ours)
        if heard:
            ours(*heard[0])


def _half(state: Any, C: int, further: int = 0) -> tuple[Array, int]:
    """B (r, C) with BᵀB = Ψ (C, C) over further rows of zeros, and r, a multiple of UNROLLED no less than Ψ's rank."""
    count = state.resting.root_row_count
    if 0 <= count <= C:
        padded = -(-count // UNROLLED) * UNROLLED
        B = np.zeros((padded + further, C))
        B[:count] = state.resting.root_rows[:count, :C]
        return B, padded
    A, scale = np.empty((C, C)), np.empty(C)
    scaled(state, A, scale)
    # LAPACK sees the transpose, in its own order, and works in place.
    _, order, rank, _ = dpstrf(A.T, lower=0, overwrite_a=1)
    padded = -(-rank // UNROLLED) * UNROLLED
    B = np.zeros((padded + further, C))
    unscaled(A, rank, order.astype(np.int64), scale, B)
    return B, padded
