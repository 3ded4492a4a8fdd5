"""Findings say no more than the numbers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_study import NAMES, small

from slamkit.simulate import standing_world
from slamkit.study import Study, compare


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
    assert told(study, right, right, 0.6) == ["In 4 runs, no filter was found to claim too little uncertainty."]
    too_little, why = told(study, wrong, right, 0.6)
    assert too_little.endswith("in the gauge ekf 10.00.") and "relative" not in too_little
    assert why.startswith("All of the ekf's inconsistency (10.00 in the gauge, 1.00 in the relative map)")
    assert "falls by up to 60%" in why
    assert told(study, wrong, right, 1e-4) == [too_little]
    both, why = told(study, wrong, right | {"ekf": [3.0] * 4, "invariant": [5.0] * 4}, 0.6)
    assert both.endswith("in the gauge ekf 10.00; in the relative map invariant 5.00, ekf 3.00.")
    assert "overconfident about the relative map too" in why
    (aligned,) = told(study, wrong, right, 0.6, simulated=False)
    assert (
        aligned == "These filters claim to have learnt the gauge, which no measurement observes: "
        "ekf (its claimed deviation falls by up to 60%)."
    )


def test_consistent_filters_are_seldom_said_to_claim_too_little(study: Study) -> None:
    rng = np.random.default_rng(1)
    dof = study.trials["ekf"][0].relative_dof
    said = 0
    for _ in range(400):
        gauge, relative = ({name: rng.chisquare(d, 4) / d for name in NAMES} for d in (3, dof))
        said += "too little uncertainty (" in told(study, gauge, relative, 0.0)[0]
    assert 0.01 < said / 400 < 0.09  # 5 %, give or take three standard deviations


def test_in_the_standing_world_the_standard_filter_learns_its_gauge_and_errs_in_nothing_else() -> None:
    study = compare(["ekf", "invariant"], standing_world(), 10, 1, jobs=1, gauge_steps=100)
    too_little, why = study.findings()
    assert "ekf" in too_little and "invariant" not in too_little and "relative" not in too_little
    assert why.startswith("All of the ekf's inconsistency")
    assert "All of the EKF's inconsistency comes from a gauge" in study.overview().get_suptitle()
    assert " ".join(study.findings()) in study.report()


def test_a_study_in_which_every_trial_failed_says_so(tmp_path: Path) -> None:
    def never(*_: Any, **__: Any) -> Any:
        raise ValueError("no filter today")

    study = small(filters={"a": never, "b": never}, runs=2, gauge_steps=0, jobs=1)
    assert study.all_failed and len(study.failures) == 4
    [said] = study.findings()
    assert said.startswith("Every trial failed (4 trials)") and "a in run 0: ValueError: no filter today" in said
    assert (
        said in study.report() and "every trial failed" in repr(study) and "every trial failed" in study._repr_html_()
    )
    assert {s["failed"] for s in study.summary().values()} == {2}
    assert not small(filters={"a": never, "ekf": "ekf"}, runs=1, gauge_steps=0, jobs=1).all_failed


@pytest.mark.parametrize("anchored", [0, 1, 2])
def test_no_filter_is_said_to_have_learnt_a_gauge_that_is_observable(study: Study, anchored: int) -> None:
    wrong = {name: [1.0] * 4 for name in NAMES} | {"ekf": [10.0] * 4}
    right = {name: [1.0] * 4 for name in NAMES}
    checks = {n: replace(c, unobservable=anchored) for n, c in study.gauge.items()}
    said = told(replace(study, gauge=checks), wrong, right, 0.6)
    assert len(said) == 1 and "ekf 10.00" in said[0]
    assert told(replace(study, gauge=checks), wrong, right, 0.6, simulated=False) == []
