"""Assigning to an attribute of a filter takes effect at once, or raises."""

from __future__ import annotations

import difflib
from collections.abc import Callable
from functools import wraps
from typing import Any, ClassVar, TypeVar

from slamkit.errors import AssignmentError


class Sealed(type):
    """Metaclass: an object takes no new attributes once its constructor is through."""

    def __call__(cls, *arguments: Any, **options: Any) -> Any:
        """Make an object and seal it."""
        new = super().__call__(*arguments, **options)
        vars(new)["_sealed"] = True
        return new


class Assignable(metaclass=Sealed):
    """What may be assigned: a property with a setter, what a constructor has set, or a value of a user's class body."""

    #: Set by a constructor, and without effect if it were assigned later.
    fixed_attributes: ClassVar[tuple[str, ...]] = ()

    def __setattr__(self, name: str, value: Any) -> None:
        kind = type(self)
        held = getattr(kind, name, None)
        if not name.startswith("_") and "_sealed" in vars(self):
            fixed = {fixed for base in kind.__mro__ for fixed in vars(base).get("fixed_attributes", ())}
            if isinstance(held, property):
                if held.fset is None:
                    raise AssignmentError(f"{name} of a {kind.__name__} is read-only")
            elif name in fixed:
                raise AssignmentError(f"{name} of a {kind.__name__} is chosen when it is made; make a new filter")
            elif name not in vars(self) and not _is_value(held):
                near = difflib.get_close_matches(name, [n for n in dir(kind) if not n.startswith("_")], 1)
                hint = f"; did you mean {near[0]}?" if near else ""
                raise AssignmentError(f"a {kind.__name__} has no attribute {name!r}{hint}")
        object.__setattr__(self, name, value)


def _is_value(held: Any) -> bool:
    """Whether what a class holds is a plain value, which an object may have another of."""
    return held is not None and not callable(held) and not hasattr(held, "__get__")


F = TypeVar("F", bound=Callable[..., Any])


def locked(method: F) -> F:
    """Decorate a method that reads or changes the belief: threads take turns with one filter."""

    @wraps(method)
    def alone(self: Any, *arguments: Any, **options: Any) -> Any:
        with self._lock:
            return method(self, *arguments, **options)

    return alone  # type: ignore[return-value]
