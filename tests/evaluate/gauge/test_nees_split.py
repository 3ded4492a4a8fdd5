"""Laws of the split of NEES."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from gauge_runs import (
    P0,
    every_filter,
    grown,
    keepers_without_sigma_points,
    log_of,
    told,
    transforms,
    truth_of,
    world,
)
from hypothesis import given, settings

from slamkit import InputError, SlamkitError, se2, simulate
from slamkit.evaluate import gauge
from slamkit.filters import FILTERS
from slamkit.models import Unicycle


@every_filter
def test_the_parts_of_nees_sum_to_the_whole(name: str) -> None:
    f, log = grown(name), log_of()
    pose, landmarks = truth_of(log)
    found = gauge.nees_split(f, pose, landmarks)
    # B and the errors anew, by finite differences around the points at which this estimator takes its lever arms.
    points = _lever_points(f)

    def body(x: Any) -> Any:
        g = se2.log(se2.between(np.r_[points[:2], f.pose[2]], x[:3]))
        g[:2] += se2.rotation(f.pose[2]).T @ (np.array([[0, -1], [1, 0]]) @ (f.pose[:2] - points[:2])) * g[2]
        return np.concatenate([g, ((x[3:].reshape(-1, 2) - x[:2]) @ se2.rotation(x[2])).ravel()])

    h, at = 1e-6, np.concatenate([points[:2], f.x[2:3], points[3:]])
    B = np.transpose([(body(at + h * e) - body(at - h * e)) / (2 * h) for e in np.eye(len(at))])
    true = np.concatenate([pose, *[landmarks[i] for i in f.landmark_ids]])
    e = np.concatenate([se2.log(se2.between(f.pose, pose)), (body(true) - body(f.x))[3:]])
    whole = e @ np.linalg.solve(B @ f.P @ B.T, e)
    assert found.total == pytest.approx(whole, rel=1e-4)
    assert (found.gauge_dof, found.relative_dof) == (3, 10)
    assert found.relative_per_dof == pytest.approx(found.relative / 10)


def _lever_points(f: Any) -> Any:
    """Positions from the rotation's column of N: J p turned back."""
    column = gauge.null_directions(f)[:, 2]
    out = np.zeros_like(column)
    out[0], out[1] = column[1], -column[0]
    out[3::2], out[4::2] = column[4::2], -column[3::2]
    return out


@every_filter
@settings(max_examples=10)
@given(T=transforms)
def test_a_rigid_motion_of_the_truth_is_gauge_alone(name: str, T: Any) -> None:
    f, (pose, landmarks) = grown(name), truth_of(log_of())
    here = gauge.nees_split(f, pose, landmarks)
    there = gauge.nees_split(f, se2.compose(T, pose), {i: se2.transform(T, p) for i, p in landmarks.items()})
    assert there.relative == pytest.approx(here.relative, rel=1e-6)
    if np.abs(T).max() > 1e-3:
        assert abs(there.gauge - here.gauge) > 1e-9


@pytest.mark.parametrize("name", [n for n in FILTERS if n != "ideal"])
@settings(max_examples=5)
@given(T=transforms)
def test_the_split_does_not_depend_on_the_frame(name: str, T: Any) -> None:
    log, w = log_of(), world()
    pose, landmarks = truth_of(log)
    c, s = np.cos(T[2]), np.sin(T[2])
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    f = FILTERS[name](w.motion, w.sensor, se2.compose(T, w.pose), R @ P0 @ R.T)
    f.run(log)
    a = gauge.nees_split(grown(name), pose, landmarks)
    b = gauge.nees_split(f, se2.compose(T, pose), {i: se2.transform(T, p) for i, p in landmarks.items()})
    assert a.gauge == pytest.approx(b.gauge, rel=1e-6)
    assert a.relative == pytest.approx(b.relative, rel=1e-6)


@keepers_without_sigma_points
def test_both_parts_are_chi_square_where_the_gauge_is_kept(name: str) -> None:
    runs = []
    for seed in range(60):
        log = log_of(steps=30, seed=seed)
        w = world()
        f = FILTERS[name](w.motion, w.sensor, w.pose, P0, **told(name, log))
        f.run(log)
        found = gauge.nees_split(f, *truth_of(log))
        runs.append((found.gauge, found.relative))
    # Bounds four standard errors wide: √(2 d / M) each.
    M, (g, r) = len(runs), np.mean(runs, axis=0)
    assert abs(g - 3) < 4 * np.sqrt(2 * 3 / M)
    assert abs(r - 10) < 4 * np.sqrt(2 * 10 / M)


def test_a_start_that_is_known_exactly_counts_where_it_is_uncertain() -> None:
    w = replace(world(), motion=Unicycle(0.0, 0.0), pose_covariance=np.zeros((3, 3)))
    log = simulate(w, np.random.default_rng(5))
    f = FILTERS["ekf"](w.motion, w.sensor, w.pose)
    f.run(log)
    pose, landmarks = truth_of(log)
    found = gauge.nees_split(f, pose, landmarks)
    assert found.gauge_dof == 0 and found.gauge == 0
    with pytest.raises(SlamkitError, match="exactly"):
        gauge.nees_split(f, pose + np.array([0.0, 0.0, 0.1]), landmarks)


def test_the_truth_must_be_whole() -> None:
    f, (pose, landmarks) = grown("ekf"), truth_of(log_of())
    with pytest.raises(InputError, match="truth_landmarks lack 0"):
        gauge.nees_split(f, pose, {i: p for i, p in landmarks.items() if i != 0})
    for bad in (pose[:2], pose * np.nan, "abc"):
        with pytest.raises(InputError, match="truth_pose"):
            gauge.nees_split(f, bad, landmarks)
    with pytest.raises(InputError, match="landmark 0"):
        gauge.nees_split(f, pose, landmarks | {0: (1.0, 2.0, 3.0)})
