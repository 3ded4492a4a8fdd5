"""The folder of a study: it resumes, refuses what is not its own, and is read back."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_study import NAMES, assert_same, small, world

from slamkit import EKFSLAM, InputError, LogFileError
from slamkit.logs import read_archive, write_archive
from slamkit.models import RelativePosition, Unicycle
from slamkit.study import Study


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


def test_a_part_of_another_study_is_refused(study: Study, tmp_path: Path) -> None:
    study.save(tmp_path / "a")
    small(seed=12, folder=tmp_path / "b")
    for name in ("trial-000001.npz", "gauge-0.npz"):
        path = tmp_path / "a" / name
        own = path.read_bytes()
        path.write_bytes((tmp_path / "b" / name).read_bytes())
        for read in (lambda: Study.load(tmp_path / "a"), lambda: small(folder=tmp_path / "a")):
            with pytest.raises(LogFileError, match=rf"{name}.*another|{name}.*other settings") as refused:
                read()
            assert "remove the file" in str(refused.value)
        path.write_bytes(own)
    assert_same(study, Study.load(tmp_path / "a"))


def altered(path: Path, kind: str, change: Callable[[dict[str, Any], dict[str, Any]], None]) -> None:
    facts, arrays = read_archive(path, kind)
    change(facts, arrays)
    write_archive(path, kind, facts, arrays)


@pytest.mark.parametrize(
    ("name", "kind", "change"),
    [
        ("study.npz", "study", lambda f, a: f.update(runs=-1)),
        ("study.npz", "study", lambda f, a: f.update(runs=2.0)),
        ("study.npz", "study", lambda f, a: f.update(filters={})),
        ("study.npz", "study", lambda f, a: f.pop("seed")),
        ("study.npz", "study", lambda f, a: a.update(times=a["times"][::-1])),
        ("study.npz", "study", lambda f, a: a.update(extra=np.zeros(2))),
        ("trial-000000.npz", "trial", lambda f, a: a.update({"0.errors": np.zeros((2, 3))})),
        ("trial-000000.npz", "trial", lambda f, a: a.update({"0.dof": a["0.dof"] + 3})),
        ("trial-000000.npz", "trial", lambda f, a: a.pop("1.nees")),
        ("trial-000000.npz", "trial", lambda f, a: f["trials"][0].update(landmarks=-4)),
        ("trial-000000.npz", "trial", lambda f, a: f["trials"][0].update(diverged=0)),
        ("trial-000000.npz", "trial", lambda f, a: f["trials"].pop()),
        ("trial-000000.npz", "trial", lambda f, a: f.update(trials=[{}] * 3)),
        ("gauge-0.npz", "gauge check", lambda f, a: f["check"].update(nullity="3")),
        ("gauge-0.npz", "gauge check", lambda f, a: a.update(deviations=np.full(8, np.nan))),
    ],
)
def test_a_file_that_contradicts_itself_is_refused_and_named(
    study: Study, tmp_path: Path, name: str, kind: str, change: Any
) -> None:
    study.save(tmp_path)
    altered(tmp_path / name, kind, change)
    with pytest.raises(LogFileError, match=name):
        Study.load(tmp_path)


def test_a_newer_file_and_one_with_pickles_are_refused(study: Study, tmp_path: Path) -> None:
    study.save(tmp_path)
    path = tmp_path / "gauge-1.npz"
    with np.load(path) as archive:
        newer = dict(archive)
    newer["slamkit"] = np.array(str(newer["slamkit"]).replace('"version": 1', '"version": 9'))
    np.savez(path, **newer)
    with pytest.raises(LogFileError, match=r"gauge-1\.npz has version 9"):
        Study.load(tmp_path)
    np.savez(path, **{**newer, "times": np.array([object()], dtype=object)})
    with pytest.raises(LogFileError, match=r"gauge-1\.npz"):
        Study.load(tmp_path)


def test_what_a_killed_writer_left_is_removed(tmp_path: Path) -> None:
    small(runs=1, folder=tmp_path)
    (tmp_path / "trial-000001.npz").unlink(missing_ok=True)
    left = [tmp_path / f".{name}.0123456789abcdef.tmp" for name in ("study.npz", "trial-000001.npz")]
    for path in left:
        path.write_bytes(b"half")
    small(runs=2, folder=tmp_path)
    assert not [p for p in tmp_path.iterdir() if p.suffix != ".npz"]


@pytest.mark.parametrize("option", [{"snapshots": True}, {"gate": 0.99}, {"storage": "dense"}, {"gate": 0.999}])
def test_every_option_is_a_setting_of_the_folder(tmp_path: Path, option: dict[str, Any]) -> None:
    small(filters=["ekf"], runs=1, gauge_steps=0, folder=tmp_path)
    with pytest.raises(InputError, match=r"other settings.*options"):
        small(filters=["ekf"], runs=1, gauge_steps=0, folder=tmp_path, options=option)
    with pytest.raises(InputError, match=r"other settings.*filters"):
        small(filters={"ekf": partial(EKFSLAM, **option)}, runs=1, gauge_steps=0, folder=tmp_path)
