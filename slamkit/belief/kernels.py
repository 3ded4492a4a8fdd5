"""The linear algebra under a belief: the covariance's lower triangle, and nothing of robots.

``state.cov`` holds the lower triangle of the active part P_AA; what stands above the diagonal means nothing.
D = ``state.size[ACTIVE]`` is its dimension. What is not active rests: its covariance as of the last flush is P⁰,
held in ``state.store``, and every correction since then is kept in small matrices (Guivant & Nebot, IEEE TRA 17(3),
2001, with an active set that grows). With A₀ the C = ``state.size[COLUMNS]`` coordinates that rested at the flush and
are active now, b what rests still and M = P⁰[A₀, b]:

    P_Ab = Φ M,    P_bb = P⁰_bb - Mᵀ Ψ M,    x_b = x⁰_b + Mᵀ ϑ.

A landmark l of A₀ stands there as l - p - J(l - p)θ, at the means of the flush: what the frame's own uncertainty adds
to l and to the pose (p, θ) alike is large, and the map's is not. In coordinates of the map Ψ, ϑ and Φ would bring small
numbers about as differences of large ones, and lose three digits over a long drive.

C = 0 where nothing rests: then all of this is empty, and the active part is everything, in the order of the map.
"""

from __future__ import annotations

from math import isfinite, sqrt
from typing import Any

from slamkit.compiled import (
    ACTIVE,
    ACTIVE_THEN,
    COLUMNS,
    CORRECTED,
    DEBT,
    LEAD,
    SPENT,
    SPENT_PLAIN,
    TILE,
    WHOLE,
    WHOLE_THEN,
    compiled,
    intrinsics,
)

__all__ = [
    "absorb",
    "activate",
    "all_finite",
    "augment",
    "cholesky",
    "collect",
    "collect_rows",
    "deposit",
    "downdate",
    "expand",
    "factors",
    "flush_square",
    "forward",
    "is_finite",
    "keep_base",
    "pack",
    "place",
    "project",
    "propagate",
    "record",
    "relate",
    "save",
    "scaled",
    "shear",
    "squeeze",
    "undo",
    "unscaled",
    "whiten",
]

#: Rows of one panel of the packed triangle: panel p is a matrix (PANEL, PANEL (p + 1)), diagonal blocks are square.
PANEL = 64

#: ``(M, i, x, y, a, b, n)``: rows i … i + 3 of M -= x[i] a + y[i] b in their first n columns at least; arrays must
#: have room up to a multiple of four rows and columns, where what they hold means nothing.
(subtract_four_rows,) = intrinsics("vectors", "subtract_four_rows")

copy_fours, project_four, project_first_four = intrinsics("vectors", "copy_fours", "project_four", "project_first_four")

#: TILE rows and columns at a time, of a rank that is a multiple of UNROLLED.
subtract_tile, subtract_tile_into, subtract_tile_cached = intrinsics(
    "vectors", "subtract_tile", "subtract_tile_into", "subtract_tile_cached"
)

#: A belief with room for no more than this is saved before a step, not asked beforehand whether the step will work.
SMALL = 48


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
    D = state.size[ACTIVE]
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
    for j in range(state.size[COLUMNS]):
        a, b, c = Phi[0, j], Phi[1, j], Phi[2, j]
        Phi[0, j] = f00 * a + f01 * b + f02 * c
        Phi[1, j] = f10 * a + f11 * b + f12 * c
        Phi[2, j] = f20 * a + f21 * b + f22 * c


@compiled("void(state, index, index)")
def gather(state: Any, slot: int, count: int) -> None:
    """Copy rows slot … slot+count-1 of the symmetric P into the last rows of ``state.gathered``."""
    cov = state.cov
    D = state.size[ACTIVE]
    for r in range(count):
        source = slot + r
        out, row = state.gathered[5 - count + r] if count == 2 else state.gathered[r], cov[source]
        for i in range(source + 1):
            out[i] = row[i]
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


@compiled("void(state, index, index, index)")
def project_pair(state: Any, slot: int, first: int, second: int) -> None:
    """Rows `first` and `second` of w ← those of H P, for two rows of H that concern one landmark, in one pass."""
    cov, Hp, Hl = state.cov, state.H_pose, state.H_landmark
    D = state.size[ACTIVE]
    w0, w1 = state.w[first][:D], state.w[second][:D]
    a0, b0, c0, d0, e0 = Hp[first, 0], Hp[first, 1], Hp[first, 2], Hl[first, 0], Hl[first, 1]
    a1, b1, c1, d1, e1 = Hp[second, 0], Hp[second, 1], Hp[second, 2], Hl[second, 0], Hl[second, 1]
    slot = max(slot, 3)
    l0, l1 = cov[slot][: slot + 1], cov[slot + 1][: slot + 2]
    for i in range(D):
        if i < slot:
            row = cov[max(i, 2)]
            p, q = l0[i], l1[i]
            x, y, z = (
                (cov[max(i, 0), min(i, 0)], cov[max(i, 1), min(i, 1)], row[i]) if i < 3 else (row[0], row[1], row[2])
            )
        else:
            row = cov[i]
            x, y, z = row[0], row[1], row[2]
            p, q = row[slot], l1[slot] if i == slot else row[slot + 1]
        w0[i] = a0 * x + b0 * y + c0 * z + d0 * p + e0 * q
        w1[i] = a1 * x + b1 * y + c1 * z + d1 * p + e1 * q


@compiled("void(state, index, index)")
def project(state: Any, n: int, k: int) -> None:
    """w ← H P and S ← H P Hᵀ + R for the n sightings in ``state.slots``, k rows each: O(nkD).

    Each row of H has five entries: three in ``state.H_pose``, two in ``state.H_landmark``.
    """
    w, S, Hp, Hl, slots, noise = state.w, state.S, state.H_pose, state.H_landmark, state.slots, state.noise
    for j in range(n):
        # An odd last row is reckoned twice, to the same numbers.
        for r in range(0, k, 2):
            project_pair(state, slots[j], j * k + r, j * k + min(r + 1, k - 1))
    for j in range(n):
        for a in range(k):
            r = j * k + a
            wr = w[r]
            for i in range(j + 1):
                slot = slots[i]
                p, q = wr[slot], wr[slot + 1]
                for b in range(k if i < j else a + 1):
                    c = i * k + b
                    s = Hp[c, 0] * wr[0] + Hp[c, 1] * wr[1] + Hp[c, 2] * wr[2] + Hl[c, 0] * p + Hl[c, 1] * q
                    if i == j:
                        s += noise[r, b]
                    S[r, c] = S[c, r] = s


@compiled("real(state, real)")
def absorb(state: Any, gate: float) -> Any:
    """All that an update by one sighting of two rows needs, in one pass: its NIS, or -1 if S is not definite.

    S, L and t are written; where the NIS is within the gate w ← L⁻¹ H P and dx ← wᵀ t too: `project`, `cholesky`,
    `forward` and `whiten` for this case, which is nearly every case.
    """
    cov, Hp, Hl, y, t, S, L = state.cov, state.H_pose, state.H_landmark, state.y, state.t, state.S, state.L
    D, s = state.size[ACTIVE], max(state.slots[0], 3)
    a, b, c, d, e = Hp[0, 0], Hp[0, 1], Hp[0, 2], Hl[0, 0], Hl[0, 1]
    f, g, h, p, q = Hp[1, 0], Hp[1, 1], Hp[1, 2], Hl[1, 0], Hl[1, 1]
    l0, l1 = cov[s], cov[s + 1]
    p00, p10, p20, p11, p21, p22 = cov[0, 0], cov[1, 0], cov[2, 0], cov[1, 1], cov[2, 1], cov[2, 2]
    # P Hᵀ in the rows that H reads; sums in pairs, for the next one waits for each.
    u0 = (a * p00 + b * p10) + (c * p20 + d * l0[0]) + e * l1[0]
    u1 = (a * p10 + b * p11) + (c * p21 + d * l0[1]) + e * l1[1]
    u2 = (a * p20 + b * p21) + (c * p22 + d * l0[2]) + e * l1[2]
    u3 = (a * l0[0] + b * l0[1]) + (c * l0[2] + d * l0[s]) + e * l1[s]
    u4 = (a * l1[0] + b * l1[1]) + (c * l1[2] + d * l1[s]) + e * l1[s + 1]
    v0 = (f * p00 + g * p10) + (h * p20 + p * l0[0]) + q * l1[0]
    v1 = (f * p10 + g * p11) + (h * p21 + p * l0[1]) + q * l1[1]
    v2 = (f * p20 + g * p21) + (h * p22 + p * l0[2]) + q * l1[2]
    v3 = (f * l0[0] + g * l0[1]) + (h * l0[2] + p * l0[s]) + q * l1[s]
    v4 = (f * l1[0] + g * l1[1]) + (h * l1[2] + p * l1[s]) + q * l1[s + 1]
    S00 = (a * u0 + b * u1) + (c * u2 + d * u3) + (e * u4 + state.noise[0, 0])
    S10 = (a * v0 + b * v1) + (c * v2 + d * v3) + (e * v4 + state.noise[1, 0])
    S11 = (f * v0 + g * v1) + (h * v2 + p * v3) + (q * v4 + state.noise[1, 1])
    S[0, 0], S[0, 1], S[1, 0], S[1, 1] = S00, S10, S10, S11
    determinant = S00 * S11 - S10 * S10
    if not (S00 > 0.0 and isfinite(S00) and determinant > 0.0 and isfinite(determinant)):
        return -1.0
    # Two roots, then two divisions, each pair side by side: nothing else here takes as long.
    L00, root = sqrt(S00), sqrt(determinant)
    i0, i1 = 1.0 / L00, L00 / root
    L10, L11 = S10 * i0, root * i0
    L[0, 0], L[1, 0], L[1, 1] = L00, L10, L11
    t0 = y[0] * i0
    t1 = (y[1] - L10 * t0) * i1
    t[0], t[1] = t0, t1
    nis = t0 * t0 + t1 * t1
    if not nis <= gate:
        return nis
    # From here on the two rows of L⁻¹ H in the place of those of H.
    a, b, c, d, e = a * i0, b * i0, c * i0, d * i0, e * i0
    f, g, h = (f - L10 * a) * i1, (g - L10 * b) * i1, (h - L10 * c) * i1
    p, q = (p - L10 * d) * i1, (q - L10 * e) * i1
    w0, w1, dx = state.w[0], state.w[1], state.dx
    first, second, both = (a, b, c, d, e), (f, g, h, p, q), (t0, t1)
    project_first_four(cov, 0, s, first, second, both, w0, w1, dx)
    for i in range(4, D, 4):
        project_four(cov, i, s, first, second, both, w0, w1, dx)
    return nis


@compiled("flag(matrix, matrix, index, index)")
def cholesky(S: Any, L: Any, first: int, n: int) -> bool:
    """L Lᵀ = S for the n × n block that starts at row and column `first`; False where S is not positive definite.

    Only the lower triangles are read and written.
    """
    if n == 2:
        i = max(first, 0)
        p, q, r = S[i, i], S[i + 1, i], S[i + 1, i + 1]
        a = sqrt(p) if p > 0.0 else 0.0
        b = q / a
        c = r - b * b
        if not (a > 0.0 and isfinite(a) and c > 0.0 and isfinite(c)):
            return False
        L[i, i], L[i + 1, i], L[i + 1, i + 1] = a, b, sqrt(c)
        return True
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
    """w ← L⁻¹ w, then dx ← wᵀ t = K y."""
    D = state.size[ACTIVE]
    w, L, t, dx = state.w, state.L, state.t, state.dx[:D]
    for r in range(0, rows, 2):
        a = w[r][:D]
        for j in range(r):
            factor, other = L[r, j], w[j][:D]
            for i in range(D):
                a[i] -= factor * other[i]
        inverse, ta = 1.0 / L[r, r], t[r]
        if r + 1 == rows:
            for i in range(D):
                a[i] *= inverse
                dx[i] = ta * a[i] if r == 0 else dx[i] + ta * a[i]
            break
        b = w[r + 1][:D]
        for j in range(r):
            factor, other = L[r + 1, j], w[j][:D]
            for i in range(D):
                b[i] -= factor * other[i]
        below, last, tb = L[r + 1, r], 1.0 / L[r + 1, r + 1], t[r + 1]
        if r == 0:
            for i in range(D):
                x = a[i] * inverse
                y = (b[i] - below * x) * last
                a[i], b[i], dx[i] = x, y, ta * x + tb * y
        else:
            for i in range(D):
                x = a[i] * inverse
                y = (b[i] - below * x) * last
                a[i], b[i] = x, y
                dx[i] += ta * x + tb * y


@compiled("void(matrix, index, vector, vector)")
def subtract_pair(M: Any, n: int, a: Any, b: Any) -> None:
    """Lower triangle of M (n, n) ← M - aᵀa - bᵀb; what stands above it, and in up to three rows after it, is spoilt."""
    for i in range(0, n, 4):
        subtract_four_rows(M, i, a, b, a, b, i + 4)


@compiled("void(state, index)")
def downdate(state: Any, rows: int) -> None:
    """P ← P - wᵀw, a symmetric downdate of one triangle: O(rows · D²/2)."""
    cov, w = state.cov, state.w
    D = state.size[ACTIVE]
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
    C, D = state.size[COLUMNS], state.size[ACTIVE]
    Phi, Psi, g, L, Hp, Hl = state.Phi, state.minus_Psi, state.g, state.L, state.H_pose, state.H_landmark
    p0, p1, p2, theta = Phi[0][:C], Phi[1][:C], Phi[2][:C], state.theta[:C]
    for j in range(n):
        slot = state.slots[j]
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
            inverse, t = 1.0 / L[r, r], state.t[r]
            for i in range(C):
                out[i] *= inverse
                theta[i] += t * out[i]
    few, count = state.few, state.count
    if count[0] + n * k > few.shape[0]:
        count[0] = -1
    if count[0] >= 0:
        for r in range(n * k):
            row, out = g[r], few[count[0] + r]
            for i in range(few.shape[1]):
                out[i] = row[i] if i < C else 0.0
        count[0] += n * k
    for r in range(0, n * k, 2):
        # An odd last row goes with a row of zeros.
        last = r + 1 == n * k
        w0, w1 = state.w[r], state.dx if last else state.w[r + 1]
        g0, g1 = g[r], state.gathered[0] if last else g[r + 1]
        if last:
            for i in range(D):
                w1[i] = 0.0
            for i in range(C):
                g1[i] = 0.0
        for i in range(0, D, 4):
            subtract_four_rows(Phi, i, w0, w1, g0, g1, C)
        subtract_pair(Psi, C, g0, g1)


@compiled("void(state, index)")
def augment(state: Any, slot: int) -> None:
    """Append two rows: P_ls = G_pose P_xs, P_ll = G_pose P_xx G_poseᵀ + block, Φ_l = G_pose Φ_x. `slot` must be D.

    The block is written from the new rows, never by a column assignment that would overwrite it.
    """
    cov, G, block, Phi, size = state.cov, state.G_pose, state.block, state.Phi, state.size
    D = size[ACTIVE]
    gather(state, 0, 3)
    p0, p1, p2 = state.gathered[0][:D], state.gathered[1][:D], state.gathered[2][:D]
    for r in range(2):
        row = cov[slot + r][:D]
        a, b, c = G[r, 0], G[r, 1], G[r, 2]
        for i in range(D):
            row[i] = a * p0[i] + b * p1[i] + c * p2[i]
        for q in range(r + 1):
            cov[slot + r, slot + q] = row[0] * G[q, 0] + row[1] * G[q, 1] + row[2] * G[q, 2] + block[r, q]
        for j in range(size[COLUMNS]):
            Phi[slot + r, j] = a * Phi[0, j] + b * Phi[1, j] + c * Phi[2, j]
        state.owner[slot + r] = size[WHOLE]
        state.local[size[WHOLE]] = slot + r
        size[WHOLE] += 1
    size[ACTIVE] = D + 2


@compiled("void(state)")
def shear(state: Any) -> None:
    """P ← E P Eᵀ with E = I + e e_θᵀ, e = J(mean - points) for every position, then points ← mean; O(D²).

    It takes a covariance whose lever arms are taken at ``state.points`` to the current mean. The heading is entry 2.
    """
    cov, mean, points, e, g = state.cov, state.mean, state.points, state.gathered[3], state.gathered[4]
    D = state.size[ACTIVE]
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
def place(i: int, j: int) -> Any:
    """Where entry (i, j), i ≥ j, of the packed triangle stands."""
    p = i // PANEL
    return PANEL * (p + 1) * (i - PANEL // 2 * p) + j


@compiled("index(state, index, index)")
def place_in(state: Any, i: int, j: int) -> Any:
    """Where entry (i, j), i ≥ j, stands in ``state.store``."""
    lead = state.size[LEAD]
    return lead * i + j if lead > 0 else place(i, j)


@compiled("void(state, matrix)")
def relate(state: Any, M: Any) -> None:
    """Rows P⁰[i, A₀] in coordinates of the map ← the same with A₀ in its own: O(C) each."""
    columns, rest, C = state.columns, state.rest, M.shape[1]
    for i in range(M.shape[0]):
        row = M[i]
        a, b, heading = row[0], row[1], row[2]
        for c in range(3, C, 2):
            row[c] -= a - (rest[columns[c + 1]] - rest[1]) * heading
            row[c + 1] -= b + (rest[columns[c]] - rest[0]) * heading


@compiled("void(state, index, vector)")
def resting_row(state: Any, index: int, out: Any) -> None:
    """out ← P⁰[A₀, index], as the last flush leaves it even where it is not yet written."""
    columns, store, V = state.columns, state.store, state.V
    pending = V.shape[1]
    for c in range(state.size[COLUMNS]):
        i, j = max(columns[c], index), min(columns[c], index)
        total = store[place_in(state, i, j)]
        if i >= state.size[CORRECTED]:
            for r in range(pending):
                total -= V[i, r] * V[j, r]
        out[c] = total
    relate(state, out.reshape(1, out.shape[0]))


@compiled("index(state, index)")
def activate(state: Any, slot: int) -> Any:
    """Make the landmark that rests at `slot` of the map active: O(A²); its slot among the active.

    With c = P⁰[A₀, j]: P_jA = cᵀΦᵀ, P_jj = P⁰_jj - cᵀΨc, x_j = x⁰_j + cᵀϑ, Φ ← [[Φ, 0], [B - cᵀΨ, I]], where
    B = [I, J(l_j - p)] on the pose takes the landmark from its coordinates in A₀ to those of the map.
    """
    size, cov, Phi, Psi, theta, g = state.size, state.cov, state.Phi, state.minus_Psi, state.theta, state.g
    D, C = size[ACTIVE], size[COLUMNS]
    column, product = state.gathered[3][:C], state.gathered[4][:C]
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
        state.mean[new] = state.rest[index]
        for i in range(C):
            state.mean[new] += column[i] * theta[i]
        state.points[new] = state.rest_points[index]
        for i in range(D):
            total, row = 0.0, Phi[i][:C]
            for j in range(C):
                total += row[j] * column[j]
            cov[new, i] = total
        # P_jj, and for the second coordinate the entry beside it too; `product` is -Ψc, for -Ψ is what is kept.
        for q in range(r + 1):
            i, j = index, slot + q
            total = state.store[place_in(state, i, j)]
            if i >= size[CORRECTED]:
                for p in range(state.V.shape[1]):
                    total -= state.V[i, p] * state.V[j, p]
            other = column if q == r else state.dx[:C]
            for p in range(C):
                total += product[p] * other[p]
            cov[new, D + q] = total
        for j in range(C):
            Phi[new, j] = product[j]
        if r == 0:
            for p in range(C):
                state.dx[p] = column[p]
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
    Phi[D, 0] += 1.0
    Phi[D, 2] -= state.rest[slot + 1] - state.rest[1]
    Phi[D + 1, 1] += 1.0
    Phi[D + 1, 2] += state.rest[slot] - state.rest[0]
    size[ACTIVE], size[COLUMNS] = D + 2, C + 2
    return D


@compiled("void(state, matrix)")
def collect(state: Any, V: Any) -> None:
    """V (whole, C) ← P⁰[:, A₀] of a packed store; nothing may be pending."""
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
    relate(state, V)


@compiled("void(state, matrix)")
def deposit(state: Any, X: Any) -> None:
    """Write P_bA = X (whole, D) and P_AA into a packed store; the rows of A in X are not read."""
    owner, local, store, cov = state.owner, state.local, state.store, state.cov
    D = state.size[ACTIVE]
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


@compiled("void(state, matrix)")
def collect_rows(state: Any, M: Any) -> None:
    """M (C, n) ← P⁰[A₀, :n] of a square store, related as `relate` does it."""
    columns, rest, store, lead = state.columns, state.rest, state.store, state.size[LEAD]
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


@compiled("void(state, matrix, vector)")
def scaled(state: Any, A: Any, scale: Any) -> None:
    """Ψ = diag(scale) A diag(scale) with ones on A's diagonal, or zeros; of A (C, C) the lower triangle, beside zeros.

    With a diagonal of ones what a decomposition of A cuts off is within rounding of every entry, whatever its unit.
    """
    Psi, C = state.minus_Psi, A.shape[0]
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


@compiled("void(state, index, matrix, integers)")
def factors(state: Any, rank: int, X: Any, added: Any) -> None:
    """Rows of X that M = P⁰[A₀, b] is to be multiplied by for all that a flush of b needs.

    The first `rank` rows are there, B with BᵀB = Ψ and rows of zeros. Then come ϑ, Φ of what is `added`, and L⁻¹HΦ.
    That is filled in, too: the active coordinates of the base and of landmarks that do not stand in the store yet.
    """
    C, at = state.size[COLUMNS], rank
    for c in range(C):
        X[at, c] = state.theta[c]
    known = 3
    for a in range(state.size[ACTIVE]):
        if a >= 3 and known < C and state.columns[known] == state.owner[a]:
            known += 1
            continue
        added[a - known + 3] = a
        at += 1
        for c in range(C):
            X[at, c] = state.Phi[a, c]
    for r in range(X.shape[0] - 1 - at):
        for c in range(C):
            X[at + 1 + r, c] = state.g[r, c]


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

    W = X P⁰[A₀, :], X and `added` of `factors`. V is room for the tiles of the first rows of W. `gain` becomes
    L⁻¹ H P (rows, D) of the last update, where that was made of what is active.
    """
    size, cov, rest, owner = state.size, state.cov, state.rest, state.owner
    D, whole, lead, n = size[ACTIVE], size[WHOLE], size[LEAD], W.shape[1]
    at = V.shape[0] // n
    tile(W, at, V)
    downdate_square(state.store, target, same, cached, lead, V, n)
    row = W[at]
    for j in range(whole):
        rest[j] += row[j]
    for a in range(D):
        rest[owner[a]], state.rest_points[owner[a]] = state.mean[a], state.points[a]
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
            out[j] = row[j] if j < size[WHOLE_THEN] else 0.0
        for a in range(size[ACTIVE_THEN]):
            out[owner[a]] = state.w[r, a]
    if gain.shape[0] > 0:
        size[ACTIVE_THEN] = -1
    keep_base(state)


@compiled("void(state)")
def keep_base(state: Any) -> None:
    """After a flush only the base is active."""
    size, owner, Phi, Psi = state.size, state.owner, state.Phi, state.minus_Psi
    for a in range(size[ACTIVE]):
        state.local[owner[a]] = -1
    for i in range(3):
        state.local[i] = owner[i] = state.columns[i] = i
        state.theta[i] = 0.0
        for j in range(3):
            Phi[i, j], Psi[i, j] = 0.0, 0.0
        Phi[i, i] = 1.0
    size[ACTIVE] = size[COLUMNS] = 3
    state.work[DEBT] = state.work[SPENT] = state.work[SPENT_PLAIN] = 0.0
    state.count[0] = 0


@compiled("void(matrix, index, vector)")
def pack(M: Any, n: int, store: Any) -> None:
    """Pack the lower triangle of M (n, n)."""
    for i in range(n):
        row, start = M[i], place(i, 0)
        for j in range(i + 1):
            store[start + j] = row[j]


@compiled("void(vector, matrix)")
def expand(store: Any, M: Any) -> None:
    """First n columns of M (n, lead), symmetric, ← a packed triangle.

    Eight rows of M at a time take what stands above the diagonal.
    """
    n, lead = M.shape
    flat = M.reshape(n * lead)
    for first in range(0, n, PANEL):
        width, last = first + PANEL, min(first + PANEL, n)
        start = place(first, 0)
        panel = store[start : start + PANEL * width]
        for i in range(last - first):
            row, a = M[first + i], panel[i * width :]
            for j in range(first + i + 1):
                row[j] = a[j]
        for left in range(0, first, 8):
            at = left * lead + first
            for i in range(last - first):
                a = panel[i * width + left : i * width + left + 8]
                for j in range(8):
                    flat[at + j * lead + i] = a[j]
        for j in range(first, last):
            for i in range(j + 1, last):
                M[j, i] = panel[(i - first) * width + j]


@compiled("void(vector, index, index)")
def squeeze(store: Any, slot: int, n: int) -> None:
    """Take rows and columns slot, slot + 1 out of a packed triangle of n rows, in place."""
    for i in range(slot + 2, n):
        source, target = place(i, 0), place(i - 2, 0)
        for j in range(slot):
            store[target + j] = store[source + j]
        for j in range(slot + 2, i + 1):
            store[target + j - 2] = store[source + j]


# -- a small belief before a step -------------------------------------------------------------------------------------


@compiled("void(state)")
def save(state: Any) -> None:
    """Keep a small belief, nothing of which rests, and its last update, of at most two rows."""
    saved, D, n = state.saved, state.size[ACTIVE], state.mean.shape[0]
    for i in range(6):
        saved[i] = state.memory[i]
    for r in range(2):
        out = saved[6 + 7 * r : 13 + 7 * r]
        out[0], out[1], out[2] = state.z[r], state.y[r], state.t[r]
        out[3], out[4] = state.S[r, 0], state.S[r, 1]
        out[5], out[6] = state.L[r, 0], state.L[r, 1]
        copy_fours(state.w, r * n, saved, 20 + r * n, D)
    copy_fours(state.mean, 0, saved, 20 + 2 * n, D)
    copy_fours(state.points, 0, saved, 20 + 3 * n, D)
    for i in range(D):
        copy_fours(state.cov, i * n, saved, 20 + (4 + i) * n, i + 1)


@compiled("void(state, index)")
def undo(state: Any, D: int) -> None:
    """Bring back what `save` has kept of a belief of D dimensions."""
    saved, size, n = state.saved, state.size, state.mean.shape[0]
    for i in range(6):
        state.memory[i] = saved[i]
    for r in range(2):
        out = saved[6 + 7 * r : 13 + 7 * r]
        state.z[r], state.y[r], state.t[r] = out[0], out[1], out[2]
        state.S[r, 0], state.S[r, 1] = out[3], out[4]
        state.L[r, 0], state.L[r, 1] = out[5], out[6]
        copy_fours(saved, 20 + r * n, state.w, r * n, D)
    copy_fours(saved, 20 + 2 * n, state.mean, 0, D)
    copy_fours(saved, 20 + 3 * n, state.points, 0, D)
    for i in range(D):
        copy_fours(saved, 20 + (4 + i) * n, state.cov, i * n, i + 1)
    for i in range(D, size[ACTIVE]):
        state.local[i] = -1
    size[ACTIVE] = size[WHOLE] = D
