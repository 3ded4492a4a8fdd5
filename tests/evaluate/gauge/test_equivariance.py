"""Laws of the stochastic gauge and of equivariance."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pytest
from gauge_runs import (
    P0,
    every_filter,
    every_order,
    every_sensor,
    keepers_without_sigma_points,
    learners,
    log_of,
    moved,
    told,
    transforms,
    world,
)
from hypothesis import given, settings

from slamkit import InputError, se2, simulate
from slamkit.evaluate import gauge
from slamkit.filters import FILTERS
from slamkit.models import Unicycle
from slamkit.simulate import loop_world
from slamkit.study import GAUGE_COVARIANCE, GAUGE_MOTION


@keepers_without_sigma_points
@every_order
@every_sensor
@pytest.mark.parametrize("degrees", [1.0, 5.0, 20.0])
def test_an_uncertain_frame_changes_nothing_relative(name: str, order: str, sensor: str, degrees: float) -> None:
    log, w = log_of(sensor, 120), world(sensor)
    P = np.array([[0.04, 0.01, 0.0], [0.01, 0.09, 0.0], [0.0, 0.0, np.deg2rad(degrees) ** 2]])
    off = gauge.stochastic_gauge(FILTERS[name], w.motion, w.sensor, log, P, w.pose, order=order, **told(name, log))
    assert off <= 1e-9


@learners
@every_sensor
def test_an_uncertain_frame_changes_what_a_learner_says(name: str, sensor: str) -> None:
    log, w = log_of(sensor, 120), world(sensor)
    assert gauge.stochastic_gauge(FILTERS[name], w.motion, w.sensor, log, P0, w.pose) > 1e-4


def test_the_stochastic_gauge_is_the_difference_of_two_runs() -> None:
    log, w = log_of(), world()
    ends = []
    for P in (None, P0):
        f = FILTERS["ekf"](w.motion, w.sensor, w.pose, P)
        seen = []
        for step in log:
            f.step(step.u, step.dt, step.scan)
            seen.append([se2.transform(se2.inverse(f.pose), p) for p in f.landmarks.values()])
        ends.append(np.array(seen))
    expected = np.linalg.norm(ends[0] - ends[1], axis=-1).max()
    assert gauge.stochastic_gauge(FILTERS["ekf"], w.motion, w.sensor, log, P0, w.pose) == pytest.approx(expected)


@every_filter
@every_order
@every_sensor
@settings(max_examples=4)
@given(T=transforms)
def test_estimates_move_with_the_frame(name: str, order: str, sensor: str, T: Any) -> None:
    log, w = log_of(sensor), world(sensor)
    off = gauge.equivariance(FILTERS[name], w.motion, w.sensor, log, T, w.pose, P0, order=order, **told(name, log))
    assert off <= 1e-9


@every_filter
@pytest.mark.parametrize(("sensor", "P"), [("relative", GAUGE_COVARIANCE), ("range-bearing", None)])
def test_a_longer_run_moves_with_the_frame(name: str, sensor: Literal["relative", "range-bearing"], P: Any) -> None:
    """On the loop world, under the motion that `slamkit compare` takes: rounding adds up over 200 steps."""
    w = loop_world(sensor)
    log = simulate(replace(w, controls=w.controls[:200]), np.random.default_rng(0))
    off = gauge.equivariance(FILTERS[name], w.motion, w.sensor, log, GAUGE_MOTION, w.pose, P, **told(name, log))
    assert off <= 1e-9


def test_equivariance_is_the_difference_of_two_runs() -> None:
    """By brute force, with a pose noise that does depend on the axes."""
    log, T = log_of(), np.array([3.0, -2.0, 0.8])
    motion, w = Unicycle(0.05, 0.05, pose_noise=np.diag([1e-2, 1e-4, 1e-5])), world()
    c, s = np.cos(T[2]), np.sin(T[2])
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    a = FILTERS["ekf"](motion, w.sensor, w.pose, P0)
    b = FILTERS["ekf"](motion, w.sensor, se2.compose(T, w.pose), R @ P0 @ R.T)
    expected = 0.0
    for step in log:
        for f in (a, b):
            f.step(step.u, step.dt, step.scan)
        A = np.eye(b.dim_x)
        A[:3, :3] = R
        for k in range(3, len(A), 2):
            A[k : k + 2, k : k + 2] = R[:2, :2]
        error = b.x - moved(T, a.x)
        error[2] = se2.wrap(error[2])
        expected = max(expected, np.abs(error).max(), np.abs(b.P - A @ a.P @ A.T).max())
    found = gauge.equivariance(FILTERS["ekf"], motion, w.sensor, log, T, w.pose, P0)
    assert found == pytest.approx(expected)
    assert found > 1e-4


def test_a_gate_that_splits_the_maps_is_named() -> None:
    log, w = log_of(), world()

    def forgetful(*arguments: Any) -> Any:
        f = FILTERS["ekf"](*arguments)
        if np.any(arguments[3]):
            f.observe("only here", (1.0, 1.0))
        return f

    with pytest.raises(InputError, match="different maps"):
        gauge.stochastic_gauge(forgetful, w.motion, w.sensor, log, P0)
