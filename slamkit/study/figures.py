"""The figures of a study."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from slamkit import evaluate, plots
from slamkit.arrays import Array
from slamkit.errors import InputError
from slamkit.study.findings import gauge_explains_all
from slamkit.study.wording import count

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from slamkit.study.study import Study

IntArray = NDArray[np.int64]

#: Panels of the figure of bars: key of the summary → label.
_BARS = {
    "position_rmse_m": "position RMSE [m]",
    "heading_rmse_deg": "heading RMSE [deg]",
    "landmark_rmse_m": "landmark RMSE [m]",
    "pose_nees": "pose NEES (3)",
    "landmark_nees": "landmark NEES (2)",
    "relative_nees_per_dof": "relative NEES per degree of freedom",
}
#: What a consistent filter has.
_EXPECTED = {"pose_nees": 3.0, "gauge_nees": 3.0, "landmark_nees": 2.0, "relative_nees_per_dof": 1.0}


def figures(study: Study) -> dict[str, Figure]:
    """See :meth:`slamkit.study.Study.figures`."""
    names, made = _judged(study), {}
    if names:
        made["overview"] = overview(study)
        with plots.new_figure(7.0, 3.6) as figure:
            _plot_nees(study, figure.subplots())
        made["nees"] = figure
        made["claims"] = _claims(study)
        if (coverage := _coverage(study)) is not None:
            made["coverage"] = coverage
        made["bars"] = _bars(study)
        made["cost"] = _cost(study)
    if _has_gauge(study):
        with plots.new_figure(6.2, 3.6) as figure:
            _plot_gauge(study, figure.subplots())
        made["gauge"] = figure
    return made


def overview(study: Study) -> Figure:
    """See :meth:`slamkit.study.Study.overview`."""
    names, s = _judged(study), study.summary()
    if not names:
        raise InputError(f"no filter finished with a truth to compare with in {count(study.runs, 'run')}")
    split = any(s[n]["gauge_nees"] is not None for n in names)
    key = "gauge_nees" if split else "pose_nees"
    subject = "ekf" if "ekf" in names else max(names, key=lambda n: s[n][key] or 0.0)
    with plots.new_figure(10.0, 7.8) as figure:
        halves: Any = figure.subfigures(2, 1, height_ratios=[1.0, 1.15])
        above, below = halves
        panels = above.subplots(1, 2, sharex=True, sharey=True)
        titles = (
            "Landmarks relative to the robot (the relative map)",
            f"{'Robot and map together in the world (the gauge)' if split else 'Robot in the world (the pose)'}"
            f"{'' if study.simulated else ', after alignment'}",
        )
        edges = []
        shown = (("relative_nees_per_dof", 1.0), (key, 1.0 / 3.0))
        for ax, title, (of, scale) in zip(panels, titles, shown, strict=True):
            _plot_bars(study, ax, of, "NEES per degree of freedom (consistent: 1)", scale)
            ax.set_title(title, fontsize=9, loc="left")
            edges += ax.get_xlim()
        panels[0].set_xlim(min(edges), max(edges))
        left, right = below.subfigures(1, 2)
        if _has_gauge(study):
            title = "Claimed heading deviation of robot and map together"
            title += ": it may never fall" if study.unobservable in (None, 3) else " (the models measure it in part)"
            _plot_gauge(study, left.subplots())
        else:
            title = "NEES of the pose over time"
            _plot_nees(study, left.subplots())
        left.suptitle(title, fontsize=9, x=0.01, ha="left")
        _plot_claim(study, right.subplots(), subject)
        title = f"Heading of the {plots.style(subject).label}: error and claimed uncertainty"
        right.suptitle(title, fontsize=9, x=0.01, ha="left")
        figure.suptitle(_headline(study, subject, s[subject]), fontsize=11)
    return figure


def _headline(study: Study, subject: str, v: Mapping[str, Any]) -> str:
    """What the numbers show about one filter."""
    label = plots.style(subject).label
    size = f"{study.world}, {count(v['finished'], 'run')}"
    if v["gauge_nees"] is None:
        return size
    relative, gauge = v["relative_nees_per_dof"], v["gauge_nees"] / 3
    numbers = f"NEES per degree of freedom {relative:.2f} in the relative map, {gauge:.2f} in the gauge"
    if gauge_explains_all(study, subject):
        return (
            f"All of the {label}'s inconsistency comes from a gauge that it claims to have learnt\n{numbers} ({size})"
        )
    return f"{label}: {numbers}\n{size}"


def _judged(study: Study) -> list[str]:
    """Filters with at least one trial that has errors."""
    return [n for n in study.trials if any(np.isfinite(t.errors).any() for t in study.finished(n))]


def _has_gauge(study: Study) -> bool:
    return any(len(c.deviations) for c in study.gauge.values())


def _elapsed(study: Study, times: Array) -> Array:
    """Times since the first step began: the first step ends at its duration, not at 0."""
    return times - study.start_time


def _pose_nees(study: Study, name: str) -> tuple[Array, IntArray]:
    """Pose NEES and its degrees of freedom (M, K) of the finished trials."""
    done = study.finished(name)
    dof = np.array([t.dof[:, 0] for t in done])
    return np.where(dof > 0, [t.nees[:, 0] for t in done], 0.0), dof


def _plot_nees(study: Study, ax: Axes) -> None:
    values = {}
    for name in _judged(study):
        nees, dof = _pose_nees(study, name)
        values[name] = np.where(dof > 0, 3 * nees / np.maximum(dof, 1), np.nan)
    plots.plot_nees(ax, _elapsed(study, study.times), values, 3, label="pose NEES (3 degrees of freedom)")


def _plot_claim(study: Study, ax: Axes, name: str, *, legend: bool = True) -> None:
    done = study.finished(name)
    errors, sigmas = (np.degrees([getattr(t, kind)[:, 2] for t in done]) for kind in ("errors", "sigmas"))
    plots.plot_claim(ax, name, _elapsed(study, study.times), errors, sigmas, legend=legend)


def _plot_gauge(study: Study, ax: Axes) -> None:
    checks = [c for c in study.gauge.values() if len(c.deviations)]
    n = min(len(c.times) for c in checks)
    deviations = {c.filter: np.degrees(c.deviations[:n]) for c in checks}
    plots.plot_gauge(ax, _elapsed(study, checks[0].times[:n]), deviations)


def _plot_bars(study: Study, ax: Axes, key: str, label: str, scale: float = 1.0) -> None:
    s = study.summary()
    band, edge = None, key.removesuffix("_per_dof")
    if f"{edge}_low" in next(iter(s.values())):
        limits = [(v[f"{edge}_low"], v[f"{edge}_high"]) for v in s.values() if v[f"{edge}_low"] is not None]
        band = (scale * limits[0][0], scale * limits[0][1]) if limits else None
    values = {n: float("nan") if v[key] is None else scale * v[key] for n, v in s.items()}
    if np.all(np.isnan(list(values.values()))):
        ax.text(0.5, 0.5, f"no {label}", transform=ax.transAxes, ha="center", va="center", color="0.4")
        return
    errors = {n: scale * (v[f"{key}_se"] or 0.0) for n, v in s.items()}
    reference = scale * _EXPECTED[key] if key in _EXPECTED else None
    plots.plot_bars(ax, values, errors, label=label, band=band, reference=reference)


def _claims(study: Study) -> Figure:
    """One panel for each filter: its heading error beside what it claims."""
    from matplotlib.patches import Patch

    names = _judged(study)
    n = len(names)
    # First as few empty places as possible, then as few rows.
    columns = max(range(min(n, 2), min(n, 4) + 1), key=lambda c: (-(-n % c), c))
    rows = -(-n // columns)
    with plots.new_figure(min(3.6 * columns, 11.0), 0.6 + 2.1 * rows) as figure:
        axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        drawn = axes.flat[:n]
        for ax, name in zip(drawn, names, strict=True):
            _plot_claim(study, ax, name, legend=False)
        for ax in axes.flat[n:]:
            ax.remove()
        for k, ax in enumerate(drawn):
            ax.set_ylabel(ax.get_ylabel() if k % columns == 0 else "")
            ax.tick_params(labelbottom=k + columns >= n)
        figure.supxlabel(drawn[0].get_xlabel(), fontsize=9)
        for ax in drawn:
            ax.set_xlabel("")
        for handle in plots.shared_legend(figure, drawn).legend_handles:
            if isinstance(handle, Patch):
                handle.set_facecolor("0.55")  # in its panel, each filter has its own colour
    return figure


def _coverage(study: Study) -> Figure | None:
    covered = {
        name: evaluate.coverage(values, dof)
        for name in _judged(study)
        for values, dof in [_pose_nees(study, name)]
        if np.any(dof > 0)
    }
    if not covered:
        return None
    levels = next(iter(covered.values())).levels
    with plots.new_figure(4.6, 4.9) as figure:
        plots.plot_coverage(figure.subplots(), levels, {n: c.share for n, c in covered.items()})
    return figure


def _cost(study: Study) -> Figure:
    s = {n: v for n, v in study.summary().items() if v["position_rmse_m"] is not None}
    with plots.new_figure(5.6, 4.2) as figure:
        plots.plot_cost(
            figure.subplots(),
            {n: v["seconds_per_step"] for n, v in s.items()},
            {n: v["position_rmse_m"] for n, v in s.items()},
            {n: v["position_rmse_m_se"] or 0.0 for n, v in s.items()},
        )
    return figure


def _bars(study: Study) -> Figure:
    with plots.new_figure(11.0, 0.8 + 0.62 * len(study.trials)) as figure:
        for ax, (key, label) in zip(figure.subplots(2, 3, sharey=True).flat, _BARS.items(), strict=True):
            _plot_bars(study, ax, key, label)
    return figure
