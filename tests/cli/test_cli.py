"""Laws of the command line and of the summary behind it: what it writes, what it prints, how it fails."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from slamkit import EKFSLAM, History, InputError, Log, Truth, cli, plots, study
from slamkit.datasets import mrclam
from slamkit.evaluate import run_report
from slamkit.filters import FILTERS
from slamkit.models import EulerUnicycle, Odometry, RangeBearing, RelativePosition, Unicycle, model_to_dict
from slamkit.simulate import WORLDS, simulate, standing_world

KEYS = {
    "filter": str,
    "steps": int,
    "observations": int,
    "rejected": int,
    "landmarks": int,
    "ate_m": float,
    "dead_reckoning_ate_m": float,
    "landmark_rmse_m": float,
    "heading_rmse_deg": float,
    "matched": int,
    "nis_mean": float,
    "nis_dof_mean": float,
    "seconds": float,
}


def slamkit(*arguments: object) -> Result:
    return CliRunner().invoke(cli.app, [str(a) for a in arguments], prog_name="slamkit")


def succeeds(*arguments: object) -> str:
    """Standard output of a command that succeeds; nothing is on stderr, which is no terminal here."""
    done = slamkit(*arguments)
    assert done.exit_code == 0, done.output
    assert done.stderr == ""
    return done.stdout


def fails(*arguments: object) -> str:
    """The one line on stderr of a command that fails."""
    done = slamkit(*arguments)
    assert done.exit_code == 2, done.output
    assert isinstance(done.exception, SystemExit)
    assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert line.startswith("error: ")
    return line


def strict_json(path: Path) -> dict[str, Any]:
    """What a JSON file holds; NaN and Infinity are no JSON."""

    def refuse(constant: str) -> None:
        raise AssertionError(f"{path} holds {constant}")

    facts = json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)
    assert isinstance(facts, dict)
    return facts


def contents(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def is_png(path: Path) -> bool:
    data = path.read_bytes()
    return data.startswith(b"\x89PNG\r\n\x1a\n") and data.endswith(b"IEND\xaeB`\x82")


def write_csv(folder: Path, **files: str) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / f"{name}.csv").write_text(text)
    return folder


@pytest.fixture(scope="module")
def loop(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The loop world as CSV files; tests read it only."""
    folder = tmp_path_factory.mktemp("logs") / "loop"
    succeeds("simulate", "loop", "--seed", 5, "--out", folder)
    return folder


@pytest.fixture
def lesson(tmp_path: Path) -> Path:
    """A short log that a test may change."""
    succeeds("simulate", "lesson", "--seed", 1, "--out", tmp_path / "lesson")
    return tmp_path / "lesson"


@pytest.fixture
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """For tests that look at other files: drawing is most of what a short run costs."""
    monkeypatch.setattr(run_report, "write_figure", lambda *_: None)


def outliers(folder: Path) -> None:
    """Make every seventh sighting of the log wrong by 3 m."""
    path = folder / "observations.csv"
    header, *rows = path.read_text().splitlines()
    for n in range(6, len(rows), 7):
        t, i, r, b = rows[n].split(",")
        rows[n] = f"{t},{i},{float(r) + 3},{b}"
    path.write_text("\n".join([header, *rows]))


def break_at(folder: Path, row: int) -> None:
    """Make one sighting's range negative: the log can be read, but not be run beyond there."""
    path = folder / "observations.csv"
    rows = path.read_text().splitlines()
    t, i, _, b = rows[row].split(",")
    rows[row] = f"{t},{i},-1.0,{b}"
    path.write_text("\n".join(rows))


# ---- a process of its own ----


def test_console_script_starts_quickly_and_without_heavy_imports() -> None:
    code = (
        "import sys; from slamkit.cli import main\n"
        "heavy = {'matplotlib', 'numba', 'pandas', 'pooch', 'dask', 'joblib'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
        "sys.argv = ['slamkit', 'run', 'csv', 'nowhere']; main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert line.startswith("error: nowhere/controls.csv")


@pytest.mark.skipif(sys.platform == "win32", reason="signals as on POSIX")
def test_ctrl_c_of_a_process_exits_with_130() -> None:
    code = (
        "import os, signal; from slamkit import cli\n"
        # A shell's background job ignores the signal, and so would its children.
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "def interrupt(*a, **k): os.kill(os.getpid(), signal.SIGINT); __import__('time').sleep(20)\n"
        "cli.simulate = interrupt\n"
        "import sys; sys.argv = ['slamkit', 'simulate', 'loop', '--out', 'never-written']; cli.main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 128 + signal.SIGINT
    assert "Traceback" not in done.stderr
    assert not Path("never-written").exists()


# ---- help ----


@pytest.mark.parametrize(
    "command", [(), ("demo",), ("run",), ("run", "mrclam"), ("run", "csv"), ("simulate",), ("fetch",), ("compare",)]
)
def test_every_help_has_an_example_that_begins_with_the_command(command: tuple[str, ...]) -> None:
    text = " ".join(succeeds(*command, "--help").split())
    assert f"Example: {' '.join(('slamkit', *command))}" in text


def test_help_names_every_filter_model_and_world() -> None:
    text = succeeds("run", "csv", "--help")
    for name in (*FILTERS, *cli.MOTIONS, *cli.SENSORS):
        assert name in text
    assert all(name in succeeds("simulate", "--help") for name in WORLDS)
    for kind in (*cli.MOTIONS.values(), *cli.SENSORS.values()):
        assert ",".join(f"{x:g}" for x in kind.default) in text.replace(" ", "")


def test_version() -> None:
    import slamkit as package

    assert succeeds("--version") == f"slamkit {package.__version__}\n"


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
        beginning = cli._beginning(log, m)
        part = list(beginning)
        assert len(part) == min(m, len(steps))
        assert beginning.truth is not None
        assert beginning.truth.times.tolist() == [t for t in range(30) if m >= len(steps) or t <= steps[m].time]
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


# ---- models ----


def test_options_go_before_the_file_and_the_file_before_the_columns(
    lesson: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[Any] = []

    class Recording(EKFSLAM):
        def __init__(self, *arguments: Any, **more: Any) -> None:
            super().__init__(*arguments, **more)
            made.append(self)

    monkeypatch.setitem(FILTERS, "ekf", Recording)

    def models(*options: object) -> tuple[Any, Any]:
        succeeds("run", "csv", lesson, *options)
        return made[-1].motion, made[-1].sensor

    world = WORLDS["lesson"]()
    assert models() == (world.motion, world.sensor)
    assert models("--motion", "unicycle") == (world.motion, world.sensor)
    assert models("--motion", "euler") == (EulerUnicycle(0.1, 0.1), world.sensor)
    assert models("--motion-noise", "0.3,0") == (Unicycle(0.3, 0.0), world.sensor)
    assert models("--motion", "euler", "--motion-noise", "0.3, 0.2") == (EulerUnicycle(0.3, 0.2), world.sensor)
    assert models("--sensor-noise", "1,2") == (world.motion, RangeBearing(1.0, 2.0))
    assert (made[-1].order, made[-1].gate) == ("sequential", None)
    models("--order", "batch", "--gate", "5")
    assert (made[-1].order, made[-1].gate) == ("batch", 5.0)
    facts = strict_json(lesson / "models.json")
    (lesson / "models.json").write_text(json.dumps(facts | {"order": "batch", "gate": 7, "pose": [1, 2, 3]}))
    models("--max-steps", 1)
    assert (made[-1].order, made[-1].gate) == ("batch", 7)
    models("--max-steps", 1, "--gate", "inf")
    assert (made[-1].order, made[-1].gate) == ("batch", np.inf)
    assert abs(made[-1].pose[0] - 1) < 0.5
    other = model_to_dict(EulerUnicycle(0.2, 0.4))
    (lesson / "models.json").write_text(json.dumps({"motion": other}))
    assert models() == (EulerUnicycle(0.2, 0.4), RangeBearing(0.1, 0.035))
    assert models("--motion-noise", "0.3,0")[0] == EulerUnicycle(0.3, 0.0)
    (lesson / "models.json").unlink()
    assert models() == (Unicycle(0.1, 0.1), RangeBearing(0.1, 0.035))


@pytest.mark.parametrize(
    ("controls", "observations", "options", "expected"),
    [
        ("t,rot1,trans,rot2\n0,0.1,1,0\n1,0,0,0", "t,id,x,y\n1,a,2,1", (), (Odometry, RelativePosition)),
        ("t,v,omega\n0,1,0\n1,0,0", "t,id,range,bearing\n1,a,2,1", (), (Unicycle, RangeBearing)),
        ("t,u1,u2\n0,1,0\n1,0,0", "t,id,z1,z2\n1,a,2,1", ("--motion", "euler", "--sensor", "relative"),
         (EulerUnicycle, RelativePosition)),
        ("t,d1,d2,d3\n0,1,0,0\n1,0,0,0", "t,id,x,y\n1,a,2,1", ("--motion", "odometry"), (Odometry, RelativePosition)),
    ],
)  # fmt: skip
def test_columns_tell_the_models(
    controls: str, observations: str, options: tuple[str, ...], expected: tuple[type, type], tmp_path: Path
) -> None:
    log = write_csv(tmp_path / "log", controls=controls, observations=observations)
    succeeds("run", "csv", log, *options, "--save", tmp_path / "f.npz")
    f = EKFSLAM.load(tmp_path / "f.npz")
    assert (type(f.motion), type(f.sensor)) == expected


# ---- errors ----


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), ("command",)),
        (("fly",), ("fly", "--help")),
        (("run",), ("command",)),
        (("run", "csv"), ("DIR", "run csv --help")),
        (("run", "csv", "nowhere"), ("nowhere/controls.csv",)),
        (("run", "csv", "{lesson}", "--filter", "kalman"), ("kalman", *FILTERS)),
        (("run", "csv", "{lesson}", "--motion", "bicycle"), ("bicycle", *cli.MOTIONS)),
        (("run", "csv", "{lesson}", "--sensor", "sonar"), ("sonar", *cli.SENSORS)),
        (("run", "csv", "{lesson}", "--motion", "odometry"), ("controls.csv", "rates v,omega", "Odometry")),
        (("run", "csv", "{lesson}", "--motion-noise", "0.1"), ("0.1", "unicycle takes 2", "rad/s")),
        (("run", "csv", "{lesson}", "--motion-noise", "a,b"), ("a,b", "unicycle takes 2")),
        (("run", "csv", "{lesson}", "--motion-noise", "0.1,-1"), ("sigma_omega", "-1")),
        (("run", "csv", "{lesson}", "--motion-noise", "nan,1"), ("sigma_v", "nan")),
        (("run", "csv", "{lesson}", "--sensor-noise", "0,1"), ("sigma_range", "0")),
        (("run", "csv", "{lesson}", "--sensor-noise", ""), ("range-bearing takes 2",)),
        (("run", "csv", "{lesson}", "--sensor", "relative", "--sensor-noise", "1,2"), ("relative takes 1",)),
        (("run", "csv", "{lesson}", "--gate", "-1"), ("gate", "-1")),
        (("run", "csv", "{lesson}", "--gate", "nan"), ("gate", "nan")),
        (("run", "csv", "{lesson}", "--gate", "wide"), ("--gate", "number")),
        (("run", "csv", "{lesson}", "--order", "random"), ("order", "random", "batch")),
        (("run", "csv", "{lesson}", "--max-steps", "0"), ("--max-steps", "1")),
        (("run", "csv", "{lesson}", "--json", "{lesson}"), ("lesson", "folder")),
        (("run", "csv", "{lesson}", "--json", "{file}/run.json"), ("file",)),
        (("run", "csv", "{lesson}", "--plot", "{file}/run.png"), ("file",)),
        (("run", "csv", "{lesson}", "--save", "{file}/f.npz"), ("file",)),
        (("run", "csv", "{lesson}", "--out", "{file}"), ("file",)),
        (("run", "csv", "{lesson}", "--plot", "run.docx"), ("run.docx", ".png")),
        (("run", "mrclam", "nowhere.zip", "--robot", "1"), ("nowhere.zip",)),
        (("run", "mrclam", "{lesson}"), ("--robot",)),
        (("run", "mrclam", "{lesson}", "--robot", "1"), ("Barcodes.dat",)),
        (("run", "mrclam", "{lesson}", "--robot", "9"), ("robot", "9")),
        (("run", "mrclam", "{lesson}", "--robot", "1", "--filter", "x"), ("x", *FILTERS)),
        (("simulate", "mars", "--out", "{lesson}/new"), ("mars", *WORLDS)),
        (("simulate", "loop"), ("--out",)),
        (("simulate", "lesson", "--out", "{file}"), ("file",)),
        (("simulate", "lesson", "--out", "{file}/log"), ("file",)),
        (("simulate", "lesson", "--seed", "-1", "--out", "{lesson}/new"), ("--seed", "0")),
        (("demo", "--out", "{file}"), ("file",)),
        (("fetch", "mrclam", "10"), ("10", "1 to 9")),
        (("fetch", "venus", "1"), ("venus", "mrclam")),
        (("fetch", "mrclam", "one"), ("N", "integer")),
        (("fetch", "mrclam", "1", "--base-url", "nonsense"), ("nonsense", "http")),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_one_line(
    arguments: tuple[str, ...], words: tuple[str, ...], lesson: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "file"
    file.write_text("as it was")
    monkeypatch.chdir(tmp_path)
    before = contents(tmp_path)
    line = fails(*(a.format(lesson=lesson, file=file) for a in arguments))
    for word in words:
        assert word in line, line
    assert contents(tmp_path) == before


@pytest.mark.parametrize(
    ("name", "line", "text"),
    [
        ("controls.csv", 3, "0.2,0.5"),
        ("observations.csv", 5, "0.4,1,two,0.1"),
        ("truth.csv", 2, "0.0,0,0,nan"),
        ("landmarks.csv", 3, "0,1,1"),
    ],
)
def test_a_garbled_row_is_named_by_file_and_line(name: str, line: int, text: str, lesson: Path) -> None:
    rows = (lesson / name).read_text().splitlines()
    rows[line - 1] = text
    (lesson / name).write_text("\n".join(rows))
    assert f"{lesson / name}:{line}: " in fails("run", "csv", lesson)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", ("not JSON",)),
        ("[1, 2]", ("object", "pose_covariance")),
        ('{"motoin": null}', ("motoin", "motion")),
        ('{"motion": {"name": "Rocket"}}', ("motion", "Rocket", "Unicycle")),
        ('{"motion": {"name": "Unicycle", "sigma_v": -1, "sigma_omega": 0}}', ("motion", "sigma_v", "-1")),
        ('{"motion": {"name": "RangeBearing", "sigma_range": 1, "sigma_bearing": 1}}', ("no motion model",)),
        ('{"sensor": {"name": "RelativePosition"}}', ("sensor", "RelativePosition")),
        ('{"sensor": 3}', ("sensor", "3")),
        ('{"pose": [1, 2]}', ("pose", "(3,)")),
        ('{"pose": "here"}', ("pose",)),
        ('{"pose_covariance": [[1, 0, 0], [0, -1, 0], [0, 0, 1]]}', ("pose_covariance", "-1")),
        ('{"order": "random"}', ("order", "random")),
        ('{"gate": "wide"}', ("gate", "wide")),
        ('{"gate": 0}', ("gate", "0")),
    ],
)
def test_a_broken_models_file_is_named(text: str, words: tuple[str, ...], lesson: Path) -> None:
    (lesson / "models.json").write_text(text)
    line = fails("run", "csv", lesson)
    for word in (str(lesson / "models.json"), *words):
        assert word in line


def test_unknown_columns_ask_for_a_model(tmp_path: Path) -> None:
    log = write_csv(tmp_path, controls="t,u1,u2\n0,1,0\n1,0,0\n", observations="t,id,z1,z2\n1,a,2,1\n")
    assert "u1,u2" in (line := fails("run", "csv", log)) and "--motion unicycle|euler|odometry" in line
    assert "z1,z2" in (line := fails("run", "csv", log, "--motion", "euler")) and "--sensor range-bearing" in line


# ---- a run that ends before its log ----


def test_a_run_that_fails_midway_leaves_what_it_did(lesson: Path, tmp_path: Path) -> None:
    succeeds("run", "csv", lesson, "--out", tmp_path / "whole")
    succeeds("run", "csv", lesson, "--max-steps", 9, "--json", tmp_path / "nine.json")
    break_at(lesson, 30)  # the 30th sighting: of three a step, in the tenth step
    outputs = ("--out", tmp_path / "out", "--json", tmp_path / "run.json", "--save", tmp_path / "f.npz")
    line = fails("run", "csv", lesson, *outputs)
    assert "range is -1.0" in line
    assert f"first 9 of 15 steps are in {tmp_path / 'out'}" in line
    whole, part = (History.load(tmp_path / name / "history.npz") for name in ("whole", "out"))
    np.testing.assert_array_equal(part.poses, whole.poses[:9])
    assert contents(tmp_path / "out").keys() == contents(tmp_path / "whole").keys()
    got = strict_json(tmp_path / "out" / "summary.json")
    assert (got["steps"], got["observations"]) == (9, 27)
    assert got | {"seconds": 0} == strict_json(tmp_path / "nine.json") | {"seconds": 0}
    assert is_png(tmp_path / "out" / "overview.png")
    assert not (tmp_path / "run.json").exists() and not (tmp_path / "f.npz").exists()


def test_a_run_that_fails_at_once_leaves_nothing_but_files_that_say_so(lesson: Path, tmp_path: Path) -> None:
    break_at(lesson, 1)
    assert "first 0 of 15 steps" in fails("run", "csv", lesson, "--out", tmp_path / "out")
    got = strict_json(tmp_path / "out" / "summary.json")
    assert (got["steps"], got["observations"], got["landmarks"], got["ate_m"]) == (0, 0, 0, None)
    assert "steps" not in fails("run", "csv", lesson)


@pytest.mark.usefixtures("no_figures")
@pytest.mark.parametrize("with_out", [True, False])
def test_ctrl_c_keeps_what_was_done(
    with_out: bool, lesson: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Interrupted(EKFSLAM):
        def run(self, log: Log, progress: Any = False) -> History:
            history = super().run(cli._beginning(log, 6))
            if len(log) == 1:  # what is run to load the compiled code
                return history
            stop = KeyboardInterrupt()
            stop.history = history  # type: ignore[attr-defined]
            raise stop

    monkeypatch.setitem(FILTERS, "ekf", Interrupted)
    done = slamkit("run", "csv", lesson, *(("--out", tmp_path / "out") if with_out else ()))
    assert done.exit_code == 130
    assert "Traceback" not in done.output
    if with_out:
        assert done.stderr == f"interrupted; its first 6 of 15 steps are in {tmp_path / 'out'}\n"
        assert strict_json(tmp_path / "out" / "summary.json")["steps"] == 6
    else:
        assert done.output == ""


def test_a_file_is_replaced_by_a_whole_one_or_not_at_all(
    lesson: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    succeeds("run", "csv", lesson, "--out", out)
    before = contents(out)

    def torn(figure: Any, path: Path, dpi: float) -> None:
        path.write_bytes(b"half of it")
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(plots, "save", torn)
    assert "No space left" in fails("run", "csv", lesson, "--out", out)
    after = contents(out)
    assert after.keys() == before.keys()
    assert after["overview.png"] == before["overview.png"]
    with pytest.raises(ValueError, match="JSON compliant"):
        run_report.write_json(out / "map.csv", {"a": 1.0, "b": np.nan})
    assert contents(out) == after


# ---- mrclam ----


@pytest.fixture(scope="module")
def small_set(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """MRCLAM7.zip, named as it is published: a robot on an arc among three landmarks, by the arc's equations."""
    rng = np.random.default_rng(7)
    start, v, omega, seconds = 1248272272.0, 0.2, 0.2, 30.0
    landmarks = {6: (2.0, 0.5), 7: (0.0, 2.0), 8: (-1.5, 0.0)}
    barcodes = {1: 5, 6: 72, 7: 27, 8: 54}

    def pose(t: float) -> tuple[float, float, float]:
        driven = max(t - mrclam.COMMAND_DELAY, 0.0)
        theta = omega * driven
        return v / omega * np.sin(theta), v / omega * (1 - np.cos(theta)), theta

    odometry = [f"{start + t:.3f} {v} {omega}" for t in np.arange(0, seconds, 0.05)]
    truth = [f"{start + t:.3f} " + " ".join(f"{x:.9f}" for x in pose(t)) for t in np.arange(0, seconds, 0.05)]
    measurement = []
    for t in np.arange(0.5, seconds, 0.5):
        x, y, theta = pose(t)
        for subject, (a, b) in landmarks.items():
            r, bearing = np.hypot(a - x, b - y), np.arctan2(b - y, a - x) - theta
            # Two outliers: one that the gate lets pass, one that it must refuse.
            r += {(10.0, 6): 0.8, (20.0, 7): 8.0}.get((t, subject), rng.normal(0, 0.02))
            noisy = f"{r:.6f} {np.angle(np.exp(1j * bearing)) + rng.normal(0, 0.01):.6f}"
            measurement.append(f"{start + t:.3f} {barcodes[subject]} {noisy}")
    measurement.append(f"{start + 1:.3f} 5 1.0 0.0")
    measurement.append(f"{start + 1:.3f} 99 1.0 0.0")
    files = {
        "Barcodes.dat": [f"{subject} {code}" for subject, code in barcodes.items()],
        "Landmark_Groundtruth.dat": [f"{subject} {x} {y} 0.001 0.001" for subject, (x, y) in landmarks.items()],
        "Robot1_Odometry.dat": odometry,
        "Robot1_Measurement.dat": measurement,
        "Robot1_Groundtruth.dat": truth,
    }
    path = tmp_path_factory.mktemp("mrclam") / "MRCLAM7.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for name, rows in files.items():
            archive.writestr(f"MRCLAM_Dataset7/{name}", "\n".join(["# a comment", *rows, ""]))
    return path


def test_run_mrclam(small_set: Path, tmp_path: Path) -> None:
    text = succeeds(
        "run", "mrclam", small_set, "--robot", 1, "--json", tmp_path / "run.json", "--out", tmp_path / "out"
    )
    assert "MRCLAM set 7, robot 1" in text
    assert "1 sightings of robots, 1 of unknown barcodes" in text
    got = strict_json(tmp_path / "run.json")
    assert {name: type(value) for name, value in got.items()} == KEYS
    assert (got["landmarks"], got["observations"], got["rejected"]) == (3, 177, 1)
    assert got["ate_m"] < 0.1
    assert is_png(tmp_path / "out" / "overview.png")
    log, (motion, sensor) = mrclam.load(small_set, 1), mrclam.models()
    history = EKFSLAM(motion, sensor, gate=mrclam.GATE).run(log)
    assert got == run_report.summarise(history, log, motion) | {"seconds": got["seconds"]}


def test_run_mrclam_refuses_a_robot_that_the_set_has_not_got(small_set: Path) -> None:
    assert "Robot2_Odometry.dat is missing" in fails("run", "mrclam", small_set, "--robot", 2)


def test_run_mrclam_on_the_real_set(data_folder: Path, tmp_path: Path) -> None:
    path = data_folder / "mrclam" / "MRCLAM_Dataset1.zip"
    if not path.exists():
        pytest.skip(f"{path} does not exist")
    succeeds("run", "mrclam", path, "--robot", 1, "--json", tmp_path / "run.json", "--max-steps", 20000)
    got = strict_json(tmp_path / "run.json")
    assert {name: type(value) for name, value in got.items()} == KEYS
    assert got["steps"] == 20000
    assert got["ate_m"] < got["dead_reckoning_ate_m"]


# ---- fetch ----


@pytest.fixture
def server(small_set: Path) -> Iterator[str]:
    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, *_: Any) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(small_set.parent))) as http:
        thread = Thread(target=http.serve_forever)
        thread.start()
        try:
            yield f"http://127.0.0.1:{http.server_port}"
        finally:
            http.shutdown()
            thread.join()


def test_fetch_prints_where_the_set_is(server: str, small_set: Path, tmp_path: Path) -> None:
    for quiet in ((), ("--quiet",)):
        text = succeeds("fetch", "mrclam", 7, "--folder", tmp_path / "data", "--base-url", server, *quiet)
        assert text == f"{tmp_path / 'data' / 'MRCLAM7.zip'}\n"
        assert Path(text.strip()).read_bytes() == small_set.read_bytes()


def test_fetch_of_a_set_that_is_not_there(server: str, tmp_path: Path) -> None:
    assert "MRCLAM8.zip" in fails("fetch", "mrclam", 8, "--folder", tmp_path / "data", "--base-url", server)
    assert contents(tmp_path) == {}


# ---- demo ----


@pytest.fixture
def short_comparison(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two runs of 20 steps in the end of the demo: the full unscented filter takes milliseconds a step."""
    short = replace(standing_world(), controls=np.zeros((20, 2)))
    monkeypatch.setattr(cli, "DEMO_RUNS", 2)
    monkeypatch.setitem(WORLDS, "standing", lambda: short)  # type: ignore[misc]


@pytest.mark.usefixtures("short_comparison")
def test_demo(tmp_path: Path) -> None:
    out = tmp_path / "demo"
    text = succeeds("demo", "--out", out)
    got = strict_json(out / "summary.json")
    assert {name: type(value) for name, value in got.items()} == KEYS
    assert got["ate_m"] < 0.1 * got["dead_reckoning_ate_m"]
    for name in ("ate_m", "dead_reckoning_ate_m", "landmark_rmse_m", "heading_rmse_deg", "nis_mean"):
        assert f" {got[name]:.3f} " in text, name
    assert is_png(out / "overview.png") and is_png(out / "correlation.png")
    log = Log.load(out / "log.npz")
    np.testing.assert_array_equal(Log.read_csv(out / "log").observations, log.observations)
    assert len(np.loadtxt(out / "trajectory.txt")) == got["steps"] == len(log)
    succeeds("run", "csv", out / "log", "--json", tmp_path / "again.json")
    again = strict_json(tmp_path / "again.json")
    assert again | {"seconds": 0} == got | {"seconds": 0}
    compared = strict_json(out / "comparison" / "summary.json")
    assert tuple(compared) == tuple(FILTERS)
    rows = {line.split()[1]: line for line in text.splitlines() if line.startswith("│")}
    for name, numbers in compared.items():
        assert set(numbers) >= COMPARED and numbers["runs"] == numbers["finished"] == 2
        for key in ("position_rmse_m", "pose_nees", "gauge_nees", "relative_nees_per_dof"):
            assert f" {numbers[key]:.3f} " in rows[name], (name, key)
    report = (out / "comparison" / "report.md").read_text()
    assert {(len(rows[name]), rows[name][-1]) for name in compared} == {(79, "│")}
    said = next(line for line in text.splitlines() if "claim too little" in line.lower())
    assert said in report
    figures = {p.stem for p in (out / "comparison").glob("*.png") if is_png(p)}
    assert figures == {"overview", "nees", "claims", "coverage", "bars", "cost", "gauge"}


@pytest.mark.usefixtures("short_comparison")
def test_the_demos_comparison_is_the_command_that_it_names(tmp_path: Path) -> None:
    text = succeeds("demo", "--out", tmp_path / "demo")
    command = text[text.index("slamkit compare") :].split(")")[0].split()
    assert "all" in command
    succeeds(*command[1:], "--json", tmp_path / "again.json")
    compared = strict_json(tmp_path / "demo" / "comparison" / "summary.json")
    for name, numbers in strict_json(tmp_path / "again.json").items():
        timed = {"seconds_per_step", "seconds_per_step_se"}
        assert {k: v for k, v in numbers.items() if k not in timed} == {
            k: v for k, v in compared[name].items() if k not in timed
        }


COMPARED = {
    "pose_nees", "pose_nees_median", "pose_nees_above_6", "position_rmse_m", "heading_rmse_deg", "landmark_nees",
    "landmark_rmse_m", "relative_nees_per_dof", "nullity", "gauge_deviation_drop", "stochastic_gauge_m", "equivariance",
    "seconds_per_step", "diverged", "runs", "pose_nees_low", "pose_nees_high",
}  # fmt: skip


def test_compare_writes_numbers_report_and_figures(tmp_path: Path) -> None:
    out, numbers, again = tmp_path / "study", tmp_path / "numbers.json", tmp_path / "again.json"
    arguments = [
        "compare",
        "--world",
        "lesson",
        "--filters",
        "ekf,fej,ideal",
        "--runs",
        "2",
        "--seed",
        "3",
        "--jobs",
        "1",
    ]
    assert "fej" in succeeds(*arguments, "--out", out, "--json", numbers)
    got = json.loads(numbers.read_text())
    assert list(got) == ["ekf", "fej", "ideal"]
    assert all(set(row) >= COMPARED for row in got.values())
    assert got["ekf"]["nullity"] == 2
    assert got["fej"]["nullity"] == got["ideal"]["nullity"] == 3
    assert {"report.md", "overview.png", "nees.png", "gauge.png"} <= {p.name for p in out.iterdir()}
    assert "fej" in (out / "report.md").read_text()
    succeeds(*arguments, "--json", again)
    for name, row in json.loads(again.read_text()).items():
        timed = {"seconds_per_step", "seconds_per_step_se"}
        assert {k: v for k, v in row.items() if k not in timed} == {k: got[name][k] for k in row if k not in timed}


def test_compare_judges_a_log_without_a_truth_by_what_needs_none(tmp_path: Path) -> None:
    log, numbers = tmp_path / "site", tmp_path / "numbers.json"
    succeeds("simulate", "lesson", "--seed", 1, "--out", log)
    (log / "truth.csv").unlink()
    (log / "landmarks.csv").unlink()
    text = succeeds("compare", "--world", log, "--filters", "ekf,ideal", "--jobs", 1, "--json", numbers)
    got = strict_json(numbers)
    assert got["ekf"]["position_rmse_m"] is None and f" {got['ekf']['nis_per_dof']:.3f} " in text
    assert "site: a recorded log" in text and "nan" not in text
    assert "Claim to have learnt the gauge, which nothing measures: ekf" in text
    assert "Failed or diverged: ideal 1 of 1 (InputError: the ideal filter needs the truth" in text


def test_an_interrupted_compare_says_how_to_go_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(study, "compare", interrupt)
    done = slamkit("compare", "--world", "lesson", "--out", tmp_path / "out")
    assert done.exit_code == 130
    assert f"{tmp_path / 'out' / 'runs'}, and the same command goes on" in done.stderr


def test_compare_refuses_before_the_first_run_what_it_could_not_write(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(study, "compare", lambda *_, **__: pytest.fail("it has run"))
    assert "is a folder" in fails("compare", "--world", "lesson", "--json", tmp_path)


def test_compare_takes_a_folder_of_csv_files(tmp_path: Path) -> None:
    log, numbers = tmp_path / "log", tmp_path / "numbers.json"
    succeeds("simulate", "lesson", "--seed", 1, "--out", log)
    succeeds("compare", "--world", log, "--filters", "ekf,invariant", "--jobs", 1, "--json", numbers)
    got = json.loads(numbers.read_text())
    assert got["ekf"]["runs"] == 1
    assert got["invariant"]["position_rmse_m"] > 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--world", "moon"], "moon"),
        (["--world", "loop", "--filters", "ekf,magic"], "magic"),
        (["--world", "loop", "--filters", ""], "filter"),
        (["--world", "loop", "--jobs", "0"], "jobs"),
        (["--world", "loop", "--runs", "0"], "runs"),
    ],
)
def test_compare_refuses_in_one_line(arguments: list[str], said: str) -> None:
    assert said in fails("compare", *arguments)
