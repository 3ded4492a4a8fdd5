"""Laws of `slamkit compare`."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from commands import COMPARED, fails, slamkit, strict_json, succeeds

from slamkit import InputError, study
from slamkit.cli.printing import comparison_table
from slamkit.models import EulerUnicycle, RangeBearing, Unicycle
from slamkit.simulate import WORLDS


def test_compare_writes_numbers_report_and_figures(tmp_path: Path) -> None:
    out, numbers, again = tmp_path / "study", tmp_path / "numbers.json", tmp_path / "again.json"
    arguments = [
        "compare",
        "--world",
        "lesson",
        "--filters",
        "ekf,fej,ideal",
        "--runs",
        "2",
        "--seed",
        "3",
        "--jobs",
        "1",
    ]
    assert "fej" in succeeds(*arguments, "--out", out, "--json", numbers)
    got = json.loads(numbers.read_text())
    assert list(got) == ["ekf", "fej", "ideal"]
    assert all(set(row) >= COMPARED for row in got.values())
    assert got["ekf"]["nullity"] == 2
    assert got["fej"]["nullity"] == got["ideal"]["nullity"] == 3
    written = {"report.md", "overview.png", "nees.png", "gauge.png", "trials.csv", "summary.tex"}
    assert written <= {p.name for p in out.iterdir()}
    assert "fej" in (out / "report.md").read_text()
    trials = list(csv.DictReader((out / "trials.csv").open(encoding="utf-8")))
    assert [(row["filter"], row["trial"]) for row in trials] == [(f, k) for f in got for k in "01"]
    assert r"\begin{tabular}" in (out / "summary.tex").read_text() and "fej" in (out / "summary.tex").read_text()
    succeeds(*arguments, "--json", again)
    for name, row in json.loads(again.read_text()).items():
        timed = {"seconds_per_step", "seconds_per_step_se"}
        assert {k: v for k, v in row.items() if k not in timed} == {k: got[name][k] for k in row if k not in timed}


def test_compare_judges_a_log_without_a_truth_by_what_needs_none(tmp_path: Path) -> None:
    log, numbers = tmp_path / "site", tmp_path / "numbers.json"
    succeeds("simulate", "lesson", "--seed", 1, "--out", log)
    (log / "truth.csv").unlink()
    (log / "landmarks.csv").unlink()
    text = succeeds("compare", "--world", log, "--filters", "ekf,ideal", "--jobs", 1, "--json", numbers)
    got = strict_json(numbers)
    assert got["ekf"]["position_rmse_m"] is None and f" {got['ekf']['nis_per_dof']:.3f} " in text
    assert "site: a recorded log" in text and "nan" not in text
    assert "claim to have learnt the gauge, which no measurement observes: ekf" in text
    assert "Failed or diverged: ideal 1 of 1 (InputError: the ideal filter needs the truth" in text


@pytest.mark.parametrize(("anchored", "heading"), [(3, "nullity\n(3)"), (2, "nullity\n(2)"), (None, "nullity")])
def test_the_expected_nullity_is_that_of_the_models(anchored: int | None, heading: str) -> None:
    compared = study.compare(["ekf"], WORLDS["lesson"](), 1, jobs=1, gauge_steps=3)
    checks = {name: replace(check, unobservable=anchored) for name, check in compared.gauge.items()}
    headings = [column.header for column in comparison_table(replace(compared, gauge=checks), "").columns]
    assert [h for h in headings if str(h).startswith("nullity")] == [heading]


def test_an_interrupted_compare_says_how_to_go_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(study, "compare", interrupt)
    done = slamkit("compare", "--world", "lesson", "--out", tmp_path / "out")
    assert done.exit_code == 130
    assert f"{tmp_path / 'out' / 'runs'}, and the same command goes on" in done.stderr


def test_compare_refuses_before_the_first_run_what_it_could_not_write(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(study, "compare", lambda *_, **__: pytest.fail("it has run"))
    assert "is a folder" in fails("compare", "--world", "lesson", "--json", tmp_path)


def test_compare_takes_a_folder_of_csv_files(tmp_path: Path) -> None:
    log, numbers = tmp_path / "log", tmp_path / "numbers.json"
    succeeds("simulate", "lesson", "--seed", 1, "--out", log)
    succeeds("compare", "--world", log, "--filters", "ekf,invariant", "--jobs", 1, "--json", numbers)
    got = json.loads(numbers.read_text())
    assert got["ekf"]["runs"] == 1
    assert got["invariant"]["position_rmse_m"] > 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--world", "moon"], "moon"),
        (["--world", "loop", "--filters", "ekf,magic"], "magic"),
        (["--world", "loop", "--filters", ""], "filter"),
        (["--world", "loop", "--jobs", "0"], "jobs"),
        (["--world", "loop", "--runs", "0"], "runs"),
    ],
)
def test_compare_refuses_in_one_line(arguments: list[str], said: str) -> None:
    assert said in fails("compare", *arguments)


def test_json_on_standard_output_is_all_that_is_there() -> None:
    done = slamkit("compare", "--world", "lesson", "--filters", "ekf,fej", "--runs", 1, "--jobs", 1, "--json", "-")
    assert done.exit_code == 0
    assert list(json.loads(done.stdout)) == ["ekf", "fej"]
    assert "NEES" in done.stderr


def test_a_log_is_compared_with_the_models_gate_and_order_of_the_options(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log, taken = tmp_path / "log", []
    succeeds("simulate", "lesson", "--seed", 1, "--out", log)
    (tmp_path / "mine.json").write_text(json.dumps({"gate": 7, "pose": [1, 2, 3]}))

    def note(*_: Any, **settings: Any) -> None:
        taken.append(settings)
        raise InputError("it has been noted")

    monkeypatch.setattr(study, "compare", note)

    def settings(*options: object) -> dict[str, Any]:
        assert "noted" in fails("compare", "--world", log, "--filters", "ekf", *options)
        return dict(taken[-1])

    world = WORLDS["lesson"]()
    plain = settings()
    assert (plain["motion"], plain["sensor"]) == (world.motion, world.sensor)
    assert plain["options"] == {"order": "sequential", "gate": None}
    given = settings("--motion-noise", "0.3,0.2", "--sensor-noise", "1,2", "--gate", 5, "--order", "batch")
    assert (given["motion"], given["sensor"]) == (Unicycle(0.3, 0.2), RangeBearing(1.0, 2.0))
    assert given["options"] == {"order": "batch", "gate": 5.0}
    assert settings("--motion", "euler")["motion"] == EulerUnicycle(0.1, 0.1)
    file = settings("--models", tmp_path / "mine.json")
    assert (file["options"]["gate"], list(file["pose"])) == (7, [1, 2, 3])
    assert settings("--models", tmp_path / "mine.json", "--gate", 3)["options"]["gate"] == 3
    line = fails("compare", "--world", log, "--sensor", "relative")
    assert "observations.csv has range,bearing" in line and "relative takes x,y" in line
    assert "rates v,omega" in fails("compare", "--world", log, "--motion", "odometry")


def test_a_study_in_which_every_trial_failed_fails_but_is_written(tmp_path: Path) -> None:
    log, out = tmp_path / "log", tmp_path / "study"
    succeeds("simulate", "lesson", "--seed", 1, "--out", log)
    (log / "truth.csv").unlink()
    (log / "landmarks.csv").unlink()
    arguments = ("compare", "--world", log, "--filters", "ideal", "--jobs", 1, "--out", out)
    line = fails(*arguments, code=1)
    assert "every run of every filter failed" in line and "ideal" in line and "needs the truth" in line
    assert strict_json(out / "summary.json")["ideal"]["finished"] == 0
    assert "ideal" in (out / "report.md").read_text()


def test_failures_are_printed_even_where_nothing_else_is(tmp_path: Path) -> None:
    log = tmp_path / "log"
    succeeds("simulate", "lesson", "--seed", 1, "--out", log)
    (log / "truth.csv").unlink()
    (log / "landmarks.csv").unlink()
    done = slamkit("compare", "--world", log, "--filters", "ekf,ideal", "--jobs", 1, "--quiet")
    assert (done.exit_code, done.stdout) == (0, "")
    assert done.stderr.startswith("Failed or diverged: ideal 1 of 1 (")
