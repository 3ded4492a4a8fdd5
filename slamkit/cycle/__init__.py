"""One step of every estimator: predict, associate, activate, update, initialise, report."""

from slamkit.cycle.estimator import EstimatorFunctions, Models, Policy, call, models_of
from slamkit.cycle.status import Status

__all__ = ["EstimatorFunctions", "Models", "Policy", "Status", "call", "models_of"]
