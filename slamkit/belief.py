"""The growing Gaussian over a base vector (a pose) and blocks of two (landmarks).

It knows linear algebra and nothing of robots. One triangle of the covariance is kept; no operation forms a dense
transition, observation or I - KH matrix.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solve_triangular

from slamkit import kernels
from slamkit.compiled import State
from slamkit.errors import DivergenceError, InputError

Array = NDArray[np.float64]

BASE, BLOCK = 3, 2  #: dimensions of the base that a transition moves, and of one block


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

    def __init__(self, mean: ArrayLike, covariance: ArrayLike, rows: int = 2, control_dim: int = 2) -> None:
        self.slots: dict[Hashable, int] = {}
        self._k, self._m = rows, control_dim
        start = np.asarray(mean, dtype=float)
        self.base = b = len(start)
        kept = {"mean": start, "points": start, "cov": np.tril(np.asarray(covariance, dtype=float))}
        kept |= {"memory": np.zeros(6), "size": np.array([b, 0, 0, 0, 0], dtype=np.int64)}
        self._lay_out(kept, capacity=b + 8 * BLOCK, sightings=8)

    def _lay_out(self, kept: dict[str, Any], capacity: int, sightings: int) -> None:
        """Arrays of the given capacity that hold what is kept."""
        k, m, rows = self._k, self._m, max(self._k * sightings, int(kept["size"][1]))
        D = int(kept["size"][0])

        def copied(name: str, shape: tuple[int, ...]) -> Array:
            out = np.zeros(shape)
            old = kept.get(name, np.zeros((0,) * len(shape)))
            part = tuple(slice(0, min(a, b)) for a, b in zip(shape, old.shape, strict=True))
            out[part] = old[part]
            return out

        cov = np.zeros((capacity, capacity))
        cov[:D, :D] = kept["cov"][:D, :D]
        self.state = State(
            mean=copied("mean", (capacity,)),
            cov=cov,
            points=copied("points", (capacity,)),
            memory=kept["memory"],
            size=kept["size"],
            pose=np.zeros(BASE),
            F=copied("F", (BASE, BASE)) if "F" in kept else np.eye(BASE),
            Q=copied("Q", (BASE, BASE)),
            G=np.zeros((BASE, m)),
            sigma_u=np.zeros((m, m)),
            at=np.zeros(BASE + BLOCK * sightings),
            slots=np.zeros(sightings, dtype=np.int64),
            order=np.zeros(sightings, dtype=np.int64),
            innovations=np.zeros((sightings, k)),
            nis=np.zeros(sightings),
            truth=np.zeros((sightings, BLOCK)),
            accepted=np.zeros(sightings, dtype=np.bool_),
            z=copied("z", (rows,)),
            z_hat=np.zeros(k),
            y=copied("y", (rows,)),
            effective=np.zeros(rows),
            H_pose=np.zeros((rows, BASE)),
            H_landmark=np.zeros((rows, BLOCK)),
            noise=np.zeros((rows, k)),
            S=copied("S", (rows, rows)),
            L=copied("L", (rows, rows)),
            w=copied("w", (rows, capacity)),
            t=copied("t", (rows,)),
            dx=np.zeros(capacity),
            gathered=np.zeros((BASE + BLOCK, capacity)),
            G_pose=np.zeros((BLOCK, BASE)),
            G_z=np.zeros((BLOCK, k)),
            block=np.zeros((BLOCK, BLOCK)),
        )

    @property
    def dim(self) -> int:
        """D = b + 2N."""
        return int(self.state.size[0])

    @property
    def ids(self) -> tuple[Hashable, ...]:
        """Ids of the blocks in the order of the mean."""
        return tuple(self.slots)

    @property
    def mean(self) -> Array:
        """Mean (D,); a copy."""
        return np.array(self.state.mean[: self.dim])

    @mean.setter
    def mean(self, value: Array) -> None:
        self.state.mean[: self.dim] = value

    @property
    def covariance(self) -> Array:
        """Covariance (D, D), symmetric; a copy."""
        D = self.dim
        lower: Array = np.tril(self.state.cov[:D, :D])
        return lower + np.tril(lower, -1).T

    @covariance.setter
    def covariance(self, value: Array) -> None:
        D = self.dim
        self.state.cov[:D, :D] = np.tril(value)

    def reserve(self, blocks: int, sightings: int = 1, control_dim: int | None = None) -> None:
        """Make room for this many further blocks, scans of this many sightings, controls of this length."""
        need, capacity = self.dim + BLOCK * blocks, len(self.state.mean)
        m = self._m if control_dim is None else control_dim
        if need <= capacity and sightings <= len(self.state.nis) and m == self._m:
            return
        self._m = m
        while capacity < need:
            capacity = self.base + 2 * (capacity - self.base)
        self._lay_out(self.state.fields, capacity, max(sightings, len(self.state.nis)))

    def register(self, block_id: Hashable, slot: int) -> None:
        """Name the block that compiled code appended at `slot`."""
        self.slots[block_id] = slot

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
        PHt = self.covariance @ H.T
        self.gain_of(PHt, H @ PHt + R, y)

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
        s.w[:rows, :D] = solve_triangular(L, cross.T, lower=True)
        s.t[:rows] = solve_triangular(L, y, lower=True)
        s.size[1], s.size[2] = rows, D
        kernels.correction(s, rows)

    def condition(self, H: ArrayLike, y: ArrayLike, R: ArrayLike) -> None:
        """Update by ``y = H δ + v``, v ~ N(0, R), with a dense H (r, D): x ← x + K y, P ← P - K S Kᵀ."""
        self.gain(np.asarray(H, dtype=float), np.asarray(y, dtype=float), np.asarray(R, dtype=float))
        D, rows = self.dim, int(self.state.size[1])
        kernels.downdate(self.state, rows)
        self.state.mean[:D] += self.state.dx[:D]

    def augment(self, block_id: Hashable, mean: ArrayLike, G: ArrayLike, noise: ArrayLike) -> None:
        """Append a block: P_ls = G P_xs, P_ll = G P_xx Gᵀ + noise, G (2, 3) on the base's first three."""
        if block_id in self.slots:
            raise InputError(f"block {block_id!r} exists already")
        self.reserve(1)
        s, slot = self.state, self.dim
        s.mean[slot : slot + BLOCK] = np.asarray(mean, dtype=float)
        s.G_pose[:], s.block[:] = np.asarray(G, dtype=float), np.asarray(noise, dtype=float)
        kernels.augment(s, slot)
        self.register(block_id, slot)

    def append(self, mean: Array, cross: Array, block: Array) -> int:
        """Append an unnamed block with its cross-covariance (2, D) to the whole state; its slot."""
        self.reserve(1)
        s, slot = self.state, self.dim
        s.mean[slot : slot + BLOCK] = mean
        s.cov[slot : slot + BLOCK, :slot] = cross
        s.cov[slot : slot + BLOCK, slot : slot + BLOCK] = np.tril(block)
        s.size[0] += BLOCK
        return slot

    def remove(self, block_id: Hashable) -> None:
        """Marginalise a block out: its rows go, the rest of the Gaussian stays as it is; O(D²)."""
        if block_id not in self.slots:
            raise InputError(f"there is no landmark {block_id!r} in the map of {len(self.slots)}")
        slot, D, s = self.slots.pop(block_id), self.dim, self.state
        rest = np.r_[0:slot, slot + BLOCK : D]
        lower = s.cov[np.ix_(rest, rest)]
        s.cov[: D - BLOCK, : D - BLOCK] = lower
        for vector in (s.mean, s.points):
            vector[: D - BLOCK] = vector[rest]
        s.w[:, : D - BLOCK] = s.w[:, rest]
        s.size[0] -= BLOCK
        s.size[2] = min(s.size[2], s.size[0]) if s.size[2] <= slot else s.size[2] - BLOCK
        self.slots = {i: k if k < slot else k - BLOCK for i, k in self.slots.items()}

    def indices(self, ids: Iterable[Hashable], base: bool) -> NDArray[np.int64]:
        """Indices into the mean: the base first where it is asked for, then each block in the order given."""
        parts = list(range(self.base)) if base else []
        for i in ids:
            if i not in self.slots:
                raise InputError(f"there is no landmark {i!r} in the map of {len(self.slots)}")
            parts += [self.slots[i], self.slots[i] + 1]
        return np.array(parts, dtype=np.int64)

    def marginal(self, ids: Iterable[Hashable], base: bool = False) -> tuple[Array, Array]:
        """Mean (d,) and covariance (d, d) of some blocks, read from the triangle without forming P."""
        at = self.indices(ids, base)
        row, column = np.meshgrid(at, at, indexing="ij")
        return self.state.mean[at], self.state.cov[np.maximum(row, column), np.minimum(row, column)]

    def snapshot(self) -> dict[str, Any]:
        """Everything that `restore` needs to bring the belief back to the bit."""
        D = self.dim
        whole = {n: np.array(v) for n, v in self.state.fields.items() if n not in ("cov", "gathered", "dx")}
        return {**whole, "cov": np.array(self.state.cov[:D, :D]), "slots": dict(self.slots)}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Undo everything since `snapshot`."""
        D = int(snapshot["size"][0])
        self.slots = dict(snapshot["slots"])
        for name, old in snapshot.items():
            if name in ("cov", "slots"):
                continue
            new = getattr(self.state, name)
            new[tuple(slice(0, n) for n in old.shape)] = old
        self.state.cov[:D, :D] = snapshot["cov"]
