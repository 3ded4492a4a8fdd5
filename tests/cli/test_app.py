"""Laws of the command itself: how it starts, helps, is interrupted."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from commands import succeeds

from slamkit.cli.streams import adapt_streams
from slamkit.filters import FILTERS
from slamkit.models import (
    MOTIONS,
    SENSORS,
    parameters_of,
)
from slamkit.simulate import WORLDS

# ---- a process of its own ----


def test_console_script_starts_quickly_and_without_heavy_imports() -> None:
    code = (
        "import sys; from slamkit.cli import main\n"
        "heavy = {'matplotlib', 'numba', 'pandas', 'pooch', 'dask', 'joblib'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
        "sys.argv = ['slamkit', 'run', 'csv', 'nowhere']; main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert line.startswith("error: nowhere/controls.csv")


@pytest.mark.skipif(sys.platform == "win32", reason="signals as on POSIX")
def test_ctrl_c_of_a_process_exits_with_130() -> None:
    code = (
        "import os, signal; from slamkit.cli import main, simulate\n"
        # A shell's background job ignores the signal, and so would its children.
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "def interrupt(*a, **k): os.kill(os.getpid(), signal.SIGINT); __import__('time').sleep(20)\n"
        "simulate.simulate = interrupt\n"
        "import sys; sys.argv = ['slamkit', 'simulate', 'loop', '--out', 'never-written']; main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 128 + signal.SIGINT
    assert "Traceback" not in done.stderr
    assert not Path("never-written").exists()


# ---- help ----


@pytest.mark.parametrize(
    "command", [(), ("demo",), ("run",), ("run", "mrclam"), ("run", "csv"), ("simulate",), ("fetch",), ("compare",)]
)
def test_every_help_has_an_example_that_begins_with_the_command(command: tuple[str, ...]) -> None:
    text = " ".join(succeeds(*command, "--help").split())
    assert f"Example: {' '.join(('slamkit', *command))}" in text


def test_help_names_every_filter_model_and_world() -> None:
    text = succeeds("run", "csv", "--help")
    for name in (*FILTERS, *MOTIONS, *SENSORS):
        assert name in text
    assert all(name in succeeds("simulate", "--help") for name in WORLDS)
    for kind in (*MOTIONS.values(), *SENSORS.values()):
        assert ",".join(f"{x:g}" for _, x in parameters_of(kind).values()) in text.replace(" ", "")


def test_version() -> None:
    import slamkit as package

    assert succeeds("--version") == f"slamkit {package.__version__}\n"


def test_the_command_alone_shows_its_help() -> None:
    assert succeeds().strip() == succeeds("--help").strip() != ""


def test_help_says_what_the_exit_codes_mean() -> None:
    text = " ".join(succeeds("--help").split())
    assert "Exit codes: 0 success; 1 the run failed" in text and "; 2 an option or a file" in text


# ---- terminals ----


def in_a_process(*arguments: object, **environment: str) -> subprocess.CompletedProcess[bytes]:
    command = [sys.executable, "-m", "slamkit.cli", *map(str, arguments)]
    clean = {n: v for n, v in os.environ.items() if n not in ("LANG", "LC_ALL", "LC_CTYPE", "PYTHONIOENCODING")}
    return subprocess.run(command, capture_output=True, check=False, env=clean | environment)


@pytest.mark.parametrize(
    "environment", [{"PYTHONIOENCODING": "ascii"}, {"LANG": "C"}, {"LC_ALL": "POSIX"}], ids=lambda e: "".join(e)
)
def test_an_ascii_terminal_gets_ascii_tables_help_and_errors(environment: dict[str, str], lesson: Path) -> None:
    table = in_a_process("run", "csv", lesson, **environment)
    assert table.returncode == 0, table.stderr
    rows = table.stdout.decode("ascii").splitlines()
    assert any(row.startswith("| time a step [us] ") for row in rows)
    assert len({len(row) for row in rows if row.startswith(("|", "+"))}) == 1
    help_ = in_a_process("run", "csv", "--help", **environment).stdout.decode("ascii")
    assert "rad2/m2" in help_ and "\\u" not in help_
    assert len({len(row) for row in help_.splitlines() if row.startswith(("|", "+"))}) == 1
    (lesson / "controls.csv").write_text("t;v;omega\n0;1;0\n")
    error = in_a_process("run", "csv", lesson, **environment)
    assert error.returncode == 2 and "\\u" not in error.stderr.decode("ascii")


def test_a_terminal_of_utf_8_gets_lines(lesson: Path) -> None:
    text = in_a_process("run", "csv", lesson, LANG="C.UTF-8", PYTHONIOENCODING="utf-8").stdout.decode("utf-8")
    assert "│ time a step [µs] " in text


@pytest.mark.parametrize(
    ("stream", "environment", "plain"),
    [
        ("utf-8", {}, False),
        ("utf-8", {"LANG": "C", "LC_CTYPE": "C.UTF-8"}, True),  # Python itself sets this LC_CTYPE
        ("utf-8", {"LANG": "C", "LC_CTYPE": "en_US.UTF-8"}, False),
        ("utf-8", {"LANG": "C", "LC_ALL": "de_DE.UTF-8"}, False),
        ("utf-8", {"LANG": "en_US.UTF-8"}, False),
        ("cp1252", {}, True),
        ("ascii", {"LANG": "en_US.UTF-8"}, True),
    ],
)
def test_a_character_is_replaced_where_it_cannot_be_shown(
    stream: str, environment: dict[str, str], plain: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    out = io.TextIOWrapper(io.BytesIO(), encoding=stream)
    monkeypatch.setattr(sys, "stdout", out)
    adapt_streams()
    print("σ ≥ 3 → 猫", file=out, flush=True)
    got = out.buffer.getvalue()  # type: ignore[attr-defined]
    assert got.strip() == (rb"sigma >= 3 -> \u732b" if plain else "σ ≥ 3 → 猫".encode())


class Terminal(io.TextIOWrapper):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(("kind", "encoding"), [(Terminal, "ascii"), (io.TextIOWrapper, "utf-8")])
def test_a_dumb_terminal_gets_ascii_and_a_file_does_not(
    kind: type[io.TextIOWrapper], encoding: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = kind(io.BytesIO(), encoding="utf-8")
    monkeypatch.setattr(sys, "stdout", out)
    monkeypatch.setenv("TERM", "dumb")
    adapt_streams()
    assert out.encoding == encoding


# ---- completion ----


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_each_shell_gets_a_completion_script(shell: str) -> None:
    done = in_a_process(_SLAMKIT_COMPLETE=f"source_{shell}")
    assert done.returncode == 0 and b"slamkit" in done.stdout and b"_SLAMKIT_COMPLETE" in done.stdout


@pytest.mark.parametrize(
    ("typed", "expected"),
    [
        ("com", ["compare"]),
        ("run ", ["mrclam", "csv"]),
        ("run csv --filter o", ["oc", "oc-ukf"]),
        ("run csv --motion e", ["euler"]),
        ("simulate l", ["lesson", "loop"]),
        ("compare --world r", ["ring"]),
    ],
)
def test_completion_offers_what_is_registered(typed: str, expected: list[str]) -> None:
    words = f"slamkit {typed}"
    done = in_a_process(_SLAMKIT_COMPLETE="complete_bash", COMP_WORDS=words, COMP_CWORD=str(words.count(" ")))
    assert done.stdout.decode().split() == expected
