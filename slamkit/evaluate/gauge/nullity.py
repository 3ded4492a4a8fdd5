"""Nullity: how many directions of the state the updates of a run left unmeasured."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np

from slamkit.arrays import Array, finite_number
from slamkit.errors import InputError
from slamkit.evaluate.gauge.recording import observability_matrix
from slamkit.filters.landmark_filter import LandmarkFilter
from slamkit.logs import Log
from slamkit.models import RelativePosition, Unicycle
from slamkit.simulate import World


@dataclass(frozen=True, eq=False)
class Nullity:
    """How many directions of the state a recorded run left unmeasured."""

    nullity: int  #: number of singular values at or below tolerance · largest
    singular_values: Array  #: (D,) of the whitened local observability matrix, descending
    tolerance: float  #: share of the largest singular value that counts as zero


def nullity(filter: LandmarkFilter, log: Log, tolerance: float = 5e-6) -> Nullity:
    """Compute the nullity of the local observability matrix of a recorded run.

    The matrix stacks R^(-1/2) H_k Φ_{k-1} … Φ_0 over all sightings. Its nullity is the number of singular values at or
    below `tolerance` times the largest.

    Parameters
    ----------
    filter : LandmarkFilter
        The estimator at the start of the log. A copy makes the run, so the filter does not change.
    log : Log
    tolerance : float
        Share of the largest singular value at or below which a singular value counts as zero, in (0, 1). Analytic
        Jacobians leave 1e-16, the regressions of an unscented filter up to 4e-7 (as α²), and a heading that is learnt
        6e-5 or more in 200 steps of the built-in worlds.

    Returns
    -------
    Nullity
        A consistent estimator has as many as :func:`slamkit.evaluate.gauge.unobservable` gives: three where nothing
        anchors the map. The standard EKF then has two, because its matrix takes the heading for measured. The nullity
        is larger if the log does not connect its landmarks.

    Raises
    ------
    InputError
        The tolerance is out of its interval, or the log does not fit the filter.

    Notes
    -----
    The Jacobians are those that the estimator used in each of its updates. A landmark that is new at step k enters as
    the measurement that its first sighting is: H = [-G_x, I] with the noise G_z R G_zᵀ. A wrong initialisation
    therefore shows. For the invariant filter Φ includes the move to the new mean, for the robocentric filter the move
    to the robot's new frame. The unobservable directions of the robocentric filter are those of the start as the robot
    sees it, which no measurement of landmarks involves. The Jacobians of an unscented filter are the matrices of its
    regressions. With sigma points over the whole state, H = P_xzᵀ P_xx⁻¹ has columns for every landmark. The steps run
    as Python, about a millisecond each.
    Huang, Mourikis & Roumeliotis, IJRR 29(5):502-528 (2010), which assumes that all landmarks are already mapped.
    """
    share = finite_number("tolerance", tolerance, above=0.0)
    if not share < 1:
        raise InputError(f"tolerance is {tolerance}, expected a share of the largest singular value in (0, 1)")
    matrix = observability_matrix(filter, log)
    # Only the triangular factor matters. Padding with zero rows gives every column its singular value.
    padded = np.concatenate([matrix, np.zeros((matrix.shape[1], matrix.shape[1]))])
    values = np.linalg.svd(np.linalg.qr(padded, mode="r"), compute_uv=False)
    return Nullity(int(np.sum(values <= share * values[0])), values, share)


def observability_world() -> World:
    """Give the world on which nullity is compared: five landmarks, one scan that starts them all, forty further steps.

    The robot drives 0.5 m/s on a circle of 2.5 m with dt 1 s. The landmarks are 2-4 m from its centre and always in
    sight. The sensor gives relative positions with 0.1 m an axis; σ_v 0.05 m/s, σ_ω 0.05 rad/s;
    P₀ = diag(0.1² m², 0.1² m², (3°)²).

    Returns
    -------
    World
    """
    angle, distance = 2 * pi * np.arange(5) / 5, np.array([3.6, 2.0, 4.0, 2.8, 3.2])
    places = np.column_stack([distance * np.cos(angle), 2.5 + distance * np.sin(angle)])
    return World(
        name="observability",
        landmarks=dict(enumerate(places)),
        motion=Unicycle(0.05, 0.05),
        sensor=RelativePosition(0.1),
        controls=np.tile([0.5, 0.2], (41, 1)),
        dt=1.0,
        pose=np.zeros(3),
        pose_covariance=np.diag([0.01, 0.01, (pi / 60) ** 2]),
    )
