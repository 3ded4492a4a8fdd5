"""The iterated EKF: each update is linearised again until it stands still."""

from __future__ import annotations

from slamkit.filters.ekf import EKFSLAM


class IteratedEKFSLAM(EKFSLAM):
    """Iterated EKF-SLAM: the update is the maximum a posteriori estimate, found by Gauss-Newton.

    Parameters, attributes and errors are those of :class:`slamkit.EKFSLAM`.

    Notes
    -----
    Iterations stop when the pose and the landmarks of the update move by less than 1e-12, or after 20. It reduces
    the linearisation error of one update; it does not keep the gauge, so it is as overconfident as the standard EKF.

    References
    ----------
    Bell & Cathey, The iterated Kalman filter update as a Gauss-Newton method, IEEE TAC 38(2) (1993).
    """

    name = "iterated"
    iterations = 20
