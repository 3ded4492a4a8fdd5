"""A numeric Jacobian, for tests and for models without an analytic one."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import ArrayLike

from slamkit.arrays import Array
from slamkit.errors import InputError

EPSILON = float(np.finfo(float).eps)
SHRINK = 1.6  #: ratio of one step to the next; not 2, because a periodic function could meet all steps in phase
LEVELS, ORDERS = 16, 6  #: how many steps are tried, and how many powers of the step are removed


def numeric_jacobian(
    f: Callable[[Array], ArrayLike],
    x: ArrayLike,
    *,
    step: ArrayLike | None = None,
    difference: Callable[[Array, Array], ArrayLike] | None = None,
) -> Array:
    """Jacobian by central differences, extrapolated to step zero.

    Up to sixteen steps, each 1.6 times shorter than the one before, give a tableau of extrapolated differences; every
    entry of the Jacobian is taken where its own error estimate is smallest. Smooth functions of order one come out to
    about 1e-12. A step at which f is not finite is passed over, so x may lie close to the edge of f's domain.

    Parameters
    ----------
    f : callable
        From an array (n,) to an array (k,).
    x : array_like (n,)
        The point, in the units of f's argument.
    step : array_like () or (n,), optional
        Longest step of each coordinate; by default 0.1, or 1e-5·\\|x\\| where that is more.
    difference : callable, optional
        ``difference(f(x + h), f(x - h))`` (k,) in place of the plain difference, for values that hold angles.

    Returns
    -------
    ndarray (k, n)
        ∂f/∂x; NaN where f was finite at too few steps to tell.

    Raises
    ------
    InputError
        x is not a finite vector, a step is not positive, or f gives no vector.

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
    x = np.array(x, dtype=float)
    if x.ndim != 1 or not np.all(np.isfinite(x)):
        raise InputError(f"x is {x}, expected a finite vector")
    steps = np.maximum(0.1, 1e-5 * np.abs(x)) if step is None else np.asarray(step, dtype=float)
    if steps.shape not in ((), x.shape) or not np.all(np.isfinite(steps) & (steps > 0)):
        raise InputError(f"step is {steps}, expected one number > 0 or {len(x)} of them")
    steps = np.broadcast_to(steps, x.shape)

    def quotients(i: int) -> Iterator[tuple[Array, Array]]:
        """Central quotients (k,) at shrinking steps, and what the rounding of f alone makes of each."""
        for n in range(LEVELS):
            ahead, behind = x.copy(), x.copy()
            ahead[i] += steps[i] / SHRINK**n
            behind[i] -= steps[i] / SHRINK**n
            width = ahead[i] - behind[i]  # what is left of twice the step after rounding
            a, b = np.array(f(ahead), dtype=float), np.array(f(behind), dtype=float)
            if a.ndim != 1 or a.shape != b.shape:
                raise InputError(f"f gave shapes {a.shape} and {b.shape}, expected one vector length")
            change = np.asarray(a - b if difference is None else difference(a, b), dtype=float)
            yield change / width, EPSILON * np.maximum(np.abs(a), np.abs(b)) / width

    with np.errstate(all="ignore"):
        columns = [_extrapolate(quotients(i)) for i in range(len(x))]
    return np.stack(columns, axis=1) if columns else np.empty((len(np.atleast_1d(f(x))), 0))


def _extrapolate(quotients: Iterator[tuple[Array, Array]]) -> Array:
    """The limit (k,) of quotients at shrinking steps: even powers of the step are removed one by one."""
    best, smallest = np.array(np.nan), np.array(np.inf)
    above: list[Array] = []
    for quotient, rounding in quotients:
        row = [quotient]
        for order, coarser in enumerate(above[:ORDERS], 1):
            factor = SHRINK ** (2 * order)
            row.append((factor * row[-1] - coarser) / (factor - 1))
            error = np.maximum(np.abs(row[-1] - row[-2]), np.abs(row[-1] - coarser))
            better = error < smallest  # never where the error is NaN
            best, smallest = np.where(better, row[-1], best), np.where(better, error, smallest)
        if np.all(smallest <= rounding):
            break  # a shorter step can only do worse
        above = row
    return np.asarray(np.broadcast_to(best, quotient.shape))
