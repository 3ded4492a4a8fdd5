"""Two runs over the same data: does the start or the frame change what it must not change?"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from slamkit import se2
from slamkit.arrays import Array, covariance, finite_array
from slamkit.errors import InputError
from slamkit.evaluate.gauge.recording import steps
from slamkit.evaluate.gauge.rigid_body import rotations, seen_by_robot
from slamkit.filters.landmark_filter import LandmarkFilter
from slamkit.logs import Log, Truth
from slamkit.protocols import MotionModel, SensorModel


def stochastic_gauge(
    filter_class: Callable[..., LandmarkFilter],
    motion: MotionModel,
    sensor: SensorModel,
    log: Log,
    pose_covariance: ArrayLike,
    pose: ArrayLike = (0.0, 0.0, 0.0),
    **options: Any,
) -> float:
    """Measure how far an uncertain start changes the map relative to the robot.

    The same data are filtered twice: from an exactly known start, and from `pose_covariance`. As long as nothing
    anchors the map (:func:`slamkit.evaluate.gauge.unobservable` gives three motions), the uncertainty of the frame
    has no effect on where landmarks are relative to the robot. A filter that gives another answer has mixed the two.

    Parameters
    ----------
    filter_class : callable
        The estimator.
    motion : MotionModel
    sensor : SensorModel
    log : Log
    pose_covariance : array_like (3, 3)
        Covariance [m², m·rad, rad²] of the uncertain start.
    pose : array_like (3,)
        Where both runs start [m, m, rad].
    **options
        Further arguments of `filter_class`.

    Returns
    -------
    float
        Largest difference [m] between the two runs of Cᵀ(l - p), C = R(θ), over all steps and landmarks.

    Raises
    ------
    InputError
        An argument does not fit, or the two runs have different maps.

    Notes
    -----
    The test assumes nothing about the estimator. Where H N = 0 with one N for all updates, P₀ enters P only as N Σ Nᵀ.
    No gain K = P Hᵀ S⁻¹ depends on that, so the two runs agree up to rounding.
    Barrau & Bonnabel, arXiv:1510.06263 (2015).
    """
    known, uncertain = (filter_class(motion, sensor, pose, P, **options) for P in (None, pose_covariance))
    largest = 0.0
    for _ in zip(steps(known, log), steps(uncertain, log), strict=True):
        _check_same_map(known, uncertain)
        difference = seen_by_robot(known.x) - seen_by_robot(uncertain.x)
        largest = max(largest, float(np.hypot(difference[:, 0], difference[:, 1]).max(initial=0.0)))
    return largest


def equivariance(
    filter_class: Callable[..., LandmarkFilter],
    motion: MotionModel,
    sensor: SensorModel,
    log: Log,
    T: ArrayLike,
    pose: ArrayLike = (0.0, 0.0, 0.0),
    pose_covariance: ArrayLike | None = None,
    **options: Any,
) -> float:
    """Measure how far an estimate depends on the frame in which it is expressed.

    The same data are filtered from `pose` and from T ∘ `pose`, with P₀ rotated. Every estimate must differ by T:
    pose' = T ∘ pose, l' = T l, P' = A P Aᵀ, A = diag(R(T), 1, R(T) …).

    Parameters
    ----------
    filter_class : callable
        The estimator.
    motion : MotionModel
        Its noise must be equivariant: an additive pose noise that differs between the world's x and y is not.
    sensor : SensorModel
        It must measure relative to the robot: what is anchored in the world does not move with T.
    log : Log
    T : array_like (3,)
        Rigid motion of the initial frame [m, m, rad].
    pose : array_like (3,)
        Where the first run starts [m, m, rad].
    pose_covariance : array_like (3, 3), optional
        P₀ of the start [m², m·rad, rad²]; None: exactly known.
    **options
        Further arguments of `filter_class`. A :class:`slamkit.logs.Truth` among them is moved by T as well.

    Returns
    -------
    float
        Largest absolute deviation over all steps and all entries of x [m, rad] and P [m², m·rad, rad²].

    Raises
    ------
    InputError
        An argument does not fit, or the two runs have different maps.

    Notes
    -----
    Deterministic equivariance; Barrau & Bonnabel, arXiv:1510.06263 (2015). The EKF of equivariant models has it.
    """
    t = finite_array("T", T, (3,))
    start = finite_array("pose", pose, (3,))
    P0 = np.zeros((3, 3)) if pose_covariance is None else covariance("pose_covariance", pose_covariance, 3)
    A = rotations(t[2], 0)
    a = filter_class(motion, sensor, start, P0, **options)
    moved: dict[str, Any] = {n: _moved(t, v) if isinstance(v, Truth) else v for n, v in options.items()}
    b = filter_class(motion, sensor, se2.compose(t, start), A @ P0 @ A.T, **moved)
    largest = 0.0
    for _ in zip(steps(a, log), steps(b, log), strict=True):
        _check_same_map(a, b)
        x, A = a.x, rotations(t[2], len(a.landmark_ids))
        expected = np.concatenate([se2.compose(t, x[:3]), se2.transform(t, x[3:].reshape(-1, 2)).ravel()])
        off = b.x - expected
        off[2] = se2.wrap(off[2])
        largest = max(largest, float(np.abs(off).max()), float(np.abs(b.P - A @ a.P @ A.T).max()))
    return largest


def _check_same_map(a: LandmarkFilter, b: LandmarkFilter) -> None:
    if a.landmark_ids != b.landmark_ids:
        raise InputError("the two runs have different maps: a gate rejected a sighting in one of them only")


def _moved(t: Array, truth: Truth) -> Truth:
    landmarks: dict[Hashable, Array] = {i: se2.transform(t, p) for i, p in truth.landmarks.items()}
    return replace(truth, poses=se2.compose(t, truth.poses), landmarks=landmarks)
