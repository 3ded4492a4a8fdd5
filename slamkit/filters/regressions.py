"""What the unscented filters compile: roots, moments, and the regressions that stand where others have Jacobians."""

from __future__ import annotations

from math import cos, isfinite, sin, sqrt
from typing import Any

import numpy as np

from slamkit.belief.dense import cholesky, forward, is_finite, whiten
from slamkit.compiled import OwnFields, compiled
from slamkit.cycle.linearise import record_non_finite
from slamkit.cycle.standard import initialise as jacobian_initialise
from slamkit.cycle.standard import sensor as jacobian_sensor
from slamkit.cycle.status import NOT_DEFINITE
from slamkit.cycle.update import commit_update, gate_sightings, record_all_rejected
from slamkit.se2 import wrap_angle

# Sigma points x ± s T lᵢ, where lᵢ are the columns of chol(Tᵀ P T) and T turns positions into robot axes: with the
# root taken there the filter does not depend on the choice of the world's axes. With half = (f₊ - f₋)/2s and the
# weights of van der Merwe, the regression of f on x is H̄ T L = [half₁ … half_n]; the mean of f is f₀ + m.
# The estimator's own fields are α, β and κ.
own = OwnFields(alpha=1, beta=1, kappa=1)

#: A direction of the state without uncertainty is probed at this distance [m, rad], so that the regression exists
#: there too. The covariance is not touched: it multiplies what is found in this direction by zero.
PROBE = 1e-6


@compiled("void(matrix, matrix, index, real)")
def root(P: Any, L: Any, n: int, floor: float) -> None:
    """L ← lower Cholesky factor of a positive semidefinite P (n, n), its pivots not below `floor`."""
    for i in range(n):
        for j in range(n):
            L[i, j] = 0.0
    for j in range(n):
        s = P[j, j]
        for q in range(j):
            s -= L[j, q] * L[j, q]
        if s <= floor * floor:
            L[j, j] = floor
            continue
        L[j, j] = sqrt(s)
        for i in range(j + 1, n):
            s = P[i, j]
            for q in range(j):
                s -= L[i, q] * L[j, q]
            L[i, j] = s / L[j, j]


@compiled("void(matrix, matrix)")
def copy(M: Any, out: Any) -> None:
    """out ← the corner of M that has its shape."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = M[i, j]


@compiled("void(matrix, matrix, matrix, index, index)")
def unwhiten(half: Any, L: Any, out: Any, rows: int, n: int) -> None:
    """out ← half L⁻¹ for a lower triangular L (n, n)."""
    for r in range(rows):
        for i in range(n - 1, -1, -1):
            s = half[r, i]
            for j in range(i + 1, n):
                s -= out[r, j] * L[j, i]
            out[r, i] = s / L[i, i]


@compiled("void(state, matrix, matrix, matrix, matrix, vector, index, index, index)")
def moments(state: Any, plus: Any, minus: Any, half: Any, extra: Any, mean: Any, rows: int, n: int, total: int) -> None:
    """From differences to f₀ at the sigma points (n, rows): shift of the mean, half differences, regression error.

    extra = P_ff - (H̄ T L)(H̄ T L)ᵀ, what a linear function of x cannot explain of f. In the further directions, up to
    `total`, f does not change.
    """
    alpha, beta, kappa = own(state).alpha, own(state).beta, own(state).kappa
    spread = alpha * alpha * (total + kappa)
    s = sqrt(spread)
    weight = 0.5 / spread
    # The centre's own weight, and that of the points at which f is what it is there.
    centre = (spread - total) / spread + 1.0 - alpha * alpha + beta + 2.0 * weight * (total - n)
    for r in range(rows):
        mean[r] = 0.0
        for i in range(n):
            mean[r] += weight * (plus[i, r] + minus[i, r])
            half[r, i] = 0.5 * (plus[i, r] - minus[i, r]) / s
    for r in range(rows):
        for q in range(rows):
            error = centre * mean[r] * mean[q]
            for i in range(n):
                error += weight * (
                    (plus[i, r] - mean[r]) * (plus[i, q] - mean[q]) + (minus[i, r] - mean[r]) * (minus[i, q] - mean[q])
                )
                error -= half[r, i] * half[q, i]
            extra[r, q] = error


@compiled("real(state, index)")
def spread(state: Any, n: int) -> float:
    """How many standard deviations the sigma points lie from the mean: α √(n + κ)."""
    return float(own(state).alpha * sqrt(n + own(state).kappa))


@compiled("void(state, index, matrix)")
def local_root(state: Any, slot: int, L: Any) -> None:
    """L ← root in robot axes of the covariance of the pose, and of the landmark at `slot` unless that is 0."""
    n = 5 if slot > 0 else 3
    P, cov = np.empty((5, 5)), state.belief.cov
    for i in range(3):
        for j in range(i + 1):
            P[i, j] = P[j, i] = cov[i, j]
    for a in range(n - 3):
        for j in range(3):
            P[3 + a, j] = P[j, 3 + a] = cov[slot + a, j]
        for b in range(a + 1):
            P[3 + a, 3 + b] = P[3 + b, 3 + a] = cov[slot + a, slot + b]
    turn_rows(P, n, -state.belief.mean[2])
    turn_columns(P, n, n, -state.belief.mean[2])
    root(P, L, n, PROBE)


@compiled("void(matrix, index, real)")
def turn_rows(M: Any, n: int, angle: float) -> None:
    """Rotate rows (0, 1), (3, 4), (5, 6), … of the first n by `angle`: diag(R, 1, R, …) M."""
    c, s = cos(angle), sin(angle)
    for pair in range((n - 1) // 2):
        k = 2 * pair + 1 if pair > 0 else 0
        for j in range(M.shape[1]):
            x, y = M[k, j], M[k + 1, j]
            M[k, j], M[k + 1, j] = c * x - s * y, s * x + c * y


@compiled("void(matrix, index, index, real)")
def turn_columns(M: Any, rows: int, n: int, angle: float) -> None:
    """Rotate columns (0, 1), (3, 4), (5, 6), … of the first n by `angle`: M diag(R, 1, R, …)ᵀ."""
    c, s = cos(angle), sin(angle)
    for i in range(rows):
        for pair in range((n - 1) // 2):
            k = 2 * pair + 1 if pair > 0 else 0
            x, y = M[i, k], M[i, k + 1]
            M[i, k], M[i, k + 1] = c * x - s * y, s * x + c * y


@compiled("void(models, state, vector, real, index)", generic=True)
def regress_motion(models: Any, state: Any, u: Any, dt: float, total: int) -> None:
    """Regression over sigma points of the pose and the control's noise: F = P_x'x P_xx⁻¹, Q the rest.

    They are among those of `total` dimensions, in whose others nothing moves.
    """
    m = u.shape[0]
    n = 3 + m
    pose, params = state.belief.mean[:3], models.motion_params
    L, columns, L_u = np.zeros((5, 5)), np.empty((3, 3)), np.empty((m, m))
    local_root(state, 0, L)
    copy(L, columns)
    turn_rows(columns, 3, pose[2])
    models.control_noise(u, dt, params, state.scratch.sigma_u)
    root(state.scratch.sigma_u, L_u, m, 0.0)
    s = spread(state, total)
    centre, moved, point, noisy = np.empty(3), np.empty(3), np.empty(3), np.empty(m)
    models.move(pose, u, dt, params, centre)
    plus, minus = np.empty((n, 3)), np.empty((n, 3))
    for i in range(n):
        for side in range(2):
            step = s if side == 0 else -s
            out = plus[i] if side == 0 else minus[i]
            for j in range(3):
                point[j] = pose[j] + (step * columns[j, i] if i < 3 else 0.0)
            for j in range(m):
                noisy[j] = u[j] + (step * L_u[j, i - 3] if i >= 3 else 0.0)
            models.move(point, noisy, dt, params, moved)
            out[0], out[1], out[2] = moved[0] - centre[0], moved[1] - centre[1], wrap_angle(moved[2] - centre[2])
    half, error, mean = np.empty((3, n)), np.empty((3, 3)), np.empty(3)
    moments(state, plus, minus, half, error, mean, 3, n, total)
    unwhiten(half, L, state.last.F, 3, 3)
    turn_columns(state.last.F, 3, 3, pose[2])
    for j in range(3):
        state.scratch.pose[j] = centre[j] + mean[j]
    state.scratch.pose[2] = wrap_angle(state.scratch.pose[2])
    # The regression explains what comes from the pose; the control's share of the spread is noise.
    models.pose_noise(pose, u, dt, params, state.last.Q)
    for i in range(3):
        for j in range(3):
            state.last.Q[i, j] += error[i, j]
            for a in range(3, n):
                state.last.Q[i, j] += half[i, a] * half[j, a]


@compiled("void(models, state, vector, real)", generic=True)
def motion(models: Any, state: Any, u: Any, dt: float) -> None:
    """Sigma points of the pose and the control's noise."""
    regress_motion(models, state, u, dt, 3 + u.shape[0])


@compiled("void(models, vector, vector, matrix, real, vector, matrix, matrix)", generic=True)
def sight(
    models: Any, pose: Any, landmark: Any, columns: Any, distance: float, at_mean: Any, plus: Any, minus: Any
) -> None:
    """What the sensor gives at (pose, landmark), and how that differs at this distance along ± each column (5, 5)."""
    params, predicted, point = models.sensor_params, np.empty(at_mean.shape[0]), np.empty(5)
    models.predict(pose, landmark, params, at_mean)
    for i in range(5):
        for side in range(2):
            step = distance if side == 0 else -distance
            for j in range(3):
                point[j] = pose[j] + step * columns[j, i]
            for j in range(2):
                point[3 + j] = landmark[j] + step * columns[3 + j, i]
            models.predict(point[:3], point[3:], params, predicted)
            models.residual(predicted, at_mean, params, plus[i] if side == 0 else minus[i])


@compiled("flag(matrix, matrix, matrix, index, index)")
def explains(half: Any, error: Any, R: Any, first: int, n: int) -> bool:
    """Whether a sighting, from row `first` on, varies more by its linear part and its noise than by the rest."""
    for r in range(first, first + R.shape[0]):
        variance = R[r - first, r - first]
        for i in range(n):
            variance += half[r, i] * half[r, i]
        if not error[r, r] <= variance:
            return False
    return True


@compiled("flag(models, state, vector, vector, index)", generic=True)
def smooth(models: Any, state: Any, pose: Any, landmark: Any, slot: int) -> bool:
    """Whether the sensor's curvature at the sigma points is what it is one standard deviation from the mean.

    Near a kink or a pole (a landmark under the robot) it is not: extrapolated from close sigma points, it gives a
    mean and a variance that no distribution can have.
    """
    k, R, s = models.R.shape[0], models.R, spread(state, 5)
    L, columns, at_mean = np.zeros((5, 5)), np.empty((5, 5)), np.empty(k)
    plus, minus, far_plus, far_minus = np.empty((5, k)), np.empty((5, k)), np.empty((5, k)), np.empty((5, k))
    local_root(state, slot, L)
    copy(L, columns)
    turn_rows(columns, 5, pose[2])
    sight(models, pose, landmark, columns, s, at_mean, plus, minus)
    sight(models, pose, landmark, columns, 1.0, at_mean, far_plus, far_minus)
    for i in range(5):
        for r in range(k):
            bend, far = abs(plus[i, r] + minus[i, r]) / (s * s), abs(far_plus[i, r] + far_minus[i, r])
            if not bend <= 2.0 * far + sqrt(R[r, r]):
                return False
    return True


@compiled("void(models, state, vector, vector, index, vector, index)", generic=True)
def sensor(models: Any, state: Any, pose: Any, landmark: Any, slot: int, z: Any, row: int) -> None:
    """Regression over sigma points of the pose and this landmark: H = P_xzᵀ P⁻¹, its error added to the noise.

    Where the sensor is not smooth enough for one, its Jacobians.
    """
    k = z.shape[0]
    params = models.sensor_params
    L, columns, out, at_mean = np.zeros((5, 5)), np.empty((5, 5)), np.empty((k, 5)), np.empty(k)
    local_root(state, slot, L)
    copy(L, columns)
    turn_rows(columns, 5, pose[2])
    plus, minus = np.empty((5, k)), np.empty((5, k))
    sight(models, pose, landmark, columns, spread(state, 5), at_mean, plus, minus)
    half, error, mean = np.empty((k, 5)), np.empty((k, k)), np.empty(k)
    moments(state, plus, minus, half, error, mean, k, 5, 5)
    if not explains(half, error, models.R, 0, 5) and not smooth(models, state, pose, landmark, slot):
        jacobian_sensor(models, state, pose, landmark, slot, z, row)
        return
    unwhiten(half, L, out, k, 5)
    turn_columns(out, k, 5, pose[2])
    for r in range(k):
        for i in range(3):
            state.scratch.H_pose[row + r, i] = out[r, i]
        for i in range(2):
            state.scratch.H_landmark[row + r, i] = out[r, 3 + i]
        state.scratch.z_hat[r] = at_mean[r] + mean[r]
        for q in range(k):
            state.scratch.noise[row + r, q] = models.R[r, q] + error[r, q]
    models.residual(z, state.scratch.z_hat, params, state.last.y[row : row + k])


@compiled("void(models, state, index, vector, index)", generic=True)
def regress_initialise(models: Any, state: Any, slot: int, z: Any, total: int) -> None:
    """Regression over sigma points of the pose and the measurement's noise, among those of `total` dimensions."""
    k = z.shape[0]
    n = 3 + k
    pose, params = state.belief.mean[:3], models.sensor_params
    L, columns, L_z = np.zeros((5, 5)), np.empty((3, 3)), np.empty((k, k))
    local_root(state, 0, L)
    copy(L, columns)
    turn_rows(columns, 3, pose[2])
    root(models.R, L_z, k, 0.0)
    s = spread(state, total)
    centre, point, noisy, plus, minus = np.empty(2), np.empty(3), np.empty(k), np.empty((n, 2)), np.empty((n, 2))
    models.invert(pose, z, params, centre)
    for i in range(n):
        for side in range(2):
            step = s if side == 0 else -s
            out = plus[i] if side == 0 else minus[i]
            for j in range(3):
                point[j] = pose[j] + (step * columns[j, i] if i < 3 else 0.0)
            for j in range(k):
                noisy[j] = z[j] + (step * L_z[j, i - 3] if i >= 3 else 0.0)
            models.invert(point, noisy, params, out)
            for j in range(2):
                out[j] -= centre[j]
    half, error, mean = np.empty((2, n)), np.empty((2, 2)), np.empty(2)
    moments(state, plus, minus, half, error, mean, 2, n, total)
    # A noise wider than the range leads to a range below zero, which has no inverse.
    if not (isfinite(error[0, 0]) and isfinite(error[1, 1])):
        jacobian_initialise(models, state, slot, 0, z)
        return
    unwhiten(half, L, state.scratch.G_pose, 2, 3)
    turn_columns(state.scratch.G_pose, 2, 3, pose[2])
    for i in range(2):
        state.belief.mean[slot + i] = centre[i] + mean[i]
        for j in range(2):
            state.scratch.block[i, j] = error[i, j]
            for a in range(3, n):
                state.scratch.block[i, j] += half[i, a] * half[j, a]


@compiled("void(models, state, index, index, vector)", generic=True)
def initialise(models: Any, state: Any, slot: int, place: int, z: Any) -> None:
    """Sigma points of the pose and the measurement's noise."""
    regress_initialise(models, state, slot, z, 3 + z.shape[0])


# -- sigma points over the whole state --------------------------------------------------------------------------------


@compiled("void(models, state, vector, real)", generic=True)
def whole_motion(models: Any, state: Any, u: Any, dt: float) -> None:
    """Sigma points of the whole state and the control's noise; only those of the pose move anything."""
    regress_motion(models, state, u, dt, state.belief.active + u.shape[0])


@compiled("void(models, state, index, index, vector)", generic=True)
def whole_initialise(models: Any, state: Any, slot: int, place: int, z: Any) -> None:
    """Sigma points of the whole state and the measurement's noise; only those of the pose matter."""
    regress_initialise(models, state, slot, z, state.belief.active + z.shape[0])


@compiled("void(matrix, real, index, real, matrix)")
def whole_columns(P: Any, heading: float, count: int, floor: float, C: Any) -> None:
    """First `count` columns of C (D, D) ← T chol(Tᵀ P T), pivots not below `floor`; the others mean nothing.

    Of P only the lower triangle is read. Row by row, so that the inner loop runs along memory.
    """
    D = C.shape[0]
    column = np.empty(D)
    for i in range(D):
        for j in range(i + 1):
            C[i, j] = C[j, i] = P[i, j]
    turn_rows(C, D, -heading)
    turn_columns(C, D, D, -heading)
    for j in range(count):
        pivot = C[j, j]
        known = pivot <= floor * floor
        C[j, j] = floor if known else sqrt(pivot)
        for i in range(j + 1, D):
            column[i] = C[i, j] = 0.0 if known else C[i, j] / C[j, j]
            C[j, i] = 0.0
        for i in range(j + 1, D):
            x, row, other = column[i], C[i][: i + 1], column[: i + 1]
            for q in range(j + 1, i + 1):
                row[q] -= x * other[q]
    turn_rows(C, D, heading)


@compiled("void(state, index, index, index, matrix, matrix, matrix, vector)")
def differentiate(state: Any, slot: int, first: int, k: int, C: Any, half: Any, error: Any, shift: Any) -> None:
    """Rows of a sighting, from `first` on, by the sensor's Jacobians instead of a regression."""
    H, H_landmark = state.scratch.H_pose, state.scratch.H_landmark
    for r in range(first, first + k):
        shift[r] = 0.0
        for q in range(error.shape[0]):
            error[r, q] = error[q, r] = 0.0
        for c in range(half.shape[1]):
            half[r, c] = H_landmark[r, 0] * C[slot, c] + H_landmark[r, 1] * C[slot + 1, c]
            for i in range(3):
                half[r, c] += H[r, i] * C[i, c]


@compiled("index(models, state, index)", generic=True)
def regress(models: Any, state: Any, n: int) -> int:
    """y, S and w ← the cross-covariance, by regression of n sightings over the whole state; how many were finite.

    With h = half · C⁻¹ + noise: S = half halfᵀ + error + R, w = half Cᵀ. Columns after those of the last landmark in
    sight move nothing that is in sight.
    """
    k, D, mean, params = models.R.shape[0], state.belief.active, state.belief.mean, models.sensor_params
    slots, order, z, y, S, w = (
        state.scratch.slots,
        state.scratch.order,
        state.last.z,
        state.last.y,
        state.last.S,
        state.last.w,
    )
    rows, count = n * k, 3
    for j in range(n):
        count = max(count, slots[j] + 2)
    C = np.empty((D, D))
    whole_columns(state.belief.cov, mean[2], count, 0.0, C)
    s = spread(state, D)
    centre, shift, predicted, point = np.empty(rows), np.empty(rows), np.empty(k), np.empty(5)
    plus, minus = np.zeros((count, rows)), np.zeros((count, rows))
    half, error = np.empty((rows, count)), np.empty((rows, rows))
    for j in range(n):
        models.predict(mean[:3], mean[slots[j] : slots[j] + 2], params, centre[j * k : (j + 1) * k])
    for c in range(count):
        for side in range(2):
            step = s if side == 0 else -s
            out = plus[c] if side == 0 else minus[c]
            for i in range(3):
                point[i] = mean[i] + step * C[i, c]
            for j in range(n):
                slot, first = slots[j], j * k
                if c < slot + 2:
                    for i in range(2):
                        point[3 + i] = mean[slot + i] + step * C[slot + i, c]
                    models.predict(point[:3], point[3:], params, predicted)
                    models.residual(predicted, centre[first : first + k], params, out[first : first + k])
    moments(state, plus, minus, half, error, shift, rows, count, D)
    for j in range(n):
        slot = slots[j]
        landmark, H, H_landmark = mean[slot : slot + 2], state.scratch.H_pose, state.scratch.H_landmark
        first, end = j * k, (j + 1) * k
        models.sensor_jacobians(mean[:3], landmark, params, H[first:end], H_landmark[first:end])
        if not explains(half, error, models.R, first, count) and not smooth(models, state, mean[:3], landmark, slot):
            differentiate(state, slot, first, k, C, half, error, shift)
    kept = 0
    for j in range(n):
        first = j * k
        for r in range(k):
            state.scratch.z_hat[r] = centre[first + r] + shift[first + r]
        models.residual(z[first : first + k], state.scratch.z_hat, params, y[first : first + k])
        if is_finite(y[first : first + k]):
            if kept < j:
                slots[kept], order[kept] = slots[j], order[j]
                for r in range(k):
                    z[kept * k + r] = z[first + r]
            kept += 1
        else:
            record_non_finite(state, order[j], k)
    if kept < n:
        return kept
    for r in range(rows):
        for q in range(r + 1):
            total = error[r, q]
            if r // k == q // k:
                total += models.R[r % k, q % k]
                state.scratch.noise[r, q % k] = state.scratch.noise[q, r % k] = total
            for c in range(count):
                total += half[r, c] * half[q, c]
            S[r, q] = S[q, r] = total
        for i in range(D):
            total = 0.0
            for c in range(count):
                total += half[r, c] * C[i, c]
            w[r, i] = total
    return n


@compiled("index(policy, models, state, index)", generic=True)
def whole_update(policy: Any, models: Any, state: Any, n: int) -> Any:
    """One update by the n sightings in ``scratch.slots`` and ``last.z``, stacked, with the covariance of their errors.

    Sightings beyond the gate, or without finite numbers, are left out, and the others are computed again.
    """
    k = models.R.shape[0]
    kept = regress(models, state, n)
    while kept < n:
        n = kept
        kept = regress(models, state, n)
    kept = gate_sightings(policy, models, state, n)
    if kept < 0:
        return NOT_DEFINITE
    if kept == 0:
        return record_all_rejected(state, n * k)
    if kept < n:
        n = kept
        regress(models, state, n)
    if not cholesky(state.last.S, state.last.L, 0, n * k):
        return NOT_DEFINITE
    forward(state.last.L, state.last.y, state.last.t, 0, n * k)
    whiten(state, n * k)
    return commit_update(policy, state, n, k)
