"""Fingerprints of settings: equal for equal content, different for any change."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_study import world

import slamkit
from slamkit import EKFSLAM
from slamkit.cycle.standard import sensor as standard_sensor
from slamkit.models import RelativePosition, Unicycle
from slamkit.study.fingerprint import fingerprint


def test_every_part_of_a_world_counts_for_its_fingerprint() -> None:
    base = world()
    changes: dict[str, Any] = {
        "name": "other", "landmarks": {**base.landmarks, "L0": np.ones(2)}, "motion": Unicycle(0.05, 0.051),
        "sensor": RelativePosition(0.2), "controls": base.controls[1:], "dt": 0.5, "pose": np.ones(3),
        "pose_covariance": np.eye(3), "max_range": 9.0, "min_range": 0.1, "field_of_view": 1.0,
        "detection_probability": 0.5, "odometry": True, "increments": True,
    }  # fmt: skip
    assert set(changes) == {f.name for f in fields(base)}
    digests = [fingerprint(replace(base, **{name: value})) for name, value in changes.items()]
    assert len({fingerprint(base), *digests}) == 1 + len(digests)
    assert fingerprint(world()) == fingerprint(base)


def gated(gate: float) -> Any:
    return lambda *arguments, **options: EKFSLAM(*arguments, gate=gate, **options)


def with_attribute(way: str) -> type:
    return type("Own", (EKFSLAM,), {"way": way, "__module__": "elsewhere", "__qualname__": "Own"})


def with_code(number: int) -> type:
    scope: dict[str, Any] = {"EKFSLAM": EKFSLAM, "__name__": "elsewhere"}
    exec(f"class Own(EKFSLAM):\n    def extra(self):\n        return {number}", scope)
    kind: type = scope["Own"]
    return kind


class Slotted:
    __slots__ = ("value",)

    def __init__(self, value: int) -> None:
        self.value = value


@pytest.mark.parametrize(
    ("make", "a", "b"),
    [
        (lambda gate: partial(EKFSLAM, gate=gate), 0.99, 0.999),
        (gated, 0.99, 0.999),
        (with_attribute, "left", "right"),
        (with_code, 1, 2),
        (Slotted, 1, 2),
        (lambda n: {n}, 1, 2),
        (lambda n: {"storage": frozenset((n, "x"))}, 1, 2),
        (lambda n: np.array([n, None], dtype=object), 1, 2),
        (lambda n: [1] * n, 1, 2),
        (lambda n: n, 1, True),
        (lambda n: {"gate": n}, 1, 1.0),
    ],
)
def test_the_content_counts_and_nothing_else(make: Callable[[Any], Any], a: Any, b: Any) -> None:
    assert fingerprint(make(a)) == fingerprint(make(a)) != fingerprint(make(b))


def test_a_fingerprint_is_the_same_in_every_process() -> None:
    program = (
        "from functools import partial; from slamkit import EKFSLAM\n"
        "from slamkit.study.fingerprint import fingerprint\n"
        "def f(x, y={'a': {'b', 'c'}}): return x in ('p', 'q')\n"
        "print(fingerprint([f, partial(EKFSLAM, gate=0.9), {'x', 'y', 'z'}]))"
    )
    path = str(Path(slamkit.__file__).parents[1])
    said = {
        subprocess.run(
            [sys.executable, "-c", program], capture_output=True, text=True, check=True,
            env={**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": path},
        ).stdout
        for seed in ("1", "2")
    }  # fmt: skip
    assert len(said) == 1


def test_using_a_compiled_function_does_not_change_its_fingerprint() -> None:
    before = fingerprint(standard_sensor)
    _ = standard_sensor.plain
    assert fingerprint(standard_sensor) == before


def test_an_object_that_refers_to_itself_has_a_fingerprint() -> None:
    loop: list[Any] = [1]
    loop.append(loop)
    assert fingerprint(loop)
