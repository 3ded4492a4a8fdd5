"""Figures that compare filters over many runs: NEES, claimed deviations, gauge, coverage, bars and cost."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from slamkit.arrays import Array
from slamkit.errors import InputError
from slamkit.evaluate import chi2_bounds
from slamkit.plots.axes import Artists, add_legend, checked_probability, count, draw_lines, log_scale, log_ticks
from slamkit.plots.styles import style

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes


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
    """Mean NEES over the runs of each filter, over time, with its χ² band.

    At each instant the mean over M independent runs of a consistent filter is distributed as χ²_{Md}/M (Bar-Shalom, Li
    & Kirubarajan 2001, section 5.4). A mean that also covers several steps scatters less than the band says.

    Parameters
    ----------
    ax : Axes
    times : array_like (K,)
        Times [s].
    nees : mapping filter → array_like (M, K) or (K,)
        One row for each run. NaN where a run has no value.
    dof : int
        Degrees of freedom of one value.
    probability : float
        Probability of the band. The band is that of the filter with the most runs.
    label : str
        Label of the vertical axis.
    log : bool, optional
        Logarithmic axis. By default, if a mean exceeds five times the upper edge of the band.
    points : int
        Largest number of points of a line. A longer run is drawn as means over consecutive steps.
    legend : bool
        False if :func:`shared_legend` or the caller adds one.

    Returns
    -------
    dict
        band, and one entry for each filter.

    Raises
    ------
    InputError
        The values do not have one column for each time, or the probability is outside (0, 1).
    """
    t, p = np.asarray(times, dtype=float), checked_probability(probability)
    values = {name: _runs(name, v, t) for name, v in nees.items()}
    M = max((len(v) for v in values.values()), default=1)
    bounds = chi2_bounds(dof, M, p)
    low, high = float(bounds.lower), float(bounds.upper)
    label_of_band = f"{p:.0%} band, {count(M, 'run')}"
    artists: Artists = {
        "band": [ax.axhspan(low, high, facecolor="0.5", alpha=0.3, linewidth=0, zorder=0.5, label=label_of_band)]
    }
    ax.axhline(dof, color="0.4", linewidth=0.6, zorder=0.6)
    n = max(1, -(-len(t) // points))
    means = {name: _block_means(_mean(v), n) for name, v in values.items()}
    artists |= draw_lines(ax, _block_means(t, n), means)
    highest = max((float(np.nanmax(m)) for m in means.values() if np.isfinite(m).any()), default=high)
    if highest > 5 * high if log is None else log:
        log_scale(ax)
    else:
        ax.set_ylim(0, 1.05 * max(highest, 1.5 * high))
    ax.set(xlabel=_time_label(n), ylabel=label)
    ax.margins(x=0)
    if legend:
        add_legend(ax)
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
    """Claimed and actual error of one filter: the errors of some runs, the RMSE of all, and the claimed ±3σ.

    Parameters
    ----------
    ax : Axes
    name : str
        The filter.
    times : array_like (K,)
        Times [s].
    errors, deviations : array_like (M, K) or (K,)
        Error and claimed standard deviation of each run, in the unit of `label`. NaN where there is none.
    sigmas : float
        Half width of the band in claimed standard deviations.
    label : str
        Label of the vertical axis.
    lines : int
        Largest number of runs whose errors are drawn: the first ones. Band and spread are computed from all runs.
    points : int
        Largest number of points of a line. In a longer run, band and spread are root means over consecutive steps as
        well, and every nth error is drawn.
    legend : bool
        False if :func:`shared_legend` or the caller adds one.

    Returns
    -------
    dict
        errors: one line for each run drawn. band: ±sigmas times the root of the mean claimed variance. spread: ±sigmas
        times the root mean square error; empty for a single run.

    Raises
    ------
    InputError
        The values do not have one column for each time.
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
        runs[0].set_label(f"error of {of}{count(len(e), 'run')}")
    spread: list[Artist] = []
    if len(e) > 1:
        dashed: dict[str, Any] = {"color": "black", "linewidth": 1.0, "linestyle": (0, (4, 1.5)), "zorder": 2.4}
        spread += ax.plot(t, actual, label=f"±{sigmas:g} RMSE", **dashed)
        spread += ax.plot(t, -actual, **dashed)
    halo = [withStroke(linewidth=2.5, foreground="white")]
    place: dict[str, Any] = {"transform": ax.transAxes, "va": "top", "zorder": 3}
    ax.text(0.02, 0.97, look.label, fontweight="bold", color=look.color, path_effects=halo, **place)
    ax.set(xlabel=_time_label(n), ylabel=label)
    ax.margins(x=0, y=0.14)  # room for the name above the data
    if legend:
        add_legend(ax)
    return {"errors": [*runs], "band": [band], "spread": spread}


def plot_gauge(
    ax: Axes,
    times: ArrayLike,
    deviations: Mapping[str, ArrayLike],
    *,
    label: str = "gauge deviation [deg]",
    legend: bool = True,
) -> Artists:
    """Standard deviation that each filter claims for the unobservable rotation. It must never decrease.

    Parameters
    ----------
    ax : Axes
    times : array_like (K,)
        Times [s].
    deviations : mapping filter → array_like (M, K) or (K,)
        √[(NᵀP⁻¹N)⁻¹]_θθ in the unit of `label`. The root mean square over the runs is drawn.
    label : str
        Label of the vertical axis.
    legend : bool
        False if :func:`shared_legend` or the caller adds one.

    Returns
    -------
    dict
        One entry for each filter.

    Raises
    ------
    InputError
        The values do not have one column for each time.
    """
    t = np.asarray(times, dtype=float)
    artists = draw_lines(ax, t, {name: np.sqrt(_mean(_runs(name, v, t) ** 2)) for name, v in deviations.items()})
    ax.set(xlabel="time [s]", ylabel=label)
    ax.set_ylim(0, 1.08 * ax.dataLim.y1 if np.isfinite(ax.dataLim.y1) and ax.dataLim.y1 > 0 else 1.0)
    ax.margins(x=0)
    if legend:
        add_legend(ax)
    return artists


def plot_coverage(ax: Axes, levels: ArrayLike, coverage: Mapping[str, ArrayLike], *, legend: bool = True) -> Artists:
    """Coverage curves: how often the truth was inside the region that a filter claimed for each probability.

    Parameters
    ----------
    ax : Axes
    levels : array_like (n,)
        Claimed probabilities in [0, 1].
    coverage : mapping filter → array_like (n,)
        Share of the values inside the region, in [0, 1].
    legend : bool
        False if :func:`shared_legend` or the caller adds one.

    Returns
    -------
    dict
        diagonal, and one entry for each filter [%].

    Raises
    ------
    InputError
        The values do not have one value for each level.
    """
    x = np.asarray(levels, dtype=float)
    diagonal = ax.plot([0, 100], [0, 100], color="0.55", linewidth=3.0, alpha=0.6, label="consistent", zorder=1)
    lines = draw_lines(ax, 100 * x, {name: 100 * _runs(name, c, x)[0] for name, c in coverage.items()})
    ax.set(xlabel="claimed probability [%]", ylabel="truth inside [%]", xlim=(0, 100), ylim=(0, 100))
    ax.set_aspect("equal", adjustable="box")
    if legend:
        add_legend(ax)
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
    """One bar for each filter with its error bar, the first filter on top.

    Parameters
    ----------
    ax : Axes
    values : mapping filter → float
        NaN means no value: the row stays empty.
    errors : mapping filter → float, optional
        Half lengths of the error bars, for example the standard errors over the runs.
    label : str
        Label of the horizontal axis, with its unit.
    band : (float, float), optional
        Range of a consistent filter. A value above it is written in bold.
    reference : float, optional
        Expected value, > 0. Give it for values that are compared by their ratio, such as NEES and its degrees of
        freedom: the axis is then logarithmic, and a bar reaches from the expected to the actual value.

    Returns
    -------
    dict
        band, and one entry for each filter: the bar, then its value as text.
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
                # A dark line would be invisible on a dark bar.
                line.set_path_effects([withStroke(linewidth=2.4, foreground="white")])
        end, text = max(value + max(error, 0.0), start), []
        if np.isfinite(end):
            how: dict[str, Any] = {"textcoords": "offset points", "va": "center", "fontsize": "small"}
            weight = "bold" if band is not None and value > band[1] else "normal"
            text = [ax.annotate(f"{value:#.3g}".rstrip("."), (end, row), xytext=(4, 0), fontweight=weight, **how)]
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
        log_scale(ax, "x")
        ax.set_xlim(low / 1.3, 1.1 * high * (high / low) ** 0.25)
        log_ticks(ax)
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
    """Accuracy and cost: one marker for each filter. The best are at the lower left.

    Parameters
    ----------
    ax : Axes
    seconds : mapping filter → float
        Time of one step [s], > 0.
    accuracy : mapping filter → float
        Error of every filter in `seconds`, in the unit of `label`.
    errors : mapping filter → float, optional
        Half lengths of the error bars.
    label : str
        Label of the vertical axis.
    legend : bool
        False if :func:`shared_legend` or the caller adds one.

    Returns
    -------
    dict
        One entry for each filter. Times are in microseconds.

    Raises
    ------
    InputError
        A filter has a time but no accuracy.
    """
    missing = [name for name in seconds if name not in accuracy]
    if missing:
        raise InputError(f"no accuracy for {', '.join(missing)}; given: {', '.join(accuracy)}")
    artists: Artists = {}
    point: dict[str, Any] = {"linestyle": "none", "markersize": 7, "zorder": 3}
    point |= {"markeredgecolor": "black", "markeredgewidth": 0.5}
    for name, cost in seconds.items():
        look = style(name)
        artists[name] = [
            *ax.plot(1e6 * cost, accuracy[name], color=look.color, marker=look.marker, label=look.label, **point)
        ]
        error = (errors or {}).get(name)
        if error is not None:
            how: dict[str, Any] = {"ecolor": look.color, "elinewidth": 1.0, "capsize": 2.5}
            artists[name] += ax.errorbar(1e6 * cost, accuracy[name], yerr=error, fmt="none", **how).get_children()
    log_scale(ax, "x")
    ax.set(xlabel="time of a step [µs]", ylabel=label)
    ax.margins(0.12)
    log_ticks(ax)
    ax.grid(True, which="major", color="0.9", linewidth=0.6)
    ax.set_axisbelow(True)
    if legend:
        add_legend(ax)
    return artists


def _runs(name: str, values: ArrayLike, x: Array) -> Array:
    """Values as (M, K): one row for each run."""
    a = np.atleast_2d(np.asarray(values, dtype=float))
    if a.ndim != 2 or x.ndim != 1 or a.shape[1] != len(x):
        raise InputError(f"values of {name} have shape {np.shape(values)}, expected ({len(x)},) or (runs, {len(x)})")
    return a


def _mean(values: Array) -> Array:
    """Mean over the rows that have a value. NaN where no row has one."""
    known = np.isfinite(values)
    n = known.sum(0)
    return np.where(n > 0, np.where(known, values, 0.0).sum(0) / np.maximum(n, 1), np.nan)


def _block_means(values: Array, n: int) -> Array:
    """Means of n consecutive values of (K,), without NaN. The last mean may cover fewer than n."""
    if n <= 1:
        return values
    starts, known = np.arange(0, len(values), n), np.isfinite(values)
    total, number = (np.add.reduceat(v, starts) for v in (np.where(known, values, 0.0), known.astype(int)))
    return np.where(number > 0, total / np.maximum(number, 1), np.nan)


def _time_label(n: int) -> str:
    return "time [s]" if n <= 1 else f"time [s], means of {n} steps"
