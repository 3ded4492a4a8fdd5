"""What a log refuses, and the laws of its schedule."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from log_examples import (
    GOOD,
    logs,
    permuted,
    quarters,
    same,
)

from slamkit.errors import InputError
from slamkit.logs import Log, Scan, Truth


@given(logs())
def test_steps_are_in_order_and_predict_only_where_a_control_acts(log: Log) -> None:
    s = log.schedule
    assert len(s.times) == len(s.dt) == len(s.control) == len(s.first) - 1 == len(log)
    assert np.all(np.diff(s.times) >= 0)
    assert s.start_time == (s.times[0] - s.dt[0] if len(log) else 0.0)
    assert np.all(s.dt >= 0)
    assert np.array_equal(s.dt > 0, s.control >= 0)
    assert np.all(s.control < len(log.controls))
    assert np.all((s.dt > 0) | (np.diff(s.first) > 0)), "a step in which nothing happens"


@given(logs())
def test_the_controls_act_from_the_first_to_the_end(log: Log) -> None:
    acting = log.end_time - log.control_times[0] if len(log.controls) else 0.0
    assert log.schedule.dt.sum() == acting
    for row, begin in enumerate(log.control_times):
        end = log.control_times[row + 1] if row + 1 < len(log.controls) else log.end_time
        steps = log.schedule.control == row
        assert log.schedule.dt[steps].sum() == end - begin
        assert np.all((log.schedule.times[steps] > begin) & (log.schedule.times[steps] <= end))
        if log.increments:
            assert steps.sum() == (end > begin), "an increment was split"


@given(logs())
def test_every_observation_occurs_once_and_at_its_time(log: Log) -> None:
    s = log.schedule
    assert s.first[0] == 0
    assert s.first[-1] == len(log.observations)
    assert np.all(np.diff(s.first) >= 0)
    assert np.all(np.diff(log.observation_times) >= 0)
    taken = np.repeat(s.times, np.diff(s.first))
    if not log.increments:
        assert np.array_equal(taken, log.observation_times)
        return
    for t, when in zip(log.observation_times, taken, strict=True):
        ends = [*log.control_times, log.end_time] if len(log.controls) else []
        inside = len(ends) and ends[0] < t <= ends[-1]
        assert when == (min(e for e in ends if e >= t) if inside else t)


WITHIN_ONE_INCREMENT = Log(
    [0.0], [(1.0,)], [0.1, 0.1, 0.2, 0.3, 0.4], [0, 1, 1, 0, 0], np.zeros((5, 1)), ("a", "b"), 1.0, True
)


@given(logs())
@example(WITHIN_ONE_INCREMENT)
def test_no_step_repeats_a_landmark_or_is_split_without_need(log: Log) -> None:
    s = log.schedule
    steps = [log.observation_ids[a:b].tolist() for a, b in zip(s.first[:-1], s.first[1:], strict=True)]
    assert all(len(set(step)) == len(step) for step in steps)
    # Where an instant takes a further step, its first sightings meet a landmark of the step before.
    for k in np.flatnonzero((s.times[1:] == s.times[:-1]) & (s.dt[1:] == 0)) + 1:
        begin, end = s.first[k], s.first[k + 1]
        together = log.observation_times[begin:end] == log.observation_times[begin]
        assert set(log.observation_ids[begin:end][together]) & set(steps[k - 1])


@given(logs())
def test_the_motion_before_a_sighting_is_that_of_the_controls_until_then(log: Log) -> None:
    u = np.arange(1, len(log.controls) + 1) / 4  # the rates or the increments, exact in sums and products
    s = log.schedule
    motion = np.cumsum(np.where(s.control >= 0, u[s.control] if len(u) else 0.0, 0.0) * (1 if log.increments else s.dt))
    taken = np.repeat(np.arange(len(log)), np.diff(s.first))
    ends = np.append(log.control_times[1:], log.end_time)
    for step, t in zip(taken, log.observation_times, strict=True):
        if not len(u):
            expected = 0.0
        elif log.increments:
            # All that began earlier is complete; there is none without a duration.
            expected = u[(log.control_times < t) & (ends > log.control_times)].sum()
        else:
            expected = (u * np.clip(np.minimum(ends, t) - log.control_times, 0, None)).sum()
        assert motion[step] == expected


@given(logs(), st.integers(0, 2**32 - 1))
def test_permuting_the_rows_changes_nothing(log: Log, seed: int) -> None:
    other = permuted(log, np.random.default_rng(seed))
    assert same(other, log)
    assert same(other.schedule, log.schedule)


@given(logs(), st.integers(0, 2**32 - 1))
def test_the_order_of_landmark_ids_changes_no_step(log: Log, seed: int) -> None:
    order = np.random.default_rng(seed).permutation(len(log.landmark_ids))
    names = tuple(log.landmark_ids[i] for i in order)
    other = replace(log, landmark_ids=names, observation_ids=np.argsort(order)[log.observation_ids])
    assert same(other.schedule, log.schedule)
    for a, b in zip(log, other, strict=True):
        assert (a.time, a.dt) == (b.time, b.dt)
        assert set(zip(a.scan.ids, map(tuple, a.scan.z), strict=True)) == set(
            zip(b.scan.ids, map(tuple, b.scan.z), strict=True)
        )


@given(logs(), quarters)
def test_the_clock_has_no_zero(log: Log, shift: float) -> None:
    other = replace(
        log,
        control_times=log.control_times + shift,
        observation_times=log.observation_times + shift,
        end_time=log.end_time + shift,
    )
    assert same(other.schedule, log.schedule._replace(times=log.schedule.times + shift))


@given(logs())
def test_iterating_gives_the_schedule(log: Log) -> None:
    steps = list(log)
    s = log.schedule
    assert [step.time for step in steps] == s.times.tolist()
    assert [step.dt for step in steps] == s.dt.tolist()
    assert [len(step.scan) for step in steps] == np.diff(s.first).tolist()
    assert all((step.u is None) == (step.dt == 0) for step in steps)
    assert [i for step in steps for i in step.scan.ids] == [log.landmark_ids[i] for i in log.observation_ids]
    assert same(np.array([z for step in steps for z in step.scan.z]).reshape(log.observations.shape), log.observations)


@pytest.mark.parametrize("increments", [False, True])
def test_a_long_log_is_scheduled_at_once(increments: bool) -> None:
    rng = np.random.default_rng(0)
    T, M = 100_000, 10_000
    log = Log(
        np.arange(T) * 0.015, rng.normal(size=(T, 2)), rng.integers(0, T // 50, M) * 0.75, rng.integers(0, 20, M),
        rng.normal(size=(M, 2)), tuple(range(20)), T * 0.015, increments,
    )  # fmt: skip
    schedule = log.schedule  # some 20 ms on one core; a loop over a million pairs would be noticed
    assert np.isclose(schedule.dt.sum(), T * 0.015)
    assert schedule.first[-1] == M


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"control_times": [0.0, np.nan]}, "control_times is not finite at row 1"),
        ({"control_times": [0.0]}, "controls have 2 rows, control_times 1"),
        ({"control_times": "soon"}, "control_times must be numbers"),
        ({"control_times": [[0.0, 1.0]]}, r"control_times has shape \(1, 2\), expected \(n,\)$"),
        ({"controls": [1.0, 2.0]}, r"controls has shape \(2,\), expected \(n, m\)$"),
        ({"controls": [(1.0, 0.0), (np.inf, 0.1)]}, "controls is not finite at row 1"),
        ({"controls": [(1.0, 0.0), (1.0,)]}, "controls must be numbers"),
        ({"observations": [(2.0, np.nan)]}, "observations is not finite at row 0"),
        ({"observations": []}, "observations has shape"),
        ({"observation_ids": [0, 0]}, r"observation_ids shape \(2,\)"),
        ({"observation_ids": [0.0]}, "expected integers"),
        ({"observation_ids": [1]}, "run from 1 to 1, there are 1"),
        ({"observation_ids": [-1]}, "run from -1"),
        ({"landmark_ids": ("a", "a")}, "an id twice"),
        ({"landmark_ids": (1, 1.0)}, "an id twice"),
        ({"landmark_ids": (["a"],)}, "hashable"),
        ({"end_time": 0.9}, "end_time is 0.9, expected a time not before the last control's 1.0"),
        ({"end_time": np.nan}, "end_time is nan, expected a finite number"),
        ({"end_time": np.inf}, "end_time is inf"),
        ({"end_time": "late"}, "end_time is 'late', expected a finite number of seconds"),
        ({"increments": True}, "the last increment .* begins at 1.0 s, when the log ends"),
        ({"increments": True, "control_times": [1.0, 1.0], "end_time": 2.0}, "two increments begin at 1.0 s"),
    ],
)
def test_a_log_says_what_is_wrong(change: dict[str, Any], message: str) -> None:
    Log(**GOOD)
    with pytest.raises(InputError, match=message):
        Log(**GOOD | change)


@pytest.mark.parametrize("end_time", [None, 1.0, np.nan])
def test_an_empty_log_is_refused(end_time: float | None) -> None:
    with pytest.raises(InputError, match="empty"):
        Log([], np.empty((0, 2)), [], [], np.empty((0, 2)), (), end_time)


def test_without_controls_a_broken_end_is_still_an_input_error() -> None:
    with pytest.raises(InputError, match="end_time"):
        Log([], np.empty((0, 2)), [1.0], [0], [(1.0, 2.0)], ("a",), np.nan)


@pytest.mark.parametrize(
    ("times", "poses", "landmarks", "message"),
    [
        ([0.0], [(1.0, 2.0)], {}, "shape"),
        ([0.0, 1.0], [(1.0, 2.0, 3.0)], {}, "2 times need"),
        ([np.nan], [(1.0, 2.0, 3.0)], {}, "truth times is not finite"),
        ([0.0], [(1.0, np.inf, 3.0)], {}, "truth poses is not finite"),
        ([0.0], [(1.0, 0.0, 3.0)], {7: (1.0, 2.0, 3.0)}, r"landmark 7 has shape \(3,\)"),
        ([0.0], [(1.0, 0.0, 3.0)], {7: (1.0, np.nan)}, "landmark 7 is not finite"),
    ],
)
def test_a_truth_says_what_is_wrong(times: Any, poses: Any, landmarks: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Truth(times, poses, landmarks)


def test_a_scan_takes_what_it_is_given() -> None:
    z = [(1.0, 2.0), (3.0, 4.0)]
    scan = Scan(("a", 1), z)
    assert len(scan) == 2
    assert scan.z is z
