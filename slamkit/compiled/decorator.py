"""The one decorator that makes functions compile at their first call. Nothing here imports Numba."""

from __future__ import annotations

import dis
import importlib
import sys
from collections.abc import Callable, Sequence
from functools import cached_property
from types import FunctionType
from typing import Any

from slamkit.compiled.cache import compile_cached, load_numba_types
from slamkit.compiled.tables import OwnFields

__all__ = ["Compiled", "MachineCode", "compiled", "intrinsics", "needed", "rows_of"]


class Compiled:
    """A function that compiles itself at its first call.

    ``f(...)`` runs the machine code; ``f.plain(...)`` runs the same source in Python over compiled primitives.

    Parameters
    ----------
    function : callable
        Written in the part of Python that Numba compiles. It may call other `Compiled` functions by name.
    signature : str
        Its type in words, for example ``"void(state, vector, real)"``: ``void``, ``real``, ``index``, ``flag``,
        ``vector``, ``matrix``, ``cube``, ``integers``, ``flags``, or the name of a table.
    generic : bool
        True: it calls functions of models or filters, so its Python form calls the Python forms of what it uses.
    """

    def __init__(self, function: FunctionType, signature: str, *, generic: bool = False) -> None:
        self.function, self.signature, self.generic = function, signature, generic
        self.__doc__, self.__name__ = function.__doc__, function.__name__
        self.__module__ = function.__module__ or "__main__"  # code that `exec` runs may be of no module

    @cached_property
    def uses(self) -> dict[str, Compiled | OwnFields]:
        """The compiled functions and the own fields that it names."""
        f = self.function
        # Names of attributes, which `co_names` holds too, are none of these.
        names = {i.argval for i in dis.get_instructions(f.__code__) if i.opname == "LOAD_GLOBAL"}
        return {n: v for n in sorted(names) if isinstance(v := f.__globals__.get(n), Compiled | OwnFields)}

    def _over(self, choose: Callable[[Any], Any]) -> FunctionType:
        """The function over the same globals, with every `Compiled` among them replaced."""
        f, chosen = self.function, {name: choose(used) for name, used in self.uses.items()}
        copy = FunctionType(f.__code__, {**f.__globals__, **chosen}, f.__name__, f.__defaults__, f.__closure__)
        copy.__module__, copy.__qualname__ = f.__module__, f.__qualname__
        return copy

    @cached_property
    def jitted(self) -> Any:
        """Numba's dispatcher, for Python and for other compiled functions: compiled now or read from the cache."""
        return compile_cached(self, self._source)

    @cached_property
    def in_table(self) -> Any:
        """The same for a table, whose functions take arrays as an address and extents."""
        return compile_cached(self, self._source, in_table=True)

    def _source(self) -> FunctionType:
        return self._over(lambda used: used.jitted)

    @cached_property
    def plain(self) -> Callable[..., Any]:
        """The same source in Python."""
        return self._over(lambda used: used.plain if used.generic or isinstance(used, OwnFields) else used)

    def __call__(self, *args: Any) -> Any:
        return self.jitted(*args)

    def __reduce__(self) -> tuple[Any, ...]:
        module = self.function.__module__
        if module == "__main__" or getattr(sys.modules.get(module), self.function.__qualname__, None) is not self:
            return Compiled._again, (self.function, self.signature, self.generic)
        return _find, (module, self.function.__qualname__)

    def __deepcopy__(self, memo: dict[int, Any]) -> Compiled:
        return self

    @classmethod
    def _again(cls, function: FunctionType, signature: str, generic: bool) -> Compiled:
        return cls(function, signature, generic=generic)


#: A function, and the attribute that is its machine code: "jitted" or "in_table".
MachineCode = tuple[Compiled, str]


class Intrinsic(Compiled):
    """A function of a module that imports Numba, by name, for compiled functions to call.

    Python calls `plain`, its specification.
    """

    def __init__(self, module: str, name: str, plain: Callable[..., Any] | None = None) -> None:
        self.__module__, self.__name__, self.generic = module, name, False
        if plain is not None:
            self.plain = plain

    @cached_property
    def jitted(self) -> Any:
        """What Numba puts in the place of a call."""
        load_numba_types()
        return getattr(importlib.import_module(self.__module__), self.__name__)

    def __call__(self, *args: Any) -> Any:
        return self.plain(*args)

    def __reduce__(self) -> tuple[Any, ...]:
        return Intrinsic, (self.__module__, self.__name__, vars(self).get("plain"))


def intrinsics(module: str, *names: str) -> list[Intrinsic]:
    """Functions of a module of this package that is not to be imported before the first call."""
    return [Intrinsic(f"slamkit.compiled.{module}", name) for name in names]


def _slice(array: Any, first: int, count: int) -> Any:
    return array[first : first + count]


#: ``rows_of(array, first, count)`` is ``array[first : first + count]`` without Numba's care for where an array ends.
rows_of = Intrinsic("slamkit.compiled.numba_types", "rows_of", _slice)


def _find(module: str, name: str) -> Any:
    return getattr(importlib.import_module(module), name)


def compiled(signature: str, *, generic: bool = False) -> Callable[[Callable[..., Any]], Compiled]:
    """Decorate a function so that it compiles at its first call; see :class:`Compiled`."""

    def decorate(function: Callable[..., Any]) -> Compiled:
        assert isinstance(function, FunctionType)
        return Compiled(function, signature, generic=generic)

    return decorate


def needed(functions: Sequence[Compiled]) -> list[Compiled]:
    """These, and what they call as machine code where they run as Python: every function that Python may call."""
    found, generic = dict.fromkeys(functions), [f for f in functions if f.generic]
    for f in generic:
        for used in f.uses.values():
            if isinstance(used, OwnFields | Intrinsic):
                continue
            if used.generic and used not in generic:
                generic.append(used)
            elif not used.generic:
                found[used] = None
    return list(found)
