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
# the regressions. The translations stay (I, 0, I, …), since the models do not depend on the place.


@compiled("void(models, state, integers, flag)", generic=True)
def scan(models: Any, state: Any, slots: Any, moved: bool) -> None:
    """J q ← F_pp J q + F_pθ with the regression's F."""
    if moved:
        F, points = state.F, state.points
        a, b = -points[1], points[0]
        x, y = F[0, 0] * a + F[0, 1] * b + F[0, 2], F[1, 0] * a + F[1, 1] * b + F[1, 2]
        points[0], points[1] = y, -x


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
    """J c ← G_p J q + G_θ with the regression's G."""
    ukf_start(models, state, slot, place, z)
    G, points = state.G_pose, state.points
    a, b = -points[1], points[0]
    x, y = G[0, 0] * a + G[0, 1] * b + G[0, 2], G[1, 0] * a + G[1, 1] * b + G[1, 2]
    points[slot], points[slot + 1] = y, -x


class ObservabilityConstrainedUKFSLAM(UKFSLAM):
    """UKF-SLAM (partial sigma points) whose regressions cannot see the global pose.

    Parameters, attributes and errors are those of :class:`slamkit.UKFSLAM`; `sigma_points` is always "partial".

    Notes
    -----
    Each measurement's regression matrix is projected onto the complement of the three directions that no measurement
    sees, restricted to the pose and the landmark at hand and carried through the prediction's regressions.

    References
    ----------
    Huang, Mourikis & Roumeliotis, A quadratic-complexity observability-constrained unscented Kalman filter for SLAM,
    IEEE T-RO 29(5) (2013).
    """

    name = "oc-ukf"
    feet = "points"
    functions = PolicyFunctions(motion=ukf_motion, sensor=sensor, start=start, scan=scan)
