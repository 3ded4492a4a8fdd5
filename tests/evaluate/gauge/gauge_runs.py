"""What the tests of the gauge share: which estimators keep it, and runs in the observability world."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from family import ORDERS, SENSORS
from hypothesis import strategies as st

from slamkit import Log, se2, simulate
from slamkit.evaluate import gauge
from slamkit.filters import FILTERS

#: Whether an estimator keeps the gauge unlearnt; None: not exactly, and no law says how far. A new one adds a line.
KEEPS: dict[str, bool | None] = {
    "ekf": False,
    "iterated": False,
    "fej": True,
    "oc": True,
    "invariant": True,
    "ideal": True,
    "robocentric": None,
    "ukf": False,
    "ukf-full": False,
    "oc-ukf": True,
}
KEEPERS = [name for name in FILTERS if KEEPS.get(name)]
LEARNERS = [name for name in FILTERS if KEEPS.get(name) is False]
every_filter = pytest.mark.parametrize("name", FILTERS)
every_order = pytest.mark.parametrize("order", ORDERS)
every_sensor = pytest.mark.parametrize("sensor", SENSORS)
decided = pytest.mark.parametrize("name", KEEPERS + LEARNERS)
keepers, learners = pytest.mark.parametrize("name", KEEPERS), pytest.mark.parametrize("name", LEARNERS)
#: A mean over sigma points depends on how uncertain the frame is, even where the gauge is kept.
keepers_without_sigma_points = pytest.mark.parametrize("name", [name for name in KEEPERS if "ukf" not in name])

P0 = np.diag([0.1, 0.2, np.deg2rad(5.0)]) ** 2
EPS = np.finfo(float).eps
transforms = st.tuples(st.floats(-50, 50), st.floats(-50, 50), st.floats(-3.1, 3.1)).map(np.array)


@cache
def world(sensor: str = "relative", steps: int = 41) -> Any:
    w = gauge.observability_world()
    return replace(w, sensor=SENSORS[sensor], controls=np.tile(w.controls[:1], (steps, 1)), pose_covariance=P0)


@cache
def log_of(sensor: str = "relative", steps: int = 41, seed: int = 0) -> Log:
    return simulate(world(sensor, steps), np.random.default_rng(seed))


def told(name: str, log: Log) -> dict[str, Any]:
    """What this estimator's constructor wants beyond the models."""
    return {"truth": log.truth} if name == "ideal" else {}


def make(name: str, log: Log, sensor: str = "relative", P: Any = P0, **options: Any) -> Any:
    w = world(sensor)
    return FILTERS[name](w.motion, w.sensor, w.pose, P, **told(name, log), **options)


def grown(name: str, steps: int = 41, **options: Any) -> Any:
    log = log_of(steps=steps)
    f = make(name, log, **options)
    f.run(log)
    return f


def moved(t: Any, x: Any) -> Any:
    """A state after a rigid motion of robot and map."""
    return np.concatenate([se2.compose(t, x[:3]), se2.transform(t, x[3:].reshape(-1, 2)).ravel()])


def with_a_late_landmark(log: Log) -> Log:
    """Landmark 4 is not sighted in the first half, and the last in each scan: the position is updated before it."""
    keep = (log.observation_ids != 4) | (log.observation_times > log.observation_times[-1] / 2)
    return replace(
        log,
        observation_times=log.observation_times[keep],
        observation_ids=log.observation_ids[keep],
        observations=log.observations[keep],
    )


def truth_of(log: Log) -> tuple[Any, dict[Any, Any]]:
    assert log.truth is not None
    return log.truth.poses[-1], dict(log.truth.landmarks)
