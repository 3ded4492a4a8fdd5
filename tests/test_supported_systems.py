"""slamkit runs where the calls of Unix and the files of Linux are missing, as on Windows and macOS.

A child process takes them away after the libraries have loaded theirs, and then loads and uses slamkit.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from slamkit.belief import storage

WITHOUT_UNIX = '''
import ast, importlib, os, pkgutil, shutil, signal, sys, tempfile, warnings
import cloudpickle, joblib, matplotlib.figure, matplotlib.backends.backend_agg, numba, platformdirs, psutil
import rich.console, rich.progress, rich.table, scipy.linalg.cython_blas, scipy.stats, scipy.spatial, typer.testing

unix = """
    O_CLOEXEC O_DIRECTORY O_NOFOLLOW O_NONBLOCK chown chroot confstr ctermid fchdir fchmod fchown fork forkpty fstatvfs
    getegid geteuid getgid getgroups getloadavg getpgid getpgrp getpriority getresuid getsid getuid killpg lchown mkfifo
    mknod nice pathconf posix_fallocate posix_spawn pread preadv pwrite pwritev sched_getaffinity setgid setpgid
    setpriority setsid setuid statvfs sync sysconf sysconf_names ttyname uname wait3 wait4
"""
for name in unix.split():
    if hasattr(os, name):
        delattr(os, name)
for name in "SIGALRM SIGHUP SIGKILL SIGQUIT SIGUSR1 SIGUSR2 alarm pause pthread_sigmask setitimer sigwait".split():
    if hasattr(signal, name):
        delattr(signal, name)
for name in "crypt fcntl grp posix pty pwd readline resource syslog termios tty".split():
    sys.modules[name] = None

def no_link(*arguments, **options):
    raise OSError("symbolic links need a privilege")

os.symlink = os.link = no_link
# The encoding of text is not the same everywhere.
warnings.filterwarnings("error", category=EncodingWarning, module="slamkit")

import slamkit
for module in pkgutil.walk_packages(slamkit.__path__, "slamkit."):
    importlib.import_module(module.name)

import numpy as np
from slamkit.filters import FILTERS
from slamkit.simulate import WORLDS, simulate

folder = tempfile.mkdtemp()
run = typer.testing.CliRunner()
def command(*arguments):
    done = run.invoke(slamkit.cli.app, arguments, prog_name="slamkit", catch_exceptions=False)
    assert done.exit_code == 0, done.output

log = os.path.join(folder, "log")
command("simulate", "standing", "--out", log)
command("run", "csv", log, "--out", os.path.join(folder, "out"), "--json", os.path.join(folder, "numbers.json"))
world = WORLDS["standing"]()
f = FILTERS["ekf"](world.motion, world.sensor, world.pose, world.pose_covariance)
history = f.run(simulate(world, np.random.default_rng(0)).head(5))
history.save(os.path.join(folder, "history.npz"))
slamkit.History.load(os.path.join(folder, "history.npz"))
f.save(os.path.join(folder, "filter.npz"))
slamkit.EKFSLAM.load(os.path.join(folder, "filter.npz"))
shutil.rmtree(folder)
'''


def test_slamkit_needs_nothing_that_only_unix_has(tmp_path: Path) -> None:
    command = [sys.executable, "-X", "warn_default_encoding", "-c", WITHOUT_UNIX]
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "machine-code")}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr


def test_a_system_that_does_not_tell_its_cache_gets_a_usual_size(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(path: Path, encoding: str | None = None) -> str:
        raise PermissionError(path)

    monkeypatch.setattr(Path, "read_text", refuse)
    assert storage.half_of_cache.__wrapped__() == 8 * 2**20
    monkeypatch.setattr(Path, "glob", lambda *_: iter(()))
    assert storage.half_of_cache.__wrapped__() == 8 * 2**20
