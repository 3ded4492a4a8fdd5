"""Gauge deviation: what a filter claims to know about the heading of robot and map together."""

from __future__ import annotations

import copy
from math import sqrt

import numpy as np
from numpy.typing import ArrayLike

from slamkit.arrays import Array, finite_array
from slamkit.evaluate.gauge.pose_given_map import body_covariance, pose_given_map
from slamkit.evaluate.gauge.recording import steps
from slamkit.filters.landmark_filter import LandmarkFilter
from slamkit.logs import Log


def gauge_deviation(filter: LandmarkFilter) -> float:
    """Compute the standard deviation that the filter claims for the heading of robot and map as one rigid body.

    Parameters
    ----------
    filter : LandmarkFilter

    Returns
    -------
    float
        √[(Nᵀ P⁻¹ N)⁻¹]_θθ [rad], with the N of :func:`slamkit.evaluate.gauge.null_directions`. As long as nothing
        observes the heading (:func:`slamkit.evaluate.gauge.unobservable`), no prediction and no update may lower it.

    Raises
    ------
    DivergenceError
        The claimed covariance of the relative map is not positive definite.

    Notes
    -----
    P⁻¹ is not formed. With relative coordinates r, in which N vanishes, the expression equals the deviation of the
    heading given the relative map, √(P_θθ - P_θr P_rr⁻¹ P_rθ), which also exists for a singular P.

    **With a start that is known exactly (P₀ = 0) there is no gauge deviation that could fall.** The value is then what
    the motion before the first sighting left. Without such motion it is zero up to rounding, about 1e-8 of the
    heading's deviation. Such a run does not show whether the filter learns its gauge: start from a positive definite
    P₀ to find out.
    """
    P = body_covariance(filter)
    squared, _ = pose_given_map(P, np.zeros(len(P)))
    return sqrt(max(float(squared[2, 2]), 0.0))


def gauge_deviations(filter: LandmarkFilter, log: Log) -> Array:
    """Compute the gauge deviation after each step of a log.

    Parameters
    ----------
    filter : LandmarkFilter
        The estimator at the start of the log. A copy makes the run, so the filter does not change.
    log : Log

    Returns
    -------
    ndarray (K,)
        :func:`gauge_deviation` [rad] after each of the log's K steps.

    Raises
    ------
    InputError
        The log does not fit the filter.
    DivergenceError
        See :func:`gauge_deviation`.
    """
    f = copy.deepcopy(filter)
    return np.array([gauge_deviation(f) for _ in steps(f, log)])


def gauge_drop(deviations: ArrayLike) -> float:
    """Compute the largest fall of a gauge deviation below an earlier value: what the filter claims to have learnt.

    Parameters
    ----------
    deviations : array_like (K,)
        Gauge deviations [rad] in the order of time; K may be 0.

    Returns
    -------
    float
        max over j < k of dⱼ - d_k [rad], at least 0.

    Raises
    ------
    InputError
        Not one row of finite numbers.
    """
    d = finite_array("deviations", deviations, (-1,))
    return float(np.max(np.maximum.accumulate(d) - d, initial=0.0))
