"""The estimators, one a file, and their names on the command line and in figures."""

from slamkit.filters.ekf import EKFSLAM
from slamkit.filters.first_estimates import FirstEstimatesEKFSLAM
from slamkit.filters.ideal import IdealEKFSLAM
from slamkit.filters.invariant import InvariantEKFSLAM
from slamkit.filters.iterated import IteratedEKFSLAM
from slamkit.filters.landmark_filter import LandmarkFilter
from slamkit.filters.observability_constrained import ObservabilityConstrainedEKFSLAM
from slamkit.filters.observability_constrained_ukf import ObservabilityConstrainedUKFSLAM
from slamkit.filters.registry import FILTERS
from slamkit.filters.robocentric import RobocentricEKFSLAM
from slamkit.filters.ukf import UKFSLAM, FullUKFSLAM

__all__ = [
    "EKFSLAM",
    "FILTERS",
    "UKFSLAM",
    "FirstEstimatesEKFSLAM",
    "FullUKFSLAM",
    "IdealEKFSLAM",
    "InvariantEKFSLAM",
    "IteratedEKFSLAM",
    "LandmarkFilter",
    "ObservabilityConstrainedEKFSLAM",
    "ObservabilityConstrainedUKFSLAM",
    "RobocentricEKFSLAM",
]
