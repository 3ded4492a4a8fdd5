"""The lists of motion and sensor models, and models as plain values for files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from slamkit.errors import InputError
from slamkit.models.odometry import Odometry
from slamkit.models.range_bearing import RangeBearing
from slamkit.models.relative_position import RelativePosition
from slamkit.models.unicycle import EulerUnicycle, Unicycle
from slamkit.protocols import METHODS, MotionModel, SensorModel
from slamkit.registry import Registry


def _check(protocol: type, what: str) -> Callable[[object], None]:
    """A check that an item of a registry is a class with the protocol's methods."""

    def check(kind: object) -> None:
        if not isinstance(kind, type):
            raise InputError(f"a {what} model must be registered as a class, got {kind!r:.80}")
        missing = [n for n in METHODS[protocol] if not callable(getattr(kind, n, None))]
        if missing:
            needed = f"see slamkit.protocols.{protocol.__name__}"
            raise InputError(f"the class {kind.__name__} is no {what} model: it has no {', '.join(missing)}; {needed}")

    return check


#: Command-line name → motion model. ``MOTIONS.register(name, kind)`` adds a class of your own.
MOTIONS: Registry[Any] = Registry(
    "motion model",
    {
        "unicycle": Unicycle,
        "euler": EulerUnicycle,
        "odometry": Odometry,
    },
    _check(MotionModel, "motion"),
)

#: Command-line name → sensor model. ``SENSORS.register(name, kind)`` adds a class of your own.
SENSORS: Registry[Any] = Registry(
    "sensor model",
    {
        "range-bearing": RangeBearing,
        "relative": RelativePosition,
    },
    _check(SensorModel, "sensor"),
)


def model_to_dict(model: object) -> dict[str, Any] | None:
    """A registered model as ``{"name": class name, argument: value, …}`` that JSON can hold.

    The arguments are those of the constructor: what the model's method ``arguments()`` returns or, without one, the
    fields of its dataclass.

    Parameters
    ----------
    model : object
        An instance of a class in :data:`MOTIONS` or :data:`SENSORS`.

    Returns
    -------
    dict or None
        None if the class is not registered, or if its arguments are unknown or are not plain values.
    """
    kind = type(model)
    if _registered().get(kind.__name__) is not kind:
        return None
    if callable(arguments := getattr(model, "arguments", None)):
        values = arguments()
    elif is_dataclass(model):
        values = {f.name: getattr(model, f.name) for f in fields(model) if f.init}
    else:
        return None
    try:
        return {"name": kind.__name__, **{name: _plain(value) for name, value in values.items()}}
    except TypeError:
        return None


def model_from_dict(value: dict[str, Any]) -> Any:
    """The model that :func:`model_to_dict` wrote.

    Only registered models are made: a file cannot name a module to import.

    Parameters
    ----------
    value : dict
        ``{"name": …, argument: value, …}``; the name is a class name (``"Unicycle"``) or the name in the registry
        (``"unicycle"``).

    Raises
    ------
    InputError
        The name or an argument is unknown, or an argument has an invalid value.
    """
    arguments = dict(value) if isinstance(value, dict) else {}
    name, known = arguments.pop("name", None), _registered()
    kind = known.get(name) or MOTIONS.get(name) or SENSORS.get(name) if isinstance(name, str) else None
    if kind is None:
        raise InputError(f"model is {value!r:.200}, expected an object whose name is one of {', '.join(known)}")
    try:
        return kind(**arguments)
    except TypeError as error:
        raise InputError(f"{name} does not take these arguments: {error}") from None


def parameters_of(kind: type) -> dict[str, tuple[str, float]]:
    """Unit and typical value of each number that a model's constructor takes, in the constructor's order.

    Parameters
    ----------
    kind : type
        A model class.

    Returns
    -------
    dict name → (unit, typical value)
        From the metadata ``unit`` and ``typical`` of the dataclass fields; empty for a class that has none.
    """
    described = [f for f in fields(kind) if {"unit", "typical"} <= f.metadata.keys()] if is_dataclass(kind) else []
    return {f.name: (f.metadata["unit"], f.metadata["typical"]) for f in described}


def _registered() -> dict[str, type]:
    """Class name → class of all registered models. The first of two classes with one name is kept."""
    return {kind.__name__: kind for kind in reversed((*MOTIONS.values(), *SENSORS.values()))}


def _plain(value: Any) -> Any:
    """`value` with arrays as lists and NumPy scalars as numbers; a TypeError if JSON cannot hold it."""
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, tuple | list):
        return [_plain(v) for v in value]
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise TypeError(f"{value!r} is not a plain value")
