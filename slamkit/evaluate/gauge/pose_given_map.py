"""The covariance in the robot's frame, and the pose given the relative map: what deviation and NEES split share."""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from slamkit.arrays import Array
from slamkit.errors import DivergenceError
from slamkit.evaluate.gauge.recording import linearisation_points
from slamkit.evaluate.gauge.rigid_body import rotations, turned
from slamkit.filters.landmark_filter import LandmarkFilter


def body_covariance(filter: LandmarkFilter) -> Array:
    """Compute B P Bᵀ (D, D), with the B of :func:`slamkit.evaluate.gauge.nees_split`."""
    points, x, P = linearisation_points(filter), filter.x, filter.P
    D, N = len(x), (len(x) - 3) // 2
    levers = points.copy()
    levers[:2] -= x[:2]
    levers[3:] -= np.tile(points[:2], N)
    B = np.eye(D)
    B[3:, :2] = -np.tile(np.eye(2), (N, 1))
    B[:, 2] -= turned(levers)
    B = rotations(-x[2], N) @ B
    return np.asarray(B @ P @ B.T)


def pose_given_map(P: Array, e: Array) -> tuple[Array, Array]:
    """Condition the pose on the relative map.

    Parameters
    ----------
    P : ndarray (D, D)
        Covariance in the robot's frame, see :func:`body_covariance`.
    e : ndarray (D,)
        Error in the same coordinates.

    Returns
    -------
    covariance : ndarray (3, 3)
        P_gg - P_gr P_rr⁻¹ P_rg.
    error : ndarray (3,)
        g - P_gr P_rr⁻¹ r.

    Raises
    ------
    DivergenceError
        P_rr is not positive definite.
    """
    if len(P) == 3:
        return P, e
    try:
        factor = cho_factor(P[3:, 3:], lower=True)
    except np.linalg.LinAlgError:
        smallest = np.linalg.eigvalsh(P[3:, 3:])[0]
        raise DivergenceError(
            "the covariance of the map relative to the robot is not positive definite "
            f"(smallest eigenvalue {smallest:.3g} m²), so the gauge cannot be separated from it"
        ) from None
    gain = cho_solve(factor, P[3:, :3]).T
    C = P[:3, :3] - gain @ P[3:, :3]
    return (C + C.T) / 2, e[:3] - gain @ e[3:]
