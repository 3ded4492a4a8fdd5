"""Accuracy of a trajectory and its map against the truth: matching, alignment, absolute and relative error."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from slamkit import se2
from slamkit.arrays import Array, Indices, finite_array, finite_number
from slamkit.errors import InputError
from slamkit.logs import Truth

__all__ = ["MINIMUM_MATCHES", "Evaluation", "RelativeError", "align", "evaluate", "nearest", "relative_error"]

#: Fewest matched points for which an error is given after alignment. A rigid motion has 3 unknowns and n points give
#: 2n numbers: one point fits exactly whatever the estimate, and two leave a single number, their distance.
MINIMUM_MATCHES = 3


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Errors of an estimate. A field is None where the truth does not suffice to give it."""

    ate_m: float | None  #: absolute trajectory error: root mean square of the matched position errors [m]
    heading_rmse_deg: float | None  #: root mean square of the matched heading errors [°]
    landmark_rmse_m: float | None  #: root mean square of the position errors of the matched landmarks [m]
    matched: int  #: number of poses with a truth
    matched_landmarks: int  #: number of landmarks with a truth
    alignment: Array  #: (3,) the motion that takes the estimate into the frame of the truth [m, m, rad]
    poses: Array  #: (K, 3) the estimated poses in the frame of the truth [m, m, rad]
    landmarks: Mapping[Hashable, Array]  #: the estimated landmarks in the frame of the truth [m]
    aligned_by: str | None = None  #: what determined the alignment: "poses", "landmarks", or None for neither


@dataclass(frozen=True)
class RelativeError:
    """Error of the motion over a fixed stretch of time or path; None where no stretch has a truth at both ends."""

    translation_rmse_m: float | None  #: root mean square of the translation error [m]
    rotation_rmse_deg: float | None  #: root mean square of the rotation error [°]
    pairs: int  #: number of stretches


def nearest(times: ArrayLike, truth_times: ArrayLike, tolerance: float) -> tuple[Indices, Indices]:
    """Match two series of stamps by nearest time, without interpolation.

    i and j match if each is the other's nearest and |times[i] - truth_times[j]| ≤ tolerance. A stamp is therefore in
    at most one pair, and a sparse truth does not count once for every estimate around it. Of two stamps that are
    equally near, the earlier one matches. Of equal stamps the last one matches: it holds the belief after everything
    that happened at that instant.

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
    a, b = _rows("times", times, (-1,)), _rows("truth_times", truth_times, (-1,))
    gap = np.inf if tolerance == np.inf else finite_number("tolerance", tolerance, lower=0.0, unit="seconds")
    if len(a) == 0 or len(b) == 0:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    a_order, b_order = np.argsort(a, kind="stable"), np.argsort(b, kind="stable")
    a, b = a[a_order], b[b_order]
    to_b, to_a = _nearest_row(a, b), _nearest_row(b, a)
    rows = np.flatnonzero((to_a[to_b] == np.arange(len(a))) & (np.abs(b[to_b] - a) <= gap))
    return a_order[rows], b_order[to_b[rows]]


def _nearest_row(of: Array, among: Array) -> Indices:
    """Row of the nearest of the sorted stamps `among`; of equal stamps the last row."""
    after = np.clip(np.searchsorted(among, of), 0, len(among) - 1)
    before = np.maximum(after - 1, 0)
    stamp = np.where(np.abs(of - among[before]) <= np.abs(among[after] - of), among[before], among[after])
    return np.searchsorted(among, stamp, side="right") - 1


def align(estimate: ArrayLike, truth: ArrayLike) -> Array:
    """Compute the rigid motion T that takes the estimated points closest to the true ones.

    Minimises Σᵢ |R(θ) eᵢ + t - gᵢ|² over proper rotations, without scale. With ē, ḡ the centroids and ẽ, g̃ the points
    relative to them: θ = atan2(Σ (ẽ × g̃), Σ ẽ·g̃) and t = ḡ - R(θ) ē. This is Umeyama's solution in the plane.

    The rotation is undetermined for fewer than two points, for points that all coincide, and where every rotation
    fits equally well (both sums vanish, as for a square and its mirror image). Then θ = 0, and only the centroids are
    brought together. Without any points the alignment is the identity.

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
    e, g = _rows("estimate", estimate, (-1, 2)), _rows("truth", truth, (-1, 2))
    if len(e) != len(g):
        raise InputError(f"estimate has {len(e)} points and truth {len(g)}, expected as many of each")
    return _align(e, g)[0]


def _align(e: Array, g: Array) -> tuple[Array, bool]:
    """The alignment of :func:`align`, and whether the points determine its rotation."""
    if len(e) == 0:
        return np.zeros(3), False
    e_mean, g_mean = e.mean(0), g.mean(0)
    de, dg = e - e_mean, g - g_mean
    cross, dot = np.sum(de[:, 0] * dg[:, 1] - de[:, 1] * dg[:, 0]), np.sum(de * dg)
    # A sum counts as zero within the rounding of the coordinates. Its direction is then noise.
    eps = 4 * np.finfo(float).eps
    e_eps, g_eps = eps * np.abs(e).max(), eps * np.abs(g).max()
    rounding = np.abs(de).sum() * g_eps + np.abs(dg).sum() * e_eps + len(e) * e_eps * g_eps
    determined = bool(np.hypot(cross, dot) > rounding)
    theta = float(np.arctan2(cross, dot)) if determined else 0.0
    t = g_mean - se2.rotation(theta) @ e_mean
    return np.array([t[0], t[1], se2.wrap(theta)]), determined


def evaluate(
    times: ArrayLike,
    poses: ArrayLike,
    truth: Truth | None,
    landmarks: Mapping[Any, ArrayLike] | None = None,
    *,
    max_gap: float = 0.1,
    aligned: bool = True,
) -> Evaluation:
    """Compute the absolute errors of a trajectory and its map.

    The poses are matched with the truth by :func:`nearest`. One alignment T, found by :func:`align`, takes the whole
    estimate into the frame of the truth. With pᵢ, θᵢ the matched poses, lⱼ the landmarks whose ids are in both maps,
    and * the truth:

    - ate = √(mean |T pᵢ - pᵢ*|²) [m]
    - heading RMSE = √(mean wrap(θᵢ + θ_T - θᵢ*)²) [°]
    - landmark RMSE = √(mean |T lⱼ - lⱼ*|²) [m]

    T is the alignment of the matched positions if there are at least three and they determine its rotation. Otherwise
    it is the alignment of the matched landmarks under the same condition: a map with a truth is scored even where the
    path has none. If neither determines T, it is the best fit to the few positions that match, for figures only.

    No error is given that the alignment could hide. The trajectory and heading errors need at least three matched
    poses. The heading and landmark errors need a determined rotation, which a robot that stands still does not give.

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
        False where the frame is known, as in a simulation. T is then the identity, and one match gives an error.

    Returns
    -------
    Evaluation

    Raises
    ------
    InputError
        Wrong shapes, a value that is not finite, or a negative gap.

    References
    ----------
    Sturm et al., A benchmark for the evaluation of RGB-D SLAM systems, IROS (2012), section V, for the absolute
    trajectory error.
    """
    t, x = _trajectory(times, poses)
    points = {i: finite_array(f"landmark {i!r}", p, (2,)) for i, p in (landmarks or {}).items()}
    known = _truth(truth)
    rows, truth_rows = nearest(t, known.times, max_gap)
    reference = known.poses[truth_rows]
    common = [i for i in points if i in known.landmarks]
    places = np.array([known.landmarks[i] for i in common]).reshape(-1, 2)
    alignment, aligned_by = np.zeros(3), None
    if aligned:
        own = np.array([points[i] for i in common]).reshape(-1, 2)
        alignment, aligned_by = _frame(x[rows, :2], reference[:, :2], own, places)
    x = se2.compose(alignment, x)
    points = {i: se2.transform(alignment, p) for i, p in points.items()}
    framed = not aligned or aligned_by is not None
    enough = not aligned or len(rows) >= MINIMUM_MATCHES
    turn = np.rad2deg(se2.wrap(x[rows, 2] - reference[:, 2]))
    errors = np.array([points[i] for i in common]).reshape(-1, 2) - places
    return Evaluation(
        ate_m=_rms(x[rows, :2] - reference[:, :2]) if enough else None,
        heading_rmse_deg=_rms(turn[:, None]) if enough and framed else None,
        landmark_rmse_m=_rms(errors) if framed else None,
        matched=len(rows),
        matched_landmarks=len(common),
        alignment=alignment,
        poses=x,
        landmarks=points,
        aligned_by=aligned_by,
    )


def _frame(positions: Array, truth: Array, landmarks: Array, true_landmarks: Array) -> tuple[Array, str | None]:
    """The alignment of :func:`evaluate` from matched positions (n, 2) or landmarks (m, 2), and which it was."""
    by_poses, determined = _align(positions, truth)
    if determined and len(positions) >= MINIMUM_MATCHES:
        return by_poses, "poses"
    by_landmarks, determined = _align(landmarks, true_landmarks)
    if determined and len(landmarks) >= MINIMUM_MATCHES:
        return by_landmarks, "landmarks"
    return by_poses, None


def relative_error(
    times: ArrayLike,
    poses: ArrayLike,
    truth: Truth | None,
    *,
    seconds: float | None = None,
    metres: float | None = None,
    max_gap: float = 0.1,
) -> RelativeError:
    """Compute the relative pose error over a fixed time, or over a fixed distance along the true path.

    A stretch leads from a matched pose i to the first matched pose j that is the given length ahead, up to rounding.
    A stretch that is more than a tenth longer than asked for is left out. Its error is E = (xᵢ*⁻¹ xⱼ*)⁻¹ (xᵢ⁻¹ xⱼ),
    which is the same in every frame and needs no alignment. The results are the root mean squares over all stretches
    of the length of E's translation [m] and of E's angle [°]. Distance is measured along the chords between matched
    true positions: a truth with gaps makes it too short.

    Parameters
    ----------
    times : array_like (K,)
        Time of each estimated pose [s].
    poses : array_like (K, 3)
        Estimated poses [m, m, rad].
    truth : Truth or None
        The truth, or None where there is none.
    seconds, metres : float
        Length of the stretch, > 0, in time [s] or distance [m]. Give exactly one of the two.
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
    Sturm et al., A benchmark for the evaluation of RGB-D SLAM systems, IROS (2012), section V. Over distances: Geiger,
    Lenz & Urtasun, Are we ready for autonomous driving?, CVPR (2012).
    """
    given = [(name, value) for name, value in (("seconds", seconds), ("metres", metres)) if value is not None]
    if len(given) != 1:
        raise InputError(f"seconds is {seconds} and metres is {metres}, expected exactly one of the two")
    name, value = given[0]
    length = finite_number(name, value, above=0.0)
    t, x = _trajectory(times, poses)
    known = _truth(truth)
    rows, truth_rows = nearest(t, known.times, max_gap)
    x, reference = x[rows], known.poses[truth_rows]
    steps = np.linalg.norm(np.diff(reference[:, :2], axis=0), axis=1)
    along = known.times[truth_rows] if metres is None else np.append(0.0, np.cumsum(steps))[: len(rows)]
    if len(rows) == 0:
        return RelativeError(None, None, 0)
    # Rounding of the stamps must not move the end of a stretch from a whole number of periods to the next one.
    ends = np.searchsorted(along, along + 0.999 * length)
    starts = np.flatnonzero(ends < len(rows))
    starts = starts[along[ends[starts]] - along[starts] <= 1.1 * length]
    ends = ends[starts]
    error = se2.between(se2.between(reference[starts], reference[ends]), se2.between(x[starts], x[ends]))
    return RelativeError(_rms(error[:, :2]), _rms(np.rad2deg(error[:, 2:])), len(starts))


def _trajectory(times: ArrayLike, poses: ArrayLike) -> tuple[Array, Array]:
    """Times (K,) and poses (K, 3) of an estimate, checked."""
    t, x = _rows("times", times, (-1,)), _rows("poses", poses, (-1, 3))
    if len(t) != len(x):
        raise InputError(f"poses have {len(x)} rows and times {len(t)}, expected as many of each")
    return t, x


def _truth(truth: Truth | None) -> Truth:
    return Truth(np.empty(0), np.empty((0, 3))) if truth is None else truth


def _rms(errors: Array) -> float | None:
    """Root mean square of the rows' lengths; None without rows."""
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1)))) if len(errors) else None


def _rows(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Check `value` by :func:`finite_array`; an empty list counts as no rows of the right width."""
    empty = value.shape == (0,) if isinstance(value, np.ndarray) else isinstance(value, Sequence) and len(value) == 0
    nothing = empty and not isinstance(value, str)
    return finite_array(name, np.empty((0, *shape[1:])) if nothing else value, shape)
