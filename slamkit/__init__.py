"""Filter-based landmark SLAM that can be trusted."""

try:
    from slamkit.models import check_model, numeric_jacobian
except ModuleNotFoundError as error:
    if error.name != "slamkit.models":
        raise
    # slamkit/models is a symbolic link to models/, which git on Windows may write as a text file.
    raise ImportError(
        "slamkit/models is not a link to the folder models: this checkout was made without symbolic links. Install "
        "slamkit (pip install .) and run it outside of the checkout, or check it out again after "
        "'git config core.symlinks true'"
    ) from None
from slamkit.belief import Storage
from slamkit.errors import (
    AssignmentError,
    DivergenceError,
    InputError,
    LogFileError,
    MemoryCapError,
    ModelError,
    SlamkitError,
    UnsupportedError,
)
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
from slamkit.simulate import World, simulate

__all__ = [
    "EKFSLAM",
    "UKFSLAM",
    "AssignmentError",
    "DivergenceError",
    "FirstEstimatesEKFSLAM",
    "FullUKFSLAM",
    "History",
    "IdealEKFSLAM",
    "InputError",
    "InvariantEKFSLAM",
    "IteratedEKFSLAM",
    "Log",
    "LogFileError",
    "MemoryCapError",
    "ModelError",
    "ObservabilityConstrainedEKFSLAM",
    "ObservabilityConstrainedUKFSLAM",
    "RobocentricEKFSLAM",
    "Scan",
    "SlamkitError",
    "Storage",
    "Truth",
    "UnsupportedError",
    "World",
    "check_model",
    "numeric_jacobian",
    "simulate",
]
__version__ = "0.1.0"
