"""Archives that are well formed and wrong are refused, and cheaply."""

from __future__ import annotations

import io
import json
import struct
import time
import tracemalloc
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from log_examples import outcome, over_one_folder, same, small_history, small_log

from slamkit.errors import InputError, LogFileError
from slamkit.logs import Field, History, Log, check_arrays, read_archive, reading, write_archive

THINGS: dict[str, Any] = {"Log": small_log(), "History": small_history()}


def parts(kind: str, folder: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    THINGS[kind].save(folder / "sound")
    return read_archive(folder / "sound", kind)


def load(kind: str, folder: Path, facts: Any, arrays: Any) -> Any:
    write_archive(folder / "changed", kind, facts, arrays)
    return type(THINGS[kind]).load(folder / "changed")


NAMES = {
    "Log": (
        "control_times", "controls", "observation_times", "observation_ids", "observations", "truth_times",
        "truth_poses", "truth_landmarks",
    ),
    "History": (
        "times", "poses", "pose_covariances", "observation_times", "observation_ids", "innovations", "nis", "accepted",
        "landmarks", "landmark_covariances",
    ),
}  # fmt: skip


CHANGES: dict[str, Callable[[Any], Any]] = {
    "shorter": lambda a: a[:-1],
    "longer": lambda a: np.concatenate([a, a[-1:]]),
    "an axis more": lambda a: a[None],
    "an axis less": lambda a: a[0],
    "broadcast": lambda a: a.ravel()[:1],
    "another byte order": lambda a: a.astype(">f8"),
    "float32": lambda a: a.astype(np.float32),
    "int32": lambda a: a.astype(np.int32),
    "complex": lambda a: a.astype(complex),
    "text": lambda a: a.astype(str),
    "bytes": lambda a: a.view(np.uint8),
}


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize(("kind", "name"), [(kind, name) for kind in THINGS for name in NAMES[kind]])
def test_an_array_of_another_form_is_refused_by_name(tmp_path: Path, kind: str, name: str, change: str) -> None:
    facts, arrays = parts(kind, tmp_path)
    with np.errstate(invalid="ignore"):  # a NaN as an integer
        arrays[name] = CHANGES[change](arrays[name])
    with pytest.raises(LogFileError, match="changed"):
        load(kind, tmp_path, facts, arrays)


@pytest.mark.parametrize(("kind", "name"), [(kind, name) for kind in THINGS for name in NAMES[kind]])
def test_a_missing_or_unknown_array_is_refused_by_name(tmp_path: Path, kind: str, name: str) -> None:
    facts, arrays = parts(kind, tmp_path)
    with pytest.raises(LogFileError, match="unknown arrays: extra"):
        load(kind, tmp_path, facts, arrays | {"extra": np.ones(2)})
    del arrays[name]
    with pytest.raises(LogFileError, match=name if not name.startswith("truth") else "2 of the 3 arrays of a truth"):
        load(kind, tmp_path, facts, arrays)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize(
    ("kind", "name"),
    [("Log", name) for name in NAMES["Log"] if name != "observation_ids"]
    + [("History", "times"), ("History", "observation_times")],
)
def test_a_number_that_is_not_finite_is_refused(tmp_path: Path, kind: str, name: str, bad: float) -> None:
    facts, arrays = parts(kind, tmp_path)
    arrays[name].ravel()[-1] = bad
    with pytest.raises(LogFileError, match=f"{name} holds a value that is not finite"):
        load(kind, tmp_path, facts, arrays)


@pytest.mark.parametrize(
    ("kind", "name", "value", "message"),
    [
        ("Log", "observation_ids", -1, "observation_ids holds -1, expected at least 0"),
        ("Log", "observation_ids", 2, "observation_ids run from 0 to 2, there are 2"),
        ("History", "observation_ids", -2, "observation_ids holds -2, expected at least -1"),
        ("History", "observation_ids", 2**62, f"observation_ids holds {2**62}, there are 2"),
        ("History", "times", -1.0, "times steps back from 0.5 to -1.0 s at row 3"),
        ("History", "observation_times", -1.0, "observation_times steps back"),
    ],
)
def test_a_number_out_of_range_is_refused(tmp_path: Path, kind: str, name: str, value: Any, message: str) -> None:
    facts, arrays = parts(kind, tmp_path)
    arrays[name][-1] = value
    with pytest.raises(LogFileError, match=message):
        load(kind, tmp_path, facts, arrays)


@pytest.mark.parametrize(
    ("kind", "change"),
    [
        *[(kind, {"extra": 1}) for kind in THINGS],
        *[("Log", {"end_time": v}) for v in (None, True, 1, "1", [1.0], float("nan"), float("inf"), -5.0)],
        *[("Log", {"increments": v}) for v in (None, 0, 1, "no", [])],
        *[("Log", {"truth": v}) for v in (True, [1], [1, 2, 3], [1, 1], [1, {}], None, {})],
        *[(kind, {"landmark_ids": v}) for kind in THINGS for v in (None, [1], 2, {"a": 1}, [1, {}], "ab")],
        ("History", {"landmark_ids": [1, 2, 3]}),
        ("Log", {"landmark_ids": [1, 1]}),
        ("Log", {"landmark_ids": [1, float("nan")]}),
        *[("History", {"filter": v}) for v in (None, 1, ["ekf"])],
        *[("History", {"seconds": v}) for v in (None, 1, True, "1")],
    ],
)
def test_a_fact_of_another_kind_is_refused(tmp_path: Path, kind: str, change: dict[str, Any]) -> None:
    facts, arrays = parts(kind, tmp_path)
    with pytest.raises(LogFileError, match="changed"):
        load(kind, tmp_path, facts | change, arrays)
    for name in facts:
        with pytest.raises(LogFileError, match=f"missing facts: {name}"):
            load(kind, tmp_path, {n: v for n, v in facts.items() if n != name}, arrays)


def npy(shape: str, descr: str = "<f8", order: bool = False, data: bytes = b"", version: bytes = b"\x01\x00") -> bytes:
    header = f"{{'descr': '{descr}', 'fortran_order': {order}, 'shape': {shape}, }}".encode()
    header += b" " * (63 - (10 + len(header)) % 64) + b"\n"
    return b"\x93NUMPY" + version + struct.pack("<H", len(header)) + header + data


def raw(path: Path, members: list[tuple[str, bytes]], compression: int = zipfile.ZIP_STORED) -> Path:
    with warnings.catch_warnings(), zipfile.ZipFile(path, "w", compression) as archive:
        warnings.simplefilter("ignore")  # of two members with one name
        for name, content in members:
            archive.writestr(name, content)
    return path


def header_member(text: str) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, np.array(text))
    return buffer.getvalue()


def log_members(folder: Path) -> list[tuple[str, bytes]]:
    small_log().save(folder / "sound")
    with zipfile.ZipFile(folder / "sound") as archive:
        return [(info.filename, archive.read(info)) for info in archive.infolist()]


@pytest.mark.parametrize(
    "content",
    [
        npy("(1000000000000,)"),
        npy("(0, 1000000000000)"),
        npy("(-1,)"),
        npy("(2,)", data=bytes(8)),
        npy("(2,)", data=bytes(24)),
        npy("(2,)", "|O", data=bytes(16)),
        npy("(2,)", "<M8[s]", data=bytes(16)),
        npy("(2,)", version=b"\x09\x00", data=bytes(16)),
        npy("(True,)", data=bytes(8)),
        npy("x" * 5000, data=bytes(16)),
        npy("(" * 5000, data=bytes(16)),
        b"\x93NUMPY",
        b"",
        b"no array",
    ],
    ids=range(14),
)
def test_a_member_that_declares_something_else_than_it_holds_is_refused(tmp_path: Path, content: bytes) -> None:
    members = [(n, content if n == "observation_times.npy" else c) for n, c in log_members(tmp_path)]
    with pytest.raises(LogFileError, match="changed"):
        Log.load(raw(tmp_path / "changed", members))


def test_members_that_slamkit_does_not_write_are_refused(tmp_path: Path) -> None:
    members = log_members(tmp_path)
    assert same(Log.load(raw(tmp_path / "rewritten", members)), small_log())
    for extra, message in (
        (members[1], "holds control_times.npy twice"),
        (members[0], "holds slamkit.npy twice"),
        (("readme.txt", b""), "readme.txt, which is not an array"),
        (("folder/controls.npy", members[2][1]), "unknown arrays: folder/controls"),
    ):
        with pytest.raises(LogFileError, match=message):
            Log.load(raw(tmp_path / "changed", [*members, extra]))
    for kind in (zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA):
        with pytest.raises(LogFileError, match=r"(is compressed|claim to be larger)"):
            Log.load(raw(tmp_path / "changed", members, kind))


def test_truth_values_are_zero_or_one(tmp_path: Path) -> None:
    small_history().save(tmp_path / "sound")
    with zipfile.ZipFile(tmp_path / "sound") as archive:
        members = [(info.filename, archive.read(info)) for info in archive.infolist()]
    members = [(n, c[:-1] + b"\x02" if n == "accepted.npy" else c) for n, c in members]
    with pytest.raises(LogFileError, match=r"accepted\.npy holds a truth value other than 0 and 1"):
        History.load(raw(tmp_path / "changed", members))


def test_columns_first_is_read_as_it_was_meant(tmp_path: Path) -> None:
    facts, arrays = parts("Log", tmp_path)
    content = {name: io.BytesIO() for name in arrays}
    for name, a in arrays.items():
        np.save(content[name], np.asfortranarray(a))
    members = [(f"{name}.npy", file.getvalue()) for name, file in content.items()]
    header = header_member(json.dumps({"slamkit": "Log", "version": 1, "facts": facts}))
    assert same(Log.load(raw(tmp_path / "f", [("slamkit.npy", header), *members])), small_log())


@pytest.mark.parametrize(
    "text",
    [
        "[" * 100_000,
        '{"slamkit": ' * 50_000,
        "",
        "null",
        "[]",
        '{"slamkit": "Log", "version": 1}',
        "9" * 10_000,
        '{"slamkit": "Log", "version": 1, "facts": []}',
        '{"slamkit": "Log", "version": 1, "facts": {}, "more": 1}',
        '{"slamkit": "Log", "version": 1, "facts": {"landmark_ids": ' + "[" * 900 + "]" * 900 + "}}",
    ],
    ids=range(10),
)
def test_nested_huge_or_other_json_is_refused(tmp_path: Path, text: str) -> None:
    members = [(n, header_member(text) if n == "slamkit.npy" else c) for n, c in log_members(tmp_path)]
    with pytest.raises(LogFileError, match="changed"):
        Log.load(raw(tmp_path / "changed", members))


@pytest.mark.parametrize("member", ["controls.npy", "slamkit.npy", "other.npy"])
def test_a_small_file_never_takes_much_memory(tmp_path: Path, member: str) -> None:
    n = 8_000_000
    descr, size = ("<U2000000", 4 * 2_000_000) if member == "slamkit.npy" else ("<f8", 8 * n)
    content = npy("()" if member == "slamkit.npy" else f"({n},)", descr)
    path = tmp_path / "bomb"
    others = [(name, c) for name, c in log_members(tmp_path) if name != member]
    raw(path, others, zipfile.ZIP_DEFLATED)
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive, archive.open(member, "w") as file:
        file.write(content)
        for _ in range(size >> 20):
            file.write(bytes(1 << 20))
        file.write(bytes(size & ((1 << 20) - 1)))
    assert path.stat().st_size < 1_000_000
    tracemalloc.start()
    began = time.perf_counter()
    with pytest.raises(LogFileError, match="bomb"):
        Log.load(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 5_000_000
    assert time.perf_counter() - began < 5.0


@over_one_folder
@given(st.sampled_from(sorted(THINGS)), st.data())
def test_any_changed_number_is_refused_or_read(tmp_path: Path, kind: str, data: st.DataObject) -> None:
    facts, arrays = parts(kind, tmp_path)
    name = data.draw(st.sampled_from(NAMES[kind]))
    view = arrays[name].reshape(-1).view(np.uint8)
    for _ in range(data.draw(st.integers(1, 8))):
        view[data.draw(st.integers(0, len(view) - 1))] = data.draw(st.integers(0, 255))
    if arrays[name].dtype == np.bool_:
        arrays[name] = view > 0
    thing, error = outcome(lambda: load(kind, tmp_path, facts, arrays))
    if error is None and kind == "Log":
        assert len(list(thing)) == len(thing.schedule.times)


def test_fields_are_checked_against_each_other() -> None:
    fields = {
        "a": Field(np.float64, ("K", 3), lower=0.0, upper=1.0),
        "b": Field(np.int64, ("K",), lower=-1),
        "c": Field(np.bool_, ("L", "K"), optional=True),
    }
    a, b, c = np.zeros((4, 3)), np.zeros(4, np.int64), np.ones((2, 4), np.bool_)
    assert check_arrays({"a": a, "b": b, "c": c}, fields) == {"K": 4, "L": 2}
    assert check_arrays({"a": a, "b": b}, fields, {"L": 7}) == {"K": 4, "L": 7}
    for arrays, message in (
        ({"a": a}, "missing arrays: b"),
        ({"a": a, "b": b, "d": b}, "unknown arrays: d; expected a, b, c"),
        ({"a": a, "b": b[:3]}, r"b has shape \(3,\) of int64, expected \(4,\) of int64"),
        ({"a": a, "b": b.astype(float)}, r"b has shape \(4,\) of float64, expected \(4,\) of int64"),
        ({"a": a[:, :2], "b": b}, r"a has shape \(4, 2\) of float64, expected \(4, 3\) of float64"),
        ({"a": a[0], "b": b}, r"a has shape \(3,\) of float64, expected \(K, 3\) of float64"),
        ({"a": a + 2, "b": b}, "a holds 2.0, expected at most 1"),
        ({"a": a, "b": b - 2}, "b holds -2, expected at least -1"),
        ({"a": a * np.nan, "b": b}, "a holds a value that is not finite"),
    ):
        with pytest.raises(InputError, match=message):
            check_arrays(arrays, fields)
    with pytest.raises(InputError, match=r"c has shape \(2, 4\) of bool, expected \(3, 4\) of bool"):
        check_arrays({"a": a, "b": b, "c": c}, fields, {"L": 3})


def test_an_archive_can_be_read_without_declared_fields(tmp_path: Path) -> None:
    arrays = {"x": np.arange(3.0), "n": np.array(7), "names": np.array(["a", "bc"]), "empty": np.empty((0, 2))}
    write_archive(tmp_path / "file", "thing", {"k": [1, None]}, arrays)
    with reading(tmp_path / "file", "thing"):
        facts, back = read_archive(tmp_path / "file", "thing")
    assert facts == {"k": [1, None]} and same(back, arrays)
    assert all(a.flags.writeable and a.flags.c_contiguous for a in back.values())
