"""Studies: the arguments, the seeds, and that the result does not depend on how it is computed."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_study import NAMES, Changed, assert_same, recorded, small, world

from slamkit import EKFSLAM, InputError, evaluate, simulate
from slamkit.filters import FILTERS, IdealEKFSLAM
from slamkit.study import Study, run_trial
from slamkit.study.settings import check_settings


@pytest.mark.parametrize("jobs", [1, 3])
def test_result_does_not_depend_on_the_number_of_jobs(study: Study, jobs: int) -> None:
    assert_same(study, small(jobs=jobs))


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


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"filters": ["ekf", "efk"]}, "no filter 'efk', expected one of ekf"),
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


class Inherits(EKFSLAM):
    """Has no name of its own."""


class Named(EKFSLAM):
    name = "named"


def test_filters_are_names_classes_or_places_in_modules() -> None:
    place = "small_study:Changed"
    chosen = check_settings(["ekf", Inherits, Named, place], world(3)).filters
    assert list(chosen) == ["ekf", "Inherits", "named", place]
    assert list(chosen.values()) == [FILTERS["ekf"], Inherits, Named, Changed]
    mapped = check_settings({"a": "fej", "b": place, "c": Named}, world(3)).filters
    assert list(mapped.values()) == [FILTERS["fej"], Changed, Named]
    assert check_settings(Named, world(3)).filters == {"named": Named}  # type: ignore[arg-type]
    for wrong, said in (
        (["small_study:Nothing"], "Nothing"),
        (["no.such.module:X"], "no.such"),
        (["small_study:world"], "must be a class"),
        ([partial(EKFSLAM, gate=0.9)], "give a factory a name"),
        ([Named, Named], "twice"),
    ):
        with pytest.raises(InputError, match=said):
            check_settings(wrong, world(3))


def test_an_estimator_of_ones_own_takes_the_options() -> None:
    study = small(filters=["small_study:Changed", Named], runs=2, gauge_steps=0, options={"order": "batch"}, jobs=1)
    same = small(filters={"ekf": partial(EKFSLAM, order="batch")}, runs=2, gauge_steps=0, jobs=1)
    for mine, other in zip(study.trials["named"], same.trials["ekf"], strict=True):
        np.testing.assert_array_equal(mine.nees, other.nees)
    history, _ = run_trial(world(), 11, 0, "small_study:Changed", options={"order": "batch"})
    assert len(history.times) == 30


def test_a_partial_of_the_ideal_filter_is_checked_with_the_truth() -> None:
    study = small(filters={"gated": partial(IdealEKFSLAM, gate=0.9999)}, runs=1, jobs=1)
    assert study.gauge["gated"].error is None and study.gauge["gated"].nullity == 3


@pytest.mark.parametrize("options", [3, {1: 2}, "order"])
def test_options_are_a_mapping(options: Any) -> None:
    with pytest.raises(InputError, match="options is"):
        check_settings(["ekf"], world(3), options=options)
