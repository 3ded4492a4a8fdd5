"""Checks of stacks of vectors and matrices: the last axes are the vector or matrix, the leading axes are free."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from slamkit.arrays import Array, check_symmetric, finite_number, real_array
from slamkit.errors import InputError


def finite_stack(name: str, value: ArrayLike, axes: int) -> Array:
    """Copy `value` into an array of finite floats with at least `axes` axes, of which the last `axes` are not empty."""
    a = real_array(name, value)
    if a.ndim < axes or 0 in a.shape[a.ndim - axes :]:
        raise InputError(f"{name} has shape {a.shape}, expected at least {axes} axes that are not empty")
    if not np.all(np.isfinite(a)):
        index = np.argwhere(~np.isfinite(a))[0]
        raise InputError(f"{name} is not finite at {tuple(map(int, index))}: {a[tuple(index)]}")
    return a


def covariance_stack(name: str, value: ArrayLike, d: int) -> Array:
    """Copy `value` into finite symmetric matrices (..., d, d)."""
    a = finite_stack(name, value, 2)
    if a.shape[-2:] != (d, d):
        raise InputError(f"{name} has shape {a.shape}, vectors of {d} components need (..., {d}, {d})")
    check_symmetric(name, a)
    return a


def common_shape(a_name: str, a: tuple[int, ...], b_name: str, b: tuple[int, ...]) -> tuple[int, ...]:
    """The shape to which the leading axes `a` and `b` broadcast."""
    try:
        return np.broadcast_shapes(a, b)
    except ValueError:
        raise InputError(f"{a_name} has leading axes {a} and {b_name} {b}: they do not broadcast") from None


def degrees_of_freedom(dof: ArrayLike) -> Array:
    """Copy `dof` into finite floats ≥ 0 of any shape."""
    d = finite_stack("dof", dof, 0)
    if np.any(d < 0):
        raise InputError(f"dof is {d.min()}, expected at least 0")
    return d


def squares_by_run(values: ArrayLike) -> Array:
    """Copy normalised squares (M, ...) of M runs into an array (M, steps)."""
    v = finite_stack("values", values, 0)
    if not v.ndim or not v.size:
        raise InputError(f"values have shape {v.shape}: there is no run, or no step")
    if np.any(v < 0):
        raise InputError(f"values hold {v.min()}, a square cannot be negative")
    return v.reshape(len(v), -1)


def standard_error(per_run: Array) -> Array:
    """s/√M over the first axis, with s the sample standard deviation of M runs; NaN for M = 1."""
    M = len(per_run)
    return np.asarray(np.std(per_run, axis=0, ddof=1) / np.sqrt(M) if M > 1 else np.full(per_run.shape[1:], np.nan))


def check_probability(probability: float) -> float:
    """Return `probability` if it lies strictly between 0 and 1."""
    p = finite_number("probability", probability, above=0.0)
    if not p < 1:
        raise InputError(f"probability is {probability}, expected a number between 0 and 1, both excluded")
    return p
