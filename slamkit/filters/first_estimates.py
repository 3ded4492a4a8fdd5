"""First-estimates Jacobians: every lever arm is taken where its position was first estimated."""

from __future__ import annotations

from typing import Any

from slamkit.compiled import compiled
from slamkit.cycle.estimator import EstimatorFunctions
from slamkit.cycle.standard import initialise as standard_initialise
from slamkit.cycle.standard import motion as standard_motion
from slamkit.cycle.standard import sensor as standard_sensor
from slamkit.filters.ekf import EKFSLAM

# The standard Jacobians enter as they are; only the column of the heading is sheared. With J d = (-d_y, d_x):
# F T(p - q), T(d) = [I, J d; 0 1], moves the lever arm's foot from p to q, and the same on H and G_x.


@compiled("void(models, state, vector, real)", generic=True)
def motion(models: Any, state: Any, u: Any, dt: float) -> None:
    """F = [I, J(p' - q); 0 1] for an equivariant model, where q = ``state.belief.linearised_at[:2]``."""
    standard_motion(models, state, u, dt)
    F = state.last.F
    dx, dy = state.belief.mean[0] - state.belief.linearised_at[0], state.belief.mean[1] - state.belief.linearised_at[1]
    for i in range(3):
        F[i, 2] += F[i, 1] * dx - F[i, 0] * dy


@compiled("void(models, state, integers, flag)", generic=True)
def prepare_scan(models: Any, state: Any, slots: Any, moved: bool) -> None:
    """The predicted position is the first estimate of where the robot is now."""
    if moved:
        state.belief.linearised_at[0], state.belief.linearised_at[1] = state.belief.mean[0], state.belief.mean[1]


@compiled("void(models, state, vector, vector, index, vector, index)", generic=True)
def sensor(models: Any, state: Any, pose: Any, landmark: Any, slot: int, z: Any, row: int) -> None:
    """H = -H_b Cᵀ[I, J(l_lin - q)] on the pose, H_b Cᵀ on the landmark."""
    standard_sensor(models, state, pose, landmark, slot, z, row)
    points = state.belief.linearised_at
    dx = points[slot] - points[0] - (landmark[0] - pose[0])
    dy = points[slot + 1] - points[1] - (landmark[1] - pose[1])
    for r in range(row, row + z.shape[0]):
        state.scratch.H_pose[r, 2] += state.scratch.H_landmark[r, 0] * dy - state.scratch.H_landmark[r, 1] * dx


@compiled("void(models, state, index, index, vector)", generic=True)
def initialise(models: Any, state: Any, slot: int, place: int, z: Any) -> None:
    """G_x = [I, J(l - q)], not [I, J(l - p)]: the published form lets the filter learn its heading."""
    standard_initialise(models, state, slot, place, z)
    G, points = state.scratch.G_pose, state.belief.linearised_at
    dx, dy = state.belief.mean[0] - points[0], state.belief.mean[1] - points[1]
    for i in range(2):
        G[i, 2] += G[i, 1] * dx - G[i, 0] * dy
    points[slot], points[slot + 1] = state.belief.mean[slot], state.belief.mean[slot + 1]


class FirstEstimatesEKFSLAM(EKFSLAM):
    """First-estimates-Jacobian EKF-SLAM: it cannot learn the global heading, which nothing measures.

    Parameters, attributes and errors are those of :class:`slamkit.EKFSLAM`.

    Notes
    -----
    Transition, observation and initialisation Jacobians take their lever arms at the predicted position of the robot
    and the first estimate of each landmark, so that all of them share the three directions that no measurement sees.
    The measurement function and its rotation stay at the current estimate. The landmark's initialisation differs
    from the published one, which breaks the property it is made for.

    References
    ----------
    Huang, Mourikis & Roumeliotis, Observability-based rules for designing consistent EKF SLAM estimators,
    IJRR 29(5):502-528 (2010), section 5.1.
    """

    name = "fej"
    functions = EstimatorFunctions(motion=motion, sensor=sensor, initialise=initialise, prepare_scan=prepare_scan)
    linearisation_points = "linearised_at"
