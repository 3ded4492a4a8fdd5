"""What several figures share: legends, scales, lines in the style of each filter, and checks of arguments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slamkit.arrays import Array
from slamkit.errors import InputError
from slamkit.plots.styles import style

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend

#: What a figure drew: meaning → list of artists.
Artists = dict[str, "list[Artist]"]


def shared_legend(figure: Figure, axes: Sequence[Axes] | NDArray[Any]) -> Legend:
    """One legend above several axes. A label that occurs in more than one of them is listed once.

    Parameters
    ----------
    figure : Figure
        It needs the constrained layout, which makes room for the legend.
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
    return fitted_legend(figure, list(named.values()), list(named), loc="outside upper center")


def add_legend(ax: Axes) -> None:
    """A legend without a frame, above the axes and in as many columns as fit, so that it never covers data."""
    handles, labels = ax.get_legend_handles_labels()
    if handles:
        fitted_legend(ax, handles, labels, loc="lower left", bbox_to_anchor=(0.0, 1.0))


def fitted_legend(parent: Axes | Figure, handles: list[Any], labels: list[str], **place: Any) -> Legend:
    """A legend with as many columns as fit into the width of its parent."""
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
        # Small, faint dots suit thousands of points. A single one in the legend would be invisible.
        if isinstance(handle, Line2D) and handle.get_marker() == ".":
            handle.set(alpha=1.0, markersize=6.0)
    return legend


def draw_lines(ax: Axes, x: Array, values: Mapping[str, Array]) -> Artists:
    """One line for each filter, in its style. Markers are shifted so that those of two filters do not coincide."""
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


def log_scale(ax: Axes, which: Literal["x", "y"] = "y") -> None:
    """A logarithmic axis with plain numbers (0.1, 2, 50) instead of powers."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    ax.set(**{f"{which}scale": "log"})
    axis = ax.yaxis if which == "y" else ax.xaxis
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def log_ticks(ax: Axes) -> None:
    """Label a logarithmic horizontal axis with as many numbers as fit."""
    from matplotlib.ticker import LogLocator

    low, high = ax.get_xlim()
    if high / low < 6:
        ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)))
    elif high / low > 300:
        ax.xaxis.set_major_locator(LogLocator())


def since_start(times: Array, run: Array, start: float | None) -> Array:
    """Times since `start` or, if that is None, since the end of the first step of a run [s]."""
    if start is None:
        start = float(run[0]) if len(run) else 0.0
    return times - start


def break_at_gaps(times: Array, *series: Array) -> list[Array]:
    """The series with a NaN in each long gap of their times, so that no line is drawn across the gap."""
    gaps = np.diff(times)
    cuts = np.flatnonzero(gaps > 20 * np.median(gaps)) + 1 if len(gaps) else np.zeros(0, dtype=np.intp)
    return [np.insert(values, cuts, np.nan) for values in series]


def draw_outlines(ax: Axes, outlines: Array, color: str, label: str, filled: bool) -> Artist:
    """Ellipses as one collection. Those that are NaN are left out and counted in the label."""
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


def checked_probability(value: float) -> float:
    """A probability in (0, 1)."""
    if not 0.0 < value < 1.0:
        raise InputError(f"probability is {value}, expected a number between 0 and 1")
    return float(value)


def checked_alignment(value: ArrayLike | None) -> Array:
    """A rigid motion (3,); the identity for None."""
    frame = np.zeros(3) if value is None else np.asarray(value, dtype=float)
    if frame.shape != (3,) or not np.all(np.isfinite(frame)):
        raise InputError(f"alignment is {value!r}, expected a pose (3,): x [m], y [m], heading [rad]")
    return frame


def count(n: int, noun: str) -> str:
    """A number and its noun: "1 run", "2 runs"."""
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"
