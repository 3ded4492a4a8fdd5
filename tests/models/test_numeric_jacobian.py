"""The numeric Jacobian."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from model_examples import PI

from slamkit import se2
from slamkit.arrays import Array
from slamkit.errors import InputError
from slamkit.models import numeric_jacobian


@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(0.01, 1))
@settings(max_examples=50, deadline=None)
def test_numeric_jacobian_of_smooth_functions(x: float, y: float, step: float) -> None:
    def f(v: Array) -> Array:
        return np.array([np.sin(v[0]) * np.exp(v[1]), v[0] ** 5, np.cos(2 * v[1]), 7.0])

    expected = np.array(
        [[np.cos(x) * np.exp(y), np.sin(x) * np.exp(y)], [5 * x**4, 0], [0, -2 * np.sin(2 * y)], [0, 0]]
    )
    np.testing.assert_allclose(numeric_jacobian(f, [x, y]), expected, rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(numeric_jacobian(f, [x, y], step=[step, step]), expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    "A", [np.arange(6.0).reshape(2, 3), np.ones((1, 4)), np.zeros((3, 1)), np.empty((2, 0))], ids=str
)
def test_numeric_jacobian_of_a_linear_map_is_its_matrix(A: Array) -> None:
    x = np.linspace(-1, 1, A.shape[1])
    J = numeric_jacobian(lambda v: A @ v, x)
    assert J.shape == A.shape
    np.testing.assert_allclose(J, A, atol=1e-13)


@pytest.mark.parametrize("x", [1e-8, 1e-3, 1.0, 1e6, 1e12])
def test_numeric_jacobian_at_any_size(x: float) -> None:
    assert numeric_jacobian(lambda v: v**2, [x])[0, 0] == pytest.approx(2 * x, rel=1e-8, abs=1e-12)
    assert numeric_jacobian(np.log, [x], step=x / 10)[0, 0] == pytest.approx(1 / x, rel=1e-9)


@pytest.mark.parametrize("step", [None, 1.0])
def test_numeric_jacobian_is_extrapolated_not_merely_central(step: float | None) -> None:
    for x in (-1.0, 0.3, 2.0):
        for f, slope in ((np.exp, np.exp(x)), (np.sin, np.cos(x)), (np.arctan, 1 / (1 + x * x))):
            assert numeric_jacobian(f, [x], step=step)[0, 0] == pytest.approx(slope, rel=2e-12)


def test_numeric_jacobian_subtracts_angles_as_it_is_told() -> None:
    def heading(v: Array) -> Array:
        return np.array([se2.wrap(2 * v[0])])

    told = numeric_jacobian(heading, [PI / 2], difference=lambda a, b: se2.wrap(a - b))
    np.testing.assert_allclose(told, [[2.0]], rtol=1e-12)
    assert abs(numeric_jacobian(heading, [PI / 2])[0, 0] - 2) > 1


def test_numeric_jacobian_near_the_edge_of_a_domain() -> None:
    assert numeric_jacobian(np.sqrt, [1e-2])[0, 0] == pytest.approx(5.0, rel=1e-9)
    assert np.isnan(numeric_jacobian(np.sqrt, [-1.0]))


def test_a_periodic_function_is_not_sampled_in_phase() -> None:
    for step in (0.1, 0.2, 0.05):
        J = numeric_jacobian(lambda v: np.sin(20 * PI * v), [0.0], step=step)
        assert J[0, 0] == pytest.approx(20 * PI, rel=1e-8)


@pytest.mark.parametrize(
    ("x", "step"),
    [
        (np.nan, None),
        ([np.inf], None),
        ([[1.0]], None),
        ([1.0], 0.0),
        ([1.0], -1.0),
        ([1.0], [1.0, 1.0]),
        ([1.0], np.nan),
    ],
)
def test_numeric_jacobian_refuses_bad_points_and_steps(x: Any, step: Any) -> None:
    with pytest.raises(InputError, match=r"^(x|step) is .*expected"):
        numeric_jacobian(lambda v: v, x, step=step)


def test_numeric_jacobian_refuses_what_is_no_vector_function() -> None:
    with pytest.raises(InputError, match="one vector length"):
        numeric_jacobian(lambda v: float(v[0]), [1.0])
