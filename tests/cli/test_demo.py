"""Laws of `slamkit demo`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import COMPARED, KEYS, is_png, strict_json, succeeds

from slamkit import Log
from slamkit.cli import demo
from slamkit.filters import FILTERS
from slamkit.simulate import WORLDS, standing_world

# ---- demo ----


@pytest.fixture
def short_comparison(monkeypatch: pytest.MonkeyPatch, register: Any) -> None:
    """Two runs of 20 steps in the end of the demo: the full unscented filter takes milliseconds a step."""
    short = replace(standing_world(), controls=np.zeros((20, 2)))
    monkeypatch.setattr(demo, "RUNS", 2)
    register(WORLDS, "standing", lambda: short)


@pytest.mark.usefixtures("short_comparison")
def test_demo(tmp_path: Path) -> None:
    out = tmp_path / "demo"
    text = succeeds("demo", "--out", out)
    got = strict_json(out / "summary.json")
    assert {name: type(value) for name, value in got.items()} == KEYS
    assert got["ate_m"] < 0.1 * got["dead_reckoning_ate_m"]
    for name in ("ate_m", "dead_reckoning_ate_m", "landmark_rmse_m", "heading_rmse_deg", "nis_mean"):
        assert f" {got[name]:.3f} " in text, name
    assert is_png(out / "overview.png") and is_png(out / "correlation.png")
    log = Log.load(out / "log.npz")
    np.testing.assert_array_equal(Log.read_csv(out / "log").observations, log.observations)
    assert len(np.loadtxt(out / "trajectory.txt")) == got["steps"] == len(log)
    succeeds("run", "csv", out / "log", "--json", tmp_path / "again.json")
    again = strict_json(tmp_path / "again.json")
    assert again | {"seconds": 0} == got | {"seconds": 0}
    compared = strict_json(out / "comparison" / "summary.json")
    assert tuple(compared) == tuple(FILTERS)
    rows = {line.split()[1]: line for line in text.splitlines() if line.startswith("│")}
    for name, numbers in compared.items():
        assert set(numbers) >= COMPARED and numbers["runs"] == numbers["finished"] == 2
        for key in ("position_rmse_m", "pose_nees", "gauge_nees", "relative_nees_per_dof"):
            assert f" {numbers[key]:.3f} " in rows[name], (name, key)
    report = (out / "comparison" / "report.md").read_text()
    assert {(len(rows[name]), rows[name][-1]) for name in compared} == {(79, "│")}
    said = next(line for line in text.splitlines() if "claim too little" in line.lower())
    assert said in report
    figures = {p.stem for p in (out / "comparison").glob("*.png") if is_png(p)}
    assert figures == {"overview", "nees", "claims", "coverage", "bars", "cost", "gauge"}


@pytest.mark.usefixtures("short_comparison")
def test_the_demos_comparison_is_the_command_that_it_names(tmp_path: Path) -> None:
    text = succeeds("demo", "--out", tmp_path / "demo")
    command = text[text.index("slamkit compare") :].split(")")[0].split()
    assert "all" in command
    succeeds(*command[1:], "--json", tmp_path / "again.json")
    compared = strict_json(tmp_path / "demo" / "comparison" / "summary.json")
    for name, numbers in strict_json(tmp_path / "again.json").items():
        timed = {"seconds_per_step", "seconds_per_step_se"}
        assert {k: v for k, v in numbers.items() if k not in timed} == {
            k: v for k, v in compared[name].items() if k not in timed
        }
