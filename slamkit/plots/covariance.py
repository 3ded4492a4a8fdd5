"""Figures of a covariance: ellipses, the correlation matrix, and how dense it becomes."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from slamkit.arrays import Array
from slamkit.errors import InputError
from slamkit.plots.axes import Artists, add_legend, checked_probability
from slamkit.plots.styles import STYLES

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def ellipses(centres: ArrayLike, covariances: ArrayLike, probability: float = 0.95, points: int = 60) -> Array:
    """Outlines of the smallest regions that contain a planar Gaussian variable with the given probability.

    The outline is the set of points with (x - μ)ᵀ P⁻¹ (x - μ) = q. The χ² quantile with two degrees of freedom is
    q = -2 ln(1 - p), which is 5.991 at 95 %.

    Parameters
    ----------
    centres : array_like (n, 2)
        Means [m].
    covariances : array_like (n, 2, 2)
        Covariances [m²]. A rank-deficient one gives a segment or a point.
    probability : float
        In (0, 1).
    points : int
        Number of points per outline.

    Returns
    -------
    ndarray (n, points, 2)
        Outlines [m]. NaN for a covariance that is not finite or that has an eigenvalue below zero by more than
        rounding: an indefinite matrix has no ellipse.

    Raises
    ------
    InputError
        The numbers of means and covariances differ, or the probability is outside (0, 1).
    """
    mu, P = np.asarray(centres, dtype=float).reshape(-1, 2), np.asarray(covariances, dtype=float).reshape(-1, 2, 2)
    if len(mu) != len(P):
        raise InputError(f"{len(mu)} centres and {len(P)} covariances, expected the same number")
    q = -2.0 * np.log1p(-checked_probability(probability))
    finite = np.isfinite(P).all((1, 2)) & np.isfinite(mu).all(1)
    values, vectors = np.linalg.eigh(np.where(finite[:, None, None], (P + P.swapaxes(1, 2)) / 2, 0.0))
    drawable = finite & (values[:, 0] >= -1e-9 * np.abs(values).max(1))
    axes = vectors * np.sqrt(q * np.maximum(values, 0.0))[:, None, :]
    phi = np.linspace(0.0, 2 * np.pi, points)
    outline = mu[:, None, :] + np.stack([np.cos(phi), np.sin(phi)], -1) @ axes.swapaxes(1, 2)
    return np.where(drawable[:, None, None], outline, np.nan)


def correlation(P: ArrayLike) -> Array:
    """Correlation matrix of a covariance.

    Parameters
    ----------
    P : array_like (D, D)
        Covariance.

    Returns
    -------
    ndarray (D, D)
        P_ij/√(P_ii P_jj). NaN in the rows and columns of a state that is known exactly (zero variance), because the
        correlation is undefined there.

    Raises
    ------
    InputError
        P is not square, or a variance is negative or not finite.
    """
    P = np.asarray(P, dtype=float)
    if P.ndim != 2 or P.shape[0] != P.shape[1]:
        raise InputError(f"P has shape {P.shape}, expected (D, D)")
    variances = np.diag(P)
    if not np.all(variances >= 0) or not np.all(np.isfinite(variances)):
        row = int(np.flatnonzero(~((variances >= 0) & np.isfinite(variances)))[0])
        raise InputError(f"variance {row} of P is {variances[row]}, expected a finite value not below zero")
    sigma = np.where(variances > 0, np.sqrt(variances), np.nan)
    return P / sigma[:, None] / sigma


def correlation_density(P: ArrayLike, threshold: float = 0.1) -> float:
    """Share of the correlations between different blocks of a SLAM covariance that exceed a threshold.

    The blocks are the pose (3 rows) and each landmark (2 rows). A state that is known exactly has no correlation.

    Parameters
    ----------
    P : array_like (3 + 2N, 3 + 2N)
        Covariance.
    threshold : float
        Limit of the absolute correlation.

    Returns
    -------
    float
        In [0, 1]. NaN if there are no landmarks, because there is no pair of blocks.

    Raises
    ------
    InputError
        P has another shape, or a variance is negative or not finite.
    """
    rho = correlation(P)
    if len(rho) < 3 or len(rho) % 2 == 0:
        raise InputError(f"P has shape {rho.shape}, expected (3 + 2N, 3 + 2N): a pose and N landmarks")
    block = np.append(np.zeros(3, dtype=int), 1 + np.arange(len(rho) - 3) // 2)
    pairs = rho[block[:, None] < block]
    return float(np.mean(np.nan_to_num(np.abs(pairs)) > threshold)) if len(pairs) else float("nan")


def plot_correlation(
    ax: Axes,
    P: ArrayLike,
    ids: Sequence[Hashable] | None = None,
    time: float | None = None,
    *,
    max_ids: int = 12,
    colorbar: bool = True,
) -> Artists:
    """Image of the correlation matrix of a SLAM covariance, from -1 to 1, with lines between the blocks.

    Parameters
    ----------
    ax : Axes
    P : array_like (3 + 2N, 3 + 2N)
        Covariance. The rows and columns of a state that is known exactly are grey.
    ids : sequence of N hashables, optional
        Landmark ids in the order of the state.
    time : float, optional
        Time for the title [s].
    max_ids : int
        With more landmarks than this, their number is written instead of their ids.
    colorbar : bool
        Add a colour bar.

    Returns
    -------
    dict
        image, lines, and colorbar (its axes) if there is one.

    Raises
    ------
    InputError
        P is not a covariance, see :func:`correlation`, or the number of ids is not N.
    """
    import matplotlib

    rho = correlation(P)
    N = max(0, (len(rho) - 3) // 2)
    if ids is not None and len(ids) != N:
        raise InputError(f"{len(ids)} ids for a covariance of shape {rho.shape}, which holds {N} landmarks")
    D = len(rho)
    cmap = matplotlib.colormaps["RdBu_r"].with_extremes(bad="0.82")
    image = ax.imshow(
        np.ma.masked_invalid(rho),
        vmin=-1,
        vmax=1,
        cmap=cmap,
        interpolation="nearest",
        extent=(0, D, D, 0),
        rasterized=True,
    )
    artists: Artists = {"image": [image], "lines": []}
    edges = np.arange(3.0, D, 2.0)
    for k, edge in enumerate(edges):
        width = 1.0 if k == 0 else 0.35
        if k == 0 or N <= 30:
            artists["lines"] += [
                ax.axhline(edge, color="0.25", linewidth=width),
                ax.axvline(edge, color="0.25", linewidth=width),
            ]
    centres = [min(1.5, D / 2), *(edges + 1.0)] if max_ids >= N else [1.5, (3 + D) / 2]
    if max_ids < N:
        names = ["pose", f"{N} landmarks"]
    else:
        names = ["pose", *(str(i) for i in (ids if ids is not None else range(1, N + 1)))]
    ax.set_xticks(centres, names, rotation=90 if max_ids / 2 < N and max_ids >= N else 0)
    ax.set_yticks(centres, names, rotation=90 if max_ids < N else 0, va="center")
    ax.tick_params(length=0)
    if time is not None:
        ax.set_title(f"t = {time:g} s", fontsize="medium")
    if colorbar:
        bar = ax.figure.colorbar(image, ax=ax, ticks=[-1, -0.5, 0, 0.5, 1], fraction=0.046, pad=0.03)
        bar.set_label("correlation")
        artists["colorbar"] = [bar.ax]
    return artists


def plot_density(
    ax: Axes,
    covariances: Sequence[ArrayLike],
    times: ArrayLike | None = None,
    *,
    thresholds: Sequence[float] = (0.1, 0.5, 0.9),
    legend: bool = True,
) -> Artists:
    """Density of a covariance over time: the share of correlations between blocks above each threshold.

    Parameters
    ----------
    ax : Axes
    covariances : sequence of array_like (3 + 2N, 3 + 2N)
        One covariance for each time. N may grow.
    times : array_like (n,), optional
        Times of the covariances [s]. Without them the horizontal axis is the number of landmarks.
    thresholds : sequence of float
        Limits of the absolute correlation. Each gets one line.
    legend : bool
        False if :func:`shared_legend` or the caller adds one.

    Returns
    -------
    dict
        density: one line for each threshold [%].

    Raises
    ------
    InputError
        A covariance is not valid, see :func:`correlation_density`, or there is not one time for each.
    """
    matrices = [np.asarray(P, dtype=float) for P in covariances]
    x = np.array([(len(P) - 3) // 2 for P in matrices]) if times is None else np.asarray(times, dtype=float)
    if x.shape != (len(matrices),):
        raise InputError(f"times have shape {x.shape}, {len(matrices)} covariances need ({len(matrices)},)")
    dashes: list[Any] = ["-", (0, (5, 1.6)), (0, (1.2, 1.2)), (0, (5, 1.5, 1, 1.5))]
    artists: Artists = {
        "density": [
            ax.plot(
                x,
                [100 * correlation_density(P, limit) for P in matrices],
                color=STYLES["landmarks"].color,
                linestyle=dashes[k % len(dashes)],
                marker="osv^"[k % 4] if len(matrices) <= 25 else "none",
                markersize=3.5,
                label=f"|correlation| > {limit:g}",
            )[0]
            for k, limit in enumerate(thresholds)
        ]
    }
    ax.set(xlabel="landmarks in the map" if times is None else "time [s]", ylabel="share of correlations [%]")
    ax.set_ylim(-3, 103)
    if legend:
        add_legend(ax)
    return artists
