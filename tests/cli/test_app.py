"""Laws of the command itself: how it starts, helps, is interrupted."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from commands import succeeds

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
