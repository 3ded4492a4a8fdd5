"""Options that several commands have."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Annotated, Any

import typer

from slamkit.filters import FILTERS
from slamkit.models import MOTIONS, SENSORS, parameters_of
from slamkit.registry import Registry

FIGURES = (".png", ".pdf", ".svg")  #: endings of the files that slamkit.plots.save writes


def completing(names: Iterable[str]) -> Callable[[str], list[str]]:
    """Completion of an option by the shell: the names that begin with what has been typed."""
    return lambda incomplete: [name for name in names if name.startswith(incomplete)]


def _noise(kinds: Registry[Any]) -> str:
    """What the noise option of each model takes, with its default."""
    described = []
    for name, kind in kinds.items():
        parameters = parameters_of(kind)
        if parameters:
            numbers = ", ".join(f"{p} ({unit})" for p, (unit, _) in parameters.items())
            default = ",".join(f"{typical:g}" for _, typical in parameters.values())
            described.append(f"{name}: {numbers}; default {default}.")
    return " ".join(described)


OWN = "or module:Class of your own"

Filter = Annotated[
    str,
    typer.Option("--filter", help=f"Estimator: {', '.join(FILTERS)}, {OWN}.", autocompletion=completing(FILTERS)),
]
Motion = Annotated[
    str | None,
    typer.Option(
        "--motion",
        help=f"Motion model: {', '.join(MOTIONS)}, {OWN}. Default: as the data say (models.json, then the columns).",
        autocompletion=completing(MOTIONS),
    ),
]
MotionNoise = Annotated[
    str | None,
    typer.Option("--motion-noise", metavar="A,B,...", help=f"Noise of the motion model. {_noise(MOTIONS)}"),
]
Sensor = Annotated[
    str | None,
    typer.Option(
        "--sensor",
        help=f"Sensor model: {', '.join(SENSORS)}, {OWN}. Default: as the data say (models.json, then the columns).",
        autocompletion=completing(SENSORS),
    ),
]
SensorNoise = Annotated[
    str | None,
    typer.Option("--sensor-noise", metavar="A,B,...", help=f"Noise of the sensor model. {_noise(SENSORS)}"),
]
Gate = Annotated[
    float | None,
    typer.Option(
        "--gate", help="Largest NIS that is accepted; inf accepts all. Default: as the data say, else every sighting."
    ),
]
Order = Annotated[
    str | None,
    typer.Option(
        "--order",
        help="sequential or batch updates. Default: as the data say, else sequential.",
        autocompletion=completing(("sequential", "batch")),
    ),
]
Models = Annotated[
    Path | None,
    typer.Option(
        "--models",
        metavar="FILE",
        help="A models.json: an object with some of motion, sensor, pose, pose_covariance, order and gate; a model "
        'is {"name": "RangeBearing", "sigma_range": 0.1, "sigma_bearing": 0.035} (docs/models-json.md). It takes '
        "precedence over what the data say. Options take precedence over it.",
    ),
]
Json = Annotated[
    Path | None,
    typer.Option("--json", metavar="FILE", help="Write the numbers as JSON. With -, to standard output alone."),
]
Plot = Annotated[
    Path | None, typer.Option("--plot", metavar="FILE", help=f"Write the overview figure ({', '.join(FIGURES)}).")
]
Out = Annotated[
    Path | None,
    typer.Option(
        "--out",
        metavar="DIR",
        help="Write summary.json, trajectory.txt (TUM), trajectory.csv, map.csv, history.npz and overview.png there. "
        "If the run fails midway, they hold its first steps.",
    ),
]
Save = Annotated[
    Path | None, typer.Option("--save", metavar="FILE", help="Write the filter itself (npz) after the run.")
]
MaxSteps = Annotated[int | None, typer.Option("--max-steps", metavar="M", min=1, help="Run the first M steps only.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]
