"""The gauge: the rigid motions of robot and map together, and which of them nothing observes."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from slamkit import se2
from slamkit.arrays import Array, finite_array
from slamkit.errors import InputError
from slamkit.evaluate.gauge.recording import linearisation_points
from slamkit.evaluate.gauge.rigid_body import turned
from slamkit.filters.landmark_filter import LandmarkFilter
from slamkit.logs import Log
from slamkit.protocols import MotionModel, SensorModel

GAUGE_DIM = 3  #: rigid motions of the plane: translation along x and y, rotation about the origin

_ROUNDING = 1e-9  # what a sighting says about a rigid motion is zero below this share of the terms that cancel
_TOLERANCE = 5e-6  # a singular value below this counts as zero over a path, as in slamkit.evaluate.gauge.nullity


def null_directions(filter: LandmarkFilter, motions: ArrayLike | None = None) -> Array:
    """Give the directions of the state that rigid motions of robot and map take, as this estimator linearises them.

    Parameters
    ----------
    filter : LandmarkFilter
    motions : array_like (3, m), optional
        The rigid motions to consider, for example those that :func:`unobservable` gives. By default all three.

    Returns
    -------
    ndarray (D, m)
        N · `motions` in the coordinates of ``filter.x`` and ``filter.P``, with N = [I₂ J p; 0 1; I₂ J lᵢ …]. The
        columns of N are the translations along x and y [m per m] and the rotation about the world's origin [m and rad
        per rad].

    Raises
    ------
    InputError
        `motions` has another shape, or holds a value that is not finite.

    Notes
    -----
    p and lᵢ are the estimator's linearisation points: the current estimate (standard, iterated), p_{k|k-1} and the
    landmarks' first estimates (first estimates), or p_{k|k-1} + Δ and the first estimates (observability-constrained).
    The invariant filter's N is constant in its own error ξ. Its covariance moves with the mean, so that in standard
    coordinates N is taken at the current estimate. For sightings of landmarks relative to the robot, H N = 0 and
    N_{k+1} = Φ_k N_k hold for every estimator but the standard and the iterated one, whose N changes with each update.
    Huang, Mourikis & Roumeliotis, IJRR 29(5):502-528 (2010); Barrau & Bonnabel, arXiv:1510.06263 (2015).
    """
    points = linearisation_points(filter)
    N = np.zeros((len(points), GAUGE_DIM))
    N[:2, :2] = np.eye(2)
    N[3:, :2] = np.tile(np.eye(2), ((len(points) - 3) // 2, 1))
    N[:, 2] = turned(points)
    N[2, 2] = 1.0
    return N if motions is None else N @ finite_array("motions", motions, (GAUGE_DIM, -1))


def anchoring(
    H_pose: ArrayLike, pose: ArrayLike, H_landmark: ArrayLike | None = None, landmark: ArrayLike | None = None
) -> Array:
    """Compute what a sighting says about the rigid motions of robot and map: A = H_pose N_pose + H_landmark N_landmark.

    N_pose = [I₂ J p; 0 1] and N_landmark = [I₂ J l]. A is zero for a sighting of an estimated landmark relative to the
    robot. A fix of the pose, or a sighting of a fixed landmark, has no second term: what it refers to does not move
    with the map.

    Parameters
    ----------
    H_pose : array_like (k, 3)
        ∂z/∂pose.
    pose : array_like (3,)
        Pose [m, m, rad] at which the Jacobians were taken.
    H_landmark : array_like (k, 2), optional
        ∂z/∂landmark. Leave it out for a fix and for a fixed landmark.
    landmark : array_like (2,), optional
        Position [m] of the landmark. Needed with `H_landmark`.

    Returns
    -------
    ndarray (k, 3)
        A, with entries that are zero up to rounding set to zero.

    Raises
    ------
    InputError
        A shape does not fit, or a value is not finite.
    """
    H, p = finite_array("H_pose", H_pose, (-1, 3)), finite_array("pose", pose, (3,))
    N = _pose_directions(p)
    A, size = H @ N, np.abs(H) @ np.abs(N)
    if H_landmark is not None:
        if landmark is None:
            raise InputError("landmark is missing, expected its position beside H_landmark")
        H, p = finite_array("H_landmark", H_landmark, (len(A), 2)), finite_array("landmark", landmark, (2,))
        N = _pose_directions(p)[:2]
        A, size = A + H @ N, size + np.abs(H) @ np.abs(N)
    return np.where(np.abs(A) > _ROUNDING * size, A, 0.0)


def unobservable(filter: LandmarkFilter, *anchorings: ArrayLike) -> Array:
    """Give the rigid motions of robot and map that neither the filter's sensor nor an anchor observes.

    The sensor is judged on every landmark of the present map, from the present pose. A sensor of landmarks relative to
    the robot observes none of the motions. One that measures along north observes the rotation.

    Parameters
    ----------
    filter : LandmarkFilter
    *anchorings : array_like (k, 3)
        What fixes of the pose and sightings of fixed landmarks say, each as :func:`anchoring` gives it. Fixes at two
        different positions observe all three motions; give more than one.

    Returns
    -------
    ndarray (3, m)
        Orthonormal basis of the null space of all rows together. Rows are translation along x and y [m] and rotation
        about the world's origin [rad]. m is the nullity to expect of a consistent filter: 3 where nothing anchors the
        map, 0 where its place in the world is observable.

    Raises
    ------
    InputError
        A shape does not fit, or a value is not finite.
    """
    pose = filter.pose
    rows = [finite_array("anchoring", a, (-1, GAUGE_DIM)) for a in anchorings]
    for place in filter.landmarks.values():
        H_pose, H_landmark = filter.sensor.jacobians(pose, place)
        rows.append(anchoring(H_pose, pose, H_landmark, place))
    stacked = np.concatenate([np.zeros((0, GAUGE_DIM)), *rows])
    if not stacked.any():
        return np.eye(GAUGE_DIM)
    _, values, directions = np.linalg.svd(np.concatenate([stacked, np.zeros((GAUGE_DIM, GAUGE_DIM))]))
    basis: Array = directions[values <= _ROUNDING * values[0]].T
    return basis


def unobservable_directions(motion: MotionModel, sensor: SensorModel, log: Log, pose: ArrayLike) -> int:
    """Count the directions of the gauge that the models leave unobservable along the path of a log.

    :func:`unobservable` judges the sensor of a filter from its present pose. This function judges both models, and
    needs no filter: a motion model can also depend on where the robot is in the world.

    Parameters
    ----------
    motion : MotionModel
    sensor : SensorModel
    log : Log
        Its controls and observations are the situations in which the models are examined.
    pose : array_like (3,)
        Start [m, m, rad].

    Returns
    -------
    int
        3 if moving robot and map together as one rigid body changes no measurement. Less if something anchors the
        map: 2 with a sensor that measures bearings from north, 0 with one that measures positions in the world.

    Raises
    ------
    InputError
        `pose` has another shape, or a value is not finite.

    Notes
    -----
    With N of :func:`null_directions`, a direction v (3,) is unobservable if H N v = 0 for every sighting and
    F N_k v = N_{k+1} v for every prediction, with H and F at one path and map that fit each other. The path here is
    dead reckoning, each sighting is of a landmark at ``sensor.invert(pose, z)``, and the directions are about the
    path's start. The rows are whitened by R and scaled to the size of H, so that the rank has no units.
    """
    x = finite_array("pose", pose, (3,))
    origin = np.array([*x[:2], 0.0])
    rows, whiten = [np.zeros((1, GAUGE_DIM))], np.linalg.inv(np.linalg.cholesky(sensor.R))
    for step in log:
        if step.u is not None:
            moved = np.array(motion.move(x, step.u, step.dt), dtype=float)
            moved[2] = se2.wrap(moved[2])
            F, _ = motion.jacobians(x, step.u, step.dt)
            rows.append(anchoring(F, x - origin) - _pose_directions(moved - origin))
            x = moved
        for z in np.asarray(step.scan.z):
            landmark = np.array(sensor.invert(x, z), dtype=np.float64)
            H_pose, H_landmark = (whiten @ H for H in sensor.jacobians(x, landmark))
            if not (np.isfinite(H_pose).all() and np.isfinite(H_landmark).all()):
                continue  # a sighting that the model cannot use
            size = max(float(np.abs(H_pose).max()), float(np.abs(H_landmark).max()))
            rows.append(anchoring(H_pose, x - origin, H_landmark, landmark - origin[:2]) / (size or 1.0))
    values = np.linalg.svd(np.concatenate(rows), compute_uv=False)
    return int(GAUGE_DIM - np.sum(values > _TOLERANCE))


def describe(motions: ArrayLike) -> str:
    """Name the rigid motions of robot and map in words, for a sentence such as "Nothing observes the …".

    Parameters
    ----------
    motions : array_like (3, m)
        Orthonormal basis, as :func:`unobservable` gives it.

    Raises
    ------
    InputError
        Another shape, or a value that is not finite.
    """
    basis = finite_array("motions", motions, (GAUGE_DIM, -1))
    count, turns = basis.shape[1], bool(np.abs(basis[2]).max(initial=0.0) > _ROUNDING)
    if count == 0:
        return "nothing"
    if count == 1 and turns:
        # A motion (t, ω) leaves the point c at rest where t + ω J c = 0.
        x, y = -basis[1, 0] / basis[2, 0], basis[0, 0] / basis[2, 0]
        return f"rotation about ({x:.3g}, {y:.3g})"
    if count == 1:
        return f"position along ({basis[0, 0]:.3g}, {basis[1, 0]:.3g})"
    if count == 2:
        return "heading and the position along one line" if turns else "position"
    return "position and heading"


def _pose_directions(pose: Array) -> Array:
    """N (3, 3) of a pose (3,): translation along x and y, rotation about the origin. A point has the first two rows."""
    return np.array([[1.0, 0.0, -pose[1]], [0.0, 1.0, pose[0]], [0.0, 0.0, 1.0]])
