"""A log as a folder of CSV files."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from log_examples import (
    GOOD,
    any_times,
    csv_ids,
    logs,
    outcome,
    over_one_folder,
    same,
    small_history,
    small_log,
)

from slamkit.errors import InputError, LogFileError
from slamkit.logs import Log, Truth, csv_columns


def comparable(log: Log) -> dict[str, Any]:
    """A log without the order of its landmark ids and without those that were never sighted."""
    sightings = zip(log.observation_times, log.observation_ids, log.observations, strict=True)
    truth, known = log.truth, log.truth.landmarks if log.truth else {}
    return {
        "sightings": sorted((t, repr(log.landmark_ids[i]), z.tolist()) for t, i, z in sightings),
        "schedule": log.schedule,
        "increments": log.increments,
        "truth": truth and (truth.times, truth.poses, {repr(i): known[i] for i in sorted(known, key=repr)}),
    }


@over_one_folder
@given(log=logs(any_times, csv_ids, late_observations=False))
def test_a_csv_folder_gives_the_log_back_to_the_bit(tmp_path: Path, log: Log) -> None:
    named = [*log.landmark_ids, *(log.truth.landmarks if log.truth else ())]
    assume(not any(isinstance(i, str) and i.lstrip("+-").isdigit() for i in named))
    for name in ("truth.csv", "landmarks.csv"):
        (tmp_path / name).unlink(missing_ok=True)
    log.write_csv(tmp_path)
    back = Log.read_csv(tmp_path)
    assert same(comparable(back), comparable(log))
    acting = np.unique(log.schedule.control[log.schedule.dt > 0])
    assert same(back.controls[acting], log.controls[acting])
    assert same(back.control_times[: len(log.controls)], log.control_times)
    assert not np.any(back.controls[len(log.controls) :])


def write(folder: Path, **texts: str | bytes) -> Path:
    sound: dict[str, str | bytes] = {
        "controls": "t,v,omega\n0,1,0.1\n1,2,0.2\n",
        "observations": "t,id,range,bearing\n0.5,7,3,0.1\n1,oak,4,0.2\n",
    }
    for name, text in (sound | texts).items():
        (folder / f"{name}.csv").write_bytes(text if isinstance(text, bytes) else text.encode())
    return folder


def test_a_log_written_by_hand(tmp_path: Path) -> None:
    plain = Log.read_csv(write(tmp_path))
    assert plain.landmark_ids == (7, "oak")
    assert plain.schedule.times.tolist() == [0.5, 1.0]
    assert not plain.increments
    assert plain.truth is None
    untidy = write(
        tmp_path,
        controls=b"\xef\xbb\xbf# driven by hand\r\n\r\n t , v, omega \r\n1,\t2 ,2e-1  # slow down\r\n 0, 1 ,.1\r\n\r\n",
        observations='# both sightings\r\r"t","id","range","bearing"\r1.0, oak ,4,0.2\r0.5,"7",3,0.1',
    )
    assert same(Log.read_csv(untidy), plain)


@pytest.mark.parametrize(
    ("header", "row", "increments"),
    [
        ("t,v,omega", "0,1,2", False),
        ("t,u1", "0,1", False),
        ("t,u1,u2,u3,u4", "0,1,2,3,4", False),
        ("t,rot1,trans,rot2", "0,1,2,3", True),
        ("t,d1,d2", "0,1,2", True),
        ("t", "", False),
    ],
)
@pytest.mark.parametrize("seen", ["range,bearing", "x,y", "z1", "z1,z2", "z1,z2,z3"])
def test_headers_say_what_the_columns_are(tmp_path: Path, header: str, row: str, increments: bool, seen: str) -> None:
    names = tuple(seen.split(","))
    rows = f"t,id,{seen}\n2,1{',5' * len(names)}\n"
    log = Log.read_csv(write(tmp_path, controls=f"{header}\n{row}\n", observations=rows))
    assert log.increments is increments
    assert log.controls.shape == (1 if row else 0, header.count(","))
    assert log.observations.shape == (1, len(names))
    assert csv_columns(tmp_path) == (tuple(header.split(",")[1:]), names)
    log.write_csv(tmp_path, controls=header.split(",")[1:], observations=names)
    assert csv_columns(tmp_path) == (tuple(header.split(",")[1:]), names)
    assert same(Log.read_csv(tmp_path), log)


def test_a_truth_may_be_poses_or_landmarks_or_both(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    poses = Log.read_csv(write(tmp_path / "a", truth="t,x,y,theta\n1,2,3,4\n0,1,2,3\n")).truth
    assert poses is not None and poses.times.tolist() == [0, 1] and not poses.landmarks
    landmarks = Log.read_csv(write(tmp_path / "b", landmarks="id,x,y\noak,1,2\n007,3,4\n")).truth
    assert landmarks is not None and landmarks.poses.shape == (0, 3)
    assert {i: p.tolist() for i, p in landmarks.landmarks.items()} == {"oak": [1, 2], 7: [3, 4]}


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("controls", "t,v,omega\n0,1\n", r"controls\.csv:2: 2 fields '0,1', expected 3: t,v,omega"),
        ("controls", "t,v,omega\n\n# x\n0,1,2,\n", r"controls\.csv:4: 4 fields '0,1,2,', expected 3"),
        ("controls", "t,v,omega\n0,1,fast\n", r"controls\.csv:2: 'fast' is not a number"),
        ("controls", "t,v,omega\n0,1,\n", r"controls\.csv:2: '' is not a number"),
        ("controls", "t,v,omega\n0,1,1_000\n", r"controls\.csv:2: '1_000' is not a number"),
        ("controls", "t,v,omega\n0,1,2\n1,nan,2\n", r"controls\.csv:3: nan is not finite"),
        ("controls", "t,v,omega\r\n0,1,2\r\n-inf,1,2\r\n", r"controls\.csv:3: -inf is not finite"),
        ("controls", "0,1,2\n1,1,2\n", r"controls\.csv:1: header is '0,1,2', expected t,v,omega or"),
        ("controls", "#\nt,omega,v\n", r"controls\.csv:2: header is 't,omega,v', expected t,v,omega or"),
        ("controls", "t,u1,u3\n", r"controls\.csv:1: header is 't,u1,u3', expected"),
        ("controls", "t;v;omega\n", r"controls\.csv:1: one column 't;v;omega', expected t,v,omega .*delimiter ';'\?"),
        ("controls", "# nothing\n\n", r"controls\.csv: the file is empty, expected the header t,v,omega"),
        ("controls", "", r"controls\.csv: the file is empty"),
        ("controls", b"t,v,omega\n0,1,2\n0,\xff,2\n", r"controls\.csv:3: byte 0xff, expected UTF-8"),
        ("controls", "t,v,omega\n0,1,2\n".encode("utf-16"), r"controls\.csv:1: byte 0xff, expected UTF-8"),
        ("controls", 't,v,omega\n0,"1,2\n', r"controls\.csv:2: .* expected fields between commas"),
        ("controls", "t,d1,d2\n0,1,2\n1,1,2\n0,1,2\n", r"controls\.csv:4: an increment begins at 0.0 s as on line 2"),
        ("controls", "t,rot1,trans,rot2\n0,0,1,0\n2,0,1,0\n", "last increment .* begins at 2.0 s, when the log ends"),
        ("observations", "t,id,range,bearing\n0,,1,2\n", r"observations\.csv:2: the id is empty"),
        ("observations", "t,id,range,bearing\n0,a,1\n", r"observations\.csv:2: 3 fields '0,a,1', expected 4"),
        ("observations", "t,id,range,bearing\n0,a,b,2\n", r"observations\.csv:2: 'b' is not a number"),
        ("observations", "t,id,range,bearing\n0,a,1,inf\n", r"observations\.csv:2: inf is not finite"),
        ("observations", "t,range,bearing\n0,1,2\n", r"observations\.csv:1: header .* expected t,id,range,bearing or"),
        ("truth", "t,x,y\n0,1,2\n", r"truth\.csv:1: header is 't,x,y', expected t,x,y,theta"),
        ("truth", "t,x,y,theta\n0,1,2,x\n", r"truth\.csv:2: 'x' is not a number"),
        ("landmarks", "id,x,y\na,1,2\nb,1,2\na,1,2\n", r"landmarks\.csv:4: landmark 'a' was given on line 2"),
        ("landmarks", "id,x,y\n7,1,2\n07,1,2\n", r"landmarks\.csv:3: landmark 7 was given on line 2"),
        ("landmarks", "id,x\na,1\n", r"landmarks\.csv:1: header is 'id,x', expected id,x,y"),
    ],
)  # fmt: skip
def test_a_broken_csv_file_is_named_with_its_line(tmp_path: Path, name: str, text: str | bytes, message: str) -> None:
    Log.read_csv(write(tmp_path))
    with pytest.raises(LogFileError, match=message):
        Log.read_csv(write(tmp_path, **{name: text}))


def test_a_missing_or_empty_csv_log_is_named(tmp_path: Path) -> None:
    for name in ("observations", "controls"):
        (write(tmp_path) / f"{name}.csv").unlink()
        with pytest.raises(LogFileError, match=rf"{name}\.csv cannot be read: No such file"):
            Log.read_csv(tmp_path)
    with pytest.raises(LogFileError, match=r"nowhere.controls\.csv cannot be read"):
        Log.read_csv(tmp_path / "nowhere")
    with pytest.raises(LogFileError, match=f"{tmp_path.name}: the log is empty"):
        Log.read_csv(write(tmp_path, controls="t,v,omega\n", observations="t,id,x,y\n"))


@over_one_folder
@given(st.sampled_from(["controls", "observations", "truth", "landmarks"]), st.integers(0, 400), st.binary(max_size=3))
def test_any_garbled_csv_file_is_read_or_refused(tmp_path: Path, name: str, at: int, garbage: bytes) -> None:
    texts: dict[str, bytes] = {
        "controls": b"t,v,omega\n0,1,0.1\n1,2,0.2\n",
        "observations": b"t,id,range,bearing\n0.5,7,3,0.1\n1,oak,4,0.2\n",
        "truth": b"t,x,y,theta\n0,1,2,3\n",
        "landmarks": b"id,x,y\n7,1,2\noak,3,4\n",
    }
    at %= len(texts[name])
    texts[name] = texts[name][:at] + garbage + texts[name][at + 1 :]
    write(tmp_path, **texts)
    log, error = outcome(lambda: Log.read_csv(tmp_path))
    assert isinstance(log, Log) if error is None else str(tmp_path) in str(error)


@pytest.mark.parametrize("name", ["7", "+7", "", " oak", "a#b", "a\nb", "a\rb", True, 1.5, None, (1,), "\ud800"])
def test_an_id_that_csv_would_change_is_refused_before_anything_is_written(tmp_path: Path, name: Hashable) -> None:
    for log in (
        Log(**GOOD | {"landmark_ids": (name,)}),
        replace(small_log(), truth=Truth([], [], {name: (0.0, 0.0)})),
    ):
        with pytest.raises(InputError, match="would not come back from a CSV file"):
            log.write_csv(tmp_path / "new")
    with pytest.raises(InputError, match="would not come back from a CSV file"):
        small_history((name, "oak")).write_csv(tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_a_landmark_that_was_never_sighted_may_have_any_id(tmp_path: Path) -> None:
    Log(**GOOD | {"landmark_ids": ("a", None, (1,))}).write_csv(tmp_path)
    assert Log.read_csv(tmp_path).landmark_ids == ("a",)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"controls": ("rot1", "trans", "rot2")}, "control columns rot1,trans,rot2 for 2 .* expected v,omega or u1,u2"),
        ({"controls": ("d1", "d2")}, "control columns d1,d2"),
        ({"observations": ("z1",)}, "observation columns z1 for 2 .* expected range,bearing or x,y or z1,z2"),
    ],
)
def test_column_names_have_to_fit(tmp_path: Path, options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        small_log().write_csv(tmp_path / "new", **options)
    assert not (tmp_path / "new").exists()


def test_an_end_before_the_last_observation_has_no_csv_form(tmp_path: Path) -> None:
    log = Log(**GOOD | {"observation_times": [5.0], "end_time": 2.0})
    with pytest.raises(InputError, match=r"end at 2.0 s, before the last observation at 5.0 s"):
        log.write_csv(tmp_path)


def test_no_truth_of_another_log_becomes_a_part_of_this_one(tmp_path: Path) -> None:
    small_log().write_csv(tmp_path)
    with pytest.raises(InputError, match=r"truth\.csv belongs to another log"):
        replace(small_log(), truth=None).write_csv(tmp_path)
    with pytest.raises(InputError, match=r"landmarks\.csv belongs to another log"):
        replace(small_log(), truth=Truth([], [])).write_csv(tmp_path)
    assert same(comparable(Log.read_csv(tmp_path)), comparable(small_log()))
