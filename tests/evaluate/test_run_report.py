"""Laws of the report on a run: its numbers, and the files of its folder."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from slamkit import EKFSLAM, InputError, Log, Truth, simulate
from slamkit.evaluate import Assessment, assess, run_report, summarise, write_json, write_run
from slamkit.simulate import loop_world

NAMES = {"summary.json", "trajectory.txt", "trajectory.csv", "map.csv", "history.npz", "overview.png"}


@pytest.fixture(scope="module")
def run() -> tuple[Assessment, Log]:
    world = loop_world()
    log = simulate(world, np.random.default_rng(0))
    history = EKFSLAM(world.motion, world.sensor, world.pose, world.pose_covariance).run(log)
    return assess(history, log, world.motion, world.pose), log


def contents(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in folder.iterdir()}


def with_truth(log: Log, truth: Truth) -> Any:
    return replace(log, truth=truth)


def test_the_count_of_matched_poses_is_beside_the_error(run: tuple[Assessment, Log]) -> None:
    assessment, log = run
    truth, motion = log.truth, loop_world().motion
    assert truth is not None
    assert assessment.summary["matched"] == len(assessment.history.times)
    for n in (0, 1, 2):
        few = Truth(truth.times[5 : 5 + n], truth.poses[5 : 5 + n])
        got = summarise(assessment.history, with_truth(log, few), motion)
        assert (got["matched"], got["ate_m"], got["dead_reckoning_ate_m"], got["heading_rmse_deg"]) == (
            n,
            None,
            None,
            None,
        )


def test_a_map_is_scored_where_only_landmarks_have_a_truth(run: tuple[Assessment, Log]) -> None:
    assessment, log = run
    assert log.truth is not None
    got = summarise(
        assessment.history,
        with_truth(log, Truth(np.empty(0), np.empty((0, 3)), log.truth.landmarks)),
        loop_world().motion,
    )
    assert got["matched"] == 0 and got["ate_m"] is None
    assert got["landmark_rmse_m"] is not None and 0 < got["landmark_rmse_m"] < 0.5


@pytest.mark.parametrize("value", [np.nan, float("inf"), [1.0, np.nan], np.zeros(2), 1j])
def test_what_json_does_not_have_is_refused_by_its_name(value: Any, tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", {"a": 1.0})
    with pytest.raises(InputError, match="speed cannot be written as JSON"):
        write_json(tmp_path / "a.json", {"a": 2.0, "speed": value})
    assert json.loads((tmp_path / "a.json").read_text()) == {"a": 1.0}
    assert contents(tmp_path).keys() == {"a.json"}


def test_a_folder_gets_all_files_and_keeps_those_of_others(run: tuple[Assessment, Log], tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    for _ in range(2):
        write_run(tmp_path, *run)
        assert contents(tmp_path).keys() == NAMES | {"notes.txt"}


@pytest.mark.parametrize("broken", ["write_json", "write_figure", "write_files"])
def test_a_run_that_cannot_be_written_changes_no_file(
    broken: str, run: tuple[Assessment, Log], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    old, new = tmp_path / "old", tmp_path / "new"
    old.mkdir()
    for name in (NAMES - {"map.csv"}) | {"notes.txt"}:
        (old / name).write_text(f"old {name}")
    before = contents(old)

    def fail(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(run_report, broken, fail)
    for folder in (old, new):
        with pytest.raises(OSError, match="No space left"):
            write_run(folder, *run)
    assert contents(old) == before
    assert not new.exists()
