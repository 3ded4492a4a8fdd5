"""Laws of the statistics by which benchmarks/experiments.py judges, and a run of the script in small."""

from __future__ import annotations

import json
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture
def experiments(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The script as a module."""
    # The script sets these for its own process; here they are taken back after the test.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
        monkeypatch.setenv(name, "1")
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return import_module("experiments")


@pytest.mark.parametrize("root", [False, True])
def test_standard_error_of_a_ratio_is_its_scatter(experiments: ModuleType, root: bool) -> None:
    rng = np.random.default_rng(3)
    yardstick = rng.gamma(3.0, 1.0, (2000, 50))
    values = 1.2 * yardstick + rng.normal(0.0, 0.3, yardstick.shape)
    found = [experiments.ratio(a, b, root) for a, b in zip(values, yardstick, strict=True)]
    ratios = np.array([r["value"] for r in found])
    assert ratios.mean() == pytest.approx(np.sqrt(1.2) if root else 1.2, rel=5e-3)
    assert np.mean([r["se"] for r in found]) == pytest.approx(ratios.std(), rel=0.06)
    # In pairs the same runs tell more than two studies with noise of their own.
    assert ratios.std() < 0.2 * np.std(values.mean(1) / rng.permutation(yardstick.mean(1)))


def test_ratio_leaves_out_runs_that_lack_one_of_the_two(experiments: ModuleType) -> None:
    nan = float("nan")
    assert experiments.ratio([2.0, 5.0, nan, 4.0], [1.0, nan, 3.0, 2.0]) == {"value": 2.0, "se": 0.0}


@pytest.mark.parametrize(
    ("value", "se", "expected"), [(1.05, 0.02, -2.5), (1.15, 0.02, 2.5), (0.85, 0.02, 2.5), (1.0, 0.0, -np.inf)]
)
def test_beyond_counts_from_the_margin_on_either_side(
    experiments: ModuleType, value: float, se: float, expected: float
) -> None:
    assert experiments.beyond({"value": value, "se": se}) == pytest.approx(expected)


def test_scattered_maps_keep_their_distance_from_the_path(experiments: ModuleType) -> None:
    world, other = experiments.scattered_map(4), experiments.loop_world()
    places = np.array(list(world.landmarks.values()))
    off = np.abs(np.hypot(places[:, 0], places[:, 1] - 10.0) - 10.0)
    assert len(places) == len(other.landmarks) and np.all((off >= 0.5) & (off <= 5.0))
    angle = np.arctan2(places[:, 0], 10.0 - places[:, 1]) % (2 * np.pi)
    assert np.bincount((angle / (2 * np.pi) * 20).astype(int), minlength=20).max() > 1


def test_the_script_writes_what_it_measures(
    experiments: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(experiments, "CLAIMED", {1.0: 0.986, 2.0: 1.789})
    monkeypatch.setattr(experiments, "ORDERS", ("batch",))
    experiments.main(only="C", runs=3, seed=1, jobs=1, out=tmp_path)
    written = json.loads((tmp_path / "experiments.json").read_text(encoding="utf-8"))
    row, _ = written["results"]["C"]["rows"]
    assert row["runs"] == 3 and all(row["kept"].values())
    assert 0.9 < row["claimed_deg"]["value"] < 1.0 - 5 * row["claimed_deg"]["se"]
    text = (tmp_path / "experiments.md").read_text(encoding="utf-8")
    assert f"{row['claimed_deg']['value']:.3f} ± {row['claimed_deg']['se']:.3f}" in text
    assert (tmp_path / "experiments.png").stat().st_size > 10_000
