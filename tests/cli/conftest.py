"""Logs and settings that the tests of the command line share."""

from __future__ import annotations

from pathlib import Path

import pytest
from commands import succeeds

from slamkit.evaluate import run_report


@pytest.fixture(scope="session")
def loop(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The loop world as CSV files; tests read it only."""
    folder = tmp_path_factory.mktemp("logs") / "loop"
    succeeds("simulate", "loop", "--seed", 5, "--out", folder)
    return folder


@pytest.fixture
def lesson(tmp_path: Path) -> Path:
    """A short log that a test may change."""
    succeeds("simulate", "lesson", "--seed", 1, "--out", tmp_path / "lesson")
    return tmp_path / "lesson"


@pytest.fixture
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """For tests that look at other files: drawing is most of what a short run costs."""
    monkeypatch.setattr(run_report, "write_figure", lambda *_: None)


@pytest.fixture(autouse=True)
def _a_terminal_that_shows_everything(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tables are drawn with lines, whatever terminal runs the tests."""
    for name in ("LC_ALL", "LANG", "LC_CTYPE", "COLUMNS"):
        monkeypatch.delenv(name, raising=False)
