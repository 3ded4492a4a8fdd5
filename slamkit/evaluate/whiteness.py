"""Whiteness: autocorrelation of an innovation sequence, and the test that all of it is zero."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from slamkit.arrays import Array, Indices
from slamkit.errors import InputError
from slamkit.evaluate.stacks import check_probability, common_shape, covariance_stack, finite_stack

__all__ = ["Whiteness", "whiteness"]


@dataclass(frozen=True, eq=False)
class Whiteness:
    """Autocorrelation of an innovation sequence, and the test that all of it is zero."""

    lags: Indices  #: (L,) 1 … L
    correlation: Array  #: (..., L) normalised autocorrelation, in [-1, 1]
    bound: Array  #: (L,) at one lag, a white sequence stays within ±bound with the given probability
    statistic: Array  #: (...) Ljung-Box statistic over all lags
    dof: int  #: its degrees of freedom, k² L
    p_value: Array  #: (...) probability of a larger statistic if the innovations are white


def whiteness(
    innovations: ArrayLike,
    covariances: ArrayLike | None = None,
    lags: int = 20,
    probability: float = 0.95,
) -> Whiteness:
    """Test whether innovations are white: normalised autocorrelation with its bound, and the Ljung-Box test.

    The innovations are whitened by their own covariance (if given) and by their sample covariance about zero, which
    gives w. Then C_l = Σ_t w_{t+l} w_tᵀ / K. The correlation at lag l is tr(C_l)/k; for a white sequence it has mean 0
    and variance (K - l)/(k K²). The statistic Q = K (K + 2) Σ_l ‖C_l‖²/(K - l) is asymptotically χ² with k² L degrees
    of freedom. It also sees correlation between components. All results are dimensionless and do not change if S is
    multiplied by a constant.

    Parameters
    ----------
    innovations : array_like (..., K, k)
        Sequences of K innovations in the order of time, bearings wrapped; leading axes are runs.
    covariances : array_like (..., K, k, k), optional
        S of each innovation; broadcasts. Without it all innovations are assumed to have the same covariance.
    lags : int
        L, the number of lags; 1 ≤ L < K. Keep it small against K, so that the asymptotics hold.
    probability : float
        Two-sided probability of the bound, in (0, 1).

    Returns
    -------
    Whiteness

    Raises
    ------
    InputError
        Shapes that do not fit, values that are not finite, S not symmetric positive definite, lags out of range, or
        innovations that do not span their k components.

    Notes
    -----
    Means are not subtracted: the innovations of a consistent filter have mean zero, and a bias must show. Bar-Shalom,
    Li, Kirubarajan 2001, section 5.4; Ljung, Box, Biometrika 65, 1978; for vectors Hosking, J. American Statistical
    Association 75, 1980.
    """
    from scipy.special import gammaincc, ndtri

    y = finite_stack("innovations", innovations, 2)
    K, k = y.shape[-2:]
    if isinstance(lags, bool) or not isinstance(lags, (int, np.integer)) or not 1 <= lags < K:
        raise InputError(f"lags is {lags!r}, expected an integer from 1 to {K - 1}: there are {K} innovations")
    two_sided = check_probability(probability)
    if covariances is not None:
        S = covariance_stack("covariances", covariances, k)
        common_shape("innovations", y.shape[:-1], "covariances", S.shape[:-2])
        try:
            L = np.linalg.cholesky(S)
        except np.linalg.LinAlgError:
            raise InputError("covariances are not all positive definite") from None
        y = np.linalg.solve(L, y[..., None])[..., 0]
    C0 = y.mT @ y / K
    if np.any(np.linalg.matrix_rank(C0, hermitian=True) < k):
        raise InputError(f"innovations do not span their {k} components: one is zero, or depends on the others")
    w = np.linalg.solve(np.linalg.cholesky(C0), y.mT).mT
    steps = np.arange(1, lags + 1)
    C = np.stack([w[..., lag:, :].mT @ w[..., : K - lag, :] / K for lag in steps], axis=-3)
    correlation = np.trace(C, axis1=-2, axis2=-1) / k
    bound = ndtri((1 + two_sided) / 2) * np.sqrt((K - steps) / k) / K
    statistic = K * (K + 2) * np.sum(np.sum(C**2, axis=(-2, -1)) / (K - steps), axis=-1)
    dof = int(k * k * lags)
    return Whiteness(steps, correlation, bound, statistic, dof, gammaincc(dof / 2, statistic / 2))
