"""Laws of the lists of named items."""

from __future__ import annotations

import math
from typing import Any

import pytest

from slamkit import InputError
from slamkit.datasets import DATASETS
from slamkit.filters import FILTERS
from slamkit.models import MOTIONS, SENSORS
from slamkit.registry import Registry
from slamkit.simulate import WORLDS

LISTS: dict[str, Registry[Any]] = {
    "filters": FILTERS,
    "motions": MOTIONS,
    "sensors": SENSORS,
    "worlds": WORLDS,
    "data sets": DATASETS,
}


def numbers() -> Registry[Any]:
    return Registry("number", {"one": 1, "two": 2}, check=math.isfinite)


def cell(value: int) -> Any:
    """What a notebook cell defines each time it is run."""

    class Mine:
        """A class of one module and qualified name, whatever its contents."""

        number = value

    return Mine


def function_cell(value: int) -> Any:
    def mine() -> int:
        return value

    return mine


@pytest.mark.parametrize("registry", LISTS.values(), ids=LISTS)
def test_what_is_removed_is_gone_and_can_be_added_again(registry: Registry[Any]) -> None:
    before = dict(registry)
    last = list(before)[-1]
    item = registry.unregister(last)
    try:
        assert item is before[last] and last not in registry and len(registry) == len(before) - 1
        with pytest.raises(InputError, match=f"there is no {registry.kind} {last!r}"):
            registry.unregister(last)
    finally:
        registry.register(last, item)
    assert list(registry.items()) == list(before.items())


@pytest.mark.parametrize("registry", LISTS.values(), ids=LISTS)
def test_a_name_is_not_given_to_another_item_unless_asked(registry: Registry[Any]) -> None:
    first, *others = before = dict(registry)
    other = type("Other", (before[first],), {}) if isinstance(before[first], type) else None
    with pytest.raises(InputError, match=f"there is a {registry.kind} {first!r} already; replace=True replaces it"):
        registry.register(first, other)
    assert dict(registry) == before
    if other is not None:
        registry.register(first, other, replace=True)
        assert registry[first] is other and list(registry) == [first, *others]
        registry.register(first, before[first], replace=True)
    assert list(registry.items()) == list(before.items())


@pytest.mark.parametrize("define", [cell, function_cell])
def test_running_a_notebook_cell_again_replaces_what_it_defined(define: Any) -> None:
    registry: Registry[Any] = Registry("thing", {"first": object})
    registry.register("mine", define(1))
    registry.register("last", object)
    again = define(2)
    registry.register("mine", again)
    assert registry["mine"] is again and list(registry) == ["first", "mine", "last"]
    with pytest.raises(InputError, match="there is a thing 'mine' already"):
        registry.register("mine", type("Another", (), {}))


def test_equal_values_are_not_one_definition() -> None:
    """Instances and plain values have no definition of their own to be run again."""
    registry = numbers()
    registry.register("one", 1)
    with pytest.raises(InputError, match="already"):
        registry.register("one", 3)
    kind = cell(1)
    things: Registry[Any] = Registry("thing", {"a": kind()})
    with pytest.raises(InputError, match="already"):
        things.register("a", kind())
    with pytest.raises(InputError, match="already"):
        things.register("a", kind)


@pytest.mark.parametrize("name", ["", "a:b", 3, None])
def test_a_name_is_text_without_a_colon(name: Any) -> None:
    registry = numbers()
    with pytest.raises(InputError, match="expected text without a colon"):
        registry.register(name, 3, replace=True)
    assert list(registry) == ["one", "two"]


@pytest.mark.parametrize("replace", [True, False])
def test_what_is_not_of_the_kind_changes_nothing(replace: bool) -> None:
    registry = numbers()
    with pytest.raises(TypeError):
        registry.register("one" if replace else "three", "3", replace=replace)
    assert dict(registry) == {"one": 1, "two": 2}
