"""``slamkit compare``: run several filters on the same runs and judge them."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.progress import BarColumn, MofNCompleteColumn

from slamkit.cli import options
from slamkit.cli.csv_folder import FILES, read_settings
from slamkit.cli.errors import RunError, reason, running
from slamkit.cli.filters import find_filters
from slamkit.cli.models import check_fit, choose, columns_of
from slamkit.cli.models_file import Settings, read_models
from slamkit.cli.outputs import Outputs
from slamkit.cli.printing import bar, comparison_table, failures, output, remarks
from slamkit.cli.worlds import find_world
from slamkit.errors import InputError
from slamkit.evaluate.run_report import write_figure, write_json
from slamkit.filters import FILTERS
from slamkit.logs import Log
from slamkit.simulate import WORLDS, World

if TYPE_CHECKING:
    from slamkit.study import Study

__all__ = ["compare_filters", "study_with_bar", "write_study"]


def compare_filters(
    world: Annotated[
        str,
        typer.Option(
            "--world",
            metavar="WORLD",
            help=f"One of {', '.join(WORLDS)}, a folder of CSV files, or module:function of your own.",
            autocompletion=options.completing(WORLDS),
        ),
    ],
    filters: Annotated[
        str,
        typer.Option(
            "--filters",
            metavar="A,B,...",
            help=f"Estimators out of {', '.join(FILTERS)}, {options.OWN}; or all. A step of ukf-full costs O(D³).",
        ),
    ] = "ekf,fej,oc,invariant,iterated,ideal,ukf",
    runs: Annotated[
        int | None, typer.Option("--runs", metavar="M", min=1, help="Simulated runs, 50 by default. A log is one run.")
    ] = None,
    seed: Annotated[int, typer.Option("--seed", metavar="S", min=0, help="The same seed gives the same runs.")] = 0,
    jobs: Annotated[int, typer.Option("--jobs", metavar="J", help="Worker processes; -1: one a core.")] = -1,
    motion: options.Motion = None,
    motion_noise: options.MotionNoise = None,
    sensor: options.Sensor = None,
    sensor_noise: options.SensorNoise = None,
    gate: options.Gate = None,
    order: options.Order = None,
    models: options.Models = None,
    json_: options.Json = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="DIR", help="Write report.md, tables and figures. Runs are kept there, to resume from."
        ),
    ] = None,
    quiet: options.Quiet = False,
) -> None:
    """Compare filters on the same runs: accuracy, consistency, and what they claim to know of their gauge."""
    chosen = find_filters(filters)
    outputs = Outputs(json_, None, out)
    outputs.prepare()
    given = Settings(gate=gate, order=order).over(Settings() if models is None else read_models(models))
    source = _find_source(world)
    settings = _choose_models(source, given, (motion, motion_noise), (sensor, sensor_noise))
    kept = None if out is None else out / "runs"
    try:
        study = study_with_bar(
            quiet,
            chosen,
            source.world,
            runs,
            seed,
            jobs=jobs,
            folder=kept,
            motion=settings.motion,
            sensor=settings.sensor,
            pose=settings.pose,
            pose_covariance=settings.pose_covariance,
            options=settings.options,
        )
    except KeyboardInterrupt:
        if kept is not None:
            print(f"interrupted; what is done is in {kept}, and the same command goes on from there", file=sys.stderr)
        raise
    except InputError:
        raise
    except Exception as error:
        resume = "" if kept is None else f"; what is done is in {kept}, and the same command goes on from there"
        raise RunError(f"{reason(error)}{resume}") from error
    with running():
        outputs.write_json(study.summary())
        if out is not None:
            write_study(out, study)
    runs_of = f"{study.runs} run{'' if study.runs == 1 else 's'}"
    title = f"{study.world}: {'a recorded log, aligned with the truth it has' if source.recorded else runs_of}"
    where = [] if out is None else [f"Report and figures are in {out}"]
    wrong = failures(study)
    if study.all_failed:
        why = next(t.error for t in study.failures)
        raise RunError(f"every run of every filter failed; the first: {study.failures[0].filter}: {why}")
    to_stderr = outputs.json_on_stdout
    output(comparison_table(study, title), *remarks(study), *wrong, *where, quiet=quiet, on_stderr=to_stderr)
    if quiet:
        output(*wrong, on_stderr=True)


@dataclass(frozen=True)
class _Source:
    """What is compared on: a world to simulate, or a folder with a log."""

    world: World | Path
    settings: Settings
    columns: Mapping[str, tuple[str, ...]]
    increments: bool

    @property
    def recorded(self) -> bool:
        return isinstance(self.world, Path)

    def file(self, what: str) -> object:
        """What has the controls ("motion") or the measurements ("sensor"), for a message."""
        return self.world / FILES[what] if isinstance(self.world, Path) else f"the world {self.world.name}"


def _find_source(text: str) -> _Source:
    # A folder comes before module:function, because C:\logs has a colon too.
    if text not in WORLDS and Path(text).is_dir():
        settings, columns = read_settings(Path(text))
        return _Source(Path(text), settings, columns, Log.read_csv(text).increments)
    if text not in WORLDS and ":" not in text:
        raise InputError(
            f"--world is {text!r}, expected one of {', '.join(WORLDS)}, a folder of CSV files or module:function"
        )
    world = find_world(text)
    settings = Settings(world.motion, world.sensor, world.pose, world.pose_covariance)
    columns = {"motion": columns_of(type(world.motion)), "sensor": columns_of(type(world.sensor))}
    return _Source(world, settings, columns, world.increments)


def _choose_models(
    source: _Source, given: Settings, motion: tuple[str | None, str | None], sensor: tuple[str | None, str | None]
) -> Settings:
    """The settings of every filter: those of the options, of ``--models``, and of the log or world."""
    settings = given.over(source.settings)
    chosen = {
        "motion": choose("motion", source.columns["motion"], *motion, settings.motion),
        "sensor": choose("sensor", source.columns["sensor"], *sensor, settings.sensor),
    }
    for what, model in chosen.items():
        check_fit(what, model, source.columns[what], source.file(what), source.increments)
    return Settings(**chosen).over(settings)


def study_with_bar(
    quiet: bool, filters: Mapping[str, Any], world: World | Path, runs: int | None, seed: int, **more: Any
) -> Study:
    """Run a study with a progress bar."""
    from slamkit import study

    with bar(quiet, BarColumn(), MofNCompleteColumn()) as progress:
        task = progress.add_task(f"comparing {len(filters)} filters", total=None)
        return study.compare(
            filters, world, runs, seed, progress=lambda n, of: progress.update(task, completed=n, total=of), **more
        )


def write_study(folder: Path, study: Study) -> None:
    """Write report.md, summary.json, trials.csv, summary.tex and the figures of a study."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "report.md").write_text(study.report(), encoding="utf-8")
    write_json(folder / "summary.json", study.summary())
    study.to_csv(folder / "trials.csv")
    study.to_latex(folder / "summary.tex")
    for name, figure in study.figures().items():
        write_figure(folder / f"{name}.png", figure)
