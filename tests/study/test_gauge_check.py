"""The gauge check: what a filter claims to learn, and what the models leave unobservable."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from family import PlainMotion, PlainSensor
from small_study import small, world

from slamkit import simulate
from slamkit.evaluate.gauge import unobservable_directions
from slamkit.models import RangeBearing, RelativePosition, Unicycle
from slamkit.study import Study


def test_the_standard_filter_alone_learns_its_gauge(study: Study) -> None:
    ekf, invariant = study.summary()["ekf"], study.summary()["invariant"]
    assert (ekf["nullity"], invariant["nullity"]) == (2, 3)
    assert ekf["gauge_deviation_drop"] > 0.01 and invariant["gauge_deviation_drop"] < 1e-9
    assert ekf["stochastic_gauge_m"] > 1e-6 and invariant["stochastic_gauge_m"] < 1e-9
    assert max(ekf["equivariance"], invariant["equivariance"]) < 1e-9
    for check in study.gauge.values():
        assert check.error is None and len(check.deviations) == len(check.times) == 8


class NorthBearing(PlainSensor):
    """z = l - p in the axes of the world, as a camera with a compass gives it."""

    def predict(self, pose: Any, landmark: Any) -> Any:
        return landmark - pose[:2]

    def jacobians(self, pose: Any, landmark: Any) -> Any:
        return np.hstack([-np.eye(2), np.zeros((2, 1))]), np.eye(2)

    def invert(self, pose: Any, z: Any) -> Any:
        return pose[:2] + z

    def inverse_jacobians(self, pose: Any, z: Any) -> Any:
        return np.hstack([np.eye(2), np.zeros((2, 1))]), np.eye(2)


class Surveyed(NorthBearing):
    """z = l, as a total station gives it."""

    def predict(self, pose: Any, landmark: Any) -> Any:
        return np.array(landmark)

    def jacobians(self, pose: Any, landmark: Any) -> Any:
        return np.zeros((2, 3)), np.eye(2)

    def invert(self, pose: Any, z: Any) -> Any:
        return np.array(z)

    def inverse_jacobians(self, pose: Any, z: Any) -> Any:
        return np.zeros((2, 3)), np.eye(2)


class Wind(PlainMotion):
    """Blows toward the east, so that the path shows where the east is."""

    def move(self, pose: Any, u: Any, dt: float) -> Any:
        return super().move(pose, u, dt) + np.array([0.3 * dt, 0.0, 0.0])


@pytest.mark.parametrize("sensor", [RelativePosition(0.1), RangeBearing(0.1, 0.02), PlainSensor(RelativePosition(0.1))])
@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (1e4, -1e4, 2.0)])
def test_models_that_see_the_world_from_the_robot_leave_three_directions(sensor: Any, place: Any) -> None:
    log = simulate(replace(world(), sensor=sensor), np.random.default_rng(1))
    assert unobservable_directions(Unicycle(0.05, 0.05), sensor, log, np.array(place)) == 3


@pytest.mark.parametrize(("kind", "left"), [(NorthBearing, 2), (Surveyed, 0)])
def test_a_sensor_that_knows_the_world_leaves_fewer_directions(kind: Any, left: int) -> None:
    sensor = kind(RelativePosition(0.1))
    anchored = replace(world(12), sensor=sensor)
    study = small(filters=["ekf", "invariant"], world=anchored, runs=2, jobs=1)
    assert study.unobservable == left
    report, said = study.report(), " ".join(study.findings())
    assert "three directions are unobservable" not in report and "anchor the map" in report
    assert "learnt" not in said


def test_a_motion_that_knows_the_world_leaves_fewer_directions() -> None:
    log = simulate(world(), np.random.default_rng(1))
    wind = Wind(Unicycle(0.05, 0.05))
    assert unobservable_directions(wind, RelativePosition(0.1), log, world().pose) == 2
