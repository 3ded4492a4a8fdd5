"""Run every filter over every robot of the MRCLAM sets 1, 2, 3 and 6, with default parameters.

    python benchmarks/mrclam.py [--filters ekf,fej] [--sets 1,6] [--data DIR] [--jobs J] [--out DIR]

There are two heading NEES, with 1 degree of freedom each; the median of a consistent filter is 0.455. The first is in
the frame of the start, which the filter claims to know. It is missing if the truth begins later. The second is after
alignment of the whole trajectory, like all other errors; the alignment removes the error of the filter's frame.

The script writes mrclam.json and mrclam.md. `slamkit fetch mrclam 1` downloads a set.
"""

from __future__ import annotations

import os

# One thread for each process. The libraries of NumPy and SciPy read these variables once, when they are loaded.
os.environ.update(
    dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1")
)

import re
from collections.abc import Sequence
from itertools import compress
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from _machine import machine, sentence
from joblib import Parallel, delayed
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import track
from rich.table import Table

from slamkit import Log, SlamkitError
from slamkit.arrays import Array
from slamkit.datasets import mrclam
from slamkit.evaluate import dead_reckoning, evaluate, heading_nees, nearest
from slamkit.evaluate.run_report import Assessment, write_json
from slamkit.filters import FILTERS
from slamkit.logs import History

NEED_TRUTH = {"ideal"}  # filters that linearise at the truth, which a real robot does not have
MAX_GAP = 0.1  # [s]; largest time between a pose and its truth
FINEST = 1e-3  # [rad]; accuracy of the true headings; below it NEES would measure the truth and not the filter
COLUMNS = {  # name in the JSON → heading in the tables, digits after the decimal point
    "ate_m": ("ATE [m]", 3),
    "dead_reckoning_ate_m": ("dead reck. [m]", 2),
    "landmark_rmse_m": ("land- marks [m]", 3),
    "heading_rmse_deg": ("head- ing [°]", 2),
    "heading_nees_start": ("NEES, start", 2),
    "heading_nees_aligned": ("NEES, aligned", 2),
    "rejected": ("re- jected", 0),
    "microseconds_a_step": ("step [µs]", 2),
}


def data_folder() -> Path:
    """Default folder of the sets: mrclam/ in the folder named by SLAMKIT_DATA, or in ../shared/data."""
    named = os.environ.get("SLAMKIT_DATA")
    return (Path(named) if named else Path(__file__).resolve().parents[2] / "shared" / "data") / "mrclam"


def find(folder: Path, sets: Sequence[int]) -> dict[int, Path]:
    """The zip or folder of each set that exists."""
    entries = sorted(folder.iterdir()) if folder.is_dir() else []
    numbers = {entry: re.search(r"MR[A-Z]?LAM\D*([1-9])(?!\d)", entry.name, re.IGNORECASE) for entry in entries}
    there = {int(match[1]): entry for entry, match in numbers.items() if match}
    return {number: there[number] for number in sets if number in there}


def runs(number: int, path: Path, robot: int, filters: Sequence[str]) -> list[dict[str, Any]]:
    """Run every filter over the log of one robot. A filter that fails is recorded with the reason."""
    data = mrclam.read(path, robot)
    motion, sensor = mrclam.models()
    reckoning = dead_reckoning(data.log, motion)
    baseline = evaluate(*reckoning, data.log.truth, max_gap=MAX_GAP)
    results = []
    for name in filters:
        result: dict[str, Any] = {"set": number, "robot": robot, "truth": data.truth_kind, "filter": name}
        try:
            FILTERS[name](motion, sensor, gate=mrclam.GATE).run(data.log.head(2))  # load the compiled code
            history = FILTERS[name](motion, sensor, gate=mrclam.GATE).run(data.log)
        except SlamkitError as error:
            results.append({**result, "error": str(error)})
            continue
        found = dict(zip(history.landmark_ids, history.landmarks, strict=True))
        evaluation = evaluate(history.times, history.poses, data.log.truth, found, max_gap=MAX_GAP)
        summary = Assessment(history, evaluation, reckoning, baseline).summary
        results.append(
            {
                **result,
                "error": None,
                **{key: value for key, value in summary.items() if key != "filter"},
                "heading_nees_start": in_frame_of_start(history, data.log) if data.truth_kind == "full" else None,
                "heading_nees_aligned": median_nees(history, data.log, evaluation.poses),
                "microseconds_a_step": 1e6 * history.seconds / len(history.times),
            }
        )
    return results


def in_frame_of_start(history: History, log: Log) -> float | None:
    """Median heading NEES of the motion since the first true pose. Every filter starts with P₀ = 0."""
    assert log.truth is not None
    rows, truth_rows = nearest(history.times, log.truth.times, MAX_GAP)
    if len(rows) == 0:
        return None
    first, true_first = history.poses[rows[0]], log.truth.poses[truth_rows[0]]
    return median_nees(history, log, history.poses + np.array([0.0, 0.0, true_first[2] - first[2]]))


def median_nees(history: History, log: Log, poses: Array) -> float | None:
    """Median heading NEES over the matched steps where the claimed deviation exceeds the accuracy of the truth."""
    assert log.truth is not None
    rows, truth_rows = nearest(history.times, log.truth.times, MAX_GAP)
    kept = history.pose_covariances[rows, 2, 2] > FINEST**2
    rows, truth_rows = rows[kept], truth_rows[kept]
    if len(rows) == 0:
        return None
    nees = heading_nees(poses[rows], history.pose_covariances[rows], log.truth.poses[truth_rows])
    return float(np.median(nees.values))


# -- reporting --------------------------------------------------------------------------------------------------------


def text(value: float | None, digits: int) -> str:
    """A number in a table."""
    return "–" if value is None else f"{value:.{digits}f}"


def over_robots(key: str, values: Sequence[float | None], digits: int) -> str:
    """Mean over the robots. For rejections the sum, for NEES median and worst: one robot can dominate its mean."""
    numbers = [value for value in values if value is not None]
    if not numbers:
        return "–"
    if key.startswith("heading_nees"):
        worst = max(numbers)
        return f"{np.median(numbers):.{digits}f} ({worst:.{0 if worst >= 10 else 1}f})"
    return text(float(np.sum(numbers) if key == "rejected" else np.mean(numbers)), digits)


def family_rows(results: Sequence[dict[str, Any]]) -> list[tuple[str, ...]]:
    """One row for each set and filter."""
    rows = []
    for number in dict.fromkeys(result["set"] for result in results):
        for name in dict.fromkeys(result["filter"] for result in results):
            of = [r for r in results if (r["set"], r["filter"]) == (number, name)]
            done = [r for r in of if r["error"] is None]
            cells = [over_robots(key, [r[key] for r in done], digits) for key, (_, digits) in COLUMNS.items()]
            rows.append((str(number), name, f"{len(done)}/{len(of)}", *cells))
    return rows


def robot_rows(results: Sequence[dict[str, Any]], name: str) -> list[tuple[str, ...]]:
    """One row for each robot, for one filter."""
    return [
        (
            str(r["set"]),
            str(r["robot"]),
            *(
                ["failed"] * len(COLUMNS)
                if r["error"]
                else [text(r[key], digits) for key, (_, digits) in COLUMNS.items()]
            ),
        )
        for r in results
        if r["filter"] == name
    ]


HEADINGS = tuple(heading.replace("- ", "") for heading, _ in COLUMNS.values())


def markdown(facts: dict[str, Any], results: Sequence[dict[str, Any]], jobs: int) -> str:
    """The tables as Markdown, and every failure with its reason."""

    def table(header: Sequence[str], rows: Sequence[Sequence[str]], left: int) -> list[str]:
        align = [":--" if column < left else "--:" for column in range(len(header))]
        return [f"| {' | '.join(row)} |" for row in (header, align, *rows)]

    motion, sensor = mrclam.models()
    lines = table(("set", "filter", "ran", *HEADINGS), family_rows(results), 3)
    lines += ["", "Over the robots of a set: means; of the heading NEES the median and, in parentheses, the worst.", ""]
    for name in dict.fromkeys(result["filter"] for result in results):
        lines += [f"### {name}, robot by robot", ""]
        lines += [*table(("set", "robot", *HEADINGS), robot_rows(results, name), 2), ""]
    lines += [
        f"- FAILED: set {r['set']}, robot {r['robot']}, {r['filter']}: {r['error']}" for r in results if r["error"]
    ]
    lines += [
        "One set of parameters for every robot, set and filter: "
        f"`{motion!r}`, `{sensor!r}`, gate {mrclam.GATE:g}. ATE, landmarks and heading under the alignment of the "
        "trajectory; dead reckoning under one of its own. NEES is that of the heading, the median over the steps "
        "(consistent: 0.455), in the frame of the start where the truth reaches back to it, and under the alignment. "
        "Time with "
        f"{jobs} {'process' if jobs == 1 else 'processes'} at once. {sentence(facts)}.",
        "",
    ]
    return "\n".join(lines)


def numbers(option: str) -> list[int]:
    """The numbers in an option."""
    try:
        return [int(part) for part in option.split(",")]
    except ValueError:
        raise typer.BadParameter(f"{option!r}, expected the numbers of sets separated by commas") from None


def main(
    filters: Annotated[
        str, typer.Option(metavar="A,B,…", help=f"Of {', '.join(FILTERS)}; by default all that need no truth.")
    ] = "",
    sets: Annotated[str, typer.Option(metavar="N,M,…", help="Numbers of the sets.")] = "1,2,3,6",
    data: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder with the sets' zips or folders.")] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Processes.")] = 2,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where to write.")] = Path(__file__).parent / "results",
) -> None:
    """Run the filters over every robot of the MRCLAM sets and compare them with the truth."""
    console = Console(highlight=False)
    names = filters.split(",") if filters else [name for name in FILTERS if name not in NEED_TRUTH]
    for name in names:
        if name not in FILTERS or name in NEED_TRUTH:
            raise typer.BadParameter(
                f"filter {name!r}, expected of {', '.join(n for n in FILTERS if n not in NEED_TRUTH)}"
            )
    folder = data_folder() if data is None else data
    wanted = numbers(sets)
    paths = find(folder, wanted)
    missing = [str(number) for number in wanted if number not in paths]
    if missing:
        where = f"in {folder} (SLAMKIT_DATA or --data names another folder)"
        console.print(f"skipped: there is no MRCLAM set {', '.join(missing)} {where}", soft_wrap=True)
    if not paths:
        return
    facts = machine()
    console.print(sentence(facts), soft_wrap=True)
    tasks = [(number, path, robot) for number, path in paths.items() for robot in mrclam.robots(path)]
    parallel = Parallel(n_jobs=jobs, return_as="generator")
    finished = parallel(delayed(runs)(number, path, robot, names) for number, path, robot in tasks)
    finished = track(finished, "robots", total=len(tasks), console=console, transient=True)
    results = [result for of_robot in finished for result in of_robot]
    table = Table(title="MRCLAM, over the robots of each set", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    shown = [key not in ("ran", "dead_reckoning_ate_m") for key in ("set", "filter", "ran", *COLUMNS)]  # 80 columns
    for column in compress(("set", "filter", "ran", *(heading for heading, _ in COLUMNS.values())), shown):
        table.add_column(column, justify="left" if column == "filter" else "right")
    for k, row in enumerate(family_rows(results), 1):
        table.add_row(*compress(row, shown), end_section=k % len(names) == 0)
    console.print(table)
    for result in results:
        if result["error"]:
            console.print(
                f"FAILED: set {result['set']}, robot {result['robot']}, {result['filter']}: {result['error']}"
            )
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / "mrclam.json", {"machine": facts, "jobs": jobs, "missing_sets": missing, "runs": results})
    (out / "mrclam.md").write_text(markdown(facts, results, jobs), encoding="utf-8")


if __name__ == "__main__":
    typer.run(main)
