"""Figures of one run: the map, the errors, the NIS, and the three together."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slamkit import se2
from slamkit.arrays import Array
from slamkit.errors import InputError
from slamkit.evaluate import chi2_bounds, trajectory
from slamkit.logs import History, Log, Truth
from slamkit.plots.axes import (
    Artists,
    add_legend,
    break_at_gaps,
    checked_alignment,
    checked_probability,
    draw_outlines,
    log_scale,
    since_start,
)
from slamkit.plots.covariance import ellipses
from slamkit.plots.figure import new_figure
from slamkit.plots.styles import style

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


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
    """Trajectory and map with their ellipses, together with truth and dead reckoning.

    Parameters
    ----------
    ax : Axes
    history : History
    truth : Truth, optional
    dead_reckoning : (times (n,), poses (n, 3)), optional
        Poses by the motion model alone, from the pose at which the filter started.
    alignment : array_like (3,), optional
        Rigid motion from the filter's frame to the frame of the truth [m, m, rad]. It is applied to the estimate and to
        dead reckoning, because both start at the same pose.
    probability : float
        Probability of an ellipse.
    pose_ellipses : int
        Number of poses with an ellipse. They are evenly spaced and include the last one.
    max_ids : int
        Landmark ids are written if there are at most this many landmarks.
    legend : bool
        False if :func:`shared_legend` or the caller adds one.

    Returns
    -------
    dict
        Those drawn of: truth, dead_reckoning, estimate, start, pose_ellipses, true_landmarks, landmarks,
        landmark_ellipses, ids. Coordinates are in metres.
    """
    frame = checked_alignment(alignment)
    C = se2.rotation(frame[2])
    look, ground, odometry, mapped = (style(n) for n in (history.filter, "truth", "dead_reckoning", "landmarks"))
    artists: Artists = {}
    if truth is not None and len(truth.poses):
        how = _line_or_dots(truth.times, history.times, 2.5)
        line = break_at_gaps(truth.times, *truth.poses[:, :2].T)
        artists["truth"] = [*ax.plot(*line, color=ground.color, linewidth=1.0, label="truth", zorder=2.2, **how)]
    if dead_reckoning is not None:
        reckoned = se2.transform(frame, np.asarray(dead_reckoning[1], dtype=float).reshape(-1, 3)[:, :2])
        how = {"color": odometry.color, "linestyle": odometry.linestyle, "linewidth": 1.0}
        artists["dead_reckoning"] = [*ax.plot(*reckoned.T, label=odometry.label, zorder=2.1, **how)]
    path = se2.transform(frame, history.poses[:, :2].reshape(-1, 2))
    how = {"color": look.color, "linestyle": look.linestyle, "linewidth": 1.2}
    artists["estimate"] = [*ax.plot(*path.T, label=look.label, zorder=2.5, **how)]
    if len(path):
        how = {"color": look.color, "marker": "o", "markersize": 5, "markerfacecolor": "white", "linestyle": "none"}
        artists["start"] = [*ax.plot(*path[0], label="start", zorder=3, **how)]
    at = np.unique(np.linspace(0, max(len(path) - 1, 0), pose_ellipses + 1)[1:].round().astype(int))[: len(path)]
    if len(at):
        P = C @ history.pose_covariances[at][:, :2, :2] @ C.T
        outlines, label = ellipses(path[at], P, probability), f"{probability:.0%} ellipse, pose"
        artists["pose_ellipses"] = [draw_outlines(ax, outlines, look.color, label, filled=True)]
    if truth is not None and len(truth.landmarks):
        places = np.array(list(truth.landmarks.values()))
        how = {"color": ground.color, "marker": ground.marker, "markersize": 4.5, "markeredgewidth": 0.9}
        artists["true_landmarks"] = [*ax.plot(*places.T, linestyle="none", label="true landmarks", zorder=2.6, **how)]
    if len(history.landmarks):
        positions = se2.transform(frame, history.landmarks)
        how = {"color": mapped.color, "marker": mapped.marker, "markersize": 5, "markeredgewidth": 1.1}
        artists["landmarks"] = [*ax.plot(*positions.T, linestyle="none", label=mapped.label, zorder=2.8, **how)]
        outlines = ellipses(positions, C @ history.landmark_covariances @ C.T, probability)
        label = f"{probability:.0%} ellipse, landmark"
        artists["landmark_ellipses"] = [draw_outlines(ax, outlines, mapped.color, label, filled=False)]
        if len(positions) <= max_ids:
            artists["ids"] = _write_ids(ax, history.landmark_ids, positions)
    ax.set(xlabel="x [m]", ylabel="y [m]")
    ax.margins(0.06)
    ax.set_aspect("equal", adjustable="datalim")
    if legend:
        add_legend(ax)
    return artists


def plot_errors(
    axes: Sequence[Axes] | NDArray[Any],
    history: History,
    truth: Truth | None = None,
    alignment: ArrayLike | None = None,
    *,
    sigmas: float = 3.0,
    tolerance: float = 0.1,
    start: float | None = None,
    legend: bool = True,
) -> Artists:
    """Errors of x, y and heading over time, with the claimed ±3σ.

    The error is the estimate minus the truth at the nearest time, without interpolation. The heading error is wrapped
    to ±180°.

    Parameters
    ----------
    axes : three Axes
        For x [m], y [m] and heading [deg].
    history : History
    truth : Truth, optional
        Without it, only the claimed band is drawn.
    alignment : array_like (3,), optional
        Rigid motion from the filter's frame to the frame of the truth [m, m, rad]. It is applied to estimates and
        covariances.
    sigmas : float
        Half width of the band in claimed standard deviations.
    tolerance : float
        Largest time between an estimate and its truth [s], as in :func:`slamkit.evaluate.trajectory.evaluate`.
    start : float, optional
        Time at which the first step begins [s], such as ``log.schedule.start_time``: the time axis begins there. By
        default it begins at the end of the first step, because a history does not hold where that begins.
    legend : bool
        False if :func:`shared_legend` or the caller adds one.

    Returns
    -------
    dict
        band (3), and error (3) if there is a truth for any estimate: [m], [m] and [deg] over the time since the start
        [s].
    """
    axes = list(axes)
    if len(axes) != 3:
        raise InputError(f"plot_errors was given {len(axes)} axes, expected 3: for x, y and heading")
    frame = checked_alignment(alignment)
    look = style(history.filter)
    T = np.eye(3)
    T[:2, :2] = se2.rotation(frame[2])
    to_units = np.array([1.0, 1.0, np.degrees(1.0)])
    variances = np.einsum("ij,kjl,il->ki", T, history.pose_covariances.reshape(-1, 3, 3), T)
    # A negative variance has no standard deviation: the band has a gap there.
    band = sigmas * np.sqrt(np.where(variances >= 0, variances, np.nan)) * to_units
    elapsed = since_start(history.times, history.times, start)
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
        how = _line_or_dots(truth.times, history.times, 3.0) | {"color": style("truth").color, "linewidth": 0.8}
        label = f"error ({look.label})"
        artists["error"] = [
            ax.plot(*break_at_gaps(elapsed[rows], elapsed[rows], e), label=label, zorder=2, **how)[0]
            for ax, e in zip(axes, (error * to_units).T, strict=True)
        ]
    for ax, label in zip(axes, ("x error [m]", "y error [m]", "heading\nerror [deg]"), strict=True):
        ax.axhline(0.0, color="0.6", linewidth=0.5, zorder=0.5)
        ax.set_ylabel(label)
        ax.margins(x=0)
        if start is not None and len(elapsed):
            ax.set_xlim(0, max(float(elapsed.max()), 1e-9))
    axes[-1].set_xlabel("time since start [s]")
    if legend:
        add_legend(axes[0])
    return artists


def plot_nis(
    ax: Axes,
    history: History,
    *,
    window: int | None = None,
    probability: float = 0.95,
    log: bool | None = None,
    start: float | None = None,
    legend: bool = True,
) -> Artists:
    """Normalised innovation squared (NIS) over time, with its χ² bands.

    For a consistent filter yᵀS⁻¹y is χ² with the d degrees of freedom of the innovation, and the mean of n independent
    values is distributed as χ²_{nd}/n (Bar-Shalom, Li & Kirubarajan 2001, section 5.4).

    Parameters
    ----------
    ax : Axes
    history : History
    window : int, optional
        Number of accepted sightings in the running mean. By default 1/40 of them, at least 10 and at most 200.
    probability : float
        Probability of a band.
    log : bool, optional
        Logarithmic axis. By default, if a value exceeds four times the upper edge of the band of one sighting.
    start : float, optional
        Time at which the first step begins [s], such as ``log.schedule.start_time``: the time axis begins there. By
        default it begins at the end of the first step, because a history does not hold where that begins.
    legend : bool
        False if :func:`shared_legend` or the caller adds one.

    Returns
    -------
    dict
        Those drawn of: nis, rejected, mean, band, mean_band. NIS [1] over the time since the start [s].
    """
    p, d, look = checked_probability(probability), history.dof, style(history.filter)
    elapsed = since_start(history.observation_times, history.times, start)
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
    few = np.count_nonzero(known) < 1000
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
            markersize=4.0 if few else 2.5,
            markeredgewidth=0,
            alpha=0.7 if few else 0.35,
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
        log_scale(ax)
        ax.set_ylim(low / 4, 2 * max(highest, high))
    else:
        ax.set_ylim(0, 1.05 * max(highest, high))
    if len(history.times):
        run = since_start(history.times, history.times, start)
        ax.set_xlim(0, max(float(elapsed.max()), float(run.max()), 1e-9))
    if legend:
        add_legend(ax)
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
    """One run at a glance: the map, the errors with their claimed ±3σ, and the NIS.

    Parameters
    ----------
    history : History
    log : Log, optional
        The log of the run. The time axes begin where its first step begins, and its truth is used if `truth` is not
        given.
    dead_reckoning : (times (n,), poses (n, 3)), optional
        Poses by the motion model alone, from the pose at which the filter started.
    truth : Truth, optional
    alignment : array_like (3,), optional
        Rigid motion from the filter's frame to the frame of the truth [m, m, rad], as returned by
        :func:`slamkit.evaluate.trajectory.align`.
    title : str, optional
        By default the filter's name and the numbers of steps, sightings and landmarks.
    size : (float, float)
        Width and height [in].

    Returns
    -------
    Figure
        Jupyter displays it. Write it to a file with :func:`save`.
    """
    if truth is None and log is not None:
        truth = log.truth
    start = None if log is None or not len(log.schedule.times) else log.schedule.start_time
    with new_figure(*size) as figure:
        panels = figure.subplot_mosaic(
            [["map", "x"], ["map", "y"], ["map", "heading"], ["nis", "nis"]],
            width_ratios=[1.35, 1.0],
            height_ratios=[1.0, 1.0, 1.0, 1.15],
        )
        errors = [panels["x"], panels["y"], panels["heading"]]
        plot_map(panels["map"], history, truth, dead_reckoning, alignment)
        plot_errors(errors, history, truth, alignment, start=start)
        plot_nis(panels["nis"], history, start=start)
        for ax in errors[:2]:
            ax.sharex(errors[2])
            ax.tick_params(labelbottom=False)
        figure.align_ylabels(errors)
        count = f"{len(history.times)} steps, {len(history.nis)} sightings, {len(history.landmarks)} landmarks"
        figure.suptitle(f"{style(history.filter).label}: {count}" if title is None else title, fontsize=10)
    return figure


def _line_or_dots(times: Array, run: Array, size: float) -> dict[str, Any]:
    """A line through the true poses, or dots where they are too few, compared with the steps of the run, for a line."""
    sparse = 20 * len(times) < len(run)
    return {"linestyle": "none" if sparse else "-", "marker": "." if sparse else "none", "markersize": size}


def _write_ids(ax: Axes, ids: Sequence[Hashable], positions: Array) -> list[Artist]:
    """Each landmark's id to the upper right of it, with a white halo."""
    from matplotlib.patheffects import withStroke

    how: dict[str, Any] = {"textcoords": "offset points", "fontsize": 7, "color": "0.2", "parse_math": False}
    halo = [withStroke(linewidth=1.5, foreground="white")]
    return [
        ax.annotate(str(i), xy, xytext=(3.5, 3.5), path_effects=halo, zorder=3, **how)
        for i, xy in zip(ids, positions, strict=True)
    ]


def _running_mean(values: Array, n: int) -> Array:
    """Means of n consecutive values (len - n + 1,)."""
    return np.asarray(np.lib.stride_tricks.sliding_window_view(values, n).mean(-1))
