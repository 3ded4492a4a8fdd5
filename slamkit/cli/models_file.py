"""models.json: which models, noise and start belong to a log."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from slamkit.errors import InputError, LogFileError
from slamkit.evaluate.run_report import write_json
from slamkit.filters import FILTERS
from slamkit.models import RelativePosition, Unicycle, model_from_dict, model_to_dict
from slamkit.protocols import MotionModel, SensorModel
from slamkit.simulate import World

__all__ = ["MODELS_FILE", "Settings", "read_models", "write_models"]

MODELS_FILE = "models.json"


@dataclass(frozen=True)
class Settings:
    """What a filter is made with. None stands for an entry that was not given."""

    motion: MotionModel | None = None
    sensor: SensorModel | None = None
    pose: ArrayLike | None = None
    pose_covariance: ArrayLike | None = None
    order: str | None = None
    gate: float | None = None

    def over(self, other: Settings) -> Settings:
        """These settings, with those of `other` for what is not given here."""
        return Settings(
            **{
                f.name: value if (value := getattr(self, f.name)) is not None else getattr(other, f.name)
                for f in fields(self)
            }
        )

    @property
    def start(self) -> ArrayLike:
        """Where the filter starts [m, m, rad]; the origin where no pose is given."""
        return (0.0, 0.0, 0.0) if self.pose is None else self.pose

    @property
    def options(self) -> dict[str, Any]:
        """Keyword arguments of a filter."""
        return {"order": self.order or "sequential", "gate": self.gate}

    def make(self, kind: Any) -> Any:
        """A filter of this class."""
        return kind(self.motion, self.sensor, self.start, self.pose_covariance, **self.options)


def read_models(path: Path) -> Settings:
    """Read a models.json. Every entry is optional; docs/models-json.md describes them.

    Raises
    ------
    LogFileError
        The file cannot be read, is not JSON, or has an entry that is unknown or does not fit.
    """
    try:
        facts = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise LogFileError(f"{path} cannot be read: {error.strerror or error}") from None
    except (ValueError, RecursionError) as error:
        raise LogFileError(f"{path} is not JSON: {error}") from None
    names = [f.name for f in fields(Settings)]
    if not isinstance(facts, dict) or not facts.keys() <= set(names):
        raise LogFileError(f"{path} holds {facts!r:.100}, expected an object with some of {', '.join(names)}")
    gate = facts.get("gate")
    if not (gate is None or (isinstance(gate, int | float) and not isinstance(gate, bool) and gate > 0)):
        raise LogFileError(f"{path}: gate is {gate!r}, expected null or a number > 0")
    for what, method in (("motion", "move"), ("sensor", "predict")):
        if facts.get(what) is None:
            continue
        try:
            facts[what] = model_from_dict(facts[what])
        except InputError as error:
            raise LogFileError(f"{path}: {what}: {error}") from None
        if not hasattr(facts[what], method):
            raise LogFileError(f"{path}: {what} is {facts[what]!r}, which is no {what} model")
    settings = Settings(**facts)
    try:
        Settings(Unicycle(0.0, 0.0), RelativePosition(1.0)).over(Settings()).over(settings).make(FILTERS["ekf"])
    except InputError as error:
        raise LogFileError(f"{path}: {error}") from None
    return settings


def write_models(path: Path, world: World) -> None:
    """Write the models.json of a simulated log. A model that is not registered is left out (null)."""
    write_json(
        path,
        {
            "motion": model_to_dict(world.motion),
            "sensor": model_to_dict(world.sensor),
            "pose": world.pose.tolist(),
            "pose_covariance": world.pose_covariance.tolist(),
        },
    )
