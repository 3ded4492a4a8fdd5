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
        How it sees a landmark; likewise.
    pose : array_like (3,)
        Where it starts: x [m], y [m], θ [rad].
    pose_covariance : array_like (3, 3), optional
        How well that is known; None: exactly, which is the rule in SLAM, where the start defines the map's frame.
    order : {"sequential", "batch"}
        A scan's sightings one after the other, each linearised anew, or as one stacked update.
    gate : float, optional
        Largest NIS yᵀS⁻¹y that is accepted; None accepts every sighting. After one that is not, y, S and z are its own
        and K is zero.
    snapshots : bool
        True keeps x_prior, P_prior, x_post and P_post as filterpy does, at the cost of two copies of P a step.
    storage : Storage, optional
        From how many landmarks on the covariance is kept compressed, how a flush is spread over steps, how much memory
        it may take. The defaults fit; no choice changes an answer by more than rounding.

    Attributes
    ----------
    pose, pose_covariance, landmarks
        The belief, without materialising P.
    x, P, y, S, K, z, log_likelihood, likelihood, mahalanobis
        As in filterpy; y, S, K and z are of the last update. x and P are read-only and stay what they were when they
        were read: assign to change the filter.
    gate
        The parameter; it may be assigned to.

    Raises
    ------
    InputError
        An argument does not fit.
    ModelError
        A model lacks a method of its protocol.

    Notes
    -----
    On a small map a prediction costs O(D) and a sighting O(D²). On a large one a step costs O(A²), where A is the
    dimension of what has been in sight since the last flush, and a flush, now and then, O(A D²) in BLAS: exact, for
    what is not in sight enters no measurement. Reading `P`, `F`, `Q` or `K` forms it; P flushes. Everything else is
    read without a flush. The standard EKF claims too small a covariance for the heading, which nothing measures: see
    the consistent variants.

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
