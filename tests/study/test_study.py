"""Laws of Monte Carlo studies: what may not depend on how, where and in how many goes they are computed."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slamkit import EKFSLAM, History, InputError, Log, LogFileError, Truth, World, evaluate, se2, simulate
from slamkit.filters import FILTERS
from slamkit.models import RelativePosition, Unicycle
from slamkit.simulate import standing_world
from slamkit.study import Study, _beginning, _digest, _each_step, compare, run_trial

NAMES = ("ekf", "invariant", "ideal")
KEYS = {
    "pose_nees", "pose_nees_median", "pose_nees_above_6", "position_rmse_m", "heading_rmse_deg", "landmark_nees",
    "landmark_rmse_m", "relative_nees_per_dof", "nullity", "gauge_deviation_drop", "stochastic_gauge_m",
    "equivariance", "seconds_per_step", "diverged",
}  # fmt: skip


def world(steps: int = 30) -> World:
    """Five landmarks around a small circle, always in sight."""
    angle = 2 * np.pi * np.arange(5) / 5
    return World(
        name="small",
        landmarks={f"L{i}": 4 * np.array([np.cos(a), np.sin(a)]) for i, a in enumerate(angle)},
        motion=Unicycle(0.05, 0.05),
        sensor=RelativePosition(0.1),
        controls=np.tile([0.5, 0.25], (steps, 1)),
        dt=1.0,
        pose=np.array([0.0, -2.0, 0.0]),
        pose_covariance=np.diag([0.01, 0.01, 0.02**2]),
    )


def small(**changes: Any) -> Study:
    arguments: dict[str, Any] = {"runs": 4, "seed": 11, "jobs": 2, "gauge_steps": 8}
    return compare(changes.pop("filters", NAMES), changes.pop("world", world()), **(arguments | changes))


def assert_same(a: Study, b: Study) -> None:
    """Equal to the bit in everything but the measured times."""
    assert dict(a.facts) == dict(b.facts) and a.filters == b.filters and a.runs == b.runs
    np.testing.assert_array_equal(a.times, b.times)
    for name in a.filters:
        for mine, other in zip((*a.trials[name], a.gauge.get(name)), (*b.trials[name], b.gauge.get(name)), strict=True):
            assert type(mine) is type(other)
            for f in fields(mine) if mine is not None else ():
                if f.name != "seconds":
                    x, y = getattr(mine, f.name), getattr(other, f.name)
                    np.testing.assert_array_equal(np.asarray(x), np.asarray(y), f"{name}: {f.name}", strict=True)


@pytest.fixture(scope="module")
def study() -> Study:
    return small()


@pytest.mark.parametrize("jobs", [1, 3])
def test_result_does_not_depend_on_the_number_of_jobs(study: Study, jobs: int) -> None:
    assert_same(study, small(jobs=jobs))


def test_dask_with_two_workers_gives_the_same(study: Study) -> None:
    pytest.importorskip("distributed")
    assert_same(study, small(backend="dask", jobs=2))


def test_dask_uses_the_client_in_force_or_the_address(study: Study) -> None:
    distributed = pytest.importorskip("distributed")
    local = {"n_workers": 1, "threads_per_worker": 2, "processes": False, "dashboard_address": None}
    with distributed.LocalCluster(**local) as cluster, distributed.Client(cluster) as client:
        assert_same(study, small(backend="dask"))
        assert client.submit(int, 1).result() == 1, "a client that was there must stay open"
        assert len(client.scheduler_info()["workers"]) == 1
        assert cluster.scheduler_address.startswith("inproc://")
        assert_same(study, small(backend=cluster.scheduler_address))


@pytest.mark.filterwarnings("ignore:.*tasks which were still being processed:UserWarning")
def test_interrupted_study_resumes_to_the_same_result(study: Study, tmp_path: Path) -> None:
    class InterruptionError(Exception):
        pass

    def interrupt(done: int, total: int) -> None:
        if done == 4:
            raise InterruptionError

    with pytest.raises(InterruptionError):
        small(folder=tmp_path, progress=interrupt)
    kept = {p.name: p.stat().st_mtime_ns for p in tmp_path.iterdir()}
    assert len(kept) == 1 + 4
    with pytest.raises(LogFileError, match="unfinished"):
        Study.load(tmp_path)
    calls: list[tuple[int, int]] = []
    assert_same(study, small(folder=tmp_path, progress=lambda done, total: calls.append((done, total))))
    assert calls == [(done, 7) for done in range(4, 8)]
    for name in kept.keys() - {"study.npz"}:
        assert (tmp_path / name).stat().st_mtime_ns == kept[name], f"{name} was computed again"
    for name in ("trial-000002.npz", "gauge-1.npz"):
        (tmp_path / name).unlink()
    assert_same(study, small(folder=tmp_path))
    assert_same(study, Study.load(tmp_path))
    assert not [p for p in tmp_path.iterdir() if p.suffix != ".npz"]


def test_a_study_goes_on_to_more_runs(study: Study, tmp_path: Path) -> None:
    first = small(runs=2, folder=tmp_path)
    for name in NAMES:
        for a, b in zip(first.trials[name], study.trials[name], strict=False):
            np.testing.assert_array_equal(a.errors, b.errors)
    calls: list[int] = []
    assert_same(study, small(folder=tmp_path, progress=lambda done, total: calls.append(done)))
    assert calls == [5, 6, 7]
    assert Study.load(tmp_path).runs == 4


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"seed": 12}, "seed"),
        ({"filters": ("ekf",)}, "filters"),
        ({"world": world(29)}, "world_content"),
        ({"motion": Unicycle(0.05, 0.06)}, "motion"),
        ({"sensor": RelativePosition(0.11)}, "sensor"),
        ({"options": {"order": "batch"}}, "options"),
        ({"pose_covariance": np.eye(3)}, "start"),
        ({"diverged_at": 2.0}, "diverged_at"),
    ],
)
def test_a_folder_with_other_settings_is_refused(study: Study, tmp_path: Path, change: Any, named: str) -> None:
    study.save(tmp_path)
    before = {p: p.read_bytes() for p in tmp_path.iterdir()}
    with pytest.raises(InputError, match=rf"other settings.*{named}"):
        small(folder=tmp_path, **change)
    assert {p: p.read_bytes() for p in tmp_path.iterdir()} == before


def test_a_trial_rerun_alone_is_the_studys(study: Study) -> None:
    for k in range(study.runs):
        for name in NAMES:
            for history, log in (study.rerun(k, name), run_trial(world(), 11, k, name)):
                assert log.truth is not None
                trial = study.trials[name][k]
                error = evaluate.state_error(history.poses, log.truth.poses[1:])
                np.testing.assert_array_equal(error, trial.errors)
                sigmas = np.sqrt(np.diagonal(history.pose_covariances, axis1=1, axis2=2))
                np.testing.assert_array_equal(sigmas, trial.sigmas)
                assert trial.nis_mean == history.nis[np.isfinite(history.nis)].mean()


@settings(max_examples=15)
@given(seed=st.integers(0, 2**64), k=st.integers(0, 6))
def test_trials_are_seeded_by_spawning(seed: int, k: int) -> None:
    short = world(3)
    expected = simulate(short, np.random.default_rng(np.random.SeedSequence(seed).spawn(7)[k]))
    _, log = run_trial(short, seed, k, "ekf")
    np.testing.assert_array_equal(log.observations, expected.observations)
    np.testing.assert_array_equal(log.controls, expected.controls)


def test_summary_is_what_the_trials_say(study: Study) -> None:
    summary = study.summary()
    assert tuple(summary) == NAMES
    json.dumps(summary, allow_nan=False)
    for name, s in summary.items():
        assert set(s) >= KEYS
        logs = [study.rerun(k, name) for k in range(study.runs)]
        poses = np.array([h.poses for h, _ in logs])
        truth = np.array([log.truth.poses[1:] for _, log in logs if log.truth is not None])
        nees = evaluate.pose_nees(poses, np.array([h.pose_covariances for h, _ in logs]), truth).values
        expected = evaluate.summary(nees, 3)
        np.testing.assert_allclose(s["pose_nees"], expected.mean, rtol=1e-12)
        np.testing.assert_allclose(s["pose_nees_se"], expected.standard_error, rtol=1e-12)
        np.testing.assert_allclose(s["pose_nees_median"], expected.median, rtol=1e-12)
        assert s["pose_nees_above_6"] == expected.share_above
        error = evaluate.state_error(poses, truth)
        rmse = np.sqrt(np.mean(np.sum(error[..., :2] ** 2, -1)))
        np.testing.assert_allclose(s["position_rmse_m"], rmse, rtol=1e-12)
        heading = np.degrees(np.sqrt(np.mean(error[..., 2] ** 2)))
        np.testing.assert_allclose(s["heading_rmse_deg"], heading, rtol=1e-12)
        of = [[log.truth.landmarks[i] for i in h.landmark_ids] for h, log in logs if log.truth is not None]
        off = np.array([h.landmarks for h, _ in logs]) - np.array(of)
        np.testing.assert_allclose(s["landmark_rmse_m"], np.sqrt(np.mean(np.sum(off**2, -1))), rtol=1e-12)
        squares = np.sum(error[..., :2] ** 2, -1).mean(1)
        spread = np.std(squares, ddof=1) / np.sqrt(len(squares)) / (2 * rmse)
        np.testing.assert_allclose(s["position_rmse_m_se"], spread, rtol=1e-9)
        assert s["runs"] == s["finished"] == 4 and s["diverged"] == 0
        assert 0 < s["seconds_per_step"] < 0.1
        assert s["pose_nees_low"] < 3 < s["pose_nees_high"] and s["relative_nees_low"] < 1 < s["relative_nees_high"]
        assert 0.3 < s["relative_nees_per_dof"] < 3


def test_the_standard_filter_alone_learns_its_gauge(study: Study) -> None:
    ekf, invariant = study.summary()["ekf"], study.summary()["invariant"]
    assert (ekf["nullity"], invariant["nullity"]) == (2, 3)
    assert ekf["gauge_deviation_drop"] > 0.01 and invariant["gauge_deviation_drop"] < 1e-9
    assert ekf["stochastic_gauge_m"] > 1e-6 and invariant["stochastic_gauge_m"] < 1e-9
    assert max(ekf["equivariance"], invariant["equivariance"]) < 1e-9
    for check in study.gauge.values():
        assert check.error is None and len(check.deviations) == len(check.times) == 8


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


def unlucky(log: Log) -> bool:
    return round(1e6 * float(log.observations[0, 0])) % 2 == 1


class Changed(EKFSLAM):
    """An EKF that goes wrong in the trials whose first measurement is an odd number of micrometres."""

    name = "changed"
    way = "raises"

    def run(self, log: Log, progress: Any = False) -> History:
        history = super().run(log, progress)
        if not unlucky(log):
            return history
        if self.way == "raises":
            raise RuntimeError("out of luck")
        return replace(history, poses=history.poses + (np.nan if self.way == "nan" else 1e3))


class Nan(Changed):
    way = "nan"


class Lost(Changed):
    way = "lost"


@pytest.fixture(scope="module")
def troubled() -> Study:
    return small(filters={"ekf": EKFSLAM, "raises": Changed, "nan": Nan, "lost": Lost}, runs=8)


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
    assert report.count("out of luck") == len(wrong) and "beyond 1 times" in report
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


def test_save_and_load_round_trip(study: Study, troubled: Study, tmp_path: Path) -> None:
    for n, s in enumerate((study, troubled)):
        s.save(tmp_path / str(n))
        loaded = Study.load(tmp_path / str(n))
        assert_same(s, loaded)
        assert loaded.summary() == s.summary() and loaded.report() == s.report()
        with pytest.raises(InputError, match=r"run_trial\(world, 11, 1, 'ekf'\)"):
            loaded.rerun(1, "ekf")
    with pytest.raises(LogFileError, match="study"):
        Study.load(tmp_path)
    for name in ("trial-000001.npz", "gauge-0.npz", "study.npz"):
        path = tmp_path / "0" / name
        path.write_bytes(path.read_bytes()[:200])
        with pytest.raises(LogFileError, match=name):
            Study.load(tmp_path / "0")


def test_table_frame_and_report_hold_every_filter(study: Study, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = study.table()
    assert [(r["filter"], r["trial"]) for r in rows] == [(n, k) for n in NAMES for k in range(4)]
    for name, s in study.summary().items():
        mean = np.mean([r["pose_nees"] for r in rows if r["filter"] == name])
        np.testing.assert_allclose(mean, s["pose_nees"], rtol=1e-12)
    report = study.report()
    for name, s in study.summary().items():
        assert report.count(f"| {name} |") == 2 and f"{s['position_rmse_m']:.3f}" in report
    assert "4 runs of 30 steps" in report and "Failed" not in report
    pandas = pytest.importorskip("pandas")
    pandas.testing.assert_frame_equal(study.frame(), pandas.DataFrame(rows))
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match=r"slamkit\[pandas\]"):
        study.frame()


def test_figures(study: Study) -> None:
    figures = study.figures()
    assert set(figures) == {"overview", "nees", "claims", "coverage", "bars", "cost", "gauge"}
    for name, figure in figures.items():
        figure.canvas.draw()
        assert figure.axes, name
    title = figures["overview"].get_suptitle()
    assert f"{study.summary()['ekf']['relative_nees_per_dof']:.2f} in the relative map" in title


def told(study: Study, gauge: Any, relative: Any, drop: float, simulated: bool = True) -> list[str]:
    """What a study says that has these NEES per degree of freedom: filter → one value a run."""
    trials = {
        name: tuple(
            replace(t, gauge_nees=t.gauge_dof * float(g), relative_nees=t.relative_dof * float(r))
            for t, g, r in zip(study.trials[name], gauge[name], relative[name], strict=True)
        )
        for name in study.filters
    }
    checks = {name: replace(c, deviation_drop=drop if name == "ekf" else 0.0) for name, c in study.gauge.items()}
    return replace(study, trials=trials, gauge=checks, facts={**study.facts, "simulated": simulated}).findings()


def test_findings_say_no_more_than_the_numbers(study: Study) -> None:
    right = {name: [1.0] * 4 for name in NAMES}
    wrong = right | {"ekf": [2.0, 20.0, 9.0, 9.0]}
    assert told(study, right, right, 0.6) == ["No filter is seen to claim too little in 4 runs."]
    too_little, why = told(study, wrong, right, 0.6)
    assert too_little.endswith("in the gauge ekf 10.00.") and "relative" not in too_little
    assert why.startswith("All of the ekf's inconsistency (10.00 in the gauge, 1.00 in the relative map)")
    assert "falls by up to 60%" in why
    assert told(study, wrong, right, 1e-4) == [too_little]
    both, why = told(study, wrong, right | {"ekf": [3.0] * 4, "invariant": [5.0] * 4}, 0.6)
    assert both.endswith("in the gauge ekf 10.00; in the relative map invariant 5.00, ekf 3.00.")
    assert "too sure of its relative map as well" in why
    (aligned,) = told(study, wrong, right, 0.6, simulated=False)
    assert (
        aligned
        == "Claim to have learnt the gauge, which nothing measures: ekf (its claimed deviation falls by up to 60%)."
    )


def test_consistent_filters_are_seldom_said_to_claim_too_little(study: Study) -> None:
    rng = np.random.default_rng(1)
    dof = study.trials["ekf"][0].relative_dof
    said = 0
    for _ in range(400):
        gauge, relative = ({name: rng.chisquare(d, 4) / d for name in NAMES} for d in (3, dof))
        said += "too little (" in told(study, gauge, relative, 0.0)[0]
    assert 0.01 < said / 400 < 0.09  # 5 %, give or take three standard deviations


def test_in_the_standing_world_the_standard_filter_learns_its_gauge_and_errs_in_nothing_else() -> None:
    study = compare(["ekf", "invariant"], standing_world(), 10, 1, jobs=1, gauge_steps=100)
    too_little, why = study.findings()
    assert "ekf" in too_little and "invariant" not in too_little and "relative" not in too_little
    assert why.startswith("All of the ekf's inconsistency")
    assert "All that is inconsistent in the EKF is a gauge" in study.overview().get_suptitle()
    assert " ".join(study.findings()) in study.report()


@pytest.mark.parametrize("heading", [0.0, 0.1])
def test_gauge_bounds_are_of_the_rank_that_the_gauge_has(heading: float) -> None:
    start = np.diag([0.01, 0.01, heading**2])
    still = replace(world(6), motion=Unicycle(0.0, 0.0), pose_covariance=start)
    s = compare(["invariant"], still, 5, 2, jobs=1, gauge_steps=0)
    dof = s.trials["invariant"][0].gauge_dof
    assert dof == (3 if heading else 2)
    bounds = evaluate.chi2_bounds(dof, 5)
    np.testing.assert_allclose(s.summary()["invariant"]["gauge_nees_low"], 3 * bounds.lower / dof)
    np.testing.assert_allclose(s.summary()["invariant"]["gauge_nees_high"], 3 * bounds.upper / dof)


def recorded(tmp_path: Path | None = None, truth: Callable[[Truth], Truth | None] = lambda t: t) -> Any:
    log = simulate(world(), np.random.default_rng(5))
    assert log.truth is not None
    log = replace(log, truth=truth(log.truth))
    if tmp_path is None:
        return log
    log.write_csv(tmp_path, observations=("x", "y"))
    return tmp_path


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


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"filters": ["ekf", "efk"]}, "'efk' is unknown, expected some of ekf"),
        ({"filters": []}, "empty"),
        ({"filters": ["ekf", "ekf"]}, "twice"),
        ({"filters": {"mine": 3}}, "class or factory"),
        ({"runs": 0}, "runs is 0"),
        ({"runs": 2.5}, "runs is 2.5"),
        ({"seed": -1}, "seed is -1"),
        ({"jobs": 0}, "jobs is 0"),
        ({"backend": "threads"}, "backend is 'threads'"),
        ({"diverged_at": 0.0}, "diverged_at is 0.0"),
        ({"max_gap": float("nan")}, "max_gap is nan"),
        ({"gauge_steps": -1}, "gauge_steps is -1"),
        ({"pose": (0, 0)}, "pose has shape"),
        ({"world": 7}, "world is a int"),
        ({"world": "no/such/folder"}, "no/such/folder"),
        ({"world": recorded(), "runs": 3}, "1 run"),
        ({"world": recorded(), "runs": 1}, "motion="),
    ],
)
def test_wrong_arguments_are_refused_at_once(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        small(folder=tmp_path / "study", **change)
    assert not (tmp_path / "study").exists()


@given(k=st.integers(0, 9), n=st.integers(1, 10))
def test_nees_is_left_out_only_where_the_error_contradicts_the_claim(k: int, n: int) -> None:
    k = k % n
    rng = np.random.default_rng(n)
    poses, P = rng.normal(size=(n, 3)), np.tile(np.eye(3), (n, 1, 1))
    P[k] = np.diag([1.0, 0.0, 1.0])
    notes: list[str] = []
    values, dof = _each_step(evaluate.pose_nees, poses, P, np.zeros((n, 3)), notes)
    assert np.isnan(values[k]) and dof[k] == 0 and len(notes) == 1
    others = np.arange(n) != k
    np.testing.assert_allclose(values[others], np.sum(poses[others] ** 2, 1), rtol=1e-12)
    assert np.all(dof[others] == 3)


@settings(max_examples=20)
@given(n=st.integers(1, 35), increments=st.booleans())
def test_the_beginning_of_a_log_is_its_first_steps(n: int, increments: bool) -> None:
    log = replace(simulate(world(), np.random.default_rng(2)), increments=increments)
    whole, part = log.schedule, _beginning(log, n)
    assert len(part) == min(n, len(log))
    for a, b in zip(part, log, strict=False):
        assert (a.time, a.dt, a.scan.ids) == (b.time, b.dt, b.scan.ids)
        np.testing.assert_array_equal(np.asarray(a.u), np.asarray(b.u))
        np.testing.assert_array_equal(a.scan.z, b.scan.z)
    np.testing.assert_array_equal(part.schedule.times, whole.times[:n])


def test_every_part_of_a_world_counts_for_its_digest() -> None:
    base = world()
    changes: dict[str, Any] = {
        "name": "other", "landmarks": {**base.landmarks, "L0": np.ones(2)}, "motion": Unicycle(0.05, 0.051),
        "sensor": RelativePosition(0.2), "controls": base.controls[1:], "dt": 0.5, "pose": np.ones(3),
        "pose_covariance": np.eye(3), "max_range": 9.0, "min_range": 0.1, "field_of_view": 1.0,
        "detection_probability": 0.5, "odometry": True, "increments": True,
    }  # fmt: skip
    assert set(changes) == {f.name for f in fields(base)}
    digests = [_digest(replace(base, **{name: value})) for name, value in changes.items()]
    assert len({_digest(base), *digests}) == 1 + len(digests)
    assert _digest(world()) == _digest(base)
