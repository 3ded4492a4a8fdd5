"""Laws of the gauge deviation."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from gauge_runs import (
    every_filter,
    every_order,
    every_sensor,
    grown,
    keepers,
    learners,
    log_of,
    make,
    told,
    world,
)
from hypothesis import given
from hypothesis import strategies as st

from slamkit import SlamkitError
from slamkit.evaluate import gauge
from slamkit.filters import FILTERS
from slamkit.models import Unicycle


def brute_deviation(f: Any) -> float:
    N = gauge.null_directions(f)
    return float(np.sqrt(np.linalg.inv(N.T @ np.linalg.solve(f.P, N))[2, 2]))


@every_filter
@every_order
def test_gauge_deviation_is_that_of_the_heading_given_the_relative_map(name: str, order: str) -> None:
    log = log_of(steps=120)
    f = make(name, log, order=order)
    deviations = gauge.gauge_deviations(f, log)
    assert len(f.landmark_ids) == 0 and deviations.shape == (len(log),)
    for k, step in enumerate(log):
        f.step(step.u, step.dt, step.scan)
        if k % 7 == 0:
            assert deviations[k] == pytest.approx(brute_deviation(f), rel=1e-9)
            assert gauge.gauge_deviation(f) == pytest.approx(deviations[k], rel=1e-12)


@keepers
@every_order
@every_sensor
def test_gauge_deviation_never_falls(name: str, order: str, sensor: str) -> None:
    log = log_of(sensor, 120)
    d = gauge.gauge_deviations(make(name, log, sensor, order=order), log)
    assert d[0] >= np.deg2rad(5.0) * (1 - 1e-9)
    assert gauge.gauge_drop(d) <= 1e-9 * d[0]


@learners
@every_order
@every_sensor
def test_gauge_deviation_falls_where_the_heading_is_learnt(name: str, order: str, sensor: str) -> None:
    log = log_of(sensor, 120)
    assert gauge.gauge_drop(gauge.gauge_deviations(make(name, log, sensor, order=order), log)) > np.deg2rad(0.5)


@keepers
def test_a_known_start_leaves_no_gauge_to_learn(name: str) -> None:
    log, w = log_of(), replace(world(), motion=Unicycle(0.0, 0.0))
    f = FILTERS[name](w.motion, w.sensor, w.pose, None, **told(name, log))
    f.run(log)
    assert gauge.gauge_deviation(f) <= 1e-8


def test_gauge_deviation_of_a_bare_pose_is_that_of_its_heading() -> None:
    f = make("ekf", log_of())
    assert gauge.gauge_deviation(f) == pytest.approx(np.deg2rad(5.0))


def test_a_map_that_is_claimed_to_be_exact_is_refused() -> None:
    f = grown("ekf")
    f.P = np.zeros(f.P.shape)
    for act in (lambda: gauge.gauge_deviation(f), lambda: gauge.nees_split(f, f.pose, f.landmarks)):
        with pytest.raises(SlamkitError, match="not positive definite"):
            act()


@given(st.lists(st.floats(0, 10), max_size=8))
def test_gauge_drop_is_the_largest_fall(d: list[float]) -> None:
    falls = [a - b for i, a in enumerate(d) for b in d[i:]]
    assert gauge.gauge_drop(d) == max(falls, default=0.0)
