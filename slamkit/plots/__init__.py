"""Figures: functions that take a matplotlib Axes, draw, and return the artists that they drew.

One palette and one legend style throughout: :data:`STYLES` gives truth, dead reckoning, landmarks and every filter
(by its command-line name) the same colour in every figure, and a dash pattern and a marker of their own, so that a
figure can be read in grey and by a colour-blind reader. Artists come back as a dict: meaning → list of artists.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slamkit import se2
from slamkit.errors import InputError
from slamkit.evaluate import chi2_bounds, trajectory
from slamkit.logs import History, Log, Truth

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend

Array = NDArray[np.float64]
Artists = dict[str, "list[Artist]"]


@dataclass(frozen=True)
class Style:
    """How one thing looks in every figure.

    Parameters
    ----------
    label : str
        Its name in legends.
    color : str
        Hexadecimal RGB.
    dashes : tuple of float
        Lengths of dash, gap, dash, … [line widths]; empty for a solid line.
    marker : str
        Marker of matplotlib.
    """

    label: str
    color: str
    dashes: tuple[float, ...]
    marker: str

    @property
    def linestyle(self) -> str | tuple[float, tuple[float, ...]]:
        """The dash pattern in matplotlib's form."""
        return (0.0, self.dashes) if self.dashes else "-"


#: Truth, dead reckoning, landmarks and every filter by its command-line name. The first colours are Okabe & Ito's
#: (Color Universal Design, 2008); the others were chosen so that any two differ by more than 14 in CIELAB, for normal
#: sight and for protanopia, deuteranopia and tritanopia as Machado, Oliveira & Fernandes (2009) simulate them.
#: Add an entry to give a filter of your own a look of its own.
STYLES: dict[str, Style] = {
    "truth": Style("truth", "#000000", (), "x"),
    "dead_reckoning": Style("dead reckoning", "#666666", (1.0, 1.4), "."),
    "landmarks": Style("landmarks", "#009E73", (), "+"),
    "ekf": Style("EKF", "#D55E00", (), "o"),
    "fej": Style("FEJ-EKF", "#0072B2", (5.0, 1.6), "s"),
    "oc": Style("OC-EKF", "#56B4E9", (5.0, 1.5, 1.0, 1.5), "^"),
    "invariant": Style("invariant EKF", "#CC79A7", (2.5, 1.2), "D"),
    "iterated": Style("iterated EKF", "#E69F00", (1.6, 1.0), "v"),
    "ideal": Style("ideal EKF", "#1A3A5A", (9.0, 2.0), "*"),
    "robocentric": Style("robocentric EKF", "#5C0029", (7.0, 1.5, 1.0, 1.5, 1.0, 1.5), "P"),
    "ukf": Style("UKF", "#785EF0", (9.0, 1.5, 3.0, 1.5), "X"),
    "ukf-full": Style("UKF, full", "#4B0092", (3.0, 3.0), "<"),
    "oc-ukf": Style("OC-UKF", "#3B3B00", (5.0, 1.2, 1.0, 1.2, 1.0, 1.2, 1.0, 1.2), ">"),
}

_FORMATS: dict[str, dict[str, None]] = {
    ".png": {"Software": None},
    ".pdf": {"CreationDate": None, "Producer": None, "Creator": None},
    ".svg": {"Date": None, "Creator": None},
}

_PAPER: Any = {
    "font.size": 9.0,
    "axes.linewidth": 0.7,
    "axes.labelsize": 9.0,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "lines.linewidth": 1.2,
    "mathtext.default": "regular",
}


def style(name: str) -> Style:
    """Style of a filter by its command-line name; a name that is not in :data:`STYLES` is drawn in a neutral grey."""
    return STYLES.get(name, Style(name, "#444444", (4.0, 2.0), "h"))


def save(figure: Figure, path: str | Path, dpi: float = 300.0) -> Path:
    """Write a figure to a file, cropped to what is drawn; the same figure gives the same bytes.

    Parameters
    ----------
    figure : Figure
    path : str or Path
        Ends in .png, .pdf or .svg; its folder exists.
    dpi : float
        Dots an inch, of a PNG and of the rasterised parts of the others.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        Another ending, or no such folder.
    """
    import matplotlib

    path = Path(path)
    if path.suffix.lower() not in _FORMATS:
        raise InputError(f"figure file {path} ends in {path.suffix!r}, expected one of {', '.join(_FORMATS)}")
    if not path.parent.is_dir():
        raise InputError(f"figure file {path}: there is no folder {path.parent}")
    # Type 42 embeds whole TrueType fonts, which journals ask for; the salt makes the ids inside an SVG repeatable.
    with matplotlib.rc_context({"svg.hashsalt": "slamkit", "pdf.fonttype": 42}):
        figure.savefig(path, dpi=dpi, bbox_inches="tight", pad_inches=0.05, metadata=_FORMATS[path.suffix.lower()])
    return path


def ellipses(
    centres: ArrayLike, covariances: ArrayLike, probability: float = 0.95, points: int = 60
) -> NDArray[np.float64]:
    """Outlines of the smallest regions that hold a planar Gaussian with the given probability.

    The outline is where (x - μ)ᵀ P⁻¹ (x - μ) = q; with two degrees of freedom the χ² quantile is q = -2 ln(1 - p),
    5.991 at 95 %.

    Parameters
    ----------
    centres : array_like (n, 2)
        Means [m].
    covariances : array_like (n, 2, 2)
        Covariances [m²]; rank-deficient ones give a segment or a point.
    probability : float
        In (0, 1).
    points : int
        Points an outline.

    Returns
    -------
    ndarray (n, points, 2)
        Outlines [m]; NaN where a covariance is not finite or has an eigenvalue below zero by more than rounding:
        an indefinite matrix has no ellipse.

    Raises
    ------
    InputError
        Shapes that do not fit, or a probability outside (0, 1).
    """
    mu, P = np.asarray(centres, dtype=float).reshape(-1, 2), np.asarray(covariances, dtype=float).reshape(-1, 2, 2)
    if len(mu) != len(P):
        raise InputError(f"{len(mu)} centres and {len(P)} covariances, expected as many of each")
    q = -2.0 * np.log1p(-_probability(probability))
    finite = np.isfinite(P).all((1, 2)) & np.isfinite(mu).all(1)
    values, vectors = np.linalg.eigh(np.where(finite[:, None, None], (P + P.swapaxes(1, 2)) / 2, 0.0))
    drawable = finite & (values[:, 0] >= -1e-9 * np.abs(values).max(1))
    axes = vectors * np.sqrt(q * np.maximum(values, 0.0))[:, None, :]
    phi = np.linspace(0.0, 2 * np.pi, points)
    outline = mu[:, None, :] + np.stack([np.cos(phi), np.sin(phi)], -1) @ axes.swapaxes(1, 2)
    return np.where(drawable[:, None, None], outline, np.nan)


def plot_map(
    ax: Axes,
    history: History,
    truth: Truth | None = None,
    dead_reckoning: tuple[ArrayLike, ArrayLike] | None = None,
    alignment: ArrayLike | None = None,
    *,
    probability: float = 0.95,
    pose_ellipses: int = 8,
    max_ids: int = 30,
    legend: bool = True,
) -> Artists:
    """Trajectory and map with their ellipses, against truth and dead reckoning.

    Parameters
    ----------
    ax : Axes
    history : History
    truth : Truth, optional
    dead_reckoning : (times (n,), poses (n, 3)), optional
        The motion model alone, from the pose at which the filter started.
    alignment : array_like (3,), optional
        Rigid motion [m, m, rad] from the filter's frame to the truth's. It moves the estimate and the dead reckoning
        alike, since both start at the same pose.
    probability : float
        What an ellipse holds.
    pose_ellipses : int
        Number of poses, evenly spaced and the last among them, that get an ellipse.
    max_ids : int
        Landmark ids are written while there are no more than this.
    legend : bool
        False where :func:`shared_legend` or the caller makes one.

    Returns
    -------
    dict
        truth, dead_reckoning, estimate, pose_ellipses, true_landmarks, landmarks, landmark_ellipses, start, ids: those
        that were drawn; coordinates in metres.
    """
    frame = _alignment(alignment)
    C = se2.rotation(frame[2])
    look, ground = style(history.filter), STYLES["truth"]
    artists: Artists = {}
    if truth is not None and len(truth.poses):
        sparse = _sparse(truth.times, history.times)
        artists["truth"] = [
            *ax.plot(
                *_broken(truth.times, *truth.poses[:, :2].T),
                color=ground.color,
                linestyle="none" if sparse else "-",
                marker="." if sparse else "none",
                markersize=2.5,
                linewidth=1.0,
                label="truth",
                zorder=2.2,
            )
        ]
    if dead_reckoning is not None:
        poses = np.asarray(dead_reckoning[1], dtype=float).reshape(-1, 3)
        odometry = STYLES["dead_reckoning"]
        artists["dead_reckoning"] = [
            *ax.plot(
                *se2.transform(frame, poses[:, :2]).T,
                color=odometry.color,
                linestyle=odometry.linestyle,
                linewidth=1.0,
                label=odometry.label,
                zorder=2.1,
            )
        ]
    path = se2.transform(frame, history.poses[:, :2].reshape(-1, 2))
    artists["estimate"] = [
        *ax.plot(*path.T, color=look.color, linestyle=look.linestyle, linewidth=1.2, label=look.label, zorder=2.5)
    ]
    if len(path):
        artists["start"] = [
            *ax.plot(
                *path[0],
                color=look.color,
                marker="o",
                markersize=5,
                markerfacecolor="white",
                linestyle="none",
                label="start",
                zorder=3,
            )
        ]
    at = np.unique(np.linspace(0, max(len(path) - 1, 0), pose_ellipses + 1)[1:].round().astype(int))[: len(path)]
    if len(at):
        P = C @ history.pose_covariances[at][:, :2, :2] @ C.T
        outlines = ellipses(path[at], P, probability)
        artists["pose_ellipses"] = [_outlines(ax, outlines, look.color, f"{probability:.0%} of the pose", filled=True)]
    if truth is not None and len(truth.landmarks):
        positions = np.array(list(truth.landmarks.values()))
        artists["true_landmarks"] = [
            *ax.plot(
                *positions.T,
                color=ground.color,
                marker=ground.marker,
                linestyle="none",
                markersize=4.5,
                markeredgewidth=0.9,
                label="true landmarks",
                zorder=2.6,
            )
        ]
    if len(history.landmarks):
        look = STYLES["landmarks"]
        positions = se2.transform(frame, history.landmarks)
        artists["landmarks"] = [
            *ax.plot(
                *positions.T,
                color=look.color,
                marker=look.marker,
                linestyle="none",
                markersize=5,
                markeredgewidth=1.1,
                label=look.label,
                zorder=2.8,
            )
        ]
        outlines = ellipses(positions, C @ history.landmark_covariances @ C.T, probability)
        artists["landmark_ellipses"] = [
            _outlines(ax, outlines, look.color, f"{probability:.0%} of the landmarks", filled=False)
        ]
        if len(positions) <= max_ids:
            from matplotlib.patheffects import withStroke

            halo = [withStroke(linewidth=1.5, foreground="white")]
            artists["ids"] = [
                ax.annotate(
                    str(i),
                    p,
                    xytext=(3.5, 3.5),
                    textcoords="offset points",
                    fontsize=7,
                    color="0.2",
                    path_effects=halo,
                    zorder=3,
                )
                for i, p in zip(history.landmark_ids, positions, strict=True)
            ]
    ax.set(xlabel="x [m]", ylabel="y [m]")
    ax.margins(0.06)
    ax.set_aspect("equal", adjustable="datalim")
    if legend:
        _legend(ax)
    return artists


def plot_errors(
    axes: Sequence[Axes] | NDArray[Any],
    history: History,
    truth: Truth | None = None,
    alignment: ArrayLike | None = None,
    *,
    sigmas: float = 3.0,
    tolerance: float = 0.1,
    legend: bool = True,
) -> Artists:
    """Error of x, y and heading over time within the claimed ±3σ.

    The error is estimate minus truth at the nearest time, never interpolated; the heading's is wrapped to ±180°.

    Parameters
    ----------
    axes : three Axes
        For x [m], y [m] and heading [deg].
    history : History
    truth : Truth, optional
        Without it the claimed band alone is drawn.
    alignment : array_like (3,), optional
        Rigid motion [m, m, rad] from the filter's frame to the truth's, for estimate and covariance.
    sigmas : float
        Half width of the band in claimed standard deviations.
    tolerance : float
        Largest time [s] between an estimate and its truth, as in :func:`slamkit.evaluate.trajectory.evaluate`.
    legend : bool
        False where :func:`shared_legend` or the caller makes one.

    Returns
    -------
    dict
        band (3), and error (3) where a truth fits: time [s] since the first step against [m], [m], [deg].
    """
    axes = list(axes)
    if len(axes) != 3:
        raise InputError(f"plot_errors was given {len(axes)} axes, expected 3: for x, y and heading")
    frame = _alignment(alignment)
    look = style(history.filter)
    T = np.eye(3)
    T[:2, :2] = se2.rotation(frame[2])
    to_units = np.array([1.0, 1.0, np.degrees(1.0)])
    variances = np.einsum("ij,kjl,il->ki", T, history.pose_covariances.reshape(-1, 3, 3), T)
    # A negative variance has no deviation: the band shows a gap there.
    band = sigmas * np.sqrt(np.where(variances >= 0, variances, np.nan)) * to_units
    elapsed = _elapsed(history.times, history.times)
    artists: Artists = {
        "band": [
            ax.fill_between(
                elapsed, -b, b, facecolor=look.color, alpha=0.22, linewidth=0, label=f"claimed ±{sigmas:g}σ", zorder=1
            )
            for ax, b in zip(axes, band.T, strict=True)
        ]
    }
    for ax, b in zip(axes, band.T, strict=True):
        ax.plot(elapsed, b, elapsed, -b, color=look.color, linewidth=0.6, zorder=1.5)
    rows, matched = trajectory.nearest(history.times, () if truth is None else truth.times, tolerance)
    if truth is not None and len(rows):
        error = se2.compose(frame, history.poses[rows]) - truth.poses[matched]
        error[:, 2] = se2.wrap(error[:, 2])
        sparse = _sparse(truth.times, history.times)
        artists["error"] = [
            ax.plot(
                *_broken(elapsed[rows], elapsed[rows], e),
                color=STYLES["truth"].color,
                linestyle="none" if sparse else "-",
                marker="." if sparse else "none",
                markersize=3,
                linewidth=0.8,
                label=f"error of the {look.label}",
                zorder=2,
            )[0]
            for ax, e in zip(axes, (error * to_units).T, strict=True)
        ]
    for ax, label in zip(axes, ("x [m]", "y [m]", "heading [deg]"), strict=True):
        ax.axhline(0.0, color="0.6", linewidth=0.5, zorder=0.5)
        ax.set_ylabel(label)
        ax.margins(x=0)
    axes[-1].set_xlabel("time since start [s]")
    if legend:
        _legend(axes[0])
    return artists


def plot_nis(
    ax: Axes,
    history: History,
    *,
    window: int | None = None,
    probability: float = 0.95,
    log: bool | None = None,
    legend: bool = True,
) -> Artists:
    """Normalised innovation squared over time with its χ² bands.

    A consistent filter's yᵀS⁻¹y is χ² with the innovation's d degrees of freedom, and the mean of n independent ones
    is χ²_{nd}/n (Bar-Shalom, Li & Kirubarajan 2001, section 5.4).

    Parameters
    ----------
    ax : Axes
    history : History
    window : int, optional
        Number of accepted sightings in the running mean; by default a fortieth of them, within 10 … 200.
    probability : float
        What a band holds.
    log : bool, optional
        Logarithmic axis; by default where a value lies above four times the single sighting's band.
    legend : bool
        False where :func:`shared_legend` or the caller makes one.

    Returns
    -------
    dict
        nis, rejected, mean, band, mean_band: those that were drawn; time [s] since the first step against NIS [1].
    """
    p, d, look = _probability(probability), history.dof, style(history.filter)
    elapsed = _elapsed(history.observation_times, history.times)
    known = np.isfinite(history.nis)
    accepted, rejected = known & history.accepted, known & ~history.accepted
    t, nis = elapsed[accepted], history.nis[accepted]
    artists: Artists = {}
    ax.set(xlabel="time since start [s]", ylabel="NIS")
    ax.margins(x=0)
    if not known.any():
        ax.text(0.5, 0.5, "no innovations", transform=ax.transAxes, ha="center", va="center", color="0.4")
        ax.set_yticks([])
        return artists
    one = chi2_bounds(d, 1, p)
    low, high = float(one.lower), float(one.upper)
    artists["band"] = [
        ax.axhspan(low, high, facecolor="0.5", alpha=0.13, linewidth=0, label=f"{p:.0%} band, one sighting", zorder=0.5)
    ]
    artists["nis"] = [
        *ax.plot(
            t,
            nis,
            color=look.color,
            marker=".",
            linestyle="none",
            markersize=2.5,
            markeredgewidth=0,
            alpha=0.35,
            label=f"one sighting ({look.label})",
            rasterized=True,
            zorder=1.5,
        )
    ]
    if rejected.any():
        artists["rejected"] = [
            *ax.plot(
                elapsed[rejected],
                history.nis[rejected],
                color="black",
                marker="x",
                linestyle="none",
                markersize=4,
                markeredgewidth=0.8,
                label=f"rejected ({np.count_nonzero(rejected)})",
                zorder=2,
            )
        ]
    n = int(np.clip(len(nis) // 40, 10, 200)) if window is None else int(window)
    if n < 1:
        raise InputError(f"window is {n} sightings, expected at least 1")
    if len(nis) >= n:
        mean = chi2_bounds(d, n, p)
        artists["mean_band"] = [
            ax.axhspan(
                float(mean.lower),
                float(mean.upper),
                facecolor="0.35",
                alpha=0.3,
                linewidth=0,
                label=f"{p:.0%} band, mean",
                zorder=1,
            )
        ]
        artists["mean"] = [
            *ax.plot(
                _running_mean(t, n),
                _running_mean(nis, n),
                color="black",
                linewidth=1.1,
                label=f"mean of {n}",
                zorder=2.5,
            )
        ]
    highest = float(history.nis[known].max())
    if highest > 4 * high if log is None else log:
        _log_scale(ax)
        ax.set_ylim(low / 4, 2 * max(highest, high))
    else:
        ax.set_ylim(0, 1.05 * max(highest, high))
    if len(history.times):
        ax.set_xlim(0, max(float(elapsed.max()), float(history.times.max() - history.times.min()), 1e-9))
    if legend:
        _legend(ax)
    return artists


def correlation(P: ArrayLike) -> Array:
    """Correlation matrix of a covariance.

    Parameters
    ----------
    P : array_like (D, D)
        Covariance.

    Returns
    -------
    ndarray (D, D)
        P_ij/√(P_ii P_jj); NaN in the rows and columns of an exactly known state (zero variance), where it is undefined.

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

    The blocks are the pose (3) and each landmark (2). A state that is exactly known correlates with nothing.

    Parameters
    ----------
    P : array_like (3 + 2N, 3 + 2N)
        Covariance.
    threshold : float
        On the absolute correlation.

    Returns
    -------
    float
        In [0, 1]; NaN without a landmark, where there is no pair of blocks.

    Raises
    ------
    InputError
        P is not of that shape, or a variance is negative or not finite.
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
    """Correlation matrix of a SLAM covariance as an image from -1 to 1, with lines between pose and landmarks.

    Parameters
    ----------
    ax : Axes
    P : array_like (3 + 2N, 3 + 2N)
        Covariance; rows of an exactly known state are drawn in grey.
    ids : sequence of N hashables, optional
        Landmark ids in the order of the state; written while there are no more than `max_ids`.
    time : float, optional
        Time [s] for the title.
    max_ids : int
    colorbar : bool

    Returns
    -------
    dict
        image, lines, and colorbar (its axes) where there is one.

    Raises
    ------
    InputError
        As :func:`correlation`, or ids that do not fit P.
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
    """How a covariance becomes dense: the share of correlations between blocks above each threshold.

    Parameters
    ----------
    ax : Axes
    covariances : sequence of array_like (3 + 2N, 3 + 2N)
        One covariance an instant; N may grow.
    times : array_like (n,), optional
        Times [s] of the covariances; without them the horizontal axis counts landmarks.
    thresholds : sequence of float
        On the absolute correlation; one line each.
    legend : bool
        False where :func:`shared_legend` or the caller makes one.

    Returns
    -------
    dict
        density: one line a threshold; values in percent.

    Raises
    ------
    InputError
        As :func:`correlation_density`, or times that do not fit.
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
        _legend(ax)
    return artists


def overview(
    history: History,
    log: Log | None = None,
    dead_reckoning: tuple[ArrayLike, ArrayLike] | None = None,
    *,
    truth: Truth | None = None,
    alignment: ArrayLike | None = None,
    title: str | None = None,
    size: tuple[float, float] = (10.0, 7.5),
) -> Figure:
    """One run at a glance: the map, the errors within their claims, and the NIS.

    Parameters
    ----------
    history : History
    log : Log, optional
        Its truth is used where `truth` is not given.
    dead_reckoning : (times (n,), poses (n, 3)), optional
    truth : Truth, optional
    alignment : array_like (3,), optional
        Rigid motion [m, m, rad] from the filter's frame to the truth's, as
        :func:`slamkit.evaluate.trajectory.align` gives it.
    title : str, optional
        By default the filter's name and what it took in.
    size : (float, float)
        Width and height [in].

    Returns
    -------
    Figure
        Write it with :func:`save`.
    """
    import matplotlib
    from matplotlib.figure import Figure

    if truth is None and log is not None:
        truth = log.truth
    with matplotlib.rc_context(_PAPER):
        figure = Figure(figsize=size, layout="constrained")
        panels = figure.subplot_mosaic(
            [["map", "x"], ["map", "y"], ["map", "heading"], ["nis", "nis"]],
            width_ratios=[1.35, 1.0],
            height_ratios=[1.0, 1.0, 1.0, 1.15],
        )
        errors = [panels["x"], panels["y"], panels["heading"]]
        plot_map(panels["map"], history, truth, dead_reckoning, alignment)
        plot_errors(errors, history, truth, alignment)
        plot_nis(panels["nis"], history)
        for ax in errors[:2]:
            ax.sharex(errors[2])
            ax.tick_params(labelbottom=False)
        figure.align_ylabels(errors)
        count = f"{len(history.times)} steps, {len(history.nis)} sightings, {len(history.landmarks)} landmarks"
        figure.suptitle(f"{style(history.filter).label}: {count}" if title is None else title, fontsize=10)
    return figure


def plot_nees(
    ax: Axes,
    times: ArrayLike,
    nees: Mapping[str, ArrayLike],
    dof: int,
    *,
    probability: float = 0.95,
    label: str = "NEES",
    log: bool | None = None,
    points: int = 400,
    legend: bool = True,
) -> Artists:
    """Mean NEES over the runs of every filter over time, with its χ² band.

    The mean of M independent runs of a consistent filter is χ²_{Md}/M (Bar-Shalom, Li & Kirubarajan 2001, 5.4) at one
    instant; means over several steps, too, scatter less.

    Parameters
    ----------
    ax : Axes
    times : array_like (K,)
        Times [s].
    nees : mapping filter → array_like (M, K) or (K,)
        One row a run; NaN where a run has no value.
    dof : int
        Degrees of freedom of one value.
    probability : float
        What the band holds. It is drawn for the largest number of runs that any filter has.
    label : str
        Of the vertical axis.
    log : bool, optional
        Logarithmic axis; by default where a mean lies above five times the band.
    points : int
        A longer run is drawn by this many means over consecutive steps at most.
    legend : bool
        False where :func:`shared_legend` or the caller makes one.

    Returns
    -------
    dict
        band, and one entry a filter.
    """
    t, p = np.asarray(times, dtype=float), _probability(probability)
    values = {name: _runs(name, v, t) for name, v in nees.items()}
    M = max((len(v) for v in values.values()), default=1)
    bounds = chi2_bounds(dof, M, p)
    low, high = float(bounds.lower), float(bounds.upper)
    artists: Artists = {
        "band": [
            ax.axhspan(
                low,
                high,
                facecolor="0.5",
                alpha=0.3,
                linewidth=0,
                zorder=0.5,
                label=f"{p:.0%} band, {_count(M, 'run')}",
            )
        ]
    }
    ax.axhline(dof, color="0.4", linewidth=0.6, zorder=0.6)
    n = max(1, -(-len(t) // points))
    means = {name: _block_means(_mean(v), n) for name, v in values.items()}
    artists |= _lines(ax, _block_means(t, n), means)
    highest = max((float(np.nanmax(m)) for m in means.values() if np.isfinite(m).any()), default=high)
    if highest > 5 * high if log is None else log:
        _log_scale(ax)
    else:
        ax.set_ylim(0, 1.05 * max(highest, 1.5 * high))
    ax.set(xlabel=_time_label(n), ylabel=label)
    ax.margins(x=0)
    if legend:
        _legend(ax)
    return artists


def plot_claim(
    ax: Axes,
    name: str,
    times: ArrayLike,
    errors: ArrayLike,
    deviations: ArrayLike,
    *,
    sigmas: float = 3.0,
    label: str = "heading error [deg]",
    lines: int = 10,
    points: int = 400,
    legend: bool = True,
) -> Artists:
    """What one filter claims against what it does: the errors of some runs, the spread of all and the claimed ±3σ.

    Parameters
    ----------
    ax : Axes
    name : str
        The filter.
    times : array_like (K,)
        Times [s].
    errors, deviations : array_like (M, K) or (K,)
        Error and claimed standard deviation of each run, in the unit that `label` names; NaN where there is none.
    sigmas : float
    label : str
        Of the vertical axis.
    lines : int
        The errors of the first runs are drawn, so many at most; claim and spread are over all of them.
    points : int
        In a longer run claim and spread are root means over consecutive steps, too, so that there are no more points
        than these; of the errors as many steps are drawn.
    legend : bool
        False where :func:`shared_legend` or the caller makes one.

    Returns
    -------
    dict
        errors (one line a run), band (claimed: ±sigmas times the root mean variance), spread (±sigmas times the
        root mean square error; empty for one run, of which it says nothing).
    """
    from matplotlib.patheffects import withStroke

    t, look = np.asarray(times, dtype=float), style(name)
    e, s = _runs(name, errors, t), _runs(name, deviations, t)
    n = max(1, -(-len(t) // points))
    claimed, actual = (sigmas * np.sqrt(_block_means(_mean(v**2), n)) for v in (s, e))
    steps, t = t[::n], _block_means(t, n)
    band = ax.fill_between(
        t, -claimed, claimed, facecolor=look.color, alpha=0.28, linewidth=0, label=f"claimed ±{sigmas:g}σ", zorder=1
    )
    ax.plot(t, claimed, t, -claimed, color=look.color, linewidth=1.0, zorder=2.2)
    shown = e[:lines, ::n]
    faint: dict[str, Any] = {"color": "0.4", "linewidth": 0.4, "alpha": 0.7, "rasterized": True}
    runs = ax.plot(steps, shown.T, zorder=1.5, **(faint if len(e) > 1 else {"color": "black", "linewidth": 0.6}))
    if runs:
        of = "" if len(shown) == len(e) else f"{len(shown)} of "
        runs[0].set_label(f"error of {of}{_count(len(e), 'run')}")
    spread: list[Artist] = []
    if len(e) > 1:
        dashed: dict[str, Any] = {"color": "black", "linewidth": 1.0, "linestyle": (0, (4, 1.5)), "zorder": 2.4}
        spread += ax.plot(t, actual, label=f"±{sigmas:g} RMSE", **dashed)
        spread += ax.plot(t, -actual, **dashed)
    ax.text(
        0.02,
        0.97,
        look.label,
        transform=ax.transAxes,
        va="top",
        fontweight="bold",
        color=look.color,
        path_effects=[withStroke(linewidth=2.5, foreground="white")],
        zorder=3,
    )
    ax.set(xlabel=_time_label(n), ylabel=label)
    ax.margins(x=0, y=0.14)  # above, room for the name
    if legend:
        _legend(ax)
    return {"errors": [*runs], "band": [band], "spread": spread}


def plot_gauge(
    ax: Axes,
    times: ArrayLike,
    deviations: Mapping[str, ArrayLike],
    *,
    label: str = "gauge deviation [deg]",
    legend: bool = True,
) -> Artists:
    """Standard deviation that each filter claims along the unobservable rotation; it may never fall.

    Parameters
    ----------
    ax : Axes
    times : array_like (K,)
        Times [s].
    deviations : mapping filter → array_like (M, K) or (K,)
        √[(NᵀP⁻¹N)⁻¹]_θθ in the unit that `label` names; the root mean square over the runs is drawn.
    label : str
        Of the vertical axis.
    legend : bool
        False where :func:`shared_legend` or the caller makes one.

    Returns
    -------
    dict
        One entry a filter.
    """
    t = np.asarray(times, dtype=float)
    artists = _lines(ax, t, {name: np.sqrt(_mean(_runs(name, v, t) ** 2)) for name, v in deviations.items()})
    ax.set(xlabel="time [s]", ylabel=label)
    ax.set_ylim(0, 1.08 * ax.dataLim.y1 if np.isfinite(ax.dataLim.y1) and ax.dataLim.y1 > 0 else 1.0)
    ax.margins(x=0)
    if legend:
        _legend(ax)
    return artists


def plot_coverage(ax: Axes, levels: ArrayLike, coverage: Mapping[str, ArrayLike], *, legend: bool = True) -> Artists:
    """Coverage curves: how often the truth lay in the region that each filter claimed to hold it.

    Parameters
    ----------
    ax : Axes
    levels : array_like (n,)
        Claimed probabilities in [0, 1].
    coverage : mapping filter → array_like (n,)
        Share of the values inside, in [0, 1].
    legend : bool
        False where :func:`shared_legend` or the caller makes one.

    Returns
    -------
    dict
        diagonal, and one entry a filter; values in percent.
    """
    x = np.asarray(levels, dtype=float)
    diagonal = ax.plot([0, 100], [0, 100], color="0.55", linewidth=3.0, alpha=0.6, label="consistent", zorder=1)
    lines = _lines(ax, 100 * x, {name: 100 * _runs(name, c, x)[0] for name, c in coverage.items()})
    ax.set(xlabel="claimed probability [%]", ylabel="truth inside [%]", xlim=(0, 100), ylim=(0, 100))
    ax.set_aspect("equal", adjustable="box")
    if legend:
        _legend(ax)
    return {"diagonal": [*diagonal], **lines}


def plot_bars(
    ax: Axes,
    values: Mapping[str, float],
    errors: Mapping[str, float] | None = None,
    *,
    label: str,
    band: tuple[float, float] | None = None,
    reference: float | None = None,
) -> Artists:
    """One bar a filter with its error, the first on top.

    Parameters
    ----------
    ax : Axes
    values : mapping filter → float
        NaN (no value) leaves the place empty.
    errors : mapping filter → float, optional
        Half lengths of the error bars, for example standard errors over the runs.
    label : str
        Of the horizontal axis, with its unit.
    band : (float, float), optional
        Where the value of a consistent filter lies; what exceeds it is written in bold.
    reference : float, optional
        What a value is expected to be, > 0, for values that compare by ratio, as NEES does with its degrees of freedom:
        the axis is logarithmic and a bar is what the value differs by.

    Returns
    -------
    dict
        band, and one entry a filter: the bar, then its value as text.
    """
    from matplotlib.patheffects import withStroke

    artists: Artists = {}
    if band is not None:
        artists["band"] = [ax.axvspan(*band, facecolor="0.5", alpha=0.3, linewidth=0, zorder=0.5)]
    if reference is not None:
        ax.axvline(reference, color="0.25", linewidth=0.8, zorder=0.6)
    start = 0.0 if reference is None else reference
    ends = [start, *(band or ())]
    for row, (name, value) in enumerate(values.items()):
        error = float((errors or {}).get(name, 0.0))
        look = style(name)
        bar = ax.barh(
            row,
            value - start,
            left=start,
            xerr=error if error > 0 else None,
            height=0.7,
            color=look.color,
            edgecolor="black",
            linewidth=0.4,
            error_kw={"elinewidth": 1.0, "capsize": 2.5, "ecolor": "0.15"},
        )
        if bar.errorbar is not None:
            for line in bar.errorbar.get_children():
                # On a dark bar a dark line would not be seen.
                line.set_path_effects([withStroke(linewidth=2.4, foreground="white")])
        end = max(value + max(error, 0.0), start)
        text = (
            []
            if not np.isfinite(end)
            else [
                ax.annotate(
                    f"{value:#.3g}".rstrip("."),
                    (end, row),
                    xytext=(4, 0),
                    textcoords="offset points",
                    va="center",
                    fontsize="small",
                    fontweight="bold" if band is not None and value > band[1] else "normal",
                )
            ]
        )
        ends.append(end)
        if reference is not None and value > 0:
            ends.append(max(value - max(error, 0.0), value / 3))
        artists[name] = [*bar.patches, *text]
    ax.set_yticks(range(len(values)), [style(name).label for name in values])
    ax.set_ylim(len(values) - 0.4, -0.6)
    if reference is None:
        ax.set_xlim(0, 1.25 * np.nanmax(ends) or 1.0)
    else:
        low, high = np.nanmin(ends), np.nanmax(ends)
        _log_scale(ax, "x")
        ax.set_xlim(low / 1.3, 1.1 * high * (high / low) ** 0.25)
        _log_ticks(ax)
    ax.tick_params(axis="y", length=0)
    ax.set_xlabel(label)
    return artists


def plot_cost(
    ax: Axes,
    seconds: Mapping[str, float],
    accuracy: Mapping[str, float],
    errors: Mapping[str, float] | None = None,
    *,
    label: str = "position RMSE [m]",
    legend: bool = True,
) -> Artists:
    """Accuracy against cost: one marker a filter, the best at the lower left.

    Parameters
    ----------
    ax : Axes
    seconds : mapping filter → float
        Time of one step [s]; positive.
    accuracy : mapping filter → float
        Error in the unit that `label` names; the filters of `seconds`.
    errors : mapping filter → float, optional
        Half lengths of the error bars.
    label : str
        Of the vertical axis.
    legend : bool
        False where :func:`shared_legend` or the caller makes one.

    Returns
    -------
    dict
        One entry a filter; time in microseconds.

    Raises
    ------
    InputError
        A filter that has a time but no accuracy.
    """
    missing = [name for name in seconds if name not in accuracy]
    if missing:
        raise InputError(f"no accuracy for {', '.join(missing)}; given: {', '.join(accuracy)}")
    artists: Artists = {}
    for name, cost in seconds.items():
        look = style(name)
        artists[name] = [
            *ax.plot(
                1e6 * cost,
                accuracy[name],
                color=look.color,
                marker=look.marker,
                markersize=7,
                markeredgecolor="black",
                markeredgewidth=0.5,
                linestyle="none",
                label=look.label,
                zorder=3,
            )
        ]
        error = (errors or {}).get(name)
        if error is not None:
            container = ax.errorbar(
                1e6 * cost, accuracy[name], yerr=error, fmt="none", ecolor=look.color, elinewidth=1.0, capsize=2.5
            )
            artists[name] += container.get_children()
    _log_scale(ax, "x")
    ax.set(xlabel="time of a step [µs]", ylabel=label)
    ax.margins(0.12)
    _log_ticks(ax)
    ax.grid(True, which="major", color="0.9", linewidth=0.6)
    ax.set_axisbelow(True)
    if legend:
        _legend(ax)
    return artists


def shared_legend(figure: Figure, axes: Sequence[Axes] | NDArray[Any]) -> Legend:
    """One legend for several axes, above them all; what occurs in more than one of them is named once.

    Parameters
    ----------
    figure : Figure
        With the constrained layout, which makes room for it.
    axes : sequence of Axes
        Drawn with ``legend=False``.

    Returns
    -------
    Legend
    """
    named: dict[str, Any] = {}
    for ax in np.ravel(np.asarray(axes, dtype=object)):
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            named.setdefault(label, handle)
    return _fitted(figure, list(named.values()), list(named), loc="outside upper center")


def _lines(ax: Axes, x: Array, values: Mapping[str, Array]) -> Artists:
    """One line a filter in its style; markers are spread so that those of different filters do not coincide."""
    every = max(1, len(x) // 8)
    return {
        name: [
            *ax.plot(
                x,
                y,
                color=style(name).color,
                linestyle=style(name).linestyle,
                marker=style(name).marker,
                markevery=(int(every * k / len(values)), every),
                markersize=5.0,
                markeredgecolor="black",
                markeredgewidth=0.25,
                label=style(name).label,
                zorder=2 + 0.01 * k,
            )
        ]
        for k, (name, y) in enumerate(values.items())
    }


def _outlines(ax: Axes, outlines: Array, color: str, label: str, filled: bool) -> Artist:
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import to_rgba

    drawable = np.isfinite(outlines).all((1, 2))
    if not drawable.all():
        label += f" ({np.count_nonzero(~drawable)} indefinite, not drawn)"
    collection = PolyCollection(
        list(outlines[drawable]),
        facecolors=to_rgba(color, 0.18 if filled else 0.12),
        edgecolors=to_rgba(color, 0.5 if filled else 1.0),
        linewidths=0.6 if filled else 0.9,
        label=label,
        zorder=2.3 if filled else 2.7,
    )
    ax.add_collection(collection)
    return collection


def _legend(ax: Axes) -> None:
    """The one legend style: without a frame, above the axes, in as many columns as fit; it never covers data."""
    handles, labels = ax.get_legend_handles_labels()
    if handles:
        _fitted(ax, handles, labels, loc="lower left", bbox_to_anchor=(0.0, 1.0))


def _fitted(parent: Axes | Figure, handles: list[Any], labels: list[str], **place: Any) -> Legend:
    """A legend in as many columns as its parent's width holds."""
    from matplotlib.lines import Line2D

    def build(columns: int) -> Legend:
        return parent.legend(
            handles,
            labels,
            ncols=columns,
            frameon=False,
            borderpad=0.0,
            borderaxespad=0.35,
            fontsize="small",
            handlelength=2.4,
            handletextpad=0.5,
            columnspacing=1.3,
            labelspacing=0.25,
            numpoints=1,
            **place,
        )

    legend = build(max(1, len(handles)))
    for columns in range(len(handles) - 1, 0, -1):
        if legend.get_window_extent().width <= parent.get_window_extent().width:
            break
        legend.remove()
        legend = build(columns)
    for handle in legend.legend_handles:
        # Faint dots are meant for thousands of points: alone in the legend they would be invisible.
        if isinstance(handle, Line2D) and handle.get_marker() == ".":
            handle.set(alpha=1.0, markersize=6.0)
    return legend


def _log_scale(ax: Axes, which: Literal["x", "y"] = "y") -> None:
    """A logarithmic axis with plain numbers (0.1, 2, 50) instead of powers."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    ax.set(**{f"{which}scale": "log"})
    axis = ax.yaxis if which == "y" else ax.xaxis
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _log_ticks(ax: Axes) -> None:
    """On a logarithmic horizontal axis as many numbers as have room."""
    from matplotlib.ticker import LogLocator

    low, high = ax.get_xlim()
    if high / low < 6:
        ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)))
    elif high / low > 300:
        ax.xaxis.set_major_locator(LogLocator())


def _elapsed(times: Array, run: Array) -> Array:
    """Times [s] since the first step of a run."""
    return times - run[0] if len(run) else times


def _sparse(times: Array, run: Array) -> bool:
    """Whether a truth has too few poses for a run's steps to be joined by lines."""
    return 20 * len(times) < len(run)


def _broken(times: Array, *series: Array) -> list[Array]:
    """The series with a NaN in every long gap of their times, so that no line bridges what nobody measured."""
    gaps = np.diff(times)
    cuts = np.flatnonzero(gaps > 20 * np.median(gaps)) + 1 if len(gaps) else np.zeros(0, dtype=np.intp)
    return [np.insert(values, cuts, np.nan) for values in series]


def _running_mean(values: Array, n: int) -> Array:
    """Means of n consecutive values (len - n + 1,)."""
    return np.asarray(np.lib.stride_tricks.sliding_window_view(values, n).mean(-1))


def _probability(value: float) -> float:
    if not 0.0 < value < 1.0:
        raise InputError(f"probability is {value}, expected a number between 0 and 1")
    return float(value)


def _alignment(value: ArrayLike | None) -> Array:
    frame = np.zeros(3) if value is None else np.asarray(value, dtype=float)
    if frame.shape != (3,) or not np.all(np.isfinite(frame)):
        raise InputError(f"alignment is {value!r}, expected a pose (3,): x [m], y [m], heading [rad]")
    return frame


def _runs(name: str, values: ArrayLike, x: Array) -> Array:
    """Values as (M, K): one row a run."""
    a = np.atleast_2d(np.asarray(values, dtype=float))
    if a.ndim != 2 or x.ndim != 1 or a.shape[1] != len(x):
        raise InputError(f"values of {name} have shape {np.shape(values)}, expected ({len(x)},) or (runs, {len(x)})")
    return a


def _mean(values: Array) -> Array:
    """Mean over the rows that have a value; NaN where none has."""
    known = np.isfinite(values)
    n = known.sum(0)
    return np.where(n > 0, np.where(known, values, 0.0).sum(0) / np.maximum(n, 1), np.nan)


def _block_means(values: Array, n: int) -> Array:
    """Means of n consecutive values (K,) each, of those that are there; the last may be of fewer."""
    if n <= 1:
        return values
    starts, known = np.arange(0, len(values), n), np.isfinite(values)
    total, count = (np.add.reduceat(v, starts) for v in (np.where(known, values, 0.0), known.astype(int)))
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _time_label(n: int) -> str:
    return "time [s]" if n <= 1 else f"time [s], means of {n} steps"


def _count(n: int, noun: str) -> str:
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"
