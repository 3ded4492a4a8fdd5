"""Odometry: its noise, and controls from consecutive poses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from model_examples import PI, durations, headings, poses, same_pose

from slamkit import se2
from slamkit.arrays import Array
from slamkit.errors import InputError
from slamkit.models import Odometry


@given(st.tuples(*[st.floats(0, 2)] * 4), st.tuples(*[st.floats(-3, 3)] * 3), durations)
@settings(max_examples=50, deadline=None)
def test_odometry_noise_follows_the_book(alpha: tuple[float, ...], u: tuple[float, ...], dt: float) -> None:
    a1, a2, a3, a4 = alpha
    rot1, trans, rot2 = u
    variances = [a1 * rot1**2 + a2 * trans**2, a3 * trans**2 + a4 * (rot1**2 + rot2**2), a1 * rot2**2 + a2 * trans**2]
    model = Odometry(*alpha)
    np.testing.assert_allclose(model.control_noise(u, dt), np.diag(variances), rtol=1e-14, atol=0)
    assert not model.pose_noise(np.zeros(3), u, dt).any()


steps = st.builds(
    lambda x, y, t: np.array([x, y, t]),
    st.floats(-5, 5) | st.sampled_from([0.0, 1e-12, -1e-12, 1e-9, -1e-9, 1e-6]),
    st.floats(-5, 5) | st.sampled_from([0.0, -0.0, 1e-12, -1e-12, 1e-10, 1e-6]),
    headings,
)


@given(poses, steps)
@settings(deadline=None)
def test_control_between_leads_from_pose_to_pose(before: Array, step: Array) -> None:
    after = se2.compose(before, step)
    u = Odometry.control_between(before, after)
    same_pose(Odometry(0.1, 0.1, 0.1, 0.1).move(before, u, 1.0), after, 3e-9)
    assert abs(u[0]) <= PI / 2
    assert -PI <= u[2] < PI


@given(poses, poses)
@settings(deadline=None)
def test_control_between_any_two_poses(before: Array, after: Array) -> None:
    u = Odometry.control_between(before, after)
    same_pose(Odometry(0.1, 0.1, 0.1, 0.1).move(before, u, 1.0), after, 3e-9)
    assert abs(u[0]) <= PI / 2


@given(headings, st.floats(0.01, 5), st.floats(-0.3, 0.3), st.floats(-0.3, 0.3))
@settings(deadline=None)
def test_a_reversing_robot_has_a_negative_translation(heading: float, d: float, rot1: float, rot2: float) -> None:
    before = np.array([0.0, 0.0, heading])
    after = Odometry(0.1, 0.1, 0.1, 0.1).move(before, [rot1, -d, rot2], 1.0)
    np.testing.assert_allclose(Odometry.control_between(before, after), [rot1, -d, rot2], atol=1e-12)


@given(headings, headings)
@settings(deadline=None)
def test_a_robot_at_rest_or_turning_on_the_spot_has_no_first_turn(heading: float, turn: float) -> None:
    before = np.array([0.0, 0.0, heading])
    np.testing.assert_array_equal(Odometry.control_between(before, before), np.zeros(3))
    for jitter in (0.0, 1e-12, -1e-10):
        after = np.array([jitter, -jitter, se2.wrap(heading + turn)])
        rot1, trans, rot2 = Odometry.control_between(before, after)
        assert rot1 == 0
        assert abs(trans) < 1e-9
        assert abs(se2.wrap(rot2 - turn)) <= 1e-12


@pytest.mark.parametrize("bad", [[0, 0], [[0, 0, 0]], [0, np.nan, 0], [0, 0, np.inf], "pose", [[1], [1, 2]], 0.0])
def test_control_between_refuses_what_is_no_pose(bad: Any) -> None:
    with pytest.raises(InputError, match="before"):
        Odometry.control_between(bad, [0, 0, 0])
    with pytest.raises(InputError, match="after"):
        Odometry.control_between([0, 0, 0], bad)
