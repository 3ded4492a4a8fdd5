"""Bad input to the statistics of consistency."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slamkit.arrays import Array
from slamkit.errors import InputError
from slamkit.evaluate import (
    chi2_bounds,
    coverage,
    heading_nees,
    inclination,
    landmark_nees,
    nci,
    nees,
    nis,
    pose_nees,
    position_nees,
    state_error,
    state_nees,
    summary,
    whiteness,
)

GOOD: dict[str, tuple[Callable[..., Any], tuple[Array, ...]]] = {
    "nees": (nees, (np.zeros((6, 4, 3)), np.tile(np.eye(3), (6, 4, 1, 1)))),
    "nis": (nis, (np.zeros((6, 2)), np.tile(np.eye(2), (6, 1, 1)))),
    "pose_nees": (pose_nees, (np.zeros((6, 3)), np.tile(np.eye(3), (6, 1, 1)), np.zeros((6, 3)))),
    "position_nees": (position_nees, (np.zeros((6, 3)), np.tile(np.eye(3), (6, 1, 1)), np.zeros((6, 3)))),
    "heading_nees": (heading_nees, (np.zeros((6, 3)), np.tile(np.eye(3), (6, 1, 1)), np.zeros((6, 3)))),
    "landmark_nees": (landmark_nees, (np.zeros((6, 2)), np.tile(np.eye(2), (6, 1, 1)), np.zeros((6, 2)))),
    "state_nees": (state_nees, (np.zeros((6, 7)), np.tile(np.eye(7), (6, 1, 1)), np.zeros((6, 7)))),
    "state_error": (state_error, (np.zeros((6, 5)), np.zeros((6, 5)))),
    "chi2_bounds": (chi2_bounds, (np.ones((6, 4)), np.ones((6, 4)))),
    "summary": (lambda v: summary(v, 3), (np.ones((6, 4)),)),
    "coverage": (coverage, (np.ones((6, 4)), np.ones((6, 4)))),
    "levels": (lambda p: coverage([1.0], 3, p), (np.linspace(0, 1, 5),)),
    "nci": (nci, (np.ones((6, 4, 2)), np.tile(np.eye(2), (6, 4, 1, 1)))),
    "inclination": (inclination, (np.ones((6, 4, 2)), np.tile(np.eye(2), (6, 4, 1, 1)))),
    "whiteness": (
        lambda y, S: whiteness(y, S, lags=3),
        (np.random.default_rng(0).normal(size=(9, 2)), np.tile(np.eye(2), (9, 1, 1))),
    ),
}


@pytest.mark.parametrize("name", GOOD)
@given(data=st.data())
@settings(max_examples=20)
def test_values_that_are_not_finite_are_refused(name: str, data: st.DataObject) -> None:
    f, arguments = GOOD[name]
    f(*arguments)
    which = data.draw(st.integers(0, len(arguments) - 1))
    broken = arguments[which].copy()
    broken[np.unravel_index(data.draw(st.integers(0, broken.size - 1)), broken.shape)] = data.draw(
        st.sampled_from([np.nan, np.inf, -np.inf])
    )
    with pytest.raises(InputError, match="not finite"):
        f(*arguments[:which], broken, *arguments[which + 1 :])


@pytest.mark.parametrize("name", GOOD)
def test_complex_values_are_refused(name: str) -> None:
    f, arguments = GOOD[name]
    for which, argument in enumerate(arguments):
        with pytest.raises(InputError, match="must be numbers"):
            f(*arguments[:which], argument.astype(complex), *arguments[which + 1 :])


@pytest.mark.parametrize("name", [name for name, (_, arguments) in GOOD.items() if len(arguments) > 1])
@given(data=st.data())
@settings(max_examples=20)
def test_shapes_that_do_not_fit_are_refused(name: str, data: st.DataObject) -> None:
    f, arguments = GOOD[name]
    which = data.draw(st.integers(0, len(arguments) - 1))
    axis = data.draw(st.integers(0, arguments[which].ndim - 1))
    # One more along any one axis, whatever it means, fits nothing else.
    broken = np.concatenate([arguments[which], np.take(arguments[which], [0], axis)], axis)
    with pytest.raises(InputError):
        f(*arguments[:which], broken, *arguments[which + 1 :])
    with pytest.raises(InputError, match="must be numbers"):
        f(*arguments[:which], "a string", *arguments[which + 1 :])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: nees(1.0, np.eye(1)), "error has shape"),
        (lambda: nees(np.zeros((4, 0)), np.zeros((4, 0, 0))), "not empty"),
        (lambda: nees(np.zeros((2, 2)), np.stack([np.eye(2), [[1, 0.1], [0, 1]]])), r"not symmetric at \(1,\)"),
        (lambda: nees([0.0], [[1.0]], rtol=-1), "rtol"),
        (lambda: nees([0.0], [[1.0]], atol=np.nan), "atol"),
        (lambda: pose_nees(np.zeros(5), np.eye(5), np.zeros(5)), "5 components"),
        (lambda: state_error(np.zeros(2), np.zeros(2)), "d ≥ 3"),
        (lambda: landmark_nees(np.zeros(3), np.eye(3), np.zeros(3)), r"\(\.\.\., 2\)"),
        (lambda: chi2_bounds(-1, 50), "dof"),
        (lambda: chi2_bounds(3, 0), "runs"),
        (lambda: chi2_bounds(3, 2.5), "runs"),
        (lambda: chi2_bounds(3, 50, 1.0), "probability"),
        (lambda: chi2_bounds(3, 50, float("nan")), "probability"),
        (lambda: summary([], 3), "values"),
        (lambda: summary(np.ones((3, 0)), 3), "no run, or no step"),
        (lambda: summary([1.0, -1e-9], 3), "negative"),
        (lambda: summary([1.0], 0), "dof"),
        (lambda: summary([1.0], [3, 3]), "dof"),  # type: ignore[arg-type]
        (lambda: nees([0.0], [[1.0]], rtol="a"), "rtol"),  # type: ignore[arg-type]
        (lambda: chi2_bounds(3, 50, "a"), "probability"),  # type: ignore[arg-type]
        (lambda: summary([1.0], 3, limit=float("nan")), "limit"),
        (lambda: coverage([1.0], 0), "every dof"),
        (lambda: coverage([1.0], 3, [0.5, 0.5]), "ascending"),
        (lambda: coverage([1.0], 3, [0.5, 1.5]), "ascending"),
        (lambda: nci(np.ones((5, 2)), np.ones((7, 5, 2, 2)) * np.eye(2)), "expected"),
        (lambda: whiteness(np.ones((9, 2)), lags=3), "span"),
        (lambda: whiteness(np.eye(9), lags=9), "lags"),
        (lambda: whiteness(np.eye(9), lags=0), "lags"),
        (lambda: whiteness(np.eye(9), lags=2.0), "lags"),  # type: ignore[arg-type]
        (lambda: whiteness(np.eye(9), -np.eye(9), lags=2), "positive definite"),
    ],
)
def test_bad_calls_say_what_was_wrong(call: Callable[[], object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        call()
