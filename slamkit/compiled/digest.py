"""A digest of everything that a user's compiled function depends on: its own source, and all that it names."""

from __future__ import annotations

import hashlib
import sys
from enum import EnumType
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

#: Packages whose functions are known by name: their versions are part of every digest, or they cannot change.
KNOWN = frozenset(
    {"slamkit", "numpy", "scipy", "numba", "llvmlite", "math", "cmath", "builtins", *sys.builtin_module_names}
)


class Unkeyed(Exception):  # noqa: N818  (no error: it means that machine code is not kept)
    """Something that a function uses has no digest."""


def digest_of(function: Any, salt: str) -> str:
    """Digest of a :class:`~slamkit.compiled.Compiled` and of every function and constant that it uses, in any module.

    Raises
    ------
    Unkeyed
        It uses an object of which no digest can be made.
    """
    walk = _Walk(salt)
    walk.add(function)
    return walk.hash.hexdigest()[:16]


class _Walk:
    def __init__(self, salt: str) -> None:
        self.hash = hashlib.sha256(f"{salt} {np.__version__}".encode())
        #: Objects by their id, kept so that no other can take that id.
        self.seen: dict[int, Any] = {}

    def text(self, *words: object) -> None:
        for word in words:
            self.hash.update(repr(word).encode() + b"\0")

    def add(self, value: Any) -> None:
        """Take a value into the digest, with all that it refers to."""
        if isinstance(value, bool | int | float | complex | str | bytes | type(None) | type(Ellipsis)):
            self.text(type(value).__name__, value)
        elif isinstance(value, tuple | list | frozenset | set):
            self.text(type(value).__name__, len(value))
            for item in sorted(value, key=repr) if isinstance(value, frozenset | set) else value:
                self.add(item)
        elif isinstance(value, np.ndarray | np.generic):
            self.text(str(value.dtype), np.shape(value), np.asarray(value).tobytes())
        elif isinstance(value, CodeType):
            self._code(value)
        elif id(value) in self.seen:
            self.text("seen")
        else:
            self.seen[id(value)] = value
            self._object(value)

    def _object(self, value: Any) -> None:
        inner = getattr(value, "function", None) or getattr(value, "py_func", None)
        module = getattr(value, "__module__", None) or ""
        if isinstance(value, ModuleType):
            self.text("module", value.__name__)
        elif module.partition(".")[0] in KNOWN and getattr(value, "__name__", None):
            self.text("known", module, value.__name__)
        elif isinstance(value, FunctionType):
            self._function(value)
        elif isinstance(inner, FunctionType):
            self.text("compiled", getattr(value, "signature", ""), getattr(value, "targetoptions", ""))
            self._function(inner)
        elif hasattr(value, "sizes") and hasattr(value, "per_sighting"):
            self.text("own", sorted(value.sizes.items()), sorted(value.per_sighting.items()))
        elif isinstance(value, np.ufunc):
            self.text("ufunc", value.__name__)
        elif isinstance(value, EnumType):
            self.text("enum", value.__qualname__)
            members: dict[str, Any] = dict(value.__members__)
            self.add([(name, member.value) for name, member in members.items()])
        elif isinstance(value, type) and issubclass(value, tuple) and hasattr(value, "_fields"):
            self.text("fields", value.__qualname__, value._fields)
        else:
            raise Unkeyed(repr(value))

    def _function(self, function: FunctionType) -> None:
        self.text("function", function.__qualname__)
        self.add(function.__defaults__)
        self.add(sorted((function.__kwdefaults__ or {}).items()))
        self._code(function.__code__)
        for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
            self.text(name)
            self.add(cell.cell_contents)
        self._names(function.__code__, function.__globals__)

    def _names(self, code: CodeType, names: dict[str, Any]) -> None:
        for name in code.co_names:
            if name in names:
                self.text(name)
                self.add(names[name])
                self._attributes(code, names[name], set())
        for constant in code.co_consts:
            if isinstance(constant, CodeType):
                self._names(constant, names)

    def _attributes(self, code: CodeType, module: Any, walked: set[str]) -> None:
        """Of a module that a function names: all attributes that the function may read, in modules inside too."""
        if not isinstance(module, ModuleType) or module.__name__.partition(".")[0] in KNOWN:
            return
        walked.add(module.__name__)
        for name in code.co_names:
            value = getattr(module, name, None)
            if value is not None:
                self.text(name)
                self.add(value)
                if getattr(value, "__name__", None) not in walked:
                    self._attributes(code, value, walked)

    def _code(self, code: CodeType) -> None:
        self.text("code", code.co_code, code.co_names, code.co_varnames)
        for constant in code.co_consts:
            self.add(constant)
