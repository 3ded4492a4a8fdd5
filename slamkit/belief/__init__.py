"""The growing Gaussian over a base vector (a pose) and blocks of two (landmarks).

It knows linear algebra and nothing of robots. One triangle of the covariance is kept; no operation forms a dense
transition, observation or I - KH matrix. A small belief is all active. In a large one only what was touched since the
last flush is, and the rest is corrected at the next: `slamkit.belief.kernels` has the equations. Where the whole
covariance is read after every step both triangles are kept, and lent.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Hashable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from math import isqrt
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solve_triangular
from scipy.linalg.blas import dgemm
from scipy.linalg.lapack import dpstrf

from slamkit.belief import kernels
from slamkit.belief.lent import Square
from slamkit.compiled import (
    ACTIVE,
    ACTIVE_THEN,
    COLUMNS,
    CORRECTED,
    LEAD,
    LIMIT,
    MOST,
    ROWS,
    SPENT,
    SPENT_PLAIN,
    STAYS,
    TILE,
    UNROLLED,
    WHOLE,
    WHOLE_THEN,
    State,
    aligned,
)
from slamkit.errors import DivergenceError, InputError, MemoryCapError

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

BASE, BLOCK = 3, 2  #: dimensions of the base that a transition moves, and of one block
PANEL = kernels.PANEL

#: What a multiply-add of a flush costs beside one of a small update, and what a flush costs besides, in the latter.
FLUSH_RATE, FLUSH_START = 0.4, 1e6
#: Landmarks above which a filter postpones corrections unless it is told otherwise.
COMPRESS_ABOVE = 64
#: Steps for which a filter that postponing does not suit does without, before it tries again; and how many of them a
#: copy of P takes away, which is cheaper to read from a filter that postpones.
STAY, READ = 1000.0, 20.0
#: Rows of L⁻¹ H Φ that are kept as they come: they are a root of Ψ, for who reads P after every few steps.
FEW = 32


@dataclass(frozen=True)
class Storage:
    """How a filter keeps a large covariance; nothing here changes what it says.

    Parameters
    ----------
    compress_above : int, optional
        Landmarks above which corrections of what is not in sight are postponed to a flush. None: above 64, unless
        that turns out not to pay, for nearly all of a small map is sighted all the time. A variant whose every update
        moves every landmark never postpones.
    flush_work : float, optional
        Multiply-adds that one step may spend on a flush, which is then spread over as many steps as it needs; None
        does it whole, at once. A core does some 10 to 40 multiply-adds in a nanosecond.
    memory_cap : float, optional
        Bytes that a covariance may take; None: four fifths of the machine's memory.

    Raises
    ------
    InputError
        A number is not positive.
    """

    compress_above: int | None = None
    flush_work: float | None = None
    memory_cap: float | None = None

    def __post_init__(self) -> None:
        for name, value in (("flush_work", self.flush_work), ("memory_cap", self.memory_cap)):
            if value is not None and not value > 0:
                raise InputError(f"{name} is {value!r}, expected None or a number > 0")
        if self.compress_above is not None and not self.compress_above >= 0:
            raise InputError(f"compress_above is {self.compress_above!r}, expected None or a number of landmarks ≥ 0")

    @property
    def limit(self) -> int:
        """Landmarks above which corrections are postponed."""
        return COMPRESS_ABOVE if self.compress_above is None else self.compress_above

    @property
    def cap(self) -> float:
        """Bytes that a covariance may take."""
        return _machine_memory() if self.memory_cap is None else self.memory_cap

    def afford(self, size: int, what: str) -> None:
        """Raise MemoryCapError unless `size` bytes are within the cap."""
        if size > self.cap:
            raise MemoryCapError(
                f"{what} takes {size / 1e9:.3g} GB, the cap is {self.cap / 1e9:.3g} GB: Storage(memory_cap=…) sets it"
            )


class Belief:
    """Mean and covariance of (base, block₁, …, block_N), with an id for each block.

    Parameters
    ----------
    mean : array_like (b,)
        Mean of the base vector, b ≥ 3; a transition moves its first three entries.
    covariance : array_like (b, b)
        Its covariance, symmetric positive semidefinite.
    rows : int
        Rows k of one block's observation, which the workspace is laid out for.
    control_dim : int
        Length m of a control, likewise.
    storage : Storage
        How a large covariance is kept.

    Attributes
    ----------
    base : int
        Length b of the base vector.
    slots : dict
        Id → index of the block's first entry in the mean.
    state : State
        The arrays, shared with compiled code.

    Notes
    -----
    Storage grows geometrically: appending a block costs amortised O(D).
    """

    def __init__(
        self,
        mean: ArrayLike,
        covariance: ArrayLike,
        rows: int = 2,
        control_dim: int = 2,
        storage: Storage | None = None,
    ) -> None:
        self.slots: dict[Hashable, int] = {}
        self.storage = Storage() if storage is None else storage
        self._k, self._m = rows, control_dim
        #: Dimension that the map is known to reach, so that its store need not grow.
        self._expected = 0
        start = np.asarray(mean, dtype=float)
        self.base = b = len(start)
        #: L⁻¹ H P (r, D) of the last update, once the active part no longer holds it.
        self._whole_w: Array | None = None
        #: The store, where it is square, and another that it may change places with; flushes since the last that was
        #: due for another reason than that P was read.
        self._squares: list[Square] = []
        self._reads = 0
        kept = {"mean": start, "points": start, "cov": np.tril(np.asarray(covariance, dtype=float))}
        kept |= {
            "F": np.eye(BASE),
            "memory": np.zeros(6),
            "count": np.zeros(1, dtype=np.int64),
            "size": np.array([b, 0, 0, 0, 0, 0, b, 0, 0, 0, 0], dtype=np.int64),
        }
        kept |= {"owner": np.arange(b), "local": np.arange(b), "work": self._terms()}
        room = b + BLOCK * int(min(8, self.storage.limit))
        self._lay_out(kept, capacity=b + 8 * BLOCK, sightings=8, columns=0, whole=room)

    def _terms(self) -> Array:
        """What `slamkit.cycle.steps.upkeep` goes by."""
        limit = self.base + BLOCK * self.storage.limit
        return np.array([0.0, FLUSH_RATE / 2, FLUSH_START, np.inf, limit, 0.0, 0.0, 0.0])

    def _lay_out(self, kept: dict[str, Any], capacity: int, sightings: int, columns: int, whole: int) -> None:
        """Arrays of the given capacities that hold what is kept."""
        k, m, rows = self._k, self._m, max(self._k * sightings, int(kept["size"][ROWS]), 2)
        D = int(kept["size"][ACTIVE])
        capacity, columns = _vectors(capacity), _vectors(columns)

        def copied(name: str, shape: tuple[int, ...], fill: float = 0.0) -> Any:
            old = kept.get(name, np.zeros((0,) * len(shape)))
            out = aligned(shape, old.dtype)
            if fill:
                out[...] = fill
            part = tuple(slice(0, min(a, b)) for a, b in zip(shape, old.shape, strict=True))
            out[part] = old[part]
            return out

        cov = aligned((capacity, capacity))
        cov[:D, :D] = kept["cov"][:D, :D]
        nothing = np.zeros((0, 0))
        self.state = State(
            mean=copied("mean", (capacity,)),
            cov=cov,
            points=copied("points", (capacity,)),
            memory=kept["memory"],
            size=kept["size"],
            work=kept["work"],
            Phi=copied("Phi", (capacity if columns else 0, columns)),
            minus_Psi=copied("minus_Psi", (columns, columns)),
            theta=copied("theta", (columns,)),
            g=copied("g", (rows, columns)),
            few=copied("few", (FEW, columns)),
            count=kept["count"],
            columns=copied("columns", (columns,)) if "columns" in kept else aligned(columns, np.int64),
            owner=copied("owner", (capacity,)),
            local=copied("local", (whole,), fill=-1),
            rest=kept["rest"] if "rest" in kept else aligned(0),
            rest_points=kept["rest_points"] if "rest_points" in kept else aligned(0),
            store=kept["store"] if "store" in kept else aligned(0),
            V=kept.get("V", nothing),
            pose=aligned(BASE),
            F=copied("F", (BASE, BASE)),
            Q=copied("Q", (BASE, BASE)),
            before=aligned(24),
            G=aligned((BASE, m)),
            sigma_u=aligned((m, m)),
            at=aligned(BASE + BLOCK * sightings),
            slots=aligned(sightings, np.int64),
            order=aligned(sightings, np.int64),
            innovations=aligned((sightings, k)),
            nis=aligned(sightings),
            truth=copied("truth", (sightings, BLOCK)),
            accepted=aligned(sightings, np.bool_),
            saved=aligned(kernels.SMALL * (kernels.SMALL + 4) + 20),
            z=copied("z", (rows,)),
            z_hat=aligned(k),
            y=copied("y", (rows,)),
            effective=aligned(rows),
            H_pose=aligned((rows, BASE)),
            H_landmark=aligned((rows, BLOCK)),
            noise=aligned((rows, k)),
            S=copied("S", (rows, rows)),
            L=copied("L", (rows, rows)),
            w=copied("w", (rows, capacity)),
            t=copied("t", (rows,)),
            dx=aligned(capacity),
            gathered=aligned((BASE + BLOCK, capacity)),
            G_pose=aligned((BLOCK, BASE)),
            G_z=aligned((BLOCK, k)),
            block=aligned((BLOCK, BLOCK)),
        )

    # -- what it holds ------------------------------------------------------------------------------------------------

    @property
    def dim(self) -> int:
        """D = b + 2N."""
        return int(self.state.size[WHOLE])

    @property
    def active(self) -> int:
        """Dimension of the active part: D where nothing rests."""
        return int(self.state.size[ACTIVE])

    @property
    def compressed(self) -> bool:
        """Whether anything may rest."""
        return bool(self.state.size[COLUMNS] > 0)

    @property
    def ids(self) -> tuple[Hashable, ...]:
        """Ids of the blocks in the order of the mean."""
        return tuple(self.slots)

    @property
    def mean(self) -> Array:
        """Mean (D,); a copy, read without a flush."""
        s, D = self.state, self.active
        if not self.compressed:
            return np.array(s.mean[:D])
        out = np.zeros(self.dim)
        out[: len(s.rest)] = s.rest[: self.dim]
        theta = s.theta[: s.size[COLUMNS]]
        resting = np.flatnonzero(s.local[: self.dim] < 0)
        if theta.any():
            out[resting] += self._resting_rows(resting) @ theta
        out[s.owner[:D]] = s.mean[:D]
        return out

    @mean.setter
    def mean(self, value: Array) -> None:
        self.flush()
        self.state.mean[: self.active] = value[: self.active]
        if self.compressed:
            self.state.rest[: self.dim] = value

    def points(self, name: str) -> Array:
        """The array `name`, mean or points, (D,) in the order of the map; a copy."""
        s, D = self.state, self.active
        if name == "mean":
            return self.mean
        out = np.zeros(self.dim)
        if self.compressed:
            out[: len(s.rest_points)] = s.rest_points[: self.dim]
        out[s.owner[:D]] = s.points[:D]
        return out

    @property
    def covariance(self) -> Array:
        """Covariance (D, D), symmetric, after a flush; read-only where it is not a copy."""
        s, D = self.state, self.dim
        if s.size[LEAD]:
            self.flush()
        if s.size[LEAD]:
            return self._squares[0].lend(D)
        self.storage.afford(8 * D * D, f"P of {len(self.slots)} landmarks")
        if not self.compressed:
            s.work[STAYS] = max(0.0, s.work[STAYS] - READ)
            lower: Array = np.tril(s.cov[:D, :D])
            return lower + np.tril(lower, -1).T
        self._reads += self.active > BASE
        self.flush()
        if self._reads > 1 and self.storage.flush_work is None and self._unpack():
            return self._squares[0].lend(D)
        out = np.empty((D, D))
        kernels.expand(self.state.store, out)
        return out

    @covariance.setter
    def covariance(self, value: Array) -> None:
        D = self.dim
        if self.compressed:
            self.flush()
            self._pack()
            kernels.pack(np.ascontiguousarray(value), D, self.state.store)
            D = self.active
        self.state.cov[:D, :D] = np.tril(value[:D, :D])

    # -- room ---------------------------------------------------------------------------------------------------------

    def reserve(self, blocks: int, sightings: int = 1, control_dim: int | None = None, exactly: bool = False) -> None:
        """Make room for this many further blocks, scans of this many sightings, controls of this length."""
        s = self.state
        need, capacity = self.active + BLOCK * blocks, len(s.mean)
        whole, sightings = self.dim + BLOCK * blocks, max(sightings, len(s.nis))
        m = self._m if control_dim is None else control_dim
        if need <= capacity and whole <= len(s.local) and sightings == len(s.nis) and m == self._m:
            return
        if need > capacity:
            capacity = self._capacity(need, need if exactly else self.base + 2 * (need - self.base))
        room = self._room(whole)
        self._m = m
        self._lay_out(s.fields, capacity, sightings, len(s.theta), room)

    def expect(self, blocks: int) -> None:
        """This many further blocks may come: a store that is made from now on has room for them, if the cap allows.

        Memory that is not written to yet is none.
        """
        self._expected = self.dim + BLOCK * blocks

    def widen(self, slots: Indices) -> None:
        """Make room for the blocks at these slots of the map to become active, and for a new one for each slot -1.

        Raises
        ------
        MemoryCapError
            The covariance would pass the cap; nothing has changed.
        """
        s = self.state
        resting = BLOCK * int(np.count_nonzero(s.local[slots[slots >= 0]] < 0))
        new = BLOCK * int(np.count_nonzero(slots < 0))
        need, columns = self.active + resting + new, int(s.size[COLUMNS]) + resting
        capacity = len(s.mean) if need <= len(s.mean) else self._capacity(need, max(need, 3 * len(s.mean) // 2))
        columns = len(s.theta) if columns <= len(s.theta) else max(columns, 3 * len(s.theta) // 2)
        self._lay_out(s.fields, capacity, len(s.nis), columns, self._room(self.dim + new))

    def _capacity(self, need: int, wanted: int) -> int:
        """Active coordinates to make room for: those that are wanted, but within the cap."""
        which, need, wanted = " active" if self.compressed else "", _vectors(need), _vectors(wanted)
        self.storage.afford(8 * need**2, f"the covariance of {(need - self.base) // BLOCK}{which} landmarks")
        return wanted if 8 * wanted**2 <= self.storage.cap else isqrt(int(self.storage.cap / 8)) // 4 * 4

    def _room(self, whole: int) -> int:
        """Coordinates of the map to make room for, so that a map that is to be compressed can be stored, too."""
        have, limit = len(self.state.local), self.state.work[LIMIT]
        if whole <= have:
            return have
        if whole <= limit:
            return max(whole, int(min(3 * whole // 2, limit)))
        self.storage.afford(_packed(whole), f"the covariance of {(whole - self.base) // BLOCK} landmarks")
        return 3 * whole // 2 if _packed(3 * whole // 2) <= self.storage.cap else -(-whole // PANEL) * PANEL

    def register(self, block_id: Hashable, slot: int) -> None:
        """Name the block that compiled code appended at `slot`."""
        self.slots[block_id] = slot

    # -- what rests ---------------------------------------------------------------------------------------------------

    def tend(self) -> None:
        """What a step asks for when it returns `DUE`: begin to compress, begin a flush, or go on with one."""
        with _undisturbed():
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
        """Whether the steps since the last flush and the next one cost more than they do where nothing rests.

        Counted in multiply-adds, which cost the same as long as the caches hold P. A flush of a small map is products
        of small matrices, with as many multiply-adds again for gathering and writing.
        """
        s, C, whole = self.state, int(self.state.size[COLUMNS]), self.dim
        own_choice = self.storage.compress_above is None and self.storage.flush_work is None
        if C == 0 or not own_choice or 8 * whole**2 > min(_cache(), self.storage.cap / 2):
            return False
        flush = C * whole * (whole / 2 + 3 * C) + 3 * FLUSH_START
        return bool(s.work[SPENT] + flush > s.work[SPENT_PLAIN])

    def _unfold(self) -> None:
        """After a flush make everything active, in the order of the map, and let it be so for a while."""
        whole, s = self.dim, self.state
        P, size = np.empty((whole, whole)), s.size.copy()
        kernels.expand(s.store, P)
        size[ACTIVE], size[COLUMNS], size[CORRECTED] = whole, 0, 0
        kept = {n: v for n, v in s.fields.items() if n not in ("rest", "rest_points", "store", "V")}
        kept |= {"size": size, "cov": P, "mean": s.rest[:whole], "points": s.rest_points[:whole]}
        kept |= {"owner": np.arange(whole), "local": np.r_[:whole, s.local[whole:]]}
        self._lay_out(kept, whole, len(s.nis), columns=0, whole=len(s.local))
        self.state.work[STAYS] = STAY

    def flush(self) -> None:
        """Bring everything that rests up to date; then only the base is active. Nothing where nothing rests."""
        if not self.compressed:
            return
        if self.state.size[LEAD] and self.dim <= self._squares[0].capacity:
            if self.active > BASE or not self._rested:
                self._begin_flush()
            return
        with _undisturbed():
            self._pack()
            self._correct_rows(None)
            if self.active > BASE or not self._rested:
                self._begin_flush()
                self._correct_rows(None)

    def _unpack(self) -> bool:
        """Let the store be square, so that P may be read as it stands there; False where there is no room for two."""
        s = self.state
        capacity = min(len(s.rest), -(-6 * self.dim // (5 * PANEL)) * PANEL)
        if 2 * Square.size(capacity) > self.storage.cap:
            return False
        square = Square(capacity)
        kernels.expand(s.store, square.store.reshape(capacity, square.lead)[: self.dim])
        self._squares = [square]
        s.size[LEAD] = square.lead
        s.replace(store=square.store)
        return True

    def _pack(self) -> None:
        """Let the store be a packed triangle: all but reading P at every step goes by that."""
        s = self.state
        if s.size[LEAD]:
            square, store = self._squares[0], np.zeros(_packed(len(s.rest)) // 8)
            stored = square.store.reshape(square.capacity, square.lead)
            kernels.pack(stored, min(self.dim, square.capacity), store)
            self._squares = []
            s.size[LEAD] = 0
            s.replace(store=store)

    def __getstate__(self) -> dict[str, Any]:
        # Copies of a square store would share its memory, or lie across the cache lines.
        self._pack()
        return self.__dict__

    @property
    def _pending(self) -> bool:
        return bool(self.state.V.shape[1])

    @property
    def _Psi(self) -> Array:  # noqa: N802
        """Ψ (C, C), symmetric."""
        C = int(self.state.size[COLUMNS])
        lower: Array = np.tril(-self.state.minus_Psi[:C, :C])
        return lower + np.tril(lower, -1).T

    @property
    def _rested(self) -> bool:
        """Whether the base's rows in the store are as they are now."""
        s = self.state
        base = np.arange(BASE)
        here, now = np.tril(self._entries(base, base)), np.tril(s.cov[:BASE, :BASE])
        still = bool(np.array_equal(s.Phi[:BASE, :BASE], np.eye(BASE)))
        return still and bool(np.array_equal(here, now)) and bool(np.array_equal(s.rest[:BASE], s.mean[:BASE]))

    def _begin_flush(self) -> None:
        """Move what is active, but for the base, to what rests; the correction of the rest is pending then.

        That of a square store is done at once.
        """
        if self.state.size[LEAD]:
            self._flush_square()
            return
        s, D, whole, C = self.state, self.active, self.dim, int(self.state.size[COLUMNS])
        self._grow_store(whole)
        if C == 0:
            self._keep_gain(np.zeros((whole, 0)))
            kernels.pack(s.cov, D, s.store)
            s.rest[:D], s.rest_points[:D] = s.mean[:D], s.points[:D]
        else:
            owner, V = s.owner[:D], np.zeros((-(-whole // PANEL) * PANEL, C))
            kernels.collect(s, V[:whole])
            self._keep_gain(V[:whole])
            moved, cross = V[:whole] @ s.theta[:C], V[:whole] @ s.Phi[:D, :C].T
            V[owner] = 0.0
            V = V @ _half(s, C)[0].T
            # What may want for memory is done; from here on the belief changes.
            s.rest[:whole] += moved
            kernels.deposit(s, cross)
            s.rest[owner], s.rest_points[owner] = s.mean[:D], s.points[:D]
            s.replace(V=V)
            s.size[CORRECTED] = 0
        self._keep_base()

    def _keep_base(self) -> None:
        """What is active has been put down in the store: from now on only the base is."""
        s = self.state
        if len(s.theta) < BASE:
            kept = {**s.fields, "cov": s.cov[:BASE, :BASE]}
            s.local[s.owner[: self.active]] = -1
            kept["size"][ACTIVE] = BASE
            capacity = BASE + 8 * BLOCK * max(4, len(s.nis) // 4)
            self._lay_out(kept, capacity, len(s.nis), capacity, len(s.local))
            s = self.state
        kernels.keep_base(s)
        if self.storage.flush_work is not None:
            # So that the beginning of the next flush is within the work of a step as well.
            s.work[MOST] = max(4 * BASE, np.sqrt(self.storage.flush_work / (6 * self.dim)))

    def _flush_square(self) -> None:
        """A flush of a square store, at once, both triangles: into the same memory, or into other if that is lent."""
        s, C, n = self.state, int(self.state.size[COLUMNS]), -(-self.dim // TILE) * TILE
        rows = int(s.size[ROWS]) if s.size[ACTIVE_THEN] >= 0 else 0
        square = self._squares[0]
        target = square if not square.lent else self._another_square()
        M = np.empty((C, n))
        kernels.collect_rows(s, M)
        added = np.empty(BASE + self.active - C, dtype=np.int64)
        X, rank = _half(s, C, 1 + len(added) + rows)
        kernels.factors(s, rank, X, added)
        W, V, gain = X @ M, target.room(n * rank), np.empty((rows, self.dim))
        # What may want for memory is done; from here on the belief changes.
        if rows:
            self._whole_w = gain  # not asked for before it is filled
        same = target is square
        cached = 8 * n * square.lead * (1 if same else 2) <= _cache()
        if same:
            kernels.flush_square(s, target.store, same, cached, W, V, added, gain)
            return
        with _undisturbed():
            kernels.flush_square(s, target.store, same, cached, W, V, added, gain)
            self._squares = [target, square]
            s.replace(store=target.store)

    def _another_square(self) -> Square:
        """Memory for a square store that nobody holds: two that change places do for who holds one P at a time."""
        free = [square for square in self._squares[1:] if not square.lent]
        return free[0] if free else Square(self._squares[0].capacity)

    def _grow_store(self, whole: int) -> None:
        """Make the store and the vectors beside it as long as the map.

        Two packed triangles, for a moment, are no more than one full matrix; and NumPy gives a new one large pages,
        which halves the time of what goes down a column.
        """
        s = self.state
        need, have = -(-whole // PANEL), len(s.rest) // PANEL
        if need > have:
            self.storage.afford(_packed(whole), f"the covariance of {(whole - self.base) // BLOCK} landmarks")
            panels = max(need, 6 * have // 5, -(-self._expected // PANEL))
            if _packed(PANEL * panels) > self.storage.cap:
                panels = need
            grown = {n: np.zeros(PANEL * panels) for n in ("rest", "rest_points")}
            grown["store"] = np.zeros(PANEL * PANEL * panels * (panels + 1) // 2)
            for name, array in grown.items():
                old = getattr(s, name)
                array[: len(old)] = old
            s.replace(**grown)

    def _correct_rows(self, work: float | None) -> None:
        """P_bb ← P_bb - Mᵀ Ψ M, panel by panel from ``size[CORRECTED]`` on, until the work is spent."""
        s = self.state
        rank, whole = s.V.shape[1], len(s.V)
        if rank == 0:
            return
        spent = 0.0
        while s.size[CORRECTED] < whole and (work is None or spent < work):
            row = int(s.size[CORRECTED])
            width = row + PANEL
            start = kernels.place(row, 0)
            panel = s.store[start : start + PANEL * width].reshape(PANEL, width)
            # BLAS sees the transpose, (width, PANEL) in its own order, and works in place.
            dgemm(-1.0, s.V[:width].T, s.V[row:width].T, 1.0, panel.T, trans_a=True, overwrite_c=True)
            s.size[CORRECTED] = width
            spent += PANEL * width * rank
        if s.size[CORRECTED] >= whole:
            s.replace(V=np.zeros((0, 0)))

    def _entries(self, rows: Indices, columns: Indices) -> Array:
        """P⁰[rows, columns] (…, p, q) of lists (…, p) and (…, q), as the last flush leaves it."""
        s = self.state
        i, j = np.maximum(rows[..., None], columns[..., None, :]), np.minimum(rows[..., None], columns[..., None, :])
        p, lead = i // PANEL, s.size[LEAD]
        out: Array = s.store[lead * i + j if lead else PANEL * (p + 1) * (i - PANEL // 2 * p) + j]
        if self._pending:
            out -= np.where(i >= s.size[CORRECTED], s.V[rows] @ s.V[columns].swapaxes(-1, -2), 0.0)
        return out

    def _resting_rows(self, at: Indices) -> Array:
        """P⁰[at, A₀] (…, C)."""
        s = self.state
        rows = self._entries(at, s.columns[: s.size[COLUMNS]])
        kernels.relate(s, rows.reshape(-1, rows.shape[-1]))
        return rows

    # -- the cycle ----------------------------------------------------------------------------------------------------

    def propagate(self, base: ArrayLike, F: ArrayLike, Q: ArrayLike) -> None:
        """First three of the base ← `base` (3,), P ← F P Fᵀ + Q with F, Q (3, 3) on their rows; O(D)."""
        s = self.state
        s.F[:], s.Q[:] = np.asarray(F, dtype=float), np.asarray(Q, dtype=float)
        s.mean[:BASE] = np.asarray(base, dtype=float)
        kernels.propagate(s)

    def gain(self, H: Array, y: Array, R: Array) -> None:
        """Prepare the update by ``y = H δ + v``, v ~ N(0, R), for a dense H (r, D): dx ← K y; O(r D²).

        Raises
        ------
        DivergenceError
            S = H P Hᵀ + R is not positive definite; nothing has changed.
        """
        PHt = self._times(H.T)
        self.gain_of(PHt, H @ PHt + R, y)

    def _times(self, X: Array) -> Array:
        """P X (D, r); of what rests, panel by panel."""
        if not self.compressed:
            return np.asarray(self.covariance @ X)
        self.flush()
        self._pack()
        D, out = self.dim, np.zeros(X.shape)
        for row in range(0, D, PANEL):
            end = min(row + PANEL, D)
            start = kernels.place(row, 0)
            panel = self.state.store[start : start + PANEL * (row + PANEL)].reshape(PANEL, -1)[: end - row, :end]
            square = np.tril(panel[:, row:])
            out[row:end] += panel[:, :row] @ X[:row] + (square + np.tril(square, -1).T) @ X[row:end]
            out[:row] += panel[:, :row].T @ X[row:end]
        return out

    def gain_of(self, cross: Array, S: Array, y: Array) -> None:
        """Prepare the update from the cross-covariance (D, r) of state and observation, and S (r, r)."""
        try:
            L = np.linalg.cholesky((S + S.T) / 2)
        except np.linalg.LinAlgError:
            raise DivergenceError(f"the innovation covariance S is not positive definite: {S}") from None
        rows, D = len(y), self.dim
        self.reserve(0, sightings=-(-rows // self._k))
        s = self.state
        s.S[:rows, :rows], s.L[:rows, :rows], s.y[:rows] = S, L, y
        w = solve_triangular(L, cross.T, lower=True)
        s.t[:rows] = solve_triangular(L, y, lower=True)
        s.size[ROWS] = rows
        if self.compressed:
            self._whole_w, s.size[ACTIVE_THEN] = w, -1
        else:
            s.w[:rows, :D], s.size[ACTIVE_THEN] = w, D
            s.dx[:D] = w.T @ s.t[:rows]

    def correct(self, retract: Callable[[State], None]) -> None:
        """Carry out the update that `gain` or `gain_of` prepared: P ← P - wᵀw, and `retract` moves the mean."""
        s, rows = self.state, int(self.state.size[ROWS])
        if not self.compressed:
            kernels.downdate(s, rows)
            retract(s)
            return
        self.flush()
        self._pack()
        w = self._whole_w
        assert w is not None
        V = np.zeros((-(-self.dim // PANEL) * PANEL, rows))
        V[: self.dim] = w.T
        dx = w.T @ s.t[:rows]
        with _undisturbed():
            s.replace(V=V)
            s.size[CORRECTED] = 0
            self._correct_rows(None)
            s.rest[: self.dim] += dx
            s.dx[:BASE] = dx[:BASE]
            retract(s)
            s.rest[:BASE] = s.mean[:BASE]
            s.cov[:BASE, :BASE] = self._entries(np.arange(BASE), np.arange(BASE))

    def condition(self, H: ArrayLike, y: ArrayLike, R: ArrayLike) -> None:
        """Update by ``y = H δ + v``, v ~ N(0, R), with a dense H (r, D): x ← x + K y, P ← P - K S Kᵀ."""
        self.gain(np.asarray(H, dtype=float), np.asarray(y, dtype=float), np.asarray(R, dtype=float))
        self.correct(_add)

    @property
    def gain_rows(self) -> Array:
        """L⁻¹ H P (r, D) of the last update, in the order of the map; zero for blocks that came after it."""
        s, rows = self.state, int(self.state.size[ROWS])
        if s.size[ACTIVE_THEN] >= 0:
            M, then = np.zeros((self.dim, int(s.size[COLUMNS]))), s.local[: s.size[WHOLE_THEN]]
            if self.compressed:
                rest = np.flatnonzero((then < 0) | (then >= s.size[ACTIVE_THEN]))
                M[rest] = self._resting_rows(rest)
            return self._gain_rows(M)
        out = np.zeros((rows, self.dim))
        if rows > 0:
            assert self._whole_w is not None
            out[:, : self._whole_w.shape[1]] = self._whole_w
        return out

    def _gain_rows(self, M: Array) -> Array:
        """`gain_rows` from what is active, and from M = P⁰[:, A₀] (D, C) for what was not at the last update."""
        s, rows, D = self.state, int(self.state.size[ROWS]), int(self.state.size[ACTIVE_THEN])
        out = np.asarray(s.g[:rows, : M.shape[1]] @ M.T) if M.shape[1] else np.zeros((rows, len(M)))
        out[:, s.size[WHOLE_THEN] :] = 0.0
        out[:, s.owner[:D]] = s.w[:rows, :D]
        return out

    def _keep_gain(self, M: Array) -> None:
        """Before the active part changes hands: what `gain_rows` would no longer find in it."""
        if self.state.size[ACTIVE_THEN] >= 0 and self.state.size[ROWS] > 0:
            self._whole_w, self.state.size[ACTIVE_THEN] = self._gain_rows(M), -1

    def augment(self, block_id: Hashable, mean: ArrayLike, G: ArrayLike, noise: ArrayLike) -> None:
        """Append a block: P_ls = G P_xs, P_ll = G P_xx Gᵀ + noise, G (2, 3) on the base's first three."""
        if block_id in self.slots:
            raise InputError(f"block {block_id!r} exists already")
        self.reserve(1)
        s, slot, whole = self.state, self.active, self.dim
        s.mean[slot : slot + BLOCK] = np.asarray(mean, dtype=float)
        s.G_pose[:], s.block[:] = np.asarray(G, dtype=float), np.asarray(noise, dtype=float)
        kernels.augment(s, slot)
        self.register(block_id, whole)

    def append(self, mean: Array, cross: Array, block: Array) -> int:
        """Append an unnamed block with its cross-covariance (2, D) to the whole state; its slot. Nothing may rest."""
        self.reserve(1)
        s, slot = self.state, self.dim
        s.mean[slot : slot + BLOCK] = mean
        s.cov[slot : slot + BLOCK, :slot] = cross
        s.cov[slot : slot + BLOCK, slot : slot + BLOCK] = np.tril(block)
        s.owner[slot : slot + BLOCK] = s.local[slot : slot + BLOCK] = slot, slot + 1
        s.size[ACTIVE] += BLOCK
        s.size[WHOLE] += BLOCK
        return slot

    def remove(self, block_id: Hashable) -> None:
        """Marginalise a block out: its rows go, the rest of the Gaussian stays as it is; O(D²)."""
        if block_id not in self.slots:
            raise InputError(f"there is no landmark {block_id!r} in the map of {len(self.slots)}")
        self.flush()
        slot, D, s = self.slots.pop(block_id), self.dim, self.state
        rest = np.r_[0:slot, slot + BLOCK : D]
        if self._whole_w is not None:
            self._whole_w = np.delete(self._whole_w, [i for i in (slot, slot + 1) if i < self._whole_w.shape[1]], 1)
        if self.compressed:
            self._pack()
            kernels.squeeze(s.store, slot, D)
            for vector in (s.rest, s.rest_points):
                vector[: D - BLOCK] = vector[rest]
        else:
            lower = s.cov[np.ix_(rest, rest)]
            s.cov[: D - BLOCK, : D - BLOCK] = lower
            for vector in (s.mean, s.points):
                vector[: D - BLOCK] = vector[rest]
            s.w[:, : D - BLOCK] = s.w[:, rest]
            s.size[ACTIVE] -= BLOCK
            s.local[D - BLOCK : D] = -1
            then = int(s.size[ACTIVE_THEN])
            if then >= 0:
                s.size[ACTIVE_THEN] = min(then, D - BLOCK) if then <= slot else then - BLOCK
        s.size[WHOLE] -= BLOCK
        self.slots = {i: k if k < slot else k - BLOCK for i, k in self.slots.items()}

    # -- reading a part -----------------------------------------------------------------------------------------------

    def indices(self, ids: Iterable[Hashable], base: bool) -> Indices:
        """Indices into the mean: the base first where it is asked for, then each block in the order given."""
        parts = list(range(self.base)) if base else []
        for i in ids:
            if i not in self.slots:
                raise InputError(f"there is no landmark {i!r} in the map of {len(self.slots)}")
            parts += [self.slots[i], self.slots[i] + 1]
        return np.array(parts, dtype=np.int64)

    def marginal(self, ids: Iterable[Hashable], base: bool = False) -> tuple[Array, Array]:
        """Mean (d,) and covariance (d, d) of some blocks, read without forming P and without a flush."""
        at = self.indices(ids, base)
        mean, covariance = self._parts(at[None])
        return mean[0], covariance[0]

    def marginals(self) -> tuple[Array, Array]:
        """Mean (N, 2) and covariance (N, 2, 2) of every block by itself, likewise."""
        slots = np.fromiter(self.slots.values(), dtype=np.int64, count=len(self.slots))
        return self._parts(slots[:, None] + np.arange(BLOCK))

    def _parts(self, at: Indices) -> tuple[Array, Array]:
        """Mean (n, d) and covariance (n, d, d) of n lists (n, d) of coordinates."""
        s = self.state
        if not self.compressed:
            i, j = at[:, :, None], at[:, None, :]
            return s.mean[at], s.cov[np.maximum(i, j), np.minimum(i, j)]
        local, C = s.local[at], int(s.size[COLUMNS])
        resting = local < 0
        # With (Φ_a, 0) for what is active and (c, 1) for what rests: P_ab = P_AA, Φ_a c_b or P⁰_bb - c_aᵀ Ψ c_b.
        rows = np.zeros((*at.shape, C))
        rows[resting] = self._resting_rows(at[resting])
        active = s.Phi[np.maximum(local, 0)][:, :, :C]
        mean = np.where(resting, 0.0, s.mean[np.maximum(local, 0)])
        mean[resting] = s.rest[at[resting]] + rows[resting] @ s.theta[:C]
        both, none = resting[:, :, None] & resting[:, None, :], ~resting[:, :, None] & ~resting[:, None, :]
        out = np.einsum("nac,nbc->nab", np.where(resting[..., None], 0.0, active), rows)
        out += out.transpose(0, 2, 1)
        a, b = np.maximum(local[:, :, None], 0), np.maximum(local[:, None, :], 0)
        a, b = np.broadcast_arrays(a, b)
        out[none] = s.cov[np.maximum(a, b), np.minimum(a, b)][none]
        held = np.where(resting, at, 0)
        out[both] = (self._entries(held, held) - rows @ self._Psi @ rows.transpose(0, 2, 1))[both]
        return mean, out

    def arrays(self) -> dict[str, Array | Indices]:
        """What `take` needs to go on bit for bit, after a flush."""
        self.flush()
        self._pack()
        self._reads = 0
        s, D, rows = self.state, self.active, int(self.state.size[ROWS])
        kept = {
            **{n: getattr(s, n) for n in ("size", "work", "memory", "F", "Q", "rest", "rest_points", "store")},
            **{n: getattr(s, n)[:D] for n in ("mean", "points")},
            **{n: getattr(s, n)[:rows] for n in ("z", "y", "t")},
            **{n: getattr(s, n)[:rows, :rows] for n in ("S", "L")},
        }
        return {**kept, "cov": np.tril(s.cov[:D, :D]), "w": self.gain_rows}

    def take(self, ids: Iterable[Hashable], arrays: dict[str, Any]) -> None:
        """Become the belief that `arrays` describe.

        Raises
        ------
        ValueError
            The arrays do not fit each other or the ids.
        """
        size = np.array(arrays["size"], dtype=np.int64)
        fixed = all(np.shape(arrays[n]) == getattr(self.state, n).shape for n in ("size", "work", "memory"))
        if not fixed or size[LEAD]:
            raise ValueError("size, work or memory of another form")
        self._squares, self._reads = [], 0
        D, whole, C, rows = int(size[ACTIVE]), int(size[WHOLE]), int(size[COLUMNS]), int(size[ROWS])
        self.slots = {i: self.base + BLOCK * n for n, i in enumerate(ids)}
        panels = len(arrays["rest"]) // PANEL
        stored = len(arrays["rest_points"]) == PANEL * panels and len(arrays["store"]) == _packed(PANEL * panels) // 8
        resting = C == BASE == D and PANEL * panels >= whole and stored
        if self.base + BLOCK * len(self.slots) != whole or not (resting or (C == 0 and whole == D)):
            raise ValueError(f"{len(self.slots)} landmark ids and a state of {whole}")
        self._whole_w, size[ACTIVE_THEN] = np.array(arrays["w"], dtype=float), -1
        kept: dict[str, Any] = {n: np.array(v) for n, v in arrays.items() if n != "w"} | {
            "size": size,
            "count": np.zeros(1, dtype=np.int64),
        }
        local = np.full(whole, -1, dtype=np.int64)
        local[:D] = kept["owner"] = np.arange(D)
        if C:
            kept |= {"Phi": np.eye(BASE), "minus_Psi": np.zeros((BASE, BASE)), "columns": np.arange(BASE)}
        room = BASE + 8 * BLOCK
        sightings = max(8, -(-rows // self._k))
        self._lay_out({**kept, "local": local}, max(D, room), sightings, room if C else 0, whole)

    def snapshot(self) -> dict[str, Any]:
        """Everything that `restore` needs to bring the belief back to the bit, unless it is flushed meanwhile."""
        D = self.active
        fixed = ("cov", "gathered", "dx", "saved", "store", "rest", "rest_points", "V")
        whole = {n: np.array(v) for n, v in self.state.fields.items() if n not in fixed}
        return {**whole, "cov": np.array(self.state.cov[:D, :D]), "slots": dict(self.slots), "gain": self._whole_w}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Undo everything since `snapshot`."""
        D = int(snapshot["size"][ACTIVE])
        self.slots, self._whole_w = dict(snapshot["slots"]), snapshot["gain"]
        for name, old in snapshot.items():
            if name in ("cov", "slots", "gain"):
                continue
            new = getattr(self.state, name)
            new[tuple(slice(0, n) for n in old.shape)] = old
        self.state.cov[:D, :D] = snapshot["cov"]


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Within the block Ctrl-C waits: a flush takes seconds at times, and half of one is no covariance."""
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


@cache
def _machine_memory() -> float:
    """Four fifths of the machine's memory [bytes]."""
    return 0.8 * os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


@cache
def _cache() -> float:
    """Half of the machine's largest cache [bytes]; a usual one where the system (other than Linux) does not say."""
    sizes = [path.read_text().strip() for path in Path("/sys/devices/system/cpu/cpu0/cache").glob("index*/size")]
    found = [int(size[:-1]) for size in sizes if size[:-1].isdecimal() and size[-1] == "K"]
    return 512.0 * max(found, default=16384)


def _vectors(n: int) -> int:
    """The least multiple of four ≥ n: compiled code works on whole vectors of four numbers."""
    return -(-n // 4) * 4


def _half(state: State, C: int, further: int = 0) -> tuple[Array, int]:
    """B (r, C) with BᵀB = Ψ (C, C) over further rows of zeros, and r, a multiple of UNROLLED no less than Ψ's rank."""
    count = int(state.count[0])
    if 0 <= count <= C:
        padded = -(-count // UNROLLED) * UNROLLED
        B = np.zeros((padded + further, C))
        B[:count] = state.few[:count, :C]
        return B, padded
    A, scale = np.empty((C, C)), np.empty(C)
    kernels.scaled(state, A, scale)
    # LAPACK sees the transpose, in its own order, and works in place.
    _, order, rank, _ = dpstrf(A.T, lower=0, overwrite_a=1)
    padded = -(-rank // UNROLLED) * UNROLLED
    B = np.zeros((padded + further, C))
    kernels.unscaled(A, rank, order.astype(np.int64), scale, B)
    return B, padded


def _packed(dim: int) -> int:
    """Bytes of a packed triangle."""
    panels = -(-dim // PANEL)
    return 4 * PANEL**2 * panels * (panels + 1)


def _add(state: State) -> None:
    D = state.size[ACTIVE]
    state.mean[:D] += state.dx[:D]
