"""One trial: compared with the truth, aligned where it is a recorded log, recorded where it fails."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_study import NAMES, recorded, small, unlucky, world

from slamkit import EKFSLAM, History, InputError, Log, Truth, evaluate, se2, simulate
from slamkit.filters import FILTERS
from slamkit.models import Unicycle
from slamkit.study import Study, compare
from slamkit.study.trial import each_step


def test_the_ideal_filter_is_consistent() -> None:
    runs = 60
    trials = compare(["ideal"], world(20), runs, 3, jobs=2, gauge_steps=0).trials["ideal"]
    for column, dof in enumerate((3, 2, 1)):
        bounds = evaluate.chi2_bounds(dof, runs, 0.999)
        final = float(np.mean([t.nees[-1, column] for t in trials]))
        assert bounds.lower < final < bounds.upper
    dof = trials[0].relative_dof
    bounds = evaluate.chi2_bounds(dof, runs, 0.999)
    assert bounds.lower < np.mean([t.relative_nees for t in trials]) < bounds.upper


def test_failed_and_diverged_trials_are_recorded(troubled: Study) -> None:
    wrong = {k for k in range(8) if unlucky(troubled.rerun(k, "ekf")[1])}
    assert 0 < len(wrong) < 8
    for name, why in (("raises", "RuntimeError: out of luck"), ("nan", "not finite"), ("lost", None)):
        trials = troubled.trials[name]
        assert {t.number for t in trials if t.diverged} == wrong
        for sound, t in zip(troubled.trials["ekf"], trials, strict=True):
            if t.number not in wrong:
                np.testing.assert_array_equal(t.nees, sound.nees)
            elif why is not None:
                assert t.error is not None and why in t.error and np.isnan(t.errors).all()
            else:
                assert t.error is None and np.all(np.abs(t.errors[:, 0]) > 900)
        s = troubled.summary()[name]
        assert s["diverged"] == len(wrong) and s["runs"] == 8
        assert s["finished"] == (8 if why is None else 8 - len(wrong))
    assert troubled.summary()["lost"]["position_rmse_m"] > 100
    assert not any(t.diverged for t in troubled.trials["ekf"])
    with pytest.raises(RuntimeError, match="out of luck"):
        troubled.rerun(min(wrong), "raises")
    report = troubled.report()
    assert report.count("out of luck") == len(wrong) and "above 1 times" in report
    json.dumps(troubled.summary(), allow_nan=False)


def test_a_filter_that_always_fails_leaves_the_others_whole(study: Study) -> None:
    def fails(*_: Any, **__: Any) -> Any:
        raise ValueError("no filter today")

    mixed = small(filters={"never": fails, **{n: FILTERS[n] for n in NAMES}})
    for name in NAMES:
        for a, b in zip(mixed.trials[name], study.trials[name], strict=True):
            np.testing.assert_array_equal(a.nees, b.nees)
    s = mixed.summary()["never"]
    assert s["diverged"] == 4 and s["finished"] == 0 and s["pose_nees"] is None and s["nullity"] is None
    assert "no filter today" in (mixed.gauge["never"].error or "")
    assert set(mixed.figures()) == set(study.figures())


def test_a_simulation_that_fails_is_recorded() -> None:
    class Slippery(Unicycle):
        def move(self, pose: Any, u: Any, dt: float) -> Any:
            moved = super().move(pose, u, dt)
            return moved if moved[0] < 1 else np.full(3, np.nan)

    broken = replace(world(), motion=Slippery(0.05, 0.05))
    study = compare(["ekf"], broken, 2, motion=world().motion, jobs=1, gauge_steps=3)
    assert all("the simulation" in (t.error or "") for t in study.trials["ekf"])
    assert "the simulation" in (study.gauge["ekf"].error or "")


def test_recorded_log_without_truth_has_no_errors(tmp_path: Path) -> None:
    models = {"motion": world().motion, "sensor": world().sensor}
    study = compare(["ekf", "ideal"], recorded(tmp_path, lambda t: None), jobs=1, gauge_steps=6, **models)
    assert study.runs == 1 and study.world == tmp_path.name
    s = study.summary()
    assert all(s["ekf"][k] is None for k in ("pose_nees", "position_rmse_m", "landmark_nees", "relative_nees_per_dof"))
    assert s["ekf"]["seconds_per_step"] > 0 and s["ekf"]["nullity"] == 2 and s["ekf"]["diverged"] == 0
    assert "truth" in (study.trials["ideal"][0].error or "") and s["ideal"]["diverged"] == 1
    assert set(study.figures()) == {"gauge"}
    assert study.gauge["ideal"].error is not None and study.gauge["ideal"].error.count("needs the truth") == 1
    assert len(study.findings()) == 1 and "ekf (its claimed deviation falls" in study.findings()[0]
    assert "| ekf | –" in study.report()
    history, _ = study.rerun(0, "ekf")
    corrected = history.nis[np.isfinite(history.nis)]
    assert study.trials["ekf"][0].nis_mean == corrected.mean()
    assert s["ekf"]["nis_per_dof"] == corrected.mean() / 2
    with pytest.raises(InputError, match="truth"):
        study.overview()


@pytest.mark.parametrize("pose", [(3.0, -4.0, 2.0), (0.0, 100.0, -3.0)])
def test_recorded_log_is_aligned(pose: tuple[float, float, float]) -> None:
    """Whatever frame the truth is in, errors and normalised errors are the same."""

    def moved(t: Truth) -> Truth:
        return Truth(t.times, se2.compose(pose, t.poses), {i: se2.transform(pose, p) for i, p in t.landmarks.items()})

    arguments: dict[str, Any] = {"motion": world().motion, "sensor": world().sensor, "jobs": 1, "gauge_steps": 0}
    a = compare(["ekf"], recorded(), pose=world().pose, pose_covariance=np.eye(3) * 0.01, **arguments)
    b = compare(["ekf"], recorded(truth=moved), pose=world().pose, pose_covariance=np.eye(3) * 0.01, **arguments)
    for key in ("pose_nees", "position_rmse_m", "heading_rmse_deg", "landmark_nees", "landmark_rmse_m"):
        np.testing.assert_allclose(a.summary()["ekf"][key], b.summary()["ekf"][key], rtol=1e-7)
    relative = "relative_nees_per_dof"
    np.testing.assert_allclose(a.summary()["ekf"][relative], b.summary()["ekf"][relative], rtol=1e-7)
    assert not b.trials["ekf"][0].diverged
    # The sum of squares is least under the alignment.
    history, _ = b.rerun(0, "ekf")
    unaligned = history.poses[:, :2] - a.rerun(0, "ekf")[1].truth.poses[1:, :2]  # type: ignore[union-attr]
    assert a.summary()["ekf"]["position_rmse_m"] <= np.sqrt(np.mean(np.sum(unaligned**2, 1)))


@pytest.mark.parametrize("poses", [0, 1, 2, 3])
@pytest.mark.parametrize("landmarks", [0, 2, 5])
def test_a_recorded_log_has_only_errors_that_its_alignment_cannot_hide(poses: int, landmarks: int) -> None:
    """Two points fit any truth by a rigid motion: errors that are left say nothing about the filter."""

    def some(t: Truth) -> Truth:
        rows = np.linspace(1, len(t.times) - 1, poses).astype(int)
        return Truth(t.times[rows], t.poses[rows], dict(list(t.landmarks.items())[:landmarks]))

    arguments: dict[str, Any] = {"motion": world().motion, "sensor": world().sensor, "jobs": 1, "gauge_steps": 0}
    study = compare(["ekf"], recorded(truth=some), pose=world().pose, **arguments)
    s, (trial,) = study.summary()["ekf"], study.trials["ekf"]
    of_poses = {s[k] is not None for k in ("position_rmse_m", "heading_rmse_deg", "pose_nees")}
    assert of_poses == {poses >= 3}
    aligned = poses >= 3 or landmarks >= 3
    assert (s["landmark_rmse_m"] is not None) == (aligned and landmarks > 0)
    assert trial.error is None and not trial.diverged
    assert ("errors are left out" in (trial.note or "")) == (not aligned)
    if not aligned:
        assert f"{poses} poses and {landmarks} landmarks have a truth" in (trial.note or "")


@given(k=st.integers(0, 9), n=st.integers(1, 10))
def test_nees_is_left_out_only_where_the_error_contradicts_the_claim(k: int, n: int) -> None:
    k = k % n
    rng = np.random.default_rng(n)
    poses, P = rng.normal(size=(n, 3)), np.tile(np.eye(3), (n, 1, 1))
    P[k] = np.diag([1.0, 0.0, 1.0])
    notes: list[tuple[str, str]] = []
    values, dof = each_step(evaluate.pose_nees, poses, P, np.zeros((n, 3)), notes)
    assert np.isnan(values[k]) and dof[k] == 0 and len(notes) == 1
    others = np.arange(n) != k
    np.testing.assert_allclose(values[others], np.sum(poses[others] ** 2, 1), rtol=1e-12)
    assert np.all(dof[others] == 3)


@settings(max_examples=20)
@given(n=st.integers(1, 35), increments=st.booleans())
def test_the_beginning_of_a_log_is_its_first_steps(n: int, increments: bool) -> None:
    log = replace(simulate(world(), np.random.default_rng(2)), increments=increments)
    whole, part = log.schedule, log.head(n)
    assert len(part) == min(n, len(log))
    for a, b in zip(part, log, strict=False):
        assert (a.time, a.dt, a.scan.ids) == (b.time, b.dt, b.scan.ids)
        np.testing.assert_array_equal(np.asarray(a.u), np.asarray(b.u))
        np.testing.assert_array_equal(a.scan.z, b.scan.z)
    np.testing.assert_array_equal(part.schedule.times, whole.times[:n])


def test_a_history_that_cannot_be_judged_fails_its_own_trial() -> None:
    class Short(EKFSLAM):
        def run(self, log: Log, progress: Any = False) -> History:
            history = super().run(log, progress)
            return replace(history, landmarks=history.landmarks[:-1])

    study = small(filters={"ekf": EKFSLAM, "short": Short}, runs=2, gauge_steps=0, jobs=1)
    assert not [t for t in study.trials["ekf"] if t.error]
    assert all(t.error for t in study.trials["short"])
