"""Coverage: how often the truth lies inside the region that a filter claims to hold it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from slamkit.arrays import Array
from slamkit.errors import InputError
from slamkit.evaluate.stacks import degrees_of_freedom, finite_stack, squares_by_run, standard_error

__all__ = ["Coverage", "coverage"]


@dataclass(frozen=True, eq=False)
class Coverage:
    """How often the truth lay inside the region that was claimed to hold it with probability `levels`."""

    levels: Array  #: (L,) claimed probability
    share: Array  #: (L,) attained share, mean over runs
    standard_error: Array  #: (L,) of the share, from the spread of the runs; NaN for one run


def coverage(values: ArrayLike, dof: ArrayLike, levels: ArrayLike | None = None) -> Coverage:
    """Compute the coverage curve: the share of NEES or NIS values ε with F_χ²(ε) ≤ level.

    A value ε says that the truth lay on the border of the claimed region of probability F_χ²(ε). The curve of a
    consistent estimator is the diagonal; a curve below it means overconfidence.

    Parameters
    ----------
    values : array_like (M,) or (M, ...)
        NEES or NIS of M runs; further axes are steps.
    dof : array_like, broadcasts to the shape of `values`
        Degrees of freedom. Values with dof 0 carry no information and are left out.
    levels : array_like (L,), optional
        Ascending probabilities in [0, 1]; by default 0.01, 0.02 … 0.99.

    Returns
    -------
    Coverage
        The share, as the mean over runs of each run's share over its steps, and its standard error s/√M over runs.

    Raises
    ------
    InputError
        No values, values that are negative or not finite, negative dof, levels not ascending or outside [0, 1].

    Notes
    -----
    F_χ²(ε) is the probability integral transform of the NEES: uniform for a consistent Gaussian estimator.
    """
    from scipy.special import gammainc

    at = np.linspace(0.01, 0.99, 99) if levels is None else finite_stack("levels", levels, 1)
    if at.ndim != 1 or not len(at) or at[0] < 0 or at[-1] > 1 or np.any(np.diff(at) <= 0):
        raise InputError(f"levels are {levels!r}, expected one ascending row of probabilities in [0, 1]")
    shape, eps, d = np.shape(values), squares_by_run(values), degrees_of_freedom(dof)
    try:
        d = np.broadcast_to(d, shape).reshape(eps.shape)
    except ValueError:
        raise InputError(f"dof has shape {d.shape}, which does not broadcast to that of values, {shape}") from None
    known = d > 0
    runs = np.flatnonzero(known.any(axis=1))
    if not len(runs):
        raise InputError("every dof is 0: there is no coverage to measure")
    M, L = len(eps), len(at)
    first = np.searchsorted(at, gammainc(d[known] / 2, eps[known] / 2))  # the first level that covers the value
    count = np.bincount(np.nonzero(known)[0] * (L + 1) + first, minlength=M * (L + 1)).reshape(M, L + 1)
    share = np.cumsum(count[runs, :L], axis=1) / known[runs].sum(axis=1, keepdims=True)
    return Coverage(at, share.mean(axis=0), standard_error(share))
