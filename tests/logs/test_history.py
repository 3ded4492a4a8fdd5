"""What a history tells other programs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from log_examples import (
    same,
    small_history,
)


def test_a_history_as_csv(tmp_path: Path) -> None:
    history = small_history((3, "a,b"))
    history.write_csv(tmp_path)
    header, *lines = (tmp_path / "trajectory.csv").read_text().splitlines()
    assert header == "t,x,y,theta,sxx,sxy,sxtheta,syy,sytheta,sthetatheta"
    rows = np.array([[float(v) for v in line.split(",")] for line in lines])
    assert same(rows[:, :4], np.column_stack([history.times, history.poses]))
    P = history.pose_covariances
    assert same(rows[:, 4:], np.column_stack([P[:, 0, 0], P[:, 0, 1], P[:, 0, 2], P[:, 1, 1], P[:, 1, 2], P[:, 2, 2]]))
    header, *lines = (tmp_path / "map.csv").read_text().splitlines()
    assert header == "id,x,y,sxx,sxy,syy"
    S = history.landmark_covariances
    expected = np.column_stack([history.landmarks, S[:, 0, 0], S[:, 0, 1], S[:, 1, 1]]).tolist()
    assert lines == [f"{name},{','.join(map(repr, row))}" for name, row in zip(("3", '"a,b"'), expected, strict=True)]
