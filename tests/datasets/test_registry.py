"""Laws of every data set that slamkit reads by name, and of one of a user's own."""

from __future__ import annotations

import inspect
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from slamkit.datasets import DATASETS, REQUIRED, DataSet, Option, Recording
from slamkit.errors import InputError
from slamkit.logs import Log
from slamkit.models import RangeBearing, Unicycle


def small_log() -> Log:
    return Log([0.0], [(1.0, 0.0)], [0.5], [0], [(2.0, 0.1)], ("a",), 1.0)


def read(path: Any, part: str, scale: float, count: int | None, quick: bool) -> Recording:
    notes = (f"{path} {part} {scale} {count} {quick}",)
    return Recording(small_log(), "mine", Unicycle(0.1, 0.1), RangeBearing(0.1, 0.1), notes=notes)


MINE = DataSet(
    "mine", "A data set of my own.", "Nobody", "FILE", "A file.", read,
    (
        Option("part", str, "Which part.", choices=("first", "second")),
        Option("scale", float, "Factor.", 1.0),
        Option("count", int, "How many.", None),
        Option("quick", bool, "Less.", False),
    ),
)  # fmt: skip


@pytest.mark.parametrize("name", DATASETS)
def test_a_data_set_says_what_it_is_and_its_options_are_its_readers(name: str) -> None:
    data_set = DATASETS[name]
    assert data_set.name == name
    for text in (data_set.description, data_set.citation, data_set.path, data_set.path_help):
        assert text and "\n" not in text
    parameters = list(inspect.signature(data_set.reader).parameters.values())[1:]
    assert [p.name for p in parameters] == [option.name for option in data_set.options]
    for parameter, option in zip(parameters, data_set.options, strict=True):
        assert option.help and option.kind in (int, float, str, bool)
        if option.default is REQUIRED:
            assert parameter.default is inspect.Parameter.empty
        else:
            assert parameter.default == option.default
            assert option.check(option.default) == option.default
    assert name in repr(data_set) and "\n" not in repr(data_set)


def test_options_are_checked_and_defaults_filled_in(tmp_path: Path) -> None:
    assert MINE.read("x", part="first").notes == ("x first 1.0 None False",)
    assert MINE.read("x", part="first", scale=np.float32(2), count=3, quick=True).notes == ("x first 2.0 3 True",)
    assert MINE.read(tmp_path, part="second").notes[0].startswith(str(tmp_path))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "mine needs the option part: Which part"),
        ({"part": "third"}, "part is 'third', expected one of first, second"),
        ({"part": 1}, "part is 1, expected text"),
        ({"part": None}, "part is None, expected text"),
        ({"part": "first", "scale": "2"}, "scale is '2', expected a finite number"),
        ({"part": "first", "scale": 10**400}, "scale is .*, expected a finite number"),
        ({"part": "first", "count": 1.0}, "count is 1.0, expected an integer"),
        ({"part": "first", "count": True}, "count is True, expected an integer"),
        ({"part": "first", "quick": 1}, "quick is 1, expected True or False"),
        ({"part": "first", "scales": 2.0}, "mine has no option 'scales', .*; did you mean scale"),
    ],
)
def test_options_say_what_is_wrong(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        MINE.read("x", **options)


def test_a_data_set_of_ones_own_is_found_by_module_and_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "my_reader.py").write_text(
        "from dataclasses import replace\nfrom slamkit.datasets import DATASETS\n"
        "MINE, OTHER = replace(DATASETS['mrclam'], name='mine'), 3\n"
    )
    assert DATASETS.find("my_reader:MINE").name == "mine"
    with pytest.raises(InputError, match=r"3 is a int, expected a slamkit\.datasets\.DataSet"):
        DATASETS.find("my_reader:OTHER")
    with pytest.raises(InputError, match="no data set 'other', expected one of mrclam"):
        DATASETS.find("other")
    with pytest.raises(InputError, match="expected a slamkit"):
        DATASETS.register("mine", read)  # type: ignore[arg-type]
    assert "mine" not in DATASETS


def test_a_recording_has_a_short_repr() -> None:
    recording = replace(MINE.read("x", part="first"), title="a title")
    assert "a title" in repr(recording) and len(repr(recording)) < 150
