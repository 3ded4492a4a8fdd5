"""Laws of a run that ends before its log: what was done is kept, and one line says why it ended."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import contents, fails, is_png, slamkit, strict_json, succeeds

from slamkit import EKFSLAM, History, Log, plots
from slamkit.evaluate import run_report
from slamkit.filters import FILTERS


def break_at(folder: Path, row: int) -> None:
    """Make one sighting's range negative: the log can be read, but not be run beyond there."""
    path = folder / "observations.csv"
    rows = path.read_text().splitlines()
    t, i, _, b = rows[row].split(",")
    rows[row] = f"{t},{i},-1.0,{b}"
    path.write_text("\n".join(rows))


# ---- a run that ends before its log ----


def test_a_run_that_fails_midway_leaves_what_it_did(lesson: Path, tmp_path: Path) -> None:
    succeeds("run", "csv", lesson, "--out", tmp_path / "whole")
    succeeds("run", "csv", lesson, "--max-steps", 9, "--json", tmp_path / "nine.json")
    break_at(lesson, 30)  # the 30th sighting: of three a step, in the tenth step
    outputs = ("--out", tmp_path / "out", "--json", tmp_path / "run.json", "--save", tmp_path / "f.npz")
    line = fails("run", "csv", lesson, *outputs, code=1)
    assert "range is -1.0" in line
    assert f"first 9 of 15 steps are in {tmp_path / 'out'}" in line
    whole, part = (History.load(tmp_path / name / "history.npz") for name in ("whole", "out"))
    np.testing.assert_array_equal(part.poses, whole.poses[:9])
    assert contents(tmp_path / "out").keys() == contents(tmp_path / "whole").keys()
    got = strict_json(tmp_path / "out" / "summary.json")
    assert (got["steps"], got["observations"]) == (9, 27)
    assert got | {"seconds": 0} == strict_json(tmp_path / "nine.json") | {"seconds": 0}
    assert is_png(tmp_path / "out" / "overview.png")
    assert not (tmp_path / "run.json").exists() and not (tmp_path / "f.npz").exists()


def test_a_run_that_fails_at_once_leaves_nothing_but_files_that_say_so(lesson: Path, tmp_path: Path) -> None:
    break_at(lesson, 1)
    assert "first 0 of 15 steps" in fails("run", "csv", lesson, "--out", tmp_path / "out", code=1)
    got = strict_json(tmp_path / "out" / "summary.json")
    assert (got["steps"], got["observations"], got["landmarks"], got["ate_m"]) == (0, 0, 0, None)
    assert "steps" not in fails("run", "csv", lesson, code=1)


@pytest.mark.usefixtures("no_figures")
@pytest.mark.parametrize("with_out", [True, False])
def test_ctrl_c_keeps_what_was_done(with_out: bool, lesson: Path, tmp_path: Path, register: Any) -> None:
    class Interrupted(EKFSLAM):
        def run(self, log: Log, progress: Any = False) -> History:
            history = super().run(log.head(6))
            if len(log) == 1:  # what is run to load the compiled code
                return history
            stop = KeyboardInterrupt()
            stop.history = history  # type: ignore[attr-defined]
            raise stop

    register(FILTERS, "ekf", Interrupted)
    done = slamkit("run", "csv", lesson, *(("--out", tmp_path / "out") if with_out else ()))
    assert done.exit_code == 130
    assert "Traceback" not in done.output
    if with_out:
        assert done.stderr == f"interrupted; its first 6 of 15 steps are in {tmp_path / 'out'}\n"
        assert strict_json(tmp_path / "out" / "summary.json")["steps"] == 6
    else:
        assert done.output == ""


def test_a_file_is_replaced_by_a_whole_one_or_not_at_all(
    lesson: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    succeeds("run", "csv", lesson, "--out", out)
    before = contents(out)

    def torn(figure: Any, path: Path, dpi: float) -> None:
        path.write_bytes(b"half of it")
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(plots, "save", torn)
    assert "No space left" in fails("run", "csv", lesson, "--out", out, code=1)
    after = contents(out)
    assert after.keys() == before.keys()
    assert after["overview.png"] == before["overview.png"]
    with pytest.raises(ValueError, match="JSON compliant"):
        run_report.write_json(out / "map.csv", {"a": 1.0, "b": np.nan})
    assert contents(out) == after


def test_an_error_that_slamkit_did_not_foresee_is_one_line_too(
    lesson: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, register: Any
) -> None:
    class Wrong(EKFSLAM):
        def run(self, log: Log, progress: Any = False) -> History:
            raise KeyError("heading")

    register(FILTERS, "ekf", Wrong)
    line = fails("run", "csv", lesson, "--out", tmp_path / "out", code=1)
    assert "KeyError: 'heading'" in line
    monkeypatch.setenv("SLAMKIT_TRACEBACK", "1")
    assert "in run" in slamkit("run", "csv", lesson).stderr


def test_the_reader_of_standard_output_may_leave() -> None:
    code = "from slamkit.cli import main; import sys; sys.argv = ['slamkit', 'run', 'csv', '--help']; main()"
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None and process.stderr is not None
        process.stdout.close()
        said = process.stderr.read()
        assert process.wait() == 1
    assert b"Traceback" not in said and b"Broken" not in said
