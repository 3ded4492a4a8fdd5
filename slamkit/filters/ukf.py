"""The unscented filter: derivatives are replaced by regressions over sigma points."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import cos, sin, sqrt
from typing import Any, NamedTuple

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter
from numpy.typing import ArrayLike, NDArray

from slamkit import kernels, se2
from slamkit.compiled import FAILING, STATUS, Compiled, compiled
from slamkit.errors import InputError
from slamkit.filters import steps
from slamkit.filters.base import LandmarkFilter, PolicyFunctions
from slamkit.protocols import MotionModel, SensorModel
from slamkit.se2 import wrap_angle

Array = NDArray[np.float64]

# Sigma points x ± s T lᵢ, where lᵢ are the columns of chol(Tᵀ P T) and T turns positions into robot axes: with the
# root taken there the filter does not depend on the choice of the world's axes. With half = (f₊ - f₋)/2s and the
# weights of van der Merwe, the regression of f on x is H̄ T L = [half₁ … half_n]; the mean of f is f₀ + m.
# ``state.memory[:3]`` holds α, β, κ.

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


@compiled("void(matrix, matrix, matrix, matrix, vector, vector, index, index)")
def moments(plus: Any, minus: Any, half: Any, extra: Any, mean: Any, memory: Any, rows: int, n: int) -> None:
    """From differences to f₀ at the sigma points (n, rows): shift of the mean, half differences, regression error.

    extra = P_ff - (H̄ T L)(H̄ T L)ᵀ, what a linear function of x cannot explain of f.
    """
    alpha, beta, kappa = memory[0], memory[1], memory[2]
    spread = alpha * alpha * (n + kappa)
    s = sqrt(spread)
    weight = 0.5 / spread
    centre = (spread - n) / spread + 1.0 - alpha * alpha + beta
    for r in range(rows):
        mean[r] = 0.0
        for i in range(n):
            mean[r] += weight * (plus[i, r] + minus[i, r])
            half[r, i] = 0.5 * (plus[i, r] - minus[i, r]) / s
    for r in range(rows):
        for q in range(rows):
            total = centre * mean[r] * mean[q]
            for i in range(n):
                total += weight * (
                    (plus[i, r] - mean[r]) * (plus[i, q] - mean[q]) + (minus[i, r] - mean[r]) * (minus[i, q] - mean[q])
                )
                total -= half[r, i] * half[q, i]
            extra[r, q] = total


@compiled("real(vector, index)")
def spread(memory: Any, n: int) -> float:
    """How many standard deviations the sigma points lie from the mean: α √(n + κ)."""
    return float(memory[0] * sqrt(n + memory[2]))


@compiled("void(state, index, matrix)")
def local_root(state: Any, slot: int, L: Any) -> None:
    """L ← root in robot axes of the covariance of the pose, and of the landmark at `slot` unless that is 0."""
    n = 5 if slot > 0 else 3
    P, cov = np.empty((5, 5)), state.cov
    for i in range(3):
        for j in range(i + 1):
            P[i, j] = P[j, i] = cov[i, j]
    for a in range(n - 3):
        for j in range(3):
            P[3 + a, j] = P[j, 3 + a] = cov[slot + a, j]
        for b in range(a + 1):
            P[3 + a, 3 + b] = P[3 + b, 3 + a] = cov[slot + a, slot + b]
    turn_rows(P, n, -state.mean[2])
    turn_columns(P, n, n, -state.mean[2])
    root(P, L, n, PROBE)


@compiled("void(matrix, index, real)")
def turn_rows(M: Any, n: int, angle: float) -> None:
    """Rotate rows (0, 1), and (3, 4) where there are 5, by `angle`: diag(R, 1, R) M."""
    c, s = cos(angle), sin(angle)
    for k in range(0, n - 1, 3):
        for j in range(M.shape[1]):
            x, y = M[k, j], M[k + 1, j]
            M[k, j], M[k + 1, j] = c * x - s * y, s * x + c * y


@compiled("void(matrix, index, index, real)")
def turn_columns(M: Any, rows: int, n: int, angle: float) -> None:
    """Rotate columns likewise: M diag(R, 1, R)ᵀ."""
    c, s = cos(angle), sin(angle)
    for i in range(rows):
        for k in range(0, n - 1, 3):
            x, y = M[i, k], M[i, k + 1]
            M[i, k], M[i, k + 1] = c * x - s * y, s * x + c * y


@compiled("void(models, state, vector, real)", generic=True)
def motion(models: Any, state: Any, u: Any, dt: float) -> None:
    """Regression over sigma points of the pose and the control's noise: F = P_x'x P_xx⁻¹, Q the rest."""
    m = u.shape[0]
    n = 3 + m
    pose, params = state.mean[:3], models.motion_params
    L, columns, L_u = np.zeros((5, 5)), np.empty((3, 3)), np.empty((m, m))
    local_root(state, 0, L)
    copy(L, columns)
    turn_rows(columns, 3, pose[2])
    models.control_noise(u, dt, params, state.sigma_u)
    root(state.sigma_u, L_u, m, 0.0)
    s = spread(state.memory, n)
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
    moments(plus, minus, half, error, mean, state.memory, 3, n)
    unwhiten(half, L, state.F, 3, 3)
    turn_columns(state.F, 3, 3, pose[2])
    for j in range(3):
        state.pose[j] = centre[j] + mean[j]
    state.pose[2] = wrap_angle(state.pose[2])
    # The regression explains what comes from the pose; the control's share of the spread is noise.
    models.pose_noise(pose, u, dt, params, state.Q)
    for i in range(3):
        for j in range(3):
            state.Q[i, j] += error[i, j]
            for a in range(3, n):
                state.Q[i, j] += half[i, a] * half[j, a]


@compiled("void(models, state, vector, vector, index, vector, index)", generic=True)
def sensor(models: Any, state: Any, pose: Any, landmark: Any, slot: int, z: Any, row: int) -> None:
    """Regression over sigma points of the pose and this landmark: H = P_xzᵀ P⁻¹, its error added to the noise."""
    k = z.shape[0]
    params = models.sensor_params
    L, columns, out = np.zeros((5, 5)), np.empty((5, 5)), np.empty((k, 5))
    local_root(state, slot, L)
    copy(L, columns)
    turn_rows(columns, 5, pose[2])
    s = spread(state.memory, 5)
    at_mean, predicted = np.empty(k), np.empty(k)
    models.predict(pose, landmark, params, at_mean)
    plus, minus, point = np.empty((5, k)), np.empty((5, k)), np.empty(5)
    for i in range(5):
        for side in range(2):
            step = s if side == 0 else -s
            for j in range(3):
                point[j] = pose[j] + step * columns[j, i]
            for j in range(2):
                point[3 + j] = landmark[j] + step * columns[3 + j, i]
            models.predict(point[:3], point[3:], params, predicted)
            models.residual(predicted, at_mean, params, plus[i] if side == 0 else minus[i])
    half, error, mean = np.empty((k, 5)), np.empty((k, k)), np.empty(k)
    moments(plus, minus, half, error, mean, state.memory, k, 5)
    unwhiten(half, L, out, k, 5)
    turn_columns(out, k, 5, pose[2])
    for r in range(k):
        for i in range(3):
            state.H_pose[row + r, i] = out[r, i]
        for i in range(2):
            state.H_landmark[row + r, i] = out[r, 3 + i]
        state.z_hat[r] = at_mean[r] + mean[r]
        for q in range(k):
            state.noise[row + r, q] = models.R[r, q] + error[r, q]
    models.residual(z, state.z_hat, params, state.y[row : row + k])


@compiled("void(models, state, index, index, vector)", generic=True)
def start(models: Any, state: Any, slot: int, place: int, z: Any) -> None:
    """Regression over sigma points of the pose and the measurement's noise."""
    k = z.shape[0]
    n = 3 + k
    pose, params = state.mean[:3], models.sensor_params
    L, columns, L_z = np.zeros((5, 5)), np.empty((3, 3)), np.empty((k, k))
    local_root(state, 0, L)
    copy(L, columns)
    turn_rows(columns, 3, pose[2])
    root(models.R, L_z, k, 0.0)
    s = spread(state.memory, n)
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
    moments(plus, minus, half, error, mean, state.memory, 2, n)
    unwhiten(half, L, state.G_pose, 2, 3)
    turn_columns(state.G_pose, 2, 3, pose[2])
    for i in range(2):
        state.mean[slot + i] = centre[i] + mean[i]
        for j in range(2):
            state.block[i, j] = error[i, j]
            for a in range(3, n):
                state.block[i, j] += half[i, a] * half[j, a]


class Fit(NamedTuple):
    """A function's regression over sigma points of n dimensions."""

    centre: Array  #: (r,) its value at the mean
    mean: Array  #: (r,) shift of its mean from there
    half: Array  #: (r, n) its covariance with the whitened state
    error: Array  #: (r, r) covariance that the regression does not explain


class UKFSLAM(LandmarkFilter, UnscentedKalmanFilter):  # type: ignore[misc, override]  # properties here
    """Unscented Kalman filter SLAM, with sigma points over what a function depends on.

    Parameters
    ----------
    motion, sensor, pose, pose_covariance, order, gate, snapshots
        As of :class:`slamkit.EKFSLAM`.
    sigma_points : {"partial", "full"}
        "partial": sigma points over the pose and the one landmark of a sighting, over the pose and the control's
        noise for a prediction; the regression then goes through the sparse update: O(D²) or less. "full": over the
        whole state, O(D³), for reference.
    alpha, beta, kappa : float
        Scaling of van der Merwe's sigma points, which lie α √(n + κ) standard deviations from the mean. The smaller
        α, the closer to the second-order limit, from which a filter differs as α². The mean is a second difference,
        so rounding enters it as 1/α²: the default keeps the estimates within 1e-9 of frame-independent where an α of
        1e-3 leaves 1e-7, and within 1e-3 standard deviations of what the full transform gives with that α.

    Attributes
    ----------
    x, P, y, S, K, z, log_likelihood, likelihood, mahalanobis
        As in filterpy; x and P are read-only copies: assign to change them.
    points_fn, Wm, Wc, sigmas_f
        Sigma points of the whole state, formed when asked for.

    Notes
    -----
    Sigma points are drawn anew before every update; filterpy's own filter does not, and three updates after one
    prediction can make it give a negative variance. The matrix root is taken in robot axes, so the filter does not
    depend on the choice of the world's axes. Angles are subtracted and averaged as angles. The filter is inexact in
    what a regression is inexact in: it adds the error of the linear fit to the noise. Partial sigma points know
    nothing of how the errors of two landmarks' fits go together: with ``order="batch"`` they are taken as independent,
    which the full ones need not do. Like the standard EKF it learns a heading that nothing measures.

    References
    ----------
    Julier & Uhlmann, Proc. IEEE 92(3) (2004); van der Merwe, dissertation (2004);
    Huang, Mourikis & Roumeliotis, IEEE ICRA (2009), for the regression on the part that a measurement depends on.
    """

    name = "ukf"
    functions = PolicyFunctions(motion=motion, sensor=sensor, start=start)

    def __init__(
        self,
        motion: MotionModel,
        sensor: SensorModel,
        pose: ArrayLike = (0.0, 0.0, 0.0),
        pose_covariance: ArrayLike | None = None,
        order: str = "sequential",
        *,
        sigma_points: str = "partial",
        alpha: float = 2.5e-2,
        beta: float = 2.0,
        kappa: float = 0.0,
        **options: Any,
    ) -> None:
        if sigma_points not in ("partial", "full"):
            raise InputError(f"sigma_points is {sigma_points!r}, expected 'partial' or 'full'")
        if not (0 < alpha <= 1 and kappa > -1 and np.isfinite(beta) and np.isfinite(kappa)):
            raise InputError(f"alpha, beta, kappa are {alpha}, {beta}, {kappa}; expected 0 < alpha ≤ 1 and kappa > -1")
        self.compresses = sigma_points == "partial"
        super().__init__(motion, sensor, pose, pose_covariance, order, **options)
        self.sigma_points, self.alpha, self.beta, self.kappa = sigma_points, alpha, beta, kappa
        self._belief.state.memory[:3] = alpha, beta, kappa

    @property
    def points_fn(self) -> MerweScaledSigmaPoints:  # type: ignore[override]
        """filterpy's generator of sigma points over the whole state, with the filter's α, β, κ."""
        return MerweScaledSigmaPoints(self.dim_x, self.alpha, self.beta, self.kappa)

    @property
    def Wm(self) -> Array:  # type: ignore[override]  # noqa: N802
        """Weights (2D + 1,) of the mean."""
        return np.asarray(self.points_fn.Wm)

    @property
    def Wc(self) -> Array:  # type: ignore[override]  # noqa: N802
        """Weights (2D + 1,) of the covariance."""
        return np.asarray(self.points_fn.Wc)

    @property
    def sigmas_f(self) -> Array:  # type: ignore[override]
        """Sigma points (2D + 1, D) of the current belief, root in robot axes."""
        columns = self._columns() * spread(self._belief.state.memory, self.dim_x)
        return np.vstack([self.x, self.x + columns.T, self.x - columns.T])

    def update(  # type: ignore[override]
        self,
        z: ArrayLike | None,
        R: ArrayLike | float | None = None,
        UT: Any = None,
        hx: Callable[..., ArrayLike] | None = None,
        residual: Callable[[Any, Any], Any] = np.subtract,
        **hx_args: Any,
    ) -> None:
        """Filterpy's own update, for an extra sensor on the full state.

        Parameters
        ----------
        z : array_like (r,) or None
            Measurement; None: nothing happens.
        R : array_like (r, r) or float, optional
            Noise covariance; the sensor model's by default.
        UT : None
            Accepted for filterpy's sake; the transform is this filter's own.
        hx : callable
            ``hx(x, **hx_args)``: the measurement (r,) that x (D,) would give.
        residual : callable
            ``residual(z, z_hat)``, for measurements that do not subtract (angles).
        **hx_args
            Further arguments of `hx`.

        Raises
        ------
        InputError
            A shape does not fit, or a value is not finite. The belief stays as it was.
        """
        if UT is not None:
            raise InputError("UT is given, but the unscented transform is this filter's own")
        if z is not None and hx is None:
            raise InputError("hx is missing: the function of the state that was measured")

        def at(x: Array) -> Array:
            return np.atleast_1d(np.asarray(hx(x, **hx_args), dtype=float))  # type: ignore[misc]

        if z is None:
            super().update(None, at, at)
            return
        columns = self._columns(PROBE)
        fit = self._fit(at, lambda a, b: np.atleast_1d(residual(a, b)), columns)
        r = len(fit.error)
        noise = self.R if R is None else np.eye(r) * float(R) if np.ndim(R) == 0 else np.asarray(R)  # type: ignore[arg-type]
        if noise.shape != (r, r):
            raise InputError(f"R has shape {noise.shape}, hx gives {r} numbers")
        H = np.linalg.solve(columns.T, fit.half.T).T
        super().update(z, lambda x: H, lambda x: at(x) + fit.mean, noise + fit.error, residual=residual)

    def _leaves_jacobians(self) -> bool:
        return self.sigma_points == "partial"

    # -- sigma points over the whole state ----------------------------------------------------------------------------

    def _columns(self, floor: float = 0.0) -> Array:
        """Root (D, D) of P, taken in robot axes; a floor makes it invertible, for a regression and nothing else."""
        D = self.dim_x
        T = np.eye(D)
        C = se2.rotation(self._belief.state.mean[2])
        for k in (0, *range(3, D, 2)):
            T[k : k + 2, k : k + 2] = C
        L = np.empty((D, D))
        root(np.ascontiguousarray(T.T @ self._belief.covariance @ T), L, D, floor)
        return np.asarray(T @ L)

    def _fit(
        self, f: Callable[[Array], Array], subtract: Callable[[Any, Any], Array], columns: Array, x: Array | None = None
    ) -> Fit:
        """Regression of f over sigma points x ± s·columns, x being the mean by default."""
        x, memory, n = self._belief.mean if x is None else x, self._belief.state.memory, columns.shape[1]
        steps_ = spread(memory, n) * columns.T
        # Bad input makes NaN here, which the caller refuses; NumPy need not warn of it as well.
        with np.errstate(invalid="ignore"):
            centre = f(x)
            plus = np.array([subtract(f(x + d), centre) for d in steps_])
            minus = np.array([subtract(f(x - d), centre) for d in steps_])
        r = plus.shape[1]
        fit = Fit(centre, np.empty(r), np.empty((r, n)), np.empty((r, r)))
        moments(plus, minus, fit.half, fit.error, fit.mean, memory, r, n)
        return fit

    def _take_step(self, u: Array, dt: float, slots: NDArray[np.int64], z: Array) -> int:
        if self.sigma_points == "partial":
            return super()._take_step(u, dt, slots, z)
        # Python appends the landmarks here, so there must be room for them first.
        self._belief.reserve(len(slots), len(slots))
        return self._whole_step(u, dt, slots, z)

    def _guarded(self, step: Compiled, *arguments: Any) -> int:
        if self.sigma_points == "partial":
            return super()._guarded(step, *arguments)
        controls, dt, control, first, which, slot_of, z, _, _, begin_at, end_at, *records = arguments
        poses, covariances, innovations, nis, accepted = records
        state = self._belief.state
        for i in range(begin_at, end_at):
            rows = slice(first[i], first[i + 1])
            slots = slot_of[which[rows]]
            status = self._whole_step(controls[max(control[i], 0)], dt[i], slots, z[rows])
            slot_of[which[rows]] = slots
            state.size[STATUS] = status
            if status != steps.OK:
                return i
            self._policy.report(state, poses[i], covariances[i])
            n = len(slots)
            innovations[rows], nis[rows], accepted[rows] = state.innovations[:n], state.nis[:n], state.accepted[:n]
        return int(end_at)

    def _whole_step(self, u: Array, dt: float, slots: NDArray[np.int64], z: Array) -> int:
        """A step with sigma points over the whole state; the slots of new landmarks are written."""
        belief, state = self._belief, self._belief.state
        before = belief.snapshot()
        slots_before = slots.copy()
        try:
            if dt > 0 and not self._whole_predict(u, dt):
                belief.restore(before)
                return steps.BAD_MOTION
            state.pose[:] = state.mean[:3]
            bad = self._first_bad(slots, z)
            if bad >= 0:
                belief.restore(before)
                state.size[FAILING] = bad
                return steps.BAD_SIGHTING
            self._whole_scan(slots, z)
        except Exception:
            belief.restore(before)
            slots[:] = slots_before
            raise
        return steps.OK

    def _ask(self, function: str, shape: int | tuple[int, int], *arguments: Any) -> Array:
        """One of the models' functions, its result checked as every filter checks it."""
        out = np.empty(shape)
        motion = function in ("move", "control_noise", "pose_noise")
        params = self._models.motion_params if motion else self._models.sensor_params
        getattr(self._models, function)(*arguments, params, out)
        return out

    def _residual(self, z: Array, z_hat: Array) -> Array:
        return self._ask("residual", self.dim_z, z, z_hat)

    def _first_bad(self, slots: NDArray[np.int64], z: Array) -> int:
        pose = self._belief.state.mean[:3]
        for i, slot in enumerate(slots):
            at = self._belief.state.mean[slot : slot + 2] if slot >= 0 else self._ask("invert", 2, pose, z[i])
            if not np.all(np.isfinite(self._residual(z[i], self._ask("predict", self.dim_z, pose, at)))):
                return i
        return -1

    def _whole_predict(self, u: Array, dt: float) -> bool:
        belief, state, m = self._belief, self._belief.state, len(u)
        D, x, columns = belief.dim, belief.mean, self._columns()
        sigma_u = self._ask("control_noise", (m, m), u, dt)
        L_u = np.empty((m, m))
        root(sigma_u, L_u, m, 0.0)
        both = np.zeros((D + m, D + m))
        both[:D, :D], both[D:, D:] = columns, L_u

        def turn(a: Array, b: Array) -> Array:
            d = np.asarray(a - b)
            d[2] = se2.wrap(d[2])
            return d

        fit = self._fit(lambda s: self._ask("move", 3, s[:3], s[D:], dt), turn, both, np.append(x, u))
        noise = fit.error + self._ask("pose_noise", (3, 3), x[:3], u, dt)
        pose = fit.centre + fit.mean
        if not (np.all(np.isfinite(pose)) and np.all(np.isfinite(fit.half)) and np.all(np.isfinite(noise))):
            state.pose[:] = pose
            return False
        half = np.vstack([fit.half, both[3:D]])
        P = half @ half.T
        # The landmarks do not move: their block is what it was, not what the root makes of it.
        P[3:, 3:] = belief.covariance[3:, 3:]
        P[:3, :3] += noise
        pose[2] = se2.wrap(pose[2])
        state.mean[:3] = pose
        belief.covariance = (P + P.T) / 2
        state.F[:] = fit.half[:, :3] @ np.linalg.pinv(columns[:3, :3])
        state.Q[:] = noise + fit.half[:, D:] @ fit.half[:, D:].T
        return True

    def _whole_scan(self, slots: NDArray[np.int64], z: Array) -> None:
        state = self._belief.state
        known = [i for i, s in enumerate(slots) if s >= 0]
        for i in range(len(slots)):
            state.innovations[i], state.nis[i], state.accepted[i] = np.nan, np.nan, slots[i] < 0
        for group in ([known] if known else []) if self.order == "batch" else []:
            self._whole_update(group, slots, z)
        for i in range(len(slots)):
            if slots[i] < 0:
                slots[i] = self._whole_start(z[i])
            elif self.order != "batch":
                self._whole_update([i], slots, z)

    def _whole_update(self, group: Sequence[int], slots: NDArray[np.int64], z: Array) -> None:
        k, belief, columns = self.dim_z, self._belief, self._columns()

        def h(x: Array) -> Array:
            return np.concatenate([self._ask("predict", k, x[:3], x[slots[i] : slots[i] + 2]) for i in group])

        def subtract(a: Array, b: Array) -> Array:
            pairs = zip(a.reshape(-1, k), b.reshape(-1, k), strict=True)
            return np.concatenate([self._residual(*pair) for pair in pairs])

        fit = self._fit(h, subtract, columns)
        S = fit.half @ fit.half.T + fit.error + np.kron(np.eye(len(group)), np.asarray(self.sensor.R))
        y = subtract(z[list(group)].ravel(), fit.centre + fit.mean)
        kept = []
        for j, i in enumerate(group):
            rows = slice(j * k, (j + 1) * k)
            nis = float(y[rows] @ np.linalg.solve(S[rows, rows], y[rows]))
            state = belief.state
            state.innovations[i], state.nis[i] = y[rows], nis
            state.accepted[i] = self.gate is None or nis <= self.gate
            kept += [j] if state.accepted[i] else []
        if len(kept) < len(group):
            if kept:
                self._whole_update([group[j] for j in kept], slots, z)
            return
        belief.gain_of(columns @ fit.half.T, S, y)
        state = belief.state
        state.z[: len(y)] = z[list(group)].ravel()
        kernels.downdate(state, len(y))
        self._policy.retract(state)

    def _whole_start(self, z: Array) -> int:
        belief, k, columns = self._belief, self.dim_z, self._columns()
        D, L_z = belief.dim, np.empty((k, k))
        root(np.array(self.sensor.R, dtype=float), L_z, k, 0.0)
        both = np.zeros((D + k, D + k))
        both[:D, :D], both[D:, D:] = columns, L_z
        fit = self._fit(lambda s: self._ask("invert", 2, s[:3], s[D:]), np.subtract, both, np.append(belief.mean, z))
        return belief.append(fit.centre + fit.mean, fit.half[:, :D] @ columns.T, fit.half @ fit.half.T + fit.error)

    def _facts(self) -> dict[str, Any]:
        return {"sigma_points": self.sigma_points, "alpha": self.alpha, "beta": self.beta, "kappa": self.kappa}

    @classmethod
    def _options(cls, facts: dict[str, Any]) -> dict[str, Any]:
        return {n: facts[n] for n in ("sigma_points", "alpha", "beta", "kappa")}


class FullUKFSLAM(UKFSLAM):
    """:class:`UKFSLAM` with sigma points over the whole state: the O(D³) reference.

    Parameters, attributes and errors are those of :class:`UKFSLAM`.
    """

    name = "ukf-full"

    def __init__(self, *args: Any, sigma_points: str = "full", **options: Any) -> None:
        super().__init__(*args, sigma_points=sigma_points, **options)
