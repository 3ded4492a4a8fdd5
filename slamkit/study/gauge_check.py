"""The gauge check: does a filter claim to learn where and how turned the whole map lies in the world?"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from slamkit.arrays import Array
from slamkit.filters import IdealEKFSLAM
from slamkit.study.trial import RAISED, text_of

if TYPE_CHECKING:
    from slamkit.filters.landmark_filter import LandmarkFilter
    from slamkit.study.settings import Settings

#: P₀ of the uncertain start in the gauge checks: standard deviations of 0.1 m, 0.1 m and 5°.
GAUGE_COVARIANCE: Array = np.diag([0.1**2, 0.1**2, np.deg2rad(5.0) ** 2])
#: Rigid motion [m, m, rad] of the frame in the check of equivariance.
GAUGE_MOTION: Array = np.array([5.0, -3.0, 1.1])


@dataclass(frozen=True, eq=False)
class GaugeCheck:
    """How one filter treats its gauge on the first steps of the first run, started from :data:`GAUGE_COVARIANCE`."""

    filter: str  #: its name in the study
    error: str | None  #: which numbers are missing and why
    nullity: int | None  #: see :func:`slamkit.evaluate.gauge.nullity`; None if it failed
    times: Array = field(repr=False)  #: (n,) [s]
    deviations: Array = field(repr=False)  #: (n,) gauge deviation after each step [rad]
    deviation_drop: float | None  #: largest fall of the gauge deviation, as a share of its largest value
    stochastic_gauge_m: float | None  #: see :func:`slamkit.evaluate.gauge.stochastic_gauge` [m]
    equivariance: float | None  #: see :func:`slamkit.evaluate.gauge.equivariance`, under :data:`GAUGE_MOTION`
    #: unobservable directions of the gauge by the models alone, see
    #: :func:`slamkit.evaluate.gauge.unobservable_directions`; None if it failed
    unobservable: int | None = None


def check_gauge(settings: Settings, name: str) -> GaugeCheck:
    """Make the gauge check of one filter. What a filter raises is recorded."""
    from slamkit.evaluate import gauge

    errors: dict[str, list[str]] = {}  # reason → what is missing because of it

    def attempt(what: str, number: Callable[[], Any]) -> Any:
        try:
            return number()
        except RAISED as error:
            errors.setdefault(text_of(error), []).append(what)
            return None

    log = attempt("the simulation", lambda: settings.log(0).head(settings.gauge_steps))
    if log is None:
        return failed_check(name, _said(errors))
    kind, models = settings.filters[name], (settings.motion, settings.sensor)
    options = dict(settings.options)
    if _is_ideal(kind):
        options["truth"] = log.truth

    def start() -> LandmarkFilter:
        return kind(*models, settings.pose, GAUGE_COVARIANCE, **options)

    nullity = attempt("nullity", lambda: gauge.nullity(start(), log).nullity)
    found = attempt("gauge deviation", lambda: gauge.gauge_deviations(start(), log))
    stochastic = attempt(
        "stochastic gauge",
        lambda: gauge.stochastic_gauge(kind, *models, log, GAUGE_COVARIANCE, settings.pose, **options),
    )
    turned = attempt(
        "equivariance",
        lambda: gauge.equivariance(kind, *models, log, GAUGE_MOTION, settings.pose, GAUGE_COVARIANCE, **options),
    )
    free = attempt("unobservable directions", lambda: gauge.unobservable_directions(*models, log, settings.pose))
    times, deviations, drop = np.empty(0), np.empty(0), None
    if found is not None and len(found):
        times, deviations = log.schedule.times, found
        drop = gauge.gauge_drop(found) / float(found.max()) if found.max() > 0 else 0.0
    return GaugeCheck(
        filter=name,
        error=_said(errors) or None,
        nullity=nullity,
        times=times,
        deviations=deviations,
        deviation_drop=drop,
        stochastic_gauge_m=stochastic,
        equivariance=turned,
        unobservable=free,
    )


def failed_check(name: str, why: str) -> GaugeCheck:
    """A gauge check without numbers."""
    return GaugeCheck(name, why, None, np.empty(0), np.empty(0), None, None, None)


def _is_ideal(kind: Any) -> bool:
    """Whether a factory makes the filter that linearises at the truth, which must be given the truth."""
    while isinstance(kind, partial):
        kind = kind.func
    return isinstance(kind, type) and issubclass(kind, IdealEKFSLAM)


def _said(errors: dict[str, list[str]]) -> str:
    return "; ".join(f"{', '.join(what)}: {why}" for why, what in errors.items())
