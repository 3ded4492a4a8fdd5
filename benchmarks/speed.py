"""Time of one step, 1 prediction and 8 range-bearing sightings of mapped landmarks: slamkit beside dense filters.

    python benchmarks/speed.py [--large] [--rounds R] [--out DIR]

One process and one thread. The contenders take turns, so that whatever else the machine does meets all of them; before
that, all of them must agree on the belief to 1e-9. Writes speed.json, speed.md and speed.png.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import _one_thread  # noqa: F401  (before NumPy)
import numpy as np
import typer
from _machine import machine, sentence
from _measure import quartiles, seconds, spread, three_digits
from _workload import SIGHTINGS, Array, Work, make_work
from contenders import contender
from rich.console import Console
from rich.table import Table

from slamkit.plots import STYLES, Style, save, style
from slamkit.se2 import wrap
from slamkit.summary import write_json

STEPS = 2000
AGREEMENT = 1e-9
SAMPLE = 0.1  # [s]; a sample takes at least as long as that, or has all of the work's steps
TARGETS = {10: 10.0, 100: 100.0}  # landmarks → how many times faster than filterpy a step must be
CONTENDERS = ("filterpy, dense", "NumPy, textbook", "slamkit, step", "slamkit, run")
PEER = "filterpy, dense"
LOOKS: dict[str, Style] = {
    "filterpy, dense": style("filterpy, dense"),
    "NumPy, textbook": Style("NumPy, textbook", "#888888", (1.0, 1.4), "p"),
    "slamkit, step": replace(STYLES["ekf"], label="slamkit, step", dashes=(5.0, 1.6)),
    "slamkit, run": replace(STYLES["ekf"], label="slamkit, run", marker="s"),
}


# -- measuring --------------------------------------------------------------------------------------------------------


def disagreement(work: Work, steps: int) -> float:
    """Largest difference of any contender from the peer: of the state, or of P as a share of its largest entry."""
    beliefs = {}
    for name in CONTENDERS:
        done = contender(name)(work)
        done.start()
        before = np.array(done.joint(np.arange(3))[0])
        done.ready(work.survey, work.survey + steps)()
        beliefs[name] = done.joint(np.arange(work.dim))
        if np.allclose(before, beliefs[name][0], atol=AGREEMENT):
            raise SystemExit(f"{name} did not move: that it agrees says nothing")
    x, P = beliefs[PEER]
    worst = 0.0
    for other_x, other_P in beliefs.values():
        dx = other_x - x
        dx[2] = wrap(dx[2])
        worst = max(worst, float(np.abs(dx).max()), float(np.abs(other_P - P).max() / np.abs(P).max()))
    return worst


def seconds_a_step(name: str, work: Work, steps: int) -> float:
    """Time of one step, from so many in a row."""
    ready = contender(name)(work)
    ready.start()
    return seconds(ready.ready(work.survey, work.survey + steps)) / steps


def enough(name: str, work: Work) -> int:
    """Steps that a sample needs to be long.

    It is lengthened until it is long indeed: a filter's first call, and what `run` does once a log, cost as much as
    hundreds of steps, so that no short sample tells how long a step takes.
    """
    steps = 1
    while steps < STEPS and steps * seconds_a_step(name, work, steps) < SAMPLE:
        steps = min(4 * steps, STEPS)
    return steps


def sample(work: Work, rounds: int) -> tuple[dict[str, Array], dict[str, int]]:
    """Times of a step (rounds,) of every contender, taken in turns, and the steps that one sample has."""
    steps = {name: enough(name, work) for name in CONTENDERS}
    times: dict[str, list[float]] = {name: [] for name in CONTENDERS}
    for _ in range(rounds):
        for name in CONTENDERS:
            times[name].append(seconds_a_step(name, work, steps[name]))
    return {name: np.array(values) for name, values in times.items()}, steps


def measure(landmarks: int, rounds: int) -> dict[str, Any]:
    """Everything about one size of map."""
    work = make_work(landmarks, np.random.default_rng(landmarks), drive=STEPS)
    checked = 20 if landmarks <= 100 else 3
    worst = disagreement(work, checked)
    if not worst <= AGREEMENT:
        raise SystemExit(f"N = {landmarks}: the contenders differ by {worst:.2g} after {checked} steps")
    times, steps = sample(work, rounds)
    return {
        "landmarks": landmarks,
        "state": 3 + 2 * landmarks,
        "rounds": rounds,
        "disagreement": worst,
        "contenders": {
            name: {
                "steps_a_sample": steps[name],
                "seconds_a_step": quartiles(values),
                # Paired by round: what slows the machine down for a while slows both.
                "times_faster": quartiles(times[PEER] / values),
            }
            for name, values in times.items()
        },
    }


# -- reporting --------------------------------------------------------------------------------------------------------


HEADER = ("landmarks", "filter", "time a step [µs]", "times faster", "steps a sample")


def rows(results: Sequence[dict[str, Any]]) -> list[tuple[str, ...]]:
    """One row a map and contender, as HEADER says."""
    return [
        (
            str(result["landmarks"]),
            name,
            spread(entry["seconds_a_step"], 1e6),
            "1" if name == PEER else spread(entry["times_faster"]),
            str(entry["steps_a_sample"]),
        )
        for result in results
        for name, entry in result["contenders"].items()
    ]


def verdicts(results: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """What was aimed at, and what came out; `step` decides, for it is called from Python as filterpy is."""
    return [
        {
            "landmarks": n,
            "target": TARGETS[n],
            "step": result["contenders"]["slamkit, step"]["times_faster"]["median"],
            "run": result["contenders"]["slamkit, run"]["times_faster"]["median"],
            "met": result["contenders"]["slamkit, step"]["times_faster"]["median"] >= TARGETS[n],
        }
        for result in results
        if (n := result["landmarks"]) in TARGETS
    ]


def verdict_line(verdict: dict[str, Any]) -> str:
    """One verdict in words."""
    return (
        f"N = {verdict['landmarks']}: at least {verdict['target']:g} times faster than filterpy's dense update wanted, "
        f"step is {three_digits(verdict['step'])} times, run {three_digits(verdict['run'])} times: "
        f"{'met' if verdict['met'] else 'NOT met'}"
    )


def markdown(facts: dict[str, Any], results: Sequence[dict[str, Any]]) -> str:
    """The table for the README."""
    lines = [f"| {' | '.join(HEADER)} |", "|--:|:--|--:|--:|--:|"]
    lines += [f"| {' | '.join(row)} |" for row in rows(results)]
    lines += [
        "",
        f"A step is 1 prediction and {SIGHTINGS} range-bearing sightings, every landmark mapped. Medians (quartiles) "
        "of samples taken in turns in one process and one thread; ratios are paired, sample by sample. What `run` does "
        "once a log (merging by time, the history) is spread over the steps of a sample. Before that all filters were "
        f"found to agree to {AGREEMENT:g}. {sentence(facts)}.",
        "",
        *(f"- {verdict_line(verdict)}" for verdict in verdicts(results)),
        "",
    ]
    return "\n".join(lines)


def draw(results: Sequence[dict[str, Any]], path: Path) -> None:
    """Time of a step against the number of landmarks; a band joins the quartiles."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.0, 3.6), layout="constrained")
    ax = figure.subplots()
    n = [result["landmarks"] for result in results]
    for name, look in LOOKS.items():
        entries = [result["contenders"][name]["seconds_a_step"] for result in results]
        q1, median, q3 = (1e6 * np.array([entry[key] for entry in entries]) for key in ("q1", "median", "q3"))
        ax.fill_between(n, q1, q3, color=look.color, alpha=0.2, linewidth=0)
        ax.plot(
            n, median, color=look.color, linestyle=look.linestyle, marker=look.marker, markersize=5, label=look.label
        )
    ax.set(xscale="log", yscale="log", xlabel="landmarks", ylabel=f"time of a step, {SIGHTINGS} sightings [µs]")
    ax.set_xticks(n, [str(value) for value in n], minor=False)
    ax.minorticks_off()
    ax.grid(True, color="0.9", linewidth=0.6)
    ax.set_axisbelow(True)
    ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, frameon=False, fontsize="small")
    save(figure, path, dpi=150)


def main(
    large: Annotated[bool, typer.Option("--large", help="Maps of 200 and 500 landmarks too; takes minutes.")] = False,
    rounds: Annotated[int, typer.Option(min=3, help="Samples of each contender; a third of it for large maps.")] = 15,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where to write.")] = Path(__file__).parent / "results",
) -> None:
    """Time one step of slamkit, of filterpy and of a textbook's filter on maps of growing size."""
    console = Console(highlight=False)
    facts = machine()
    console.print(sentence(facts), soft_wrap=True)
    results = []
    for n in (10, 50, 100, *((200, 500) if large else ())):
        with console.status(f"{n} landmarks"):
            results.append(measure(n, rounds if n <= 100 else max(3, rounds // 3)))
    table = Table(title=f"1 prediction and {SIGHTINGS} sightings, every landmark mapped")
    for column in HEADER:
        table.add_column(column, justify="left" if column == "filter" else "right")
    for k, row in enumerate(rows(results), 1):
        table.add_row(*row, end_section=k % len(CONTENDERS) == 0)
    console.print(table)
    for verdict in verdicts(results):
        console.print(verdict_line(verdict), soft_wrap=True)
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / "speed.json", {"machine": facts, "results": results, "targets": verdicts(results)})
    (out / "speed.md").write_text(markdown(facts, results), encoding="utf-8")
    draw(results, out / "speed.png")


if __name__ == "__main__":
    typer.run(main)
