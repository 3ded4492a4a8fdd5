"""Accuracy of trajectories and maps against the truth: alignment, absolute and relative error, dead reckoning."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slamkit import se2
from slamkit.arrays import finite_array
from slamkit.errors import InputError, ModelError
from slamkit.logs import Log, Truth
from slamkit.protocols import MotionModel

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Evaluation:
    """An estimate beside the truth; a field is None where there is no truth to compare with."""

    ate_m: float | None  #: root mean square of the matched position errors [m]
    heading_rmse_deg: float | None  #: root mean square of the matched heading errors [°]
    landmark_rmse_m: float | None  #: root mean square of the position errors of the matched landmarks [m]
    matched: int  #: number of poses with a truth
    matched_landmarks: int  #: number of landmarks with a truth
    alignment: Array  #: (3,) the motion that takes the estimate into the frame of the truth [m, m, rad]
    poses: Array  #: (K, 3) the estimated poses in the frame of the truth [m, m, rad]
    landmarks: Mapping[Hashable, Array]  #: the estimated landmarks in the frame of the truth [m]


@dataclass(frozen=True)
class RelativeError:
    """Error of the motion over a fixed stretch of time or path; None where no stretch has a truth at both ends."""

    translation_rmse_m: float | None  #: root mean square of the translation's error [m]
    rotation_rmse_deg: float | None  #: root mean square of the rotation's error [°]
    pairs: int  #: number of stretches


def nearest(times: ArrayLike, truth_times: ArrayLike, tolerance: float) -> tuple[IntArray, IntArray]:
    """Match two series of stamps by nearest time; nothing is interpolated.

    i and j match where each is the other's nearest and |times[i] - truth_times[j]| ≤ tolerance, so a stamp is in one
    pair at most: a sparse truth does not count once for every estimate around it. Of two that are equally near the
    earlier is taken, of equal stamps the one that comes last (the belief after all that happened at that instant).

    Parameters
    ----------
    times : array_like (n,)
        Stamps of the estimate [s], in any order.
    truth_times : array_like (m,)
        Stamps of the truth [s], in any order.
    tolerance : float
        Largest difference [s], ≥ 0.

    Returns
    -------
    rows, truth_rows : ndarray (p,) of int
        Indices into `times` and `truth_times`, in the order of time.

    Raises
    ------
    InputError
        Wrong shapes, a stamp that is not finite, or a negative tolerance.
    """
    a, b = _array("times", times, (-1,)), _array("truth_times", truth_times, (-1,))
    if not tolerance >= 0:
        raise InputError(f"tolerance is {tolerance}, expected a duration ≥ 0 s")
    if len(a) == 0 or len(b) == 0:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    a_order, b_order = np.argsort(a, kind="stable"), np.argsort(b, kind="stable")
    a, b = a[a_order], b[b_order]
    to_b, to_a = _nearest_row(a, b), _nearest_row(b, a)
    rows = np.flatnonzero((to_a[to_b] == np.arange(len(a))) & (np.abs(b[to_b] - a) <= tolerance))
    return a_order[rows], b_order[to_b[rows]]


def _nearest_row(of: Array, among: Array) -> IntArray:
    """Row of the nearest of the sorted stamps `among`, the last one where stamps are equal."""
    after = np.clip(np.searchsorted(among, of), 0, len(among) - 1)
    before = np.maximum(after - 1, 0)
    stamp = np.where(np.abs(of - among[before]) <= np.abs(among[after] - of), among[before], among[after])
    return np.searchsorted(among, stamp, side="right") - 1


def align(estimate: ArrayLike, truth: ArrayLike) -> Array:
    """The rigid motion T that takes the estimated points closest to the true ones.

    Minimises Σᵢ |R(θ) eᵢ + t - gᵢ|² over proper rotations, without scale. With ẽ, g̃ the points from their centroids
    ē, ḡ: θ = atan2(Σ (ẽ × g̃), Σ ẽ·g̃) and t = ḡ - R(θ) ē, which is Umeyama's solution in the plane.

    The rotation is undetermined for less than two points, for points that all coincide, and where every rotation is
    equally good (both sums vanish, as for a square and its mirror image): then θ = 0, and only the centroids are
    brought together. Of no points the alignment is the identity.

    Parameters
    ----------
    estimate, truth : array_like (n, 2)
        Corresponding points [m].

    Returns
    -------
    ndarray (3,)
        T as a pose [m, m, rad]: ``se2.transform(T, estimate)`` lies on `truth`.

    Raises
    ------
    InputError
        Wrong shapes, or a value that is not finite.

    References
    ----------
    Umeyama, Least-squares estimation of transformation parameters between two point patterns, IEEE PAMI 13(4):376-380
    (1991).
    """
    e, g = _array("estimate", estimate, (-1, 2)), _array("truth", truth, (-1, 2))
    if len(e) != len(g):
        raise InputError(f"estimate has {len(e)} points, truth has {len(g)}: expected as many")
    if len(e) == 0:
        return np.zeros(3)
    e_mean, g_mean = e.mean(0), g.mean(0)
    de, dg = e - e_mean, g - g_mean
    cross, dot = np.sum(de[:, 0] * dg[:, 1] - de[:, 1] * dg[:, 0]), np.sum(de * dg)
    # A coordinate is known to its rounding only; a sum within what that makes of it is zero, and has no direction.
    eps = 4 * np.finfo(float).eps
    e_eps, g_eps = eps * np.abs(e).max(), eps * np.abs(g).max()
    rounding = np.abs(de).sum() * g_eps + np.abs(dg).sum() * e_eps + len(e) * e_eps * g_eps
    theta = float(np.arctan2(cross, dot)) if np.hypot(cross, dot) > rounding else 0.0
    t = g_mean - se2.rotation(theta) @ e_mean
    return np.array([t[0], t[1], se2.wrap(theta)])


def evaluate(
    times: ArrayLike,
    poses: ArrayLike,
    truth: Truth | None,
    landmarks: Mapping[Any, ArrayLike] | None = None,
    *,
    max_gap: float = 0.1,
    aligned: bool = True,
) -> Evaluation:
    """Absolute errors of a trajectory and its map.

    The poses are matched with the truth by :func:`nearest`, and :func:`align` of the matched positions gives the one
    alignment T under which everything is compared: ate = √(mean |T pᵢ - pᵢ*|²), the heading error is
    θᵢ + θ_T - θᵢ* wrapped, and a landmark's error is |T l - l*| over the ids that both maps have.

    Parameters
    ----------
    times : array_like (K,)
        Time of each estimated pose [s].
    poses : array_like (K, 3)
        Estimated poses [m, m, rad].
    truth : Truth or None
        The truth, or None where there is none.
    landmarks : mapping id → array_like (2,), optional
        Estimated map [m].
    max_gap : float
        Largest difference in time between a pose and its truth [s].
    aligned : bool
        False where the frame is known, as in a simulation: T is then the identity.

    Returns
    -------
    Evaluation
        With `aligned` and no matched pose the alignment is unknown, so there is no landmark error either.

    Raises
    ------
    InputError
        Wrong shapes, a value that is not finite, or a negative gap.

    References
    ----------
    Sturm et al., A benchmark for the evaluation of RGB-D SLAM systems, IROS (2012), section V, for the absolute
    trajectory error.
    """
    t, x = _array("times", times, (-1,)), _array("poses", poses, (-1, 3))
    if len(t) != len(x):
        raise InputError(f"poses have {len(x)} rows, times {len(t)}: expected as many")
    points = {i: _array(f"landmark {i!r}", p, (2,)) for i, p in (landmarks or {}).items()}
    known = Truth(np.empty(0), np.empty((0, 3))) if truth is None else truth
    rows, truth_rows = nearest(t, known.times, max_gap)
    reference = known.poses[truth_rows]
    alignment = align(x[rows, :2], reference[:, :2]) if aligned else np.zeros(3)
    x = se2.compose(alignment, x)
    points = {i: se2.transform(alignment, p) for i, p in points.items()}
    common = [i for i in points if i in known.landmarks] if len(rows) or not aligned else []
    errors = np.array([points[i] - known.landmarks[i] for i in common]).reshape(-1, 2)
    turn = np.rad2deg(se2.wrap(x[rows, 2] - reference[:, 2]))
    return Evaluation(
        ate_m=_rms(x[rows, :2] - reference[:, :2]),
        heading_rmse_deg=_rms(turn[:, None]),
        landmark_rmse_m=_rms(errors),
        matched=len(rows),
        matched_landmarks=len(common),
        alignment=alignment,
        poses=x,
        landmarks=points,
    )


def relative_error(
    times: ArrayLike,
    poses: ArrayLike,
    truth: Truth | None,
    *,
    seconds: float | None = None,
    metres: float | None = None,
    max_gap: float = 0.1,
) -> RelativeError:
    """Relative pose error over a fixed time, or a fixed distance along the true path.

    From every matched pose i to the first one j that is as far on as was asked for (but for rounding), unless it is
    more than a tenth farther: E = (xᵢ*⁻¹ xⱼ*)⁻¹ (xᵢ⁻¹ xⱼ). Needs no alignment: E is the same in every frame. Distance
    is measured along the chords between matched true positions, so a truth with gaps makes it too short.

    Parameters
    ----------
    times : array_like (K,)
        Time of each estimated pose [s].
    poses : array_like (K, 3)
        Estimated poses [m, m, rad].
    truth : Truth or None
        The truth, or None where there is none.
    seconds, metres : float
        Length of the stretch, > 0, in time [s] or distance [m]: exactly one of the two.
    max_gap : float
        Largest difference in time between a pose and its truth [s].

    Returns
    -------
    RelativeError

    Raises
    ------
    InputError
        Wrong shapes, a value that is not finite, a length that is not positive, or not exactly one length.

    References
    ----------
    Sturm et al., A benchmark for the evaluation of RGB-D SLAM systems, IROS (2012), section V; over distances Geiger,
    Lenz & Urtasun, Are we ready for autonomous driving?, CVPR (2012).
    """
    given = [(name, value) for name, value in (("seconds", seconds), ("metres", metres)) if value is not None]
    if len(given) != 1:
        raise InputError(f"seconds is {seconds} and metres is {metres}, expected exactly one of the two")
    name, length = given[0]
    if not 0 < length < np.inf:
        raise InputError(f"{name} is {length}, expected a finite length > 0")
    t, x = _array("times", times, (-1,)), _array("poses", poses, (-1, 3))
    if len(t) != len(x):
        raise InputError(f"poses have {len(x)} rows, times {len(t)}: expected as many")
    known = Truth(np.empty(0), np.empty((0, 3))) if truth is None else truth
    rows, truth_rows = nearest(t, known.times, max_gap)
    x, reference = x[rows], known.poses[truth_rows]
    steps = np.linalg.norm(np.diff(reference[:, :2], axis=0), axis=1)
    along = known.times[truth_rows] if metres is None else np.append(0.0, np.cumsum(steps))[: len(rows)]
    if len(rows) == 0:
        return RelativeError(None, None, 0)
    # The rounding of the stamps must not push a stretch over a whole number of periods to the next one.
    ends = np.searchsorted(along, along + 0.999 * length)
    starts = np.flatnonzero(ends < len(rows))
    starts = starts[along[ends[starts]] - along[starts] <= 1.1 * length]
    ends = ends[starts]
    error = se2.between(se2.between(reference[starts], reference[ends]), se2.between(x[starts], x[ends]))
    return RelativeError(_rms(error[:, :2]), _rms(np.rad2deg(error[:, 2:])), len(starts))


def dead_reckoning(log: Log, motion: MotionModel, pose: ArrayLike = (0.0, 0.0, 0.0)) -> tuple[Array, Array]:
    """The motion model alone: where the controls lead if nothing is ever sighted.

    Parameters
    ----------
    log : Log
    motion : MotionModel
    pose : array_like (3,)
        Where to start [m, m, rad].

    Returns
    -------
    times : ndarray (K,)
        Time at the end of each step of ``log.schedule`` [s], as in a History.
    poses : ndarray (K, 3)
        Pose then [m, m, rad].

    Raises
    ------
    InputError
        `pose` has a wrong shape or is not finite.
    ModelError
        The model gave a pose that is not finite.
    """
    x = _array("pose", pose, (3,))
    x[2] = se2.wrap(x[2])
    schedule = log.schedule
    poses = np.empty((len(schedule.times), 3))
    for k, (dt, row) in enumerate(zip(schedule.dt.tolist(), schedule.control.tolist(), strict=True)):
        if dt > 0:
            x = np.array(motion.move(x, log.controls[row], dt))
            x[2] = se2.wrap(x[2])
        poses[k] = x
    if not np.all(np.isfinite(poses)):
        step = int(np.argmin(np.isfinite(poses).all(1)))
        raise ModelError(f"{motion!r} gave a pose that is not finite at {schedule.times[step]} s (step {step})")
    return schedule.times.copy(), poses


def _rms(errors: Array) -> float | None:
    """Root mean square of the rows' lengths; None of no rows."""
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1)))) if len(errors) else None


def _array(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    """`value` as a finite array of that shape, -1 standing for any length; an empty list fits (-1, …)."""
    nothing = shape[0] == -1 and isinstance(value, Sequence | np.ndarray) and np.array_equal(value, [])
    return finite_array(name, np.empty((0, *shape[1:])) if nothing else value, shape)
