"""The growing Gaussian over a base vector (a pose) and blocks of two (landmarks).

It knows linear algebra and nothing of robots. One triangle of the covariance is kept; no operation forms a dense
transition, observation or I - KH matrix. Where the whole covariance is read after every step, both triangles are kept
and lent to the reader.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_triangular

from slamkit.arrays import Array, Indices
from slamkit.belief import dense
from slamkit.belief.compressed import READ, Compressed, undisturbed
from slamkit.belief.layout import BASE, BLOCK, FIELDS
from slamkit.belief.packed import PANEL, expand, pack, packed_index, squeeze
from slamkit.belief.storage import Storage
from slamkit.compiled import OwnFields
from slamkit.errors import DivergenceError, InputError


class Belief(Compressed):
    """Mean and covariance of (base, block₁, …, block_N), with an id for each block.

    Parameters
    ----------
    mean : array_like (b,)
        Mean of the base vector, b ≥ 3; a transition moves its first three entries.
    covariance : array_like (b, b)
        Its covariance, symmetric positive semidefinite.
    rows : int
        Rows k of one block's observation, for which the workspace is laid out.
    control_dim : int
        Length m of a control, for which it is laid out too.
    storage : Storage
        How a large covariance is kept.
    own_fields : OwnFields
        Further numbers that are kept, copied and undone with the belief.

    Attributes
    ----------
    base : int
        Length b of the base vector.
    slots : dict
        Id → index of the block's first entry in the mean.
    state : Shared
        The arrays, shared with compiled code; :mod:`slamkit.belief.layout` lists them.
    """

    def __init__(
        self,
        mean: ArrayLike,
        covariance: ArrayLike,
        rows: int = 2,
        control_dim: int = 2,
        storage: Storage | None = None,
        own_fields: OwnFields | None = None,
    ) -> None:
        storage = Storage() if storage is None else storage
        super().__init__(mean, covariance, rows, control_dim, storage, own_fields or OwnFields())

    @property
    def ids(self) -> tuple[Hashable, ...]:
        """Ids of the blocks in the order of the mean."""
        return tuple(self.slots)

    @property
    def mean(self) -> Array:
        """Mean (D,); a copy, read without a flush."""
        s, D = self.state, self.active
        if not self.compressed:
            return np.array(s.belief.mean[:D])
        out = np.zeros(self.dim)
        out[: len(s.resting.mean)] = s.resting.mean[: self.dim]
        theta = s.resting.theta[: s.resting.columns]
        resting = np.flatnonzero(s.belief.local[: self.dim] < 0)
        if theta.any():
            out[resting] += self._resting_rows(resting) @ theta
        out[s.belief.owner[:D]] = s.belief.mean[:D]
        return out

    @mean.setter
    def mean(self, value: Array) -> None:
        self.flush()
        self.state.belief.mean[: self.active] = value[: self.active]
        if self.compressed:
            self.state.resting.mean[: self.dim] = value

    def linearisation_points(self, name: str) -> Array:
        """The array `name`, mean or linearised_at, (D,) in the order of the map; a copy."""
        s, D = self.state, self.active
        if name == "mean":
            return self.mean
        out = np.zeros(self.dim)
        if self.compressed:
            out[: len(s.resting.linearised_at)] = s.resting.linearised_at[: self.dim]
        out[s.belief.owner[:D]] = s.belief.linearised_at[:D]
        return out

    @property
    def covariance(self) -> Array:
        """Covariance (D, D), symmetric, after a flush. A read-only view where that saves a copy."""
        s, D = self.state, self.dim
        if s.resting.row_stride:
            self.flush()
        if s.resting.row_stride:
            return self._squares[0].lend(D)
        self.storage.afford(8 * D * D, f"P of {len(self.slots)} landmarks")
        if not self.compressed:
            s.resting.stays = max(0.0, s.resting.stays - READ)
            lower: Array = np.tril(s.belief.cov[:D, :D])
            return lower + np.tril(lower, -1).T
        self._reads += self.active > BASE
        self.flush()
        if self._reads > 1 and self.storage.flush_work is None and self._unpack():
            return self._squares[0].lend(D)
        out = np.empty((D, D))
        expand(self.state.resting.store, out)
        return out

    @covariance.setter
    def covariance(self, value: Array) -> None:
        D = self.dim
        if self.compressed:
            self.flush()
            self._pack()
            pack(np.ascontiguousarray(value), D, self.state.resting.store)
            D = self.active
        self.state.belief.cov[:D, :D] = np.tril(value[:D, :D])

    def register(self, block_id: Hashable, slot: int) -> None:
        """Name the block that compiled code appended at `slot`."""
        self.slots[block_id] = slot

    # -- the cycle ----------------------------------------------------------------------------------------------------

    def propagate(self, base: ArrayLike, F: ArrayLike, Q: ArrayLike) -> None:
        """First three of the base ← `base` (3,), P ← F P Fᵀ + Q with F, Q (3, 3) on their rows; O(D)."""
        s = self.state
        s.last.F[:], s.last.Q[:] = np.asarray(F, dtype=float), np.asarray(Q, dtype=float)
        s.belief.mean[:BASE] = np.asarray(base, dtype=float)
        dense.propagate(s)

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
        """P X (D, r), panel by panel where part of the map rests."""
        if not self.compressed:
            return np.asarray(self.covariance @ X)
        self.flush()
        self._pack()
        D, out = self.dim, np.zeros(X.shape)
        for row in range(0, D, PANEL):
            end = min(row + PANEL, D)
            start = packed_index(row, 0)
            panel = self.state.resting.store[start : start + PANEL * (row + PANEL)].reshape(PANEL, -1)[
                : end - row, :end
            ]
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
        s.last.S[:rows, :rows], s.last.L[:rows, :rows], s.last.y[:rows] = S, L, y
        w = solve_triangular(L, cross.T, lower=True)
        s.last.t[:rows] = solve_triangular(L, y, lower=True)
        s.last.rows = rows
        if self.compressed:
            self._whole_w, s.last.active = w, -1
        else:
            s.last.w[:rows, :D], s.last.active = w, D
            s.scratch.dx[:D] = w.T @ s.last.t[:rows]

    def update(self, retract: Callable[[Any], None]) -> None:
        """Carry out the update that `gain` or `gain_of` prepared: P ← P - wᵀw, and `retract` moves the mean."""
        s, rows = self.state, int(self.state.last.rows)
        if not self.compressed:
            dense.downdate(s, rows)
            retract(s)
            return
        self.flush()
        self._pack()
        w = self._whole_w
        assert w is not None
        V = np.zeros((-(-self.dim // PANEL) * PANEL, rows))
        V[: self.dim] = w.T
        dx = w.T @ s.last.t[:rows]
        with undisturbed():
            s.resting.V = V
            s.resting.corrected = 0
            self._correct_rows(None)
            s.resting.mean[: self.dim] += dx
            s.scratch.dx[:BASE] = dx[:BASE]
            retract(s)
            s.resting.mean[:BASE] = s.belief.mean[:BASE]
            s.belief.cov[:BASE, :BASE] = self._entries(np.arange(BASE), np.arange(BASE))

    def condition(self, H: ArrayLike, y: ArrayLike, R: ArrayLike) -> None:
        """Update by ``y = H δ + v``, v ~ N(0, R), with a dense H (r, D): x ← x + K y, P ← P - K S Kᵀ."""
        self.gain(np.asarray(H, dtype=float), np.asarray(y, dtype=float), np.asarray(R, dtype=float))
        self.update(_add)

    @property
    def gain_rows(self) -> Array:
        """L⁻¹ H P (r, D) of the last update, in the order of the map; zero for blocks that came after it."""
        s, rows = self.state, int(self.state.last.rows)
        if s.last.active >= 0:
            M, then = np.zeros((self.dim, int(s.resting.columns))), s.belief.local[: s.last.dim]
            if self.compressed:
                rest = np.flatnonzero((then < 0) | (then >= s.last.active))
                M[rest] = self._resting_rows(rest)
            return self._gain_rows(M)
        out = np.zeros((rows, self.dim))
        if rows > 0:
            assert self._whole_w is not None
            out[:, : self._whole_w.shape[1]] = self._whole_w
        return out

    def augment(self, block_id: Hashable, mean: ArrayLike, G: ArrayLike, noise: ArrayLike) -> None:
        """Append a block: P_ls = G P_xs, P_ll = G P_xx Gᵀ + noise, G (2, 3) on the base's first three."""
        if block_id in self.slots:
            raise InputError(f"block {block_id!r} exists already")
        self.reserve(1)
        s, slot, whole = self.state, self.active, self.dim
        s.belief.mean[slot : slot + BLOCK] = np.asarray(mean, dtype=float)
        s.scratch.G_pose[:], s.scratch.block[:] = np.asarray(G, dtype=float), np.asarray(noise, dtype=float)
        dense.augment(s, slot)
        self.register(block_id, whole)

    def append(self, mean: Array, cross: Array, block: Array) -> int:
        """Append an unnamed block with its cross-covariance (2, D) to the state; gives its slot. Nothing may rest."""
        self.reserve(1)
        s, slot = self.state, self.dim
        s.belief.mean[slot : slot + BLOCK] = mean
        s.belief.cov[slot : slot + BLOCK, :slot] = cross
        s.belief.cov[slot : slot + BLOCK, slot : slot + BLOCK] = np.tril(block)
        s.belief.owner[slot : slot + BLOCK] = s.belief.local[slot : slot + BLOCK] = slot, slot + 1
        s.belief.active += BLOCK
        s.belief.dim += BLOCK
        return slot

    def remove(self, block_id: Hashable) -> None:
        """Marginalise a block out: remove its rows and columns. The rest of the Gaussian stays as it is; O(D²)."""
        if block_id not in self.slots:
            raise InputError(f"there is no landmark {block_id!r} in the map of {len(self.slots)}")
        self.flush()
        slot, D, s = self.slots.pop(block_id), self.dim, self.state
        rest = np.r_[0:slot, slot + BLOCK : D]
        if self._whole_w is not None:
            self._whole_w = np.delete(self._whole_w, [i for i in (slot, slot + 1) if i < self._whole_w.shape[1]], 1)
        if self.compressed:
            self._pack()
            squeeze(s.resting.store, slot, D)
            for vector in (s.resting.mean, s.resting.linearised_at):
                vector[: D - BLOCK] = vector[rest]
        else:
            lower = s.belief.cov[np.ix_(rest, rest)]
            s.belief.cov[: D - BLOCK, : D - BLOCK] = lower
            for vector in (s.belief.mean, s.belief.linearised_at):
                vector[: D - BLOCK] = vector[rest]
            s.last.w[:, : D - BLOCK] = s.last.w[:, rest]
            s.belief.active -= BLOCK
            s.belief.local[D - BLOCK : D] = -1
            then = int(s.last.active)
            if then >= 0:
                s.last.active = min(then, D - BLOCK) if then <= slot else then - BLOCK
        s.belief.dim -= BLOCK
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
        """Mean (N, 2) and covariance (N, 2, 2) of every block by itself, read without forming P and without a flush."""
        slots = np.fromiter(self.slots.values(), dtype=np.int64, count=len(self.slots))
        return self._parts(slots[:, None] + np.arange(BLOCK))

    def _parts(self, at: Indices) -> tuple[Array, Array]:
        """Mean (n, d) and covariance (n, d, d) of n lists (n, d) of coordinates."""
        s = self.state
        if not self.compressed:
            i, j = at[:, :, None], at[:, None, :]
            return s.belief.mean[at], s.belief.cov[np.maximum(i, j), np.minimum(i, j)]
        local, C = s.belief.local[at], int(s.resting.columns)
        resting = local < 0
        # With (Φ_a, 0) for an active coordinate, (c, 1) for a resting one: P_ab = P_AA, Φ_a c_b or P⁰_bb - c_aᵀ Ψ c_b.
        rows = np.zeros((*at.shape, C))
        rows[resting] = self._resting_rows(at[resting])
        active = s.resting.Phi[np.maximum(local, 0)][:, :, :C]
        mean = np.where(resting, 0.0, s.belief.mean[np.maximum(local, 0)])
        mean[resting] = s.resting.mean[at[resting]] + rows[resting] @ s.resting.theta[:C]
        both, none = resting[:, :, None] & resting[:, None, :], ~resting[:, :, None] & ~resting[:, None, :]
        out = np.einsum("nac,nbc->nab", np.where(resting[..., None], 0.0, active), rows)
        out += out.transpose(0, 2, 1)
        a, b = np.maximum(local[:, :, None], 0), np.maximum(local[:, None, :], 0)
        a, b = np.broadcast_arrays(a, b)
        out[none] = s.belief.cov[np.maximum(a, b), np.minimum(a, b)][none]
        held = np.where(resting, at, 0)
        out[both] = (self._entries(held, held) - rows @ self._Psi @ rows.transpose(0, 2, 1))[both]
        return mean, out

    # -- undo ---------------------------------------------------------------------------------------------------------

    def snapshot(self) -> dict[str, Any]:
        """Everything that `restore` needs to bring the belief back exactly, unless it is flushed meanwhile."""
        s = self.state
        held = {"capacity": self.active, "columns": s.resting.columns, "map": self.dim, "rows": len(s.last.y)}
        kept: dict[str, Any] = {"slots": dict(self.slots), "gain": self._whole_w, "own": s.own.copy()}
        for part, fields in FIELDS.items():
            of = getattr(s, part)
            for name, field in fields.items():
                value = getattr(of, name)
                if field.shape and field.undone:
                    value = value[tuple(slice(0, held.get(n) if isinstance(n, str) else n) for n in field.shape)].copy()
                if field.undone:
                    kept[f"{part}.{name}"] = value
        return kept

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Undo everything since `snapshot`."""
        s = self.state
        s.belief.local[: self.dim] = -1
        for name, old in snapshot.items():
            part, _, field = name.partition(".")
            if not field:
                continue
            of = getattr(s, part)
            if isinstance(old, np.ndarray):
                getattr(of, field)[tuple(slice(0, n) for n in old.shape)] = old
            else:
                setattr(of, field, old)
        s.own[: len(snapshot["own"])] = snapshot["own"]
        self.slots, self._whole_w = dict(snapshot["slots"]), snapshot["gain"]


def _add(state: Any) -> None:
    D = state.belief.active
    state.belief.mean[:D] += state.scratch.dx[:D]
