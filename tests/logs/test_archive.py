"""Logs and histories come back from their files exactly, and a file that is not sound is refused."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Callable, Hashable
from dataclasses import replace
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from log_examples import (
    GOOD,
    any_times,
    ids,
    logs,
    outcome,
    over_one_folder,
    same,
    small_history,
    small_log,
)

from slamkit.errors import InputError, LogFileError
from slamkit.logs import History, Log, Truth, decode_id, encode_id


@given(ids)
def test_ids_come_back_from_json_in_type_and_value(landmark_id: Hashable) -> None:
    assert same(decode_id(encode_id(landmark_id)), landmark_id)


@over_one_folder
@given(logs(any_times, ids))
def test_a_saved_log_comes_back_exactly(tmp_path: Path, log: Log) -> None:
    log.save(tmp_path / "log.npz")
    back = Log.load(tmp_path / "log.npz")
    assert same(back, log)
    assert same(back.schedule, log.schedule)
    assert os.listdir(tmp_path) == ["log.npz"]


@over_one_folder
@given(st.lists(ids, max_size=4, unique=True), st.integers(0, 2**32 - 1), st.floats())
def test_a_saved_history_comes_back_exactly(tmp_path: Path, names: list[Hashable], seed: int, seconds: float) -> None:
    history = replace(small_history(tuple(names), np.random.default_rng(seed)), seconds=seconds)
    history.save(tmp_path / "history")
    assert same(History.load(tmp_path / "history"), history)
    assert os.listdir(tmp_path) == ["history"], "under exactly this name"


def test_a_history_without_steps_comes_back(tmp_path: Path) -> None:
    empty = History(
        "ekf", np.empty(0), np.empty((0, 3)), np.empty((0, 3, 3)), np.empty(0), np.empty(0, dtype=np.int64),
        np.empty((0, 2)), np.empty(0), np.empty(0, dtype=np.bool_), (), np.empty((0, 2)), np.empty((0, 2, 2)), 0.25,
    )  # fmt: skip
    empty.save(tmp_path / "history.npz")
    assert same(History.load(tmp_path / "history.npz"), empty)


def test_look_alike_ids_stay_apart(tmp_path: Path) -> None:
    names = (1, "1", (1,), ("1",), None, "None", (), ((),), (True,), 0.5, "0.5")
    small_history(names).save(tmp_path / "h.npz")
    assert same(History.load(tmp_path / "h.npz").landmark_ids, names)
    for name in (True, 1.0, 1):
        Log(**GOOD | {"landmark_ids": (name,)}).save(tmp_path / "l.npz")
        assert type(Log.load(tmp_path / "l.npz").landmark_ids[0]) is type(name)


def test_numpys_numbers_become_pythons(tmp_path: Path) -> None:
    names = (np.int64(7), np.str_("oak"), (np.float32(0.5), np.bool_(True)))
    Log(**GOOD | {"landmark_ids": names}).save(tmp_path / "log.npz")
    assert same(Log.load(tmp_path / "log.npz").landmark_ids, (7, "oak", (0.5, True)))


class Tree(IntEnum):
    OAK = 1


SAVERS: list[Callable[[tuple[Hashable, ...], Path], None]] = [
    lambda names, path: Log(**GOOD | {"landmark_ids": names}).save(path),
    lambda names, path: replace(small_log(), truth=Truth([], [], dict.fromkeys(names, (0.0, 0.0)))).save(path),
    lambda names, path: small_history((*names, "oak")).save(path),
]


@pytest.mark.parametrize("save", SAVERS)
@pytest.mark.parametrize("name", [frozenset({1}), b"oak", Tree.OAK, 1j, (1, frozenset()), float("nan"), ("a", np.nan)])
def test_an_id_that_no_file_holds_is_refused_and_the_old_file_stays(
    tmp_path: Path, name: Hashable, save: Callable[[tuple[Hashable, ...], Path], None]
) -> None:
    path = tmp_path / "file.npz"
    path.write_bytes(b"precious")
    with pytest.raises(InputError, match="a file holds ids that are int, str"):
        save((name,), path)
    assert path.read_bytes() == b"precious"
    assert os.listdir(tmp_path) == ["file.npz"]


def test_a_history_that_does_not_fit_together_is_not_saved(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"poses has shape \(3, 3\)"):
        replace(small_history(), poses=np.zeros((3, 3))).save(tmp_path / "h.npz")
    with pytest.raises(InputError, match="accepted has shape"):
        replace(small_history(), accepted=np.ones(5)).save(tmp_path / "h.npz")
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    "write", [lambda p: small_log().save(p), lambda p: small_history().save(p), lambda p: small_history().write_tum(p)]
)
def test_a_failure_while_writing_leaves_the_old_file(
    tmp_path: Path, write: Callable[[Path], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"precious")

    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(OSError, match="No space left"):
            write(path)
    assert path.read_bytes() == b"precious"
    assert os.listdir(tmp_path) == ["file"]
    write(path)
    assert path.read_bytes() != b"precious"


def test_saving_follows_a_link_and_keeps_the_usual_permissions(tmp_path: Path) -> None:
    (tmp_path / "usual").write_bytes(b"")
    (tmp_path / "real.npz").write_bytes(b"")
    (tmp_path / "link.npz").symlink_to("real.npz")
    small_log().save(tmp_path / "link.npz")
    assert (tmp_path / "link.npz").is_symlink()
    assert same(Log.load(tmp_path / "real.npz"), small_log())
    assert (tmp_path / "real.npz").stat().st_mode == (tmp_path / "usual").stat().st_mode


def test_the_same_content_gives_the_same_bytes(tmp_path: Path) -> None:
    small_log().save(tmp_path / "a")
    small_log().save(tmp_path / "b")
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_one_kind_is_not_read_as_the_other(tmp_path: Path) -> None:
    small_log().save(tmp_path / "log")
    small_history().save(tmp_path / "history")
    with pytest.raises(LogFileError, match="history holds a slamkit History, expected a Log"):
        Log.load(tmp_path / "history")
    with pytest.raises(LogFileError, match="log holds a slamkit Log, expected a History"):
        History.load(tmp_path / "log")


@pytest.mark.parametrize("load", [Log.load, History.load])
def test_what_is_no_such_file_is_named(tmp_path: Path, load: Callable[[Path], Any]) -> None:
    np.save(tmp_path / "array", np.ones(3))
    np.savez(tmp_path / "other", times=np.ones(3))
    np.savez(tmp_path / "pickled", slamkit=np.array([{}], dtype=object))
    (tmp_path / "text").write_text("t,v,omega\n0,1,2\n")
    (tmp_path / "nothing").write_bytes(b"")
    (tmp_path / "folder").mkdir()
    for name in ("array.npy", "other.npz", "pickled.npz", "text", "nothing", "folder", "missing"):
        with pytest.raises(LogFileError, match=name):
            load(tmp_path / name)


def test_a_file_of_a_later_version_says_so(tmp_path: Path) -> None:
    small_log().save(tmp_path / "log")
    with np.load(tmp_path / "log") as archive:
        members = {name: archive[name] for name in archive.files}
    members["slamkit"] = np.array(str(members["slamkit"]).replace('"version": 1', '"version": 2'))
    np.savez(tmp_path / "later.npz", **members)
    with pytest.raises(LogFileError, match=r"later\.npz has version 2"):
        Log.load(tmp_path / "later.npz")


@pytest.mark.parametrize("thing", [small_log(), small_history()], ids=["Log", "History"])
def test_a_damaged_file_is_refused_or_read_exactly(tmp_path: Path, thing: Any) -> None:
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    thing.save(whole)
    content, rng = whole.read_bytes(), np.random.default_rng(1)
    for length in rng.permutation(len(content))[:100]:
        broken.write_bytes(content[:length])
        with pytest.raises(LogFileError, match="broken"):
            type(thing).load(broken)
    refused = 0
    for at in rng.permutation(len(content))[:300]:
        broken.write_bytes(content[:at] + bytes([content[at] ^ int(rng.integers(1, 256))]) + content[at + 1 :])
        read, error = outcome(lambda: type(thing).load(broken))
        # Some bytes of a zip archive say nothing: a date, a permission.
        assert same(read, thing) if error is None else "broken" in str(error)
        refused += error is not None
    assert refused > 150


def test_nothing_in_a_file_is_a_pickle(tmp_path: Path) -> None:
    small_log().save(tmp_path / "log")
    small_history().save(tmp_path / "history")
    for name in ("log", "history"):
        with zipfile.ZipFile(tmp_path / name) as archive:
            for member in archive.namelist():
                with archive.open(member) as file:
                    np.lib.format.read_array(file, allow_pickle=False)
