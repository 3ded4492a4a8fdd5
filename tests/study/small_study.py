"""A small world and a small study that the tests of this room share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from slamkit import EKFSLAM, History, Log, Truth, World, simulate
from slamkit.models import RelativePosition, Unicycle
from slamkit.study import Study, compare

NAMES = ("ekf", "invariant", "ideal")


KEYS = {
    "pose_nees", "pose_nees_median", "pose_nees_above_6", "position_rmse_m", "heading_rmse_deg", "landmark_nees",
    "landmark_rmse_m", "relative_nees_per_dof", "nullity", "gauge_deviation_drop", "stochastic_gauge_m",
    "equivariance", "seconds_per_step", "diverged",
}  # fmt: skip


def world(steps: int = 30) -> World:
    """Five landmarks around a small circle, always in sight."""
    angle = 2 * np.pi * np.arange(5) / 5
    return World(
        name="small",
        landmarks={f"L{i}": 4 * np.array([np.cos(a), np.sin(a)]) for i, a in enumerate(angle)},
        motion=Unicycle(0.05, 0.05),
        sensor=RelativePosition(0.1),
        controls=np.tile([0.5, 0.25], (steps, 1)),
        dt=1.0,
        pose=np.array([0.0, -2.0, 0.0]),
        pose_covariance=np.diag([0.01, 0.01, 0.02**2]),
    )


def small(**changes: Any) -> Study:
    arguments: dict[str, Any] = {"runs": 4, "seed": 11, "jobs": 2, "gauge_steps": 8}
    return compare(changes.pop("filters", NAMES), changes.pop("world", world()), **(arguments | changes))


def assert_same(a: Study, b: Study) -> None:
    """Equal to the bit in everything but the measured times."""
    assert dict(a.facts) == dict(b.facts) and a.filters == b.filters and a.runs == b.runs
    np.testing.assert_array_equal(a.times, b.times)
    for name in a.filters:
        for mine, other in zip((*a.trials[name], a.gauge.get(name)), (*b.trials[name], b.gauge.get(name)), strict=True):
            assert type(mine) is type(other)
            for f in fields(mine) if mine is not None else ():
                if f.name != "seconds":
                    x, y = getattr(mine, f.name), getattr(other, f.name)
                    np.testing.assert_array_equal(np.asarray(x), np.asarray(y), f"{name}: {f.name}", strict=True)


def unlucky(log: Log) -> bool:
    return round(1e6 * float(log.observations[0, 0])) % 2 == 1


class Changed(EKFSLAM):
    """An EKF that goes wrong in the trials whose first measurement is an odd number of micrometres."""

    name = "changed"
    way = "raises"

    def run(self, log: Log, progress: Any = False) -> History:
        history = super().run(log, progress)
        if not unlucky(log):
            return history
        if self.way == "raises":
            raise RuntimeError("out of luck")
        return replace(history, poses=history.poses + (np.nan if self.way == "nan" else 1e3))


class Nan(Changed):
    way = "nan"


class Lost(Changed):
    way = "lost"


def recorded(tmp_path: Path | None = None, truth: Callable[[Truth], Truth | None] = lambda t: t) -> Any:
    log = simulate(world(), np.random.default_rng(5))
    assert log.truth is not None
    log = replace(log, truth=truth(log.truth))
    if tmp_path is None:
        return log
    log.write_csv(tmp_path, observations=("x", "y"))
    return tmp_path
