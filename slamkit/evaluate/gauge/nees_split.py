"""The NEES of the whole state, split into gauge and relative map."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cho_factor, cho_solve

from slamkit import se2
from slamkit.arrays import finite_array
from slamkit.errors import InputError
from slamkit.evaluate.gauge.pose_given_map import body_covariance, pose_given_map
from slamkit.evaluate.gauge.rigid_body import seen_by_robot
from slamkit.evaluate.nees import ATOL, nees
from slamkit.filters.landmark_filter import LandmarkFilter


@dataclass(frozen=True)
class NeesSplit:
    """NEES of the whole state, split into the contributions of the gauge and of the relative map."""

    gauge: float  #: of the pose, given the relative map: χ² with `gauge_dof` degrees of freedom if consistent
    gauge_dof: int  #: 3, or less where the claimed covariance is singular
    relative: float  #: of the landmarks as the robot sees them: χ² with `relative_dof` degrees of freedom
    relative_dof: int  #: 2N

    @property
    def total(self) -> float:
        """NEES of the whole state, gauge + relative."""
        return self.gauge + self.relative

    @property
    def relative_per_dof(self) -> float:
        """Relative NEES per degree of freedom: 1 on average if consistent; NaN for an empty map."""
        return self.relative / self.relative_dof if self.relative_dof else float("nan")


def nees_split(filter: LandmarkFilter, truth_pose: ArrayLike, truth_landmarks: Mapping[Any, ArrayLike]) -> NeesSplit:
    """Split the NEES of the whole state into that of the gauge and that of the relative map.

    The split holds whatever anchors the map: the gauge part is the NEES of the pose given the relative map.

    Parameters
    ----------
    filter : LandmarkFilter
    truth_pose : array_like (3,)
        True pose [m, m, rad].
    truth_landmarks : mapping id → array_like (2,)
        True positions [m] of at least the landmarks in the map.

    Returns
    -------
    NeesSplit

    Raises
    ------
    InputError
        A shape does not fit, a value is not finite, or a landmark of the map has no truth.
    DivergenceError
        The claimed covariance of the relative map is not positive definite, or the error contradicts a gauge that
        the filter claims to know exactly (see :func:`slamkit.evaluate.nees.nees`).

    Notes
    -----
    Letters: state (p, θ, l₁ … l_N); J = [0 -1; 1 0]; C = R(θ); X the pose as a rigid motion; ^ an estimate.

    Coordinates in the robot's frame: g = log(X̂⁻¹X) (3), which has the NEES of the invariant error log(XX̂⁻¹), and
    r = Cᵀ(l - p) - Ĉᵀ(l̂ - p̂) (2N), which does not depend on the gauge. Their covariance is P' = B P Bᵀ with
    B = [Ĉᵀ ĈᵀJ(p̂ - p_lin) 0; 0 1 0; -Ĉᵀ -ĈᵀJ(l_lin - p_lin) Ĉᵀ]. Its lever arms are the estimator's own
    linearisation points, so that N does not enter r. Then the NEES of (g, r) is exactly
    rᵀP_rr⁻¹r + (g - P_gr P_rr⁻¹ r)ᵀ (P_gg - P_gr P_rr⁻¹ P_rg)⁻¹ (g - P_gr P_rr⁻¹ r).
    The relative part is the same for every rigid motion of the truth.

    With lever arms at the current mean, r of an estimator that linearises elsewhere would contain claimed gauge
    uncertainty: its relative part would look smaller, and its gauge part would lose its meaning.

    A claimed gauge covariance that is singular (P₀ = 0) counts on its eigenspace only: see `gauge_dof`. Directions
    below the rounding of its computation, 1e-8 of the pose's deviation, count as known exactly.
    """
    X = finite_array("truth_pose", truth_pose, (3,))
    missing = [i for i in filter.landmark_ids if i not in truth_landmarks]
    if missing:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise InputError(f"truth_landmarks lack {missing[0]!r}{more}, expected every landmark of the map")
    places = [finite_array(f"truth of landmark {i!r}", truth_landmarks[i], (2,)) for i in filter.landmark_ids]
    truth = np.concatenate([X, *places])
    r = (seen_by_robot(truth) - seen_by_robot(filter.x)).ravel()
    e = np.concatenate([se2.log(se2.between(filter.pose, X)), r])
    P = body_covariance(filter)
    C, g = pose_given_map(P, e)
    relative = float(r @ cho_solve(cho_factor(P[3:, 3:], lower=True), r)) if len(r) else 0.0
    rounding = sqrt(len(P) * np.finfo(float).eps * float(np.diag(P)[:3].max()))
    gauge = nees(g, C, atol=max(ATOL, rounding))
    return NeesSplit(float(gauge.values), int(gauge.dof), relative, len(r))
