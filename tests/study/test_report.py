"""A study as text."""

from __future__ import annotations

import csv
import io
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_study import NAMES, small, world

from slamkit import EKFSLAM, History, InputError, Log
from slamkit.models import Unicycle
from slamkit.study import Study


def test_table_frame_and_report_hold_every_filter(study: Study, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = study.table()
    assert [(r["filter"], r["trial"]) for r in rows] == [(n, k) for n in NAMES for k in range(4)]
    for name, s in study.summary().items():
        mean = np.mean([r["pose_nees"] for r in rows if r["filter"] == name])
        np.testing.assert_allclose(mean, s["pose_nees"], rtol=1e-12)
    report = study.report()
    for name, s in study.summary().items():
        assert report.count(f"| {name} |") == 2 and f"{s['position_rmse_m']:.3f}" in report
    assert "4 runs of 30 steps" in report and "Failed" not in report
    pandas = pytest.importorskip("pandas")
    pandas.testing.assert_frame_equal(study.frame(), pandas.DataFrame(rows))
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match=r"slamkit\[pandas\]"):
        study.frame()


def test_csv_holds_the_table(troubled: Study, tmp_path: Path) -> None:
    text = troubled.to_csv(tmp_path / "trials.csv")
    assert (tmp_path / "trials.csv").read_text() == text
    read, rows = list(csv.DictReader(io.StringIO(text))), troubled.table()
    assert len(read) == len(rows) == 32
    for line, row in zip(read, rows, strict=True):
        assert list(line) == list(row)
        for name, value in row.items():
            if isinstance(value, float):
                assert line[name] == ("" if np.isnan(value) else repr(value))
            else:
                assert line[name] == ("" if value is None else str(value))


def test_latex_holds_every_filter_and_escapes_its_name(study: Study, tmp_path: Path) -> None:
    own = small(filters={"my_ekf 50%": EKFSLAM}, runs=2, gauge_steps=0)
    text = own.to_latex(tmp_path / "table.tex")
    assert (tmp_path / "table.tex").read_text() == text
    assert r"my\_ekf 50\% &" in text and r"heading RMSE [$^\circ$]" in text
    for table, rows in ((text, 1), (study.to_latex(), 3)):
        lines = [line for line in table.splitlines() if "&" in line]
        assert len(lines) == 1 + rows and {line.count("&") for line in lines} == {6}
        assert all(line.endswith(r"\\") for line in lines)
    assert f"{study.summary()['ekf']['position_rmse_m']:.3f} $\\pm$" in study.to_latex()


def test_tables_need_no_pandas(study: Study, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    assert study.to_csv() and study.to_latex() and study._repr_html_()


def test_a_study_shows_itself_shortly(study: Study, troubled: Study) -> None:
    assert repr(study) == "<Study of small: 4 runs of 30 steps: ekf, invariant, ideal>"
    assert "trials failed or diverged" in repr(troubled)
    page = study._repr_html_()
    assert page.count("<tr>") == 4 and f"{study.summary()['ekf']['position_rmse_m']:.3f}" in page
    hostile = replace(study, facts={**study.facts, "world": "<b>&"})
    assert "<b>" not in hostile._repr_html_()
    assert all(len(repr(thing)) < 600 for thing in (*study.trials["ekf"], *study.gauge.values()))


def test_no_matrix_stands_in_a_cell(study: Study) -> None:
    P = np.arange(900.0).reshape(30, 30)
    error = f"DivergenceError: P is not positive definite:\n{P}\nand x = {P[0]!r} at 3 s"
    trials = {n: tuple(replace(t, error=error, diverged=True) for t in study.trials[n]) for n in ("ekf", "ideal")}
    noted = replace(study.trials["invariant"][0], note=f"split is left out: {P!r}")
    checks = {"ekf": replace(study.gauge["ekf"], error=f"nullity: {P.tolist()}")}
    told = replace(study, trials={**trials, "invariant": (noted,) * 4}, gauge=checks)
    report = told.report()
    assert report.count("not positive definite: [matrix] and x = [values] at 3 s") == 0 + 8
    assert "split is left out: [matrix]" in report and "nullity: [matrix]" in report
    assert all(len(cell) < 220 for line in report.splitlines() if line.startswith("|") for cell in line.split("|"))
    assert max(len(line) for line in replace(told, trials=trials).report().splitlines()) < 500
    assert told.table()[0]["error"] == error


def test_only_what_is_left_out_is_listed_as_left_out(study: Study) -> None:
    """A NEES that contradicts P at one step of thirty is said to lack that step, and not to be missing."""
    assert "left out" not in study.report()

    class Certain(EKFSLAM):
        def run(self, log: Log, progress: Any = False) -> History:
            history = super().run(log, progress)
            P = history.pose_covariances.copy()
            if len(P) > 7:
                P[7] = np.diag([1.0, 0.0, 1.0])
            return replace(history, pose_covariances=P)

    certain = small(filters={"certain": Certain}, runs=1, gauge_steps=0)
    [trial] = certain.trials["certain"]
    assert np.isfinite(trial.mean_nees).all()
    note = trial.note or ""
    assert note.startswith("pose NEES leaves out 1 of 30 steps: ") and "position NEES leaves out 1 of 30 steps" in note
    report = certain.report()
    assert "Missing" not in report and "## Numbers that are left out" in report and "1 of 30 steps" in report


@pytest.mark.parametrize(
    ("unobservable", "said"),
    [
        (3, "all three directions are unobservable"),
        (2, "two of the gauge's"),
        (1, "one of the gauge's"),
        (0, "none of the gauge's"),
        (None, ""),
    ],
)
def test_the_report_speaks_of_the_directions_that_are_unobservable(
    study: Study, unobservable: int | None, said: str
) -> None:
    checks = {n: replace(c, unobservable=unobservable) for n, c in study.gauge.items()}
    report = replace(study, gauge=checks).report()
    assert said in report
    assert ("all three" in report) == (unobservable == 3) and ("anchor" in report) == (unobservable in (0, 1, 2))


def test_the_report_says_where_the_start_fixes_the_gauge() -> None:
    known = replace(world(6), motion=Unicycle(0.0, 0.0), pose_covariance=np.zeros((3, 3)))
    report = small(filters=["invariant"], world=known, runs=2).report()
    assert "The start fixes the gauge in part: at the end of the runs it has 0 degrees of freedom" in report
