"""Filters as files: an npz archive without code, checked before compiled code sees any of it."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

from slamkit.belief import Storage
from slamkit.belief.files import FORMS, UNBOUNDED, load_arrays, to_arrays
from slamkit.errors import InputError, LogFileError
from slamkit.logs import Field, decode_id, encode_id, read_archive, reading, write_archive
from slamkit.models.registry import model_from_dict, model_to_dict

F = TypeVar("F")

_KIND = "filter"
_FIELDS = {name: Field(dtype, shape, finite=name not in UNBOUNDED) for name, (dtype, shape) in FORMS.items()}
#: Longest control for which a file may ask for room.
_LONGEST_CONTROL = 10_000


def save(filter: Any, path: str | Path) -> None:
    """Write a filter; :func:`load` gives one that continues exactly."""
    facts = {
        "filter": filter.name,
        "order": filter.order,
        "gate": filter.gate,
        "snapshots": filter.snapshots,
        "storage": asdict(filter.storage),
        "dim_u": filter.dim_u,
        "ids": [encode_id(i) for i in filter._belief.ids],
        "motion": model_to_dict(filter.motion),
        "sensor": model_to_dict(filter.sensor),
        "own": filter._facts(),
    }
    write_archive(path, _KIND, facts, to_arrays(filter._belief))


def load(cls: type[F], path: str | Path, motion: Any, sensor: Any) -> F:
    """Read a filter that :func:`save` wrote."""
    kind: Any = cls
    with reading(path, _KIND):
        facts, arrays = read_archive(path, _KIND, _FIELDS, _FACTS)
        if facts["filter"] != kind.name:
            raise LogFileError(f"{path} holds the filter {facts['filter']!r}, expected {kind.name!r}")
        models: dict[str, Any] = {}
        for what, given in (("motion", motion), ("sensor", sensor)):
            models[what] = given if given is not None or facts[what] is None else model_from_dict(facts[what])
        missing = [n for n, model in models.items() if model is None]
    if missing:
        raise InputError(f"{path} was written with a {missing[0]} model of its user: give load({missing[0]}=…)")
    with reading(path, _KIND):
        new: Any = kind(
            **models,
            order=facts["order"],
            gate=facts["gate"],
            snapshots=facts["snapshots"],
            storage=Storage(**facts["storage"]),
            **kind._options(facts["own"]),
        )
        _take_control_length(new, facts["dim_u"])
        ids = [_id(i) for i in facts["ids"]]
        load_arrays(new._belief, ids, arrays)
        new._resume(facts["own"])
    return new  # type: ignore[no-any-return]


_FACTS: dict[str, type | tuple[type, ...]] = {
    "filter": str,
    "order": str,
    "gate": (float, int, type(None)),
    "snapshots": bool,
    "storage": dict,
    "dim_u": int,
    "ids": list,
    "motion": (dict, type(None)),
    "sensor": (dict, type(None)),
    "own": dict,
}


def _take_control_length(new: Any, length: int) -> None:
    """A control may be longer than the motion model says only if the model does not say."""
    known = int(getattr(new.motion, "control_dim", 0))
    if not 0 <= length <= _LONGEST_CONTROL or (known and length != known):
        raise InputError(f"dim_u is {length}, expected {known or f'0 to {_LONGEST_CONTROL}'}")
    new._take_control_length(length)


def _id(value: Any) -> Hashable:
    landmark_id = decode_id(value)
    hash(landmark_id)
    return landmark_id
