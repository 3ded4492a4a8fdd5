"""Every tutorial runs, draws its figure, and its numbers are what its text says."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parent.parent
TUTORIALS = sorted((ROOT / "tutorials").glob("[0-9]*.py"))
NUMBER = r"(-?\d+(?:\.\d+)?(?:e[+-]?\d+)?)"

#: What a tutorial prints, and the range in which its text makes sense: (text before the number, low, high).
CLAIMS = {
    "01": [
        ("innovation in range: ", 0.29, 0.31),
        ("dead reckoning, position RMSE: ", 1.0, 50.0),
        ("EKF-SLAM, position RMSE: ", 0.0, 1.0),
        ("landmarks in the map: ", 20, 20),
    ],
    "02": [
        ("correlation of the two landmarks' x: ", 0.3, 1.0),
        ("share of |correlation| > 0.1 at the end: ", 0.5, 1.0),
    ],
    "03": [
        ("EKF-SLAM with the camera, position RMSE: ", 0.0, 1.0),
        ("largest difference between the two: ", 0.0, 1e-9),
    ],
    "04": [
        ("right: smallest eigenvalue after the first, second, third landmark: ", 1e-12, 1.0),
        ("wrong: smallest eigenvalue after the first, second, third landmark: ", -1.0, -5e-3),
        ("right: share of steps inside the band: ", 0.7, 1.0),
        ("wrong: share of steps inside the band: ", 0.0, 0.1),
        ("largest difference between the right listing and slamkit: ", 0.0, 1e-9),
    ],
    "05": [("EKF-SLAM, ATE: ", 0.0, 0.3), ("dead reckoning, ATE: ", 1.0, 10.0), ("landmark RMSE: ", 0.0, 0.12)],
}


@pytest.mark.parametrize("path", TUTORIALS, ids=lambda p: p.stem)
def test_tutorial(path: Path, tmp_path: Path) -> None:
    environment = {**os.environ, "MPLBACKEND": "Agg", "SLAMKIT_FIGURES": str(tmp_path), "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, path], env=environment, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    if done.stdout.startswith("skipped"):
        pytest.skip(done.stdout.strip())
    from matplotlib.image import imread

    pixels = imread(tmp_path / f"{path.stem}.png")
    assert min(pixels.shape[:2]) > 400
    assert np.std(pixels[..., :3]) > 0.05
    for text, low, high in CLAIMS.get(path.stem[:2], []):
        found = re.search(re.escape(text) + NUMBER, done.stdout)
        assert found, f"{text!r} is not printed"
        assert low <= float(found[1]) <= high, found[0]


def test_every_tutorial_has_its_claims() -> None:
    assert {p.stem[:2] for p in TUTORIALS} == set(CLAIMS)
