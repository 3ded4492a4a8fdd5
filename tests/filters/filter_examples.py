"""Filters that the tests of this room are tried on."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
from family import ALL, FILTERS, MOTIONS, ORDERS, P0, SENSORS, PlainMotion, PlainSensor, drive

from slamkit import InputError, Storage

POSE = (0.3, -0.2, 3.0)
every_filter = pytest.mark.parametrize("name", FILTERS)
all_filters = pytest.mark.parametrize("name", ALL)
every_order = pytest.mark.parametrize("order", ORDERS)
every_motion = pytest.mark.parametrize("motion", MOTIONS)
every_sensor = pytest.mark.parametrize("sensor", SENSORS)
#: The belief as it is by default, and with everything out of sight at rest.
every_storage = pytest.mark.parametrize("storage", [Storage(), Storage(compress_above=0)], ids=["plain", "compressed"])
every_form = pytest.mark.parametrize("form", ["compiled", "python"])


def make(name: str, motion: Any = "unicycle", sensor: Any = "range-bearing", **options: Any) -> Any:
    m = MOTIONS[motion] if isinstance(motion, str) else motion
    s = SENSORS[sensor] if isinstance(sensor, str) else sensor
    return ALL[name](m, s, POSE, P0, **options)


def made_of(form: str, motion: Any, sensor: Any) -> tuple[Any, Any]:
    """Both models compiled, or as a user writes them in Python."""
    return (motion, sensor) if form == "compiled" else (PlainMotion(motion), PlainSensor(sensor))


def grown(name: str, **options: Any) -> Any:
    f = make(name, **options)
    f.run(drive(f.motion, f.sensor))
    return f


def same(a: Any, b: Any) -> bool:
    return (
        np.array_equal(a.x, b.x)
        and np.array_equal(a.P, b.P)
        and a.landmark_ids == b.landmark_ids
        and np.array_equal(a.y, b.y)
        and np.array_equal(a.S, b.S)
        and np.array_equal(a.K, b.K)
        and np.array_equal(a.F, b.F)
        and np.array_equal(a.Q, b.Q)
        and a.log_likelihood == b.log_likelihood
    )


def untouched(f: Any, act: Any, *errors: type[Exception]) -> None:
    """The act raises, and the filter is what it was.

    In a compressed belief a refused step may have made landmarks active: the same numbers, formed in another order.
    """
    before = copy.deepcopy(f)
    with pytest.raises(errors or InputError) as caught:
        act()
    assert str(caught.value)
    if not f._belief.compressed:
        assert same(before, f)
        return
    assert before.landmark_ids == f.landmark_ids
    for name in ("x", "y", "S", "z", "F", "Q", "P", "K"):
        a, b = getattr(before, name), getattr(f, name)
        np.testing.assert_allclose(b, a, rtol=0, atol=1e-13 * max(1.0, np.abs(a).max(initial=0.0)), err_msg=name)
