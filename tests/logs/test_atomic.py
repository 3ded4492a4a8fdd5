"""Files are replaced as a whole, and the files of a folder together, wherever a writer is killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from slamkit.errors import InputError
from slamkit.logs import Log, Truth, atomic, csv_columns, read_files, replacing, write_files


class Killed(BaseException):
    """A kill, as far as the files are concerned: nothing is tidied up after it."""


def killing(monkeypatch: pytest.MonkeyPatch, at: int) -> None:
    """Let the writer die before its at-th act on the file system."""
    count = iter(range(10**6))
    dead = False

    def counted(function: Callable[..., Any]) -> Callable[..., Any]:
        def act(*arguments: Any, **options: Any) -> Any:
            nonlocal dead
            n = next(count)
            if dead or n == at:
                dead = True
                raise Killed
            return function(*arguments, **options)

        return act

    monkeypatch.setattr(atomic, "open", counted(open), raising=False)
    monkeypatch.setattr(os, "fsync", counted(os.fsync))
    monkeypatch.setattr(os, "replace", counted(os.replace))
    monkeypatch.setattr(Path, "unlink", counted(Path.unlink))


OLD = {"a.csv": b"old a", "b.csv": b"old b", "c.csv": b"old c"}
NEW = {"a.csv": b"new a", "b.csv": b"new b", "c.csv": b"new c"}


@pytest.mark.parametrize("at", range(17))
def test_killed_anywhere_a_folder_holds_all_old_files_or_all_new_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at: int
) -> None:
    write_files(tmp_path, OLD)
    (tmp_path / "notes.txt").write_text("mine")
    with monkeypatch.context() as patch:
        killing(patch, at)
        try:
            write_files(tmp_path, NEW)
            finished = True
        except Killed:
            finished = False
    found = read_files(tmp_path, OLD)
    assert found in (OLD, NEW)
    assert found == NEW or not finished
    assert finished == (at > 14), "a kill after the last act is no kill: the range covers every act"
    write_files(tmp_path, {"a.csv": b"newest"})
    assert {name: (tmp_path / name).read_bytes() for name in OLD} == found | {"a.csv": b"newest"}
    write_files(tmp_path, NEW)
    assert sorted(os.listdir(tmp_path)) == [*sorted(NEW), "notes.txt"], "what the killed writer left is gone"


def log(value: float) -> Log:
    n = 300
    truth = Truth(np.arange(n), np.full((n, 3), value), {"a": (value, value)})
    return Log(
        np.arange(n), np.full((n, 2), value), np.arange(n) + 0.5, np.zeros(n, int), np.full((n, 2), value), ("a",), n,
        truth=truth,
    )  # fmt: skip


def value_of(log: Log) -> float:
    assert log.truth is not None
    values = {
        *log.controls[:-1].ravel(),
        *log.observations.ravel(),
        *log.truth.poses.ravel(),
        *log.truth.landmarks["a"],
    }
    assert len(values) == 1, f"a mixture of the logs {values}"
    return values.pop()


WRITER = """
import sys
sys.path[:0] = [{tests!r}, {here!r}]
from test_atomic import log
print("ready", flush=True)
for k in range(10**6):
    log(k % 7 + 1.0).write_csv(sys.argv[1])
"""


@pytest.mark.skipif(sys.platform == "win32", reason="there is no SIGKILL")
def test_a_killed_process_leaves_one_log_and_its_remains_are_removed(tmp_path: Path) -> None:
    code = WRITER.format(tests=str(Path(__file__).parents[1]), here=str(Path(__file__).parent))
    log(1.0).write_csv(tmp_path)
    for wait in (0.0, 0.011, 0.023, 0.04):
        writer = subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], stdout=subprocess.PIPE)
        assert writer.stdout is not None
        writer.stdout.readline()
        for _ in range(5):  # while the other process writes
            value_of(Log.read_csv(tmp_path))
        threading.Event().wait(wait)
        writer.send_signal(signal.SIGKILL)
        writer.wait()
        writer.stdout.close()
        value_of(Log.read_csv(tmp_path))
        assert csv_columns(tmp_path) == (("v", "omega"), ("range", "bearing"))
    log(9.0).write_csv(tmp_path)
    assert value_of(Log.read_csv(tmp_path)) == 9.0
    assert sorted(os.listdir(tmp_path)) == ["controls.csv", "landmarks.csv", "observations.csv", "truth.csv"]


def test_readers_and_writers_of_one_folder_never_meet_a_mixture(tmp_path: Path) -> None:
    log(1.0).write_csv(tmp_path)
    errors: list[BaseException] = []

    def work(act: Callable[[int], Any]) -> None:
        try:
            for k in range(12):
                act(k)
        except BaseException as error:
            errors.append(error)

    acts = [lambda k: log(k + 2.0).write_csv(tmp_path), lambda k: log(k + 50.0).write_csv(tmp_path)]
    acts += [lambda k: value_of(Log.read_csv(tmp_path))] * 2  # type: ignore[list-item]
    threads = [threading.Thread(target=work, args=(act,)) for act in acts]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not errors
    assert value_of(Log.read_csv(tmp_path)) in (13.0, 61.0)


def test_what_a_killed_writer_left_is_removed_and_a_living_ones_file_stays(tmp_path: Path) -> None:
    stale = tmp_path / f".log.npz.{'0' * 16}.tmp"
    other = tmp_path / f".other.npz.{'0' * 16}.tmp"
    for path in (stale, other):
        path.write_bytes(b"half")
    with replacing(tmp_path / "log.npz") as first:
        first.write(b"first")
        with replacing(tmp_path / "log.npz") as second:
            second.write(b"second")
        assert not stale.exists() and other.exists()
        assert (tmp_path / "log.npz").read_bytes() == b"second"
    assert (tmp_path / "log.npz").read_bytes() == b"first"
    assert sorted(os.listdir(tmp_path)) == [other.name, "log.npz"]


def test_a_list_of_files_names_no_file_elsewhere(tmp_path: Path) -> None:
    folder = tmp_path / "log"
    write_files(folder, OLD)
    (tmp_path / f".a.csv.{'0' * 16}.tmp").write_bytes(b"elsewhere")
    (folder / atomic.LIST).write_text(f"../.a.csv.{'0' * 16}.tmp\n.a.csv.{'1' * 16}.tmp\nnonsense\n", encoding="utf-8")
    assert read_files(folder, OLD) == OLD
    write_files(folder, NEW)
    assert read_files(folder, NEW) == NEW and (tmp_path / f".a.csv.{'0' * 16}.tmp").exists()


def test_a_truth_whose_writing_was_interrupted_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    without = Log([0.0], [(1.0, 2.0)], [0.5], [0], [(1.0, 2.0)], ("a",), 1.0)
    without.write_csv(tmp_path)
    with monkeypatch.context() as patch:
        real = os.replace
        patch.setattr(os, "replace", lambda a, b: real(a, b) if Path(b).name == atomic.LIST else _die())
        with pytest.raises(Killed):
            log(3.0).write_csv(tmp_path)
    assert not (tmp_path / "truth.csv").exists()
    assert value_of(Log.read_csv(tmp_path)) == 3.0
    with pytest.raises(InputError, match=r"truth\.csv belongs to another log"):
        without.write_csv(tmp_path)
    assert value_of(Log.read_csv(tmp_path)) == 3.0 and (tmp_path / "truth.csv").exists()


def _die() -> None:
    raise Killed
