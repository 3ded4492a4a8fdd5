"""The standard EKF: every Jacobian at the current estimate."""

from __future__ import annotations

from filterpy.kalman import ExtendedKalmanFilter

from slamkit.filters.landmark_filter import LandmarkFilter


class EKFSLAM(LandmarkFilter, ExtendedKalmanFilter):  # type: ignore[misc, override]  # properties here
    """EKF-SLAM: one Gaussian over the pose and every landmark, linearised at the current estimate.

    Parameters
    ----------
    motion : MotionModel
        How the robot moves; one of `slamkit.models` or your own.
    sensor : SensorModel
        How it sees a landmark; one of `slamkit.models` or your own.
    pose : array_like (3,)
        Where it starts: x [m], y [m], θ [rad].
    pose_covariance : array_like (3, 3), optional
        Covariance of the start. None: known exactly, as usual in SLAM, where the start defines the frame of the map.
    order : {"sequential", "batch"}
        Use the sightings of a scan one after the other, each linearised anew, or as one stacked update.
    gate : float, optional
        Largest NIS yᵀS⁻¹y that is accepted; None accepts every sighting. After a rejected sighting y, S and z are those
        of that sighting, and K is zero.
    snapshots : bool
        True keeps x_prior, P_prior, x_post and P_post as filterpy does, at the cost of copies of the filter and of P in
        every step. Nothing else changes.
    storage : Storage, optional
        When the covariance is kept compressed, how a flush is spread over steps, and how much memory it may take. No
        choice changes an estimate by more than rounding.

    Attributes
    ----------
    pose, pose_covariance, landmarks
        The belief, without materialising P.
    x, P, y, S, K, z, log_likelihood, likelihood, mahalanobis
        As in filterpy; y, S, K and z are those of the last update. x and P are read-only snapshots. To change the
        filter, assign to them.
    motion, sensor, order, gate
        The parameters. Assigning takes effect from the next step on. Other names cannot be assigned.

    Raises
    ------
    InputError
        An argument does not fit.
    ModelError
        A model lacks a method of its protocol.

    Notes
    -----
    On a small map a prediction costs O(D) and a sighting O(D²). On a large map updates to landmarks that are out of
    view are deferred: a step costs O(A²), where A is the dimension of everything seen since the last flush, and an
    occasional flush costs O(A D²) in BLAS. The result is exact. Reading `P`, `F`, `Q` or `K` forms the matrix, and
    reading P flushes; everything else is read without a flush.

    The standard EKF underestimates the uncertainty of the heading, which no measurement observes. The consistent
    estimators of the family do not.

    References
    ----------
    Smith, Self & Cheeseman, Estimating uncertain spatial relationships in robotics (1990);
    Guivant & Nebot, Optimization of the simultaneous localization and map-building algorithm for real-time
    implementation, IEEE TRA 17(3):242-257 (2001), for the compressed form;
    Thrun, Burgard & Fox, Probabilistic Robotics (2005), table 10.1.

    Examples
    --------
    >>> from slamkit.models import RangeBearing, Unicycle
    >>> f = EKFSLAM(Unicycle(0.1, 0.05), RangeBearing(0.1, 0.02))
    >>> f.step((1.0, 0.0), 1.0, {"tree": (2.0, 0.0)})
    >>> f.landmarks["tree"].tolist()
    [3.0, 0.0]
    """

    name = "ekf"
