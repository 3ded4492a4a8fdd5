"""The check of a model before a filter uses it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
import pytest
from family import MOTIONS, SENSORS, PlainMotion, PlainSensor

from slamkit.errors import ModelError
from slamkit.models import RangeBearing, Unicycle
from slamkit.protocols import (
    METHODS,
    MotionFunctions,
    MotionModel,
    SensorFunctions,
    SensorModel,
    is_compiled,
    require_model,
)

MOTION, SENSOR = Unicycle(0.1, 0.1), RangeBearing(0.1, 0.1)
GOOD: list[Any] = [
    *[(m, MotionModel) for m in (*MOTIONS.values(), PlainMotion(MOTION))],
    *[(s, SensorModel) for s in (*SENSORS.values(), PlainSensor(SENSOR))],
]


def plain(*arguments: Any) -> None:
    """A function that is not compiled."""


@numba.njit
def numba_function(z, z_hat, params, out):  # type: ignore[no-untyped-def]
    out[0] = z[0] - z_hat[0]


def changed(model: Any, **attributes: Any) -> Any:
    """A model of a class of its own, with other attributes."""
    made = type("Changed", (type(model),), attributes)
    parameters = [getattr(model, name) for name in ("sigma_v", "sigma_omega", "sigma_range") if hasattr(model, name)]
    return made(*parameters, *([0.1] if len(parameters) == 1 else []))


@pytest.mark.parametrize(("model", "protocol"), GOOD, ids=lambda x: type(x).__name__)
def test_a_good_model_passes(model: Any, protocol: type) -> None:
    require_model(model, protocol, "model")


@pytest.mark.parametrize(("model", "protocol"), GOOD, ids=lambda x: type(x).__name__)
def test_a_class_in_place_of_an_instance_is_refused(model: Any, protocol: type) -> None:
    name = type(model).__name__
    with pytest.raises(ModelError, match=rf"^the model is the class {name}, expected an instance: {name}\(…\)$"):
        require_model(type(model), protocol, "the model")


@pytest.mark.parametrize(("model", "protocol"), GOOD, ids=lambda x: type(x).__name__)
def test_a_missing_method_is_named(model: Any, protocol: type) -> None:
    for method in METHODS[protocol]:
        kept = {n: getattr(model, n) for n in ("R", *METHODS[protocol]) if n != method and hasattr(model, n)}
        with pytest.raises(ModelError, match=rf"^motion is a Half, which has no {method}: see .*{protocol.__name__}$"):
            require_model(type("Half", (), kept)(), protocol, "motion")


def test_a_sensor_without_noise_is_refused() -> None:
    kept = {n: getattr(SENSOR, n) for n in METHODS[SensorModel]}
    with pytest.raises(ModelError, match=r"^sensor is a Half, which has no R: see"):
        require_model(type("Half", (), kept)(), SensorModel, "sensor")


@pytest.mark.parametrize(("model", "protocol"), GOOD, ids=lambda x: type(x).__name__)
def test_an_attribute_in_place_of_a_method_is_refused(model: Any, protocol: type) -> None:
    for method in METHODS[protocol]:
        kept = {n: getattr(model, n) for n in ("R", *METHODS[protocol]) if hasattr(model, n)}
        with pytest.raises(ModelError, match=f"whose {method} is 3, expected a method"):
            require_model(type("Odd", (), kept | {method: 3})(), protocol, "model")


def test_a_sensor_in_the_place_of_a_motion_is_refused() -> None:
    with pytest.raises(ModelError, match=r"^motion is a RangeBearing, which has no move, control_noise, pose_noise"):
        require_model(SENSOR, MotionModel, "motion")
    with pytest.raises(ModelError, match=r"^sensor is a NoneType, which has no R, predict, "):
        require_model(None, SensorModel, "sensor")


@pytest.mark.parametrize("function", [*MotionFunctions._fields])
def test_a_plain_function_where_a_compiled_one_is_due_is_refused(function: str) -> None:
    model = changed(MOTION, functions=Unicycle.functions._replace(**{function: plain}))
    expected = f"functions.{function} is the plain Python function plain, expected one decorated with numba.njit"
    with pytest.raises(ModelError, match=f"^motion is a Changed whose {expected}"):
        require_model(model, MotionModel, "motion")


@pytest.mark.parametrize("function", [*SensorFunctions._fields])
@pytest.mark.parametrize("wrong", [plain, SENSOR.predict, 3], ids=["plain function", "method", "number"])
def test_what_a_sensor_cannot_have_compiled_is_refused(function: str, wrong: Any) -> None:
    model = changed(SENSOR, functions=RangeBearing.functions._replace(**{function: wrong}))
    with pytest.raises(ModelError, match=rf"whose functions\.{function} is .*, expected one decorated with"):
        require_model(model, SensorModel, "sensor")


@pytest.mark.parametrize("functions", [(), (plain,), object()], ids=["empty", "one plain function", "object"])
def test_functions_that_lack_one_are_refused(functions: Any) -> None:
    with pytest.raises(ModelError, match=r"whose functions\.predict is missing, expected one decorated with"):
        require_model(changed(SENSOR, functions=functions), SensorModel, "sensor")


@pytest.mark.parametrize("params", [np.eye(2), np.array([1j]), 3.0, ["a"], None], ids=str)
def test_params_that_are_no_vector_of_real_numbers_are_refused(params: Any) -> None:
    with pytest.raises(ModelError, match=r"whose params is .*, expected a vector of real numbers"):
        require_model(changed(SENSOR, params=params), SensorModel, "sensor")


def test_the_fused_function_is_optional() -> None:
    four, five = Unicycle.functions[:4], RangeBearing.functions[:5]
    require_model(changed(MOTION, functions=MotionFunctions(*four)), MotionModel, "motion")
    require_model(changed(SENSOR, functions=SensorFunctions(*five)), SensorModel, "sensor")
    assert MotionFunctions(*Unicycle.functions) == Unicycle.functions  # positional, as in slamkit 0.1


def test_compiled_functions_are_told_from_others() -> None:
    assert is_compiled(numba_function)
    assert all(is_compiled(f) for f in (*Unicycle.functions, *RangeBearing.functions))
    assert not any(is_compiled(f) for f in (plain, numba_function.py_func, Unicycle, None, 3, dataclass))
