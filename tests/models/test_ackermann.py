"""The vehicle with a steered front axle."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from model_examples import VICTORIA_PARK, durations, poses, same_pose

from slamkit import se2
from slamkit.arrays import Array
from slamkit.errors import InputError
from slamkit.models import Ackermann, Unicycle

speeds = st.floats(-5, 5)
angles = st.floats(-0.6, 0.6) | st.sampled_from([0.0, 1e-12, -1e-9])


@given(poses, speeds, angles, durations)
@settings(max_examples=50, deadline=None)
def test_without_offsets_it_is_a_unicycle_with_the_turn_rate_of_its_steering(
    pose: Array, v: float, alpha: float, dt: float
) -> None:
    moved = Ackermann(0.1, 0.1, wheelbase=2.0).move(pose, [v, alpha], dt)
    same_pose(moved, Unicycle(0.1, 0.1).move(pose, [v, v * np.tan(alpha) / 2.0], dt), 1e-12)


@given(poses, speeds, angles, durations)
@settings(max_examples=50, deadline=None)
def test_the_sensor_moves_with_the_vehicle(pose: Array, v: float, alpha: float, dt: float) -> None:
    wheelbase, encoder, ahead, left = VICTORIA_PARK
    at_axle = Ackermann(0.1, 0.1, wheelbase, encoder)
    mount = np.array([ahead, left, 0.0])
    axle = se2.compose(pose, se2.inverse(mount))
    moved = se2.compose(at_axle.move(axle, [v, alpha], dt), mount)
    same_pose(Ackermann(0.1, 0.1, *VICTORIA_PARK).move(pose, [v, alpha], dt), moved, 1e-11)


@given(speeds, angles, durations)
@settings(max_examples=50, deadline=None)
def test_the_encoders_wheel_rolls_as_far_as_it_measures(v: float, alpha: float, dt: float) -> None:
    wheelbase, encoder, *_ = VICTORIA_PARK
    model = Ackermann(0.1, 0.1, wheelbase, encoder)
    middle = model.move(np.zeros(3), [v, alpha], dt)
    turn = dt * v / (1 - np.tan(alpha) * encoder / wheelbase) * np.tan(alpha) / wheelbase
    np.testing.assert_allclose(se2.wrap(middle[2] - turn), 0, atol=1e-12)
    wheel = se2.transform(middle, [0.0, encoder]) - [0.0, encoder]
    chord = v * dt * np.sinc(turn / (2 * np.pi))  # of an arc of length v·dt
    np.testing.assert_allclose(np.hypot(*wheel), abs(chord), atol=1e-12)


@given(poses, speeds, angles, durations)
@settings(max_examples=50, deadline=None)
def test_it_composes_along_its_arc(pose: Array, v: float, alpha: float, dt: float) -> None:
    model, u = Ackermann(0.1, 0.1, *VICTORIA_PARK), [v, alpha]
    whole = model.move(pose, u, dt)
    same_pose(model.move(model.move(pose, u, dt / 2), u, dt / 2), whole, 1e-11)


@pytest.mark.parametrize("alpha", [np.pi / 2, -np.pi / 2 - 0.1, 2.0, np.arctan(2.83 / 0.76) + 1e-9, np.nan, np.inf])
def test_an_angle_that_the_vehicle_cannot_steer_gives_nan(alpha: float) -> None:
    model = Ackermann(0.1, 0.1, *VICTORIA_PARK)
    assert np.isnan(model.move(np.zeros(3), [1.0, alpha], 0.1)).all()
    assert np.isnan(model.jacobians(np.zeros(3), [1.0, alpha], 0.1)[1]).any()


@pytest.mark.parametrize("bad", [np.nan, np.inf, 10**400, "2.0", None, True, 1j, [2.0]], ids=str)
@pytest.mark.parametrize("name", ["wheelbase", "encoder_left", "ahead", "left"])
def test_a_distance_that_is_no_finite_number_is_refused(name: str, bad: Any) -> None:
    with pytest.raises(InputError, match=f"^{name} is .*expected a finite number of metres"):
        Ackermann(0.1, 0.1, **{"wheelbase": 2.0, name: bad})


@pytest.mark.parametrize("bad", [0.0, -1.0])
def test_a_wheelbase_is_positive(bad: float) -> None:
    with pytest.raises(InputError, match=r"^wheelbase is .*expected a finite number of metres > 0"):
        Ackermann(0.1, 0.1, bad)
