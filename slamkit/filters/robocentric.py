"""The robocentric EKF: the map is kept in the robot's frame, where its uncertainty is small."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from math import cos, sin
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from slamkit import se2
from slamkit.arrays import Array
from slamkit.belief.dense import gather
from slamkit.compiled import MachineCode, OwnFields, compiled
from slamkit.cycle.estimator import EstimatorFunctions
from slamkit.cycle.standard import motion_noise
from slamkit.filters.assignment import locked
from slamkit.filters.ekf import EKFSLAM
from slamkit.protocols import MotionModel, SensorModel
from slamkit.se2 import wrap, wrap_angle

# The belief is (r, B, l₁ …) in the frame of the robot at the last composition: r the robot, B the frame in which it
# started, lᵢ the landmarks. In the world the start is the constant a = ``own(state).start``, so that the world's pose
# of the robot is a ∘ B⁻¹ ∘ r and R(ψ), ψ = θ_a - θ_B, leads to world axes. (The world's own frame in the place of B
# would make corrections depend, in second order, on where the world has its origin.) Own fields: `corrected` is 1 where
# an update has come since the last composition, `psi` is ψ at the last prediction, `start` is a.
own = OwnFields(corrected=1, psi=1, start=3)


@compiled("void(state, vector)")
def world_pose(state: Any, pose: Any) -> None:
    """pose ← a ∘ B⁻¹ ∘ r."""
    mean, a = state.belief.mean, own(state).start
    c, s = cos(a[2] - mean[5]), sin(a[2] - mean[5])
    dx, dy = mean[0] - mean[3], mean[1] - mean[4]
    pose[0], pose[1] = a[0] + c * dx - s * dy, a[1] + s * dx + c * dy
    pose[2] = wrap_angle(a[2] - mean[5] + mean[2])


@compiled("void(matrix, real)")
def turn(M: Any, angle: float) -> None:
    """M ← R M Rᵀ, M (3, 3) on a pose, R = diag(R(angle), 1)."""
    c, s = cos(angle), sin(angle)
    for j in range(3):
        x, y = M[0, j], M[1, j]
        M[0, j], M[1, j] = c * x - s * y, s * x + c * y
    for i in range(3):
        x, y = M[i, 0], M[i, 1]
        M[i, 0], M[i, 1] = c * x - s * y, s * x + c * y


@compiled("void(models, state, vector, real)", generic=True)
def motion(models: Any, state: Any, u: Any, dt: float) -> None:
    """Move r; the model sees the world, for its noise may lie along the world's axes."""
    mean, arrived, a = state.belief.mean, state.scratch.pose, own(state).start
    pose = np.empty(3)
    world_pose(state, pose)
    models.move(pose, u, dt, models.motion_params, arrived)
    models.motion_jacobians(pose, u, dt, models.motion_params, state.last.F, state.scratch.G)
    motion_noise(models, state, pose, u, dt)
    psi = a[2] - mean[5]
    turn(state.last.F, -psi)
    turn(state.last.Q, -psi)
    own(state).psi = psi
    c, s, x, y = cos(psi), sin(psi), arrived[0] - a[0], arrived[1] - a[1]
    arrived[0], arrived[1] = mean[3] + c * x + s * y, mean[4] + c * y - s * x
    arrived[2] = wrap_angle(arrived[2] - psi)


@compiled("void(state)")
def retract(state: Any) -> None:
    """x ← x + dx in this frame, and w, which is only read from now on, ← w Wᵀ: the gain in world coordinates."""
    mean, dx, D = state.belief.mean, state.scratch.dx, state.belief.active
    c, s = cos(own(state).start[2] - mean[5]), sin(own(state).start[2] - mean[5])
    for q in range(state.last.rows):
        row = state.last.w[q]
        for i in range(2, D // 2):
            k = 0 if i == 2 else 2 * i
            x, y = mean[k] - mean[3], mean[k + 1] - mean[4]
            ex, ey = row[k] - row[3], row[k + 1] - row[4]
            row[k] = c * ex - s * ey + (s * x + c * y) * row[5]
            row[k + 1] = s * ex + c * ey - (c * x - s * y) * row[5]
        row[2] -= row[5]
    for i in range(D):
        mean[i] += dx[i]
    mean[2], mean[5] = wrap_angle(mean[2]), wrap_angle(mean[5])
    own(state).corrected = 1.0


@compiled("void(state)")
def compose(state: Any) -> None:
    """Express B and every landmark in the frame of the robot at r, where r is 0 and exactly known: O(D²).

    l' = C(r)ᵀ(l - p_r), B' = r⁻¹ ∘ B; P' = A P Aᵀ with the rows C(r)ᵀ[-I, -J(l - p_r), I] of A: what r says is
    subtracted first, then the axes are turned.
    """
    cov, mean, D = state.belief.cov, state.belief.mean, state.belief.active
    c, s = cos(mean[2]), sin(mean[2])
    # Row i of A before the turn is e_i - (a_i, b_i, lever_i) on r.
    gather(state, 0, 3)
    g0, g1, g2 = state.scratch.gathered[0], state.scratch.gathered[1], state.scratch.gathered[2]
    a, b, lever = state.scratch.gathered[3], state.scratch.gathered[4], state.scratch.dx
    p00, p11, p22 = g0[0], g1[1], g2[2]
    p01, p02, p12 = g0[1], g0[2], g1[2]
    a[5], b[5], lever[5] = 0.0, 0.0, 1.0
    for i in range(2, D // 2):
        k = 3 if i == 2 else 2 * i
        x, y = mean[k] - mean[0], mean[k + 1] - mean[1]
        a[k], b[k], lever[k] = 1.0, 0.0, -y
        a[k + 1], b[k + 1], lever[k + 1] = 0.0, 1.0, x
        mean[k], mean[k + 1] = c * x + s * y, c * y - s * x
    mean[5] = wrap_angle(mean[5] - mean[2])
    for i in range(3, D):
        g0[i] -= 0.5 * (p00 * a[i] + p01 * b[i] + p02 * lever[i])
        g1[i] -= 0.5 * (p01 * a[i] + p11 * b[i] + p12 * lever[i])
        g2[i] -= 0.5 * (p02 * a[i] + p12 * b[i] + p22 * lever[i])
    for i in range(3, D):
        row = cov[i]
        ai, bi, ei, h0, h1, h2 = a[i], b[i], lever[i], g0[i], g1[i], g2[i]
        for j in range(3, i + 1):
            row[j] -= ai * g0[j] + bi * g1[j] + ei * g2[j] + h0 * a[j] + h1 * b[j] + h2 * lever[j]
    for i in range(2, D // 2):
        k = 3 if i == 2 else 2 * i
        first, second = cov[k], cov[k + 1]
        first[k + 1] = second[k]  # the turn needs the whole block on the diagonal
        for j in range(3, k + 2):
            x, y = first[j], second[j]
            first[j], second[j] = c * x + s * y, c * y - s * x
    for i in range(3, D):
        row = cov[i]
        x, y = row[3], row[4]
        row[3], row[4] = c * x + s * y, c * y - s * x
        for k in range(6, i + 1, 2):
            x, y = row[k], row[k + 1]
            row[k], row[k + 1] = c * x + s * y, c * y - s * x
    for i in range(3):
        mean[i] = 0.0
        for j in range(i + 1):
            cov[i, j] = 0.0
    for i in range(3, D):
        row = cov[i]
        row[0] = row[1] = row[2] = 0.0
    own(state).corrected = 0.0


@compiled("void(state, vector, matrix)")
def report(state: Any, pose: Any, covariance: Any) -> None:
    """Compose if a scan has corrected the belief, for this ends a step; then the pose and W P Wᵀ."""
    if own(state).corrected != 0.0:
        compose(state)
    cov, a = state.belief.cov, own(state).start
    world_pose(state, pose)
    c, s = cos(a[2] - state.belief.mean[5]), sin(a[2] - state.belief.mean[5])
    W = np.zeros((3, 6))
    W[0, 0], W[0, 1], W[1, 0], W[1, 1] = c, -s, s, c
    W[0, 3], W[0, 4], W[1, 3], W[1, 4] = -c, s, -s, -c
    W[0, 5], W[1, 5] = pose[1] - a[1], a[0] - pose[0]
    W[2, 2], W[2, 5] = 1.0, -1.0
    for i in range(3):
        for j in range(i + 1):
            total = 0.0
            for p in range(6):
                for q in range(6):
                    total += W[i, p] * cov[max(p, q), min(p, q)] * W[j, q]
            covariance[i, j] = covariance[j, i] = total


class RobocentricEKFSLAM(EKFSLAM):
    """Robocentric EKF-SLAM: one Gaussian over the map as the robot sees it, and over where it started from there.

    Parameters, attributes and errors are those of :class:`slamkit.EKFSLAM`.

    Notes
    -----
    The belief lives in the frame of the robot at the last scan that corrected it: the robot's pose r since then, the
    frame B in which it started and the landmarks. A prediction moves r, O(D); a sighting corrects all; after a scan
    everything is expressed in the frame of the corrected robot, a second pass over the covariance. Everything public
    is in world coordinates: x, P, K, F and Q are formed when asked for. `update`, for an extra sensor, is made in
    world coordinates and gives filterpy's own numbers.

    No measurement of landmarks depends on B: what the filter says of the map relative to the robot is the same
    however uncertain the start is. It is inexact by nature all the same: the change of frame is not linear, and its
    Jacobian is taken at the corrected estimate while the correction was made with another. What that leaves of
    inconsistency sits in the relative map.

    References
    ----------
    Castellanos, Martínez-Cantín, Tardós & Neira, Robocentric map joining: improving the consistency of EKF-SLAM,
    Robotics and Autonomous Systems 55(1):21-29 (2007).
    """

    name = "robocentric"
    own_fields = own
    functions = EstimatorFunctions(motion=motion, retract=retract, report=report)
    base = 6
    compresses = False

    def __init__(
        self,
        motion: MotionModel,
        sensor: SensorModel,
        pose: ArrayLike = (0.0, 0.0, 0.0),
        pose_covariance: ArrayLike | None = None,
        order: str = "sequential",
        **options: Any,
    ) -> None:
        super().__init__(motion, sensor, pose, pose_covariance, order, **options)
        own(self._belief.state).start = self._belief.mean[:3]
        self._hold(self._belief.mean[:3], self._belief.covariance[:3, :3])

    def _compiles(self) -> list[MachineCode]:
        return [*super()._compiles(), (compose, "jitted")]

    def _apply_step(self, u: Array, dt: float, ids: Sequence[Hashable], z: Array) -> None:
        super()._apply_step(u, dt, ids, z)
        if own(self._belief.state).corrected:
            compose(self._belief.state)

    # -- in world coordinates -----------------------------------------------------------------------------------------

    @property
    @locked
    def landmarks(self) -> dict[Hashable, Array]:
        """The map: id → position (2,) [m]; copies."""
        return dict(zip(self._belief.ids, self._mean()[3:].reshape(-1, 2), strict=True))

    @locked
    def marginal(self, ids: Sequence[Hashable], pose: bool = False) -> tuple[Array, Array]:
        """As :meth:`EKFSLAM.marginal`."""
        mean, covariance = self._belief.marginal(ids, base=True)
        keep = slice(0 if pose else 3, None)
        return in_world(mean, self._start)[keep], covariance_in_world(mean, covariance, self._start)[keep, keep]

    def _marginals(self) -> tuple[Array, Array]:
        parts = [self.marginal([i]) for i in self._belief.ids]
        return np.array([m for m, _ in parts]).reshape(-1, 2), np.array([P for _, P in parts]).reshape(-1, 2, 2)

    @property
    def _start(self) -> Array:
        return own(self._belief.state).start  # type: ignore[no-any-return]

    @property
    @locked
    def F(self) -> Array:  # type: ignore[override]  # noqa: N802
        """Transition matrix (D, D) of the last prediction, formed when asked for."""
        return self._pose_block_in_world(super().F)

    @property
    @locked
    def Q(self) -> Array:  # type: ignore[override]  # noqa: N802
        """Process noise (D, D) of the last prediction, formed when asked for."""
        return self._pose_block_in_world(super().Q)

    def _pose_block_in_world(self, M: Array) -> Array:
        whole, block = M.copy(), np.array(M[:3, :3])
        turn(block, own(self._belief.state).psi)
        whole[:3, :3] = block
        whole.flags.writeable = False
        return whole

    def _lever_points(self) -> Array:
        return self._mean()

    def _change_frame(self, rows: Array, pose: Array) -> None:
        """A of `compose`, whose C(r)ᵀJ(l - p_r) is J l' with the l' that it has left."""
        C, after = se2.rotation(pose[2]), self._belief.mean
        for k in (3, *range(6, len(after), 2)):
            rows[k : k + 2] = C.T @ (rows[k : k + 2] - rows[:2])
            rows[k] += after[k + 1] * rows[2]
            rows[k + 1] -= after[k] * rows[2]
        rows[5] -= rows[2]
        rows[:3] = 0.0

    def _mean(self) -> Array:
        return in_world(self._belief.mean, self._start)

    def _covariance(self) -> Array:
        return covariance_in_world(self._belief.mean, self._belief.covariance, self._start)

    def _set_mean(self, x: Array) -> None:
        self._hold(x, self._covariance())

    def _set_covariance(self, P: Array) -> None:
        self._hold(self._mean(), P)

    def _hold(self, x: Array, P: Array) -> None:
        """Take x and P for the belief: beside the start, exactly known, in the world's frame; composed."""
        self._belief.mean = np.insert(x, 3, self._start)
        self._belief.covariance = np.insert(np.insert(P, 3, np.zeros((3, 1)), axis=0), 3, np.zeros((3, 1)), axis=1)
        compose(self._belief.state)

    def _update_dense(self, H: Array, y: Array, R: Array) -> None:
        x, P = self._mean(), self._covariance()
        cross = P @ H.T
        self._belief.gain_of(np.insert(cross, 3, np.zeros((3, 1)), axis=0), H @ cross + R, y)
        state, D = self._belief.state, self._belief.dim
        w, dx = (np.delete(a, slice(3, 6), axis=-1) for a in (state.last.w[: len(y), :D], state.scratch.dx[:D]))
        self._hold(x + dx, P - w.T @ w)


def in_world(mean: Array, start: Array) -> Array:
    """Pose and landmarks (3 + 2n,) in the world, of (r, B, landmarks) (6 + 2n,) and the start's pose there."""
    x, psi = np.delete(mean, slice(3, 6)), start[2] - mean[5]
    at = np.r_[0, 3 : len(x) : 2]
    c, s, dx, dy = np.cos(psi), np.sin(psi), x[at] - mean[3], x[at + 1] - mean[4]
    x[at], x[at + 1], x[2] = start[0] + c * dx - s * dy, start[1] + s * dx + c * dy, wrap(x[2] + psi)
    return x


def covariance_in_world(mean: Array, covariance: Array, start: Array) -> Array:
    """W P Wᵀ (3 + 2n, 3 + 2n), W = ∂in_world/∂mean at `mean` (6 + 2n,).

    Each entry is computed by itself, so that it does not depend on which others are asked for.
    """
    x, psi = in_world(mean, start), start[2] - mean[5]
    at, c, s = np.r_[0, 3 : len(x) : 2], np.cos(psi), np.sin(psi)

    def rows(M: Array) -> Array:
        out = np.delete(M, slice(3, 6), axis=0)
        dx, dy = out[at] - M[3], out[at + 1] - M[4]
        out[at] = c * dx - s * dy + (x[at + 1, None] - start[1]) * M[5]
        out[at + 1] = s * dx + c * dy - (x[at, None] - start[0]) * M[5]
        out[2] -= M[5]
        return out

    P = rows(rows(covariance).T)
    return np.asarray((P + P.T) / 2)
