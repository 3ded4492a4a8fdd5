"""What logs, histories and scans print, and what a scan refuses."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from log_examples import GOOD, logs, small_history, small_log

from slamkit.errors import InputError
from slamkit.logs import Log, Scan, Truth


def test_a_log_prints_in_one_line() -> None:
    assert repr(small_log()) == "Log(2 controls, 3 sightings of 2 landmarks, 0 … 2.5 s, truth)"
    assert repr(small_log().truth) == "Truth(2 poses, 2 landmarks)"
    log = Log([0.0], [(1.0, 0.0, 0.0)], [], [], np.empty((0, 2)), (), 3.0, increments=True)
    assert repr(log) == "Log(1 increment, 0 sightings of 0 landmarks, 0 … 3 s)"
    assert repr(Log([], np.empty((0, 2)), [1.0], [0], [(1.0, 2.0)], ("a",), 9.0)).endswith("1 … 1 s)")


def test_a_history_prints_in_one_line() -> None:
    history = replace(small_history(), accepted=np.array([True, True, False, True, False]))
    assert repr(history) == "History('ekf', 4 steps, 5 sightings (2 rejected), 2 landmarks, 0 … 1 s)"


@given(logs())
def test_every_log_has_a_short_text(log: Log) -> None:
    assert len(repr(log)) < 200 and "\n" not in repr(log)
    assert log._repr_html_().count("<tr>") == 4


def test_a_notebook_shows_small_tables() -> None:
    html = replace(small_history(), filter="<mine>", seconds=0.25)._repr_html_()
    assert html.startswith("<table>") and "&lt;mine&gt;" in html and "0.25 s" in html
    assert len(html) < 1500
    assert "2 rates of 2 numbers" in small_log()._repr_html_()


@pytest.mark.parametrize(
    ("ids", "z", "message"),
    [
        (None, [(1.0, 2.0)], "ids of a scan are None, expected a sequence of ids"),
        (7, [(1.0, 2.0)], "ids of a scan are 7"),
        ("a", [(1.0, 2.0)], "ids of a scan are 'a'"),
        ({"a": (1.0, 2.0)}, [(1.0, 2.0)], "ids of a scan are {'a'"),
        ({"a"}, [(1.0, 2.0)], "ids of a scan are {'a'"),
        (iter("a"), [(1.0, 2.0)], "ids of a scan are"),
        (("a",), None, "z of a scan is None, expected one measurement per id"),
        (("a",), 1.0, "z of a scan is 1.0"),
        (("a",), [(1.0, 2.0)] * 2, "a scan has 1 ids and 2 rows of z"),
        ((), [(1.0, 2.0)], "a scan has 0 ids and 1 rows of z"),
    ],
)
def test_a_scan_says_what_is_wrong(ids: Any, z: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Scan(ids, z)


@pytest.mark.parametrize("ids", [["a", 1], ("a", 1), np.array([3, 4]), range(2)])
def test_a_scan_takes_any_sequence_of_ids(ids: Any) -> None:
    assert len(Scan(ids, np.ones((2, 2)))) == 2
    assert len(Scan(ids[:0], np.empty((0, 2)))) == 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"landmark_ids": "a"}, "landmark_ids is 'a', expected a sequence"),
        ({"landmark_ids": None}, "landmark_ids must be a sequence"),
        ({"controls": np.ones((2, 2)) * 1j}, "controls must be numbers"),
        ({"observations": np.ma.array([(1.0, 2.0)], mask=[(1, 0)])}, "observations must be numbers"),
        ({"observation_times": np.array(["2024-01-01"], "M8[s]")}, "observation_times must be numbers"),
        ({"observation_times": [10**400]}, "observation_times must be numbers"),
        ({"end_time": 10**400}, "end_time is an integer of .* bits, expected a finite number"),
        ({"observation_ids": [[0, 1], [0]]}, "observation_ids must be integers"),
        ({"increments": "no"}, "increments is 'no', expected True or False"),
        ({"truth": {}}, "truth is a dict, expected a Truth or None"),
    ],
)
def test_a_log_of_the_wrong_kind_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Log(**GOOD | change)
    if "truth" not in change:
        with pytest.raises(InputError):
            Truth([0.0], [(0.0, 0.0, 0.0)], change)


def test_a_log_keeps_plain_writable_copies() -> None:
    given = {name: np.array(GOOD[name], dtype=">f8") for name in ("control_times", "controls", "observations")}
    given["controls"] = np.asfortranarray(given["controls"])
    for a in given.values():
        a.flags.writeable = False
    log = Log(**GOOD | given | {"observation_ids": np.array([0], dtype=">i2")})
    for name in ("control_times", "controls", "observation_times", "observations", "observation_ids"):
        a = getattr(log, name)
        assert a.dtype.isnative and a.flags.c_contiguous and a.flags.writeable and a.flags.aligned
        assert not any(np.may_share_memory(a, b) for b in given.values())
    assert log.observation_ids.dtype == np.int64
