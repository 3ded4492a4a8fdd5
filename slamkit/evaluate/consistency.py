"""Does an estimator's covariance tell the truth? NEES, NIS, their bounds, coverage, credibility, whiteness.

Errors are estimate - truth, headings wrapped to [-π, π). All functions take stacks: the last axis (or the last two)
is the vector (or matrix), the leading axes are runs, steps, landmarks. Where a statistic is taken over runs, runs are
the first axis: the steps of one run are correlated, so only independent runs carry inference.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slamkit.errors import DivergenceError, InputError
from slamkit.se2 import wrap

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

RTOL = 1e-12  #: an eigenvalue below this share of the largest counts as zero
ATOL = 1e-9  #: a standard deviation below this (in units of the state) counts as zero

# An error outside the eigenspace of a covariance may be this many times the largest standard deviation that the
# thresholds let pass for zero.
_OUTSIDE_SIGMAS = 6.0
_ASYMMETRY = 1e-9


@dataclass(frozen=True, eq=False)
class NormalizedSquares:
    """Normalised squares eᵀP⁻¹e (NEES or NIS) and the degrees of freedom that each one has."""

    values: Array  #: (...) eᵀP⁻¹e; χ² with `dof` degrees of freedom for a consistent estimator
    dof: IntArray  #: (...) rank of P

    @property
    def per_dof(self) -> Array:
        """(...) values / dof: one on the average for a consistent estimator; NaN where dof is 0."""
        return np.asarray(np.divide(self.values, self.dof, out=np.full_like(self.values, np.nan), where=self.dof > 0))


@dataclass(frozen=True, eq=False)
class Bounds:
    """Two-sided bounds, shaped as the degrees of freedom that they were asked for."""

    lower: Array
    upper: Array


@dataclass(frozen=True)
class Summary:
    """Normalised squares over independent runs; every run counts once, as its own mean over its steps."""

    runs: int
    mean: float
    standard_error: float  #: of the mean, from the spread of the runs; NaN for one run
    median: float
    trimmed_mean: float  #: mean without the lowest and the highest tenth of the runs
    limit: float
    share_above: float  #: share of the runs that lie above `limit`


@dataclass(frozen=True, eq=False)
class Coverage:
    """How often the truth lay inside the region that was claimed to hold it with probability `levels`."""

    levels: Array  #: (L,) claimed probability
    share: Array  #: (L,) attained share, mean over runs
    standard_error: Array  #: (L,) of the share, from the spread of the runs; NaN for one run


@dataclass(frozen=True, eq=False)
class Whiteness:
    """Autocorrelation of an innovation sequence, and the test that all of it is zero."""

    lags: IntArray  #: (L,) 1 … L
    correlation: Array  #: (..., L) normalised autocorrelation, in [-1, 1]
    bound: Array  #: (L,) a white sequence stays within ±bound at one lag with the probability asked for
    statistic: Array  #: (...) Ljung–Box statistic over all lags
    dof: int  #: its degrees of freedom, k² L
    p_value: Array  #: (...) probability of a larger statistic if the innovations are white


def state_error(estimate: ArrayLike, truth: ArrayLike) -> Array:
    """Estimate minus truth of poses, or of whole states that begin with a pose.

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
    a, b = _numbers("estimate", estimate, 1), _numbers("truth", truth, 1)
    if a.shape[-1] != b.shape[-1] or a.shape[-1] < 3:
        raise InputError(f"estimate has shape {a.shape} and truth {b.shape}, expected (..., d) for both with d ≥ 3")
    _broadcast("estimate", a.shape[:-1], "truth", b.shape[:-1])
    error = a - b
    error[..., 2] = wrap(error[..., 2])
    return error


def nees(error: ArrayLike, covariance: ArrayLike, *, rtol: float = RTOL, atol: float = ATOL) -> NormalizedSquares:
    """Normalised estimation error squared, ε = eᵀ P⁻¹ e.

    A covariance that is not of full rank is normal (a robot that knows exactly where it starts). Then ε is taken on
    the eigenspace whose eigenvalues exceed ``max(rtol · λ_max, atol²)``: ε = Σ (vᵢᵀe)² / λᵢ, and has that rank as
    its degrees of freedom. Nothing is added to P. An error outside that eigenspace contradicts what the filter
    claims to know exactly and raises.

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
        Shapes that do not fit, values that are not finite, P not symmetric.
    DivergenceError
        P has a negative eigenvalue beyond the threshold, or the error leaves the eigenspace of P: its part outside
        exceeds six of the standard deviations that the thresholds let pass for zero.

    Notes
    -----
    Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, section 5.4; its use
    for SLAM: Huang, Mourikis, Roumeliotis, Int. J. Robotics Research 29(5), 2010.
    """
    return _normalized_squares("error", error, "covariance", covariance, rtol, atol)


def pose_nees(poses: ArrayLike, covariances: ArrayLike, truth: ArrayLike) -> NormalizedSquares:
    """NEES of the pose (3 degrees of freedom), e = (x, y, θ) - truth with θ wrapped; see :func:`nees`.

    Parameters
    ----------
    poses, truth : array_like (..., 3)
        Estimated and true poses [m, m, rad].
    covariances : array_like (..., 3, 3)
        Claimed pose covariances.

    Returns
    -------
    NormalizedSquares
        Shaped as the leading axes.

    Raises
    ------
    InputError, DivergenceError
        As :func:`nees`.
    """
    error, P = _pose_error(poses, covariances, truth)
    return nees(error, P)


def position_nees(poses: ArrayLike, covariances: ArrayLike, truth: ArrayLike) -> NormalizedSquares:
    """NEES of the position (2 degrees of freedom): marginal over the heading; arguments as :func:`pose_nees`."""
    error, P = _pose_error(poses, covariances, truth)
    return nees(error[..., :2], P[..., :2, :2])


def heading_nees(poses: ArrayLike, covariances: ArrayLike, truth: ArrayLike) -> NormalizedSquares:
    """NEES of the heading (1 degree of freedom), θ wrapped: ε = e_θ² / P_θθ; arguments as :func:`pose_nees`."""
    error, P = _pose_error(poses, covariances, truth)
    return nees(error[..., 2:], P[..., 2:, 2:])


def landmark_nees(landmarks: ArrayLike, covariances: ArrayLike, truth: ArrayLike) -> NormalizedSquares:
    """NEES of each landmark by itself (2 degrees of freedom); see :func:`nees`.

    Landmarks of one map are correlated: their values are not independent, and their mean over a map is no χ².

    Parameters
    ----------
    landmarks, truth : array_like (..., 2)
        Estimated and true positions [m].
    covariances : array_like (..., 2, 2)
        Claimed covariances [m²].

    Returns
    -------
    NormalizedSquares
        Shaped as the leading axes.

    Raises
    ------
    InputError, DivergenceError
        As :func:`nees`.
    """
    a, b = _numbers("landmarks", landmarks, 1), _numbers("truth", truth, 1)
    if a.shape[-1] != 2 or b.shape[-1] != 2:
        raise InputError(f"landmarks have shape {a.shape} and truth {b.shape}, expected (..., 2) for both")
    _broadcast("landmarks", a.shape[:-1], "truth", b.shape[:-1])
    return nees(a - b, covariances)


def state_nees(states: ArrayLike, covariances: ArrayLike, truth: ArrayLike) -> NormalizedSquares:
    """NEES of the whole state (pose, then landmarks; 3 + 2N degrees of freedom); see :func:`nees`.

    Parameters
    ----------
    states, truth : array_like (..., 3 + 2N)
        x [m], y [m], θ [rad], then the landmarks [m], in the same order in both.
    covariances : array_like (..., 3 + 2N, 3 + 2N)
        Claimed joint covariances.

    Returns
    -------
    NormalizedSquares
        Shaped as the leading axes.

    Raises
    ------
    InputError, DivergenceError
        As :func:`nees`.
    """
    return nees(state_error(states, truth), covariances)


def nis(innovations: ArrayLike, covariances: ArrayLike) -> NormalizedSquares:
    """Normalised innovation squared, yᵀ S⁻¹ y: the consistency test that needs no truth.

    Parameters
    ----------
    innovations : array_like (..., k)
        y = z - ẑ in the sensor's units, bearings wrapped (as the sensor model's ``residual`` gives them).
    covariances : array_like (..., k, k)
        S = H P Hᵀ + R.

    Returns
    -------
    NormalizedSquares
        Shaped as the leading axes; χ²_k for a consistent filter.

    Raises
    ------
    InputError, DivergenceError
        As :func:`nees`.

    Notes
    -----
    Bar-Shalom, Li, Kirubarajan 2001, section 5.4.
    """
    return _normalized_squares("innovations", innovations, "covariances", covariances, RTOL, ATOL)


def chi2_bounds(dof: ArrayLike, runs: ArrayLike = 1, probability: float = 0.95) -> Bounds:
    """Bounds of the mean of M independent χ²_d values: χ²_{Md}((1 ∓ probability)/2) / M.

    For the mean NEES over M runs at one step (or the NIS over M independent sightings). A mean over the steps of a
    run has no such bounds, for its terms are correlated: see :func:`summary`.

    Parameters
    ----------
    dof : array_like (...)
        Degrees of freedom d ≥ 0 of one value. Where they differ between runs, their mean over the runs.
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

    d, M = _dof(dof), _numbers("runs", runs, 0)
    if not np.all((M >= 1) & (np.floor(M) == M)):
        raise InputError(f"runs is {runs!r}, expected whole numbers of at least 1")
    tail = (1 - _probability(probability)) / 2
    _broadcast("dof", d.shape, "runs", M.shape)
    half = np.where(d > 0, M * d, 1.0) / 2
    certain = d == 0
    lower = np.where(certain, 0.0, 2 * gammaincinv(half, tail) / M)
    upper = np.where(certain, 0.0, 2 * gammainccinv(half, tail) / M)
    return Bounds(lower, upper)


def summary(values: ArrayLike, dof: float, limit: float | None = None) -> Summary:
    """What NEES (or NIS) values say over runs, robustly: one diverged run can carry a mean.

    Each run is first reduced to its mean over its steps; mean, spread, median and shares are then over runs, which
    are independent where steps are not. A consistent estimator has a mean of `dof`.

    Parameters
    ----------
    values : array_like (M,) or (M, ...)
        Values of M runs; further axes are steps, landmarks, …
    dof : float
        Degrees of freedom of one value.
    limit : float, optional
        Limit of ``share_above``. By default 6 for dof = 3, which a χ²₃ value exceeds with probability 0.112, and for
        other dof the quantile that is exceeded with that same probability.

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

    per_run = _squares(values).mean(axis=1)
    d = float(_dof(dof))
    if d == 0:
        raise InputError("dof is 0: there is nothing to summarise")
    if limit is None:
        limit = float(2 * gammaincinv(d / 2, gammainc(1.5, 3.0)))
    elif not np.isfinite(limit):
        raise InputError(f"limit is {limit}, expected a finite number")
    M = len(per_run)
    ordered, cut = np.sort(per_run), M // 10
    return Summary(
        runs=M,
        mean=float(per_run.mean()),
        standard_error=float(_standard_error(per_run)),
        median=float(np.median(per_run)),
        trimmed_mean=float(ordered[cut : M - cut].mean()),
        limit=float(limit),
        share_above=float(np.mean(per_run > limit)),
    )


def coverage(values: ArrayLike, dof: ArrayLike, levels: ArrayLike | None = None) -> Coverage:
    """Coverage curve: the share of values with F_χ²(ε) ≤ level.

    A value ε says that the truth lay on the border of the claimed region of probability F_χ²(ε). A consistent
    estimator's curve is the diagonal; one below it is overconfident.

    Parameters
    ----------
    values : array_like (M,) or (M, ...)
        NEES or NIS of M runs; further axes are steps.
    dof : array_like, broadcasts to the shape of `values`
        Degrees of freedom. Values with dof 0 say nothing and are left out.
    levels : array_like (L,), optional
        Ascending probabilities in [0, 1]; by default 0.01, 0.02 … 0.99.

    Returns
    -------
    Coverage
        The share and its standard error over runs.

    Raises
    ------
    InputError
        No values, values that are negative or not finite, negative dof, levels not ascending or outside [0, 1].

    Notes
    -----
    F_χ²(ε) is the probability integral transform of the NEES: uniform for a consistent Gaussian estimator.
    """
    from scipy.special import gammainc

    at = np.linspace(0.01, 0.99, 99) if levels is None else _numbers("levels", levels, 1)
    if at.ndim != 1 or not len(at) or at[0] < 0 or at[-1] > 1 or np.any(np.diff(at) <= 0):
        raise InputError(f"levels are {levels!r}, expected one ascending row of probabilities in [0, 1]")
    shape, eps, d = np.shape(values), _squares(values), _dof(dof)
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
    return Coverage(at, share.mean(axis=0), _standard_error(share))


def nci(error: ArrayLike, covariance: ArrayLike) -> Array:
    """Noncredibility index, (10/M) Σ |log₁₀ ρᵢ| [dB]: how far the claimed covariance is from the attained one.

    ρᵢ = εᵢ/ε*ᵢ compares the NEES εᵢ = eᵢᵀ Pᵢ⁻¹ eᵢ of run i with what it would be under the sample mean square error
    of all runs, ε*ᵢ = eᵢᵀ (Σⱼ eⱼeⱼᵀ/M)⁻¹ eᵢ. It is 0 for P equal to that sample mean square error, and near 0
    (falling as 1/√M) for a credible estimator.

    Parameters
    ----------
    error : array_like (M, ..., d)
        Errors of M > d runs; the axes between are steps.
    covariance : array_like (M, ..., d, d)
        Claimed covariances; broadcasts.

    Returns
    -------
    ndarray (...)
        One index for each step. NaN at a step that has none: some run's covariance has another rank than the sample
        mean square error, nothing is uncertain, or some run has no error at all.

    Raises
    ------
    InputError, DivergenceError
        As :func:`nees`; M ≤ d.

    Notes
    -----
    Li, Zhao, Measuring estimator's credibility: noncredibility index, FUSION 2006; Li, Zhao, Li, Evaluation of
    estimation algorithms: credibility tests, IEEE Trans. Systems, Man, and Cybernetics A 42(1), 2012.
    """
    return np.asarray(np.mean(np.abs(_credibility(error, covariance)), axis=0))


def inclination(error: ArrayLike, covariance: ArrayLike) -> Array:
    """Inclination indicator, (10/M) Σ log₁₀ ρᵢ [dB]: positive is overconfident, negative underconfident.

    Arguments, ρ, result, errors and source as :func:`nci`; ``abs(inclination) <= nci``. A covariance that is c times
    the attained one moves it by -10 log₁₀ c.
    """
    return np.asarray(np.mean(_credibility(error, covariance), axis=0))


def whiteness(
    innovations: ArrayLike,
    covariances: ArrayLike | None = None,
    lags: int = 20,
    probability: float = 0.95,
) -> Whiteness:
    """Are the innovations white? Normalised autocorrelation with its bound, and the Ljung–Box test.

    The innovations are whitened by their own covariance (if given) and by their sample covariance about zero, then
    C_l = Σ_t w_{t+l} w_tᵀ / K. The correlation at lag l is tr(C_l)/k; for a white sequence it has mean 0 and
    variance (K - l)/(k K²). The statistic Q = K (K + 2) Σ_l ‖C_l‖²/(K - l) is asymptotically χ² with k² L degrees
    of freedom and sees correlation between components, too. Neither depends on units or on a constant factor in S.

    Parameters
    ----------
    innovations : array_like (..., K, k)
        Sequences of K innovations, one after another in time, bearings wrapped; leading axes are runs.
    covariances : array_like (..., K, k, k), optional
        S of each innovation; broadcasts. Without it the innovations are taken to have one covariance.
    lags : int
        L, the number of lags; 1 ≤ L < K. Small against K for the asymptotics to hold.
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
    Means are not subtracted: a consistent filter's innovations have mean zero, and a bias shall show. Bar-Shalom,
    Li, Kirubarajan 2001, section 5.4; Ljung, Box, Biometrika 65, 1978; for vectors Hosking, J. American Statistical
    Association 75, 1980.
    """
    from scipy.special import gammaincc, ndtri

    y = _numbers("innovations", innovations, 2)
    K, k = y.shape[-2:]
    if isinstance(lags, bool) or not isinstance(lags, (int, np.integer)) or not 1 <= lags < K:
        raise InputError(f"lags is {lags!r}, expected an integer from 1 to {K - 1}: there are {K} innovations")
    two_sided = _probability(probability)
    if covariances is not None:
        S = _numbers("covariances", covariances, 2)
        _square(S, "covariances", k)
        _broadcast("innovations", y.shape[:-1], "covariances", S.shape[:-2])
        _symmetric("covariances", S)
        try:
            L = np.linalg.cholesky(S)
        except np.linalg.LinAlgError:
            raise InputError("covariances are not all positive definite") from None
        y = np.linalg.solve(L, y[..., None])[..., 0]
    C0 = y.mT @ y / K
    if np.any(np.linalg.matrix_rank(C0, hermitian=True) < k):
        raise InputError(f"innovations do not span their {k} components: one is zero, or follows from the others")
    w = np.linalg.solve(np.linalg.cholesky(C0), y.mT).mT
    steps = np.arange(1, lags + 1)
    C = np.stack([w[..., lag:, :].mT @ w[..., : K - lag, :] / K for lag in steps], axis=-3)
    correlation = np.trace(C, axis1=-2, axis2=-1) / k
    bound = ndtri((1 + two_sided) / 2) * np.sqrt((K - steps) / k) / K
    statistic = K * (K + 2) * np.sum(np.sum(C**2, axis=(-2, -1)) / (K - steps), axis=-1)
    dof = int(k * k * lags)
    return Whiteness(steps, correlation, bound, statistic, dof, gammaincc(dof / 2, statistic / 2))


def _normalized_squares(
    name: str, vector: ArrayLike, matrix_name: str, matrix: ArrayLike, rtol: float, atol: float
) -> NormalizedSquares:
    e, P = _numbers(name, vector, 1), _numbers(matrix_name, matrix, 2)
    if not (0 <= rtol < 1 and 0 <= atol < np.inf):
        raise InputError(f"rtol is {rtol} and atol {atol}, expected 0 ≤ rtol < 1 and 0 ≤ atol < ∞")
    d = e.shape[-1]
    _square(P, matrix_name, d)
    shape = _broadcast(name, e.shape[:-1], matrix_name, P.shape[:-2])
    _symmetric(matrix_name, P)
    P = np.broadcast_to(P / 2 + P.mT / 2, (*shape, d, d)).reshape(-1, d, d)
    e = np.broadcast_to(e, (*shape, d)).reshape(-1, d)
    values, proven = _full_rank_squares(e, P, rtol, atol)
    rank = np.full(len(e), d)
    rest = np.flatnonzero(~proven)
    if len(rest):
        values[rest], rank[rest] = _eigenspace_squares(e[rest], P[rest], rtol, atol, rest, shape)
    return NormalizedSquares(values.reshape(shape), rank.reshape(shape))


def _full_rank_squares(e: Array, P: Array, rtol: float, atol: float) -> tuple[Array, NDArray[np.bool_]]:
    """EᵀP⁻¹e by Cholesky, and where P is proven to be of full rank by the rule of the eigenspace."""
    L = np.zeros_like(P)
    # LAPACK's factorisation stops the whole stack at its first singular matrix; this one leaves NaN there.
    with np.errstate(all="ignore"):
        for j in range(P.shape[-1]):
            column = P[:, j:, j] - (L[:, j:, :j] @ L[:, j, :j, None])[..., 0]
            L[:, j:, j] = column / np.sqrt(column[:, :1])
        rows = np.flatnonzero(np.all(np.isfinite(L), axis=(1, 2)))
        root = np.linalg.inv(L[rows])
        # λ_min ≥ 1/‖L⁻¹‖²_F and λ_max ≤ tr P: whoever passes here would pass with eigenvalues, too.
        smallest = 1 / np.sum(root**2, axis=(1, 2))
        enough = smallest > np.maximum(rtol * np.trace(P[rows], axis1=1, axis2=2), atol**2)
    values, proven = np.zeros(len(P)), np.zeros(len(P), dtype=np.bool_)
    values[rows] = np.sum((root @ e[rows, :, None])[..., 0] ** 2, axis=1)
    proven[rows] = enough
    return values, proven


def _eigenspace_squares(
    e: Array, P: Array, rtol: float, atol: float, rows: IntArray, shape: tuple[int, ...]
) -> tuple[Array, IntArray]:
    """EᵀP⁺e on the eigenspace above the threshold, and its rank; `rows` and `shape` name the matrix in an error."""
    lam, V = np.linalg.eigh(P)
    floor = np.maximum(rtol * lam[:, -1], atol**2)
    for i in np.flatnonzero(lam[:, 0] < -floor)[:1]:
        raise DivergenceError(
            f"the covariance{_where(rows[i], shape)} is not positive semi-definite: "
            f"its eigenvalues run from {lam[i, 0]:.3g} to {lam[i, -1]:.3g}"
        )
    kept = lam > floor[:, None]
    rank = kept.sum(axis=1)
    along = (V.mT @ e[..., None])[..., 0]
    outside = np.sqrt(np.sum(np.where(kept, 0.0, along) ** 2, axis=1))
    allowed = _OUTSIDE_SIGMAS * np.sqrt(floor * (e.shape[-1] - rank))
    for i in np.flatnonzero(outside > allowed)[:1]:
        raise DivergenceError(
            f"the error{_where(rows[i], shape)} leaves the eigenspace of its covariance (rank {rank[i]} of "
            f"{e.shape[-1]}) by {outside[i]:.3g}, at most {allowed[i]:.3g} passes for rounding: "
            "the filter claims to know exactly what it has wrong"
        )
    return np.sum(np.where(kept, along**2 / np.where(kept, lam, 1.0), 0.0), axis=1), rank


def _credibility(error: ArrayLike, covariance: ArrayLike) -> Array:
    """10 log₁₀(ε/ε*) (M, ...), with ε* under the sample mean square error over the first axis; NaN where undefined."""
    e, P = _numbers("error", error, 2), _numbers("covariance", covariance, 2)
    M, d = len(e), e.shape[-1]
    if d >= M:
        raise InputError(f"error has {M} runs, the sample mean square error of {d} components needs more than {d}")
    if _broadcast("error", e.shape[:-1], "covariance", P.shape[:-2]) != e.shape[:-1]:
        raise InputError(f"covariance has shape {P.shape}, expected {(*e.shape, d)}")
    by_step = np.moveaxis(e, 0, -2)
    claimed, attained = nees(e, P), nees(e, by_step.mT @ by_step / M)
    defined = (claimed.dof == attained.dof) & (claimed.values > 0) & (attained.values > 0)
    ratio = np.divide(claimed.values, attained.values, out=np.full(defined.shape, np.nan), where=defined)
    return 10 * np.log10(ratio)


def _pose_error(poses: ArrayLike, covariances: ArrayLike, truth: ArrayLike) -> tuple[Array, Array]:
    error, P = state_error(poses, truth), _numbers("covariances", covariances, 2)
    if error.shape[-1] != 3:
        raise InputError(f"poses have {error.shape[-1]} components, expected 3: x, y, θ")
    _square(P, "covariances", 3)
    return error, P


def _squares(values: ArrayLike) -> Array:
    """Normalised squares as (runs, steps)."""
    v = _numbers("values", values, 0)
    if not v.ndim or not v.size:
        raise InputError(f"values have shape {v.shape}: there is no run, or no step")
    if np.any(v < 0):
        raise InputError(f"values hold {v.min()}, a square cannot be negative")
    return v.reshape(len(v), -1)


def _standard_error(per_run: Array) -> Array:
    """s/√M over the first axis; NaN for M = 1."""
    M = len(per_run)
    return np.asarray(np.std(per_run, axis=0, ddof=1) / np.sqrt(M) if M > 1 else np.full(per_run.shape[1:], np.nan))


def _numbers(name: str, value: ArrayLike, axes: int) -> Array:
    """Finite floats with at least `axes` axes, none of the last `axes` empty."""
    try:
        a = np.asarray(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} must be numbers, given {type(value).__name__}: {error}") from None
    if a.ndim < axes or 0 in a.shape[a.ndim - axes :]:
        raise InputError(f"{name} has shape {a.shape}, expected at least {axes} axes that are not empty")
    if not np.all(np.isfinite(a)):
        index = np.argwhere(~np.isfinite(a))[0]
        raise InputError(f"{name} is not finite at {tuple(map(int, index))}: {a[tuple(index)]}")
    return a


def _dof(dof: ArrayLike) -> Array:
    d = _numbers("dof", dof, 0)
    if np.any(d < 0):
        raise InputError(f"dof is {d.min()}, expected at least 0")
    return d


def _probability(probability: float) -> float:
    if not 0 < probability < 1:
        raise InputError(f"probability is {probability}, expected a number between 0 and 1, both excluded")
    return probability


def _square(matrix: Array, name: str, d: int) -> None:
    if matrix.shape[-2:] != (d, d):
        raise InputError(f"{name} has shape {matrix.shape}, vectors of {d} components need (..., {d}, {d})")


def _symmetric(name: str, matrix: Array) -> None:
    asymmetry = np.abs(matrix - matrix.mT).max(axis=(-2, -1))
    bad = np.argwhere(asymmetry > _ASYMMETRY * np.abs(matrix).max(axis=(-2, -1)))
    if len(bad):
        index = tuple(map(int, bad[0]))
        raise InputError(
            f"{name} is not symmetric{' at ' + str(index) if index else ''}: it differs by {asymmetry[index]:.3g}"
        )


def _broadcast(a_name: str, a: tuple[int, ...], b_name: str, b: tuple[int, ...]) -> tuple[int, ...]:
    try:
        return np.broadcast_shapes(a, b)
    except ValueError:
        raise InputError(f"{a_name} has leading axes {a} and {b_name} {b}: they do not broadcast") from None


def _where(row: int, shape: tuple[int, ...]) -> str:
    return f" at {tuple(map(int, np.unravel_index(row, shape)))}" if shape else ""
