"""Laws of wrong use: one line names what was given and what was expected, and nothing is written."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import contents, fails, strict_json, succeeds, write_csv

from slamkit import EKFSLAM
from slamkit.filters import FILTERS
from slamkit.models import (
    MOTIONS,
    SENSORS,
    EulerUnicycle,
    Odometry,
    RangeBearing,
    RelativePosition,
    Unicycle,
    model_to_dict,
)
from slamkit.simulate import WORLDS

# ---- models ----


def test_options_go_before_the_file_and_the_file_before_the_columns(lesson: Path, register: Any) -> None:
    made: list[Any] = []

    class Recording(EKFSLAM):
        def __init__(self, *arguments: Any, **more: Any) -> None:
            super().__init__(*arguments, **more)
            made.append(self)

    register(FILTERS, "ekf", Recording)

    def models(*options: object) -> tuple[Any, Any]:
        succeeds("run", "csv", lesson, *options)
        return made[-1].motion, made[-1].sensor

    world = WORLDS["lesson"]()
    assert models() == (world.motion, world.sensor)
    assert models("--motion", "unicycle") == (world.motion, world.sensor)
    assert models("--motion", "euler") == (EulerUnicycle(0.1, 0.1), world.sensor)
    assert models("--motion-noise", "0.3,0") == (Unicycle(0.3, 0.0), world.sensor)
    assert models("--motion", "euler", "--motion-noise", "0.3, 0.2") == (EulerUnicycle(0.3, 0.2), world.sensor)
    assert models("--sensor-noise", "1,2") == (world.motion, RangeBearing(1.0, 2.0))
    assert (made[-1].order, made[-1].gate) == ("sequential", None)
    models("--order", "batch", "--gate", "5")
    assert (made[-1].order, made[-1].gate) == ("batch", 5.0)
    facts = strict_json(lesson / "models.json")
    (lesson / "models.json").write_text(json.dumps(facts | {"order": "batch", "gate": 7, "pose": [1, 2, 3]}))
    models("--max-steps", 1)
    assert (made[-1].order, made[-1].gate) == ("batch", 7)
    models("--max-steps", 1, "--gate", "inf")
    assert (made[-1].order, made[-1].gate) == ("batch", np.inf)
    assert abs(made[-1].pose[0] - 1) < 0.5
    other = model_to_dict(EulerUnicycle(0.2, 0.4))
    (lesson / "models.json").write_text(json.dumps({"motion": other}))
    assert models() == (EulerUnicycle(0.2, 0.4), RangeBearing(0.1, 0.035))
    assert models("--motion-noise", "0.3,0")[0] == EulerUnicycle(0.3, 0.0)
    (lesson / "models.json").unlink()
    assert models() == (Unicycle(0.1, 0.1), RangeBearing(0.1, 0.035))


@pytest.mark.parametrize(
    ("controls", "observations", "options", "expected"),
    [
        ("t,rot1,trans,rot2\n0,0.1,1,0\n1,0,0,0", "t,id,x,y\n1,a,2,1", (), (Odometry, RelativePosition)),
        ("t,v,omega\n0,1,0\n1,0,0", "t,id,range,bearing\n1,a,2,1", (), (Unicycle, RangeBearing)),
        ("t,u1,u2\n0,1,0\n1,0,0", "t,id,z1,z2\n1,a,2,1", ("--motion", "euler", "--sensor", "relative"),
         (EulerUnicycle, RelativePosition)),
        ("t,d1,d2,d3\n0,1,0,0\n1,0,0,0", "t,id,x,y\n1,a,2,1", ("--motion", "odometry"), (Odometry, RelativePosition)),
    ],
)  # fmt: skip
def test_columns_tell_the_models(
    controls: str, observations: str, options: tuple[str, ...], expected: tuple[type, type], tmp_path: Path
) -> None:
    log = write_csv(tmp_path / "log", controls=controls, observations=observations)
    succeeds("run", "csv", log, *options, "--save", tmp_path / "f.npz")
    f = EKFSLAM.load(tmp_path / "f.npz")
    assert (type(f.motion), type(f.sensor)) == expected


# ---- errors ----


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("fly",), ("fly", "--help")),
        (("run",), ("command",)),
        (("run", "csv"), ("DIR", "run csv --help")),
        (("run", "csv", "nowhere"), ("nowhere/controls.csv",)),
        (("run", "csv", "{lesson}", "--filter", "kalman"), ("kalman", *FILTERS)),
        (("run", "csv", "{lesson}", "--motion", "bicycle"), ("bicycle", *MOTIONS)),
        (("run", "csv", "{lesson}", "--sensor", "sonar"), ("sonar", *SENSORS)),
        (("run", "csv", "{lesson}", "--motion", "odometry"), ("controls.csv", "rates v,omega", "Odometry")),
        (("run", "csv", "{lesson}", "--motion-noise", "0.1"), ("0.1", "unicycle takes 2", "rad/s")),
        (("run", "csv", "{lesson}", "--motion-noise", "a,b"), ("a,b", "unicycle takes 2")),
        (("run", "csv", "{lesson}", "--motion-noise", "0.1,-1"), ("sigma_omega", "-1")),
        (("run", "csv", "{lesson}", "--motion-noise", "nan,1"), ("sigma_v", "nan")),
        (("run", "csv", "{lesson}", "--sensor-noise", "0,1"), ("sigma_range", "0")),
        (("run", "csv", "{lesson}", "--sensor-noise", ""), ("range-bearing takes 2",)),
        (("run", "csv", "{lesson}", "--sensor", "relative", "--sensor-noise", "1,2"), ("relative takes 1",)),
        (("run", "csv", "{lesson}", "--gate", "-1"), ("gate", "-1")),
        (("run", "csv", "{lesson}", "--gate", "nan"), ("gate", "nan")),
        (("run", "csv", "{lesson}", "--gate", "wide"), ("--gate", "number")),
        (("run", "csv", "{lesson}", "--order", "random"), ("order", "random", "batch")),
        (("run", "csv", "{lesson}", "--max-steps", "0"), ("--max-steps", "1")),
        (("run", "csv", "{lesson}", "--json", "{lesson}"), ("lesson", "folder")),
        (("run", "csv", "{lesson}", "--json", "{file}/run.json"), ("file",)),
        (("run", "csv", "{lesson}", "--plot", "{file}/run.png"), ("file",)),
        (("run", "csv", "{lesson}", "--save", "{file}/f.npz"), ("file",)),
        (("run", "csv", "{lesson}", "--out", "{file}"), ("file",)),
        (("run", "csv", "{lesson}", "--plot", "run.docx"), ("run.docx", ".png")),
        (("run", "mrclam", "nowhere.zip", "--robot", "1"), ("nowhere.zip",)),
        (("run", "mrclam", "{lesson}"), ("--robot",)),
        (("run", "mrclam", "{lesson}", "--robot", "1"), ("Barcodes.dat",)),
        (("run", "mrclam", "{lesson}", "--robot", "9"), ("robot", "9")),
        (("run", "mrclam", "{lesson}", "--robot", "1", "--filter", "x"), ("x", *FILTERS)),
        (("simulate", "mars", "--out", "{lesson}/new"), ("mars", *WORLDS)),
        (("simulate", "loop"), ("--out",)),
        (("simulate", "lesson", "--out", "{file}"), ("file",)),
        (("simulate", "lesson", "--out", "{file}/log"), ("file",)),
        (("simulate", "lesson", "--seed", "-1", "--out", "{lesson}/new"), ("--seed", "0")),
        (("demo", "--out", "{file}"), ("file",)),
        (("fetch", "mrclam", "10"), ("10", "1 to 9")),
        (("fetch", "venus", "1"), ("venus", "mrclam")),
        (("fetch", "mrclam", "one"), ("N", "integer")),
        (("fetch", "mrclam", "1", "--base-url", "nonsense"), ("nonsense", "http")),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_one_line(
    arguments: tuple[str, ...], words: tuple[str, ...], lesson: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "file"
    file.write_text("as it was")
    monkeypatch.chdir(tmp_path)
    before = contents(tmp_path)
    line = fails(*(a.format(lesson=lesson, file=file) for a in arguments))
    for word in words:
        assert word in line, line
    assert contents(tmp_path) == before


@pytest.mark.parametrize(
    ("name", "line", "text"),
    [
        ("controls.csv", 3, "0.2,0.5"),
        ("observations.csv", 5, "0.4,1,two,0.1"),
        ("truth.csv", 2, "0.0,0,0,nan"),
        ("landmarks.csv", 3, "0,1,1"),
    ],
)
def test_a_garbled_row_is_named_by_file_and_line(name: str, line: int, text: str, lesson: Path) -> None:
    rows = (lesson / name).read_text().splitlines()
    rows[line - 1] = text
    (lesson / name).write_text("\n".join(rows))
    assert f"{lesson / name}:{line}: " in fails("run", "csv", lesson)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", ("not JSON",)),
        ("[1, 2]", ("object", "pose_covariance")),
        ('{"motoin": null}', ("motoin", "motion")),
        ('{"motion": {"name": "Rocket"}}', ("motion", "Rocket", "Unicycle")),
        ('{"motion": {"name": "Unicycle", "sigma_v": -1, "sigma_omega": 0}}', ("motion", "sigma_v", "-1")),
        ('{"motion": {"name": "RangeBearing", "sigma_range": 1, "sigma_bearing": 1}}', ("no motion model",)),
        ('{"sensor": {"name": "RelativePosition"}}', ("sensor", "RelativePosition")),
        ('{"sensor": 3}', ("sensor", "3")),
        ('{"pose": [1, 2]}', ("pose", "(3,)")),
        ('{"pose": "here"}', ("pose",)),
        ('{"pose_covariance": [[1, 0, 0], [0, -1, 0], [0, 0, 1]]}', ("pose_covariance", "-1")),
        ('{"order": "random"}', ("order", "random")),
        ('{"gate": "wide"}', ("gate", "wide")),
        ('{"gate": 0}', ("gate", "0")),
    ],
)
def test_a_broken_models_file_is_named(text: str, words: tuple[str, ...], lesson: Path) -> None:
    (lesson / "models.json").write_text(text)
    line = fails("run", "csv", lesson)
    for word in (str(lesson / "models.json"), *words):
        assert word in line


def test_unknown_columns_ask_for_a_model(tmp_path: Path) -> None:
    log = write_csv(tmp_path, controls="t,u1,u2\n0,1,0\n1,0,0\n", observations="t,id,z1,z2\n1,a,2,1\n")
    assert "u1,u2" in (line := fails("run", "csv", log)) and "--motion unicycle|euler|odometry" in line
    assert "z1,z2" in (line := fails("run", "csv", log, "--motion", "euler")) and "--sensor range-bearing" in line


@pytest.mark.parametrize(
    ("sensor", "columns", "takes"), [("relative", "range,bearing", "x,y"), ("range-bearing", "x,y", "range,bearing")]
)
def test_a_sensor_is_refused_on_the_columns_of_another(sensor: str, columns: str, takes: str, tmp_path: Path) -> None:
    log = write_csv(tmp_path, controls="t,v,omega\n0,1,0\n1,0,0\n", observations=f"t,id,{columns}\n1,a,2,1\n")
    named = fails("run", "csv", log, "--sensor", sensor)
    model = {"relative": RelativePosition(0.1), "range-bearing": RangeBearing(0.1, 0.1)}[sensor]
    (log / "models.json").write_text(json.dumps({"sensor": model_to_dict(model)}))
    for line in (named, fails("run", "csv", log)):
        assert f"{log / 'observations.csv'} has {columns}, but the sensor model {sensor} takes {takes}" in line


@pytest.mark.parametrize("delimiter", [";", "\t", " "])
@pytest.mark.parametrize("name", ["controls", "observations"])
def test_a_wrong_delimiter_is_named(name: str, delimiter: str, lesson: Path) -> None:
    path = lesson / f"{name}.csv"
    path.write_text(path.read_text().replace(",", delimiter))
    line = fails("run", "csv", lesson)
    word = repr(delimiter)
    assert f"{path}:1: " in line and f"is the delimiter {word}? expected ','" in line, line


@pytest.mark.parametrize(
    ("text", "words"),
    [('{"gate": true}', ("gate", "True")), ("[" * 100_000, ("not JSON",)), ('{"sensor": []}', ("[]",))],
)
def test_a_models_file_holds_nothing_else(text: str, words: tuple[str, ...], lesson: Path) -> None:
    (lesson / "mine.json").write_text(text)
    line = fails("run", "csv", lesson, "--models", lesson / "mine.json")
    for word in (str(lesson / "mine.json"), *words):
        assert word in line
    assert "missing.json" in fails("run", "csv", lesson, "--models", lesson / "missing.json")
