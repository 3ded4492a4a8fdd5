"""The command line: parse, call the library, print."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, NoReturn

import numpy as np
import typer
from numpy.typing import ArrayLike
from rich.console import Console
from rich.progress import BarColumn, DownloadColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text
from typer.core import TyperGroup

import slamkit
from slamkit import plots
from slamkit.datasets import mrclam
from slamkit.errors import InputError, LogFileError, SlamkitError
from slamkit.evaluate.run_report import Assessment, assess, write_figure, write_json, write_run
from slamkit.filters import FILTERS
from slamkit.logs import Log, csv_columns
from slamkit.models import (
    EulerUnicycle,
    Odometry,
    RangeBearing,
    RelativePosition,
    Unicycle,
    model_from_dict,
    model_to_dict,
)
from slamkit.protocols import MotionModel, SensorModel
from slamkit.simulate import WORLDS, World, simulate

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from slamkit.study import Study

DEMO_SEED = 1
DEMO_RUNS = 10  # of the comparison
MODELS_FILE = "models.json"
FIGURES = (".png", ".pdf", ".svg")  # what slamkit.plots.save writes


class _Kind(NamedTuple):
    """A built-in model as the command line knows it."""

    model: Callable[..., Any]
    noise: tuple[str, ...]  # what the numbers of its noise option are
    default: tuple[float, ...]
    columns: tuple[str, ...]  # the columns of a CSV file that tell that this model made them


MOTIONS: dict[str, _Kind] = {
    "unicycle": _Kind(Unicycle, ("sigma_v [m/s]", "sigma_omega [rad/s]"), (0.1, 0.1), ("v", "omega")),
    "euler": _Kind(EulerUnicycle, ("sigma_v [m/s]", "sigma_omega [rad/s]"), (0.1, 0.1), ()),
    "odometry": _Kind(
        Odometry,
        ("alpha1 [rad²/rad²]", "alpha2 [rad²/m²]", "alpha3 [m²/m²]", "alpha4 [m²/rad²]"),
        (0.05, 0.01, 0.05, 0.01),
        ("rot1", "trans", "rot2"),
    ),
}
SENSORS: dict[str, _Kind] = {
    "range-bearing": _Kind(
        RangeBearing, ("sigma_range [m]", "sigma_bearing [rad]"), (0.1, 0.035), ("range", "bearing")
    ),
    "relative": _Kind(RelativePosition, ("sigma [m]",), (0.1,), ("x", "y")),
}


class _Commands(TyperGroup):
    """Commands whose every error is one line on stderr and exit code 2."""

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        windows_expand_args: bool = True,
        **extra: Any,
    ) -> Any:
        """Run the command that the arguments name, and leave with its exit code."""
        run = partial(super().main, args, prog_name, complete_var, False, windows_expand_args, **extra)
        if not standalone_mode:
            return run()
        try:
            code = run()
        except (SlamkitError, OSError) as error:
            _fail(_reason(error))
        except Exception as error:
            # Usage errors belong to Click or to Typer's copy of it, depending on Typer's version; both say it so.
            if not hasattr(error, "format_message"):
                raise
            context = getattr(error, "ctx", None)
            hint = "" if context is None else f" (see {context.command_path} --help)"
            _fail(f"{error.format_message()}{hint}")
        sys.exit(code or 0)


app = typer.Typer(
    cls=_Commands,
    name="slamkit",
    help="Filter-based landmark SLAM: run filters on simulated and recorded logs, and measure them.",
    epilog="Example: slamkit demo --out demo",
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
run_app = typer.Typer(
    help="Run a filter over a recorded log and compare it with the truth and with dead reckoning.",
    epilog="Example: slamkit run mrclam MRCLAM_Dataset1.zip --robot 1",
)
app.add_typer(run_app, name="run")


def main() -> None:
    """The console script `slamkit`."""
    app(prog_name="slamkit")


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"slamkit {slamkit.__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    pass


# -- options that several commands have -------------------------------------------------------------------------------

Filter = Annotated[str, typer.Option("--filter", help=f"Estimator: {', '.join(FILTERS)}.")]
Json = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="Write the numbers of the run as JSON.")]
Plot = Annotated[
    Path | None, typer.Option("--plot", metavar="FILE", help=f"Write the overview figure ({', '.join(FIGURES)}).")
]
Out = Annotated[
    Path | None,
    typer.Option(
        "--out",
        metavar="DIR",
        help="Write summary.json, trajectory.txt (TUM), trajectory.csv, map.csv, history.npz and overview.png there, "
        "also when the run fails midway.",
    ),
]
Save = Annotated[
    Path | None, typer.Option("--save", metavar="FILE", help="Write the filter itself (npz) after the run.")
]
MaxSteps = Annotated[int | None, typer.Option("--max-steps", metavar="M", min=1, help="Run the first M steps only.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]


# -- commands ---------------------------------------------------------------------------------------------------------


@app.command(epilog="Example: slamkit demo --out demo")
def demo(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Where to write.")] = Path("slamkit-demo"),
    quiet: Quiet = False,
) -> None:
    """Simulate the loop world (always the same run), run dead reckoning and EKF-SLAM, and write figures and files.

    In the end every filter is compared on a few runs of the standing world, where nothing measures the heading.
    """
    from slamkit.study import prepare

    world = WORLDS["loop"]()
    with _bar(quiet) as bar:
        bar.add_task("loading (at the first run, compiling: half a minute)", total=None)
        prepare(FILTERS, [world, WORLDS["standing"]()])
    log = simulate(world, np.random.default_rng(DEMO_SEED))
    _write_log(out / "log", world, log)
    log.save(out / "log.npz")
    assessment = _estimate(_maker("ekf", world), log, world.pose, _Outputs(out=out, quiet=quiet), "loop world")
    write_figure(out / "correlation.png", _correlation_figure(_maker("ekf", world)(), log))
    _print(quiet, _table("Ten loops of a simulated robot", [assessment]), f"Figures, log and numbers are in {out}")
    study = _compare(quiet, list(FILTERS), WORLDS["standing"](), DEMO_RUNS, DEMO_SEED)
    _write_study(out / "comparison", study)
    title = f"A robot that stands still and looks {len(study.times)} times: {study.runs} runs"
    what = f"slamkit compare --world standing --filters all --runs {study.runs} --seed {study.seed}"
    _print(quiet, "", _comparison(study, title), *_said(study), f"Its figures are in {out / 'comparison'} ({what})")


@run_app.command("mrclam", epilog="Example: slamkit run mrclam MRCLAM_Dataset1.zip --robot 1 --json run.json")
def run_mrclam(
    path: Annotated[Path, typer.Argument(metavar="PATH", help="Zip or folder of an MRCLAM set, as it was downloaded.")],
    robot: Annotated[int, typer.Option("--robot", metavar="K", help="Whose log: 1 to 5.")],
    filter_: Filter = "ekf",
    json_: Json = None,
    plot: Plot = None,
    out: Out = None,
    save: Save = None,
    max_steps: MaxSteps = None,
    quiet: Quiet = False,
) -> None:
    """Run over one robot's log of the UTIAS multi-robot data set, with the same noise parameters for every robot."""
    estimator, outputs = _known(filter_), _Outputs(json_, plot, out, save, quiet)
    outputs.prepare()
    data = mrclam.read(path, robot)
    motion, sensor = mrclam.models()
    start = _Start(gate=mrclam.GATE)
    log = data.log if max_steps is None else _beginning(data.log, max_steps)
    of_set = "MRCLAM" if data.set_number is None else f"MRCLAM set {data.set_number}"
    title = f"{of_set}, robot {robot}"
    assessment = _estimate(lambda: _make(estimator, motion, sensor, start), log, start.pose, outputs, title)
    left_out = f"Left out: {data.robot_sightings} sightings of robots, {data.unknown_barcodes} of unknown barcodes"
    _print(quiet, _table(title, [assessment]), left_out)


@run_app.command("csv", epilog="Example: slamkit run csv LOG --motion unicycle --motion-noise 0.1,0.05 --gate 13.8")
def run_csv(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="DIR",
            help="Folder with controls.csv (t,v,omega or t,rot1,trans,rot2) and observations.csv (t,id,range,bearing "
            "or t,id,x,y); optional: truth.csv (t,x,y,theta), landmarks.csv (id,x,y), models.json.",
        ),
    ],
    filter_: Filter = "ekf",
    motion: Annotated[
        str | None,
        typer.Option(help=f"Motion model: {', '.join(MOTIONS)}. By default as in models.json, else by columns."),
    ] = None,
    motion_noise: Annotated[
        str | None,
        typer.Option(
            metavar="A,B[,C,D]",
            help="unicycle, euler: standard deviations of speed (m/s) and turn rate (rad/s); odometry: four alphas. By "
            "default as in models.json, else 0.1,0.1 and 0.05,0.01,0.05,0.01.",
        ),
    ] = None,
    sensor: Annotated[
        str | None,
        typer.Option(help=f"Sensor model: {', '.join(SENSORS)}. By default as in models.json, else by columns."),
    ] = None,
    sensor_noise: Annotated[
        str | None,
        typer.Option(
            metavar="A[,B]",
            help="range-bearing: standard deviations of range (m) and bearing (rad); relative: of each coordinate (m). "
            "By default as in models.json, else 0.1,0.035 and 0.1.",
        ),
    ] = None,
    gate: Annotated[
        float | None, typer.Option(help="Largest NIS that is accepted. By default as in models.json, else every one.")
    ] = None,
    order: Annotated[
        str | None,
        typer.Option(help="sequential or batch updates. By default as in models.json, else sequential."),
    ] = None,
    json_: Json = None,
    plot: Plot = None,
    out: Out = None,
    save: Save = None,
    max_steps: MaxSteps = None,
    quiet: Quiet = False,
) -> None:
    """Run over a log in the form of CSV files."""
    estimator, outputs = _known(filter_), _Outputs(json_, plot, out, save, quiet)
    outputs.prepare()
    log = Log.read_csv(folder)
    controls, measurements = csv_columns(folder)
    file = _read_models(folder / MODELS_FILE)
    moves = _choose("motion", MOTIONS, controls, motion, motion_noise, file.motion)
    sees = _choose("sensor", SENSORS, measurements, sensor, sensor_noise, file.sensor)
    if isinstance(moves, Odometry) != log.increments:
        kind = "increments" if log.increments else "rates"
        raise LogFileError(f"{folder / 'controls.csv'} has {kind} {','.join(controls)}, which {moves!r} cannot take")
    start = replace(
        file.start, gate=file.start.gate if gate is None else gate, order=file.start.order if order is None else order
    )
    log = log if max_steps is None else _beginning(log, max_steps)
    assessment = _estimate(lambda: _make(estimator, moves, sees, start), log, start.pose, outputs, str(folder))
    models = f"{_described('motion', MOTIONS, moves)} {_described('sensor', SENSORS, sees)}"
    _print(quiet, _table(str(folder), [assessment]), f"Models: {models}")


@app.command("simulate", epilog="Example: slamkit simulate loop --seed 1 --out loop && slamkit run csv loop")
def simulate_world(
    world: Annotated[str, typer.Argument(metavar="WORLD", help=f"One of {', '.join(WORLDS)}.")],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Where to write.")],
    seed: Annotated[int, typer.Option("--seed", metavar="S", min=0, help="The same seed gives the same bytes.")] = 0,
    quiet: Quiet = False,
) -> None:
    """Simulate a run and write it as CSV files with its truth; models.json says which models and noise made it."""
    if world not in WORLDS:
        raise InputError(f"world is {world!r}, expected one of {', '.join(WORLDS)}")
    made = WORLDS[world]()
    log = simulate(made, np.random.default_rng(seed))
    _write_log(out, made, log)
    _print(quiet, f"{len(log)} steps and {len(log.observations)} sightings are in {out}")


@app.command("compare", epilog="Example: slamkit compare --world loop --filters ekf,fej,ideal --runs 10 --out study")
def compare_filters(
    world: Annotated[
        str,
        typer.Option("--world", metavar="WORLD", help=f"One of {', '.join(WORLDS)}, or a folder of CSV files."),
    ],
    filters: Annotated[
        str,
        typer.Option(
            "--filters",
            metavar="A,B,…",
            help=f"Estimators, out of {', '.join(FILTERS)}; or all of them: all. A step of ukf-full costs O(D³).",
        ),
    ] = "ekf,fej,oc,invariant,iterated,ideal,ukf",
    runs: Annotated[
        int | None, typer.Option("--runs", metavar="M", min=1, help="Simulated runs; 50 by default. A log is one run.")
    ] = None,
    seed: Annotated[int, typer.Option("--seed", metavar="S", min=0, help="The same seed gives the same runs.")] = 0,
    jobs: Annotated[int, typer.Option("--jobs", metavar="J", help="Worker processes; -1: one a core.")] = -1,
    json_: Json = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Write report.md and figures; keep the runs, to resume from."),
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Compare filters on the same runs: accuracy, consistency, and what they claim to know of their gauge."""
    names = list(FILTERS) if filters == "all" else [name.strip() for name in filters.split(",") if name.strip()]
    for name in names:
        _known(name)
    _Outputs(json_, None, out, None, quiet).prepare()
    models: dict[str, Any] = {}
    source: World | Path
    if world in WORLDS:
        source = WORLDS[world]()
    elif Path(world).is_dir():
        source, columns, file = Path(world), csv_columns(world), _read_models(Path(world) / MODELS_FILE)
        models = {
            "motion": _choose("motion", MOTIONS, columns[0], None, None, file.motion),
            "sensor": _choose("sensor", SENSORS, columns[1], None, None, file.sensor),
            "pose": file.start.pose,
            "pose_covariance": file.start.pose_covariance,
            "options": {"order": file.start.order, "gate": file.start.gate},
        }
    else:
        raise InputError(f"world is {world!r}, expected one of {', '.join(WORLDS)} or a folder of CSV files")
    kept = None if out is None else out / "runs"
    try:
        study = _compare(quiet, names, source, runs, seed, jobs=jobs, folder=kept, **models)
    except KeyboardInterrupt:
        if kept is not None:
            typer.echo(f"interrupted; what is done is in {kept}, and the same command goes on from there", err=True)
        raise
    if json_ is not None:
        write_json(json_, study.summary())
    if out is not None:
        _write_study(out, study)
    runs_of = f"{study.runs} run{'' if study.runs == 1 else 's'}"
    title = f"{study.world}: {runs_of if world in WORLDS else 'a recorded log, aligned with the truth it has'}"
    where = [] if out is None else [f"Report and figures are in {out}"]
    _print(quiet, _comparison(study, title), *_said(study), *where)


@app.command("fetch", epilog="Example: slamkit fetch mrclam 1 --folder data")
def fetch_set(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Data set: mrclam.")],
    number: Annotated[int, typer.Argument(metavar="N", help="Which of its sets.")],
    folder: Annotated[
        Path | None,
        typer.Option("--folder", metavar="DIR", help="Where to put it; by default the user's cache folder."),
    ] = None,
    base_url: Annotated[
        str | None,
        typer.Option("--base-url", metavar="URL", help="Another address of the folder with the sets' files."),
    ] = None,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="No progress; the path is printed all the same.")
    ] = False,
) -> None:
    """Download a set from its official address, unless it is there already, and print its path."""
    from slamkit.datasets.fetch import fetch

    with _bar(quiet, DownloadColumn()) as bar:
        task = bar.add_task(f"{name} {number}", total=None)
        path = fetch(
            name, number, folder, base_url=base_url, progress=lambda received: bar.update(task, completed=received)
        )
    typer.echo(path)


# -- filters and their models -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Start:
    """What a filter is made with beside its models."""

    pose: ArrayLike = (0.0, 0.0, 0.0)
    pose_covariance: ArrayLike | None = None
    order: str = "sequential"
    gate: float | None = None


class _ModelsFile(NamedTuple):
    """What models.json says."""

    motion: MotionModel | None
    sensor: SensorModel | None
    start: _Start


def _known(name: str) -> Any:
    if name not in FILTERS:
        raise InputError(f"filter is {name!r}, expected one of {', '.join(FILTERS)}")
    return FILTERS[name]


def _make(estimator: Any, motion: MotionModel, sensor: SensorModel, start: _Start) -> Any:
    return estimator(motion, sensor, start.pose, start.pose_covariance, start.order, gate=start.gate)


def _maker(name: str, world: World) -> Callable[[], Any]:
    """Makes filters that know the world's models and its initial belief."""
    start = _Start(world.pose, world.pose_covariance)
    return lambda: _make(FILTERS[name], world.motion, world.sensor, start)


def _choose(
    what: str,
    kinds: Mapping[str, _Kind],
    columns: Sequence[str],
    name: str | None,
    noise: str | None,
    from_file: Any,
) -> Any:
    """The model that the options name, else that of models.json, else the one whose columns these are."""
    if name is not None and name not in kinds:
        raise InputError(f"--{what} is {name!r}, expected one of {', '.join(kinds)}")
    of_file = next((n for n, kind in kinds.items() if type(from_file) is kind.model), None)
    if noise is None and of_file is not None and name in (None, of_file):
        return from_file
    by_columns = next((n for n, kind in kinds.items() if tuple(columns) == kind.columns), None)
    chosen = name or of_file or by_columns
    if chosen is None:
        raise InputError(f"the columns {','.join(columns)} tell no {what} model, expected --{what} {'|'.join(kinds)}")
    kind = kinds[chosen]
    if noise is None:
        return kind.model(*kind.default)
    expected = f"--{what}-noise is {noise!r}, {chosen} takes {len(kind.noise)}: {', '.join(kind.noise)}"
    try:
        numbers = [float(part) for part in noise.split(",")]
    except ValueError:
        raise InputError(expected) from None
    if len(numbers) != len(kind.noise):
        raise InputError(expected)
    return kind.model(*numbers)


def _described(what: str, kinds: Mapping[str, _Kind], model: Any) -> str:
    """The options that give this model."""
    name, kind = next((name, kind) for name, kind in kinds.items() if type(model) is kind.model)
    noise = ",".join(f"{getattr(model, field.split()[0]):.4g}" for field in kind.noise)
    extra = " (and additive pose noise)" if np.any(getattr(model, "pose_covariance", 0.0)) else ""
    return f"--{what} {name} --{what}-noise {noise}{extra}"


def _read_models(path: Path) -> _ModelsFile:
    """models.json, every entry of which is optional; nothing where there is no such file."""
    if not path.exists():
        return _ModelsFile(None, None, _Start())
    try:
        facts = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise LogFileError(f"{path} is not JSON: {error}") from None
    names = ("motion", "sensor", "pose", "pose_covariance", "order", "gate")
    if not isinstance(facts, dict) or not facts.keys() <= set(names):
        raise LogFileError(f"{path} holds {facts!r:.100}, expected an object with some of {', '.join(names)}")
    gate = facts.get("gate")
    if not (gate is None or (isinstance(gate, int | float) and gate > 0)):
        raise LogFileError(f"{path}: gate is {gate!r}, expected null or a number > 0")
    models: dict[str, Any] = {}
    for what, kinds in (("motion", MOTIONS), ("sensor", SENSORS)):
        try:
            models[what] = None if facts.get(what) is None else model_from_dict(facts[what])
        except InputError as error:
            raise LogFileError(f"{path}: {what}: {error}") from None
        if models[what] is not None and all(type(models[what]) is not kind.model for kind in kinds.values()):
            raise LogFileError(f"{path}: {what} is {models[what]!r}, which is no {what} model")
    start = _Start(
        **{name: facts[name] for name in ("pose", "pose_covariance", "order", "gate") if facts.get(name) is not None}
    )
    try:
        _make(FILTERS["ekf"], Unicycle(0.0, 0.0), RelativePosition(1.0), start)
    except InputError as error:
        raise LogFileError(f"{path}: {error}") from None
    return _ModelsFile(models["motion"], models["sensor"], start)


def _write_log(folder: Path, world: World, log: Log) -> None:
    """CSV files, and models.json beside them."""
    measurements = next(kind.columns for kind in SENSORS.values() if type(world.sensor) is kind.model)
    log.write_csv(folder, observations=measurements)
    write_json(
        folder / MODELS_FILE,
        {
            "motion": model_to_dict(world.motion),
            "sensor": model_to_dict(world.sensor),
            "pose": world.pose.tolist(),
            "pose_covariance": world.pose_covariance.tolist(),
        },
    )


def _beginning(log: Log, steps: int) -> Log:
    """The log that ends with its first so many steps."""
    schedule = log.schedule
    if steps >= len(schedule.times):
        return log
    end, seen = float(schedule.times[steps - 1]), int(schedule.first[steps])
    assert log.end_time is not None
    acting = log.control_times < end
    truth = log.truth
    if truth is not None:
        known = truth.times <= schedule.times[steps]  # so that the last step finds the truth that is nearest to it
        truth = replace(truth, times=truth.times[known], poses=truth.poses[known])
    return replace(
        log,
        control_times=log.control_times[acting],
        controls=log.controls[acting],
        observation_times=log.observation_times[:seen],
        observation_ids=log.observation_ids[:seen],
        observations=log.observations[:seen],
        end_time=min(end, log.end_time),
        truth=truth,
    )


# -- running and writing ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Outputs:
    """Where the results of a run go."""

    json: Path | None = None
    plot: Path | None = None
    out: Path | None = None
    save: Path | None = None
    quiet: bool = False

    def prepare(self) -> None:
        """Make the folders, and refuse before the run what could not be written after it."""
        if self.plot is not None and self.plot.suffix.lower() not in FIGURES:
            raise InputError(f"--plot is {self.plot}, expected a name that ends in {', '.join(FIGURES)}")
        for file in (self.json, self.plot, self.save):
            if file is not None:
                if file.is_dir():
                    raise InputError(f"{file} is a folder, expected a file to write")
                file.parent.mkdir(parents=True, exist_ok=True)
        if self.out is not None:
            self.out.mkdir(parents=True, exist_ok=True)

    def write(self, assessment: Assessment, log: Log, f: Any, title: str) -> None:
        if self.json is not None:
            write_json(self.json, assessment.summary)
        if self.plot is not None:
            write_figure(self.plot, assessment.overview(log, title))
        if self.out is not None:
            write_run(self.out, assessment, log, title)
        if self.save is not None:
            f.save(self.save)


def _estimate(make: Callable[[], Any], log: Log, pose: ArrayLike, outputs: _Outputs, title: str) -> Assessment:
    """Run, judge and write; what a run that fails midway did until then goes to --out."""
    f = make()
    titled = f"{title}: {plots.style(f.name).label}"
    try:
        with _bar(outputs.quiet, BarColumn(), TextColumn("{task.completed:.0f}/{task.total:.0f} steps")) as bar:
            task = bar.add_task(f"{titled}: loading (at the first run, compiling: half a minute)", total=len(log))
            # What is timed must not be the loading of compiled code; if the first step is to blame, the run says so.
            with suppress(SlamkitError):
                make().run(_beginning(log, 1))
            bar.update(task, description=titled)
            history = f.run(log, progress=lambda done, total: bar.update(task, completed=done, total=total))
    except (SlamkitError, KeyboardInterrupt) as error:
        history = getattr(error, "history", None)
        if history is None or outputs.out is None:
            raise
        write_run(outputs.out, assess(history, log, f.motion, pose), log, f"{titled}, incomplete")
        done = f"its first {len(history.times)} of {len(log)} steps are in {outputs.out}"
        if isinstance(error, KeyboardInterrupt):
            typer.echo(f"interrupted; {done}", err=True)
            raise
        raise SlamkitError(f"{_reason(error)}; {done}") from error
    assessment = assess(history, log, f.motion, pose)
    outputs.write(assessment, log, f, titled)
    return assessment


def _compare(
    quiet: bool, filters: Sequence[str], world: World | Path, runs: int | None, seed: int, **more: Any
) -> Study:
    """A study, with a bar."""
    from slamkit.study import compare

    with _bar(quiet, BarColumn(), MofNCompleteColumn()) as bar:
        task = bar.add_task(f"comparing {len(filters)} filters", total=None)
        return compare(
            filters, world, runs, seed, progress=lambda n, of: bar.update(task, completed=n, total=of), **more
        )


def _write_study(folder: Path, study: Study) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "report.md").write_text(study.report(), encoding="utf-8")
    write_json(folder / "summary.json", study.summary())
    for name, figure in study.figures().items():
        write_figure(folder / f"{name}.png", figure)


@contextmanager
def _bar(quiet: bool, *columns: Any) -> Iterator[Progress]:
    """A progress bar on stderr, unless that is no terminal."""
    console = Console(stderr=True)
    layout = (TextColumn("{task.description}"), *columns, TimeElapsedColumn())
    with Progress(*layout, console=console, transient=True, disable=quiet or not console.is_terminal) as bar:
        yield bar


# -- figures and tables -----------------------------------------------------------------------------------------------


def _correlation_figure(f: Any, log: Log, instants: int = 60) -> Figure:
    """How the covariance becomes dense as the filter runs: with a third of the map, the whole map, at the end."""
    from matplotlib.figure import Figure

    at = set(np.geomspace(1, len(log), instants).round().astype(int).tolist())  # crowded where the map grows
    covariances, times = [], []
    for step, (time, u, dt, scan) in enumerate(log, 1):
        if u is None:
            f.observe_scan(scan)
        else:
            f.step(u, dt, scan)
        if step in at and f.landmarks:
            covariances.append(f.P)
            times.append(time)
    dims = np.array([len(P) for P in covariances])
    shown = [int(np.argmax(dims >= 3 + (dims[-1] - 3) / 3)), int(np.argmax(dims == dims[-1])), len(dims) - 1]
    figure = Figure(figsize=(10.0, 6.4), layout="constrained")
    panels = figure.subplot_mosaic([["a", "b", "c"], ["density"] * 3], height_ratios=[1.3, 1.0])
    for panel, k in zip("abc", shown, strict=True):
        ids = f.landmark_ids[: (dims[k] - 3) // 2]
        plots.plot_correlation(panels[panel], covariances[k], ids, times[k], colorbar=panel == "c")
    plots.plot_density(panels["density"], covariances, times)
    panels["density"].set_xscale("log")
    return figure


def _table(title: str, runs: Sequence[Assessment]) -> Table:
    """One column a filter, dead reckoning beside them; every run is over the same log."""
    summaries = [run.summary for run in runs]
    baseline = runs[0].dead_reckoning_evaluation
    table = Table(title=Text(title))
    table.add_column("")
    for summary in summaries:
        table.add_column(summary["filter"], justify="right")
    table.add_column("dead reckoning", justify="right")
    expected = {s["nis_dof_mean"] for s in summaries} - {None}
    nis = f"mean NIS (consistent: {expected.pop():g})" if len(expected) == 1 else "mean NIS"
    rows: list[tuple[str, list[Any], Any]] = [
        ("trajectory error (ATE) [m]", [s["ate_m"] for s in summaries], baseline.ate_m),
        ("heading RMSE [deg]", [s["heading_rmse_deg"] for s in summaries], baseline.heading_rmse_deg),
        ("landmark RMSE [m]", [s["landmark_rmse_m"] for s in summaries], None),
        (nis, [s["nis_mean"] for s in summaries], None),
        ("steps", [s["steps"] for s in summaries], None),
        ("sightings", [s["observations"] for s in summaries], None),
        ("rejected sightings", [s["rejected"] for s in summaries], None),
        ("landmarks", [s["landmarks"] for s in summaries], None),
        ("time [s]", [s["seconds"] for s in summaries], None),
        ("time a step [µs]", [_microseconds(s["seconds"], s["steps"]) for s in summaries], None),
    ]
    for name, values, beside in rows:
        table.add_row(name, *map(_number, values), _number(beside))
    return table


#: Columns of the table of a comparison, with a truth and without one; broken so that they fit a terminal of 80.
JUDGED = {
    "position\nRMSE [m]": "position_rmse_m",
    "heading\nRMSE\n[deg]": "heading_rmse_deg",
    "pose\nNEES (3)": "pose_nees",
    "gauge\nNEES (3)": "gauge_nees",
    "relative\nNEES/dof\n(1)": "relative_nees_per_dof",
    "nullity\n(3)": "nullity",
}
UNJUDGED = {
    "NIS/dof\n(1)": "nis_per_dof",
    "nullity\n(3)": "nullity",
    "gauge\ndeviation\nfalls by": "gauge_deviation_drop",
    "stochastic\ngauge [m]": "stochastic_gauge_m",
    "time\na step\n[µs]": "seconds_per_step",
}


def _comparison(study: Study, title: str) -> Table:
    """One filter a row; in parentheses, what a consistent filter is expected to have."""
    summary = study.summary()
    judged = any(numbers["pose_nees"] is not None for numbers in summary.values())
    table = Table(title=Text(title))
    table.add_column("", no_wrap=True)
    columns = JUDGED if judged else UNJUDGED
    for heading in columns:
        table.add_column(heading, justify="right", no_wrap=True)
    for name, numbers in summary.items():
        table.add_row(name, *[_figure_of(key, numbers[key]) for key in columns.values()])
    return table


def _figure_of(key: str, value: float | None) -> str:
    if value is not None and key in ("gauge_deviation_drop", "stochastic_gauge_m"):
        return f"{value:.0e}" if value < 5e-4 else f"{value:.3f}"
    return _number(None if value is None else 1e6 * value if key == "seconds_per_step" else value)


def _said(study: Study) -> list[str]:
    """What stands below the table: the bounds, what the numbers say, and what went wrong."""
    summary = study.summary()
    bounds = []
    for name, key in (("pose NEES", "pose_nees"), ("gauge NEES", "gauge_nees"), ("relative NEES", "relative_nees")):
        of = next((s for s in summary.values() if s[f"{key}_low"] is not None), None)
        if of is not None:
            bounds.append(f"{name} {of[f'{key}_low']:.2f} to {of[f'{key}_high']:.2f}")
    wrong = []
    for name, s in summary.items():
        if s["diverged"]:
            why = next((f" ({t.error})" for t in study.failures if t.filter == name and t.error), "")
            wrong.append(f"{name} {s['diverged']} of {s['runs']}{why}")
    said = [f"Consistent (95 %): {', '.join(bounds)}"] if bounds else []
    said += [" ".join(study.findings())] if study.findings() else []
    return [*said, *([f"Failed or diverged: {', '.join(wrong)}"] if wrong else [])]


def _microseconds(seconds: float | None, steps: int) -> float | None:
    return None if seconds is None or steps == 0 else 1e6 * seconds / steps


def _number(value: float | None) -> str:
    if value is None:
        return "-"
    return str(value) if isinstance(value, int) else f"{value:.3f}" if abs(value) < 100 else f"{value:.0f}"


def _print(quiet: bool, *what: Table | str) -> None:
    if not quiet:
        console = Console()
        for thing in what:
            # A path must come out whole, so that it can be copied: text is not wrapped.
            console.print(thing, soft_wrap=isinstance(thing, str), markup=False, highlight=False)


# -- errors -----------------------------------------------------------------------------------------------------------


def _reason(error: BaseException) -> str:
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        return f"{error.filename}: {error.strerror}"
    return str(error) or type(error).__name__


def _fail(message: str) -> NoReturn:
    typer.echo(f"error: {' '.join(message.splitlines())}", err=True)
    sys.exit(2)


if __name__ == "__main__":
    main()
