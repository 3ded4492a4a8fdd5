"""Laws of the convergence of the map."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from gauge_runs import (
    P0,
    every_order,
    every_sensor,
    grown,
    keepers,
    learners,
    log_of,
    make,
    world,
)

from slamkit import InputError
from slamkit.evaluate import gauge
from slamkit.filters import FILTERS
from slamkit.models import Unicycle


@keepers
@every_order
@every_sensor
def test_the_lower_bound_holds_where_the_gauge_is_kept(name: str, order: str, sensor: str) -> None:
    log, w = log_of(sensor, 120), world(sensor)
    f = make(name, log, sensor, order=order)
    start = log.truth.poses[0] if name == "ideal" and log.truth is not None else w.pose
    for k, step in enumerate(log):
        f.step(step.u, step.dt, step.scan)
        if k % 10 == 0:
            assert gauge.lower_bound_gap(f, P0, start) > -1e-12


@learners
@every_sensor
def test_the_lower_bound_is_broken_where_the_heading_is_learnt(name: str, sensor: str) -> None:
    log, w = log_of(sensor, 120), world(sensor)
    f = make(name, log, sensor)
    f.run(log)
    assert gauge.lower_bound_gap(f, P0, w.pose) < -1e-3


def test_the_lower_bound_is_that_of_the_first_sightings() -> None:
    """With no noise of motion and a nearly perfect sensor the map's covariance is A₀ P₀ A₀ᵀ and hardly more."""
    w = world()
    f = FILTERS["ekf"](Unicycle(0.0, 0.0), type(w.sensor)(1e-7), w.pose, P0)
    for i, p in w.landmarks.items():
        f.observe(i, f.sensor.predict(f.pose, p))
    assert 0 < gauge.lower_bound_gap(f, P0, w.pose) < 2e-14
    assert gauge.lower_bound_gap(f, 2 * P0, w.pose) < -0.1


@keepers
def test_the_relative_map_converges(name: str) -> None:
    sizes = []
    for steps in (30, 120, 480):
        f = grown(name, steps)
        P = gauge.relative_map_covariance(f)
        N = gauge.null_directions(f)[3:]
        assert np.array_equal(P, P.T)
        assert np.abs(P @ N).max() < 1e-12
        values = np.linalg.eigvalsh(P)
        assert values[0] > -1e-15 and np.sum(values > 1e-9) == 2 * 5 - 3
        sizes.append(values[-1])
    assert all(later < 0.5 * earlier for earlier, later in pairwise(sizes))


def test_the_relative_covariance_ignores_the_gauge() -> None:
    f = grown("ekf")
    P, N = gauge.relative_map_covariance(f), gauge.null_directions(f)
    f.P = f.P + N @ np.diag([3.0, 2.0, 1.0]) @ N.T
    np.testing.assert_allclose(gauge.relative_map_covariance(f), P, atol=1e-12)


def test_maps_too_small_and_shapes_that_do_not_fit() -> None:
    log = log_of()
    f = make("ekf", log)
    with pytest.raises(InputError, match="map is empty"):
        gauge.lower_bound_gap(f, P0, (0, 0, 0))
    f.observe(1, (2.0, 0.0))
    with pytest.raises(InputError, match="at least 2"):
        gauge.relative_map_covariance(f)
    with pytest.raises(InputError, match=r"pose_covariance has shape \(2, 2\)"):
        gauge.lower_bound_gap(f, np.eye(2), (0, 0, 0))
    with pytest.raises(InputError, match="T has shape"):
        gauge.equivariance(FILTERS["ekf"], f.motion, f.sensor, log, (0.0, 1.0))
    with pytest.raises(InputError, match="deviations"):
        gauge.gauge_drop([[1.0]])
