"""Range and bearing: short and negative ranges, and differences of bearings."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from model_examples import PI, headings, poses

from slamkit.arrays import Array
from slamkit.errors import InputError
from slamkit.models import RangeBearing, RelativePosition


@given(poses, headings, st.floats(0, 9.9e-7))
@settings(max_examples=50, deadline=None)
def test_a_landmark_on_the_robot_has_no_bearing(pose: Array, direction: float, r: float) -> None:
    pose[:2] = 0.0  # at large coordinates a distance of 1e-6 m is not a number of its own
    model, landmark = RangeBearing(0.1, 0.1), r * np.array([np.cos(direction), np.sin(direction)])
    assert np.isnan(model.predict(pose, landmark)[0])
    assert np.isnan(model.jacobians(pose, landmark)[0]).any()
    assert np.isnan(model.invert(pose, [r, direction])).all()
    assert np.all(np.isfinite(RelativePosition(0.1).predict(pose, landmark)))


@pytest.mark.parametrize("r", [1.1e-6, 1e-5, 1e-3])
def test_a_landmark_a_little_further_has_one(r: float) -> None:
    model = RangeBearing(0.1, 0.1)
    for bearing in np.linspace(-3, 3, 13):
        z = model.predict([0.0, 0.0, 0.4], r * np.array([np.cos(0.4 + bearing), np.sin(0.4 + bearing)]))
        np.testing.assert_allclose(z, [r, bearing], rtol=1e-9, atol=1e-12)


@given(st.floats(max_value=-5e-324, min_value=-1e9), st.floats(-10, 10))
@settings(max_examples=50, deadline=None)
def test_a_negative_range_is_no_measurement(r: float, bearing: float) -> None:
    model = RangeBearing(0.1, 0.1)
    assert np.isnan(model.residual([r, bearing], [1.0, 0.0])[0])
    assert np.isnan(model.invert([0.0, 0.0, 0.0], [r, bearing])).all()
    with pytest.raises(InputError, match=re.escape(f"range is {r} m, expected a range ≥ 0")):
        model.validate([r, bearing])
    with pytest.raises(InputError, match=re.escape(f"range is {r} m")):
        model.validate([[1.0, 0.0], [r, bearing], [-1.0, 0.0]])
    model.validate([[0.0, bearing], [-r, bearing]])
    model.validate(np.empty((0, 2)))


@given(st.floats(0, 100), st.floats(0, 100), st.floats(-20, 20), st.floats(-20, 20))
@settings(max_examples=100, deadline=None)
def test_bearings_are_subtracted_as_angles(r: float, r_hat: float, b: float, b_hat: float) -> None:
    dr, db = RangeBearing(0.1, 0.1).residual([r, b], [r_hat, b_hat])
    assert dr == r - r_hat
    assert -PI <= db < PI
    assert abs(np.exp(1j * db) - np.exp(1j * (b - b_hat))) <= 1e-14
