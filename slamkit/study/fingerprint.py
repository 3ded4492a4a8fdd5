"""A short hash of any setting: equal for equal content, in every process."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import fields, is_dataclass
from functools import cached_property
from types import (
    BuiltinFunctionType,
    CodeType,
    FunctionType,
    GetSetDescriptorType,
    MemberDescriptorType,
    MethodType,
    ModuleType,
)
from typing import Any

import numpy as np


def fingerprint(value: object) -> str:
    """Hash a setting: a number, an array, a model, a class, a function, or any mapping or sequence of these.

    slamkit's own classes and functions are known by name: the version of slamkit is a setting of its own. Classes and
    functions from elsewhere are hashed by their code and by the values that they hold (defaults, closures, class
    attributes). Functions that such code merely calls by a global name are not followed.

    Returns
    -------
    str
        16 hexadecimal digits.
    """
    hash_ = hashlib.sha256()
    _feed(hash_, value, set())
    return hash_.hexdigest()[:16]


def _feed(hash_: Any, value: Any, open_: set[int]) -> None:
    named = isinstance(value, type | FunctionType | BuiltinFunctionType)
    kind = value if named else type(value)
    hash_.update(f"<{kind.__module__}.{kind.__qualname__}>".encode())
    if value is None or isinstance(value, bool | int | float | complex | str | bytes | np.generic | ModuleType):
        hash_.update(repr(value.__name__ if isinstance(value, ModuleType) else value).encode())
        return
    if id(value) in open_:  # a reference back to what is being hashed
        return
    open_.add(id(value))
    if isinstance(value, np.ndarray) and value.dtype != object:
        hash_.update(f"{value.dtype.str}{value.shape}".encode() + np.ascontiguousarray(value).tobytes())
    elif isinstance(value, set | frozenset):
        hash_.update("".join(sorted(fingerprint(item) for item in value)).encode())
    else:
        for item in _content(value):
            _feed(hash_, item, open_)
    open_.discard(id(value))


def _content(value: Any) -> list[Any]:
    """What a value consists of, besides its type."""
    if isinstance(value, type):
        return _class_content(value)
    if isinstance(value, FunctionType):
        if _is_own(value.__module__):
            return []
        return [value.__code__, value.__defaults__, value.__kwdefaults__, _cells(value), vars(value)]
    if isinstance(value, CodeType):
        return [value.co_code, value.co_names, value.co_varnames, value.co_consts]
    if isinstance(value, MethodType):
        return [value.__func__, value.__self__]
    if isinstance(value, property):
        return [value.fget, value.fset]
    if isinstance(value, staticmethod | classmethod):
        return [value.__func__]
    if isinstance(value, cached_property):
        return [value.func]
    if isinstance(value, Mapping):
        return [item for pair in value.items() for item in pair]
    if isinstance(value, np.ndarray):
        return [value.shape, *value.ravel().tolist()]
    if isinstance(value, list | tuple):
        return [len(value), *value]
    if is_dataclass(value):
        return [{f.name: getattr(value, f.name) for f in fields(value)}]
    if not isinstance(value, BuiltinFunctionType):
        return _object_content(value)
    return []


def _class_content(kind: type) -> list[Any]:
    """The code and the attributes of a class from outside of slamkit and the standard library, bases included."""
    if _is_own(kind.__module__) or kind.__module__ == "builtins":
        return []
    attributes = {n: v for n, v in vars(kind).items() if n not in _BOOKKEEPING and not n.startswith("_abc_")}
    simple = {n: v for n, v in sorted(attributes.items()) if not isinstance(v, _MACHINERY)}
    return [*kind.__bases__, simple]


#: What Python itself adds to a class.
_BOOKKEEPING = {
    "__annotate_func__", "__annotations__", "__annotations_cache__", "__dict__", "__doc__", "__firstlineno__",
    "__module__", "__orig_bases__", "__parameters__", "__qualname__", "__static_attributes__", "__weakref__",
}  # fmt: skip


#: What Python adds to a class for its slots.
_MACHINERY = (MemberDescriptorType, GetSetDescriptorType)


def _object_content(value: Any) -> list[Any]:
    """The attributes of an object; of one without attributes (a partial, say), what it pickles."""
    if isinstance(python := getattr(value, "py_func", None), FunctionType):  # compiled by Numba
        return [python]
    kind = type(value)
    slots = [n for c in kind.__mro__ for n in _slots(c) if hasattr(value, n)]
    attributes = {n: getattr(value, n) for n in slots} | dict(getattr(value, "__dict__", {}))
    attributes = {n: v for n, v in attributes.items() if not isinstance(getattr(kind, n, None), cached_property)}
    if attributes:
        return [attributes]
    try:
        reduced = value.__reduce_ex__(4)
    except Exception:  # it cannot be pickled: its type is all that is known
        return []
    return list(reduced[1:3]) if isinstance(reduced, tuple) else [reduced]


def _slots(kind: type) -> tuple[str, ...]:
    slots = vars(kind).get("__slots__", ())
    return (slots,) if isinstance(slots, str) else tuple(s for s in slots if s not in ("__dict__", "__weakref__"))


def _cells(function: FunctionType) -> list[Any]:
    """The values of the variables that a function takes from the function around it."""
    values = []
    for cell in function.__closure__ or ():
        with suppress(ValueError):  # not assigned yet
            values.append(cell.cell_contents)
    return values


def _is_own(module: str | None) -> bool:
    return module is not None and (module == "slamkit" or module.startswith("slamkit."))
