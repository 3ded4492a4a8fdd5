"""Time of one step, 1 prediction and 8 range-bearing sightings of mapped landmarks: slamkit beside dense filters.

    python benchmarks/speed.py [--large] [--rounds R] [--out DIR]

One process and one thread. The contenders take turns, so that whatever else the machine does meets all of them; before
that, all of them must agree on the belief to 1e-9. Writes speed.json, speed.md and speed.png.
"""

from __future__ import annotations

import os

# The libraries under NumPy and SciPy read these once, when they are loaded.
os.environ.update(
    dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"), "1")
)

import copy
import gc
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import atan2, cos, hypot, pi, sin
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Protocol

import numpy as np
import typer
from _machine import machine, sentence
from filterpy.kalman import ExtendedKalmanFilter
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from slamkit import EKFSLAM, Log, Scan
from slamkit.models import RangeBearing, Unicycle
from slamkit.plots import STYLES, Style, save, style
from slamkit.se2 import wrap
from slamkit.simulate import random_world, simulate
from slamkit.summary import write_json

Array = NDArray[np.float64]

SIGHTINGS = 8
STEPS = 2000
DT = 0.1
NEAREST = 0.5  # [m]; so near that the noise of the range is much of it, no landmark is sighted
SIGMA_RANGE, SIGMA_BEARING = 0.1, float(np.deg2rad(2.0))
SIGMA_V, SIGMA_OMEGA = 0.1, 0.1
AGREEMENT = 1e-9
SAMPLE = 0.1  # [s]; a sample takes at least as long as that, or has all of the work's steps
TARGETS = {10: 10.0, 100: 100.0}  # landmarks → how many times faster than filterpy a step must be


class Sighting(NamedTuple):
    """One measurement of the landmark whose coordinates begin at `slot` of the state."""

    slot: int
    z: Array


@dataclass(frozen=True, eq=False)
class Work:
    """The same steps in the form that each contender takes, and the filter with the finished map they start from."""

    start: EKFSLAM
    controls: Array  # (STEPS, 2)
    sightings: list[list[Sighting]]
    scans: list[Scan]
    log: Log

    def first(self, steps: int) -> Log:
        """The first steps as a log of their own, not yet merged by time."""
        log, seen = self.log, SIGHTINGS * steps
        return replace(
            log,
            control_times=log.control_times[:steps],
            controls=log.controls[:steps],
            observation_times=log.observation_times[:seen],
            observation_ids=log.observation_ids[:seen],
            observations=log.observations[:seen],
            end_time=DT * steps,
        )


def make_work(landmarks: int, rng: np.random.Generator) -> Work:
    """A drive through a random map, all of it mapped from the start; each step sights the nearest landmarks."""
    world = random_world(rng, landmarks, steps=STEPS)
    assert world.dt == DT
    places = np.array(list(world.landmarks.values()))
    drive = simulate(replace(world, landmarks={}), rng)
    assert drive.truth is not None
    offset = places - drive.truth.poses[:, None, :2]
    distance = np.hypot(offset[..., 0], offset[..., 1])
    bearing = np.arctan2(offset[..., 1], offset[..., 0]) - drive.truth.poses[:, None, 2]
    z = np.stack([distance, bearing], -1) + rng.normal(0.0, (SIGMA_RANGE, SIGMA_BEARING), (STEPS + 1, landmarks, 2))
    z[..., 0] = np.abs(z[..., 0])
    z[..., 1] = wrap(z[..., 1])
    rows = np.argsort(np.where(distance < NEAREST, np.inf, distance), axis=1)[1:, :SIGHTINGS]
    rows.sort(axis=1)  # as a log has them

    start = EKFSLAM(Unicycle(SIGMA_V, SIGMA_OMEGA), RangeBearing(SIGMA_RANGE, SIGMA_BEARING), world.pose)
    start.observe_scan(Scan(range(landmarks), z[0]))
    z = np.take_along_axis(z[1:], rows[..., None], axis=1)
    return Work(
        start=start,
        controls=drive.controls,
        sightings=[
            [Sighting(3 + 2 * i, z_i) for i, z_i in zip(ids, scan, strict=True)]
            for ids, scan in zip(rows.tolist(), z, strict=True)
        ],
        scans=[Scan(tuple(ids), scan) for ids, scan in zip(rows.tolist(), z, strict=True)],
        log=Log(
            control_times=drive.control_times,
            controls=drive.controls,
            observation_times=np.repeat(drive.truth.times[1:], SIGHTINGS),
            observation_ids=rows.ravel(),
            observations=z.reshape(-1, 2),
            landmark_ids=tuple(range(landmarks)),
        ),
    )


# -- the models as a textbook's filter has them: plain Python on scalars, dense matrices ------------------------------


def move(pose: Array, u: Array) -> tuple[list[float], Array, Array]:
    """Exact arc: new pose, ∂/∂pose (3, 3) and the noise's covariance (3, 3)."""
    (x, y, theta), (v, omega) = pose.tolist(), u.tolist()
    a = omega * DT / 2
    sinc, slope = (sin(a) / a, (cos(a) - sin(a) / a) / a) if abs(a) > 1e-4 else (1 - a * a / 6, -a / 3)
    c, s = cos(theta + a), sin(theta + a)
    dx, dy = v * DT * sinc * c, v * DT * sinc * s
    F = np.array([[1.0, 0.0, -dy], [0.0, 1.0, dx], [0.0, 0.0, 1.0]])
    h = v * DT * DT / 2
    G = np.array([[DT * sinc * c, h * (slope * c - sinc * s)], [DT * sinc * s, h * (slope * s + sinc * c)], [0.0, DT]])
    return [x + dx, y + dy, theta + omega * DT], F, (G * (SIGMA_V**2, SIGMA_OMEGA**2)) @ G.T


def predicted(x: Array, slot: int) -> Array:
    """Range and bearing."""
    dx, dy = x[slot] - x[0], x[slot + 1] - x[1]
    return np.array([hypot(dx, dy), atan2(dy, dx) - x[2]])


def jacobian(x: Array, slot: int) -> Array:
    """∂z/∂x (2, D)."""
    dx, dy = x[slot] - x[0], x[slot + 1] - x[1]
    q = dx * dx + dy * dy
    r = hypot(dx, dy)
    H = np.zeros((2, len(x)))
    H[:, :3] = (-dx / r, -dy / r, 0.0), (dy / q, -dx / q, -1.0)
    H[:, slot : slot + 2] = (dx / r, dy / r), (-dy / q, dx / q)
    return H


def residual(z: Array, z_hat: Array) -> Array:
    """The difference z - z_hat, the bearing wrapped."""
    y = z - z_hat
    y[1] = (y[1] + pi) % (2 * pi) - pi
    return y


R = np.diag([SIGMA_RANGE**2, SIGMA_BEARING**2])


# -- the contenders ---------------------------------------------------------------------------------------------------


class Contender(Protocol):
    """One way to do the work."""

    def __init__(self, work: Work, steps: int) -> None:
        """Make everything ready; this is not timed."""
        ...

    def go(self) -> None:
        """Take the first steps of the work; this is timed."""
        ...

    def belief(self) -> tuple[Array, Array]:
        """State (D,) and covariance (D, D) after that."""
        ...


class Filterpy(ExtendedKalmanFilter):
    """filterpy's ExtendedKalmanFilter as it comes: dense F and Q to predict, one dense update a sighting."""

    def __init__(self, work: Work, steps: int) -> None:
        x, P = work.start.x.copy(), work.start.P.copy()
        super().__init__(len(x), 2)
        self.x, self.P, self.R, self.Q = x, P, R, np.zeros_like(P)
        self.work, self.steps = work, steps

    def predict_x(self, u: Any = 0) -> None:
        """The motion model; filterpy calls it from `predict`."""
        self.x[:3], self.F[:3, :3], self.Q[:3, :3] = move(self.x[:3], u)

    def go(self) -> None:
        """Take the steps."""
        for k in range(self.steps):
            self.predict(self.work.controls[k])
            for slot, z in self.work.sightings[k]:
                self.update(z, jacobian, predicted, args=(slot,), hx_args=(slot,), residual=residual)

    def belief(self) -> tuple[Array, Array]:
        """State and covariance."""
        return self.x, self.P


class Textbook:
    """EKF-SLAM in NumPy as textbooks write it (Thrun, Burgard & Fox 2005, table 10.1): P = F P Fᵀ + Q, (I - K H) P."""

    def __init__(self, work: Work, steps: int) -> None:
        self.x, self.P = work.start.x.copy(), work.start.P.copy()
        self.work, self.steps = work, steps

    def go(self) -> None:
        """Take the steps."""
        x, P, identity = self.x, self.P, np.eye(len(self.x))
        for k in range(self.steps):
            F, Q = identity.copy(), np.zeros_like(P)
            x[:3], F[:3, :3], Q[:3, :3] = move(x[:3], self.work.controls[k])
            P = F @ P @ F.T + Q
            for slot, z in self.work.sightings[k]:
                H = jacobian(x, slot)
                K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
                x += K @ residual(z, predicted(x, slot))
                P = (identity - K @ H) @ P
        self.P = P

    def belief(self) -> tuple[Array, Array]:
        """State and covariance."""
        return self.x, self.P


class Step:
    """`EKFSLAM.step`, called from Python."""

    def __init__(self, work: Work, steps: int) -> None:
        self.filter, self.work, self.steps = copy.deepcopy(work.start), work, steps

    def go(self) -> None:
        """Take the steps."""
        for k in range(self.steps):
            self.filter.step(self.work.controls[k], DT, self.work.scans[k])

    def belief(self) -> tuple[Array, Array]:
        """State and covariance."""
        return self.filter.x, self.filter.P


class Run:
    """`EKFSLAM.run`: merges the log by time, takes every step, and returns a history of all of it."""

    def __init__(self, work: Work, steps: int) -> None:
        self.filter, self.log = copy.deepcopy(work.start), work.first(steps)

    def go(self) -> None:
        """Take the steps."""
        self.filter.run(self.log)

    def belief(self) -> tuple[Array, Array]:
        """State and covariance."""
        return self.filter.x, self.filter.P


CONTENDERS: dict[str, type[Contender]] = {
    "filterpy, dense": Filterpy,
    "NumPy, textbook": Textbook,
    "slamkit, step": Step,
    "slamkit, run": Run,
}
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
    for name, contender in CONTENDERS.items():
        done = contender(work, steps)
        done.go()
        beliefs[name] = done.belief()
    x, P = beliefs[PEER]
    if np.allclose(x, work.start.x, atol=AGREEMENT):
        raise SystemExit("the filters did not move: that they agree says nothing")
    worst = 0.0
    for other_x, other_P in beliefs.values():
        dx = other_x - x
        dx[2] = wrap(dx[2])
        worst = max(worst, float(np.abs(dx).max()), float(np.abs(other_P - P).max() / np.abs(P).max()))
    return worst


def seconds(contender: type[Contender], work: Work, steps: int) -> float:
    """Time of one step, from so many in a row."""
    ready = contender(work, steps)
    gc.collect()
    gc.disable()
    try:
        begin = time.perf_counter()
        ready.go()
        return (time.perf_counter() - begin) / steps
    finally:
        gc.enable()


def enough(contender: type[Contender], work: Work) -> int:
    """Steps that a sample needs to be long.

    It is lengthened until it is long indeed: a filter's first call, and what `run` does once a log, cost as much as
    hundreds of steps, so that no short sample tells how long a step takes.
    """
    steps = 1
    while steps < STEPS and steps * seconds(contender, work, steps) < SAMPLE:
        steps = min(4 * steps, STEPS)
    return steps


def sample(work: Work, rounds: int) -> tuple[dict[str, Array], dict[str, int]]:
    """Times of a step (rounds,) of every contender, taken in turns, and the steps that one sample has."""
    steps = {name: enough(contender, work) for name, contender in CONTENDERS.items()}
    times: dict[str, list[float]] = {name: [] for name in CONTENDERS}
    for _ in range(rounds):
        for name, contender in CONTENDERS.items():
            times[name].append(seconds(contender, work, steps[name]))
    return {name: np.array(values) for name, values in times.items()}, steps


def quartiles(values: Array) -> dict[str, float]:
    """Median and quartiles, as JSON can hold them."""
    q1, median, q3 = np.percentile(values, [25, 50, 75]).tolist()
    return {"median": median, "q1": q1, "q3": q3}


def measure(landmarks: int, rounds: int) -> dict[str, Any]:
    """Everything about one size of map."""
    work = make_work(landmarks, np.random.default_rng(landmarks))
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


def three_digits(value: float) -> str:
    """A number with three digits, or all of its digits before the point."""
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}"


def spread(values: dict[str, float], scale: float = 1.0) -> str:
    """Median and, in parentheses, quartiles."""
    median, q1, q3 = (three_digits(scale * values[key]) for key in ("median", "q1", "q3"))
    return f"{median} ({q1} … {q3})"


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
