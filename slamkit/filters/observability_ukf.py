"""The observability-constrained UKF: regressions that are blind where the system is."""

from __future__ import annotations

from typing import Any

import numpy as np

from slamkit.compiled import compiled
from slamkit.filters.base import PolicyFunctions
from slamkit.filters.ukf import UKFSLAM
from slamkit.filters.ukf import motion as ukf_motion
from slamkit.filters.ukf import sensor as ukf_sensor
from slamkit.filters.ukf import start as ukf_start

# The direction of the unobservable rotation is (J q, 1, J c₁, …): ``state.points`` holds q and the cᵢ, carried through
# the regressions. The translations are (I, 0, I, …) for good: the models do not depend on the place, and the
# regressions are held to that, which they miss by what is cubic in the heading.


@compiled("void(models, state, vector, real)", generic=True)
def motion(models: Any, state: Any, u: Any, dt: float) -> None:
    """The regression's F with F_pp = I and F_θp = 0."""
    ukf_motion(models, state, u, dt)
    F = state.F
    F[0, 0] = F[1, 1] = 1.0
    F[0, 1] = F[1, 0] = F[2, 0] = F[2, 1] = 0.0


@compiled("void(models, state, integers, flag)", generic=True)
def scan(models: Any, state: Any, slots: Any, moved: bool) -> None:
    """J q ← J q + F_pθ."""
    if moved:
        state.points[0] += state.F[1, 2]
        state.points[1] -= state.F[0, 2]


@compiled("void(models, state, vector, vector, index, vector, index)", generic=True)
def sensor(models: Any, state: Any, pose: Any, landmark: Any, slot: int, z: Any, row: int) -> None:
    """H ← H (I - N (NᵀN)⁻¹ Nᵀ), N the three directions on the pose and this landmark."""
    ukf_sensor(models, state, pose, landmark, slot, z, row)
    points = state.points
    N = np.zeros((5, 3))
    N[0, 0] = N[1, 1] = N[3, 0] = N[4, 1] = N[2, 2] = 1.0
    N[0, 2], N[1, 2] = -points[1], points[0]
    N[3, 2], N[4, 2] = -points[slot + 1], points[slot]
    # Gram-Schmidt: the translations are orthogonal already; what is left of the rotation is taken off them.
    for c in range(2):
        mean = 0.5 * (N[c, 2] + N[3 + c, 2])
        N[c, 2] -= mean
        N[3 + c, 2] -= mean
    for c in range(3):
        length = 0.0
        for i in range(5):
            length += N[i, c] * N[i, c]
        for r in range(row, row + z.shape[0]):
            along = 0.0
            for i in range(3):
                along += state.H_pose[r, i] * N[i, c]
            for i in range(2):
                along += state.H_landmark[r, i] * N[3 + i, c]
            for i in range(3):
                state.H_pose[r, i] -= along * N[i, c] / length
            for i in range(2):
                state.H_landmark[r, i] -= along * N[3 + i, c] / length


@compiled("void(models, state, index, index, vector)", generic=True)
def start(models: Any, state: Any, slot: int, place: int, z: Any) -> None:
    """G_p = I, and J c ← J q + G_θ."""
    ukf_start(models, state, slot, place, z)
    G, points = state.G_pose, state.points
    G[0, 0] = G[1, 1] = 1.0
    G[0, 1] = G[1, 0] = 0.0
    points[slot], points[slot + 1] = points[0] + G[1, 2], points[1] - G[0, 2]


class ObservabilityConstrainedUKFSLAM(UKFSLAM):
    """UKF-SLAM (partial sigma points) whose regressions cannot see the global pose.

    Parameters, attributes and errors are those of :class:`slamkit.UKFSLAM`; `sigma_points` is always "partial".

    Notes
    -----
    Each measurement's regression matrix is projected onto the complement of the three directions that no measurement
    sees, restricted to the pose and the landmark at hand and carried through the prediction's regressions. The
    projection changes the columns of the positions as well as that of the heading, so the filter is not the Kalman
    filter where everything is linear; all others of the family are.

    References
    ----------
    Huang, Mourikis & Roumeliotis, A quadratic-complexity observability-constrained unscented Kalman filter for SLAM,
    IEEE T-RO 29(5) (2013).
    """

    name = "oc-ukf"
    feet = "points"
    functions = PolicyFunctions(motion=motion, sensor=sensor, start=start, scan=scan)
