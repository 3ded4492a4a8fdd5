"""One list of named things a kind: filters, models, data sets, worlds. A user's own can be added."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Generic, TypeVar

from slamkit.errors import InputError

T = TypeVar("T")


class Registry(Mapping[str, T], Generic[T]):
    """Things of one kind by name, in the order in which they were listed.

    Parameters
    ----------
    kind : str
        What one of them is called in a message, such as ``"filter"``.
    items : mapping name → item
        The built-in ones: the one list of them.
    check : callable, optional
        ``check(item)`` raises an error where the item is none of the kind.

    Examples
    --------
    >>> filters = Registry("filter", {"ekf": object})
    >>> filters.register("mine", int)
    >>> list(filters)
    ['ekf', 'mine']
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

    def register(self, name: str, item: T) -> None:
        """Add an item of your own.

        Raises
        ------
        InputError
            The name is empty, holds a colon or belongs to another item, or the item is none of the kind.
        """
        if not isinstance(name, str) or not name or ":" in name:
            raise InputError(f"the name of a {self.kind} is {name!r}, expected text without a colon")
        if self._items.get(name, item) is not item:
            raise InputError(f"there is a {self.kind} {name!r} already")
        if self._check is not None:
            self._check(item)
        self._items[name] = item

    def find(self, name: str) -> T:
        """The item of that name; ``module:attribute`` imports it from a module of your own.

        The module is looked for in the working directory too.

        Raises
        ------
        InputError
            There is no such item, or it is none of the kind.
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
