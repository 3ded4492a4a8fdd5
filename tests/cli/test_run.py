"""Laws of `slamkit run csv` and of the summary behind it."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import takewhile
from pathlib import Path

import numpy as np
import pytest
from commands import KEYS, contents, fails, is_png, slamkit, strict_json, succeeds, write_csv

from slamkit import EKFSLAM, History, InputError, Log, Truth, plots
from slamkit.evaluate import run_report
from slamkit.filters import FILTERS
from slamkit.models import (
    MOTIONS,
    SENSORS,
    RangeBearing,
    Unicycle,
    parameters_of,
)
from slamkit.simulate import WORLDS, simulate


def outliers(folder: Path) -> None:
    """Make every seventh sighting of the log wrong by 3 m."""
    path = folder / "observations.csv"
    header, *rows = path.read_text().splitlines()
    for n in range(6, len(rows), 7):
        t, i, r, b = rows[n].split(",")
        rows[n] = f"{t},{i},{float(r) + 3},{b}"
    path.write_text("\n".join([header, *rows]))


# ---- simulate, run csv ----


@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.usefixtures("no_figures")
def test_a_world_comes_back_from_its_files_to_the_bit(world: str, tmp_path: Path) -> None:
    made = WORLDS[world]()
    log = simulate(made, np.random.default_rng(3))
    expected = EKFSLAM(made.motion, made.sensor, made.pose, made.pose_covariance).run(log)
    succeeds("simulate", world, "--seed", 3, "--out", tmp_path / "log")
    succeeds("run", "csv", tmp_path / "log", "--out", tmp_path / "out")
    got = History.load(tmp_path / "out" / "history.npz")
    for name in ("times", "poses", "pose_covariances", "innovations", "nis", "landmarks", "landmark_covariances"):
        np.testing.assert_array_equal(getattr(got, name), getattr(expected, name), err_msg=name)
    assert got.landmark_ids == expected.landmark_ids


def test_one_seed_gives_the_same_bytes_and_another_one_others(tmp_path: Path, lesson: Path) -> None:
    for name, seed in (("same", 1), ("other", 2)):
        succeeds("simulate", "lesson", "--seed", seed, "--out", tmp_path / name)
    assert contents(tmp_path / "same") == contents(lesson)
    assert contents(tmp_path / "other")["controls.csv"] == contents(lesson)["controls.csv"]  # commands have no noise
    assert contents(tmp_path / "other")["observations.csv"] != contents(lesson)["observations.csv"]


def test_two_runs_write_the_same_bytes_but_for_the_time_they_took(tmp_path: Path, lesson: Path) -> None:
    for name in "ab":
        succeeds("run", "csv", lesson, "--out", tmp_path / name)
    a, b = contents(tmp_path / "a"), contents(tmp_path / "b")
    assert a.keys() == b.keys()
    for name in a.keys() - {"summary.json", "history.npz"}:
        assert a[name] == b[name], name
    first, second = (strict_json(tmp_path / name / "summary.json") for name in "ab")
    assert first | {"seconds": 0} == second | {"seconds": 0}


def test_json_has_the_promised_keys_and_the_library_gives_the_same_numbers(loop: Path, tmp_path: Path) -> None:
    succeeds("run", "csv", loop, "--json", tmp_path / "run.json")
    got = strict_json(tmp_path / "run.json")
    assert {name: type(value) for name, value in got.items()} == KEYS
    log, world = Log.read_csv(loop), WORLDS["loop"]()
    history = EKFSLAM(world.motion, world.sensor, world.pose, world.pose_covariance).run(log)
    assert got | {"seconds": history.seconds} == run_report.summarise(history, log, world.motion, world.pose)
    assert (got["filter"], got["steps"], got["landmarks"]) == ("ekf", len(log), 20)
    assert (got["observations"], got["rejected"]) == (len(log.observations), 0)


def test_the_filter_is_far_better_than_dead_reckoning(loop: Path, tmp_path: Path) -> None:
    succeeds("run", "csv", loop, "--json", tmp_path / "run.json")
    got = strict_json(tmp_path / "run.json")
    assert got["ate_m"] < 0.1 * got["dead_reckoning_ate_m"]
    assert got["landmark_rmse_m"] < 0.5
    assert 1.85 < got["nis_mean"] < 2.15
    assert got["nis_dof_mean"] == 2.0


def test_the_table_shows_the_numbers_of_the_json(loop: Path, tmp_path: Path) -> None:
    text = succeeds("run", "csv", loop, "--json", tmp_path / "run.json")
    got = strict_json(tmp_path / "run.json")
    for name in ("ate_m", "dead_reckoning_ate_m", "landmark_rmse_m", "heading_rmse_deg", "nis_mean"):
        assert f" {got[name]:.3f} " in text, name
    for name in ("steps", "observations", "landmarks"):
        assert f" {got[name]} " in text, name
    (row,) = (line for line in text.splitlines() if "poses with a truth" in line)
    assert row.count(f" {got['matched']} ") == 2  # the filter's and dead reckoning's
    assert "--motion unicycle --motion-noise 0.008839,0.03536 --sensor relative --sensor-noise 0.1" in text


def test_summary_averages_what_corrected_the_belief(lesson: Path) -> None:
    outliers(lesson)
    log, motion = Log.read_csv(lesson), Unicycle(0.05, 0.05)
    history = EKFSLAM(motion, RangeBearing(0.1, 0.035), gate=9.0).run(log)
    got = run_report.summarise(history, log, motion)
    first = np.isnan(history.nis)
    assert got["rejected"] == np.count_nonzero(~history.accepted) > 0
    assert got["nis_mean"] == pytest.approx(np.mean([n for n in history.nis[~first] if n <= 9.0]), rel=1e-12)


@pytest.mark.usefixtures("no_figures")
def test_a_history_without_a_time_is_written_into_a_new_folder_as_json(lesson: Path, tmp_path: Path) -> None:
    log, motion = Log.read_csv(lesson), Unicycle(0.05, 0.05)
    history = replace(EKFSLAM(motion, RangeBearing(0.1, 0.035)).run(log), seconds=float("nan"))
    run_report.write_run(tmp_path / "a" / "b", run_report.assess(history, log, motion), log)
    assert strict_json(tmp_path / "a" / "b" / "summary.json")["seconds"] is None


def test_summary_refuses_the_history_of_another_log(lesson: Path) -> None:
    log, motion = Log.read_csv(lesson), Unicycle(0.05, 0.05)
    history = EKFSLAM(motion, RangeBearing(0.1, 0.035)).run(log)
    with pytest.raises(InputError, match="another log"):
        run_report.summarise(replace(history, times=history.times + 0.01), log, motion)


def test_null_where_there_is_no_truth(lesson: Path, tmp_path: Path) -> None:
    accuracy = {"ate_m", "dead_reckoning_ate_m", "landmark_rmse_m", "heading_rmse_deg"}
    succeeds("run", "csv", lesson, "--json", tmp_path / "with.json")
    (lesson / "truth.csv").unlink()
    succeeds("run", "csv", lesson, "--json", tmp_path / "map.json")
    (lesson / "landmarks.csv").unlink()
    text = succeeds("run", "csv", lesson, "--json", tmp_path / "none.json", "--plot", tmp_path / "none.png")
    before, landmarks, none = (strict_json(tmp_path / f"{n}.json") for n in ("with", "map", "none"))
    assert not {n for n, value in before.items() if value is None}
    assert {n for n, value in landmarks.items() if value is None} == accuracy - {"landmark_rmse_m"}
    assert {n for n, value in none.items() if value is None} == accuracy
    assert none["nis_mean"] == before["nis_mean"]
    assert is_png(tmp_path / "none.png")
    assert "nan" not in text.lower()


def test_null_where_nothing_was_sighted(tmp_path: Path) -> None:
    log = write_csv(
        tmp_path / "log", controls="t,v,omega\n0,1,0\n1,1,0.1\n2,0,0\n", observations="t,id,range,bearing\n"
    )
    succeeds("run", "csv", log, "--out", tmp_path / "out")
    got = strict_json(tmp_path / "out" / "summary.json")
    assert (got["observations"], got["landmarks"], got["nis_mean"], got["nis_dof_mean"]) == (0, 0, None, None)
    assert is_png(tmp_path / "out" / "overview.png")


def test_out_holds_the_whole_run(lesson: Path, tmp_path: Path) -> None:
    out = tmp_path / "new" / "folder"
    succeeds(
        "run", "csv", lesson, "--out", out, "--json", tmp_path / "there" / "run.json", "--save", tmp_path / "f.npz"
    )
    names = {"summary.json", "trajectory.txt", "trajectory.csv", "map.csv", "history.npz", "overview.png"}
    assert contents(out).keys() == names
    history = History.load(out / "history.npz")
    assert (out / "summary.json").read_bytes() == (tmp_path / "there" / "run.json").read_bytes()
    tum = np.loadtxt(out / "trajectory.txt")
    np.testing.assert_array_equal(tum[:, :3], np.column_stack([history.times, history.poses[:, :2]]))
    assert [int(line.split(",")[0]) for line in (out / "map.csv").read_text().splitlines()[1:]] == [0, 1, 2]
    assert is_png(out / "overview.png")
    loaded = EKFSLAM.load(tmp_path / "f.npz")
    np.testing.assert_array_equal(loaded.pose, history.poses[-1])
    np.testing.assert_array_equal(list(loaded.landmarks.values()), history.landmarks)


@pytest.mark.parametrize("ending", [".png", ".pdf", ".svg", ".jpg", ".txt", ""])
def test_figures_may_have_the_endings_that_can_be_drawn(ending: str, lesson: Path, tmp_path: Path) -> None:
    from matplotlib.figure import Figure

    file = tmp_path / f"figure{ending}"
    try:
        plots.save(Figure(), file)
    except InputError:
        assert ".png, .pdf, .svg" in fails("run", "csv", lesson, "--plot", file)
        assert not file.exists()
    else:
        before = file.read_bytes()
        succeeds("run", "csv", lesson, "--plot", file)
        assert file.read_bytes() != before


def test_quiet_prints_nothing(lesson: Path, tmp_path: Path) -> None:
    assert succeeds("run", "csv", lesson, "--quiet") == ""
    assert succeeds("simulate", "lesson", "--out", tmp_path / "a", "--quiet") == ""


@pytest.mark.parametrize("name", FILTERS)
def test_every_filter_runs_under_its_name(name: str, lesson: Path, tmp_path: Path) -> None:
    succeeds("run", "csv", lesson, "--filter", name, "--json", tmp_path / "run.json")
    assert strict_json(tmp_path / "run.json")["filter"] == name


# ---- the first steps ----


def random_log(seed: int, increments: bool) -> Log:
    """A log with ties, repeated sightings of one instant, and sightings before, between and after the controls."""
    rng = np.random.default_rng(seed)
    ct = rng.permutation(20)[:8].astype(float) + 3 if increments else rng.integers(3, 20, 8).astype(float)
    n = 25
    return Log(
        control_times=ct,
        controls=rng.normal(size=(8, 3 if increments else 2)),
        observation_times=rng.integers(0, 56, n) / 2,
        observation_ids=rng.integers(0, 3, n),
        observations=rng.uniform(1, 2, (n, 2)),
        landmark_ids=("a", "b", "c"),
        end_time=float(ct.max() + rng.integers(1, 4)),
        increments=increments,
        truth=Truth(np.arange(30.0), np.zeros((30, 3))),
    )


@pytest.mark.parametrize("increments", [False, True])
@pytest.mark.parametrize("seed", range(10))
def test_first_steps_are_those_of_the_whole_log(seed: int, increments: bool) -> None:
    log = random_log(seed, increments)
    steps = list(log)
    for m in range(1, len(steps) + 2):
        short = log.head(m)
        part = list(short)
        assert len(part) == min(m, len(steps))
        assert short.truth is not None
        assert log.truth is not None
        for step in part:  # the true pose that is nearest to a step stays, and so do those before it
            nearest = log.truth.times[np.argmin(np.abs(log.truth.times - step.time))]
            assert short.truth.times[np.argmin(np.abs(short.truth.times - step.time))] == nearest
        assert short.truth.times.tolist() == log.truth.times[: len(short.truth.times)].tolist()
        for a, b in zip(part, steps, strict=False):
            assert (a.time, a.dt, a.scan.ids) == (b.time, b.dt, b.scan.ids)
            np.testing.assert_array_equal(a.scan.z, b.scan.z)
            assert (a.u is None) == (b.u is None)
            if a.u is not None and b.u is not None:
                np.testing.assert_array_equal(a.u, b.u)


@pytest.mark.usefixtures("no_figures")
def test_max_steps_is_the_beginning_of_the_run(loop: Path, tmp_path: Path) -> None:
    succeeds("run", "csv", loop, "--out", tmp_path / "all")
    whole = History.load(tmp_path / "all" / "history.npz")
    for m in (1, 300, len(whole.times), len(whole.times) + 1):
        succeeds("run", "csv", loop, "--max-steps", m, "--out", tmp_path / "some")
        some = History.load(tmp_path / "some" / "history.npz")
        k = min(m, len(whole.times))
        np.testing.assert_array_equal(some.poses, whole.poses[:k])
        np.testing.assert_array_equal(some.pose_covariances, whole.pose_covariances[:k])
        assert strict_json(tmp_path / "some" / "summary.json")["steps"] == k


# ---- JSON on standard output ----


@pytest.mark.usefixtures("no_figures")
def test_json_on_standard_output_is_all_that_is_there(lesson: Path, tmp_path: Path) -> None:
    succeeds("run", "csv", lesson, "--json", tmp_path / "run.json")
    for quiet in ((), ("--quiet",)):
        done = slamkit("run", "csv", lesson, "--json", "-", "--out", tmp_path / "out", *quiet)
        assert done.exit_code == 0
        assert json.loads(done.stdout) | {"seconds": 0} == strict_json(tmp_path / "run.json") | {"seconds": 0}
        assert ("trajectory error" in done.stderr) is not bool(quiet)
    assert not Path("-").exists()


# ---- models.json as it is documented ----


def rows_of(text: str, model: str) -> list[str]:
    """The rows of a table that belong to a model: that with its name, and those below without a name."""
    lines = text[text.index(f"| `{model}` |") :].splitlines()
    return [lines[0], *takewhile(lambda line: line.startswith("| |"), lines[1:])]


def test_the_documents_example_of_models_json_runs_and_its_tables_are_complete(lesson: Path, tmp_path: Path) -> None:
    text = (Path(__file__).resolve().parents[2] / "docs" / "models-json.md").read_text(encoding="utf-8")
    for kind in (*MOTIONS.values(), *SENSORS.values()):
        assert f"`{kind.__name__}`" in text
        block = rows_of(text, kind.__name__)
        if "as `" in block[0]:
            block = rows_of(text, block[0].split("as `")[1].split("`")[0])
        for name, (unit, typical) in parameters_of(kind).items():
            (row,) = (line for line in block if f"| `{name}` |" in line)
            assert f"| {unit} | {typical:g} |" in row
    example = text[text.index("    {\n") : text.index("    }\n") + 6]
    (tmp_path / "mine.json").write_text(example)
    said = text[text.index("Models: ") :].splitlines()[0]
    assert said in succeeds("run", "csv", lesson, "--models", tmp_path / "mine.json")
