"""Time and memory of slamkit and of other filters, from 3 to 10,000 landmarks.

    python benchmarks/scaling.py [--sizes 10,100] [--quick] [--no-random] [--keep] [--out DIR]

A step is 1 prediction and 8 range-bearing sightings of mapped landmarks. Every contender has a process of its own with
one thread. The contenders take turns, so that other load on the machine affects all of them, and each must agree with
slamkit before it is timed. Times are compared with those of a plain C++ filter, which needs g++. MRPT (on Debian: apt
install libmrpt-slam-dev) and GTSAM (pip install --editable '.[bench]') are included if they are installed. The report
lists the contenders that did not take part, with the reason. The script writes scaling.json, scaling.md and
scaling.png.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import _one_thread  # noqa: F401  (before NumPy)
import numpy as np
import typer
from _machine import machine, sentence
from _measure import quartiles, spread, three_digits
from _worker import LIMIT, WINDOW, Floors, Track, Worker, peak
from _workload import SIGHTINGS, Array, IntArray, Work, make_work
from contenders import CONTENDERS, ROUNDING, MissingError, contender
from rich.console import Console
from rich.table import Table

from slamkit.evaluate.run_report import write_json
from slamkit.plots import STYLES, Style, save
from slamkit.se2 import wrap

SIZES = (3, 10, 50, 100, 200, 500, 1000, 2000, 5000, 10000)
PEER = "C++, one triangle"
RUN, STEP, SPREAD, CALLS, READ, HOLD = (
    "slamkit, run",
    "slamkit, step",
    "slamkit, step, spread flush",
    "slamkit, predict + observe",
    "slamkit, step + read P",
    "slamkit, step + hold P",
)
FILTERPY = "filterpy, dense"
FLOORS = "floors"
FLOOR_KEYS = {
    "triangle_pass_seconds": "one pass over the triangle",
    "dsyrk_seconds": "8 D² multiply-adds",
}
FLOORS_FROM = 100  # landmarks; on smaller maps the call itself takes most of the time
#: Contenders that are measured only at some sizes. Those of others stop where a step takes about a second.
ONLY = {
    READ: (500, 1000, 2000),
    HOLD: (500, 1000, 2000),
    SPREAD: (1000, 2000, 5000, 10000),
    CALLS: range(2001),
    "MRPT": range(2001),
    "iSAM2 + covariance": range(501),
    "NumPy, textbook": range(501),
    FILTERPY: range(501),
}
#: Why other filters differ from slamkit. Those not listed differ by rounding.
WHY = {
    "MRPT": "which takes the Jacobians of all sightings of a step before it corrects by any, and the residual of a "
    "bearing before it corrects by the range, and keeps measurements in single precision",
    "iSAM2": "a smoother, which linearises the past anew, leaves small corrections aside, and needs a millimetre of "
    "noise on each motion",
}
RANDOM = (PEER, RUN, STEP)  # contenders of the random workload
WORST = (STEP, SPREAD)
PEAKS = (1000, 2000, 5000, 10000)
AGED = "iSAM2", 100, 2000  # contender, landmarks, and steps after which its time is measured again
LARGE = 1e9  # [bytes]; if P is larger, at most two contenders with a P are in memory at once

# Targets: landmarks → time of `run` divided by that of the C++ filter.
RATIOS = {10: 1.5, 50: 1.2, 100: 0.9, 200: 0.35, 500: 0.10, 1000: 0.04, 2000: 0.02, 5000: 0.01}
STEP_ABOVE_RUN = 10, 4e-6  # landmarks, [s]
FASTER = {10: 10.0, 100: 100.0}  # landmarks → speed of a step called from Python, relative to filterpy
MEAN_STEP = 10000, 6e-3  # landmarks, [s]
WORST_STEP = 10000, 50e-3  # landmarks, [s], with the spread flush
PEAK = 10000, 1.15  # landmarks, multiple of the size of P
READING = 500, 1.3  # least number of landmarks, multiple of the time of the 8 D² multiply-adds


# -- measuring --------------------------------------------------------------------------------------------------------


def entries_to_compare(work: Work, steps: int) -> IntArray:
    """Entries of the state whose joint covariance is compared.

    On a small map these are all entries. On a large one they are those of the pose, of the landmarks seen in the last
    steps, and of a sample of all landmarks.
    """
    if work.landmarks <= 500:
        return np.arange(work.dim)
    end = work.survey + steps
    seen = work.ids[work.first[max(work.survey, end - 50)] : work.first[end]]
    chosen = np.unique(np.concatenate([seen, np.linspace(0, work.landmarks - 1, 100).astype(np.int64)]))
    return np.concatenate([np.arange(3), (3 + 2 * chosen[:, None] + (0, 1)).ravel()])


def disagreement(belief: tuple[Array, Array], other: tuple[Array, Array], entries: IntArray) -> float:
    """Largest difference of two beliefs: of the states in standard deviations, of the covariances as correlations."""
    (x, block), (other_x, other_block) = belief, other
    sigma = np.sqrt(np.diag(block))
    dx = other_x - x
    dx[2] = wrap(dx[2])
    return float(max(np.abs(dx[entries] / sigma).max(), np.abs((other_block - block) / np.outer(sigma, sigma)).max()))


def is_other(name: str) -> bool:
    """Whether a contender is neither slamkit nor the C++ filter of this folder."""
    return name in CONTENDERS and name != PEER and not name.startswith("slamkit")


class Field:
    """The contenders with their processes, and those that no longer take part."""

    def __init__(self) -> None:
        self.workers: dict[str, Worker] = {}
        self.out: dict[str, str] = {}  # contender that no longer takes part → reason

    def worker(self, name: str) -> Worker:
        """The process of a contender."""
        if name not in self.workers:
            self.workers[name] = Worker()
        return self.workers[name]

    def ask(self, name: str, method: Any, *arguments: Any) -> Any:
        """Call a method of a contender. If another person's filter fails, it takes no further part: returns None."""
        try:
            return self.worker(name)(method, *arguments)
        except MissingError as missing:
            self.leave(name, str(missing))
        except Exception as error:
            if not is_other(name):
                raise
            self.leave(name, f"fails: {' '.join(str(error).split())[:100]} …")
        return None

    def leave(self, name: str, why: str) -> None:
        """Remove a contender and end its process, which may hang or use much memory."""
        self.out[name] = why
        self.workers.pop(name).close()

    def willing(self, landmarks: int, names: Iterable[str]) -> list[str]:
        """Those of the contenders that take part in maps of this size."""
        return [n for n in names if n not in self.out and landmarks in ONLY.get(n, (landmarks,))]

    def close(self) -> None:
        """End all processes."""
        for worker in self.workers.values():
            worker.close()


@dataclass
class Times:
    """Measurements of one contender on one map."""

    steps: int  # steps of a sample
    seconds: list[float]  # time of a step in each round [s]
    peer: list[float]  # time of a step of the peer in the same rounds [s]
    filterpy: list[float]  # time of a step of filterpy in the same rounds [s]
    checked: dict[str, float]  # number of steps → disagreement with slamkit after them


def group_times(field: Field, work: Work, names: Sequence[str], rounds: int) -> tuple[dict[str, Times], list[Any]]:
    """Check some contenders and time them in turns. Returns their times, and those of the floors in each round."""
    for name in names:
        field.ask(name, "make", *((Floors, work.dim) if name == FLOORS else (Track, name, work)))
    checked = check(field, work, [name for name in names if name != FLOORS])
    steps = {name: field.ask(name, "calibrate") for name in checked if name not in field.out}
    taken: dict[str, list[Any]] = {name: [] for name in names}
    for _ in range(rounds):
        for name in (name for name in names if name not in field.out):
            taken[name].append(field.ask(name, "sample", *([] if name == FLOORS else [steps[name]])))
    times = {
        name: Times(
            steps[name],
            taken[name],
            *([] if other in field.out else list(taken.get(other, [])) for other in (PEER, FILTERPY)),
            checked[name],
        )
        for name in steps
        if name not in field.out
    }
    for name in names:
        if name not in field.out:
            field.ask(name, "drop")
    return times, taken.get(FLOORS, [])


def check(field: Field, work: Work, names: Sequence[str]) -> dict[str, dict[str, float]]:
    """Disagreement of each contender with the first of slamkit's. One that exceeds its tolerance takes no further part.

    All contenders are compared after a few steps. slamkit and the C++ filter are fast enough to be compared after many
    steps as well, which include flushes and reach other places; if one of these exceeds its tolerance, the benchmark
    ends.
    """
    here = [name for name in names if name not in field.out]
    checked: dict[str, dict[str, float]] = {name: {} for name in here}
    reference = next((name for name in here if name.startswith("slamkit")), None)
    if reference is None:
        return {}  # a contender that cannot be checked is not timed
    few, many = (WINDOW, 2000) if work.landmarks <= 200 else (3, max(3, min(2000, int(4e8 / work.dim**2))))
    before = field.ask(reference, "belief", 0, np.arange(3))[0]
    for steps in (few, many):
        entries = entries_to_compare(work, steps)
        belief = field.ask(reference, "belief", steps, entries)
        if np.allclose(before[:2], belief[0][:2], rtol=0.0, atol=1e-3):
            raise SystemExit(f"N = {work.landmarks}: {reference} did not move, so agreement with it shows nothing")
        for name in here:
            if name == reference or name in field.out or (steps > few and is_other(name)):
                continue
            other = field.ask(name, "belief", steps, entries)
            if other is None:
                continue
            found = disagreement(belief, other, entries)
            if not found <= contender(name).tolerance:
                text = f"differs from {reference} by {found:.2g} after {steps} steps at N = {work.landmarks}"
                if not is_other(name):
                    raise SystemExit(f"{name} {text}")
                field.leave(name, text)
                continue
            checked[name][str(steps)] = found
    return {name: found for name, found in checked.items() if name not in field.out}


def measure(field: Field, landmarks: int, rounds: int, scattered: bool) -> dict[str, Any]:
    """Measure the times of all contenders on one size of map."""
    work = make_work(landmarks, np.random.default_rng(landmarks), scattered=scattered)
    names = field.willing(landmarks, RANDOM if scattered else CONTENDERS)
    if 8 * work.dim**2 <= LARGE:
        groups = [[*names, FLOORS] if landmarks >= FLOORS_FROM else names]
    else:
        smoothers = [name for name in names if is_other(name)]  # these have no P
        ours = [[name] for name in names if name.startswith("slamkit")]
        groups = [[PEER, *ours[0], *smoothers], *([PEER, *name] for name in ours[1:]), [FLOORS]]
    times: dict[str, Times] = {}
    floors: list[Any] = []
    for group in groups:
        found, passes = group_times(field, work, group, rounds)
        floors += passes
        for name, entry in found.items():
            if name in times:  # the peer, in another group
                times[name].seconds += entry.seconds
            else:
                times[name] = entry
    passed, multiplied = np.array(floors).reshape(-1, 2).T
    result: dict[str, Any] = {
        "landmarks": landmarks,
        "state": work.dim,
        "sightings": min(SIGHTINGS, landmarks),
        "workload": "random" if scattered else "drive",
        "rounds": rounds,
        "floors": {"triangle_pass_seconds": quartiles(passed), "dsyrk_seconds": quartiles(multiplied)}
        if floors
        else None,
        "contenders": {
            name: {
                "steps_a_sample": entry.steps,
                "disagreement": entry.checked,
                "seconds_a_step": quartiles(np.array(entry.seconds)),
                # Paired by round, because other load on the machine slows both.
                "ratio": quartiles(np.array(entry.seconds) / entry.peer) if entry.peer and name != PEER else None,
                "times_faster_than_filterpy": quartiles(np.array(entry.filterpy) / entry.seconds)
                if entry.filterpy and name.startswith("slamkit")
                else None,
            }
            for name, entry in times.items()
        },
    }
    name, n, steps = AGED
    if landmarks == n and name in times:
        field.ask(name, "make", Track, name, work)
        result["contenders"][name]["seconds_a_step_later"] = {"after": steps, "seconds": field.ask(name, "aged", steps)}
        field.ask(name, "drop")
    if not scattered:
        repeats = 3 if landmarks <= 1000 else 2
        for name in field.willing(landmarks, WORST):
            result["contenders"][name]["worst"] = worst(field, work, name, repeats)
    return result


def worst(field: Field, work: Work, name: str, repeats: int) -> dict[str, Any]:
    """Slowest step of the whole drive. A flush may come after more steps than a sample has."""
    field.ask(name, "make", Track, name, work)
    slowest = float(field.ask(name, "worst", work.steps - work.survey, repeats).max())
    field.ask(name, "drop")
    return {"seconds": slowest, "repeats": repeats}


def peaks(field: Field, sizes: Sequence[int]) -> list[dict[str, Any]]:
    """Peak memory of whole runs with their survey. Each has a process of its own that first runs on a small map."""
    found: list[dict[str, Any]] = []
    small = make_work(100, np.random.default_rng(100), drive=200)
    for landmarks in sizes:
        work = make_work(landmarks, np.random.default_rng(landmarks))
        for name in (name for name in (PEER, RUN) if name not in field.out):
            worker = Worker()
            try:
                size = worker(peak, name, small, work)
            except MissingError as missing:
                field.out["memory"] = str(missing)
                return found
            finally:
                worker.close()
            found.append(
                {
                    "landmarks": landmarks,
                    "contender": name,
                    "bytes": size,
                    "of_P": size / (8 * (3 + 2 * landmarks) ** 2),
                }
            )
    return found


# -- reporting --------------------------------------------------------------------------------------------------------


def duration(seconds: float) -> str:
    """A time with a suitable unit."""
    unit, scale = ("µs", 1e6) if seconds < 1e-3 else ("ms", 1e3) if seconds < 1 else ("s", 1.0)
    return f"{three_digits(scale * seconds)} {unit}"


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """A Markdown table with all columns right-aligned."""
    lines = [f"| {' | '.join(header)} |", "|" + "--:|" * len(header)]
    return [*lines, *(f"| {' | '.join(row)} |" for row in rows), ""]


def of(result: dict[str, Any], name: str, key: str) -> float | None:
    """Median of a measurement of a contender, or None if it was not measured."""
    entry = result["contenders"].get(name)
    return None if entry is None or entry[key] is None else float(entry[key]["median"])


def time_rows(results: Sequence[dict[str, Any]], names: Sequence[str]) -> Iterable[list[str]]:
    """Median time of a step: one row for each size, one column for each contender and floor."""
    for result in results:
        times = [of(result, name, "seconds_a_step") for name in names]
        floors = [result["floors"] and result["floors"][key]["median"] for key in FLOOR_KEYS]
        yield [str(result["landmarks"]), *("–" if t is None else duration(t) for t in (*times, *floors))]


def ratio_rows(results: Sequence[dict[str, Any]], names: Sequence[str]) -> Iterable[list[str]]:
    """Paired ratio to the C++ filter with quartiles: one row for each size, one column for each contender."""
    for result in results:
        entries = [result["contenders"].get(name) for name in names]
        yield [
            str(result["landmarks"]),
            *("–" if entry is None or entry["ratio"] is None else spread(entry["ratio"]) for entry in entries),
        ]


def worst_rows(results: Sequence[dict[str, Any]]) -> Iterable[list[str]]:
    """Mean and slowest step of the drive, for both rules of flushing."""
    for result in results:
        row = [str(result["landmarks"])]
        for name in WORST:
            entry = result["contenders"].get(name)
            if entry is None or "worst" not in entry:
                row += ["–", "–"]
            else:
                row += [duration(entry["seconds_a_step"]["median"]), duration(entry["worst"]["seconds"])]
        yield row


def verdicts(drive: Sequence[dict[str, Any]], memory: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Targets and results for the sizes that were measured."""
    at = {result["landmarks"]: result for result in drive}
    found: list[dict[str, Any]] = []

    def judge(landmarks: int, wanted: str, target: float, value: float | None, text: str) -> None:
        if value is not None:
            line = f"N = {landmarks}: {wanted} wanted, {text}: {'met' if value <= target else 'NOT met'}"
            found.append(
                {"landmarks": landmarks, "target": target, "value": value, "met": value <= target, "line": line}
            )

    for n, target in RATIOS.items():
        ratio = of(at[n], RUN, "ratio") if n in at else None
        if ratio is not None:
            judge(
                n, f"run at most {target:g} of the C++ filter's time", target, ratio, f"{three_digits(ratio)} measured"
            )
    for n, target in FASTER.items():
        faster = of(at[n], STEP, "times_faster_than_filterpy") if n in at else None
        if faster is not None:
            wanted = f"a step called from Python at least {target:g} times faster than filterpy's dense one"
            judge(n, wanted, 1 / target, 1 / faster, f"{three_digits(faster)} times measured")
    n, target = STEP_ABOVE_RUN
    if n in at:
        above = (of(at[n], STEP, "seconds_a_step") or 0.0) - (of(at[n], RUN, "seconds_a_step") or 0.0)
        wanted = f"a step called from Python at most {duration(target)} above one of run"
        judge(n, wanted, target, above, f"{duration(above)} measured")
    n, target = MEAN_STEP
    if n in at:
        for name in (RUN, STEP, SPREAD):
            mean = of(at[n], name, "seconds_a_step")
            if mean is not None:
                judge(n, f"at most {duration(target)} a step", target, mean, f"{name} takes {duration(mean)}")
    n, target = WORST_STEP
    if n in at and "worst" in at[n]["contenders"].get(SPREAD, {}):
        slowest = at[n]["contenders"][SPREAD]["worst"]["seconds"]
        whole = at[n]["contenders"][STEP]["worst"]["seconds"]
        text = f"{duration(slowest)} measured ({duration(whole)} where the flush is done at once)"
        judge(n, f"no step above {duration(target)} with the spread flush", target, slowest, text)
    n, target = PEAK
    for entry in memory:
        if entry["landmarks"] == n and entry["contender"] == RUN:
            judge(
                n, f"a peak of at most {target:g} P", target, entry["of_P"], f"{three_digits(entry['of_P'])} P measured"
            )
    smallest, target = READING
    for n, result in at.items():
        reading = of(result, READ, "seconds_a_step")
        if n >= smallest and reading is not None and result["floors"]:
            times = reading / result["floors"]["dsyrk_seconds"]["median"]
            wanted = f"P read after every step within {target:g} times 8 D² multiply-adds"
            judge(n, wanted, target, times, f"{three_digits(times)} times measured")
    return found


def differences(results: Sequence[dict[str, Any]]) -> list[str]:
    """Largest disagreements with slamkit, their tolerances and reasons, as lines of a list."""
    largest: dict[str, tuple[float, float]] = {}
    for result in results:
        for name, entry in result["contenders"].items():
            tolerance = contender(name).tolerance
            kind = "the other EKFs" if tolerance == ROUNDING else name
            found = max((largest.get(kind, (0.0, 0.0))[0], *entry["disagreement"].values()))
            largest[kind] = found, tolerance
    return [
        f"- {kind}{f', {WHY[kind]}' if kind in WHY else ''}: {found:.1g} (at most {tolerance:g} allowed)"
        for kind, (found, tolerance) in largest.items()
    ]


def kept(report: dict[str, Any]) -> str:
    """A sentence that names the results of an earlier run."""
    parts = [
        f"{workload} on {', '.join(sizes)} landmarks"
        for workload in ("drive", "random")
        if (sizes := [str(result["landmarks"]) for result in report[workload] if result.get("kept")])
    ]
    return f" From an earlier run: {'; '.join(parts)}." if parts else ""


def markdown(facts: dict[str, Any], report: dict[str, Any]) -> str:
    """The report: all tables with explanations."""
    drive, scattered, memory = report["drive"], report["random"], report["memory"]
    names = [name for name in CONTENDERS if any(name in result["contenders"] for result in drive)]
    floors = list(FLOOR_KEYS.values())
    lines = [
        f"Time of a step, 1 prediction and {SIGHTINGS} range-bearing sightings (3 where N = 3), every landmark mapped, "
        "in a drive through a field with 0.1 landmarks a square metre that sights the nearest ones. Medians, one "
        "thread, flushes included. The last two columns are this machine's floors: the triangle of P read and written "
        "once, and the multiply-adds of 8 sightings as one BLAS dsyrk of rank 16. Other people's filters stop where "
        f"a step takes about a second, or a call {LIMIT:g} s. MRPT and iSAM2 run as they are packaged, for any "
        "processor of the architecture; the C++ filter is compiled for this one.",
        "",
        *table(["N", *names, *floors], time_rows(drive, names)),
        "The same in times of the C++ filter's, paired by round: median (quartiles).",
        "",
        *table(["N", *(name for name in names if name != PEER)], ratio_rows(drive, [n for n in names if n != PEER])),
        "A step of slamkit called by itself: the median of a sample's mean, and the slowest of the whole drive (of "
        "the least that each step takes in 3 repeats; from N = 2000 on 2). Either a flush is done at "
        "once, or it is spread over steps.",
        "",
        *table(["N", "at once: mean", "slowest", "spread: mean", "slowest"], worst_rows(drive)),
    ]
    if memory:
        cells = [
            [str(e["landmarks"]), e["contender"], f"{e['bytes'] / 2**20:.0f}", three_digits(e["of_P"])] for e in memory
        ]
        lines += [
            "Memory at the peak of a run, its survey included, above what its process holds that has run on a map of "
            "100 landmarks before, so that all code is loaded, and has the work; in times of one P in float64.",
            "",
            *table(["N", "contender", "MiB", "of P"], cells),
        ]
    if scattered:
        lines += [
            f"The worst case for a filter that puts work off: each step sights {SIGHTINGS} landmarks of the whole map.",
            "",
            *table(["N", *RANDOM, *floors], time_rows(scattered, RANDOM)),
            *table(["N", *RANDOM[1:]], ratio_rows(scattered, RANDOM[1:])),
        ]
    later = [
        entry["seconds_a_step_later"] | {"N": result["landmarks"], "name": name}
        for result in drive
        for name, entry in result["contenders"].items()
        if "seconds_a_step_later" in entry
    ]
    lines += [
        f"The step of {e['name']} grows with the poses that it keeps. The tables have the first {WINDOW} steps of the "
        f"drive; after {e['after']} it takes {duration(e['seconds'])} at N = {e['N']}.\n"
        for e in later
    ]
    lines += [
        "Before it was timed, every contender was compared with slamkit after the same steps: the state in standard "
        "deviations, the covariance as correlations. Largest differences:",
        "",
        *differences([*drive, *scattered]),
        "",
        f"Ratios are of samples taken in turns. {sentence(facts)}.{kept(report)}",
        "",
        *(f"- {name}: {why}" for name, why in report["out"].items()),
        *([""] if report["out"] else []),
        *(f"- {verdict['line']}" for verdict in report["targets"]),
        "",
    ]
    return "\n".join(lines)


OURS = STYLES["ekf"]
LOOKS: dict[str, Style] = {
    PEER: Style(PEER, "#000000", (), "d"),
    RUN: replace(OURS, label=RUN, marker="s"),
    STEP: replace(OURS, label=STEP, dashes=(5.0, 1.6)),
    CALLS: replace(OURS, label=CALLS, dashes=(1.0, 1.4), marker="^"),
    "MRPT": Style("MRPT", "#000000", (2.5, 1.2), "v"),
    "iSAM2": Style(f"iSAM2, first {WINDOW} steps", "#777777", (), "x"),
    "iSAM2 + covariance": Style("iSAM2 + joint covariance", "#777777", (5.0, 1.5, 1.0, 1.5), "*"),
    "NumPy, textbook": Style("NumPy, textbook", "#888888", (1.0, 1.4), "p"),
    "filterpy, dense": Style("filterpy, dense", "#444444", (4.0, 2.0), "h"),
}


def draw(results: Sequence[dict[str, Any]], path: Path) -> None:
    """Draw the time of a step over the number of landmarks. Bands show the quartiles; the floors are dashed."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.6, 4.4), layout="constrained")
    ax = figure.subplots()
    n = np.array([result["landmarks"] for result in results])
    for name, look in LOOKS.items():
        there = [
            (result["landmarks"], entry["seconds_a_step"])
            for result in results
            if (entry := result["contenders"].get(name))
        ]
        if not there:
            continue
        at = [landmarks for landmarks, _ in there]
        q1, median, q3 = (1e3 * np.array([entry[key] for _, entry in there]) for key in ("q1", "median", "q3"))
        ax.fill_between(at, q1, q3, color=look.color, alpha=0.2, linewidth=0)
        ax.plot(
            at, median, color=look.color, linestyle=look.linestyle, marker=look.marker, markersize=4.5, label=look.label
        )
    for (key, label), dashes in zip(FLOOR_KEYS.items(), ((2.0, 2.0), (6.0, 3.0)), strict=True):
        there = [(result["landmarks"], 1e3 * result["floors"][key]["median"]) for result in results if result["floors"]]
        if there:
            ax.plot(*zip(*there, strict=True), color="0.55", linewidth=0.8, linestyle=(0, dashes), label=label)
    ax.set(xscale="log", yscale="log", xlabel="landmarks", ylabel=f"time of a step, {SIGHTINGS} sightings [ms]")
    ax.set_xticks(n, [f"{value}" if value < 1000 else f"{value / 1000:g}k" for value in n.tolist()], minor=False)
    ax.minorticks_off()
    ax.grid(True, color="0.9", linewidth=0.6)
    ax.set_axisbelow(True)
    ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize="small")
    save(figure, path, dpi=150)


def sizes_of(text: str) -> tuple[int, ...]:
    """Numbers of landmarks from the command line, ascending."""
    try:
        sizes = tuple(sorted({int(part) for part in text.split(",")}))
    except ValueError:
        sizes = ()
    if not sizes or sizes[0] < 1:
        raise typer.BadParameter(f"{text!r}, expected numbers of landmarks such as 10,100")
    return sizes


def main(
    sizes: Annotated[
        str | None, typer.Option(metavar="N,N,…", help="Numbers of landmarks; by default 3 to 10,000.")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="A look: up to 500 landmarks and three rounds.")] = False,
    random: Annotated[bool, typer.Option(help="The random workload too.")] = True,
    keep: Annotated[
        bool, typer.Option("--keep", help="Keep what DIR has of other sizes, from an earlier run.")
    ] = False,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where to write.")] = Path(__file__).parent / "results",
) -> None:
    """Time one step of slamkit and of other people's filters on maps of 3 to 10,000 landmarks."""
    chosen = sizes_of(sizes) if sizes is not None else tuple(n for n in SIZES if not quick or n <= 500)
    console = Console(highlight=False)
    facts = machine()
    console.print(sentence(facts), soft_wrap=True)
    field = Field()
    out.mkdir(parents=True, exist_ok=True)
    before = json.loads((out / "scaling.json").read_text(encoding="utf-8")) if keep else {}
    results: dict[bool, list[dict[str, Any]]] = {
        scattered: [
            {**result, "kept": True}
            for result in before.get(workload, [])
            if result["landmarks"] not in chosen or (scattered and not random)
        ]
        for scattered, workload in ((False, "drive"), (True, "random"))
    }
    memory = [entry for entry in before.get("memory", []) if entry["landmarks"] not in chosen]
    try:
        for scattered in (False, True) if random else (False,):
            for n in chosen:
                with console.status(f"{n} landmarks, {'random' if scattered else 'drive'}"):
                    rounds = 3 if quick or n > 1000 else 5 if n > 200 else 9
                    result = measure(field, n, rounds, scattered)
                results[scattered] = sorted([*results[scattered], result], key=lambda r: r["landmarks"])
                show(console, result)
                write(out, facts, field, results, memory)
    finally:
        field.close()
    with console.status("memory"):
        memory = sorted([*memory, *peaks(field, [n for n in PEAKS if n in chosen])], key=lambda e: e["landmarks"])
    report = write(out, facts, field, results, memory)
    for name, why in field.out.items():
        console.print(f"{name}: {why}", soft_wrap=True)
    for entry in memory:
        console.print(f"N = {entry['landmarks']}: {entry['contender']} has a peak of {entry['of_P']:.3g} P")
    for verdict in report["targets"]:
        console.print(verdict["line"], soft_wrap=True)


def write(
    out: Path, facts: dict[str, Any], field: Field, results: dict[bool, list[dict[str, Any]]], memory: list[Any]
) -> dict[str, Any]:
    """Write all results so far, and return them. Large maps take long: an interruption loses no finished result."""
    report: dict[str, Any] = {"drive": results[False], "random": results[True], "memory": memory, "out": field.out}
    report["targets"] = verdicts(results[False], memory)
    write_json(out / "scaling.json", {"machine": facts, **report})
    (out / "scaling.md").write_text(markdown(facts, report), encoding="utf-8")
    draw(results[False], out / "scaling.png")
    return report


def show(console: Console, result: dict[str, Any]) -> None:
    """Print the results for one size of map."""
    title = f"{result['landmarks']} landmarks, {result['workload']}"
    columns = Table(title=title, title_justify="left")
    columns.add_column("filter")
    for column in ("a step", "times C++", "slowest", "differs", "sample"):
        columns.add_column(column, justify="right", no_wrap=True)
    for name, entry in result["contenders"].items():
        ratio, slowest = entry["ratio"], entry.get("worst")
        columns.add_row(
            name,
            duration(entry["seconds_a_step"]["median"]),
            "1" if name == PEER else "–" if ratio is None else spread(ratio),
            "" if slowest is None else duration(slowest["seconds"]),
            f"{max(entry['disagreement'].values(), default=0.0):.1g}",
            str(entry["steps_a_sample"]),
        )
    for key, label in FLOOR_KEYS.items() if result["floors"] else ():
        columns.add_row(label, duration(result["floors"][key]["median"]), *[""] * 4)
    console.print(columns)


if __name__ == "__main__":
    typer.run(main)
