"""The unicycle on its arc and in its first-order form."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from derivations import close, exact, symbolic
from hypothesis import given, settings
from hypothesis import strategies as st
from model_examples import MOTIONS, durations, name, poses, rates, same_pose

from slamkit.arrays import Array
from slamkit.errors import InputError
from slamkit.models import EulerUnicycle, Unicycle


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("exponent", np.arange(-12, 0.01, 0.25))
def test_unicycle_is_smooth_through_zero_turn(exponent: float, sign: int) -> None:
    value, F, G = symbolic(Unicycle)
    model, pose, v, dt = Unicycle(0.1, 0.1), np.array([0.3, -0.2, 0.7]), 1.3, 0.8
    omega = sign * 2 * 10**exponent / dt  # a = ω·dt/2 is ±10^exponent
    numbers = [*pose, v, omega, 0.0, dt]
    close(model.move(pose, [v, omega], dt), exact(value, *numbers)[:, 0])
    close(model.jacobians(pose, [v, omega], dt)[0], exact(F, *numbers))
    close(model.jacobians(pose, [v, omega], dt)[1], exact(G, *numbers))


def test_unicycle_is_continuous_at_zero_turn_and_where_its_series_end() -> None:
    model, pose, dt = Unicycle(0.1, 0.1), np.array([0.3, -0.2, 0.7]), 2.0  # so that a = ω
    for at in (0.0, 5e-324, 1e-2, 1e-1, -1e-2, -1e-1):
        for other in (np.nextafter(at, 1), np.nextafter(at, -1)):
            for f in (model.move, lambda *a: model.jacobians(*a)[0], lambda *a: model.jacobians(*a)[1]):
                np.testing.assert_allclose(f(pose, [1.0, at], dt), f(pose, [1.0, other], dt), rtol=0, atol=4e-15)


def test_unicycle_at_zero_turn_drives_straight() -> None:
    moved = Unicycle(0.1, 0.1).move([1.0, 2.0, 0.5], [2.0, 0.0], 0.25)
    np.testing.assert_allclose(moved, [1 + 0.5 * np.cos(0.5), 2 + 0.5 * np.sin(0.5), 0.5], rtol=1e-15)


@given(poses, rates, rates, durations)
@settings(max_examples=50, deadline=None)
def test_unicycle_composes_along_its_arc(pose: Array, v: float, omega: float, dt: float) -> None:
    model = Unicycle(0.1, 0.1)
    half = model.move(model.move(pose, [v, omega], dt / 2), [v, omega], dt / 2)
    same_pose(half, model.move(pose, [v, omega], dt), 1e-11)
    same_pose(model.move(model.move(pose, [v, omega], dt), [-v, -omega], dt), pose, 1e-11)


@given(poses, st.floats(0.1, 3), st.floats(0.1, 3))
@settings(max_examples=50, deadline=None)
def test_euler_unicycle_is_the_first_order_of_the_arc(pose: Array, v: float, omega: float) -> None:
    pose[:2] /= 100
    arc, euler = Unicycle(0.1, 0.1), EulerUnicycle(0.1, 0.1)
    errors = []
    for dt in (1e-2, 1e-3):
        difference = arc.move(pose, [v, omega], dt) - euler.move(pose, [v, omega], dt)
        assert difference[2] == 0
        errors.append(np.hypot(*difference[:2]))
        assert errors[-1] == pytest.approx(v * omega * dt**2 / 2, rel=0.02)  # halfway between chord and tangent
    assert errors[1] == pytest.approx(errors[0] / 100, rel=0.05)


@pytest.mark.parametrize("model", MOTIONS[:3], ids=name)
@given(rates, rates, durations, poses)
@settings(max_examples=20, deadline=None)
def test_unicycle_noise_is_what_was_given(model: Any, v: float, omega: float, dt: float, pose: Array) -> None:
    np.testing.assert_array_equal(
        model.control_noise([v, omega], dt), np.diag([model.sigma_v**2, model.sigma_omega**2])
    )
    np.testing.assert_array_equal(model.pose_noise(pose, [v, omega], dt), np.array(model.pose_covariance))


NOT_PSD = [
    np.diag([1.0, 1.0, -1e-6]),
    np.array([[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    np.array([[1.0, 0.5, 0.0], [0.4, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    np.diag([1.0, np.nan, 1.0]),
    np.diag([np.inf, 1.0, 1.0]),
    np.eye(2),
    np.eye(3) * 1j,
    np.eye(3) + 0j,
    np.ones(3),
    0.1,
    "noise",
    [[1.0], [1.0, 2.0]],
]


@pytest.mark.parametrize("noise", NOT_PSD, ids=str)
@pytest.mark.parametrize("maker", [Unicycle, EulerUnicycle])
def test_pose_noise_must_be_a_covariance(maker: type, noise: Any) -> None:
    with pytest.raises(InputError, match="pose_noise"):
        maker(0.1, 0.1, noise)


@given(st.lists(st.floats(-3, 3), min_size=9, max_size=9))
@settings(max_examples=50, deadline=None)
def test_every_covariance_is_taken_and_kept(entries: list[float]) -> None:
    root = np.reshape(entries, (3, 3))
    covariance = root @ root.T
    kept = Unicycle(0.1, 0.1, covariance).pose_noise(np.zeros(3), np.zeros(2), 1.0)
    np.testing.assert_allclose(kept, covariance, rtol=1e-14, atol=1e-300)
    np.testing.assert_array_equal(kept, kept.T)
