"""The numbers of a study."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from small_study import KEYS, NAMES, world

from slamkit import evaluate
from slamkit.models import Unicycle
from slamkit.study import Study, compare


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
