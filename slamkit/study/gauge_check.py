"""The gauge check: does a filter claim to learn where and how turned the whole map lies in the world?"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from slamkit import se2
from slamkit.arrays import Array
from slamkit.filters import IdealEKFSLAM
from slamkit.logs import Log
from slamkit.protocols import MotionModel, SensorModel
from slamkit.study.trial import RAISED, text_of

if TYPE_CHECKING:
    from slamkit.filters.landmark_filter import LandmarkFilter
    from slamkit.study.settings import Settings

#: P₀ of the uncertain start in the gauge checks: standard deviations of 0.1 m, 0.1 m and 5°.
GAUGE_COVARIANCE: Array = np.diag([0.1**2, 0.1**2, np.deg2rad(5.0) ** 2])
#: Rigid motion [m, m, rad] of the frame in the check of equivariance.
GAUGE_MOTION: Array = np.array([5.0, -3.0, 1.1])

#: A singular value below this share of the largest counts as zero; see :func:`slamkit.evaluate.gauge.nullity`.
_TOLERANCE = 5e-6


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
    #: unobservable directions of the gauge by the models alone, see :func:`unobservable_directions`; None if it failed
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
    free = attempt("unobservable directions", lambda: unobservable_directions(*models, log, settings.pose))
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


def unobservable_directions(motion: MotionModel, sensor: SensorModel, log: Log, pose: Array) -> int:
    """How many of the gauge's three directions the models leave unobservable.

    Parameters
    ----------
    motion : MotionModel
    sensor : SensorModel
    log : Log
        Its controls and observations are the situations in which the models are looked at.
    pose : array_like (3,)
        Start [m, m, rad].

    Returns
    -------
    int
        3 if moving robot and map together as one rigid body changes no measurement. Less if something anchors the
        map: 2 with a sensor that measures bearings from north, 0 with one that measures positions in the world.

    Notes
    -----
    With N = [I₂ J p; 0 1; I₂ J l] (see :func:`slamkit.evaluate.gauge.null_directions`) a direction v (3,) is
    unobservable if H N v = 0 for every sighting and F N_k v = N_{k+1} v for every prediction, with H and F at one
    path and map that fit each other. The path here is dead reckoning, each sighting is of a landmark at
    ``sensor.invert(pose, z)``, and the directions are about the path's start. The rows are whitened by R and scaled
    to the size of H, so that the rank has no units.
    """
    x = np.array(pose, dtype=float)
    origin = x[:2].copy()
    rows, whiten = [np.zeros((1, 3))], np.linalg.inv(np.linalg.cholesky(sensor.R))
    for step in log:
        if step.u is not None:
            moved = np.asarray(motion.move(x, step.u, step.dt), dtype=float)
            F, _ = motion.jacobians(x, step.u, step.dt)
            rows.append(F @ _generators(x[:2], origin, heading=True) - _generators(moved[:2], origin, heading=True))
            x = np.array([*moved[:2], se2.wrap(moved[2])])
        for z in np.asarray(step.scan.z):
            landmark = np.array(sensor.invert(x, z), dtype=np.float64)
            H_pose, H_landmark = (whiten @ H for H in sensor.jacobians(x, landmark))
            if not (np.isfinite(H_pose).all() and np.isfinite(H_landmark).all()):
                continue  # a sighting that the model cannot use
            size = max(float(np.abs(H_pose).max()), float(np.abs(H_landmark).max()))
            N_pose = _generators(x[:2], origin, heading=True)
            N_landmark = _generators(landmark, origin, heading=False)
            rows.append((H_pose @ N_pose + H_landmark @ N_landmark) / (size or 1.0))
    values = np.linalg.svd(np.concatenate(rows), compute_uv=False)
    return int(3 - np.sum(values > _TOLERANCE))


def _generators(place: Array, origin: Array, *, heading: bool) -> Array:
    """Rows of N for a place (2,) and, for a pose, its heading: translation along x and y, rotation about `origin`."""
    x, y = place - origin
    rows = [[1.0, 0.0, -y], [0.0, 1.0, x]]
    return np.array([*rows, [0.0, 0.0, 1.0]] if heading else rows)


def _is_ideal(kind: Any) -> bool:
    """Whether a factory makes the filter that linearises at the truth, which must be given the truth."""
    while isinstance(kind, partial):
        kind = kind.func
    return isinstance(kind, type) and issubclass(kind, IdealEKFSLAM)


def _said(errors: dict[str, list[str]]) -> str:
    return "; ".join(f"{', '.join(what)}: {why}" for why, what in errors.items())
