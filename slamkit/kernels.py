"""The linear algebra under a belief: the covariance's lower triangle, and nothing of robots.

``state.cov`` holds P's lower triangle; what stands above the diagonal means nothing. D = ``state.size[0]``.
"""

from __future__ import annotations

from math import isfinite, sqrt
from typing import Any

from slamkit.compiled import compiled

__all__ = [
    "all_finite",
    "augment",
    "cholesky",
    "correction",
    "downdate",
    "forward",
    "is_finite",
    "project",
    "propagate",
    "shear",
    "whiten",
]


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
    cov, F, Q = state.cov, state.F, state.Q
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


@compiled("void(state, index)")
def downdate(state: Any, rows: int) -> None:
    """P ← P - wᵀw, a symmetric downdate of one triangle: O(rows · D²/2)."""
    cov, w = state.cov, state.w
    D = state.size[0]
    for r in range(0, rows - 1, 2):
        a, b = w[r], w[r + 1]
        for i in range(D):
            row, left, right = cov[i][: i + 1], a[: i + 1], b[: i + 1]
            x, y = a[i], b[i]
            for j in range(i + 1):
                row[j] -= x * left[j] + y * right[j]
    if rows % 2 == 1:
        a = w[rows - 1]
        for i in range(D):
            row, left = cov[i][: i + 1], a[: i + 1]
            x = a[i]
            for j in range(i + 1):
                row[j] -= x * left[j]


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
    """Append two rows: P_ls = G_pose P_xs, P_ll = G_pose P_xx G_poseᵀ + block. `slot` must be D.

    The block is written from the new rows, never by a column assignment that would overwrite it.
    """
    cov, G, block = state.cov, state.G_pose, state.block
    D = state.size[0]
    gather(state, 0, 3)
    p0, p1, p2 = state.gathered[0][:D], state.gathered[1][:D], state.gathered[2][:D]
    for r in range(2):
        row = cov[slot + r][:D]
        a, b, c = G[r, 0], G[r, 1], G[r, 2]
        for i in range(D):
            row[i] = a * p0[i] + b * p1[i] + c * p2[i]
        for q in range(r + 1):
            cov[slot + r, slot + q] = row[0] * G[q, 0] + row[1] * G[q, 1] + row[2] * G[q, 2] + block[r, q]
    state.size[0] = D + 2


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
