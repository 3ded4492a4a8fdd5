"""The observability-constrained EKF: of all lever arms that keep the gauge unlearnt, those nearest to the estimates."""

from __future__ import annotations

from typing import Any

from slamkit.belief.dense import propagate
from slamkit.compiled import OwnFields, compiled
from slamkit.cycle.estimator import EstimatorFunctions
from slamkit.cycle.standard import motion as standard_motion
from slamkit.filters import first_estimates
from slamkit.filters.ekf import EKFSLAM

# All lever arms are first estimates moved by one common vector -Δ, so that their differences stay what they were;
# Δ is the least-squares choice over the robot and the landmarks of the scan, which is what the published linear
# system solves. The own fields are Δ = `shift`, the `position` before the last prediction, and whether
# that is `pending`: no scan has followed it yet. ``state.belief.linearised_at[:2]`` is
# q = p_{k|k-1} + Δ, so that l_first - q is the lever arm.


own = OwnFields(shift=2, position=2, pending=1)


@compiled("void(models, state, vector, real)", generic=True)
def motion(models: Any, state: Any, u: Any, dt: float) -> None:
    """F for a scan that sees nothing; `prepare_scan` moves the lever arm when it knows what is seen."""
    standard_motion(models, state, u, dt)
    mine = own(state)
    mine.pending = 1.0
    mine.position[0], mine.position[1] = state.belief.mean[0], state.belief.mean[1]


@compiled("void(models, state, integers, flag)", generic=True)
def prepare_scan(models: Any, state: Any, slots: Any, moved: bool) -> None:
    """Choose Δ as the mean of q - p and of l_first - l̂ over the known landmarks of the scan."""
    mine, points, mean = own(state), state.belief.linearised_at, state.belief.mean
    shift, position = mine.shift, mine.position
    if mine.pending == 0.0:
        return
    if moved:
        tentative_x, tentative_y = points[0] - position[0], points[1] - position[1]
    else:  # the prediction was a call of its own, and chose for a scan that sees nothing
        tentative_x, tentative_y = shift[0], shift[1]
    if slots.shape[0] > 0:
        mine.pending = 0.0
    x, y, n = tentative_x, tentative_y, 1
    for slot in slots:
        if slot >= 0:
            x += points[slot] - mean[slot]
            y += points[slot + 1] - mean[slot + 1]
            n += 1
    shift[0], shift[1] = x / n, y / n
    points[0], points[1] = mean[0] + shift[0], mean[1] + shift[1]
    if n > 1:
        move_lever(state, shift[0] - tentative_x, shift[1] - tentative_y)


@compiled("void(state, real, real)")
def move_lever(state: Any, dx: float, dy: float) -> None:
    """Replace F by T F, T = [I, J(dx, dy); 0 1], in the prediction already made: P ← T (P - Q) Tᵀ + Q; O(D)."""
    F, Q, old, rest = state.last.F, state.last.Q, state.last.F.copy(), state.last.Q.copy()
    F[:, :] = 0.0
    F[0, 0] = F[1, 1] = F[2, 2] = 1.0
    F[0, 2], F[1, 2] = -dy, dx
    for i in range(3):
        for j in range(3):
            s = 0.0
            for a in range(3):
                for b in range(3):
                    s += F[i, a] * rest[a, b] * F[j, b]
            Q[i, j] = rest[i, j] - s
    propagate(state)
    for i in range(2):
        for j in range(3):
            old[i, j] += F[i, 2] * old[2, j]
    for i in range(3):
        for j in range(3):
            F[i, j], Q[i, j] = old[i, j], rest[i, j]


class ObservabilityConstrainedEKFSLAM(EKFSLAM):
    """Observability-constrained EKF-SLAM (OC-EKF 2.0): first-estimates Jacobians that follow the estimates.

    Parameters, attributes and errors are those of :class:`slamkit.EKFSLAM`.

    Notes
    -----
    The lever arms keep the differences of the first estimates, so the filter cannot learn the global heading, and
    are otherwise as close to the current estimates as these differences allow. Sightings that come after a scan, in
    calls of `observe` of their own, use the scan's choice. The landmark's initialisation differs from the published
    one, which breaks the property it is made for.

    References
    ----------
    Huang, Mourikis & Roumeliotis, IJRR 29(5):502-528 (2010), section 5.2.
    """

    name = "oc"
    own_fields = own
    functions = EstimatorFunctions(
        motion=motion, sensor=first_estimates.sensor, initialise=first_estimates.initialise, prepare_scan=prepare_scan
    )
    linearisation_points = "linearised_at"
