"""A small belief is saved before each step and brought back if the step fails."""

from __future__ import annotations

from typing import Any

from slamkit.compiled import compiled, intrinsics

#: A belief with room for no more than this is saved before each step, which costs less than checking every sighting.
SMALL = 48
#: Where the rows of the last update begin in what is saved: after z, y, t, S and L of two rows.
LAST = 16

(copy_fours,) = intrinsics("simd", "copy_fours")


@compiled("void(state)")
def save_small(state: Any) -> None:
    """Save a small belief, in which nothing rests, and its last update, of at most two rows."""
    last, saved, D, n = state.last, state.scratch.saved, state.belief.active, state.belief.mean.shape[0]
    for r in range(2):
        out = saved[7 * r : 7 * r + 7]
        out[0], out[1], out[2] = last.z[r], last.y[r], last.t[r]
        out[3], out[4] = last.S[r, 0], last.S[r, 1]
        out[5], out[6] = last.L[r, 0], last.L[r, 1]
        copy_fours(last.w, r * n, saved, LAST + r * n, D)
    copy_fours(state.belief.mean, 0, saved, LAST + 2 * n, D)
    copy_fours(state.belief.linearised_at, 0, saved, LAST + 3 * n, D)
    for i in range(D):
        copy_fours(state.belief.cov, i * n, saved, LAST + (4 + i) * n, i + 1)
    own, first = state.own, LAST + (4 + n) * n
    for i in range(own.shape[0]):
        saved[first + i] = own[i]


@compiled("void(state, index)")
def undo_small(state: Any, D: int) -> None:
    """Restore what `save_small` saved of a belief of D dimensions."""
    last, saved, n = state.last, state.scratch.saved, state.belief.mean.shape[0]
    for r in range(2):
        out = saved[7 * r : 7 * r + 7]
        last.z[r], last.y[r], last.t[r] = out[0], out[1], out[2]
        last.S[r, 0], last.S[r, 1] = out[3], out[4]
        last.L[r, 0], last.L[r, 1] = out[5], out[6]
        copy_fours(saved, LAST + r * n, last.w, r * n, D)
    copy_fours(saved, LAST + 2 * n, state.belief.mean, 0, D)
    copy_fours(saved, LAST + 3 * n, state.belief.linearised_at, 0, D)
    for i in range(D):
        copy_fours(saved, LAST + (4 + i) * n, state.belief.cov, i * n, i + 1)
    own, first = state.own, LAST + (4 + n) * n
    for i in range(own.shape[0]):
        own[i] = saved[first + i]
    for i in range(D, state.belief.active):
        state.belief.local[i] = -1
    state.belief.active = state.belief.dim = D
