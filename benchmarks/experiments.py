"""Experiments A to D: the filters in four simulated worlds, compared with published and reference values.

    python benchmarks/experiments.py [--only A,C] [--runs M] [--seed S] [--jobs J] [--out DIR]

A, D  Ten loops past 20 landmarks, with relative positions (A) or range and bearing (D). Filters that leave the heading
      unobservable must have NEES and RMSE within 10 % of those of the ideal filter. All filters see the same noise, so
      that the ratio to the ideal filter is known better than either number.
maps  The world of A with other maps: how much the NEES of the standard EKF depends on the positions of the landmarks.
B     The 2-D SLAM benchmark of UKF-M. Results must be within three standard errors of the published values.
C     A robot that stands still: the uncertainty that the standard EKF claims for a heading that no sensor measures.

± is one standard error over the runs. The script writes experiments.json, experiments.md and experiments.png.
"""

from __future__ import annotations

import os

# One thread for each process. The libraries of NumPy and SciPy read these variables once, when they are loaded.
os.environ.update(
    dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1")
)

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from _machine import machine, sentence
from numpy.typing import ArrayLike
from rich.console import Console

from slamkit import World
from slamkit.arrays import Array
from slamkit.evaluate import chi2_bounds
from slamkit.evaluate.run_report import write_json
from slamkit.plots import plot_bars, save, shared_legend, style
from slamkit.simulate import loop_world, ring_world, standing_world
from slamkit.study import Study, compare

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Row = dict[str, Any]
#: compare() with the settings of the script. Arguments: title, filters, world, runs, and further ones of compare().
Run = Callable[..., Study]

RUNS = {"A": 50, "B": 100, "C": 100, "D": 50, "maps": 20}
LONGER = {"A": 8, "B": 4, "D": 8}  # factor by which the study of the judged filters is continued
MAPS = range(6)

JUDGED = ("fej", "oc", "invariant")
FAMILY = ("ideal", "ekf", *JUDGED, "iterated", "robocentric", "ukf", "oc-ukf")
MARGIN = 0.1  # largest relative difference between a judged filter and the ideal one
SENSORS = {"A": "relative", "D": "range-bearing"}
MEASURES = {
    "pose_nees": "pose NEES (3)",
    "position_rmse_m": "position RMSE [m]",
    "heading_rmse_deg": "heading RMSE [°]",
}
DIGITS = {"pose_nees": 2, "position_rmse_m": 3, "heading_rmse_deg": 2}
#: (pose NEES, its standard error), position RMSE, heading RMSE in 50 runs with one map, which loop_world lacks.
REFERENCE: dict[str, dict[str, tuple[tuple[float, float | None], float, float | None]]] = {
    "A": {
        "ideal": ((3.62, 0.28), 0.703, 3.11),
        "ekf": ((11.85, 2.46), 0.901, 3.87),
        "fej": ((3.56, None), 0.702, 3.12),
        "oc": ((3.47, None), 0.704, 3.11),
        "invariant": ((3.41, None), 0.706, 3.12),
    },
    "D": {
        "ideal": ((3.44, None), 0.660, 2.98),
        "ekf": ((17.5, 4.1), 1.043, 4.49),
        "fej": ((3.48, None), 0.664, None),
        "oc": ((3.60, None), 0.667, None),
        "invariant": ((3.39, None), 0.663, None),
    },
}
REFERENCE_MAPS = (11.9, 52.7)  # pose NEES of the standard EKF with the reference's map of A, and with another map

ERRORS_ALLOWED = 3.0  # standard errors
RING_MEASURES = {  # key of Study.summary → (name, degrees of freedom by which the published value is divided, digits)
    "heading_rmse_deg": ("heading RMSE [°]", 1, 2),
    "position_rmse_m": ("position RMSE [m]", 1, 3),
    "heading_nees": ("heading NEES / dof", 1, 2),
    "position_nees": ("position NEES / dof", 2, 2),
}
PUBLISHED_RUNS = 100
#: Brossard, Barrau & Bonnabel, ICRA (2020), in the order of RING_MEASURES. No standard errors are published.
PUBLISHED = {
    "ekf": (3.02, 0.67, 2.88, 2.56),
    "invariant": (2.51, 0.55, 1.01, 1.17),
    "ukf": (3.01, 0.67, 2.93, 2.63),
}

#: σ₀ [°] → standard deviation of the heading that the standard EKF claims after 300 scans [°].
CLAIMED = {0.5: 0.498, 1.0: 0.986, 2.0: 1.789, 5.0: 1.950, 10.0: 1.742, 20.0: 1.551}
ORDERS = ("sequential", "batch")
SPREADS_ALLOWED = 2.0  # standard deviations of a single run
KEPT = 1e-9  # relative


# -- statistics -------------------------------------------------------------------------------------------------------


def mean(values: ArrayLike) -> Row:
    """Mean over the runs, and its standard error."""
    v = np.asarray(values, dtype=float)
    return {"value": float(v.mean()), "se": float(v.std(ddof=1) / np.sqrt(len(v)))}


def ratio(values: ArrayLike, yardstick: ArrayLike, root: bool = False) -> Row:
    """Mean of values (M,) divided by the mean of a yardstick (M,) in the same runs, or its root; with standard error.

    The error is that of values - ratio · yardstick (delta method), in which effects common to both cancel. A run with a
    NaN in either is left out.
    """
    a, b = np.asarray(values, dtype=float), np.asarray(yardstick, dtype=float)
    both = np.isfinite(a) & np.isfinite(b)
    a, b = a[both], b[both]
    r = float(a.mean() / b.mean())
    se = float(np.std(a - r * b, ddof=1) / np.sqrt(len(a)) / b.mean())
    return {"value": float(np.sqrt(r)), "se": se / (2 * float(np.sqrt(r)))} if root else {"value": r, "se": se}


def beyond(found: Row, margin: float = MARGIN) -> float:
    """Excess of a ratio's distance from 1 over the margin, in standard errors. Not positive within the margin."""
    excess = abs(found["value"] - 1) - margin
    return float(excess / found["se"]) if found["se"] > 0 else float(np.sign(excess) * np.inf if excess else 0.0)


def by_run(study: Study, name: str) -> dict[str, Array]:
    """Mean pose NEES, and mean square errors of position and heading, of each run (M,). NaN where the filter failed."""
    squares = np.array([t.mean_square_error for t in study.trials[name]])
    nees = np.array([t.mean_nees[0] for t in study.trials[name]])
    return {"pose_nees": nees, "position_rmse_m": squares[:, 0], "heading_rmse_deg": squares[:, 1]}


# -- the experiments --------------------------------------------------------------------------------------------------


def loop(study: Study, reference: Mapping[str, tuple[tuple[float, float | None], float, float | None]]) -> list[Row]:
    """One row for each filter: measured and reference values, and ratios to the ideal filter in the same runs."""
    ideal = by_run(study, "ideal")
    rows = []
    for name, summary in study.summary().items():
        own = by_run(study, name)
        expected: tuple[Any, ...] = reference.get(name, (None, None, None))
        measured = {}
        for key, value in zip(MEASURES, expected, strict=True):
            known, error = value if isinstance(value, tuple) else (value, None)
            measured[key] = {
                "value": summary[key], "se": summary[f"{key}_se"], "reference": known, "reference_se": error,
            }  # fmt: skip
        ratios = {key: ratio(own[key], ideal[key], root="rmse" in key) for key in MEASURES}
        rows.append(
            {
                "filter": name,
                "runs": study.runs,
                **measured,
                "pose_nees_median": summary["pose_nees_median"],
                "to_ideal": ratios,
                "within": all(beyond(r) <= 0 for r in ratios.values()) if name in JUDGED else None,
            }
        )
    return rows


def scattered_map(map_seed: int) -> World:
    """The world of A with landmarks anywhere around the circle, instead of one in each twentieth of it."""
    world = loop_world()
    rng = np.random.default_rng(map_seed)
    n, radius = len(world.landmarks), float(world.controls[0, 0] / world.controls[0, 1])
    angle = rng.uniform(0.0, 2 * np.pi, n)
    distance = radius + rng.uniform(0.5, 5.0, n) * np.where(np.arange(n) % 2 == 0, 1, -1)
    places = np.column_stack([distance * np.cos(angle), radius + distance * np.sin(angle)])
    return replace(world, landmarks=dict(enumerate(places)))


MAP_KINDS: dict[str, Callable[[int], World]] = {
    "one in each twentieth": lambda map_seed: loop_world(map_seed=map_seed),
    "anywhere": scattered_map,
}


def maps(run: Run, runs: int) -> list[Row]:
    """One row for each map: the standard EKF and the ideal filter."""
    rows = []
    for kind, make in MAP_KINDS.items():
        for map_seed in MAPS:
            study = run(f"maps, {kind}, map {map_seed}", ("ideal", "ekf"), make(map_seed), runs)
            rows.append({"landmarks": kind, "map_seed": map_seed, "runs": runs, "filters": study.summary()})
    return rows


def ring(study: Study, known_exactly: bool) -> list[Row]:
    """One row for each filter and measure: measured and published value, and their difference in standard errors.

    If `known_exactly`, the standard error is that of the measured value. Otherwise it is that of the difference, where
    the published runs are assumed to scatter as the measured ones do.
    """
    rows = []
    for name, summary in study.summary().items():
        for (key, (_, dof, _)), published in zip(RING_MEASURES.items(), PUBLISHED[name], strict=True):
            value, se = summary[key] / dof, summary[f"{key}_se"] / dof
            published_se = 0.0 if known_exactly else se * float(np.sqrt(study.runs / PUBLISHED_RUNS))
            z = (value - published) / float(np.hypot(se, published_se))
            rows.append(
                {
                    "filter": name, "measure": key, "runs": study.runs, "value": value, "se": se,
                    "published": published, "published_se": published_se, "z": z,
                    "within": bool(abs(z) <= ERRORS_ALLOWED),
                }
            )  # fmt: skip
    return rows


def standing(run: Run, runs: int) -> list[Row]:
    """One row for each σ₀ and order of the updates: deviations claimed by the EKF and by the consistent filters."""
    rows = []
    for order in ORDERS:
        for degrees, printed in CLAIMED.items():
            world = standing_world(np.deg2rad(degrees))
            title = f"C, σ₀ = {degrees:g}°, {order} updates"
            study = run(title, ("ekf", *JUDGED), world, runs, options={"order": order})
            done = study.finished("ekf")
            claimed = np.degrees([t.sigmas[-1, 2] for t in done])
            spread = float(claimed.std(ddof=1))
            z = (printed - float(claimed.mean())) / spread
            change = {
                name: max(float(np.abs(np.degrees(t.sigmas[:, 2]) / degrees - 1).max()) for t in study.finished(name))
                for name in JUDGED
            }
            rows.append(
                {
                    "sigma_0_deg": degrees,
                    "order": order,
                    "runs": study.runs,
                    "claimed_deg": mean(claimed),
                    "median_deg": float(np.median(claimed)),
                    "spread_deg": spread,
                    "reference_deg": printed,
                    "z_of_one_run": z,
                    "within": bool(abs(z) <= SPREADS_ALLOWED),
                    "attained_deg": float(np.degrees(np.sqrt(np.mean([t.errors[-1, 2] ** 2 for t in done])))),
                    "kept_deg": {
                        name: mean(np.degrees([t.sigmas[-1, 2] for t in study.finished(name)])) for name in JUDGED
                    },
                    "largest_relative_change": change,
                    "kept": {name: bool(value <= KEPT) for name, value in change.items()},
                }
            )
    return rows


# -- tables -----------------------------------------------------------------------------------------------------------


def plus_minus(value: float | None, se: float | None, digits: int) -> str:
    """A number in a table, with its standard error if there is one."""
    if value is None:
        return "–"
    return f"{value:.{digits}f}" + ("" if se is None else f" ± {se:.{digits}f}")


def table(header: Sequence[str], rows: Sequence[Sequence[str]], left: int) -> list[str]:
    """A Markdown table. The first `left` columns are left-aligned, the others right-aligned."""
    align = [":--" if column < left else "--:" for column in range(len(header))]
    return [f"| {' | '.join(row)} |" for row in (header, align, *rows)]


def loop_table(rows: Sequence[Row]) -> list[str]:
    """Experiments A and D: measured and reference values."""
    header = ["filter", *(cell for title in MEASURES.values() for cell in (title, "reference")), "median NEES"]
    return table(
        header,
        [
            [
                row["filter"],
                *(
                    cell
                    for key, digits in DIGITS.items()
                    for m in [row[key]]
                    for cell in (
                        plus_minus(m["value"], m["se"], digits),
                        plus_minus(m["reference"], m["reference_se"], digits),
                    )
                ),
                f"{row['pose_nees_median']:.2f}",
            ]
            for row in rows
        ],
        1,
    )


def within_text(row: Row) -> str:
    """Whether the ratios of a filter are within the margin; if not, by how much they are outside."""
    if row["within"] is None:
        return "–"
    outside = [
        f"{MEASURES[key].split(' [')[0].removesuffix(' (3)')} by {max(beyond(r), 0):.1f} SE"
        for key, r in row["to_ideal"].items()
        if beyond(r) > 0
    ]
    return "NO: " + ", ".join(outside) if outside else "yes"


def ratio_table(rows: Sequence[Row]) -> list[str]:
    """Ratio of each filter to the ideal one in the same runs."""
    return table(
        ("filter", "runs", "NEES / ideal", "position RMSE / ideal", "heading RMSE / ideal", "within 10 %"),
        [
            [
                row["filter"],
                str(row["runs"]),
                *(plus_minus(r["value"], r["se"], 3) for r in row["to_ideal"].values()),
                within_text(row),
            ]
            for row in rows
            if row["filter"] != "ideal"
        ],
        1,
    )


def map_table(rows: Sequence[Row]) -> list[str]:
    """Experiment A with other maps."""
    return table(
        ("landmarks", "map", "EKF NEES", "its median", "ideal NEES", "EKF position RMSE [m]", "ideal"),
        [
            [
                row["landmarks"],
                str(row["map_seed"]),
                plus_minus(ekf["pose_nees"], ekf["pose_nees_se"], 1),
                f"{ekf['pose_nees_median']:.1f}",
                plus_minus(ideal["pose_nees"], ideal["pose_nees_se"], 1),
                plus_minus(ekf["position_rmse_m"], ekf["position_rmse_m_se"], 2),
                plus_minus(ideal["position_rmse_m"], ideal["position_rmse_m_se"], 2),
            ]
            for row in rows
            for ekf, ideal in [(row["filters"]["ekf"], row["filters"]["ideal"])]
        ],
        1,
    )


def ring_table(rows: Sequence[Row]) -> list[str]:
    """Experiment B: measured and published values."""
    return table(
        ("filter", "measure", "runs", "measured", "published", "difference / SE", "within 3"),
        [
            [
                row["filter"],
                title,
                str(row["runs"]),
                plus_minus(row["value"], row["se"], digits),
                plus_minus(row["published"], row["published_se"] or None, 2),
                f"{row['z']:+.1f}",
                "yes" if row["within"] else "NO",
            ]
            for row in rows
            for title, _, digits in [RING_MEASURES[row["measure"]]]
        ],
        2,
    )


def standing_table(rows: Sequence[Row]) -> list[str]:
    """Experiment C: deviations claimed for a heading that no sensor measures."""
    return table(
        ("updates", "σ₀ [°]", "EKF claims [°]", "spread of runs [°]", "reference [°]", "(reference - mean) / spread",
         "within 2", "EKF errs by [°]", "fej, oc, invariant change σ₀ by"),
        [
            [
                row["order"],
                f"{row['sigma_0_deg']:g}",
                plus_minus(row["claimed_deg"]["value"], row["claimed_deg"]["se"], 3),
                f"{row['spread_deg']:.3f}",
                f"{row['reference_deg']:.3f}",
                f"{row['z_of_one_run']:+.1f}",
                "yes" if row["within"] else "NO",
                f"{row['attained_deg']:.2f}",
                f"{max(row['largest_relative_change'].values()):.0g}",
            ]
            for row in rows
        ],
        1,
    )  # fmt: skip


SUMMARY = ("world, runs", "filter", "measure", "measured", "in more runs", "published or reference", "limit", "met")


def summary_rows(results: Row) -> list[tuple[str, ...]]:
    """Targets and results, with the columns of SUMMARY."""
    rows: list[tuple[str, ...]] = []
    for letter, found in results.items():
        if letter in SENSORS:
            rows += loop_summary(letter, found["rows"], {row["filter"]: row for row in found["longer"]})
        elif letter == "B":
            rows += ring_summary(found["rows"], found["longer"])
        else:
            rows += standing_summary(found["rows"])
    return rows


def loop_summary(letter: str, rows: Sequence[Row], longer: Mapping[str, Row]) -> list[tuple[str, ...]]:
    """Experiments A and D: values of the ideal filter and the EKF, and ratios of the judged filters."""

    def numbers(row: Row, value: str, se: str) -> str:
        return ", ".join(plus_minus(row[key][value], row[key][se], digits) for key, digits in DIGITS.items())

    def ratios(row: Row) -> str:
        return ", ".join(plus_minus(r["value"], r["se"], 3) for r in row["to_ideal"].values())

    def known(row: Row, key: str) -> str:
        a, b = row[key]["reference"], rows[0][key]["reference"]
        return "–" if a is None else f"{a / b:.2f}"

    found: list[tuple[str, ...]] = []
    for row in rows:
        name, more = row["filter"], longer.get(row["filter"])
        start = (f"{letter}: loop, {row['runs']}" + (f" → {more['runs']}" if more else ""), name)
        if name in ("ideal", "ekf"):
            measure = "pose NEES (3), position RMSE [m], heading RMSE [°]"
            continued = numbers(more, "value", "se") if more else "–"
            cells = (numbers(row, "value", "se"), continued, numbers(row, "reference", "reference_se"), "–", "–")
            found.append((*start, measure, *cells))
        elif more:
            expected = ", ".join(known(row, key) for key in MEASURES)
            verdicts = f"{within_text(row)}; {within_text(more)}"
            found.append(
                (*start, "the same over the ideal's", ratios(row), ratios(more), expected, "1 ± 0.1", verdicts)
            )
    return found


def ring_summary(rows: Sequence[Row], longer: Sequence[Row]) -> list[tuple[str, ...]]:
    """Experiment B: one row for each filter."""

    def of(name: str, results: Sequence[Row]) -> tuple[str, str]:
        own = [row for row in results if row["filter"] == name]
        cells = [plus_minus(row["value"], row["se"], RING_MEASURES[row["measure"]][2]) for row in own]
        return ", ".join(cells), "yes" if all(row["within"] for row in own) else "NO"

    return [
        (
            f"B: ring, {rows[0]['runs']} → {longer[0]['runs']}",
            name,
            "RMSE of heading [°] and position [m], NEES / dof of both",
            of(name, rows)[0],
            of(name, longer)[0],
            ", ".join(f"{value:.2f}" for value in published),
            "3 SE",
            f"{of(name, rows)[1]}; {of(name, longer)[1]}",
        )
        for name, published in PUBLISHED.items()
    ]


def standing_summary(rows: Sequence[Row]) -> list[tuple[str, ...]]:
    """Experiment C: one row for each order of the EKF, and one for the judged filters."""
    found: list[tuple[str, ...]] = []
    for order in ORDERS:
        own = [row for row in rows if row["order"] == order]
        found.append(
            (
                f"C: standing, {own[0]['runs']}",
                f"ekf, {order}",
                f"claimed [°] from σ₀ = {', '.join(format(row['sigma_0_deg'], 'g') for row in own)}°",
                ", ".join(plus_minus(row["claimed_deg"]["value"], row["claimed_deg"]["se"], 3) for row in own),
                "–",
                ", ".join(f"{row['reference_deg']:.3f}" for row in own),
                "2 deviations of a run",
                "yes" if all(row["within"] for row in own) else "NO",
            )
        )
    largest = max(change for row in rows for change in row["largest_relative_change"].values())
    kept = all(all(row["kept"].values()) for row in rows)
    cells = ("largest change of σ₀, relative", f"{largest:.0g}", "–", "0", f"{KEPT:.0e}", "yes" if kept else "NO")
    return [*found, (found[0][0], ", ".join(JUDGED), *cells)]


def loop_section(letter: str, results: Row) -> list[str]:
    """Section on experiment A or D."""
    rows, longer = results["rows"], results["longer"]
    runs, more = rows[0]["runs"], longer[0]["runs"]
    bounds = chi2_bounds(3, runs)
    world = "relative positions" if letter == "A" else "range and bearing"
    return [
        f"## {letter}. Loop world, {world}: {runs} runs of one map", "",
        "Map 0 of `loop_world`; the reference's map is another one, so that only the ratios below can be held against "
        "a limit. A consistent filter's mean NEES at one step lies in "
        f"[{bounds.lower:.2f}, {bounds.upper:.2f}] (95 %).", "",
        *loop_table(rows), "",
        f"Over the ideal filter in the same runs, and the same study continued to {more} runs. Limit for fej, oc and "
        "invariant: each ratio within 10 % of one; where it is not, how many standard errors (SE) it lies beyond.", "",
        *ratio_table([*rows, *longer]), "",
    ]  # fmt: skip


def map_section(rows: Sequence[Row]) -> list[str]:
    """Section on other maps."""
    ranges = [
        f"{min(found):.1f} to {max(found):.1f}"
        for kind in MAP_KINDS
        for found in [[row["filters"]["ekf"]["pose_nees"] for row in rows if row["landmarks"] == kind]]
    ]
    return [
        f"## Experiment A on other maps: {rows[0]['runs']} runs of each", "",
        "`loop_world` draws one landmark in each twentieth of the circle; here also maps with each landmark anywhere "
        f"around it. The EKF's mean NEES goes from {' on the former and from '.join(ranges)} on the latter; the "
        f"reference had {REFERENCE_MAPS[0]} on its map and {REFERENCE_MAPS[1]} on another. So no single number stands "
        "for the EKF: it depends on the map, and on one map the mean depends on a few bad runs (see the median).", "",
        *map_table(rows), "",
    ]  # fmt: skip


def ring_section(results: Row) -> list[str]:
    """Section on experiment B."""
    rows, longer = results["rows"], results["longer"]
    return [
        f"## B. Ring world: {rows[0]['runs']} runs", "",
        "Published: Brossard, Barrau & Bonnabel, UKF-M (ICRA 2020), benchmark \"2D Robot SLAM\", "
        f"{PUBLISHED_RUNS} runs, without standard errors; so the difference is in standard errors of what is measured "
        "here, as if the published value were exact. RMSE over time and runs, NEES a degree of freedom over time and "
        "runs; all sightings of a scan in one update, as there (`order=\"batch\"`). The filters share their noise, and "
        "the four measures their errors: the rows do not vary independently.", "",
        *ring_table(rows), "",
        f"The same study continued to {longer[0]['runs']} runs. The published values are given the standard error that "
        f"{PUBLISHED_RUNS} of these runs have, and the difference that of both.", "",
        *ring_table(longer), "",
    ]  # fmt: skip


def standing_section(rows: Sequence[Row]) -> list[str]:
    """Section on experiment C."""
    large = [row["spread_deg"] for row in rows if row["sigma_0_deg"] >= 2]
    return [
        f"## C. Standing robot: {rows[0]['runs']} runs of each, 300 scans", "",
        "What the standard EKF claims for its heading after the last scan, where nothing measures the heading and the "
        "claim must stay σ₀. From σ₀ = 2° on the claims of single runs scatter by "
        f"{min(large):.1f} to {max(large):.1f}° (standard deviation). The reference does not say over how many runs it "
        "was taken; its values scatter as those of one run or a few would. Limit: each lies within 2 standard "
        "deviations of a single run from the mean, which is weak where runs scatter so; ± is the standard error of the "
        "mean. Two orders of the updates, since the reference does not name its own: landmark by landmark, or a scan "
        "at once.", "",
        *standing_table(rows), "",
        "The EKF errs by: root mean square of its heading errors at the end. The last column: the largest relative "
        "change of what the three claim, in any step of any run.", "",
    ]  # fmt: skip


def markdown(facts: Row, results: Row) -> str:
    """The report: all tables with explanations."""
    lines = ["# Experiments", ""]
    lines += [
        "Every filter runs over the same simulated runs. ± is one standard error over the runs; NEES is not divided by "
        "its degrees of freedom unless a heading says so. Reference: an earlier calculation with a map and noise of "
        f"its own. Seed {facts['seed']}. `python benchmarks/experiments.py` makes this page.",
        "",
    ]
    lines += [*table(SUMMARY, summary_rows(results), 3), ""]
    lines += ["In more runs: the same study continued. Met: as named, and then in more runs. Details follow.", ""]
    for letter in results:
        if letter in SENSORS:
            lines += loop_section(letter, results[letter])
        elif letter == "B":
            lines += ring_section(results["B"])
        else:
            lines += standing_section(results["C"]["rows"])
        if letter == "A":
            lines += map_section(results["A"]["maps"])
    wrong = facts["failed_or_diverged"]
    lines += ["Failed or diverged (the latter do enter the numbers):", "", *wrong, ""] if wrong else []
    lines += [f"{sentence(facts['machine'])}.", ""]
    return "\n".join(lines)


# -- the figure -------------------------------------------------------------------------------------------------------


def draw(results: Row, path: Path) -> None:
    """Draw one panel for each experiment, and one for the maps."""
    import matplotlib
    from matplotlib.figure import Figure

    panels = [name for name in ("A", "D", "maps", "B", "C") if name in results or (name == "maps" and "A" in results)]
    top = [name for name in panels if name in ("A", "D", "maps")]
    bottom = [name for name in panels if name in ("B", "C")]
    rows = [row for row in (top, bottom) if row]
    width = int(np.lcm.reduce([len(row) for row in rows]))
    layout: list[Any] = [[name for name in row for _ in range(width // len(row))] for row in rows]
    with matplotlib.rc_context(
        {"font.size": 9.0, "axes.linewidth": 0.7, "xtick.labelsize": 8.0, "ytick.labelsize": 8.0}
    ):
        figure = Figure(figsize=(11.0, 0.5 + 3.2 * len(rows)), layout="constrained")
        axes: dict[str, Axes] = figure.subplot_mosaic(layout)
        for name, ax in axes.items():
            if name in SENSORS:
                draw_loop(ax, letter=name, rows=results[name]["rows"])
            elif name == "maps":
                draw_maps(ax, results["A"]["maps"])
            elif name == "B":
                draw_ring(ax, results["B"]["rows"])
            else:
                draw_standing(ax, results["C"]["rows"])
        for name in SENSORS:
            if name in axes:
                axes[name].set_xlim(0, max(axes[n].get_xlim()[1] for n in SENSORS if n in axes))
        shared_legend(figure, list(axes.values()))
        save(figure, path, dpi=150)


#: Look of a value that is not measured here.
KNOWN: Row = {
    "marker": "D", "markersize": 5, "markerfacecolor": "white", "markeredgecolor": "black", "linestyle": "none",
    "zorder": 4, "label": "reference",
}  # fmt: skip


def title(ax: Axes, text: str) -> None:
    """Write the title of a panel."""
    ax.set_title(text, fontsize=9, loc="left")


def draw_loop(ax: Axes, letter: str, rows: Sequence[Row]) -> None:
    """Bars of the pose NEES, with markers at the reference values."""
    values = {row["filter"]: row["pose_nees"] for row in rows}
    bounds = chi2_bounds(3, rows[0]["runs"])
    bars = plot_bars(
        ax,
        {name: v["value"] for name, v in values.items()},
        {name: v["se"] for name, v in values.items()},
        label="pose NEES (3 degrees of freedom)",
        band=(float(bounds.lower), float(bounds.upper)),
    )
    for name in values:
        bars[name][-1].remove()  # the marker of the reference would cover the text
    reference = [
        (row, v["reference"], v["reference_se"] or 0.0) for row, v in enumerate(values.values()) if v["reference"]
    ]
    at, known, error = (np.array(column) for column in zip(*reference, strict=True))
    at = at + 0.18  # beside the error bar of the measured value
    ax.errorbar(
        known, at, xerr=np.where(error > 0, error, np.nan), ecolor="black", elinewidth=1.0, capsize=2.5, **KNOWN
    )
    ends = [v["value"] + v["se"] for v in values.values()] + list(known + error)
    ax.set_xlim(0, 1.08 * max(ends))
    sensor = "relative positions" if letter == "A" else "range and bearing"
    title(ax, f"{letter}: loop, {sensor}, {rows[0]['runs']} runs")


def draw_maps(ax: Axes, rows: Sequence[Row]) -> None:
    """NEES of the standard EKF and the ideal filter with each map."""
    at = np.arange(len(rows)) + np.array([0.8 if row["landmarks"] == "anywhere" else 0.0 for row in rows])
    for name in ("ekf", "ideal"):
        look = style(name)
        found = [row["filters"][name] for row in rows]
        value, se = np.array([v["pose_nees"] for v in found]), np.array([v["pose_nees_se"] for v in found])
        ax.errorbar(
            at, value, yerr=[np.minimum(se, 0.9 * value), se], fmt=look.marker, color=look.color, markersize=6,
            markeredgecolor="black", markeredgewidth=0.5, elinewidth=1.0, capsize=2.5, label=look.label,
        )  # fmt: skip
    ax.axhline(3.0, color="0.5", linewidth=0.8, zorder=0)
    last = at[-1] + 1.8
    ax.plot([last] * len(REFERENCE_MAPS), REFERENCE_MAPS, **KNOWN)
    ax.set_yscale("log")
    top = max(2.5 * ax.get_ylim()[1], 200.0)
    ticks = [v for v in (2, 3, 5, 10, 20, 50, 100, 200, 500, 1000) if v <= top / 2]
    ax.set_yticks(ticks, [str(v) for v in ticks])
    ax.minorticks_off()
    ax.set_ylim(1.5, top)
    ax.set_xticks([*at, last], [*(str(row["map_seed"]) for row in rows), "ref."])
    for kind in MAP_KINDS:
        own = at[[row["landmarks"] == kind for row in rows]]
        text = fill(f"landmarks {kind}", 16)
        ax.text(own.mean(), 0.97, text, ha="center", va="top", fontsize=8, transform=ax.get_xaxis_transform())
    ax.set(xlabel="map", ylabel="pose NEES (3)")
    title(ax, f"A on other maps, {rows[0]['runs']} runs of each")


def draw_ring(ax: Axes, rows: Sequence[Row]) -> None:
    """Measured divided by published values, with the allowed errors."""
    keys = list(RING_MEASURES)
    names = list(dict.fromkeys(row["filter"] for row in rows))
    ax.axvline(1.0, color="black", linewidth=0.8, zorder=0)
    for k, name in enumerate(names):
        look = style(name)
        own = [row for row in rows if row["filter"] == name]
        at = np.array([keys.index(row["measure"]) for row in own]) + 0.22 * (k - (len(names) - 1) / 2)
        value, se = (np.array([row[key] / row["published"] for row in own]) for key in ("value", "se"))
        ax.errorbar(value, at, xerr=ERRORS_ALLOWED * se, fmt="none", ecolor=look.color, elinewidth=0.8)
        ax.errorbar(
            value, at, xerr=se, fmt=look.marker, color=look.color, markersize=6, markeredgecolor="black",
            markeredgewidth=0.5, elinewidth=2.6, label=look.label,
        )  # fmt: skip
    ax.set_yticks(range(len(keys)), [name for name, _, _ in RING_MEASURES.values()])
    ax.set_ylim(len(keys) - 0.5, -0.5)
    ax.tick_params(axis="y", length=0)
    ax.set_xlabel("measured / published (±1 and ±3 standard errors)")
    title(ax, f"B: ring, {rows[0]['runs']} runs")


def draw_standing(ax: Axes, rows: Sequence[Row]) -> None:
    """Claimed deviation over the initial one, both on logarithmic axes."""
    ekf = style("ekf")
    own = [row for row in rows if row["order"] == ORDERS[0]]
    sigma = np.array([row["sigma_0_deg"] for row in own])
    claimed = np.array([row["claimed_deg"]["value"] for row in own])
    spread = np.array([row["spread_deg"] for row in own])
    for name, size in zip(JUDGED, (11, 8, 5), strict=True):  # they coincide, so draw one inside the other
        look = style(name)
        ax.plot(
            sigma, [row["kept_deg"][name]["value"] for row in own], color=look.color, linestyle=look.linestyle,
            marker=look.marker, markersize=size, markeredgecolor="black", markeredgewidth=0.5, label=look.label,
        )  # fmt: skip
    ax.fill_between(sigma, claimed - spread, claimed + spread, color=ekf.color, alpha=0.25, linewidth=0)
    ax.plot(
        sigma, claimed, color=ekf.color, linestyle=ekf.linestyle, marker=ekf.marker, markersize=6,
        markeredgecolor="black", markeredgewidth=0.5, label=ekf.label,
    )  # fmt: skip
    ax.plot(
        sigma, [row["attained_deg"] for row in own], "o", markersize=14, markerfacecolor="none",
        markeredgecolor="black", label="RMS error of the EKF",
    )  # fmt: skip
    ax.plot(sigma, [row["reference_deg"] for row in own], **KNOWN)
    ax.set(xscale="log", yscale="log", xlabel="initial deviation σ₀ of the heading [°]")
    ax.set_ylabel("claimed σ after 300 scans [°]")
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_ticks(sigma, [f"{v:g}" for v in sigma])
    ax.minorticks_off()
    title(ax, f"C: standing robot, {own[0]['runs']} runs of each; band: spread of runs")


# -- the script -------------------------------------------------------------------------------------------------------


def main(
    only: Annotated[str, typer.Option(metavar="A,B,…", help="Experiments; the maps belong to A.")] = "A,B,C,D",
    runs: Annotated[int | None, typer.Option(min=2, help="Runs of each; by default 50, 100, 100, 50.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the runs.")] = 1,
    jobs: Annotated[int, typer.Option(min=1, help="Processes.")] = 2,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where to write.")] = Path(__file__).parent / "results",
) -> None:
    """Repeat the experiments and compare every number with the published or reference value."""
    console = Console(highlight=False)
    chosen = only.split(",")
    for letter in chosen:
        if letter not in "ABCD" or len(letter) != 1:
            raise typer.BadParameter(f"experiment {letter!r}, expected one of A, B, C, D")
    facts: Row = {"machine": machine(), "seed": seed, "jobs": jobs, "failed_or_diverged": []}
    plain: Row = {"soft_wrap": True, "markup": False}
    console.print(sentence(facts["machine"]), **plain)
    count = {name: named if runs is None else runs for name, named in RUNS.items()}

    def run(title: str, filters: Sequence[str], world: World, runs: int, **more: Any) -> Study:
        console.print(f"{title}: {runs} runs of {len(filters)} filters", **plain)
        study = compare(filters, world, runs, seed, jobs=jobs, progress=True, gauge_steps=0, **more)
        facts["failed_or_diverged"] += [
            f"- {title}: {trial.filter}, run {trial.number}: {trial.error or 'diverged'}" for trial in study.failures
        ]
        return study

    results: Row = {}
    for letter in sorted(set(chosen)):
        begin = time.perf_counter()
        if letter in SENSORS:
            world = loop_world("relative" if letter == "A" else "range-bearing")
            found: Row = {
                "rows": loop(run(letter, FAMILY, world, count[letter]), REFERENCE[letter]),
                "longer": loop(run(f"{letter}, longer", ("ideal", *JUDGED), world, LONGER[letter] * count[letter]), {}),
            }
            if letter == "A":
                found["maps"] = maps(run, count["maps"])
        elif letter == "B":
            ours = (tuple(PUBLISHED), ring_world())
            once, more = count["B"], LONGER["B"] * count["B"]
            found = {
                "rows": ring(run("B", *ours, once, options={"order": "batch"}), known_exactly=True),
                "longer": ring(run("B, longer", *ours, more, options={"order": "batch"}), known_exactly=False),
            }
        else:
            found = {"rows": standing(run, count["C"])}
        results[letter] = {"seconds": time.perf_counter() - begin, **found}
    out.mkdir(parents=True, exist_ok=True)
    text = markdown(facts, results)
    for where, name, measure, measured, continued, known, limit, met in summary_rows(results):
        console.print(f"{where}, {name}: {measure}", **plain)
        console.print(f"    {measured}; in more runs: {continued}; expected: {known}; limit {limit}: {met}", **plain)
    write_json(out / "experiments.json", {**facts, "results": results})
    (out / "experiments.md").write_text(text, encoding="utf-8")
    draw(results, out / "experiments.png")


if __name__ == "__main__":
    typer.run(main)
