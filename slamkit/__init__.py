"""Filter-based landmark SLAM that can be trusted."""

from slamkit.errors import InputError, LogFileError, ModelError, SlamkitError
from slamkit.filters import (
    EKFSLAM,
    FirstEstimatesEKFSLAM,
    InvariantEKFSLAM,
    IteratedEKFSLAM,
    ObservabilityConstrainedEKFSLAM,
)
from slamkit.logs import History, Log, Scan, Truth
from slamkit.simulate import World, simulate

__all__ = [
    "EKFSLAM",
    "FirstEstimatesEKFSLAM",
    "History",
    "InputError",
    "InvariantEKFSLAM",
    "IteratedEKFSLAM",
    "Log",
    "LogFileError",
    "ModelError",
    "ObservabilityConstrainedEKFSLAM",
    "Scan",
    "SlamkitError",
    "Truth",
    "World",


    "simulate",
]
__version__ = "0.1.0"
