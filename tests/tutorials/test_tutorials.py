"""Every tutorial runs as a script and as a notebook, draws its figure, and prints the numbers that its text quotes."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
TUTORIALS = sorted((ROOT / "tutorials").glob("[0-9][0-9]_*.py"))
NUMBER = r"(-?\d+(?:\.\d+)?(?:e[+-]?\d+)?)"

#: Text that a tutorial prints before a number, and the range of this number for which its prose is true.
CLAIMS: dict[str, dict[str, tuple[float, float]]] = {
    "01_a_first_map": {
        "sd of x after one step of 1 m": (0.0999, 0.1001),  # σ_v·dt
        "the tree is started at": (3.0, 3.0),
        "innovation in range": (0.3, 0.3),
        "sd of x before the update": (0.1414, 0.1415),  # √2 σ_v·dt
        "sd of x after the update": (0.12, 0.14),
        "the robot moves back to x": (1.85, 1.95),
        "the tree moves on to x": (3.05, 3.15),
        "landmarks in the map": (20, 20),
        "dead reckoning, position RMSE": (3, 30),
        "EKF-SLAM, position RMSE": (0.05, 1),
        "EKF-SLAM, landmark RMSE": (0.05, 1.2),
        "the loop is closed after": (200, 260),
        "claimed sd of the position before": (0.5, 1.5),
        "claimed sd of the position after": (0.05, 0.4),
    },
    "02_why_the_covariance_becomes_dense": {
        "largest difference between the equation and the filter": (0, 1e-12),
        "correlation of the two landmarks' x": (0.3, 0.7),
        "share of |correlation| > 0.1 at the end": (0.9, 1),
        "share of |correlation| > 0.9 at the end": (0.3, 0.8),
        "all of P: mean NEES": (1, 8),
        "blocks only: mean NEES": (50, 1e4),
        "textbook over slamkit at N = 300": (5, 1e5),
    },
    "03_a_model_of_your_own": {
        "WrongSign breaks": (1, 1),
        "dead reckoning, position RMSE": (2, 30),
        "EKF-SLAM with our models, position RMSE": (0.02, 1),
        "invariant EKF with our models, position RMSE": (0.02, 1),
        "numba.njit, largest difference from plain NumPy": (0, 1e-10),
        "slamkit.compiled, largest difference from plain NumPy": (0, 1e-10),
        "a step of plain NumPy over a compiled one": (3, 1e4),
    },
    "04_the_listings_bug": {
        "right, smallest eigenvalue of P after landmark 1": (1e-4, 1e-3),
        "right, smallest eigenvalue of P after landmark 3": (1e-4, 1e-3),
        "wrong, smallest eigenvalue of P after landmark 1": (-7.7e-3, -7.6e-3),
        "wrong, smallest eigenvalue of P after landmark 3": (-0.1, -0.05),
        "slamkit, smallest eigenvalue of P after landmark 3": (1e-4, 1e-3),
        "slamkit refuses the listing's P: P is not positive semidefinite: its smallest eigenvalue is": (-0.1, -0.05),
        "wrong, median final error": (0.5, 5),
        "right, largest error of any run": (0.05, 0.5),
        "slamkit, largest error of any run": (0.05, 0.5),
        "largest difference between the listing put right and slamkit": (0, 1e-12),
        "wrong, runs with an impossible or too large NEES at the end": (80, 100),
        "wrong, runs with a negative NEES at some time": (50, 100),
        "slamkit, runs with an impossible or too large NEES at the end": (0, 15),
        "slamkit, runs with a negative NEES at some time": (0, 0),
        "evaluate.pose_nees says: the covariance at (0,": (0, 14),
        "slamkit, mean NEES over 50 runs at the end": (2.36, 3.72),  # its own 95 % band
    },
    "05_a_real_robot": {
        "sightings of landmarks": (6771, 6771),
        "landmarks in the map": (15, 15),
        "dead reckoning, ATE": (2, 5),
        "EKF-SLAM, ATE": (0.05, 0.3),
        "EKF-SLAM, landmark RMSE": (0.03, 0.12),
        "mean NIS": (0.1, 1),
        "robot 5, mrclam.models(), landmark RMSE": (0.03, 0.12),
        "robot 5, scatter alone, landmark RMSE": (0.2, 2),
    },
    "06_consistency": {
        "right claim, mean NEES": (2.95, 3.05),
        "right claim, share of the NEES below 7.815": (0.947, 0.953),
        "claimed deviations are half of the true ones, mean NEES": (11.8, 12.2),
        "band of a mean over 1000 independent steps": (2.84, 2.86),
        "invariant EKF, runs whose mean lies in that band": (0, 10),
        "invariant EKF, lowest mean NEES of a run": (0.5, 2),
        "invariant EKF, highest mean NEES of a run": (6, 20),
        "invariant EKF, correlation of the NEES with that of 100 steps before": (0.25, 0.6),
        "invariant EKF, independent values that 250 steps are worth": (1.5, 2.5),
        "invariant EKF, independent values that 1000 steps are worth": (2, 3),
        "share of the runs in which the EKF's mean NEES is lower than the invariant one's": (0.14, 0.2),
        "95 % band of the mean over 50 runs": (2.36, 2.36),
        "EKF, mean NEES at the last step": (3.73, 15),
        "invariant EKF, mean NEES at the last step": (2.36, 3.71),
        "wrong noise, mean NEES at the last step": (3.73, 10),
        "EKF, mean NEES": (5, 9),
        "EKF, median NEES": (3.4, 5),
        "invariant EKF, mean NEES": (2.5, 3.9),
        "invariant EKF, median NEES": (2.37, 3),
        "EKF, share of runs above 6": (0.2, 0.5),
        "invariant EKF, share of runs above 6": (0, 0.2),
        "EKF, share of the sum of all runs that its three worst runs hold": (0.12, 0.5),
        "EKF, truth inside the 95 % region": (60, 85),
        "invariant EKF, truth inside the 95 % region": (89, 97),
        "EKF, mean NIS": (1.98, 2.03),
        "invariant EKF, mean NIS": (1.98, 2.03),
        "wrong noise, mean NIS": (3.4, 4),
    },
    "07_gauge_freedom": {
        "robot and map moved as one, largest change of a sighting": (0, 1e-12),
        "from 1 deg, EKF claims": (0.98, 0.99),
        "from 2 deg, EKF claims": (1.4, 1.9),
        "from 20 deg, EKF claims": (1.1, 1.9),
        "from 5 deg, EKF is off by": (3.5, 8),
        "from 20 deg, EKF is off by": (14, 30),
        "from 20 deg, first-estimates EKF claims": (20, 20),
        "information on the turn when the map has been started": (131.31, 131.32),
        "1/σ₀²": (131.31, 131.32),
        "learnt in 299 scans, by hand": (500, 50000),
        "learnt in 299 scans, by the filter's covariance": (500, 50000),
        "relative difference": (0, 1e-9),
        "fej, gauge deviation after 300 scans": (5, 5),
        "oc, gauge deviation after 300 scans": (5, 5),
        "invariant, gauge deviation after 300 scans": (5, 5),
        "ekf, gauge deviation after 300 scans": (1, 4),
        "ekf, nullity": (2, 2),
        "fej, nullity": (3, 3),
        "oc, nullity": (3, 3),
        "invariant, nullity": (3, 3),
        "ideal, nullity": (3, 3),
        "ekf, third smallest singular value": (0.5, 10),
        "fej, third smallest singular value": (0, 1e-11),
        "ideal, third smallest singular value": (0, 1e-11),
        "ekf, gauge deviation falls by": (0.5, 4),
        "fej, gauge deviation falls by": (0, 0),
        "oc, gauge deviation falls by": (0, 0),
        "invariant, gauge deviation falls by": (0, 0),
        "ideal, gauge deviation falls by": (0, 0),
        "ekf, stochastic gauge at 1 deg": (1e-4, 1),
        "ekf, stochastic gauge at 20 deg": (1e-2, 1),
        "fej, stochastic gauge at 20 deg": (0, 1e-9),
        "oc, stochastic gauge at 20 deg": (0, 1e-9),
        "invariant, stochastic gauge at 20 deg": (0, 1e-9),
        "ideal, stochastic gauge at 20 deg": (0, 1e-9),
        "ekf, equivariance, largest deviation": (0, 1e-9),
    },
    "08_the_family": {
        "failed or diverged runs": (0, 0),
        "ukf and ukf-full, largest difference in standard deviations": (0, 1e-3),
        "ekf, position RMSE": (0.75, 1),
        "iterated, position RMSE": (0.85, 1.3),
        "invariant, position RMSE": (0.6, 0.74),
        "ideal, position RMSE": (0.6, 0.74),
        "runs in which the EKF is farther off than the invariant EKF": (11, 19),
        "ekf, relative NEES per dof": (0.9, 1.12),
        "ideal, relative NEES per dof": (0.9, 1.3),
        "invariant, relative NEES per dof": (0.9, 1.12),
        "ekf, gauge NEES per dof": (2, 6),
        "iterated, gauge NEES per dof": (3, 12),
        "ukf, gauge NEES per dof": (2, 8),
        "fej, gauge NEES per dof": (0.67, 1.39),
        "oc, gauge NEES per dof": (0.67, 1.39),
        "oc-ukf, gauge NEES per dof": (0.67, 1.39),
        "robocentric, gauge NEES per dof": (0.67, 1.39),
        "invariant, gauge NEES per dof": (0.67, 1.39),
        "95 % band of the gauge NEES per dof": (0.67, 0.68),
        "ekf minus invariant, relative NEES per dof": (-0.04, 0.04),
        "ekf minus invariant, gauge NEES per dof": (1, 5),
        "the worst run of the EKF, claimed deviation of the heading": (1, 3),
        "the worst run of the EKF, error of the heading": (4, 12),
        "as it is, gauge NEES (3)": (16, 60),  # 16.3 is exceeded by one in a thousand
        "as it is, NEES of the whole state per dof": (1.3, 3),
        "moved by T, gauge NEES (3)": (0, 7.8),
        "moved by T, NEES of the whole state per dof": (0.6, 1.45),
        "ekf, gauge deviation falls by": (10, 90),
        "ukf, gauge deviation falls by": (10, 90),
        "iterated, gauge deviation falls by": (10, 90),
        "robocentric, gauge deviation falls by": (0, 0),
        "fej, gauge deviation falls by": (0, 0),
        "oc-ukf, gauge deviation falls by": (0, 0),
        "invariant, gauge deviation falls by": (0, 0),
        "fej, excess of relative NEES per dof over invariant": (0.03, 0.4),
        "oc-ukf, excess of relative NEES per dof over invariant": (0.05, 0.5),
        "robocentric, excess of relative NEES per dof over invariant": (0.1, 0.5),
        "ideal, excess of relative NEES per dof over invariant": (0.01, 0.4),
        "time of a step, the slowest of the nine over the EKF": (1.2, 8),
    },
    "09_the_ukf": {
        "mean distance of the landmark, tangent": (10, 10),
        "mean distance of the landmark, sigma points": (9.5, 9.62),
        "mean distance of the landmark, 20000 samples": (9.5, 9.62),  # 10 exp(-0.3²/2)
        "spread with kappa = 0 at n = 203": (14.2, 14.2),
        "centre weight with kappa = 3 - n at n = 203": (-66.7, -66.7),
        "variance of |x|² by kappa = 3 - n": (-40601, -40599),
        "sd of the predicted range, 20000 samples": (0.114, 0.118),
        "sd of the predicted range at N = 1, spread √D": (0.115, 0.13),
        "sd of the predicted range at N = 300, spread √D": (0.55, 0.6),
        "sd of the predicted range at N = 1, spread √3 (κ = 3 − D)": (0.11, 0.12),
        "sd of the predicted range at N = 300, spread √3 (κ = 3 − D)": (0.11, 0.12),
        "sd of the predicted range at N = 1, spread √D / 100 (α = 0.01, β = 2)": (0.11, 0.12),
        "sd of the predicted range at N = 300, spread √D / 100 (α = 0.01, β = 2)": (0.11, 0.12),
        "largest change by turning the frame, root in world axes": (5e-3, 0.1),
        "largest change by turning the frame, root in body axes": (0, 1e-12),
        "largest change by turning the frame, UKFSLAM": (0, 1e-9),
        "largest change by turning the frame, FullUKFSLAM": (0, 1e-9),
        "sigma points of the whole state at N = 300": (1207, 1207),
        "sigma points of the pose and one landmark": (11, 11),
        "largest difference between whole and partial update, same spread": (0, 1e-12),
        "N = 5, alpha = 0.001, partial from full": (0, 1e-3),
        "N = 20, alpha = 0.001, partial from full": (0, 1e-3),
        "N = 50, alpha = 0.001, partial from full": (0, 1e-3),
        "N = 50, alpha = 1, partial from full": (0.1, 1),
        "variance after 2 updates, points of the prediction": (0, 0),
        "variance after 2 updates, drawn anew": (0.333, 0.334),
        "variance after 3 updates, points of the prediction": (-0.5, -0.5),
        "variance after 3 updates, drawn anew": (0.25, 0.25),
        "EKFSLAM, deviation of the heading claimed away": (0.5, 3),
        "UKFSLAM, deviation of the heading claimed away": (0.5, 3),
    },
    "10_convergence": {
        "ekf, smallest eigenvalue of what an update takes off": (-1e-13, 1e-13),
        "fej, smallest eigenvalue of what an update takes off": (-1e-13, 1e-13),
        "ekf, relative sd of a landmark after 1255 s": (2, 4),
        "fej, relative sd of a landmark after 1255 s": (2, 4),
        "ekf, ratio of the two over that of 1/√t": (0.85, 1.15),
        "fej, ratio of the two over that of 1/√t": (0.85, 1.15),
        "ekf, smallest eigenvalue of P_mm - A0 P0 A0' at the end": (-20, -3),
        "ekf, share of the time below the bound": (0.8, 1),
        "ekf, first below the bound after": (5, 230),  # before the loop is closed
        "fej, smallest eigenvalue of P_mm - A0 P0 A0' at the end": (1e-6, 1e-3),
        "fej, share of the time below the bound": (0, 0),
        "landmark 4, sd by the bound": (1.23, 1.23),  # √(2 · 0.1² + (23.3 · 3°)²)
        "ekf, landmark 4, claimed sd": (0.2, 0.9),
        "ekf, landmark 4, RMSE over 40 runs": (1.3, 2.5),
        "ekf, landmark 4, mean NEES": (8, 40),
        "ekf, relative NEES per degree of freedom": (0.9, 1.2),
        "fej, landmark 4, claimed sd": (1.3, 1.8),
        "fej, landmark 4, RMSE over 40 runs": (1.1, 1.8),
        "fej, landmark 4, mean NEES": (1.2, 3.8),
        "fej, relative NEES per degree of freedom": (1.1, 1.6),
    },
    "11_one_wrong_association": {
        "sightings with a wrong id": (2, 2),
        "largest NIS of the scan, ids right": (0, 13.8),
        "smallest NIS of the swapped two": (500, 2000),
        "the heading jumps by": (30, 180),
        "mean NIS, the next 10 s": (20, 500),
        "mean NIS, 50 to 100 s later": (1.4, 2.6),
        "mean NIS, the last loop": (1.7, 2.3),
        "mean NIS, the last loop, ids right": (1.7, 2.3),
        "ekf, 10 s later, map displaced by": (0.4, 2),
        "ekf, 1139 s later, map displaced by": (0.3, 2),
        "ekf, 10 s later, map deformed by": (10, 20),
        "ekf, 1139 s later, map deformed by": (4, 8),
        "invariant, 10 s later, map displaced by": (0.05, 0.3),
        "invariant, 1139 s later, map displaced by": (0, 0.08),
        "invariant, 1139 s later, map deformed by": (4, 8),
        "ekf, ratio of the deformations over that of 1/t": (0.8, 1.25),
        "invariant, ratio of the deformations over that of 1/t": (0.8, 1.25),
        "ekf, right, mean NEES of the last loop": (5, 30),
        "ekf, swapped, mean NEES of the last loop": (30, 300),
        "ekf, runs of 12 whose NEES the swap has raised": (9, 11),
        "ekf, turn of the map at the end, root mean square": (2, 8),
        "invariant, right, mean NEES of the last loop": (2, 6),
        "invariant, swapped, mean NEES of the last loop": (3, 8),
        "invariant, turn of the map at the end, root mean square": (0, 0.3),
        "gate, wrong sightings rejected, of 24": (24, 24),
        "gate, right sightings rejected, a run": (2, 7),
        "gate, turn of the map at the end, root mean square": (0, 0.1),
        "close, sightings rejected in that scan": (0, 0),
        "close, largest NIS of the scan": (2, 13.8),
        "close, map displaced by": (0, 10),
        "close, map deformed by": (0, 10),
        "first sight, EKF, NIS of the last loop": (1.7, 2.3),
        "first sight, EKF, mean NEES of the last loop": (1e4, 1e7),
        "first sight, EKF, the two landmarks are off by": (4.5, 5.5),
        "first sight, EKF, the map is turned by": (120, 180),
        "first sight, EKF, the map is deformed by": (0, 5),
        "first sight, invariant EKF, the map is turned by": (120, 180),
        "first sight, invariant EKF, the map is deformed by": (0, 5),
        "first sight, EKF with a gate, the two landmarks are off by": (4.5, 5.5),
        "first sight, EKF with a gate, the others are off by": (0.5, 3),
        "first sight, EKF with a gate, right sightings rejected, a run": (200, 1000),
    },
    "12_ten_thousand_landmarks": {
        "by hand, sightings": (200, 400),
        "by hand, active of 403": (15, 60),
        "by hand, largest move of a landmark that was not in sight, in standard deviations": (0.01, 1),
        "by hand, largest difference from the plain filter": (0, 1e-9),
        "200 landmarks, 3000 steps, flushes": (5, 200),
        "200 landmarks, 3000 steps, sighted": (100, 200),
        "200 landmarks, 3000 steps, largest difference of x": (0, 1e-9),
        "200 landmarks, 3000 steps, largest difference of P": (0, 1e-9),
        "P at N = 10000, one triangle": (1.6, 1.601),  # 4 D² bytes
        "P at N = 10000, a full matrix": (3.2, 3.202),
        "P at N = 10000, one triangle over that at N = 1000": (99, 100),
        "steps in which A is the same at N = 1000 and at N = 10000": (100, 400),
        "dimension of A at N = 1000, largest of these": (20, 110),
        "dimension of A at N = 10000, largest of these": (20, 110),
        "dimension of A at N = 10000, after 400 steps": (20, 200),
        "N = 2000, at once, flushes": (1, 20),
        "N = 2000, spread, flushes": (2, 200),
        "N = 2000, at once and spread, largest difference of x": (0, 1e-9),
        "N = 2000, at once and spread, largest difference of P": (0, 1e-9),
    },
}


#: Runs the cells of a tutorial one after the other in one namespace, as a notebook does: there is no `__file__`, and
#: only linecache knows the source of a cell.
NOTEBOOK = r"""
import linecache, pathlib, re, sys
source = pathlib.Path(sys.argv[1]).read_text(encoding="utf-8")
for number, cell in enumerate(re.split(r"(?m)^# %%.*\n", source)):
    name = f"<cell {number}>"
    linecache.cache[name] = len(cell), None, cell.splitlines(keepends=True), name
    exec(compile(cell, name, "exec"), globals())
"""


def run(path: Path, folder: Path, *, notebook: bool = False, **variables: str) -> str:
    """Standard output of a tutorial that runs in a folder of its own and without a display."""
    data = os.environ.get("SLAMKIT_DATA", str(ROOT.parent / "shared" / "data"))
    figures = str(folder / "figures")
    ours = {"MPLBACKEND": "Agg", "PYTHONPATH": str(ROOT), "SLAMKIT_DATA": data, "SLAMKIT_FIGURES": figures}
    command = [sys.executable, "-W", "error::DeprecationWarning:__main__"]
    if notebook:
        command += ["-c", NOTEBOOK]
    environment = {**os.environ, **ours, **variables}
    done = subprocess.run(
        [*command, str(path)], env=environment, cwd=folder, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    assert [p.name for p in folder.iterdir()] in ([], ["figures"]), "it left files behind"
    return done.stdout


def check_numbers(name: str, printed: str) -> None:
    """Every number that the prose quotes is printed and lies in its range."""
    for text, (low, high) in CLAIMS.get(name, {}).items():
        found = re.search(rf"(?m)^\W*{re.escape(text)}:?\s+{NUMBER}", printed)
        assert found, f"{text!r} is not printed"
        assert low <= float(found[1]) <= high, f"{found[0]}, expected {low} to {high}"


@pytest.mark.parametrize("path", TUTORIALS, ids=lambda p: p.stem)
def test_a_tutorial_runs_and_says_what_its_text_says(path: Path, tmp_path: Path) -> None:
    printed = run(path, tmp_path)
    if printed.startswith("skipped"):
        pytest.skip(printed.strip())
    from matplotlib.image import imread

    assert [p.name for p in (tmp_path / "figures").iterdir()] == [f"{path.stem}.png"]
    ink = imread(tmp_path / "figures" / f"{path.stem}.png")[..., :3].min(axis=2) < 0.9
    assert min(ink.shape) > 600
    rows, columns = np.array_split(ink, 4, axis=0), np.array_split(ink, 4, axis=1)
    assert min(part.mean() for part in (*rows, *columns)) > 0.002, "a quarter of the figure is blank"

    check_numbers(path.stem, printed)


NOTEBOOKS = {
    "01": [],
}


@pytest.mark.parametrize(
    "path",
    # `make test-long` runs all of them.
    [pytest.param(path, marks=NOTEBOOKS.get(path.stem[:2], [pytest.mark.slow]), id=path.stem) for path in TUTORIALS],
)
def test_a_tutorial_runs_as_a_notebook(path: Path, tmp_path: Path) -> None:
    printed = run(path, tmp_path, notebook=True)
    if printed.startswith("skipped"):
        pytest.skip(printed.strip())
    check_numbers(path.stem, printed)


@pytest.mark.parametrize("path", TUTORIALS, ids=lambda p: p.stem)
def test_a_tutorial_does_not_use_its_file_name(path: Path) -> None:
    assert "__file__" not in path.read_text(encoding="utf-8"), "a notebook has no __file__"


def test_every_tutorial_is_held_to_its_numbers() -> None:
    assert set(CLAIMS) == {path.stem for path in TUTORIALS}


@pytest.mark.parametrize("path", TUTORIALS, ids=lambda p: p.stem)
def test_a_tutorial_keeps_the_form(path: Path) -> None:
    source = path.read_text(encoding="utf-8")
    tree = ast.parse(source)
    assert ast.get_docstring(tree)
    cells = source.split("\n# %%")[1:]
    assert cells[0].startswith(f" [markdown]\n# # {path.stem[:2]} · "), "the first cell is a heading with the number"
    assert "\n# | symbol | shape | meaning |\n" in cells[0], "the first cell states the symbols"
    assert cells[-1].startswith(" [markdown]\n# ## Key points\n"), "the last cell holds the key points"
    text = [line for cell in cells if cell.startswith(" [markdown]") for line in cell.splitlines()[1:]]
    assert all(line.startswith("#") or not line for line in text), "a markdown cell holds code"
    used = {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            used |= {*(node.module or "").split("."), *(alias.name for alias in node.names)}
    assert not {name for name in used if name.startswith("_") and not name.endswith("__")}, "a private name is used"


def test_the_index_lists_every_tutorial_and_no_other() -> None:
    index = (ROOT / "tutorials" / "README.md").read_text(encoding="utf-8")
    assert re.findall(r"\]\((\d\d_\w+\.py)\)", index) == [path.name for path in TUTORIALS]


def test_without_its_data_the_real_robot_is_skipped(tmp_path: Path) -> None:
    empty = tmp_path / "nothing"
    printed = run(ROOT / "tutorials" / "05_a_real_robot.py", tmp_path, SLAMKIT_DATA=str(empty))
    assert printed.startswith("skipped")
    assert printed.count("\n") == 1 and str(empty) in printed and "SLAMKIT_DATA" in printed
    assert not (tmp_path / "figures").exists()
