"""Motion and sensor models by name and noise, as options give them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from slamkit.errors import InputError, LogFileError
from slamkit.models import MOTIONS, SENSORS, Odometry, parameters_of
from slamkit.registry import Registry

__all__ = ["check_fit", "choose", "columns_of", "described"]

KINDS: dict[str, Registry[Any]] = {"motion": MOTIONS, "sensor": SENSORS}


def columns_of(kind: type) -> tuple[str, ...]:
    """The names of the model's numbers in a CSV file; empty if they do not identify the model."""
    columns: tuple[str, ...] = getattr(kind, "columns", ())
    return columns


def choose(
    what: str,
    columns: Sequence[str],
    name: str | None,
    noise: str | None,
    given: Any,
) -> Any:
    """The model that the options name, else the one that the data say, else the one whose columns these are.

    Parameters
    ----------
    what : {"motion", "sensor"}
    columns : sequence of str
        Names of the columns of the controls or the measurements; empty if they have none.
    name, noise : str or None
        The options ``--motion`` and ``--motion-noise``, or ``--sensor`` and ``--sensor-noise``.
    given : model or None
        What models.json, the data set or the world says.

    Raises
    ------
    InputError
        A name is unknown, the noise does not fit the model, or nothing tells which model made the log.
    """
    kinds = KINDS[what]
    if name is not None:
        kind = kinds.find(name)
    elif given is not None:
        kind, name = type(given), _name_of(kinds, type(given))
    else:
        name = next((n for n, k in kinds.items() if columns and columns_of(k) == tuple(columns)), None)
        if name is None:
            raise InputError(
                f"the columns {','.join(columns)} do not tell the {what} model, expected --{what} {'|'.join(kinds)}"
            )
        kind = kinds[name]
    return given if noise is None and kind is type(given) else _make(what, name, kind, noise)


def check_fit(what: str, model: Any, columns: Sequence[str], where: object, increments: bool) -> None:
    """Refuse a model whose numbers are not those of the log.

    Parameters
    ----------
    what : {"motion", "sensor"}
    model : MotionModel or SensorModel
    columns : sequence of str
        Names of the columns of the controls or the measurements; empty if they have none.
    where : object
        The file or the world that has them, for the message.
    increments : bool
        Whether the log's controls are increments.

    Raises
    ------
    LogFileError
        A built-in motion model is given controls of the other kind, or the columns belong to another model.
    """
    kind, kinds = type(model), KINDS[what]
    numbers = ",".join(columns)
    if what == "motion" and kind in kinds.values() and isinstance(model, Odometry) != increments:
        rates = f"{'increments' if increments else 'rates'} {numbers}".strip()
        raise LogFileError(f"{where} has {rates}, which {model!r} cannot take")
    own, known = columns_of(kind), [columns_of(k) for k in kinds.values()]
    if own and columns and tuple(columns) in known and own != tuple(columns):
        raise LogFileError(f"{where} has {numbers}, but the {what} model {_name_of(kinds, kind)} takes {','.join(own)}")


def described(what: str, model: Any) -> str:
    """The options that give this model, or the model itself where no options do."""
    name, parameters = _name_of(KINDS[what], type(model)), parameters_of(type(model))
    if not parameters:
        return f"--{what} {name} ({model!r})"
    noise = ",".join(f"{getattr(model, parameter):.4g}" for parameter in parameters)
    extra = " (and additive pose noise)" if np.any(getattr(model, "pose_covariance", 0.0)) else ""
    return f"--{what} {name} --{what}-noise {noise}{extra}"


def _name_of(kinds: Registry[Any], kind: type) -> str:
    return next((n for n, k in kinds.items() if k is kind), f"{kind.__module__}:{kind.__qualname__}")


def _make(what: str, name: str, kind: Any, noise: str | None) -> Any:
    """A model with this noise, or with typical noise."""
    parameters = parameters_of(kind)
    takes = ", ".join(f"{parameter} [{unit}]" for parameter, (unit, _) in parameters.items())
    count = f" {len(parameters)}: {takes}" if parameters else " numbers between commas"
    numbers: list[float] = [typical for _, typical in parameters.values()]
    if noise is not None:
        try:
            numbers = [float(part) for part in noise.split(",")]
        except ValueError:
            raise InputError(f"--{what}-noise is {noise!r}, {name} takes{count}") from None
        if parameters and len(numbers) != len(parameters):
            raise InputError(f"--{what}-noise is {noise!r}, {name} takes{count}")
    try:
        return kind(*numbers)
    except TypeError as error:
        given = f"--{what}-noise {noise}" if noise is not None else f"no --{what}-noise"
        raise InputError(f"--{what} {name} with {given} cannot be made: {error}") from None
