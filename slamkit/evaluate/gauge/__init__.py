"""The gauge: position and heading of robot and map together, which sightings of landmarks alone do not observe.

A consistent filter keeps its uncertainty about the gauge; these functions measure whether a filter does.
"""

from slamkit.evaluate.gauge.convergence import lower_bound_gap, relative_map_covariance
from slamkit.evaluate.gauge.deviation import gauge_deviation, gauge_deviations, gauge_drop
from slamkit.evaluate.gauge.directions import (
    GAUGE_DIM,
    anchoring,
    describe,
    null_directions,
    unobservable,
    unobservable_directions,
)
from slamkit.evaluate.gauge.equivariance import equivariance, stochastic_gauge
from slamkit.evaluate.gauge.nees_split import NeesSplit, nees_split
from slamkit.evaluate.gauge.nullity import Nullity, nullity, observability_world

__all__ = [
    "GAUGE_DIM",
    "NeesSplit",
    "Nullity",
    "anchoring",
    "describe",
    "equivariance",
    "gauge_deviation",
    "gauge_deviations",
    "gauge_drop",
    "lower_bound_gap",
    "nees_split",
    "null_directions",
    "nullity",
    "observability_world",
    "relative_map_covariance",
    "stochastic_gauge",
    "unobservable",
    "unobservable_directions",
]
