"""A fuzz that ends badly says how, and what it was about to do."""

from __future__ import annotations

from pathlib import Path

import child
import pytest


@pytest.mark.parametrize(
    ("ending", "message"),
    [
        ("os.kill(os.getpid(), signal.SIGSEGV)", "ended by SIGSEGV; seed 7"),
        ("raise ValueError('a finding')", "returned 1; seed 7"),
        ("time.sleep(60)", "did not end; seed 7"),
    ],
)
def test_a_bad_end_is_a_finding(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: str, message: str) -> None:
    lines = [
        "import os, signal, time",
        "from child import Trace, arguments",
        "given = arguments()",
        "trace = Trace(open(given.folder / 'trace', 'w'))",
        "trace.begin('a filter')",
        "trace.operation('the last one')",
        ending,
    ]
    (tmp_path / "bad.py").write_text("\n".join(lines))
    monkeypatch.setattr(child, "FOLDER", tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent))
    monkeypatch.setattr(child, "ROOT", Path(__file__).parent)
    with pytest.raises(AssertionError, match=message) as found:
        child.run_child("bad.py", 3, 7, tmp_path, timeout=3)
    assert "a filter\n1: the last one" in str(found.value)
