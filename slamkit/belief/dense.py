"""Compiled linear algebra on the active part of the covariance, a dense lower triangle.

``state.belief.cov`` holds the lower triangle of P_AA, A being what is active and D = ``state.belief.active`` its
dimension. What stands above the diagonal means nothing. Where part of the map rests, these functions keep Φ up to date
too; :mod:`slamkit.belief.compressed` has the equations.
"""

from __future__ import annotations

from math import isfinite, sqrt
from typing import Any

from slamkit.compiled import compiled, intrinsics

#: ``(M, i, x, y, a, b, n)``: rows i … i + 3 of M -= x[i] a + y[i] b in their first n columns at least. Arrays must have
#: room up to a multiple of four rows and columns; what they hold there means nothing.
(subtract_four_rows,) = intrinsics("simd", "subtract_four_rows")

project_four, project_first_four = intrinsics("simd", "project_four", "project_first_four")


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

    Reads ``state.last.F`` and ``state.last.Q``; Q is taken symmetric.
    """
    cov, F, Q, Phi = state.belief.cov, state.last.F, state.last.Q, state.resting.Phi
    D = state.belief.active
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
    for j in range(state.resting.columns):
        a, b, c = Phi[0, j], Phi[1, j], Phi[2, j]
        Phi[0, j] = f00 * a + f01 * b + f02 * c
        Phi[1, j] = f10 * a + f11 * b + f12 * c
        Phi[2, j] = f20 * a + f21 * b + f22 * c


@compiled("void(state, index, index)")
def gather(state: Any, slot: int, count: int) -> None:
    """Copy rows slot … slot+count-1 of the symmetric P into the last rows of ``state.scratch.gathered``."""
    cov = state.belief.cov
    D = state.belief.active
    for r in range(count):
        source = slot + r
        out, row = state.scratch.gathered[5 - count + r] if count == 2 else state.scratch.gathered[r], cov[source]
        for i in range(source + 1):
            out[i] = row[i]
    if count == 2:
        a, b = state.scratch.gathered[3], state.scratch.gathered[4]
        a[slot + 1] = cov[slot + 1, slot]
        for i in range(slot + 2, D):
            row = cov[i]
            a[i] = row[slot]
            b[i] = row[slot + 1]
    else:
        a, b, c = state.scratch.gathered[0], state.scratch.gathered[1], state.scratch.gathered[2]
        a[1], a[2], b[2] = cov[1, 0], cov[2, 0], cov[2, 1]
        for i in range(3, D):
            row = cov[i]
            a[i] = row[0]
            b[i] = row[1]
            c[i] = row[2]


@compiled("void(state, index, index, index)")
def project_pair(state: Any, slot: int, first: int, second: int) -> None:
    """Rows `first` and `second` of w ← those of H P, for two rows of H that concern one landmark, in one pass."""
    cov, Hp, Hl = state.belief.cov, state.scratch.H_pose, state.scratch.H_landmark
    D = state.belief.active
    w0, w1 = state.last.w[first][:D], state.last.w[second][:D]
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
    """w ← H P and S ← H P Hᵀ + R for the n sightings in ``state.scratch.slots``, k rows each: O(nkD).

    Each row of H has five entries: three in ``scratch.H_pose``, two in ``scratch.H_landmark``.
    """
    w, S, Hp, Hl, slots, noise = (
        state.last.w,
        state.last.S,
        state.scratch.H_pose,
        state.scratch.H_landmark,
        state.scratch.slots,
        state.scratch.noise,
    )
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
def project_and_gate(state: Any, gate: float) -> Any:
    """Everything an update by one sighting of two rows needs, in one pass; gives its NIS, or -1 if S is not definite.

    S, L and t are written; where the NIS is within the gate w ← L⁻¹ H P and dx ← wᵀ t too: `project`, `cholesky`,
    `forward` and `whiten` for this case, which is nearly every case.
    """
    cov, Hp, Hl, y, t, S, L = (
        state.belief.cov,
        state.scratch.H_pose,
        state.scratch.H_landmark,
        state.last.y,
        state.last.t,
        state.last.S,
        state.last.L,
    )
    D, s = state.belief.active, max(state.scratch.slots[0], 3)
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
    S00 = (a * u0 + b * u1) + (c * u2 + d * u3) + (e * u4 + state.scratch.noise[0, 0])
    S10 = (a * v0 + b * v1) + (c * v2 + d * v3) + (e * v4 + state.scratch.noise[1, 0])
    S11 = (f * v0 + g * v1) + (h * v2 + p * v3) + (q * v4 + state.scratch.noise[1, 1])
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
    w0, w1, dx = state.last.w[0], state.last.w[1], state.scratch.dx
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
    D = state.belief.active
    w, L, t, dx = state.last.w, state.last.L, state.last.t, state.scratch.dx[:D]
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
    """Lower triangle of M (n, n) ← M - aᵀa - bᵀb. Entries above it, and up to three rows after it, are overwritten."""
    for i in range(0, n, 4):
        subtract_four_rows(M, i, a, b, a, b, i + 4)


@compiled("void(state, index)")
def downdate(state: Any, rows: int) -> None:
    """P ← P - wᵀw, a symmetric downdate of one triangle: O(rows · D²/2)."""
    cov, w = state.belief.cov, state.last.w
    D = state.belief.active
    for r in range(0, rows - 1, 2):
        subtract_pair(cov, D, w[r], w[r + 1])
    if rows % 2 == 1:
        a = w[rows - 1]
        for i in range(D):
            row, left = cov[i][: i + 1], a[: i + 1]
            x = a[i]
            for j in range(i + 1):
                row[j] -= x * left[j]


@compiled("void(state, index)")
def augment(state: Any, slot: int) -> None:
    """Append two rows: P_ls = G_pose P_xs, P_ll = G_pose P_xx G_poseᵀ + block, Φ_l = G_pose Φ_x. `slot` must be D.

    The block is written from the new rows, never by a column assignment that would overwrite it.
    """
    cov, G, block, Phi = state.belief.cov, state.scratch.G_pose, state.scratch.block, state.resting.Phi
    D = state.belief.active
    gather(state, 0, 3)
    p0, p1, p2 = state.scratch.gathered[0][:D], state.scratch.gathered[1][:D], state.scratch.gathered[2][:D]
    for r in range(2):
        row = cov[slot + r][:D]
        a, b, c = G[r, 0], G[r, 1], G[r, 2]
        for i in range(D):
            row[i] = a * p0[i] + b * p1[i] + c * p2[i]
        for q in range(r + 1):
            cov[slot + r, slot + q] = row[0] * G[q, 0] + row[1] * G[q, 1] + row[2] * G[q, 2] + block[r, q]
        for j in range(state.resting.columns):
            Phi[slot + r, j] = a * Phi[0, j] + b * Phi[1, j] + c * Phi[2, j]
        state.belief.owner[slot + r] = state.belief.dim
        state.belief.local[state.belief.dim] = slot + r
        state.belief.dim += 1
    state.belief.active = D + 2


@compiled("void(state)")
def shear(state: Any) -> None:
    """P ← E P Eᵀ with E = I + e e_θᵀ, e = J(mean - points) for every position, then points ← mean; O(D²).

    It moves the lever arms of a covariance from ``state.belief.linearised_at`` to the current mean. The heading is
    entry 2.
    """
    cov, mean, points, e, g = (
        state.belief.cov,
        state.belief.mean,
        state.belief.linearised_at,
        state.scratch.gathered[3],
        state.scratch.gathered[4],
    )
    D = state.belief.active
    moved = False
    for i in range(D):
        if i != 2 and mean[i] != points[i]:
            moved = True
    if moved:
        gather(state, 0, 3)
        heading = state.scratch.gathered[2]
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
