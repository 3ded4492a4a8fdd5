"""Convergence of the map: its covariance without the gauge, and the lower bound that the start sets."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from slamkit.arrays import Array, covariance, finite_array
from slamkit.errors import InputError
from slamkit.evaluate.gauge.directions import null_directions
from slamkit.evaluate.gauge.rigid_body import J
from slamkit.filters.landmark_filter import LandmarkFilter


def relative_map_covariance(filter: LandmarkFilter) -> Array:
    """Compute the map's covariance without the gauge: how well the landmarks are known relative to each other.

    Parameters
    ----------
    filter : LandmarkFilter
        Its map holds at least two landmarks.

    Returns
    -------
    ndarray (2N, 2N)
        Π P_mm Πᵀ [m²] with Π = I - N_m (N_mᵀ N_m)⁻¹ N_mᵀ and N_m the landmarks' rows of
        :func:`slamkit.evaluate.gauge.null_directions`. Its rank is at most 2N - 3. It goes to zero as the same map is
        seen again and again.

    Raises
    ------
    InputError
        Fewer than two landmarks.

    Notes
    -----
    Dissanayake, Newman, Clark, Durrant-Whyte & Csorba, IEEE Trans. Robotics and Automation 17(3) (2001), theorem 2.
    """
    if len(filter.landmark_ids) < 2:
        raise InputError(f"the map holds {len(filter.landmark_ids)} landmarks, expected at least 2")
    N = null_directions(filter)[3:]
    # About the map's centre the columns are orthogonal, so that a map far from the origin loses no digits.
    N[:, 2] -= N[:, :2] @ (N[:, :2].T @ N[:, 2]) / (len(N) / 2)
    Q, _ = np.linalg.qr(N)
    P = filter.P[3:, 3:]
    P = P - Q @ (Q.T @ P)
    P = P - (P @ Q) @ Q.T
    return np.asarray((P + P.T) / 2)


def lower_bound_gap(filter: LandmarkFilter, pose_covariance: ArrayLike, pose: ArrayLike) -> float:
    """Compute how far the map's covariance stays above its lower bound, the initial uncertainty of the pose.

    The bound holds as long as nothing anchors the map (:func:`slamkit.evaluate.gauge.unobservable` gives three
    motions).

    Parameters
    ----------
    filter : LandmarkFilter
        After a run; its map holds at least one landmark.
    pose_covariance : array_like (3, 3)
        P₀ [m², m·rad, rad²] of the start.
    pose : array_like (3,)
        Where the run started [m, m, rad]. For a filter that linearises at the truth: where the truth started.

    Returns
    -------
    float
        Smallest eigenvalue [m²] of P_mm - A₀ P₀ A₀ᵀ with A₀ of rows [I, J(lᵢ - p₀)] and lᵢ where the estimator
        evaluates N. It is negative beyond rounding only if the filter has learnt its gauge.

    Raises
    ------
    InputError
        A shape does not fit, a value is not finite, or the map is empty.

    Notes
    -----
    Dissanayake, Newman, Clark, Durrant-Whyte & Csorba, IEEE Trans. Robotics and Automation 17(3) (2001), theorem 3,
    extended to an uncertain heading.
    """
    P0, start = covariance("pose_covariance", pose_covariance, 3), finite_array("pose", pose, (3,))
    if not filter.landmark_ids:
        raise InputError("the map is empty, expected at least one landmark")
    A0 = null_directions(filter)[3:]
    A0[:, 2] -= A0[:, :2] @ J @ start[:2]
    return float(np.linalg.eigvalsh(filter.P[3:, 3:] - A0 @ P0 @ A0.T)[0])
