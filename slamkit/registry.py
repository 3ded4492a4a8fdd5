"""Lists of named items, one for each kind: filters, models, data sets, worlds. A user can add items."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Generic, TypeVar

from slamkit.errors import InputError

T = TypeVar("T")


class Registry(Mapping[str, T], Generic[T]):
    """Items of one kind by name, in the order in which they were registered.

    Parameters
    ----------
    kind : str
        What an item is called in a message, such as ``"filter"``.
    items : mapping name → item
        The built-in items.
    check : callable, optional
        ``check(item)`` raises an error if the item is not of this kind.

    Examples
    --------
    >>> filters = Registry("filter", {"ekf": object})
    >>> filters.register("mine", int)
    >>> list(filters)
    ['ekf', 'mine']
    >>> filters.register("mine", float)
    Traceback (most recent call last):
        ...
    slamkit.errors.InputError: there is a filter 'mine' already; replace=True replaces it
    >>> filters.register("mine", float, replace=True)
    >>> filters.unregister("mine")
    <class 'float'>
    >>> list(filters)
    ['ekf']
    """

    def __init__(self, kind: str, items: Mapping[str, T], check: Callable[[T], object] | None = None) -> None:
        self.kind = kind
        self._check = check
        self._items: dict[str, T] = dict(items)

    def __getitem__(self, name: str) -> T:
        return self._items[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._items)

    def __len__(self) -> int:
        return len(self._items)

    def register(self, name: str, item: T, *, replace: bool = False) -> None:
        """Add an item of your own.

        Parameters
        ----------
        name : str
            Its name, without a colon.
        item : object
            A class or function that was defined again (same module and qualified name, as when a notebook cell runs a
            second time) replaces its former definition.
        replace : bool
            True to replace whatever has this name. The new item takes the place of the old one in the order.

        Raises
        ------
        InputError
            The name is empty, has a colon or belongs to another item, or the item is not of this kind. The list is
            unchanged.
        """
        if not isinstance(name, str) or not name or ":" in name:
            raise InputError(f"the name of a {self.kind} is {name!r}, expected text without a colon")
        if not replace and name in self._items and not _same_definition(self._items[name], item):
            raise InputError(f"there is a {self.kind} {name!r} already; replace=True replaces it")
        if self._check is not None:
            self._check(item)
        self._items[name] = item

    def unregister(self, name: str) -> T:
        """Remove an item and return it.

        Raises
        ------
        InputError
            There is no item of this name.
        """
        if name not in self._items:
            raise InputError(f"there is no {self.kind} {name!r}, expected one of {', '.join(self)}")
        return self._items.pop(name)

    def find(self, name: str) -> T:
        """Return the item of this name. ``module:attribute`` imports it from a module of your own.

        The module may also be in the working directory.

        Raises
        ------
        InputError
            There is no such item, or it is not of this kind.
        """
        if name in self._items:
            return self._items[name]
        if ":" not in name:
            raise InputError(f"there is no {self.kind} {name!r}, expected one of {', '.join(self)} or module:attribute")
        module, _, attribute = name.partition(":")
        here = str(Path.cwd())
        if here not in sys.path:
            sys.path.append(here)
        try:
            item: T = getattr(importlib.import_module(module), attribute)
        except (ImportError, AttributeError, ValueError) as error:
            raise InputError(f"the {self.kind} {name!r} cannot be imported: {error}") from None
        if self._check is not None:
            self._check(item)
        return item


def _same_definition(old: object, new: object) -> bool:
    """Whether both are one object, or a class or function of one module and qualified name."""
    if old is new:
        return True
    names = [(getattr(o, "__module__", None), getattr(o, "__qualname__", None)) for o in (old, new)]
    return type(old) is type(new) and names[0] == names[1] and None not in names[0]
