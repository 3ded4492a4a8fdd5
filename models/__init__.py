"""The pluggable models: how a robot moves, and how it sees a landmark."""

from slamkit.models.check import check_model, numeric_jacobian
from slamkit.models.files import model_from_dict, model_to_dict
from slamkit.models.motion import EulerUnicycle, Odometry, Unicycle
from slamkit.models.sensors import RangeBearing, RelativePosition

__all__ = [
    "EulerUnicycle",
    "Odometry",
    "RangeBearing",
    "RelativePosition",
    "Unicycle",
    "check_model",
    "model_from_dict",
    "model_to_dict",
    "numeric_jacobian",
]
