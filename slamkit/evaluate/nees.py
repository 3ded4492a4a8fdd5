"""NEES and NIS of an estimator, their χ² bounds, and their summary over runs.

Errors are estimate - truth, headings wrapped to [-π, π). All functions take stacks: the last axis (or the last two)
is the vector (or matrix), the leading axes are runs, steps, landmarks. Where a statistic is taken over runs, runs are
the first axis. The steps of one run are correlated, so a test must count independent runs and not steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from slamkit.arrays import Array, finite_number
from slamkit.errors import InputError
from slamkit.evaluate.normalized_squares import ATOL, RTOL, NormalizedSquares, normalized_squares
from slamkit.evaluate.stacks import (
    check_probability,
    common_shape,
    covariance_stack,
    degrees_of_freedom,
    finite_stack,
    squares_by_run,
    standard_error,
)
from slamkit.se2 import wrap

__all__ = [
    "ATOL",
    "RTOL",
    "Bounds",
    "NormalizedSquares",
    "Summary",
    "chi2_bounds",
    "heading_nees",
    "landmark_nees",
    "nees",
    "nis",
    "pose_nees",
    "position_nees",
    "state_error",
    "state_nees",
    "summary",
]


@dataclass(frozen=True, eq=False)
class Bounds:
    """Two-sided bounds, in the shape of the degrees of freedom that were given."""

    lower: Array
    upper: Array


@dataclass(frozen=True)
class Summary:
    """Normalised squares over independent runs. Every run counts once, by its mean over its steps."""

    runs: int
    mean: float
    standard_error: float  #: of the mean, from the spread of the runs; NaN for one run
    median: float
    trimmed_mean: float  #: mean without the lowest and the highest tenth of the runs
    limit: float
    share_above: float  #: share of the runs that lie above `limit`


def state_error(estimate: ArrayLike, truth: ArrayLike) -> Array:
    """Compute estimate minus truth for poses, or for whole states that begin with a pose.

    Parameters
    ----------
    estimate, truth : array_like (..., d), d ≥ 3
        x [m], y [m], θ [rad], then any coordinates that subtract plainly (landmarks [m]).

    Returns
    -------
    ndarray (..., d)
        The error; its heading is in [-π, π).

    Raises
    ------
    InputError
        Shapes that do not fit, d < 3, or values that are not finite.
    """
    a, b = finite_stack("estimate", estimate, 1), finite_stack("truth", truth, 1)
    if a.shape[-1] != b.shape[-1] or a.shape[-1] < 3:
        raise InputError(f"estimate has shape {a.shape} and truth {b.shape}, expected (..., d) for both with d ≥ 3")
    common_shape("estimate", a.shape[:-1], "truth", b.shape[:-1])
    error = a - b
    error[..., 2] = wrap(error[..., 2])
    return error


def nees(error: ArrayLike, covariance: ArrayLike, *, rtol: float = RTOL, atol: float = ATOL) -> NormalizedSquares:
    """Compute the normalised estimation error squared, ε = eᵀ P⁻¹ e.

    ε is dimensionless. For a consistent estimator it is χ² with as many degrees of freedom as P has rank.

    A covariance that is not of full rank is normal: a robot may know exactly where it starts. Then ε is taken on the
    eigenspace whose eigenvalues exceed ``max(rtol · λ_max, atol²)``: ε = Σ (vᵢᵀe)² / λᵢ, and its degrees of freedom
    are that rank. Nothing is added to P. An error outside that eigenspace contradicts what the filter claims to know
    exactly, and raises.

    Parameters
    ----------
    error : array_like (..., d)
        Estimate minus truth, angles wrapped (see :func:`state_error`).
    covariance : array_like (..., d, d)
        P, as claimed by the filter; leading axes broadcast against those of `error`.
    rtol : float
        Share of the largest eigenvalue below which an eigenvalue counts as zero.
    atol : float
        Standard deviation, in units of the state, below which a direction counts as known exactly.

    Returns
    -------
    NormalizedSquares
        Values and degrees of freedom, both (...).

    Raises
    ------
    InputError
        Shapes that do not fit, values that are not finite, or P not symmetric.
    DivergenceError
        P has a negative eigenvalue beyond the threshold, or the error leaves the eigenspace of P: its part outside
        exceeds six times the standard deviation that the thresholds treat as zero.

    Notes
    -----
    Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, section 5.4; its use
    for SLAM: Huang, Mourikis, Roumeliotis, Int. J. Robotics Research 29(5), 2010.
    """
    return normalized_squares("error", error, "covariance", covariance, rtol, atol)


def pose_nees(poses: ArrayLike, covariances: ArrayLike, truth: ArrayLike) -> NormalizedSquares:
    """Compute the NEES of the pose: ε = eᵀ P⁻¹ e with e = (x, y, θ) - truth and θ wrapped; 3 degrees of freedom.

    Parameters
    ----------
    poses, truth : array_like (..., 3)
        Estimated and true poses [m, m, rad].
    covariances : array_like (..., 3, 3)
        Claimed pose covariances.

    Returns
    -------
    NormalizedSquares
        In the shape of the leading axes.

    Raises
    ------
    InputError, DivergenceError
        See :func:`nees`.
    """
    error, P = _pose_error(poses, covariances, truth)
    return nees(error, P)


def position_nees(poses: ArrayLike, covariances: ArrayLike, truth: ArrayLike) -> NormalizedSquares:
    """Compute the NEES of the position, marginal over the heading: ε = e_pᵀ P_pp⁻¹ e_p; 2 degrees of freedom.

    Parameters and errors are those of :func:`pose_nees`.
    """
    error, P = _pose_error(poses, covariances, truth)
    return nees(error[..., :2], P[..., :2, :2])


def heading_nees(poses: ArrayLike, covariances: ArrayLike, truth: ArrayLike) -> NormalizedSquares:
    """Compute the NEES of the heading, with θ wrapped: ε = e_θ² / P_θθ; 1 degree of freedom.

    Parameters and errors are those of :func:`pose_nees`.
    """
    error, P = _pose_error(poses, covariances, truth)
    return nees(error[..., 2:], P[..., 2:, 2:])


def landmark_nees(landmarks: ArrayLike, covariances: ArrayLike, truth: ArrayLike) -> NormalizedSquares:
    """Compute the NEES of each landmark by itself: ε = eᵀ P⁻¹ e with e = l - truth; 2 degrees of freedom.

    The landmarks of one map are correlated. Their values are not independent, and their mean over a map is not χ².

    Parameters
    ----------
    landmarks, truth : array_like (..., 2)
        Estimated and true positions [m].
    covariances : array_like (..., 2, 2)
        Claimed covariances [m²].

    Returns
    -------
    NormalizedSquares
        In the shape of the leading axes.

    Raises
    ------
    InputError, DivergenceError
        See :func:`nees`.
    """
    a, b = finite_stack("landmarks", landmarks, 1), finite_stack("truth", truth, 1)
    if a.shape[-1] != 2 or b.shape[-1] != 2:
        raise InputError(f"landmarks have shape {a.shape} and truth {b.shape}, expected (..., 2) for both")
    common_shape("landmarks", a.shape[:-1], "truth", b.shape[:-1])
    return nees(a - b, covariances)


def state_nees(states: ArrayLike, covariances: ArrayLike, truth: ArrayLike) -> NormalizedSquares:
    """Compute the NEES of the whole state (pose, then N landmarks): ε = eᵀ P⁻¹ e; 3 + 2N degrees of freedom.

    Parameters
    ----------
    states, truth : array_like (..., 3 + 2N)
        x [m], y [m], θ [rad], then the landmarks [m], in the same order in both.
    covariances : array_like (..., 3 + 2N, 3 + 2N)
        Claimed joint covariances.

    Returns
    -------
    NormalizedSquares
        In the shape of the leading axes.

    Raises
    ------
    InputError, DivergenceError
        See :func:`nees`.
    """
    return nees(state_error(states, truth), covariances)


def nis(innovations: ArrayLike, covariances: ArrayLike) -> NormalizedSquares:
    """Compute the normalised innovation squared, yᵀ S⁻¹ y: a consistency test that needs no truth.

    It is dimensionless. For a consistent filter it is χ² with k degrees of freedom.

    Parameters
    ----------
    innovations : array_like (..., k)
        y = z - ẑ in the sensor's units, bearings wrapped (as the sensor model's ``residual`` gives them).
    covariances : array_like (..., k, k)
        S = H P Hᵀ + R.

    Returns
    -------
    NormalizedSquares
        In the shape of the leading axes.

    Raises
    ------
    InputError, DivergenceError
        See :func:`nees`.

    Notes
    -----
    Bar-Shalom, Li, Kirubarajan 2001, section 5.4.
    """
    return normalized_squares("innovations", innovations, "covariances", covariances)


def chi2_bounds(dof: ArrayLike, runs: ArrayLike = 1, probability: float = 0.95) -> Bounds:
    """Compute the bounds of the mean of M independent χ²_d values: χ²_{Md}((1 ∓ probability)/2) / M.

    Use them for the mean NEES over M runs at one step, or for the mean NIS over M independent sightings. They do not
    hold for a mean over the steps of a run, whose terms are correlated: see :func:`summary`.

    Parameters
    ----------
    dof : array_like (...)
        Degrees of freedom d ≥ 0 of one value. If they differ between runs, give their mean over the runs.
    runs : array_like (...) of int
        M ≥ 1; broadcasts against `dof`.
    probability : float
        Two-sided probability, in (0, 1).

    Returns
    -------
    Bounds
        Lower and upper (...); both 0 where dof is 0.

    Raises
    ------
    InputError
        Negative dof, runs that are not whole numbers ≥ 1, a probability outside (0, 1), shapes that do not broadcast.

    Notes
    -----
    Bar-Shalom, Li, Kirubarajan 2001, section 5.4: M times the mean is χ² with Md degrees of freedom.
    """
    from scipy.special import gammainccinv, gammaincinv

    d, M = degrees_of_freedom(dof), finite_stack("runs", runs, 0)
    if not np.all((M >= 1) & (np.floor(M) == M)):
        raise InputError(f"runs is {runs!r}, expected whole numbers of at least 1")
    tail = (1 - check_probability(probability)) / 2
    common_shape("dof", d.shape, "runs", M.shape)
    half = np.where(d > 0, M * d, 1.0) / 2
    certain = d == 0
    lower = np.where(certain, 0.0, 2 * gammaincinv(half, tail) / M)
    upper = np.where(certain, 0.0, 2 * gammainccinv(half, tail) / M)
    return Bounds(lower, upper)


def summary(values: ArrayLike, dof: float, limit: float | None = None) -> Summary:
    """Summarise NEES or NIS values over runs, with statistics that one diverged run cannot dominate.

    Each run is first reduced to its mean over its steps. Mean, spread, median and shares are then taken over runs,
    which are independent where steps are not. For a consistent estimator the mean is `dof` on average.

    Parameters
    ----------
    values : array_like (M,) or (M, ...)
        Values of M runs; further axes are steps, landmarks, …
    dof : float
        Degrees of freedom of one value.
    limit : float, optional
        Limit of ``share_above``. The default is 6 for dof = 3, which a χ²₃ value exceeds with probability 0.112, and
        for other dof the quantile that is exceeded with the same probability.

    Returns
    -------
    Summary

    Raises
    ------
    InputError
        No runs, values that are negative or not finite, dof ≤ 0.

    Notes
    -----
    The trimmed mean leaves out ⌊M/10⌋ runs at either end. The standard error is s/√M with s the sample standard
    deviation of the runs' means.
    """
    from scipy.special import gammainc, gammaincinv

    per_run = squares_by_run(values).mean(axis=1)
    d = finite_number("dof", dof, above=0.0)
    limit = float(2 * gammaincinv(d / 2, gammainc(1.5, 3.0))) if limit is None else finite_number("limit", limit)
    M = len(per_run)
    ordered, cut = np.sort(per_run), M // 10
    return Summary(
        runs=M,
        mean=float(per_run.mean()),
        standard_error=float(standard_error(per_run)),
        median=float(np.median(per_run)),
        trimmed_mean=float(ordered[cut : M - cut].mean()),
        limit=limit,
        share_above=float(np.mean(per_run > limit)),
    )


def _pose_error(poses: ArrayLike, covariances: ArrayLike, truth: ArrayLike) -> tuple[Array, Array]:
    error = state_error(poses, truth)
    if error.shape[-1] != 3:
        raise InputError(f"poses have {error.shape[-1]} components, expected 3: x, y, θ")
    return error, covariance_stack("covariances", covariances, 3)
