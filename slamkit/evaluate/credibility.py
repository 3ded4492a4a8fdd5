"""Credibility: the covariance that a filter claims against the mean square error that its runs attain."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from slamkit.arrays import Array
from slamkit.errors import InputError
from slamkit.evaluate.nees import nees
from slamkit.evaluate.stacks import common_shape, finite_stack

__all__ = ["inclination", "nci"]


def nci(error: ArrayLike, covariance: ArrayLike) -> Array:
    """Compute the noncredibility index, (10/M) Σ |log₁₀ ρᵢ| [dB]: the distance of claimed from attained covariance.

    ρᵢ = εᵢ/ε*ᵢ compares the NEES of run i, εᵢ = eᵢᵀ Pᵢ⁻¹ eᵢ, with its value under the sample mean square error of all
    M runs, ε*ᵢ = eᵢᵀ (Σⱼ eⱼeⱼᵀ/M)⁻¹ eᵢ. The index is 0 if P equals that sample mean square error. For a credible
    estimator it falls towards 0 as 1/√M.

    Parameters
    ----------
    error : array_like (M, ..., d)
        Errors of M > d runs; the axes between are steps.
    covariance : array_like (M, ..., d, d)
        Claimed covariances; broadcasts.

    Returns
    -------
    ndarray (...)
        One index for each step [dB]. NaN at a step that has none: the covariance of a run has another rank than the
        sample mean square error, nothing is uncertain, or a run has no error at all.

    Raises
    ------
    InputError
        M ≤ d, or see :func:`slamkit.evaluate.nees.nees`.
    DivergenceError
        See :func:`slamkit.evaluate.nees.nees`.

    Notes
    -----
    Li, Zhao, Measuring estimator's credibility: noncredibility index, FUSION 2006; Li, Zhao, Li, Evaluation of
    estimation algorithms: credibility tests, IEEE Trans. Systems, Man, and Cybernetics A 42(1), 2012.
    """
    return np.asarray(np.mean(np.abs(_log_ratios(error, covariance)), axis=0))


def inclination(error: ArrayLike, covariance: ArrayLike) -> Array:
    """Compute the inclination indicator, (10/M) Σ log₁₀ ρᵢ [dB]: positive if overconfident, negative if underconfident.

    ``abs(inclination) <= nci``. A covariance that is c times the attained one changes the indicator by -10 log₁₀ c.
    Parameters, ρᵢ, result, errors and source are those of :func:`nci`.
    """
    return np.asarray(np.mean(_log_ratios(error, covariance), axis=0))


def _log_ratios(error: ArrayLike, covariance: ArrayLike) -> Array:
    """10 log₁₀(ε/ε*) (M, ...), with ε* under the sample mean square error over the first axis; NaN where undefined."""
    e, P = finite_stack("error", error, 2), finite_stack("covariance", covariance, 2)
    M, d = len(e), e.shape[-1]
    if d >= M:
        raise InputError(f"error has {M} runs, the sample mean square error of {d} components needs more than {d}")
    if common_shape("error", e.shape[:-1], "covariance", P.shape[:-2]) != e.shape[:-1]:
        raise InputError(f"covariance has shape {P.shape}, expected {(*e.shape, d)}")
    by_step = np.moveaxis(e, 0, -2)
    claimed, attained = nees(e, P), nees(e, by_step.mT @ by_step / M)
    defined = (claimed.dof == attained.dof) & (claimed.values > 0) & (attained.values > 0)
    ratio = np.divide(claimed.values, attained.values, out=np.full(defined.shape, np.nan), where=defined)
    return 10 * np.log10(ratio)
