"""The built-in models as plain values, for files."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from slamkit.errors import InputError
from slamkit.models.motion import EulerUnicycle, Odometry, Unicycle
from slamkit.models.sensors import RangeBearing, RelativePosition

BUILT_IN: dict[str, Any] = {m.__name__: m for m in (Unicycle, EulerUnicycle, Odometry, RangeBearing, RelativePosition)}

# A unicycle's additive noise is kept under a name of its own, since `pose_noise` is the protocol's method.
_ARGUMENT = {"pose_covariance": "pose_noise"}


def model_to_dict(model: object) -> dict[str, Any] | None:
    """A built-in model as ``{"name": ..., argument: value, ...}`` that JSON can hold; None for any other object."""
    if BUILT_IN.get(type(model).__name__) is not type(model):
        return None
    values = {_ARGUMENT.get(f.name, f.name): getattr(model, f.name) for f in fields(model)}  # type: ignore[arg-type]
    return {"name": type(model).__name__, **values}


def model_from_dict(value: dict[str, Any]) -> Any:
    """The model that :func:`model_to_dict` wrote.

    Raises
    ------
    InputError
        The name or an argument is unknown, or an argument does not fit.
    """
    arguments = dict(value) if isinstance(value, dict) else {}
    name = arguments.pop("name", None)
    if name not in BUILT_IN:
        raise InputError(f"model is {value!r}, expected an object whose name is one of {', '.join(BUILT_IN)}")
    try:
        return BUILT_IN[name](**arguments)
    except TypeError as error:
        raise InputError(f"{name} does not take these arguments: {error}") from None
