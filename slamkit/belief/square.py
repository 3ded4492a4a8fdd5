"""A flush into a square store, both triangles: for a covariance that is read as a whole after every step."""

from __future__ import annotations

from typing import Any

from slamkit.belief.flush import keep_base_only
from slamkit.compiled import TILE, compiled, intrinsics

#: TILE rows and columns at a time, of a rank that is a multiple of UNROLLED.
subtract_tile, subtract_tile_into, subtract_tile_cached = intrinsics(
    "simd", "subtract_tile", "subtract_tile_into", "subtract_tile_cached"
)


@compiled("void(state, matrix)")
def rows_at_flush_square(state: Any, M: Any) -> None:
    """M (C, n) ← P⁰[A₀, :n] of a square store, related as `to_map_coordinates` does it."""
    columns, rest, store, lead = (
        state.resting.activated,
        state.resting.mean,
        state.resting.store,
        state.resting.row_stride,
    )
    C, n = M.shape
    for c in range(C):
        row, source = M[c], store[lead * columns[c] :]
        for j in range(n):
            row[j] = source[j]
    x, y, heading = M[0], M[1], M[2]
    for c in range(3, C, 2):
        a, b = M[c], M[c + 1]
        right, up = rest[columns[c]] - rest[0], rest[columns[c + 1]] - rest[1]
        for j in range(n):
            a[j] -= x[j] - up * heading[j]
            b[j] -= y[j] + right * heading[j]


@compiled("void(state, index, matrix, integers)")
def flush_factors(state: Any, rank: int, X: Any, added: Any) -> None:
    """Rows of X by which a flush multiplies M = P⁰[A₀, b].

    The first `rank` rows are there, B with BᵀB = Ψ and rows of zeros. Then come ϑ, Φ of what is `added`, and L⁻¹HΦ.
    That is filled in, too: the active coordinates of the base and of landmarks that do not stand in the store yet.
    """
    C, at = state.resting.columns, rank
    for c in range(C):
        X[at, c] = state.resting.theta[c]
    known = 3
    for a in range(state.belief.active):
        if a >= 3 and known < C and state.resting.activated[known] == state.belief.owner[a]:
            known += 1
            continue
        added[a - known + 3] = a
        at += 1
        for c in range(C):
            X[at, c] = state.resting.Phi[a, c]
    for r in range(X.shape[0] - 1 - at):
        for c in range(C):
            X[at + 1 + r, c] = state.last.g[r, c]


@compiled("void(matrix, index, vector)")
def tile(W: Any, rank: int, V: Any) -> None:
    """V ← the first `rank` rows of W, transposed, in tiles as `downdate_square` wants them."""
    for k in range(rank):
        row = W[k]
        for first in range(0, W.shape[1], TILE):
            at = first * rank + k * TILE
            for i in range(TILE):
                V[at + i] = row[first + i]


@compiled("void(vector, vector, flag, flag, index, vector, index)")
def downdate_square(source: Any, target: Any, same: bool, cached: bool, lead: int, V: Any, n: int) -> None:
    """First n rows and columns of a square store: target ← source - V Vᵀ, both triangles; they may be the `same`.

    `cached` says that the caches hold all of it. n and `lead` are multiples of TILE. A band of rows is taken column by
    column, so that what is written beyond the diagonal is whole cache lines that follow each other.
    """
    rank = V.shape[0] // n
    for first in range(0, n, 256):
        last = min(first + 256, n)
        for j in range(0, last, TILE):
            if cached:
                for i in range(max(first, j), last, TILE):
                    subtract_tile_cached(source, target, lead, i, j, V, rank)
            elif same:
                for i in range(max(first, j), last, TILE):
                    subtract_tile(source, target, lead, i, j, V, rank)
            else:
                for i in range(max(first, j), last, TILE):
                    subtract_tile_into(source, target, lead, i, j, V, rank)


@compiled("void(state, vector, flag, flag, matrix, vector, integers, matrix)")
def flush_square(state: Any, target: Any, same: bool, cached: bool, W: Any, V: Any, added: Any, gain: Any) -> None:
    """A flush of a square store into `target`, as `downdate_square` does it.

    W = X P⁰[A₀, :], X and `added` of `flush_factors`. V is room for the tiles of the first rows of W. `gain` becomes
    L⁻¹ H P (rows, D) of the last update, where that was made of what is active.
    """
    cov, rest, owner = state.belief.cov, state.resting.mean, state.belief.owner
    D, whole, lead, n = state.belief.active, state.belief.dim, state.resting.row_stride, W.shape[1]
    at = V.shape[0] // n
    tile(W, at, V)
    downdate_square(state.resting.store, target, same, cached, lead, V, n)
    row = W[at]
    for j in range(whole):
        rest[j] += row[j]
    for a in range(D):
        rest[owner[a]], state.resting.linearised_at[owner[a]] = state.belief.mean[a], state.belief.linearised_at[a]
    for a in added:
        i = owner[a]
        at += 1
        row, out = W[at], target[lead * i : lead * i + whole]
        for j in range(whole):
            out[j] = row[j]
        for b in range(D):
            out[owner[b]] = cov[max(a, b), min(a, b)]
        if a >= 3:
            for j in range(whole):
                target[lead * j + i] = out[j]
    # The base's columns stand in one cache line.
    x, y, heading = target[:whole], target[lead : lead + whole], target[2 * lead : 2 * lead + whole]
    for j in range(3, whole):
        out = target[lead * j : lead * j + 3]
        out[0], out[1], out[2] = x[j], y[j], heading[j]
    for r in range(gain.shape[0]):
        row, out = W[at + 1 + r], gain[r]
        for j in range(whole):
            out[j] = row[j] if j < state.last.dim else 0.0
        for a in range(state.last.active):
            out[owner[a]] = state.last.w[r, a]
    if gain.shape[0] > 0:
        state.last.active = -1
    keep_base_only(state)
