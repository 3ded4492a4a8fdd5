"""Laws of the null directions."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
from family import SENSORS, PlainSensor
from gauge_runs import (
    KEEPS,
    P0,
    every_filter,
    every_order,
    every_sensor,
    grown,
    keepers,
    log_of,
    make,
    moved,
    world,
)

from slamkit import InputError
from slamkit.evaluate import gauge
from slamkit.filters import FILTERS


def test_every_filter_is_said_to_keep_its_gauge_or_not() -> None:
    assert set(FILTERS) <= set(KEEPS), "add the new estimator to KEEPS"


@pytest.mark.parametrize("name", ["ekf", "invariant", "iterated"])
def test_null_directions_are_rigid_motions_of_the_state(name: str) -> None:
    f, h = grown(name), 1e-6
    difference = [(moved(h * e, f.x) - moved(-h * e, f.x)) / (2 * h) for e in np.eye(3)]
    np.testing.assert_allclose(gauge.null_directions(f), np.transpose(difference), atol=1e-8)


def test_ideal_null_directions_are_rigid_motions_of_the_truth() -> None:
    truth = log_of().truth
    assert truth is not None
    f, h = grown("ideal"), 1e-6
    x = np.concatenate([truth.poses[-1], *[truth.landmarks[i] for i in f.landmark_ids]])
    difference = [(moved(h * e, x) - moved(-h * e, x)) / (2 * h) for e in np.eye(3)]
    np.testing.assert_allclose(gauge.null_directions(f), np.transpose(difference), atol=1e-8)


def test_first_estimates_stay_in_the_null_directions() -> None:
    log = log_of()
    f, first = make("fej", log), {}
    for step in log:
        moment = copy.deepcopy(f)
        moment.predict(step.u, step.dt)
        f.step(step.u, step.dt, step.scan)
        first |= {i: p for i, p in f.landmarks.items() if i not in first}
        J = np.array([[0.0, -1.0], [1.0, 0.0]])
        N = gauge.null_directions(f)
        np.testing.assert_allclose(N[:2, 2], J @ moment.pose[:2], atol=1e-14)
        np.testing.assert_allclose(N[3:, 2], np.concatenate([J @ first[i] for i in f.landmark_ids]), atol=1e-14)


@keepers
@every_order
@every_sensor
def test_prediction_carries_the_null_directions_on(name: str, order: str, sensor: str) -> None:
    log = log_of(sensor)
    f = make(name, log, sensor, order=order)
    before = None
    for step in log:
        if before is not None:
            # An estimator that chooses its lever arms with the scan in hand must be given the scan.
            f.step(step.u, step.dt, step.scan)
            if name != "invariant":  # whose N moves on with the mean within the scan, too
                np.testing.assert_allclose(f.F @ before, gauge.null_directions(f), atol=1e-12)
        else:
            f.step(step.u, step.dt, step.scan)
        before = gauge.null_directions(f)


# -- what anchors observe


class AlongNorth(PlainSensor):
    """A robot with a compass: the landmark's place relative to the robot, along the world's axes."""

    def predict(self, pose: Any, landmark: Any) -> Any:
        return landmark - pose[:2]

    def jacobians(self, pose: Any, landmark: Any) -> Any:
        return np.hstack([-np.eye(2), np.zeros((2, 1))]), np.eye(2)

    def invert(self, pose: Any, z: Any) -> Any:
        return pose[:2] + z

    def inverse_jacobians(self, pose: Any, z: Any) -> Any:
        return np.hstack([np.eye(2), np.zeros((2, 1))]), np.eye(2)


def position_fix(x: float, y: float) -> Any:
    return gauge.anchoring(np.eye(2, 3), (x, y, 0.7))


HEADING_FIX = gauge.anchoring([[0.0, 0.0, 1.0]], (3.0, -2.0, 0.1))


@every_filter
@every_sensor
def test_sightings_relative_to_the_robot_observe_no_rigid_motion(name: str, sensor: str) -> None:
    f = make(name, log_of(sensor), sensor)
    assert np.array_equal(gauge.unobservable(f), np.eye(3))
    f.run(log_of(sensor))
    assert np.array_equal(gauge.unobservable(f), np.eye(3))
    assert gauge.describe(gauge.unobservable(f)) == "position and heading"


@pytest.mark.parametrize(
    ("anchors", "left"),
    [
        ([], "position and heading"),
        ([HEADING_FIX], "position"),
        ([position_fix(4.0, -2.5)], "rotation about (4, -2.5)"),
        ([position_fix(4.0, -2.5), position_fix(4.0, -2.5)], "rotation about (4, -2.5)"),
        ([position_fix(4.0, -2.5), position_fix(5.0, -2.5)], "nothing"),
        ([position_fix(4.0, -2.5), HEADING_FIX], "nothing"),
        ([gauge.anchoring(np.eye(3), (400.0, 20.0, 0.3))], "nothing"),
        ([np.array([[0.0, 1.0, 0.0]]), HEADING_FIX], "position along (1, 0)"),
        ([np.array([[1.0, 0.0, 0.0]])], "heading and the position along one line"),
    ],
)
def test_anchors_leave_the_motions_that_they_do_not_see(anchors: list[Any], left: str) -> None:
    f = grown("ekf")
    motions = gauge.unobservable(f, *anchors)
    assert gauge.describe(motions).replace("-1, -0", "1, 0").replace("-1, 0", "1, 0") == left
    np.testing.assert_allclose(motions.T @ motions, np.eye(motions.shape[1]), atol=1e-12)
    for A in anchors:
        assert np.abs(A @ motions).max(initial=0.0) < 1e-9
    np.testing.assert_allclose(gauge.null_directions(f, motions), gauge.null_directions(f) @ motions, atol=1e-12)


@every_sensor
def test_fixed_landmarks_are_anchors(sensor: str) -> None:
    """One that the robot sees leaves the rotation about it, two leave nothing."""
    f, pose, places = grown("ekf"), np.array([1.0, 2.0, 0.4]), [np.array([5.0, 3.0]), np.array([-2.0, 0.0])]
    seen = [gauge.anchoring(SENSORS[sensor].jacobians(pose, p)[0], pose) for p in places]
    assert gauge.describe(gauge.unobservable(f, seen[0])) == "rotation about (5, 3)"
    assert gauge.describe(gauge.unobservable(f, *seen)) == "nothing"


def test_the_nullity_of_a_run_is_the_number_of_unobservable_motions() -> None:
    w, log = world(), log_of()
    f = FILTERS["ekf"](w.motion, AlongNorth(w.sensor), w.pose, P0)
    found = gauge.nullity(f, log)
    f.run(log)
    motions = gauge.unobservable(f)
    assert gauge.describe(motions) == "position"
    assert found.nullity == motions.shape[1] == 2


def test_anchors_that_do_not_fit_are_refused() -> None:
    f = grown("ekf")
    for act in (
        lambda: gauge.unobservable(f, np.eye(2)),
        lambda: gauge.anchoring(np.eye(2), (0, 0, 0)),
        lambda: gauge.anchoring(np.eye(2, 3), (0, 0)),
        lambda: gauge.anchoring(np.eye(2, 3), (0, 0, 0), np.eye(3, 2), (0, 0)),
        lambda: gauge.anchoring(np.eye(2, 3), (0, 0, 0), np.eye(2)),
        lambda: gauge.null_directions(f, np.eye(2)),
        lambda: gauge.describe(np.eye(2)),
    ):
        with pytest.raises(InputError):
            act()
