"""The pluggable models: how a robot moves, and what a sensor measures of a landmark."""

from slamkit.models.conformance import check_model
from slamkit.models.numeric_jacobian import numeric_jacobian
from slamkit.models.odometry import Odometry
from slamkit.models.range_bearing import RangeBearing
from slamkit.models.registry import MOTIONS, SENSORS, model_from_dict, model_to_dict, parameters_of
from slamkit.models.relative_position import RelativePosition
from slamkit.models.unicycle import EulerUnicycle, Unicycle

__all__ = [
    "MOTIONS",
    "SENSORS",
    "EulerUnicycle",
    "Odometry",
    "RangeBearing",
    "RelativePosition",
    "Unicycle",
    "check_model",
    "model_from_dict",
    "model_to_dict",
    "numeric_jacobian",
    "parameters_of",
]
