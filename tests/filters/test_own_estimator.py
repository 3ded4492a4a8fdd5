"""An estimator outside slamkit has what the family has: its own numbers are copied, saved and undone."""

from __future__ import annotations

import copy
import json
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from family import MOTIONS, P0, SENSORS, drive
from filter_examples import POSE, every_form, every_order, every_storage, made_of, same, untouched
from own_estimator import CautiousEKF
from typer.testing import CliRunner

from slamkit import EKFSLAM, DivergenceError, InputError
from slamkit.cli import app
from slamkit.filters import FILTERS
from slamkit.models import RangeBearing
from slamkit.simulate import WORLDS
from slamkit.study import compare

SIGHTED = {"L0": (3.0, 0.4), "L1": (2.0, -0.8)}


def make(kind: Any = CautiousEKF, form: str = "compiled", **options: Any) -> Any:
    return kind(*made_of(form, MOTIONS["unicycle"], SENSORS["range-bearing"]), POSE, P0, **options)


@every_order
@every_storage
@every_form
def test_without_caution_it_is_the_ekf(order: str, storage: Any, form: str) -> None:
    mine = make(form=form, order=order, storage=storage, caution=0.0)
    ekf = make(EKFSLAM, form, order=order, storage=storage)
    log = drive(MOTIONS["unicycle"], SENSORS["range-bearing"])
    assert np.array_equal(mine.run(log).poses, ekf.run(log).poses)
    assert same(mine, ekf)
    assert mine.scans == len(log)


@every_order
@every_form
def test_its_numbers_count(order: str, form: str) -> None:
    f = make(form=form, order=order)
    for k in range(4):
        f.step((1.0, 0.1), 0.3, SIGHTED)
        assert f.caution == pytest.approx(0.9 ** (k + 1)) and f.scans == k + 1
    H = f.sensor.jacobians(f.pose, f.landmarks["L0"])
    assert H[0].shape == (2, 3)
    P = f.marginal(["L0"], pose=True)[1]
    H = np.hstack(H)
    f.observe("L0", (3.0, 0.4))
    np.testing.assert_allclose(f.S, H @ P @ H.T + (1 + 0.9**5) * f.R, rtol=1e-9)


@every_storage
@every_form
def test_its_numbers_are_copied_saved_and_undone(storage: Any, form: str, tmp_path: Path) -> None:
    f = make(form=form, storage=storage)
    f.run(drive(MOTIONS["unicycle"], SENSORS["range-bearing"], steps=10))
    f.save(tmp_path / "f")
    models = {"motion": f.motion, "sensor": f.sensor}
    copies = [copy.deepcopy(f), pickle.loads(pickle.dumps(f)), CautiousEKF.load(tmp_path / "f", **models)]
    for g in copies:
        assert (g.caution, g.scans) == (f.caution, f.scans) == (pytest.approx(0.9**10), 10)
        g.step((1.0, 0.1), 0.3, SIGHTED)
    f.step((1.0, 0.1), 0.3, SIGHTED)
    assert all(same(f, g) and g.caution == f.caution for g in copies)
    before = f.caution, f.scans
    untouched(f, lambda: f.step((1.0, 0.1), 0.3, {"L0": (3.0, 0.4), "L1": (np.nan, 0.0)}))
    untouched(f, lambda: f.step((1.0, np.nan), 0.3, SIGHTED))
    f.sensor = RangeBearing(1e-9, 1e-9)
    untouched(f, lambda: f.step((1.0, 0.1), 0.3, {"new": (4.0, 0.0), **SIGHTED}), DivergenceError)
    assert (f.caution, f.scans) == before


def test_it_is_used_by_name_in_a_study_and_on_the_command_line(
    register: Callable[..., None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    register(FILTERS, "cautious", CautiousEKF)
    assert FILTERS.find("cautious") is CautiousEKF is FILTERS.find("own_estimator:CautiousEKF")
    study = compare(["ekf", "cautious"], WORLDS["standing"](), 2, jobs=1, gauge_steps=5)
    assert not study.failures and study.filters == ("ekf", "cautious")
    assert study.trials["cautious"][0].nees.shape == study.trials["ekf"][0].nees.shape
    assert "cautious" in str(study.table())
    monkeypatch.chdir(tmp_path)
    drive(MOTIONS["unicycle"], SENSORS["range-bearing"]).write_csv("log")
    for named in ("cautious", "own_estimator:CautiousEKF"):
        done = CliRunner().invoke(app, ["run", "csv", "log", "--filter", named, "--json", "out.json"])
        assert done.exit_code == 0, done.output
        assert json.loads(Path("out.json").read_text())["filter"] == "cautious"
    with pytest.raises(InputError, match="cautious"):
        FILTERS.find("cautios")
