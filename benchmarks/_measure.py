"""Measure a time, and write it."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def seconds(go: Callable[[], object]) -> float:
    """Time of one call [s], with the garbage collector off."""
    gc.collect()
    gc.disable()
    try:
        begin = time.perf_counter()
        go()
        return time.perf_counter() - begin
    finally:
        gc.enable()


def quartiles(values: Array) -> dict[str, float]:
    """Median and quartiles, as JSON values."""
    q1, median, q3 = np.percentile(values, [25, 50, 75]).tolist()
    return {"median": median, "q1": q1, "q3": q3}


def three_digits(value: float) -> str:
    """A number with three significant digits, but with all digits before the decimal point."""
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def spread(values: dict[str, float], scale: float = 1.0) -> str:
    """The median, with the quartiles in parentheses."""
    median, q1, q3 = (three_digits(scale * values[key]) for key in ("median", "q1", "q3"))
    return f"{median} ({q1} … {q3})"
