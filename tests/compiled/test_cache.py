"""Machine code on disk: damaged code is made anew, and without a safe place there is none; the results never change."""

from __future__ import annotations

import os
import random
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba import config

from slamkit.compiled import CacheWarning, Compiled, cache
from slamkit.se2 import wrap_angle

ROOT = Path(__file__).resolve().parents[2]


def plain_total(v: Any) -> float:
    s = 0.0
    for x in v:
        s += wrap_angle(x)
    return s


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder of its own for machine code, in which nothing is yet."""
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path / "cache"))
    forget()
    yield tmp_path / "cache"
    forget()


def forget() -> None:
    """What a process remembers of folders and warnings."""
    for remembered in (cache._root, cache._private, cache._warn):
        remembered.cache_clear()


def call() -> tuple[float, bool, list[str]]:
    """What a process that starts now computes, whether it had to compile, and its warnings."""
    forget()
    made: list[Any] = []
    function = Compiled(plain_total, "real(vector)")
    source = function._source
    vars(function)["_source"] = lambda: made.append(1) or source()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        value = function(np.array([4.0, 1.0]))
    return value, bool(made), [str(w.message) for w in caught if w.category is CacheWarning]


RIGHT = 5.0 - 2 * np.pi
rng = random.Random(1)
DAMAGE: dict[str, Callable[[bytes], bytes]] = {
    "truncated": lambda b: b[: rng.randrange(len(b))],
    "empty": lambda b: b"",
    "a bit flipped": lambda b: flipped(b, rng.randrange(8 * len(b))),
    "random": lambda b: rng.randbytes(len(b)),
    "zeros": lambda b: bytes(len(b)),
    "longer": lambda b: b + b"\0",
    "not text": lambda b: b"\xff" * len(b),
}


def flipped(content: bytes, bit: int) -> bytes:
    changed = bytearray(content)
    changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)


def stored(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file() and "plain_total" in str(path))


def test_machine_code_is_kept(folder: Path) -> None:
    assert call() == (RIGHT, True, [])
    assert {path.suffix for path in stored(folder)} == {"", ".nbi", ".nbc"}
    assert folder.stat().st_mode & 0o077 == 0, "nobody else may even look"
    assert call() == (RIGHT, False, [])


@pytest.mark.parametrize("kind", ["", ".nbi", ".nbc"])
@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_file_is_made_anew_with_one_warning(folder: Path, kind: str, damage: str) -> None:
    call()
    for path in stored(folder):
        if path.suffix == kind:
            path.write_bytes(DAMAGE[damage](path.read_bytes()))
    value, compiled, said = call()
    assert value == RIGHT and compiled
    assert len(said) == 1 and "was damaged: it is made anew" in said[0] and str(folder) in said[0]
    assert call() == (RIGHT, False, []), "it is sound again"


def test_a_missing_or_additional_file_is_damage(folder: Path) -> None:
    call()
    for path in stored(folder):
        content = path.read_bytes()
        path.unlink()
        assert call()[:2] == (RIGHT, True), path
        assert path.exists() or content
    (stored(folder)[0].parent / "further.nbc").write_bytes(b"code")
    assert call()[:2] == (RIGHT, True)


def test_all_damage_is_said_once(folder: Path) -> None:
    call()
    for path in folder.rglob("*"):
        if path.is_file():
            path.write_bytes(b"")
    forget()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for name in ("one", "two"):
            again = Compiled(plain_total, "real(vector)")
            again.__name__ = name
            for path in stored(folder):
                path.write_bytes(b"")
            assert again(np.array([4.0, 1.0])) == RIGHT
    assert len([w for w in caught if w.category is CacheWarning]) == 1


def test_a_file_of_the_same_version_elsewhere_has_its_own_machine_code(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two checkouts of one version, or a file that was written again, do not take each other's for damaged."""
    for stamp in ("one", "two", "one", "two"):
        monkeypatch.setattr(cache, "_source_stamp", lambda source, stamp=stamp: stamp)
        value, _, said = call()
        assert value == RIGHT and said == []
    assert not call()[1]


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="permissions are POSIX's")
@pytest.mark.parametrize("mode", [0o777, 0o720, 0o702])
def test_a_folder_that_others_can_write_to_is_not_used(folder: Path, mode: int) -> None:
    folder.mkdir()
    folder.chmod(mode)
    value, compiled, said = call()
    assert value == RIGHT and compiled and len(said) == 1 and "others can write to it" in said[0]
    assert list(folder.iterdir()) == []
    folder.chmod(0o700)
    assert call() == (RIGHT, True, [])
    inner = next(folder.iterdir())
    inner.chmod(mode)
    assert call()[:2] == (RIGHT, True), "nor one inside of it"


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="owners are POSIX's")
def test_a_folder_of_somebody_else_is_not_used(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    call()
    monkeypatch.setattr(os, "getuid", lambda: 12345)
    value, compiled, said = call()
    assert value == RIGHT and compiled and len(said) == 1 and "does not belong to you" in said[0]


SCRIPT = """
import warnings
import numpy as np
from slamkit.se2 import wrap_angle
from slamkit.compiled import compiled
print(wrap_angle(4.0), wrap_angle(0.5))
"""


@pytest.mark.parametrize(
    "environment",
    [
        {"NUMBA_CACHE_DIR": "/proc/x"},
        {"NUMBA_CACHE_DIR": "/dev/null/x"},
        {"HOME": "/proc/nobody", "XDG_CACHE_HOME": ""},
        {"HOME": "/dev/null", "XDG_CACHE_HOME": "/dev/null"},
    ],
    ids=["proc", "below a file", "no home", "home is a file"],
)
def test_without_a_place_to_write_it_runs_with_one_warning(environment: dict[str, str]) -> None:
    inherited = {k: v for k, v in os.environ.items() if k not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], env=inherited | environment, cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == [str(4.0 - 2 * np.pi), "0.5"]
    assert done.stderr.count("CacheWarning") == 1 and "set NUMBA_CACHE_DIR" in done.stderr
