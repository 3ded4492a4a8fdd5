"""The arrays of a belief, and how they grow."""

from __future__ import annotations

from collections.abc import Hashable
from math import isqrt
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from slamkit.arrays import Indices
from slamkit.belief.layout import BASE, BLOCK, FIELDS, STATE
from slamkit.belief.packed import PANEL, packed_bytes
from slamkit.belief.rollback import LAST, SMALL
from slamkit.belief.storage import Storage
from slamkit.compiled import OwnFields, Shared, aligned

#: Cost of a multiply-add of a flush relative to one of a small update, and the fixed cost of a flush in the latter.
FLUSH_RATE, FLUSH_START = 0.4, 1e6


class Room:
    """The state that a belief shares with compiled code, and room for it.

    Storage grows geometrically: appending a block costs amortised O(D).
    """

    def __init__(
        self, mean: ArrayLike, covariance: ArrayLike, rows: int, control_dim: int, storage: Storage, own: OwnFields
    ) -> None:
        self.slots: dict[Hashable, int] = {}
        self.storage, self.own_fields = storage, own
        self._k, self._m = rows, control_dim
        #: Dimension that the map is known to reach, so that its store need not grow.
        self._expected = 0
        start = np.asarray(mean, dtype=float)
        self.base = b = len(start)
        cov = np.tril(np.asarray(covariance, dtype=float))
        kept: dict[str, Any] = {
            "belief": {"active": b, "dim": b, "mean": start, "linearised_at": start, "cov": cov},
            "resting": self._flush_prices(),
            "last": {"F": np.eye(BASE)},
            "scratch": {},
        }
        kept["belief"] |= {"owner": np.arange(b), "local": np.arange(b)}
        self._lay_out(kept, capacity=b + 8 * BLOCK, sightings=8, columns=0, room=b + BLOCK * int(min(8, storage.limit)))

    def _flush_prices(self) -> dict[str, float]:
        """What decides when to flush, see `slamkit.cycle.upkeep`."""
        limit = float(self.base + BLOCK * self.storage.limit)
        return {
            "price_per_square": FLUSH_RATE / 2, "fixed_price": FLUSH_START, "most_columns": np.inf, "limit": limit,
        }  # fmt: skip

    def _lay_out(self, kept: dict[str, Any], capacity: int, sightings: int, columns: int, room: int) -> None:
        """Make arrays of the given capacities that hold what is kept, a value for each field of each part."""
        k, D = self._k, int(kept["belief"]["active"])
        capacity, columns = whole_vectors(capacity), whole_vectors(columns)
        own = self.own_fields.size(sightings)
        lengths = {
            "capacity": capacity, "columns": columns, "sightings": sightings, "map": room, "k": k, "m": self._m,
            "rows": max(k * sightings, int(kept["last"].get("rows", 0)), 2), "point": BASE + BLOCK * sightings,
            "own": own, "saved": LAST + SMALL * (SMALL + 4) + own,
        }  # fmt: skip
        values: dict[str, Any] = {"own": aligned(own)}
        if "own" in kept:
            held = min(own, len(kept["own"]))
            values["own"][:held] = kept["own"][:held]
        for part, fields in FIELDS.items():
            values[part] = {}
            for name, field in fields.items():
                old = kept[part].get(name)
                if field.kind in ("index", "real", "flag"):
                    values[part][name] = 0 if old is None else old
                elif not field.shape:
                    ndim = 2 if field.kind == "matrix" else 1
                    values[part][name] = aligned((0,) * ndim) if old is None else old
                else:
                    shape = tuple(lengths[n] if isinstance(n, str) else n for n in field.shape)
                    kind = {"integers": np.int64, "flags": np.bool_}.get(field.kind, np.float64)
                    new = aligned(shape, kind)
                    if field.fill:
                        new[...] = field.fill
                    if field.kept and old is not None:
                        if name == "cov":
                            old = old[:D, :D]
                        both = tuple(slice(0, min(a, b)) for a, b in zip(shape, old.shape, strict=True))
                        new[both] = old[both]
                    values[part][name] = new
        self.state = Shared(STATE, **values)

    @property
    def dim(self) -> int:
        """D = b + 2N."""
        return self.state.belief.dim  # type: ignore[no-any-return]

    @property
    def active(self) -> int:
        """Dimension of the active part: D where nothing rests."""
        return self.state.belief.active  # type: ignore[no-any-return]

    @property
    def compressed(self) -> bool:
        """Whether anything may rest."""
        return bool(self.state.resting.columns > 0)

    @property
    def _sightings(self) -> int:
        return len(self.state.scratch.nis)

    def reserve(self, blocks: int, sightings: int = 1, control_dim: int | None = None, exactly: bool = False) -> None:
        """Make room for this many further blocks, scans of this many sightings, controls of this length."""
        s = self.state
        need, capacity = self.active + BLOCK * blocks, len(s.belief.mean)
        whole, sightings = self.dim + BLOCK * blocks, max(sightings, self._sightings)
        m = self._m if control_dim is None else control_dim
        if need <= capacity and whole <= len(s.belief.local) and sightings == self._sightings and m == self._m:
            return
        if need > capacity:
            capacity = self._affordable(need, need if exactly else self.base + 2 * (need - self.base))
        room = self._map_room(whole)
        self._m = m
        self._lay_out(s.values, capacity, sightings, len(s.resting.theta), room)

    def hint_final_size(self, blocks: int) -> None:
        """Say how many further blocks may come: a store made from now on has room for them, if the cap allows.

        Memory that is not written to yet is none.
        """
        self._expected = self.dim + BLOCK * blocks

    def grow_for(self, slots: Indices) -> None:
        """Make room for the blocks at these slots of the map to become active, and for a new one for each slot -1.

        Raises
        ------
        MemoryCapError
            The covariance would pass the cap; nothing has changed.
        """
        s = self.state
        resting = BLOCK * int(np.count_nonzero(s.belief.local[slots[slots >= 0]] < 0))
        new = BLOCK * int(np.count_nonzero(slots < 0))
        need, columns = self.active + resting + new, int(s.resting.columns) + resting
        capacity = (
            len(s.belief.mean)
            if need <= len(s.belief.mean)
            else self._affordable(need, max(need, 3 * len(s.belief.mean) // 2))
        )
        columns = (
            len(s.resting.theta) if columns <= len(s.resting.theta) else max(columns, 3 * len(s.resting.theta) // 2)
        )
        self._lay_out(s.values, capacity, self._sightings, columns, self._map_room(self.dim + new))

    def _affordable(self, need: int, wanted: int) -> int:
        """Active coordinates to make room for: as many as wanted, but within the cap."""
        which, need, wanted = " active" if self.compressed else "", whole_vectors(need), whole_vectors(wanted)
        self.storage.afford(8 * need**2, f"the covariance of {(need - self.base) // BLOCK}{which} landmarks")
        return wanted if 8 * wanted**2 <= self.storage.cap else isqrt(int(self.storage.cap / 8)) // 4 * 4

    def _map_room(self, whole: int) -> int:
        """Coordinates of the map to make room for, including what the store of a compressed map needs."""
        have, limit = len(self.state.belief.local), self.state.resting.limit
        if whole <= have:
            return have
        if whole <= limit:
            return max(whole, int(min(3 * whole // 2, limit)))
        self.storage.afford(packed_bytes(whole), f"the covariance of {(whole - self.base) // BLOCK} landmarks")
        return 3 * whole // 2 if packed_bytes(3 * whole // 2) <= self.storage.cap else -(-whole // PANEL) * PANEL

    def register(self, block_id: Hashable, slot: int) -> None:
        """Name the block that compiled code appended at `slot`."""
        self.slots[block_id] = slot


def whole_vectors(n: int) -> int:
    """The least multiple of four ≥ n: compiled code works on whole vectors of four numbers."""
    return -(-n // 4) * 4
