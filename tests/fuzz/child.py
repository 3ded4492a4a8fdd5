"""A fuzz runs in a process of its own, so that a fatal signal is a finding and not the end of the tests."""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import IO

FOLDER = Path(__file__).resolve().parent
ROOT = FOLDER.parent.parent


class Trace:
    """What is about to be done, in a file that outlives the process."""

    def __init__(self, file: IO[str]) -> None:
        self.file, self.count = file, 0

    def begin(self, line: str) -> None:
        """Forget what was done before."""
        self.file.seek(0)
        self.file.truncate()
        self.write(line)

    def write(self, line: str) -> None:
        self.file.write(f"{line}\n")
        self.file.flush()

    def operation(self, line: str) -> None:
        """Count an operation, and note it before it is done."""
        self.count += 1
        self.write(f"{self.count}: {line}")


def arguments() -> argparse.Namespace:
    """What `run_child` passes on."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, required=True, help="operations, or files")
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--folder", type=Path, required=True, help="where the trace and other files go")
    parser.add_argument("--shrink", action="store_true", help="look for a shorter series; takes minutes")
    return parser.parse_args()


def run_child(script: str, count: int, seed: int, folder: Path, timeout: float) -> str:
    """Run a fuzz of this folder in a child process.

    Returns
    -------
    str
        What it printed.

    Raises
    ------
    AssertionError
        It did not end well: with its return code or signal, the seed, the operations that led there, and its output.
    """
    python_path = os.pathsep.join(map(str, (ROOT, FOLDER.parent, FOLDER)))
    command = [sys.executable, "-X", "faulthandler", str(FOLDER / script)]
    command += ["--count", str(count), "--seed", str(seed), "--folder", str(folder)]
    environment = os.environ | {"PYTHONPATH": python_path}
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=timeout, env=environment, cwd=folder, check=False
        )
        code, output = done.returncode, done.stdout + done.stderr
    except subprocess.TimeoutExpired as late:
        parts = [part.decode() if isinstance(part, bytes) else part or "" for part in (late.stdout, late.stderr)]
        code, output = None, "".join(parts)
    if code == 0:
        return output
    how = (
        "did not end" if code is None else f"ended by {signal.Signals(-code).name}" if code < 0 else f"returned {code}"
    )
    trace = (folder / "trace").read_text() if (folder / "trace").exists() else ""
    last = "\n".join(trace.splitlines()[-60:])
    raise AssertionError(f"{script} {how}; seed {seed}; last operations:\n{last}\noutput:\n{output[-6000:]}")
