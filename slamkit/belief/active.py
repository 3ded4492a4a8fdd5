"""Compiled bookkeeping between the active part of a large map and the part that rests.

:mod:`slamkit.belief.compressed` has the equations.
"""

from __future__ import annotations

from typing import Any

from slamkit.belief.dense import subtract_four_rows, subtract_pair
from slamkit.belief.packed import packed_index
from slamkit.compiled import compiled


@compiled("index(state, index, index)")
def store_index(state: Any, i: int, j: int) -> Any:
    """Where entry (i, j), i ≥ j, stands in ``state.resting.store``."""
    lead = state.resting.row_stride
    return lead * i + j if lead > 0 else packed_index(i, j)


@compiled("void(state, matrix)")
def to_map_coordinates(state: Any, M: Any) -> None:
    """Rows P⁰[i, A₀] in coordinates of the map ← the same with A₀ in its own: O(C) each."""
    columns, rest, C = state.resting.activated, state.resting.mean, M.shape[1]
    for i in range(M.shape[0]):
        row = M[i]
        a, b, heading = row[0], row[1], row[2]
        for c in range(3, C, 2):
            row[c] -= a - (rest[columns[c + 1]] - rest[1]) * heading
            row[c + 1] -= b + (rest[columns[c]] - rest[0]) * heading


@compiled("void(state, index, vector)")
def resting_row(state: Any, index: int, out: Any) -> None:
    """out ← P⁰[A₀, index] after the last flush, including corrections that are not yet written."""
    columns, store, V = state.resting.activated, state.resting.store, state.resting.V
    pending = V.shape[1]
    for c in range(state.resting.columns):
        i, j = max(columns[c], index), min(columns[c], index)
        total = store[store_index(state, i, j)]
        if i >= state.resting.corrected:
            for r in range(pending):
                total -= V[i, r] * V[j, r]
        out[c] = total
    to_map_coordinates(state, out.reshape(1, out.shape[0]))


@compiled("index(state, index)")
def activate(state: Any, slot: int) -> Any:
    """Make the landmark that rests at `slot` of the map active: O(A²). Gives its active slot.

    With c = P⁰[A₀, j]: P_jA = cᵀΦᵀ, P_jj = P⁰_jj - cᵀΨc, x_j = x⁰_j + cᵀϑ, Φ ← [[Φ, 0], [B - cᵀΨ, I]], where
    B = [I, J(l_j - p)] on the pose takes the landmark from its coordinates in A₀ to those of the map.
    """
    cov, Phi, Psi, theta, g = (
        state.belief.cov,
        state.resting.Phi,
        state.resting.minus_Psi,
        state.resting.theta,
        state.last.g,
    )
    D, C = state.belief.active, state.resting.columns
    column, product = state.scratch.gathered[3][:C], state.scratch.gathered[4][:C]
    for r in range(2):
        index, new = slot + r, D + r
        # The second coordinate comes after the first, whose column is as yet that of the identity.
        resting_row(state, index, column)
        for i in range(C):
            product[i] = 0.0
        for i in range(C):
            row, x, total = Psi[i], column[i], 0.0
            for j in range(i):
                total += row[j] * column[j]
                product[j] += row[j] * x
            product[i] += total + row[i] * x
        state.belief.mean[new] = state.resting.mean[index]
        for i in range(C):
            state.belief.mean[new] += column[i] * theta[i]
        state.belief.linearised_at[new] = state.resting.linearised_at[index]
        for i in range(D):
            total, row = 0.0, Phi[i][:C]
            for j in range(C):
                total += row[j] * column[j]
            cov[new, i] = total
        # P_jj, and for the second coordinate the entry beside it too; `product` is -Ψc, for -Ψ is what is kept.
        for q in range(r + 1):
            i, j = index, slot + q
            total = state.resting.store[store_index(state, i, j)]
            if i >= state.resting.corrected:
                for p in range(state.resting.V.shape[1]):
                    total -= state.resting.V[i, p] * state.resting.V[j, p]
            other = column if q == r else state.scratch.dx[:C]
            for p in range(C):
                total += product[p] * other[p]
            cov[new, D + q] = total
        for j in range(C):
            Phi[new, j] = product[j]
        if r == 0:
            for p in range(C):
                state.scratch.dx[p] = column[p]
    for r in range(2):
        new, at = D + r, C + r
        for i in range(D + 2):
            Phi[i, at] = 0.0
        for j in range(at + 1):
            Psi[at, j] = 0.0
        theta[at] = 0.0
        for q in range(g.shape[0]):
            g[q, at] = 0.0
        state.resting.activated[at], state.belief.owner[new], state.belief.local[slot + r] = slot + r, slot + r, new
    Phi[D, C], Phi[D + 1, C + 1] = 1.0, 1.0
    Phi[D, 0] += 1.0
    Phi[D, 2] -= state.resting.mean[slot + 1] - state.resting.mean[1]
    Phi[D + 1, 1] += 1.0
    Phi[D + 1, 2] += state.resting.mean[slot] - state.resting.mean[0]
    state.belief.active, state.resting.columns = D + 2, C + 2
    return D


@compiled("void(state, index, index)")
def record(state: Any, n: int, k: int) -> None:
    """Record the effect of an update by n sightings of k rows on all resting landmarks: O(rows · D · C).

    With g = L⁻¹ H Φ: Φ ← Φ - wᵀg, Ψ ← Ψ + gᵀg, ϑ ← ϑ + gᵀt. Reads H, L, w and t of the update.
    """
    C, D = state.resting.columns, state.belief.active
    Phi, Psi, g, L, Hp, Hl = (
        state.resting.Phi,
        state.resting.minus_Psi,
        state.last.g,
        state.last.L,
        state.scratch.H_pose,
        state.scratch.H_landmark,
    )
    p0, p1, p2, theta = Phi[0][:C], Phi[1][:C], Phi[2][:C], state.resting.theta[:C]
    for j in range(n):
        slot = state.scratch.slots[j]
        l0, l1 = Phi[slot][:C], Phi[slot + 1][:C]
        for r in range(j * k, (j + 1) * k):
            out = g[r][:C]
            a, b, c, d, e = Hp[r, 0], Hp[r, 1], Hp[r, 2], Hl[r, 0], Hl[r, 1]
            for i in range(C):
                out[i] = a * p0[i] + b * p1[i] + c * p2[i] + d * l0[i] + e * l1[i]
            for q in range(r):
                factor, other = L[r, q], g[q][:C]
                for i in range(C):
                    out[i] -= factor * other[i]
            inverse, t = 1.0 / L[r, r], state.last.t[r]
            for i in range(C):
                out[i] *= inverse
                theta[i] += t * out[i]
    few = state.resting.root_rows
    if state.resting.root_row_count + n * k > few.shape[0]:
        state.resting.root_row_count = -1
    if state.resting.root_row_count >= 0:
        for r in range(n * k):
            row, out = g[r], few[state.resting.root_row_count + r]
            for i in range(few.shape[1]):
                out[i] = row[i] if i < C else 0.0
        state.resting.root_row_count += n * k
    for r in range(0, n * k, 2):
        # An odd last row goes with a row of zeros.
        last = r + 1 == n * k
        w0, w1 = state.last.w[r], state.scratch.dx if last else state.last.w[r + 1]
        g0, g1 = g[r], state.scratch.gathered[0] if last else g[r + 1]
        if last:
            for i in range(D):
                w1[i] = 0.0
            for i in range(C):
                g1[i] = 0.0
        for i in range(0, D, 4):
            subtract_four_rows(Phi, i, w0, w1, g0, g1, C)
        subtract_pair(Psi, C, g0, g1)
