"""How the tests of the command line run a command and look at what it wrote."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from typer.testing import CliRunner, Result

from slamkit.cli import app

KEYS = {
    "filter": str,
    "steps": int,
    "observations": int,
    "rejected": int,
    "landmarks": int,
    "ate_m": float,
    "dead_reckoning_ate_m": float,
    "landmark_rmse_m": float,
    "heading_rmse_deg": float,
    "matched": int,
    "nis_mean": float,
    "nis_dof_mean": float,
    "seconds": float,
}


COMPARED = {
    "pose_nees", "pose_nees_median", "pose_nees_above_6", "position_rmse_m", "heading_rmse_deg", "landmark_nees",
    "landmark_rmse_m", "relative_nees_per_dof", "nullity", "gauge_deviation_drop", "stochastic_gauge_m", "equivariance",
    "seconds_per_step", "diverged", "runs", "pose_nees_low", "pose_nees_high",
}  # fmt: skip


def slamkit(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(a) for a in arguments], prog_name="slamkit")


def succeeds(*arguments: object) -> str:
    """Standard output of a command that succeeds; nothing is on stderr, which is no terminal here."""
    done = slamkit(*arguments)
    assert done.exit_code == 0, done.output
    assert done.stderr == ""
    return done.stdout


def fails(*arguments: object, code: int = 2) -> str:
    """The one line on stderr of a command that fails: 2 for wrong use, 1 for a run that failed."""
    done = slamkit(*arguments)
    assert done.exit_code == code, done.output
    assert isinstance(done.exception, SystemExit)
    assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert line.startswith("error: ")
    return line


def strict_json(path: Path) -> dict[str, Any]:
    """What a JSON file holds; NaN and Infinity are no JSON."""

    def refuse(constant: str) -> None:
        raise AssertionError(f"{path} holds {constant}")

    facts = json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)
    assert isinstance(facts, dict)
    return facts


def contents(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def is_png(path: Path) -> bool:
    data = path.read_bytes()
    return data.startswith(b"\x89PNG\r\n\x1a\n") and data.endswith(b"IEND\xaeB`\x82")


def write_csv(folder: Path, **files: str) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / f"{name}.csv").write_text(text)
    return folder
