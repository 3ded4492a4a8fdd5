"""The linear algebra under a belief: the covariance's lower triangle, and nothing of robots.

``state.cov`` holds the lower triangle of the active part P_AA; what stands above the diagonal means nothing.
D = ``state.size[0]`` is its dimension. What is not active rests: its covariance as of the last flush is P⁰, packed in
``state.store``, and every correction since then is kept in small matrices (Guivant & Nebot, IEEE TRA 17(3), 2001, with
an active set that grows). With A₀ the C = ``state.size[5]`` coordinates that rested at the flush and are active now,
b what rests still and M = P⁰[A₀, b]:

    P_Ab = Φ M,    P_bb = P⁰_bb - Mᵀ Ψ M,    x_b = x⁰_b + Mᵀ ϑ.

C = 0 where nothing rests: then all of this is empty, and the active part is everything, in the order of the map.
"""

from __future__ import annotations

from math import isfinite, sqrt
from typing import Any

from slamkit.compiled import compiled

__all__ = [
    "activate",
    "all_finite",
    "augment",
    "cholesky",
    "collect",
    "correction",
    "deposit",
    "downdate",
    "expand",
    "forward",
    "is_finite",
    "pack",
    "place",
    "project",
    "propagate",
    "record",
    "shear",
    "squeeze",
    "whiten",
]

#: Rows of one panel of the packed triangle: panel p is a matrix (PANEL, PANEL (p + 1)), diagonal blocks are square.
PANEL = 64


@compiled("flag(vector)")
def is_finite(v: Any) -> bool:
    """Whether every entry of a vector is finite."""
    for i in range(v.shape[0]):  # noqa: SIM110  (compiled code)
        if not isfinite(v[i]):
            return False
    return True


@compiled("flag(matrix)")
def all_finite(m: Any) -> bool:
    """Whether every entry of a matrix is finite."""
    for i in range(m.shape[0]):
        for j in range(m.shape[1]):
            if not isfinite(m[i, j]):
                return False
    return True


@compiled("void(state)")
def propagate(state: Any) -> None:
    """P ← F P Fᵀ + Q where F and Q concern the first three rows only: O(D).

    Reads ``state.F`` and ``state.Q``; Q is taken symmetric.
    """
    cov, F, Q, Phi = state.cov, state.F, state.Q, state.Phi
    D = state.size[0]
    f00, f01, f02 = F[0, 0], F[0, 1], F[0, 2]
    f10, f11, f12 = F[1, 0], F[1, 1], F[1, 2]
    f20, f21, f22 = F[2, 0], F[2, 1], F[2, 2]
    for i in range(3, D):
        row = cov[i]
        a, b, c = row[0], row[1], row[2]
        row[0] = f00 * a + f01 * b + f02 * c
        row[1] = f10 * a + f11 * b + f12 * c
        row[2] = f20 * a + f21 * b + f22 * c
    p00, p10, p11 = cov[0, 0], cov[1, 0], cov[1, 1]
    p20, p21, p22 = cov[2, 0], cov[2, 1], cov[2, 2]
    for i in range(3):
        # Row i of F P, then its product with the rows of F up to the diagonal.
        a = F[i, 0] * p00 + F[i, 1] * p10 + F[i, 2] * p20
        b = F[i, 0] * p10 + F[i, 1] * p11 + F[i, 2] * p21
        c = F[i, 0] * p20 + F[i, 1] * p21 + F[i, 2] * p22
        for j in range(i + 1):
            cov[i, j] = a * F[j, 0] + b * F[j, 1] + c * F[j, 2] + Q[i, j]
    for j in range(state.size[5]):
        a, b, c = Phi[0, j], Phi[1, j], Phi[2, j]
        Phi[0, j] = f00 * a + f01 * b + f02 * c
        Phi[1, j] = f10 * a + f11 * b + f12 * c
        Phi[2, j] = f20 * a + f21 * b + f22 * c


@compiled("void(state, index, index)")
def gather(state: Any, slot: int, count: int) -> None:
    """Copy rows slot … slot+count-1 of the symmetric P into the last rows of ``state.gathered``."""
    cov = state.cov
    D = state.size[0]
    for r in range(count):
        source = slot + r
        out = state.gathered[5 - count + r] if count == 2 else state.gathered[r]
        out[: source + 1] = cov[source, : source + 1]
    if count == 2:
        a, b = state.gathered[3], state.gathered[4]
        a[slot + 1] = cov[slot + 1, slot]
        for i in range(slot + 2, D):
            row = cov[i]
            a[i] = row[slot]
            b[i] = row[slot + 1]
    else:
        a, b, c = state.gathered[0], state.gathered[1], state.gathered[2]
        a[1], a[2], b[2] = cov[1, 0], cov[2, 0], cov[2, 1]
        for i in range(3, D):
            row = cov[i]
            a[i] = row[0]
            b[i] = row[1]
            c[i] = row[2]


@compiled("void(state, index, index)")
def project(state: Any, n: int, k: int) -> None:
    """w ← H P and S ← H P Hᵀ + R for the n sightings in ``state.slots``, k rows each: O(nkD).

    Each row of H has five entries: three in ``state.H_pose``, two in ``state.H_landmark``.
    """
    D = state.size[0]
    w, S, Hp, Hl, rows = state.w, state.S, state.H_pose, state.H_landmark, state.gathered
    gather(state, 0, 3)
    p0, p1, p2 = rows[0][:D], rows[1][:D], rows[2][:D]
    for j in range(n):
        gather(state, state.slots[j], 2)
        l0, l1 = rows[3][:D], rows[4][:D]
        for r in range(j * k, (j + 1) * k):
            out = w[r][:D]
            a, b, c, d, e = Hp[r, 0], Hp[r, 1], Hp[r, 2], Hl[r, 0], Hl[r, 1]
            for i in range(D):
                out[i] = a * p0[i] + b * p1[i] + c * p2[i] + d * l0[i] + e * l1[i]
    for r in range(n * k):
        wr = w[r]
        for q in range(r + 1):
            slot = state.slots[q // k]
            S[r, q] = (
                Hp[q, 0] * wr[0] + Hp[q, 1] * wr[1] + Hp[q, 2] * wr[2] + Hl[q, 0] * wr[slot] + Hl[q, 1] * wr[slot + 1]
            )
            if q // k == r // k:
                S[r, q] += state.noise[r, q % k]
            S[q, r] = S[r, q]


@compiled("flag(matrix, matrix, index, index)")
def cholesky(S: Any, L: Any, first: int, n: int) -> bool:
    """L Lᵀ = S for the n × n block that starts at row and column `first`; False where S is not positive definite.

    Only the lower triangles are read and written.
    """
    for i in range(first, first + n):
        for j in range(first, i + 1):
            s = S[i, j]
            for q in range(first, j):
                s -= L[i, q] * L[j, q]
            if i > j:
                L[i, j] = s / L[j, j]
            elif s > 0.0 and isfinite(s):
                L[i, i] = sqrt(s)
            else:
                return False
    return True


@compiled("real(matrix, vector, vector, index, index)")
def forward(L: Any, y: Any, t: Any, first: int, n: int) -> float:
    """t ← L⁻¹ y over the block that starts at `first`; returns tᵀt = yᵀS⁻¹y."""
    total = 0.0
    for i in range(first, first + n):
        s = y[i]
        for j in range(first, i):
            s -= L[i, j] * t[j]
        t[i] = s / L[i, i]
        total += t[i] * t[i]
    return total


@compiled("void(state, index)")
def whiten(state: Any, rows: int) -> None:
    """w ← L⁻¹ w, row by row."""
    D = state.size[0]
    w, L = state.w, state.L
    for i in range(rows):
        out = w[i][:D]
        for j in range(i):
            factor, other = L[i, j], w[j][:D]
            for c in range(D):
                out[c] -= factor * other[c]
        inverse = 1.0 / L[i, i]
        for c in range(D):
            out[c] *= inverse


@compiled("void(matrix, index, vector, vector)")
def subtract_pair(M: Any, n: int, a: Any, b: Any) -> None:
    """Lower triangle of M (n, n) ← M - aᵀa - bᵀb, two rows at a time: each entry of a and b serves both."""
    for i in range(0, n - 1, 2):
        upper, lower, left, right = M[i][: i + 1], M[i + 1][: i + 1], a[: i + 1], b[: i + 1]
        x0, y0, x1, y1 = a[i], b[i], a[i + 1], b[i + 1]
        for j in range(i + 1):
            upper[j] -= x0 * left[j] + y0 * right[j]
            lower[j] -= x1 * left[j] + y1 * right[j]
        M[i + 1, i + 1] -= x1 * x1 + y1 * y1
    if n % 2 == 1:
        row, left, right = M[n - 1][:n], a[:n], b[:n]
        x0, y0 = a[n - 1], b[n - 1]
        for j in range(n):
            row[j] -= x0 * left[j] + y0 * right[j]


@compiled("void(state, index)")
def downdate(state: Any, rows: int) -> None:
    """P ← P - wᵀw, a symmetric downdate of one triangle: O(rows · D²/2)."""
    cov, w = state.cov, state.w
    D = state.size[0]
    for r in range(0, rows - 1, 2):
        subtract_pair(cov, D, w[r], w[r + 1])
    if rows % 2 == 1:
        a = w[rows - 1]
        for i in range(D):
            row, left = cov[i][: i + 1], a[: i + 1]
            x = a[i]
            for j in range(i + 1):
                row[j] -= x * left[j]


@compiled("void(state, index, index)")
def record(state: Any, n: int, k: int) -> None:
    """Keep what an update by n sightings of k rows says of everything that rests: O(rows · D · C).

    With g = L⁻¹ H Φ: Φ ← Φ - wᵀg, Ψ ← Ψ + gᵀg, ϑ ← ϑ + gᵀt. Reads H, L, w and t of the update.
    """
    C, D = state.size[5], state.size[0]
    Phi, Psi, g, L, Hp, Hl = state.Phi, state.Psi, state.g, state.L, state.H_pose, state.H_landmark
    p0, p1, p2 = Phi[0][:C], Phi[1][:C], Phi[2][:C]
    for r in range(n * k):
        slot = state.slots[r // k]
        l0, l1, out = Phi[slot][:C], Phi[slot + 1][:C], g[r][:C]
        a, b, c, d, e = Hp[r, 0], Hp[r, 1], Hp[r, 2], Hl[r, 0], Hl[r, 1]
        for i in range(C):
            out[i] = a * p0[i] + b * p1[i] + c * p2[i] + d * l0[i] + e * l1[i]
        for q in range(r):
            factor, other = L[r, q], g[q][:C]
            for i in range(C):
                out[i] -= factor * other[i]
        inverse = 1.0 / L[r, r]
        for i in range(C):
            out[i] *= inverse
    theta = state.theta[:C]
    for r in range(n * k):
        factor, out = state.t[r], g[r][:C]
        for i in range(C):
            theta[i] += factor * out[i]
        w = state.w[r]
        for i in range(D):
            row, x = Phi[i][:C], w[i]
            for j in range(C):
                row[j] -= x * out[j]
        for i in range(C):
            row, left = Psi[i][: i + 1], out[: i + 1]
            x = out[i]
            for j in range(i + 1):
                row[j] += x * left[j]


@compiled("void(state, index)")
def correction(state: Any, rows: int) -> None:
    """dx ← wᵀ t = K y."""
    D = state.size[0]
    w, t, dx = state.w, state.t, state.dx[:D]
    for c in range(D):
        dx[c] = 0.0
    for r in range(rows):
        factor, row = t[r], w[r][:D]
        for c in range(D):
            dx[c] += factor * row[c]


@compiled("void(state, index)")
def augment(state: Any, slot: int) -> None:
    """Append two rows: P_ls = G_pose P_xs, P_ll = G_pose P_xx G_poseᵀ + block, Φ_l = G_pose Φ_x. `slot` must be D.

    The block is written from the new rows, never by a column assignment that would overwrite it.
    """
    cov, G, block, Phi, size = state.cov, state.G_pose, state.block, state.Phi, state.size
    D = size[0]
    gather(state, 0, 3)
    p0, p1, p2 = state.gathered[0][:D], state.gathered[1][:D], state.gathered[2][:D]
    for r in range(2):
        row = cov[slot + r][:D]
        a, b, c = G[r, 0], G[r, 1], G[r, 2]
        for i in range(D):
            row[i] = a * p0[i] + b * p1[i] + c * p2[i]
        for q in range(r + 1):
            cov[slot + r, slot + q] = row[0] * G[q, 0] + row[1] * G[q, 1] + row[2] * G[q, 2] + block[r, q]
        for j in range(size[5]):
            Phi[slot + r, j] = a * Phi[0, j] + b * Phi[1, j] + c * Phi[2, j]
        state.owner[slot + r] = size[6]
        state.local[size[6]] = slot + r
        size[6] += 1
    size[0] = D + 2


@compiled("void(state)")
def shear(state: Any) -> None:
    """P ← E P Eᵀ with E = I + e e_θᵀ, e = J(mean - points) for every position, then points ← mean; O(D²).

    It takes a covariance whose lever arms are taken at ``state.points`` to the current mean. The heading is entry 2.
    """
    cov, mean, points, e, g = state.cov, state.mean, state.points, state.gathered[3], state.gathered[4]
    D = state.size[0]
    moved = False
    for i in range(D):
        if i != 2 and mean[i] != points[i]:
            moved = True
    if moved:
        gather(state, 0, 3)
        heading = state.gathered[2]
        e[0], e[1], e[2] = points[1] - mean[1], mean[0] - points[0], 0.0
        for i in range(3, D, 2):
            e[i], e[i + 1] = points[i + 1] - mean[i + 1], mean[i] - points[i]
        half = 0.5 * cov[2, 2]
        for i in range(D):
            g[i] = heading[i] + half * e[i]
        for i in range(D):
            row, left, right = cov[i][: i + 1], e[: i + 1], g[: i + 1]
            x, y = e[i], g[i]
            for j in range(i + 1):
                row[j] += x * right[j] + y * left[j]
    for i in range(D):
        points[i] = mean[i]


# -- what rests -------------------------------------------------------------------------------------------------------


@compiled("index(index, index)")
def place(i: int, j: int) -> int:
    """Where entry (i, j), i ≥ j, of the packed triangle stands."""
    p = i // PANEL
    return PANEL * (p + 1) * (i - PANEL // 2 * p) + j


@compiled("void(state, index, vector)")
def resting_row(state: Any, index: int, out: Any) -> None:
    """out ← P⁰[A₀, index], as the last flush leaves it even where it is not yet written."""
    columns, store, V, U = state.columns, state.store, state.V, state.U
    pending = V.shape[1]
    for c in range(state.size[5]):
        i, j = max(columns[c], index), min(columns[c], index)
        total = store[place(i, j)]
        if i >= state.size[7]:
            for r in range(pending):
                total -= V[i, r] * U[j, r]
        out[c] = total


@compiled("index(state, index)")
def activate(state: Any, slot: int) -> int:
    """Make the landmark that rests at `slot` of the map active: O(A²); its slot among the active.

    With c = P⁰[A₀, j]: P_jA = cᵀΦᵀ, P_jj = P⁰_jj - cᵀΨc, x_j = x⁰_j + cᵀϑ, Φ ← [[Φ, 0], [-cᵀΨ, I]].
    """
    size, cov, Phi, Psi, theta, g = state.size, state.cov, state.Phi, state.Psi, state.theta, state.g
    D, C = size[0], size[5]
    column, product = state.gathered[3][:C], state.gathered[4][:C]
    for r in range(2):
        index, new = slot + r, D + r
        # The second coordinate comes after the first, whose column is as yet that of the identity.
        resting_row(state, index, column)
        for i in range(C):
            total = 0.0
            for j in range(i + 1):
                total += Psi[i, j] * column[j]
            for j in range(i + 1, C):
                total += Psi[j, i] * column[j]
            product[i] = total
        state.mean[new] = state.rest[index]
        for i in range(C):
            state.mean[new] += column[i] * theta[i]
        state.points[new] = state.rest_points[index]
        for i in range(D):
            total, row = 0.0, Phi[i][:C]
            for j in range(C):
                total += row[j] * column[j]
            cov[new, i] = total
        # P⁰[j, j] and, for the second coordinate, P⁰[j + 1, j]: both as corrected since the flush.
        for q in range(r + 1):
            i, j = index, slot + q
            total = state.store[place(i, j)]
            if i >= size[7]:
                for p in range(state.V.shape[1]):
                    total -= state.V[i, p] * state.U[j, p]
            other = column if q == r else state.dx[:C]
            for p in range(C):
                total -= product[p] * other[p]
            cov[new, D + q] = total
        for j in range(C):
            Phi[new, j] = -product[j]
        if r == 0:
            state.dx[:C] = column
    for r in range(2):
        new, at = D + r, C + r
        for i in range(D + 2):
            Phi[i, at] = 0.0
        for j in range(at + 1):
            Psi[at, j] = 0.0
        theta[at] = 0.0
        for q in range(g.shape[0]):
            g[q, at] = 0.0
        state.columns[at], state.owner[new], state.local[slot + r] = slot + r, slot + r, new
    Phi[D, C], Phi[D + 1, C + 1] = 1.0, 1.0
    size[0], size[5] = D + 2, C + 2
    return D


@compiled("void(state, matrix)")
def collect(state: Any, V: Any) -> None:
    """V (whole, C) ← P⁰[:, A₀]; nothing may be pending."""
    columns, store = state.columns, state.store
    whole = V.shape[0]
    for c in range(V.shape[1]):
        j = columns[c]
        for i in range(j):
            V[i, c] = store[place(j, i)]
    for i in range(whole):
        row, start = V[i], place(i, 0)
        for c in range(V.shape[1]):
            j = columns[c]
            if j <= i:
                row[c] = store[start + j]


@compiled("void(state, matrix)")
def deposit(state: Any, X: Any) -> None:
    """Write P_bA = X (whole, D) and P_AA into the store; the rows of A in X are not read."""
    owner, local, store, cov = state.owner, state.local, state.store, state.cov
    D = state.size[0]
    for i in range(X.shape[0]):
        row, start = X[i], place(i, 0)
        if local[i] < 0:
            for a in range(D):
                j = owner[a]
                if j < i:
                    store[start + j] = row[a]
    for a in range(D):
        i = owner[a]
        start = place(i, 0)
        for j in range(i):
            if local[j] < 0:
                store[start + j] = X[j, a]
        for b in range(a + 1):
            j = owner[b]
            store[place(max(i, j), min(i, j))] = cov[a, b]


@compiled("void(matrix, index, vector)")
def pack(M: Any, n: int, store: Any) -> None:
    """Pack the lower triangle of M (n, n)."""
    for i in range(n):
        start = place(i, 0)
        store[start : start + i + 1] = M[i, : i + 1]


@compiled("void(vector, matrix)")
def expand(store: Any, M: Any) -> None:
    """M (n, n), symmetric, ← a packed triangle, block by block so that both triangles stay in the cache."""
    n = M.shape[0]
    for i in range(n):
        start = place(i, 0)
        M[i, : i + 1] = store[start : start + i + 1]
    for first in range(0, n, PANEL):
        for left in range(0, first + 1, PANEL):
            for i in range(first, min(first + PANEL, n)):
                for j in range(left, min(left + PANEL, i)):
                    M[j, i] = M[i, j]


@compiled("void(vector, index, index)")
def squeeze(store: Any, slot: int, n: int) -> None:
    """Take rows and columns slot, slot + 1 out of a packed triangle of n rows, in place."""
    for i in range(slot + 2, n):
        source, target = place(i, 0), place(i - 2, 0)
        for j in range(slot):
            store[target + j] = store[source + j]
        for j in range(slot + 2, i + 1):
            store[target + j - 2] = store[source + j]
