"""``slamkit run NAME PATH``: run a filter over a recorded log. There is one command for each data set."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from slamkit.cli import options
from slamkit.cli.csv_folder import FILES, read_settings
from slamkit.cli.estimate import estimate
from slamkit.cli.filters import find_filter
from slamkit.cli.models import check_fit, choose, columns_of, described
from slamkit.cli.models_file import Settings, read_models
from slamkit.cli.outputs import Outputs
from slamkit.cli.printing import output, run_table
from slamkit.datasets import DATASETS, REQUIRED, DataSet, Option
from slamkit.logs import Log

__all__ = ["RunGroup"]

PANEL = "Options of this data set"
CSV = "csv"  #: the name of a log in the form of CSV files
CSV_HELP = (
    "Folder with controls.csv (t,v,omega or t,rot1,trans,rot2) and observations.csv (t,id,range,bearing or t,id,x,y). "
    "Optional: truth.csv (t,x,y,theta), landmarks.csv (id,x,y) and models.json (docs/models-json.md)."
)


@dataclass(frozen=True)
class Source:
    """A log, and what its data set says about the filter that suits it."""

    log: Log
    title: str
    settings: Settings
    columns: Mapping[str, tuple[str, ...]]  #: of the controls ("motion") and the measurements ("sensor")
    folder: Path | None = None  #: of a log in the form of CSV files
    notes: tuple[str, ...] = ()

    def file(self, what: str) -> object:
        """What has the controls ("motion") or the measurements ("sensor"), for a message."""
        return self.title if self.folder is None else self.folder / FILES[what]


def run(
    read: Callable[[], Source],
    filter_: options.Filter = "ekf",
    motion: options.Motion = None,
    motion_noise: options.MotionNoise = None,
    sensor: options.Sensor = None,
    sensor_noise: options.SensorNoise = None,
    gate: options.Gate = None,
    order: options.Order = None,
    models: options.Models = None,
    json_: options.Json = None,
    plot: options.Plot = None,
    out: options.Out = None,
    save: options.Save = None,
    max_steps: options.MaxSteps = None,
    quiet: options.Quiet = False,
) -> None:
    """Run a filter over a log, print a table and write the files that are asked for."""
    _, kind = find_filter(filter_)
    outputs = Outputs(json_, plot, out, save)
    outputs.prepare()
    source = read()
    given = Settings(gate=gate, order=order).over(Settings() if models is None else read_models(models))
    given = given.over(source.settings)
    chosen = {
        what: choose(what, source.columns[what], name, noise, current)
        for what, name, noise, current in (
            ("motion", motion, motion_noise, given.motion),
            ("sensor", sensor, sensor_noise, given.sensor),
        )
    }
    for what, model in chosen.items():
        check_fit(what, model, source.columns[what], source.file(what), source.log.increments)
    settings = Settings(**chosen).over(given)
    log = source.log if max_steps is None else source.log.head(max_steps)
    run_ = estimate(lambda: settings.make(kind), log, settings.start, outputs, source.title, quiet)
    used = f"Models: {described('motion', settings.motion)} {described('sensor', settings.sensor)}"
    output(run_table(source.title, run_), *source.notes, used, quiet=quiet, on_stderr=outputs.json_on_stdout)


def read_csv(path: Path) -> Source:
    """A log in the form of CSV files.

    Raises
    ------
    LogFileError
        A file is missing or damaged.
    """
    log = Log.read_csv(path)
    settings, columns = read_settings(path)
    return Source(log, str(path), settings, columns, path)


def read_data_set(data_set: DataSet, path: Path, values: Mapping[str, Any]) -> Source:
    """A log of a data set.

    Raises
    ------
    InputError
        An option does not fit.
    LogFileError
        A file is missing or damaged.
    """
    recording = data_set.read(path, **values)
    settings = Settings(
        motion=recording.motion,
        sensor=recording.sensor,
        pose=recording.pose,
        pose_covariance=recording.pose_covariance,
        gate=recording.gate,
    )
    columns = {"motion": columns_of(type(recording.motion)), "sensor": columns_of(type(recording.sensor))}
    return Source(recording.log, recording.title, settings, columns, notes=recording.notes)


# ---- commands made from the list of data sets ----


class RunGroup(TyperGroup):
    """One command for each data set that is registered, ``csv``, and ``module:DATA_SET`` of a user's own."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Names of the commands."""
        return [*DATASETS, CSV]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command of this name; None if there is no such data set."""
        if cmd_name == CSV:
            return _csv_command()
        if cmd_name in DATASETS or ":" in cmd_name:
            return _command(cmd_name, DATASETS.find(cmd_name))
        return None


def _csv_command() -> Any:
    path = Annotated[Path, typer.Argument(metavar="DIR", help=CSV_HELP)]
    return _make_command(
        CSV,
        "A log in the form of CSV files.",
        "LOG --motion unicycle --motion-noise 0.1,0.05 --gate 13.8",
        {"path": (path, inspect.Parameter.empty)},
        read_csv,
    )


def _command(name: str, data_set: DataSet) -> Any:
    path = Annotated[Path, typer.Argument(metavar=data_set.path, help=data_set.path_help)]
    parameters: dict[str, tuple[Any, Any]] = {"path": (path, inspect.Parameter.empty)}
    required = []
    for option in data_set.options:
        parameters[option.name] = _parameter(option)
        if option.default is REQUIRED:
            example = (
                option.choices[0] if option.choices else {int: "1", float: "1.0", str: "NAME"}.get(option.kind, "")
            )
            required.append(f"--{option.name.replace('_', '-')} {example}".strip())

    def read(path: Path, **values: Any) -> Source:
        return read_data_set(data_set, path, values)

    return _make_command(name, data_set.description, " ".join(["PATH", *required]), parameters, read)


def _parameter(option: Option) -> tuple[Any, Any]:
    """Type and default of a reader's option, as Typer reads them from a function."""
    flag = f"--{option.name.replace('_', '-')}"
    if option.kind is bool and option.default is True:
        flag = f" /--no-{flag[2:]}"  # only the flag that changes the default
    described = typer.Option(
        flag,
        metavar=option.metavar,
        help=f"{option.help} One of {', '.join(option.choices)}." if option.choices else option.help,
        autocompletion=options.completing(option.choices) if option.choices else None,
        rich_help_panel=PANEL,
    )
    kind = option.kind if option.default is not None else option.kind | None
    return Annotated[kind, described], inspect.Parameter.empty if option.default is REQUIRED else option.default


def _make_command(
    name: str, help_: str, example: str, own: Mapping[str, tuple[Any, Any]], read: Callable[..., Source]
) -> Any:
    """The command with these parameters of its own and those of :func:`run`."""

    def command(**values: Any) -> None:
        mine = {parameter: values.pop(parameter) for parameter in own}
        run(lambda: read(**mine), **values)

    shared = list(inspect.signature(run, eval_str=True).parameters.values())[1:]
    keyword = inspect.Parameter.KEYWORD_ONLY
    parameters = [inspect.Parameter(n, keyword, annotation=kind, default=d) for n, (kind, d) in own.items()]
    parameters += [parameter.replace(kind=keyword) for parameter in shared]
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    maker = typer.Typer(add_completion=False, context_settings={"help_option_names": ["-h", "--help"]})
    maker.command(name, help=help_, epilog=f"Example: slamkit run {name} {example}")(command)
    return typer.main.get_command(maker)
