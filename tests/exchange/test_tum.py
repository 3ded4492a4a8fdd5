"""Trajectories in the TUM form."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from log_examples import (
    numbers,
    over_one_folder,
    quarters,
    same,
    small_history,
)

from slamkit.errors import InputError
from slamkit.exchange import write_tum


@over_one_folder
@given(st.lists(st.tuples(quarters, numbers, numbers, st.floats(-np.pi, np.pi, exclude_max=True)), max_size=8))
def test_a_tum_file_holds_one_pose_a_time(tmp_path: Path, rows: list[tuple[float, ...]]) -> None:
    rows.sort(key=lambda row: row[0])
    data = np.reshape(rows, (-1, 4))
    write_tum(tmp_path / "path.tum", data[:, 0], data[:, 1:])
    lines = (tmp_path / "path.tum").read_text().splitlines()
    read = np.array([[float(v) for v in line.split(" ")] for line in lines]).reshape(-1, 8)
    expected = np.reshape(list({row[0]: row for row in rows}.values()), (-1, 4))
    assert same(read[:, :3], expected[:, :3])
    assert not np.any(read[:, 3:6])
    np.testing.assert_allclose(np.hypot(read[:, 6], read[:, 7]), 1.0, atol=1e-15)
    np.testing.assert_allclose(2 * np.arctan2(read[:, 6], read[:, 7]), expected[:, 3], atol=1e-15)


def test_a_history_as_tum_is_its_trajectory(tmp_path: Path) -> None:
    history = small_history()
    history.write_tum(tmp_path / "a")
    write_tum(tmp_path / "b", history.times, history.poses)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    assert len((tmp_path / "a").read_text().splitlines()) == len(np.unique(history.times))


@pytest.mark.parametrize(
    ("times", "poses", "message"),
    [
        ([0.0, 1.0], [(0.0, 0.0, 0.0)], r"poses have shape \(1, 3\), 2 times need \(2, 3\)"),
        ([1.0, 0.0], np.zeros((2, 3)), "times step back from 1.0 to 0.0 s at row 1"),
        ([np.nan], np.zeros((1, 3)), "times is not finite at row 0"),
        ([0.0], [(0.0, 0.0, np.nan)], "poses is not finite at row 0"),
    ],
)
def test_no_tum_file_of_what_is_no_trajectory(tmp_path: Path, times: Any, poses: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        write_tum(tmp_path / "path", times, poses)
    assert os.listdir(tmp_path) == []
