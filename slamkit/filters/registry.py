"""The list of estimators: a new one is its file and a line here."""

from __future__ import annotations

from typing import Any

from slamkit.errors import InputError
from slamkit.filters.ekf import EKFSLAM
from slamkit.filters.first_estimates import FirstEstimatesEKFSLAM
from slamkit.filters.ideal import IdealEKFSLAM
from slamkit.filters.invariant import InvariantEKFSLAM
from slamkit.filters.iterated import IteratedEKFSLAM
from slamkit.filters.landmark_filter import LandmarkFilter
from slamkit.filters.observability_constrained import ObservabilityConstrainedEKFSLAM
from slamkit.filters.observability_constrained_ukf import ObservabilityConstrainedUKFSLAM
from slamkit.filters.robocentric import RobocentricEKFSLAM
from slamkit.filters.ukf import UKFSLAM, FullUKFSLAM
from slamkit.registry import Registry

__all__ = ["FILTERS"]


def _check(kind: object) -> None:
    if not (isinstance(kind, type) and issubclass(kind, LandmarkFilter)):
        raise InputError(f"a filter must be a class on slamkit.filters.LandmarkFilter, got {kind!r}")


_LIST = (
    EKFSLAM,
    FirstEstimatesEKFSLAM,
    ObservabilityConstrainedEKFSLAM,
    InvariantEKFSLAM,
    IteratedEKFSLAM,
    IdealEKFSLAM,
    RobocentricEKFSLAM,
    UKFSLAM,
    FullUKFSLAM,
    ObservabilityConstrainedUKFSLAM,
)

#: Command-line name → estimator. ``FILTERS.register(name, kind)`` adds one of your own.
FILTERS: Registry[Any] = Registry("filter", {kind.name: kind for kind in _LIST}, _check)
