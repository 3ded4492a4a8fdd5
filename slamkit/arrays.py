"""Types of arrays, and the checks that numbers from outside go through.

Every check returns a new, writable, C-contiguous array in the machine's byte order. Compiled functions need such
arrays, and the caller's array stays untouched.
"""

from __future__ import annotations

from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slamkit.errors import InputError

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_SYMMETRY = 1e-9  # largest difference between a covariance and its transpose, over the largest entry
_NEGATIVE = 1e-10  # largest negative eigenvalue that counts as rounding, over the largest entry


def real_array(name: str, value: Any) -> Array:
    """Copy `value` into a float array of the same shape; entries may be NaN or infinite.

    Parameters
    ----------
    name : str
        What the value is called in an error message.
    value : array_like
        Real numbers in rows of equal length. Read-only, big-endian and unaligned arrays are fine.

    Returns
    -------
    ndarray of float64
        A writable, C-contiguous copy.

    Raises
    ------
    InputError
        `value` holds something other than real numbers (complex numbers, text, dates, masked entries, other objects),
        a number beyond the range of a double, or rows of different lengths.
    """
    if type(value) is np.ndarray and value.dtype == np.float64:
        return np.array(value, dtype=np.float64, order="C")
    rows = value if isinstance(value, list | tuple) else [value]
    try:
        if any(isinstance(row, np.ma.MaskedArray) and np.ma.is_masked(row) for row in rows):
            raise TypeError("some entries are masked")
        given = np.asarray(value)
        if given.dtype.kind == "O":
            for entry in given.flat:
                if not isinstance(entry, Real):
                    raise TypeError(f"{_shown(entry)} is not a real number")
        elif given.dtype.kind not in "biuf":
            raise TypeError(f"values of dtype {given.dtype} are not real numbers")
        return np.array(given, dtype=np.float64, order="C")
    # An object may raise nearly anything while NumPy reads it as an array.
    except Exception as error:
        raise InputError(f"{name} must be numbers, given {type(value).__name__}: {error}") from None


def finite_array(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Copy `value` into an array of finite floats with the given shape.

    Parameters
    ----------
    name : str
        What the value is called in an error message.
    value : array_like
        Real numbers, as for :func:`real_array`.
    shape : tuple of int
        The expected shape; -1 allows any length.

    Returns
    -------
    ndarray of float64
        A writable, C-contiguous copy.

    Raises
    ------
    InputError
        `value` is not an array of real numbers, has another shape, or holds NaN or an infinity.
    """
    a = real_array(name, value)
    _check_shape(name, a.shape, shape)
    if not np.isfinite(a).all():
        bad = np.argwhere(~np.isfinite(a))[0]
        where = f" at row {bad[0]}" if a.ndim else ""
        raise InputError(f"{name} is not finite{where}: {a[tuple(bad)]}")
    return a


def finite_number(
    name: str, value: Any, *, above: float = -np.inf, lower: float = -np.inf, upper: float = np.inf, unit: str = ""
) -> float:
    """Return `value` as a finite float.

    Parameters
    ----------
    name : str
        What the value is called in an error message.
    value : number
        A real number, or an array of no dimensions that holds one. A bool is not a number here.
    above, lower, upper : float
        Bounds: above < value, lower ≤ value ≤ upper.
    unit : str
        Unit in an error message, such as ``"seconds"``.

    Raises
    ------
    InputError
        `value` is not a real number, is beyond the range of a double, is not finite, or is out of bounds.
    """
    of = f" of {unit}" if unit else ""
    is_bool = isinstance(value, bool | np.bool_) or getattr(value, "dtype", None) == np.bool_
    try:
        number = np.nan if is_bool else float(finite_array(name, value, ()))
    except InputError:
        number = np.nan
    if not (np.isfinite(number) and number > above and lower <= number <= upper):
        bounds = [f"> {above:g}"] if above > -np.inf else []
        bounds += [f"≥ {lower:g}"] if lower > -np.inf else []
        bounds += [f"≤ {upper:g}"] if upper < np.inf else []
        raise InputError(f"{name} is {_shown(value)}, expected a finite number{of} {' and '.join(bounds)}".rstrip())
    return number


def covariance(name: str, value: ArrayLike, size: int | None = None, *, definite: bool = False) -> Array:
    """Copy `value` into a symmetric positive semidefinite matrix.

    Parameters
    ----------
    name : str
        What the value is called in an error message.
    value : array_like (n, n)
        May differ from its transpose by 1e-9 of its largest entry; the result is exactly symmetric.
    size : int, optional
        The expected n; by default any.
    definite : bool
        Demand that all eigenvalues are positive. By default eigenvalues of zero are fine, and so is a negative one
        that rounding explains: down to -1e-10 times the largest entry.

    Returns
    -------
    ndarray (n, n) of float64
        A writable, C-contiguous copy.

    Raises
    ------
    InputError
        `value` is not an array of finite numbers, has another shape, is not symmetric, or has an eigenvalue that is
        too small.
    """
    a = real_array(name, value)
    n = size if size is not None else (a.shape[0] if a.ndim else -1)
    a = finite_array(name, a, (n, n))
    check_symmetric(name, a)
    a = np.where(a == a.T, a, a / 2 + a.T / 2)
    scale = float(np.abs(a).max(initial=0.0))
    smallest = float(np.linalg.eigvalsh(a)[0]) if len(a) else 0.0
    if not smallest >= -_NEGATIVE * scale or (definite and len(a) and smallest <= 0):
        kind = "positive definite" if definite else "positive semidefinite"
        raise InputError(f"{name} is not {kind}: its smallest eigenvalue is {smallest:.3g}")
    return a


def check_symmetric(name: str, matrices: Array) -> None:
    """Check that a matrix (n, n), or every matrix of a stack (..., n, n), equals its transpose up to rounding.

    Raises
    ------
    InputError
        A matrix differs from its transpose by more than 1e-9 of its largest entry.
    """
    with np.errstate(over="ignore"):
        difference = np.abs(matrices - matrices.mT).max(axis=(-2, -1), initial=0.0)
    bad = np.argwhere(difference > _SYMMETRY * np.abs(matrices).max(axis=(-2, -1), initial=0.0))
    if len(bad):
        at = tuple(map(int, bad[0]))
        where = f" at {at}" if at else ""
        raise InputError(f"{name} is not symmetric{where}: it differs from its transpose by {difference[at]:.3g}")


def index_array(name: str, value: ArrayLike, shape: tuple[int, ...], count: int, *, lowest: int = 0) -> Indices:
    """Copy `value` into an array of row numbers.

    Parameters
    ----------
    name : str
        What the value is called in an error message.
    value : array_like of int
        Row numbers; an empty array may have any dtype.
    shape : tuple of int
        The expected shape; -1 allows any length.
    count : int
        Number of rows: every entry is less.
    lowest : int
        The least entry that is allowed.

    Raises
    ------
    InputError
        `value` has another shape, holds something other than integers, or an entry out of range.
    """
    try:
        a = np.asarray(value)
    # An object may raise nearly anything while NumPy reads it as an array.
    except Exception as error:
        raise InputError(f"{name} must be integers, given {type(value).__name__}: {error}") from None
    _check_shape(name, a.shape, shape)
    if np.ma.is_masked(value):
        raise InputError(f"{name} has masked entries, expected integers")
    if a.size and not np.issubdtype(a.dtype, np.integer):
        raise InputError(f"{name} has dtype {a.dtype}, expected integers")
    if a.size and (a.min() < lowest or a.max() >= count):
        raise InputError(f"{name} runs from {a.min()} to {a.max()}, expected {lowest} to {count - 1}")
    return np.array(a, dtype=np.int64, order="C")


def _check_shape(name: str, given: tuple[int, ...], expected: tuple[int, ...]) -> None:
    if len(given) != len(expected) or any(n not in (-1, m) for n, m in zip(expected, given, strict=True)):
        letters = iter("nmklp")
        wanted = str(tuple(next(letters) if n == -1 else n for n in expected)).replace("'", "")
        raise InputError(f"{name} has shape {given}, expected {wanted}")


def _shown(value: Any) -> str:
    """`value` for an error message, cut where it is long; Python refuses to print an integer of many digits."""
    if isinstance(value, int) and not isinstance(value, bool) and value.bit_length() > 1024:
        return f"an integer of {value.bit_length()} bits"
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."
