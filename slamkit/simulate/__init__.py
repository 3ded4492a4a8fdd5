"""Simulated runs: a :class:`World` and a random generator give a :class:`slamkit.Log` with its truth."""

from slamkit.simulate.simulate import simulate
from slamkit.simulate.world import World
from slamkit.simulate.worlds import WORLDS, lesson_world, loop_world, random_world, ring_world, standing_world

__all__ = [
    "WORLDS",
    "World",
    "lesson_world",
    "loop_world",
    "random_world",
    "ring_world",
    "simulate",
    "standing_world",
]
