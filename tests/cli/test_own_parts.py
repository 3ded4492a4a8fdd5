"""Laws of filters, models, worlds and data sets of a user's own, named ``module:name`` on the command line."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from commands import fails, strict_json, succeeds

from slamkit import EKFSLAM

MODULE = """
from dataclasses import dataclass, replace
from slamkit import EKFSLAM, Log
from slamkit.datasets import DataSet, Option, Recording
from slamkit.models import RangeBearing, Unicycle
from slamkit.simulate import lesson_world

class MyEKF(EKFSLAM):
    pass

class Renamed(EKFSLAM):
    name = "renamed"

class Clashing(EKFSLAM):
    name = "fej"

class Slippery(Unicycle):
    pass

class Laser(RangeBearing):
    columns = ("range", "bearing")

class NeedsMore:
    def __init__(self, a, b, c): ...
    move = jacobians = control_noise = pose_noise = lambda self, *_: None

def yard():
    return replace(lesson_world(), name="yard")

def field(size):
    return lesson_world()

HALL = yard()
seven = 7

def read(path, which):
    world = yard()
    return Recording(Log.read_csv(path), f"hall {which}", world.motion, world.sensor, notes=("Nothing was left out",))

WHICH = Option("which", str, "Which.", choices=("a", "b"))
SET = DataSet("hall", "A hall.", "nobody", "DIR", "The folder.", read, (WHICH,))
"""


@pytest.fixture(autouse=True)
def _mine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    (tmp_path / "my_parts.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    yield
    sys.modules.pop("my_parts", None)


@pytest.mark.parametrize(("named", "shown"), [("MyEKF", "MyEKF"), ("Renamed", "renamed"), ("Clashing", "Clashing")])
def test_a_filter_runs_under_its_name_or_that_of_its_class(
    named: str, shown: str, lesson: Path, tmp_path: Path
) -> None:
    text = succeeds(
        "run", "csv", lesson, "--filter", f"my_parts:{named}", "--json", "run.json", "--out", "out", "--plot", "o.pdf"
    )
    succeeds("run", "csv", lesson, "--json", "ekf.json")
    mine, ekf = strict_json(tmp_path / "run.json"), strict_json(tmp_path / "ekf.json")
    assert mine == ekf | {"filter": shown, "seconds": mine["seconds"]}
    assert f" {shown} " in text
    assert EKFSLAM.name == "ekf"


def test_filters_are_compared_with_those_of_ones_own(tmp_path: Path) -> None:
    filters = "ekf,my_parts:MyEKF,my_parts:Renamed"
    text = succeeds(
        "compare", "--world", "lesson", "--filters", filters, "--runs", 2, "--jobs", 1, "--json", "c.json", "--out", "c"
    )
    got = strict_json(tmp_path / "c.json")
    assert list(got) == ["ekf", "MyEKF", "renamed"]
    assert got["MyEKF"]["pose_nees"] == got["ekf"]["pose_nees"] and got["MyEKF"]["finished"] == 2
    report = (tmp_path / "c" / "report.md").read_text()
    assert all(f" {name} " in text and name in report for name in got)
    assert "twice" in fails("compare", "--world", "lesson", "--filters", "my_parts:MyEKF,my_parts:MyEKF")


def test_models_of_ones_own_take_the_noise_of_the_options(lesson: Path, tmp_path: Path) -> None:
    def run(*options: str) -> float:
        text = succeeds("run", "csv", lesson, *options, "--json", "run.json")
        assert "Models: --motion " in text
        return float(strict_json(tmp_path / "run.json")["nis_mean"])

    noise = ("--motion-noise", "0.2,0.3", "--sensor-noise", "0.3,0.1")
    own = ("--motion", "my_parts:Slippery", "--sensor", "my_parts:Laser")
    assert run(*own, *noise) == run(*noise, "--motion", "unicycle")
    assert "--motion my_parts:Slippery" in succeeds("run", "csv", lesson, *own)


@pytest.mark.parametrize("name", ["yard", "HALL"])
def test_a_world_of_ones_own_is_simulated_and_compared(name: str, tmp_path: Path) -> None:
    succeeds("simulate", f"my_parts:{name}", "--seed", 1, "--out", "own")
    succeeds("simulate", "lesson", "--seed", 1, "--out", "lesson")
    for file in ("controls.csv", "observations.csv", "models.json"):
        assert (tmp_path / "own" / file).read_bytes() == (tmp_path / "lesson" / file).read_bytes()
    text = succeeds("compare", "--world", f"my_parts:{name}", "--filters", "ekf", "--runs", 1, "--jobs", 1)
    assert "yard: 1 run" in text


def test_a_data_set_of_ones_own_is_run(lesson: Path, tmp_path: Path) -> None:
    text = succeeds("run", "my_parts:SET", lesson, "--which", "a", "--json", "run.json")
    assert "hall a" in text and "Nothing was left out" in text
    assert strict_json(tmp_path / "run.json")["steps"] == 15
    assert "which is 'c', expected one of a, b" in fails("run", "my_parts:SET", lesson, "--which", "c")
    assert "Example: slamkit run my_parts:SET PATH --which a" in succeeds("run", "my_parts:SET", "--help")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("run", "csv", "{log}", "--filter", "nowhere:X"), ("nowhere",)),
        (("run", "csv", "{log}", "--filter", "my_parts:None_"), ("None_",)),
        (("run", "csv", "{log}", "--filter", "my_parts:yard"), ("filter", "yard")),
        (("run", "csv", "{log}", "--motion", "my_parts:HALL"), ("motion model", "World")),
        (("run", "csv", "{log}", "--motion", "my_parts:NeedsMore"), ("NeedsMore", "no --motion-noise", "missing")),
        (("run", "csv", "{log}", "--motion", "my_parts:NeedsMore", "--motion-noise", "1,x"), ("1,x",)),
        (("run", "csv", "{log}", "--sensor", "my_parts:MyEKF"), ("sensor model", "MyEKF")),
        (("run", "my_parts:seven", "{log}"), ("7", "DataSet")),
        (("simulate", "my_parts:seven", "--out", "x"), ("world", "7")),
        (("simulate", "my_parts:field", "--out", "x"), ("field", "size")),
        (("simulate", "my_parts:MyEKF", "--out", "x"), ("MyEKF", "motion")),
        (("compare", "--world", "my_parts:none"), ("none",)),
    ],
)  # fmt: skip
def test_what_is_none_of_its_kind_is_refused_in_one_line(
    arguments: tuple[str, ...], words: tuple[str, ...], lesson: Path
) -> None:
    line = fails(*(a.format(log=lesson) for a in arguments))
    for word in words:
        assert word in line, line
