"""The right-invariant EKF: the error is a rigid motion of the whole map, not a difference of coordinates."""

from __future__ import annotations

from math import cos, sin
from typing import Any

from slamkit.arrays import Array
from slamkit.belief.dense import shear
from slamkit.compiled import MachineCode, compiled
from slamkit.cycle.estimator import EstimatorFunctions
from slamkit.cycle.standard import motion as standard_motion
from slamkit.filters import first_estimates
from slamkit.filters.ekf import EKFSLAM
from slamkit.se2 import wrap_angle

# Within a scan the covariance is kept in the error δ of the points c = ``belief.linearised_at``, the means before it:
# δ = ξ + (J c) ξθ, a constant linear image of the invariant error ξ. Then H, G_x are those of first estimates, and
# exp(ξ) moves a position y to c + R(ξθ)(y - c) + V(ξθ) δ, since V J ξθ = R - I. Standard coordinates differ from δ
# by the shear T(y - c), so `shear` returns to them before the next prediction, which then costs O(D).


@compiled("void(models, state, vector, real)", generic=True)
def motion(models: Any, state: Any, u: Any, dt: float) -> None:
    """F = I in the invariant error is the standard F in standard coordinates."""
    shear(state)
    standard_motion(models, state, u, dt)


@compiled("void(state)")
def retract(state: Any) -> None:
    """X ← exp(ξ) X̂: rotate and move the robot and every landmark.

    The rows of w, which are only read from now on, go to standard coordinates first, at the mean before the update.
    """
    mean, points, dx = state.belief.mean, state.belief.linearised_at, state.scratch.dx
    D = state.belief.active
    a = dx[2]
    c, s = cos(a), sin(a)
    if abs(a) < 1e-4:
        v0, v1 = 1.0 - a * a / 6.0, 0.5 * a * (1.0 - a * a / 12.0)
    else:
        v0, v1 = s / a, (1.0 - c) / a
    for r in range(state.last.rows):
        row = state.last.w[r]
        for i in range(-1, (D - 3) // 2):
            k = 0 if i < 0 else 3 + 2 * i
            row[k] -= (mean[k + 1] - points[k + 1]) * row[2]
            row[k + 1] += (mean[k] - points[k]) * row[2]
    for i in range(-1, (D - 3) // 2):
        k = 0 if i < 0 else 3 + 2 * i
        x, y = mean[k] - points[k], mean[k + 1] - points[k + 1]
        ex, ey = dx[k], dx[k + 1]
        mean[k] = points[k] + c * x - s * y + v0 * ex - v1 * ey
        mean[k + 1] = points[k + 1] + s * x + c * y + v1 * ex + v0 * ey
    mean[2] = wrap_angle(mean[2] + a)


@compiled("void(state, vector, matrix)")
def report(state: Any, pose: Any, covariance: Any) -> None:
    """The pose's block in standard coordinates."""
    cov, mean, points = state.belief.cov, state.belief.mean, state.belief.linearised_at
    e0, e1 = points[1] - mean[1], mean[0] - points[0]
    p02, p12, p22 = cov[2, 0], cov[2, 1], cov[2, 2]
    covariance[0, 0] = cov[0, 0] + 2.0 * e0 * p02 + e0 * e0 * p22
    covariance[1, 1] = cov[1, 1] + 2.0 * e1 * p12 + e1 * e1 * p22
    covariance[1, 0] = covariance[0, 1] = cov[1, 0] + e1 * p02 + e0 * p12 + e0 * e1 * p22
    covariance[2, 0] = covariance[0, 2] = p02 + e0 * p22
    covariance[2, 1] = covariance[1, 2] = p12 + e1 * p22
    covariance[2, 2] = p22
    for i in range(3):
        pose[i] = mean[i]


class InvariantEKFSLAM(EKFSLAM):
    """Right-invariant EKF-SLAM: consistent without choosing linearisation points by hand.

    Parameters, attributes and errors are those of :class:`slamkit.EKFSLAM`.

    Notes
    -----
    The error is ξ in X = exp(ξ) X̂ with X = (p, θ, l₁ … l_N); the directions that no measurement sees are constant in
    it. x and P are reported in standard coordinates, as of every other filter. Every update moves every landmark and
    costs a second rank-2 pass over the covariance per scan.

    References
    ----------
    Barrau & Bonnabel, An EKF-SLAM algorithm with consistency properties, arXiv:1510.06263 (2015);
    Zhang, Wu, Song, Huang & Dissanayake, IEEE RA-L 2(2) (2017).
    """

    name = "invariant"
    functions = EstimatorFunctions(
        motion=motion,
        sensor=first_estimates.sensor,
        initialise=first_estimates.initialise,
        prepare_scan=first_estimates.prepare_scan,
        retract=retract,
        report=report,
    )
    linearisation_points = "linearised_at"
    compresses = False

    def _compiles(self) -> list[MachineCode]:
        return [*super()._compiles(), (shear, "jitted")]

    def _to_standard_coordinates(self) -> None:
        shear(self._belief.state)

    def _set_mean(self, x: Array) -> None:
        super()._set_mean(x)
        self._belief.state.belief.linearised_at[: len(x)] = x
