"""Motion and sensor models as the functions that a step calls."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from slamkit.arrays import Array
from slamkit.compiled import Models, models_of
from slamkit.errors import ModelError
from slamkit.protocols import METHODS, MotionFunctions, MotionModel, SensorFunctions, SensorModel


def adapt(motion: MotionModel, sensor: SensorModel, R: Array) -> Models:
    """Both models as functions that write into their last arguments: compiled ones as they are, others wrapped."""
    motion_functions, sensor_functions = getattr(motion, "functions", None), getattr(sensor, "functions", None)
    both = motion_functions is not None and sensor_functions is not None
    if motion_functions is None:
        motion_functions = MotionFunctions(*(_filling(motion, name) for name in METHODS[MotionModel]))
    if sensor_functions is None:
        sensor_functions = SensorFunctions(*(_filling(sensor, name) for name in METHODS[SensorModel]))
    moving, seeing = (
        np.ascontiguousarray(getattr(model, "params", np.empty(0)), dtype=float) for model in (motion, sensor)
    )
    return models_of(motion_functions, sensor_functions, moving, seeing, np.ascontiguousarray(R), compiled=both)


_OUTPUTS = {"jacobians": 2, "inverse_jacobians": 2}


def _filling(model: object, name: str) -> Callable[..., None]:
    """A method of a plain model as a function (…, params, out…) that fills its outputs, shapes checked."""
    method, outputs = getattr(model, name), _OUTPUTS.get(name, 1)

    def fill(*arguments: Any) -> None:
        given, outs = arguments[: -outputs - 1], arguments[-outputs:]
        results = method(*given)
        for out, result in zip(outs, results if outputs > 1 else (results,), strict=True):
            value = np.asarray(result, dtype=float)
            if value.shape != out.shape:
                raise ModelError(f"{type(model).__name__}.{name} gave shape {value.shape}, expected {out.shape}")
            out[...] = value

    return fill
