"""A log as a folder of CSV files, with the models.json beside them."""

from __future__ import annotations

from pathlib import Path

from slamkit.cli.models import columns_of
from slamkit.cli.models_file import MODELS_FILE, Settings, read_models, write_models
from slamkit.logs import Log, csv_columns
from slamkit.simulate import World

__all__ = ["FILES", "read_settings", "write_log"]


FILES = {"motion": "controls.csv", "sensor": "observations.csv"}  #: the file with the numbers of each model


def read_settings(folder: Path) -> tuple[Settings, dict[str, tuple[str, ...]]]:
    """What models.json says (nothing if there is none), and the columns of the controls and the measurements.

    Raises
    ------
    LogFileError
        A file cannot be read; the message names it.
    """
    controls, measurements = csv_columns(folder)
    file = folder / MODELS_FILE
    return (read_models(file) if file.exists() else Settings()), {"motion": controls, "sensor": measurements}


def write_log(folder: Path, world: World, log: Log) -> None:
    """Write a simulated log as CSV files with its models.json."""
    measured = columns_of(type(world.sensor)) or tuple(f"z{i + 1}" for i in range(log.observations.shape[1]))
    log.write_csv(folder, observations=measured)
    write_models(folder / MODELS_FILE, world)
