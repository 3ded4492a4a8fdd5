"""The check that arrays from outside go through."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slamkit.errors import InputError

Array = NDArray[np.float64]


def finite_array(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    """A copy of `value` as a finite float array of that shape, -1 standing for any length.

    Raises
    ------
    InputError
        It is no array of numbers, has another shape, or holds a value that is not finite; the message names it.
    """
    try:
        a = np.array(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} must be numbers: {error}") from None
    if a.ndim != len(shape) or any(n not in (-1, m) for n, m in zip(shape, a.shape, strict=True)):
        wanted = str(tuple("n" if n == -1 else n for n in shape)).replace("'", "")
        raise InputError(f"{name} has shape {a.shape}, expected {wanted}")
    bad = np.argwhere(~np.isfinite(a))
    if len(bad):
        where = f" at row {bad[0][0]}" if a.ndim else ""
        raise InputError(f"{name} is not finite{where}: {a[tuple(bad[0])]}")
    return a
