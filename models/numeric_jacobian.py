"""A numeric Jacobian, for tests and for models without an analytic one."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slamkit.arrays import Array, real_array
from slamkit.errors import InputError

EPSILON = float(np.finfo(float).eps)
SHRINK = 1.6  #: ratio of one step to the next; not 2, because a periodic function could meet all steps in phase
LEVELS, ORDERS = 16, 6  #: how many steps are tried, and how many powers of the step are removed

Function = Callable[[Array], ArrayLike]
Difference = Callable[[Array, Array], ArrayLike]


def numeric_jacobian(
    f: Function, x: ArrayLike, *, step: ArrayLike | None = None, difference: Difference | None = None
) -> Array:
    """Jacobian by central differences, extrapolated to step zero.

    Up to sixteen steps are tried, each 1.6 times shorter than the one before. They fill a tableau of extrapolated
    differences, and every entry of the Jacobian is taken where its own error estimate is smallest. For smooth functions
    of order one the error is about 1e-12. A step at which f is not finite is skipped, so x may be close to the edge of
    f's domain.

    Parameters
    ----------
    f : callable
        From an array (n,) to an array (k,).
    x : array_like (n,)
        The point, in the units of f's argument.
    step : array_like () or (n,), optional
        Longest step of each coordinate; by default 0.1, or 1e-5·\\|x\\| if that is more.
    difference : callable, optional
        ``difference(f(x + h), f(x - h))`` (k,) replaces the plain difference. Give it if f returns angles: a sensor
        model's `residual`, for example.

    Returns
    -------
    ndarray (k, n)
        ∂f/∂x; NaN if f was finite at too few steps.

    Raises
    ------
    InputError
        x is not a finite vector, a step is not positive, or f does not return a vector.

    References
    ----------
    Ridders, Advances in Engineering Software 4(2):75-76 (1982).

    Examples
    --------
    >>> import numpy as np
    >>> from slamkit.models import numeric_jacobian
    >>> numeric_jacobian(lambda x: np.array([x[0] * x[1], np.sin(x[1])]), [2.0, 0.0]).round(9)
    array([[0., 2.],
           [0., 1.]])
    """
    x = real_array("x", x)
    if x.ndim != 1 or not np.all(np.isfinite(x)):
        raise InputError(f"x is {x}, expected a finite vector")
    steps = np.maximum(0.1, 1e-5 * np.abs(x)) if step is None else real_array("step", step)
    if steps.shape not in ((), x.shape) or not np.all(np.isfinite(steps) & (steps > 0)):
        raise InputError(f"step is {steps}, expected one number > 0 or {len(x)} of them")
    steps = np.broadcast_to(steps, x.shape)
    if len(x) == 0:
        return np.empty((len(np.atleast_1d(f(x))), 0))
    with np.errstate(all="ignore"):
        return _extrapolate(f, x, steps, difference)


def _extrapolate(f: Function, x: Array, steps: Array, difference: Difference | None) -> Array:
    """The limit (k, n) of the quotients at shrinking steps: even powers of the step are removed one by one."""
    best, smallest = np.array(np.nan), np.array(np.inf)
    unfinished = np.ones(len(x), dtype=bool)  # coordinates for which a shorter step may still do better
    coarser: list[Array] = []
    for level in range(LEVELS):
        quotient, rounding = _quotients(f, x, steps / SHRINK**level, difference, unfinished)
        row = [quotient]
        for order, above in enumerate(coarser[:ORDERS], 1):
            factor = SHRINK ** (2 * order)
            row.append((factor * row[-1] - above) / (factor - 1))
            error = np.maximum(np.abs(row[-1] - row[-2]), np.abs(row[-1] - above))
            better = error < smallest  # never true for NaN
            best, smallest = np.where(better, row[-1], best), np.where(better, error, smallest)
        unfinished &= ~np.all(smallest <= rounding, axis=0)
        if not unfinished.any():
            break
        coarser = row
    return np.asarray(np.broadcast_to(best, quotient.shape))


def _quotients(
    f: Function, x: Array, steps: Array, difference: Difference | None, wanted: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Central quotients (k, n) of the wanted coordinates, NaN for others, and the error of each by rounding of f."""
    ahead: list[Array] = []
    behind: list[Array] = []
    widths: list[float] = []
    for i in np.flatnonzero(wanted):
        for values, h in ((ahead, steps[i]), (behind, -steps[i])):
            moved = x.copy()
            moved[i] += h
            values.append(np.array(f(moved), dtype=float))
        widths.append((x[i] + steps[i]) - (x[i] - steps[i]))  # twice the step, as far as rounding leaves it
    shapes = {a.shape for a in (*ahead, *behind)}
    if len(shapes) > 1 or len(*shapes) != 1:
        raise InputError(f"f gave shapes {' and '.join(map(str, sorted(shapes)))}, expected one vector length")
    pairs = list(zip(ahead, behind, strict=True))
    change = [a - b if difference is None else np.asarray(difference(a, b), dtype=float) for a, b in pairs]
    quotients, rounding = np.full((2, *ahead[0].shape, len(x)), np.nan)
    quotients[:, wanted] = np.transpose(change) / widths
    rounding[:, wanted] = EPSILON * np.transpose([np.maximum(np.abs(a), np.abs(b)) for a, b in pairs]) / widths
    return quotients, rounding
