"""Compiled parts of a flush, which brings the part of a large map that rests up to date."""

from __future__ import annotations

from math import sqrt
from typing import Any

from slamkit.belief.active import to_map_coordinates
from slamkit.belief.packed import packed_index
from slamkit.compiled import compiled


@compiled("void(state, matrix)")
def rows_at_flush(state: Any, V: Any) -> None:
    """V (whole, C) ← P⁰[:, A₀] of a packed store; nothing may be pending."""
    columns, store = state.resting.activated, state.resting.store
    whole = V.shape[0]
    for c in range(V.shape[1]):
        j = columns[c]
        for i in range(j):
            V[i, c] = store[packed_index(j, i)]
    for i in range(whole):
        row, start = V[i], packed_index(i, 0)
        for c in range(V.shape[1]):
            j = columns[c]
            if j <= i:
                row[c] = store[start + j]
    to_map_coordinates(state, V)


@compiled("void(state, matrix)")
def write_active(state: Any, X: Any) -> None:
    """Write P_bA = X (whole, D) and P_AA into a packed store; the rows of A in X are not read."""
    owner, local, store, cov = state.belief.owner, state.belief.local, state.resting.store, state.belief.cov
    D = state.belief.active
    for i in range(X.shape[0]):
        row, start = X[i], packed_index(i, 0)
        if local[i] < 0:
            for a in range(D):
                j = owner[a]
                if j < i:
                    store[start + j] = row[a]
    for a in range(D):
        i = owner[a]
        start = packed_index(i, 0)
        for j in range(i):
            if local[j] < 0:
                store[start + j] = X[j, a]
        for b in range(a + 1):
            j = owner[b]
            store[packed_index(max(i, j), min(i, j))] = cov[a, b]


@compiled("void(state, matrix, vector)")
def scaled(state: Any, A: Any, scale: Any) -> None:
    """Ψ = diag(scale) A diag(scale) with ones on A's diagonal, or zeros; of A (C, C) the lower triangle, beside zeros.

    With a diagonal of ones what a decomposition of A cuts off is within rounding of every entry, whatever its unit.
    """
    Psi, C = state.resting.minus_Psi, A.shape[0]
    for i in range(C):
        scale[i] = sqrt(max(-Psi[i, i], 0.0))
    for i in range(C):
        for j in range(C):
            divisor = scale[i] * scale[j]
            A[i, j] = -Psi[i, j] / divisor if j <= i and divisor > 0.0 else 0.0


@compiled("void(matrix, index, integers, vector, matrix)")
def unscaled(L: Any, rank: int, order: Any, scale: Any, B: Any) -> None:
    """First `rank` rows of B with BᵀB = Ψ from L Lᵀ = A with A's rows and columns in this order, counted from 1."""
    for i in range(L.shape[0]):
        c = order[i] - 1
        for k in range(min(i + 1, rank)):
            B[k, c] = L[i, k] * scale[c]


@compiled("void(state)")
def keep_base_only(state: Any) -> None:
    """After a flush only the base is active."""
    owner, Phi, Psi = state.belief.owner, state.resting.Phi, state.resting.minus_Psi
    for a in range(state.belief.active):
        state.belief.local[owner[a]] = -1
    for i in range(3):
        state.belief.local[i] = owner[i] = state.resting.activated[i] = i
        state.resting.theta[i] = 0.0
        for j in range(3):
            Phi[i, j], Psi[i, j] = 0.0, 0.0
        Phi[i, i] = 1.0
    state.belief.active = state.resting.columns = 3
    state.resting.debt = state.resting.spent = state.resting.spent_plain = 0.0
    state.resting.root_row_count = 0
