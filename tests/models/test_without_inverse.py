"""Sensors that measure a bearing or a range alone, and so have no inverse."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from model_examples import PI, WITHOUT_INVERSE, headings, name, poses

from slamkit import EKFSLAM
from slamkit.arrays import Array
from slamkit.errors import InputError, ModelError
from slamkit.models import Bearing, Range, RangeBearing, Unicycle
from slamkit.protocols import SensorModel

ROW = {Range: 0, Bearing: 1}  # of a range-bearing sensor


@pytest.mark.parametrize("model", WITHOUT_INVERSE, ids=name)
@given(poses, headings, st.floats(0, 9e-7) | st.floats(1e-3, 100), st.floats(-50, 50))
@settings(max_examples=50, deadline=None)
def test_it_is_a_part_of_the_range_bearing_sensor(
    model: Any, pose: Array, direction: float, r: float, z: float
) -> None:
    pose[:2] = 0.0 if r < 1e-6 else pose[:2]  # at large coordinates a distance of 1e-6 m is not a number of its own
    landmark = pose[:2] + r * np.array([np.cos(direction), np.sin(direction)])
    whole, row = RangeBearing(0.1, 0.1), ROW[type(model)]
    if r > 1e-6:
        np.testing.assert_array_equal(model.predict(pose, landmark), whole.predict(pose, landmark)[[row]])
        for part, both in zip(model.jacobians(pose, landmark), whole.jacobians(pose, landmark), strict=True):
            np.testing.assert_array_equal(part, both[[row]])
    else:
        assert np.isnan(model.predict(pose, landmark)).all()
        assert np.isnan(model.jacobians(pose, landmark)[1]).all()
    np.testing.assert_array_equal(model.residual([z], [1.0]), whole.residual([z, z], [1.0, 1.0])[[row]])


@pytest.mark.parametrize("model", WITHOUT_INVERSE, ids=name)
@pytest.mark.parametrize("r", [0.0, 9e-7, 1.1e-6, 2.5])
@pytest.mark.parametrize("z", [-1.0, 0.0, 4.0])
def test_linearise_gives_nan_where_the_others_do(model: Any, r: float, z: float) -> None:
    pose, landmark = np.array([0.0, 0.0, 3.0]), r * np.array([0.6, -0.8])
    found = np.zeros(1), np.zeros(1), np.zeros((1, 3)), np.zeros((1, 2))
    model.functions.linearise(pose, landmark, np.array([z]), model.params, *found)
    z_hat = model.predict(pose, landmark)
    for got, expected in zip(found, (z_hat, model.residual([z], z_hat), *model.jacobians(pose, landmark)), strict=True):
        np.testing.assert_allclose(got, expected, rtol=1e-15)


@pytest.mark.parametrize("model", WITHOUT_INVERSE, ids=name)
def test_a_filter_refuses_it_and_says_what_it_lacks(model: Any) -> None:
    assert not isinstance(model, SensorModel)
    with pytest.raises(ModelError, match=f"sensor is a {name(model)}, which has no invert, inverse_jacobians"):
        EKFSLAM(Unicycle(0.1, 0.1), model)


@given(st.floats(-20, 20), st.floats(-20, 20))
@settings(max_examples=50, deadline=None)
def test_bearings_are_subtracted_as_angles(b: float, b_hat: float) -> None:
    (db,) = Bearing(0.1).residual([b], [b_hat])
    assert -PI <= db < PI
    assert abs(np.exp(1j * db) - np.exp(1j * (b - b_hat))) <= 1e-14


@given(st.floats(max_value=-5e-324, min_value=-1e9))
@settings(max_examples=50, deadline=None)
def test_a_negative_range_is_no_measurement(r: float) -> None:
    model = Range(0.1)
    assert np.isnan(model.residual([r], [1.0]))
    with pytest.raises(InputError, match=re.escape(f"range is {r} m, expected a range ≥ 0")):
        model.validate([[1.0], [r], [-1.0]])
    model.validate([[0.0], [-r]])
    model.validate(np.empty((0, 1)))
