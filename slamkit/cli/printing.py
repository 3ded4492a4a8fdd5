"""Tables, lines of text and progress bars on a terminal."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from slamkit.evaluate.run_report import Assessment

if TYPE_CHECKING:
    from slamkit.study import Study

__all__ = ["bar", "comparison_table", "failures", "output", "print_json", "remarks", "run_table"]


def output(*what: Table | str, quiet: bool = False, on_stderr: bool = False) -> None:
    """Print tables and lines of text. `on_stderr` keeps standard output free for JSON."""
    if quiet:
        return
    console = Console(stderr=on_stderr)
    for thing in what:
        # Text is not wrapped, so that a path can be copied whole.
        console.print(thing, soft_wrap=isinstance(thing, str), markup=False, highlight=False)


def print_json(facts: Mapping[str, Any]) -> None:
    """Print facts as JSON on standard output."""
    print(json.dumps(facts, indent=2, allow_nan=False))


@contextmanager
def bar(quiet: bool, *columns: Any) -> Iterator[Progress]:
    """A progress bar on stderr, shown only on a terminal."""
    console = Console(stderr=True)
    layout = (TextColumn("{task.description}"), *columns, TimeElapsedColumn())
    shown = not quiet and console.is_terminal and not console.is_dumb_terminal
    with Progress(*layout, console=console, transient=True, disable=not shown) as progress:
        yield progress


# ---- a run ----


def run_table(title: str, run: Assessment) -> Table:
    """The numbers of a run, with dead reckoning beside them."""
    s, baseline = run.summary, run.dead_reckoning_evaluation
    table = Table(title=Text(title))
    table.add_column("")
    table.add_column(s["filter"], justify="right")
    table.add_column("dead reckoning", justify="right")
    expected = s["nis_dof_mean"]
    seconds, steps = s["seconds"], s["steps"]
    rows: list[tuple[str, float | None, float | None]] = [
        ("trajectory error (ATE) [m]", s["ate_m"], baseline.ate_m),
        ("heading RMSE [deg]", s["heading_rmse_deg"], baseline.heading_rmse_deg),
        ("landmark RMSE [m]", s["landmark_rmse_m"], None),
        ("mean NIS" if expected is None else f"mean NIS (consistent: {expected:g})", s["nis_mean"], None),
        ("poses with a truth", s["matched"], baseline.matched),
        ("steps", steps, None),
        ("sightings", s["observations"], None),
        ("rejected sightings", s["rejected"], None),
        ("landmarks", s["landmarks"], None),
        ("time [s]", seconds, None),
        ("time a step [µs]", None if seconds is None or steps == 0 else 1e6 * seconds / steps, None),
    ]
    for name, value, beside in rows:
        table.add_row(name, _number(value), _number(beside))
    return table


# ---- a comparison ----

#: Columns of the table with a truth and without one. The headings are broken to fit a terminal of 80 columns.
JUDGED = {
    "position\nRMSE [m]": "position_rmse_m",
    "heading\nRMSE\n[deg]": "heading_rmse_deg",
    "pose\nNEES (3)": "pose_nees",
    "gauge\nNEES (3)": "gauge_nees",
    "relative\nNEES/dof\n(1)": "relative_nees_per_dof",
    "nullity": "nullity",
}
UNJUDGED = {
    "NIS/dof\n(1)": "nis_per_dof",
    "nullity": "nullity",
    "gauge\ndeviation\nfalls by": "gauge_deviation_drop",
    "stochastic\ngauge [m]": "stochastic_gauge_m",
    "time\na step\n[µs]": "seconds_per_step",
}


def comparison_table(study: Study, title: str) -> Table:
    """A table with a row for each filter. Parentheses hold what a consistent filter is expected to have.

    The expected nullity depends on the models: 3, unless they anchor the map.
    """
    summary = study.summary()
    judged = any(numbers["pose_nees"] is not None for numbers in summary.values())
    table = Table(title=Text(title))
    table.add_column("", overflow="fold")
    columns = JUDGED if judged else UNJUDGED
    for heading, key in columns.items():
        if key == "nullity" and study.unobservable is not None:
            heading = f"{heading}\n({study.unobservable})"
        table.add_column(heading, justify="right", no_wrap=True)
    for name, numbers in summary.items():
        table.add_row(name, *[_cell(key, numbers[key]) for key in columns.values()])
    return table


def remarks(study: Study) -> list[str]:
    """The lines below the table: the bounds of a consistent filter, and what the numbers say."""
    summary = study.summary()
    bounds = []
    for name, key in (("pose NEES", "pose_nees"), ("gauge NEES", "gauge_nees"), ("relative NEES", "relative_nees")):
        of = next((s for s in summary.values() if s[f"{key}_low"] is not None), None)
        if of is not None:
            bounds.append(f"{name} {of[f'{key}_low']:.2f} to {of[f'{key}_high']:.2f}")
    findings = study.findings()
    return [
        *([f"Consistent (95 %): {', '.join(bounds)}"] if bounds else []),
        *([" ".join(findings)] if findings else []),
    ]


def failures(study: Study) -> list[str]:
    """One line that names the filters that failed or diverged, in how many runs and why; none if none did."""
    wrong = []
    for name, s in study.summary().items():
        if s["diverged"]:
            why = next((f" ({t.error})" for t in study.failures if t.filter == name and t.error), "")
            wrong.append(f"{name} {s['diverged']} of {s['runs']}{why}")
    return [f"Failed or diverged: {', '.join(wrong)}"] if wrong else []


def _cell(key: str, value: float | None) -> str:
    if value is not None and key in ("gauge_deviation_drop", "stochastic_gauge_m"):
        return f"{value:.0e}" if value < 5e-4 else f"{value:.3f}"
    return _number(None if value is None else 1e6 * value if key == "seconds_per_step" else value)


def _number(value: float | None) -> str:
    if value is None:
        return "-"
    return str(value) if isinstance(value, int) else f"{value:.3f}" if abs(value) < 100 else f"{value:.0f}"
