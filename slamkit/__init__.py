"""Filter-based landmark SLAM that can be trusted."""

from slamkit.belief import Storage
from slamkit.errors import InputError, LogFileError, ModelError, SlamkitError
from slamkit.filters import (
    EKFSLAM,
    UKFSLAM,
    FirstEstimatesEKFSLAM,
    FullUKFSLAM,
    IdealEKFSLAM,
    InvariantEKFSLAM,
    IteratedEKFSLAM,
    ObservabilityConstrainedEKFSLAM,
    ObservabilityConstrainedUKFSLAM,
    RobocentricEKFSLAM,
)
from slamkit.logs import History, Log, Scan, Truth
from slamkit.models.check import check_model, numeric_jacobian
from slamkit.simulate import World, simulate

__all__ = [
    "EKFSLAM",
    "UKFSLAM",
    "FirstEstimatesEKFSLAM",
    "FullUKFSLAM",
    "History",
    "IdealEKFSLAM",
    "InputError",
    "InvariantEKFSLAM",
    "IteratedEKFSLAM",
    "Log",
    "LogFileError",
    "ModelError",
    "ObservabilityConstrainedEKFSLAM",
    "ObservabilityConstrainedUKFSLAM",
    "RobocentricEKFSLAM",
    "Scan",
    "SlamkitError",
    "Storage",
    "Truth",
    "World",
    "check_model",
    "numeric_jacobian",
    "simulate",
]
__version__ = "0.1.0"
