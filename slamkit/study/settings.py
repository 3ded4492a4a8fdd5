"""The settings of a study, checked before the first run."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from slamkit.arrays import Array
from slamkit.errors import InputError
from slamkit.filters import FILTERS
from slamkit.logs import Log, PathLike
from slamkit.protocols import MotionModel, SensorModel
from slamkit.simulate import World, simulate
from slamkit.study.fingerprint import fingerprint

if TYPE_CHECKING:
    from slamkit.filters.landmark_filter import LandmarkFilter

#: Called with (motion, sensor, pose, pose_covariance, **options); returns a filter.
FilterFactory = Callable[..., "LandmarkFilter"]


@dataclass(frozen=True, eq=False)
class Settings:
    """Everything that a worker needs to run any part of the study."""

    name: str  #: of the world or log
    world: World | Log
    filters: Mapping[str, FilterFactory]
    runs: int
    seed: int
    motion: MotionModel
    sensor: SensorModel
    pose: Array
    pose_covariance: Array
    options: Mapping[str, Any]
    diverged_at: float
    gauge_steps: int
    max_gap: float

    @property
    def simulated(self) -> bool:
        """Whether the runs are simulated; otherwise there is one recorded log."""
        return isinstance(self.world, World)

    @cached_property
    def times(self) -> Array:
        """(K,) ends of the steps [s]."""
        if isinstance(self.world, Log):
            return self.world.schedule.times
        return np.asarray(float(self.world.dt) * np.arange(1, len(self.world.controls) + 1, dtype=np.float64))

    @property
    def start_time(self) -> float:
        """Time at which the first step begins [s]."""
        return self.world.schedule.start_time if isinstance(self.world, Log) else 0.0

    @cached_property
    def facts(self) -> dict[str, Any]:
        """The settings that identify a study in its folder. The number of runs is not one of them: it may grow."""
        from slamkit import __version__

        return {
            "slamkit": __version__,
            "simulated": self.simulated,
            "world": self.name,
            "seed": self.seed,
            "filters": {name: fingerprint(kind) for name, kind in self.filters.items()},
            "world_content": fingerprint(self.world),
            "motion": fingerprint(self.motion),
            "sensor": fingerprint(self.sensor),
            "start": fingerprint((self.pose, self.pose_covariance)),
            "options": fingerprint(dict(sorted(self.options.items()))),
            "diverged_at": self.diverged_at,
            "gauge_steps": self.gauge_steps,
            "max_gap": self.max_gap,
        }

    def log(self, k: int) -> Log:
        """The log of run k."""
        if isinstance(self.world, Log):
            return self.world
        return simulate(self.world, np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(k,))))

    def make(self, name: str) -> LandmarkFilter:
        """A new filter of that name, at the start."""
        return self.filters[name](self.motion, self.sensor, self.pose, self.pose_covariance, **self.options)


def check_settings(
    filters: Iterable[str | type] | Mapping[str, FilterFactory | str],
    world: World | Log | PathLike,
    runs: int | None = None,
    seed: int = 0,
    motion: MotionModel | None = None,
    sensor: SensorModel | None = None,
    pose: ArrayLike | None = None,
    pose_covariance: ArrayLike | None = None,
    options: Mapping[str, Any] | None = None,
    diverged_at: float = 1.0,
    gauge_steps: int = 200,
    max_gap: float = 0.1,
) -> Settings:
    """Check the arguments of :func:`slamkit.study.compare` and fill in what was left out.

    Raises
    ------
    InputError
        An argument does not fit.
    """
    name = world.name if isinstance(world, World) else "recorded log"
    if not isinstance(world, World | Log):
        try:
            path = Path(world)
        except TypeError:
            raise InputError(f"world is a {type(world).__name__}, expected a World, a Log or a folder") from None
        name, world = path.resolve().name, Log.read_csv(path)
    simulated = isinstance(world, World)
    count = (50 if simulated else 1) if runs is None else runs
    for what, value, least in (("runs", count, 1), ("seed", seed, 0), ("gauge_steps", gauge_steps, 0)):
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
            raise InputError(f"{what} is {value!r}, expected an integer of at least {least}")
    if not simulated and count != 1:
        raise InputError(f"runs is {count}, but a recorded log is 1 run")
    for what, number in (("diverged_at", diverged_at), ("max_gap", max_gap)):
        if isinstance(number, bool | str) or not np.isreal(number) or not 0 < number < np.inf:
            raise InputError(f"{what} is {number!r}, expected a finite number > 0")
    if isinstance(world, World):
        motion, sensor = motion or world.motion, sensor or world.sensor
        pose = world.pose if pose is None else pose
        pose_covariance = world.pose_covariance if pose_covariance is None else pose_covariance
    if motion is None or sensor is None:
        raise InputError("a recorded log has no motion and sensor model: give motion=… and sensor=…")
    if options is not None and not (isinstance(options, Mapping) and all(isinstance(n, str) for n in options)):
        raise InputError(f"options is {options!r}, expected a mapping of argument names to values")
    # A wrong model or start would fail in every trial. One of slamkit's own filters reports it now.
    start = FILTERS["ekf"](
        motion,
        sensor,
        (0.0, 0.0, 0.0) if pose is None else pose,
        np.zeros((3, 3)) if pose_covariance is None else pose_covariance,
    )
    del start
    return Settings(
        name=name,
        world=world,
        filters=_choose_filters(filters),
        runs=int(count),
        seed=int(seed),
        motion=motion,
        sensor=sensor,
        pose=np.array((0.0, 0.0, 0.0) if pose is None else pose, dtype=float),
        pose_covariance=np.array(np.zeros((3, 3)) if pose_covariance is None else pose_covariance, dtype=float),
        options=dict(options or {}),
        diverged_at=float(diverged_at),
        gauge_steps=int(gauge_steps),
        max_gap=float(max_gap),
    )


def _choose_filters(filters: Iterable[str | type] | Mapping[str, FilterFactory | str]) -> dict[str, FilterFactory]:
    """Name → factory, in the order given."""
    if isinstance(filters, Mapping):
        named = list(filters.items())
    else:
        items = [filters] if isinstance(filters, str | type) else list(filters)
        named = [(item if isinstance(item, str) else _name_of(item), item) for item in items]
    if not named:
        raise InputError(f"filters is empty, expected some of {', '.join(FILTERS)}, or a mapping name → class")
    names = [name for name, _ in named]
    if len(set(names)) != len(names):
        raise InputError(f"filters has a name twice: {', '.join(map(str, names))}")
    chosen = {}
    for name, item in named:
        kind = FILTERS.find(item) if isinstance(item, str) else item
        if not isinstance(name, str) or not name or not callable(kind):
            raise InputError(f"filter {name!r} is {item!r}, expected a name (str) and a class or factory")
        chosen[name] = kind
    return chosen


def _name_of(kind: object) -> str:
    """The name of a filter class; an inherited ``name`` would confuse it with the class that it derives from."""
    if not isinstance(kind, type):
        raise InputError(f"filters has {kind!r}, expected a name or a class; give a factory a name: {{name: factory}}")
    return str(vars(kind).get("name", kind.__name__))
