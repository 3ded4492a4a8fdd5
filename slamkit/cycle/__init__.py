"""One step of every estimator: predict, associate, activate, update, initialise, report."""

from slamkit.cycle.estimator import EstimatorFunctions, Policy, call
from slamkit.cycle.status import Status

__all__ = ["EstimatorFunctions", "Policy", "Status", "call"]
