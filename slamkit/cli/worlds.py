"""Worlds by name, including those of a user's own module."""

from __future__ import annotations

from typing import Any

from slamkit.errors import InputError
from slamkit.simulate import WORLDS, World

__all__ = ["find_world"]


def find_world(text: str) -> World:
    """The world of this name; ``module:attribute`` names a World, or a function that returns one.

    Raises
    ------
    InputError
        There is no such world, or it is not a World.
    """
    item: Any = WORLDS.find(text)
    if isinstance(item, World):
        return item
    try:
        world = item()
    except TypeError as error:
        raise InputError(f"the world {text} cannot be made without arguments: {error}") from error
    if not isinstance(world, World):
        raise InputError(f"the world {text} is a {type(world).__name__}, expected a slamkit.World")
    return world
