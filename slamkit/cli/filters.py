"""Filters by name, including those of a user's own module."""

from __future__ import annotations

from typing import Any

from slamkit.errors import InputError
from slamkit.filters import FILTERS

__all__ = ["find_filter", "find_filters"]


def find_filter(text: str) -> tuple[str, Any]:
    """The name to show and the class of a filter: a registered name, or ``module:Class``.

    A class of a user's own is shown under its attribute `name`. A class that only inherits a `name`, or has that of
    another filter, is shown under the name of the class.

    Raises
    ------
    InputError
        There is no such filter, or it is not a filter class.
    """
    kind = FILTERS.find(text)
    if text in FILTERS:
        return text, kind
    own = vars(kind).get("name")
    name = own if isinstance(own, str) and FILTERS.get(own, kind) is kind else text.rpartition(":")[2]
    if kind.name != name:
        kind.name = name  # histories, tables and figures take the name from here
    return name, kind


def find_filters(text: str) -> dict[str, Any]:
    """Filters by the name to show: names between commas, or ``all`` for every registered filter.

    Raises
    ------
    InputError
        No filter is named, one is unknown, or two have the same name.
    """
    names = list(FILTERS) if text == "all" else [name.strip() for name in text.split(",") if name.strip()]
    if not names:
        raise InputError(f"--filters is {text!r}, expected at least one filter out of {', '.join(FILTERS)}")
    chosen: dict[str, Any] = {}
    for name, kind in map(find_filter, names):
        if name in chosen:
            raise InputError(f"--filters is {text!r}, which names the filter {name} twice")
        chosen[name] = kind
    return chosen
