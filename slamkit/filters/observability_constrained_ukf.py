"""The observability-constrained UKF: regressions that are blind where the system is."""

from __future__ import annotations

from typing import Any

from slamkit.compiled import compiled
from slamkit.cycle.estimator import EstimatorFunctions
from slamkit.errors import InputError
from slamkit.filters import first_estimates
from slamkit.filters.regressions import initialise as ukf_initialise
from slamkit.filters.regressions import motion as ukf_motion
from slamkit.filters.regressions import sensor as ukf_sensor
from slamkit.filters.ukf import UKFSLAM

# No measurement sees N = [I, J q; 0 1; I, J cᵢ …], where ``belief.linearised_at`` holds q, the last predicted position,
# and the cᵢ, the landmarks' first estimates. With H = [H_p h_θ H_l] on the pose and one landmark, H N = 0 reads
#     H_p = -H_l,   h_θ = -(H_p J q + H_l J c) = -H_l J (c - q):
# the landmark's columns, which the regression always has (a landmark is never known exactly), give the others.
# Likewise F N = N' gives F = [I, J (p' - q); 0 1], and a landmark's start G = [I, J (l - q)].


@compiled("void(models, state, vector, real)", generic=True)
def motion(models: Any, state: Any, u: Any, dt: float) -> None:
    """F = [I, J(p' - q); 0 1]."""
    ukf_motion(models, state, u, dt)
    F, points, arrived = state.last.F, state.belief.linearised_at, state.scratch.pose
    F[:, :] = 0.0
    F[0, 0] = F[1, 1] = F[2, 2] = 1.0
    F[0, 2], F[1, 2] = points[1] - arrived[1], arrived[0] - points[0]


@compiled("void(models, state, vector, vector, index, vector, index)", generic=True)
def sensor(models: Any, state: Any, pose: Any, landmark: Any, slot: int, z: Any, row: int) -> None:
    """H = H_l [-I, -J(c - q), I]."""
    ukf_sensor(models, state, pose, landmark, slot, z, row)
    H, H_l, points = state.scratch.H_pose, state.scratch.H_landmark, state.belief.linearised_at
    dx, dy = points[slot] - points[0], points[slot + 1] - points[1]
    for r in range(row, row + z.shape[0]):
        H[r, 0], H[r, 1] = -H_l[r, 0], -H_l[r, 1]
        H[r, 2] = H_l[r, 0] * dy - H_l[r, 1] * dx


@compiled("void(models, state, index, index, vector)", generic=True)
def initialise(models: Any, state: Any, slot: int, place: int, z: Any) -> None:
    """G = [I, J(l - q)], and c ← l."""
    ukf_initialise(models, state, slot, place, z)
    G, points, mean = state.scratch.G_pose, state.belief.linearised_at, state.belief.mean
    G[0, 0] = G[1, 1] = 1.0
    G[0, 1] = G[1, 0] = 0.0
    G[0, 2], G[1, 2] = points[1] - mean[slot + 1], mean[slot] - points[0]
    points[slot], points[slot + 1] = mean[slot], mean[slot + 1]


class ObservabilityConstrainedUKFSLAM(UKFSLAM):
    """UKF-SLAM (partial sigma points) whose regressions cannot see the global pose.

    Parameters, attributes and errors are those of :class:`slamkit.UKFSLAM`; `sigma_points` is always "partial".

    Notes
    -----
    Means, noises and the regression on the landmark are the sigma points'. The other columns of the regression
    matrices follow from the latter so that the three directions that no measurement sees stay unmeasured, with lever
    arms between the predicted position of the robot and the first estimate of the landmark, as of
    :class:`slamkit.FirstEstimatesEKFSLAM`. The regression error in the noise is that of the unconstrained regression.

    The published filter projects H orthogonally, H (I - N (NᵀN)⁻¹ Nᵀ), and carries N through the prediction's
    regressions. Its lever arms drift from the estimates as dead reckoning does, what is projected depends on the unit
    of length, and where everything is linear it is not the Kalman filter; this one is.

    Inexact by nature: a mean over sigma points depends on how uncertain the frame is. What lies at b from the robot
    has its mean in the world at b (1 - σ²/2), σ being the standard deviation of the frame's heading [rad], so the
    relative map comes out too small by that, 1.5 % at 10°, whatever it claims. The stochastic-gauge test finds it.

    References
    ----------
    Huang, Mourikis & Roumeliotis, A quadratic-complexity observability-constrained unscented Kalman filter for SLAM,
    IEEE T-RO 29(5) (2013); IJRR 29(5):502-528 (2010), section 5.1, for the lever arms.
    """

    name = "oc-ukf"
    linearisation_points = "linearised_at"
    functions = EstimatorFunctions(
        motion=motion, sensor=sensor, initialise=initialise, prepare_scan=first_estimates.prepare_scan
    )

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        if self.sigma_points != "partial":
            raise InputError(f"sigma_points is {self.sigma_points!r}, {self.name} takes 'partial' only")
