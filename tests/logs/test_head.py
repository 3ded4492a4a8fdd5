"""The first steps of a log are a log, over which a filter gets to where it would be after them in the whole log."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from family import ALL
from hypothesis import given
from hypothesis import strategies as st
from log_examples import logs, quarters, same, small_log

from slamkit.errors import InputError
from slamkit.logs import Log, Truth
from slamkit.models import Odometry, RangeBearing, Unicycle


@given(logs(), st.data())
def test_the_head_has_the_first_steps(log: Log, data: st.DataObject) -> None:
    k = data.draw(st.integers(1, len(log))) if len(log) else 1
    head = log.head(k)
    whole, part = log.schedule, head.schedule
    assert len(head) == min(k, len(log))
    assert same(part.times, whole.times[:k]) and same(part.dt, whole.dt[:k]) and same(part.first, whole.first[: k + 1])
    assert same(part.control, whole.control[:k])
    for a, b in zip(head, log, strict=False):
        assert a.time == b.time and a.dt == b.dt and same(a.u, b.u)
        assert a.scan.ids == b.scan.ids and same(a.scan.z, b.scan.z)
    assert head.landmark_ids == log.landmark_ids and head.increments == log.increments
    assert head.end_time <= log.end_time
    if len(log):
        assert head.end_time == min(whole.times[min(k, len(log)) - 1], log.end_time) or head is log
        assert same(head.head(k), head)


@given(logs())
def test_the_head_of_all_steps_is_the_log(log: Log) -> None:
    assert log.head(max(len(log), 1)) is log
    assert log.head(len(log) + 5) is log


@given(logs(), st.data(), st.lists(quarters, max_size=8))
def test_a_step_of_the_head_finds_the_same_truth(log: Log, data: st.DataObject, times: list[float]) -> None:
    poses = np.arange(3.0 * len(times)).reshape(-1, 3)
    log = Log(
        log.control_times, log.controls, log.observation_times, log.observation_ids, log.observations,
        log.landmark_ids, log.end_time, log.increments, Truth(times, poses, {"a": (1.0, 2.0)}),
    )  # fmt: skip
    k = data.draw(st.integers(1, max(len(log), 1)))
    head = log.head(k)
    assert log.truth is not None and head.truth is not None
    assert head.truth.landmarks.keys() == {"a"}
    for time in head.schedule.times:
        distances = np.abs(log.truth.times - time)
        if len(distances):
            nearest = distances == distances.min()
            kept = np.abs(head.truth.times - time) == distances.min()
            assert same(head.truth.poses[kept], log.truth.poses[nearest])


def test_commands_later_than_the_head_are_left_out_and_a_rate_ends_with_it() -> None:
    log = Log([0.0, 1.0, 2.0], [(1.0, 0.0), (2.0, 0.0), (3.0, 0.0)], [1.5], [0], [(2.0, 0.1)], ("a", "b"), 4.0)
    assert log.schedule.times.tolist() == [1.0, 1.5, 2.0, 4.0]
    head = log.head(2)
    assert head.controls[:, 0].tolist() == [1.0, 2.0] and head.end_time == 1.5
    assert len(log.head(1).observations) == 0 and log.head(1).end_time == 1.0
    assert log.head(3).controls[:, 0].tolist() == [1.0, 2.0] and log.head(3).end_time == 2.0


def test_an_increment_is_whole_in_the_head() -> None:
    u = [(0.0, 1.0, 0.0), (0.1, 1.0, 0.0), (0.0, 0.0, 0.0)]
    log = Log([0.0, 1.0, 2.0], u, [0.5, 1.5], [0, 0], [(2.0, 0.1), (1.0, 0.1)], ("a",), 2.0, increments=True)
    head = log.head(1)
    assert head.schedule.dt.tolist() == [1.0] and head.controls.tolist() == [[0.0, 1.0, 0.0]]
    assert head.observation_times.tolist() == [0.5] and len(next(iter(head)).scan) == 1


@pytest.mark.parametrize("steps", [0, -1, 1.0, True, None, "2"])
def test_a_head_has_a_number_of_steps(steps: Any) -> None:
    with pytest.raises(InputError, match=r"steps is .*, expected an integer of at least 1"):
        small_log().head(steps)


def drive(increments: bool) -> Log:
    rng = np.random.default_rng(4)
    n = 30
    landmarks = {i: np.array([3.0 * np.cos(i), 3.0 * np.sin(i)]) for i in range(4)}
    u = np.column_stack([np.zeros(n), np.full(n, 0.05), np.full(n, 0.1)]) if increments else np.tile([0.5, 1.0], (n, 1))
    ct = 0.1 * np.arange(n)
    ot = np.sort(rng.uniform(0.0, 0.1 * n, 60)).round(2)
    poses, sensor = np.zeros((n + 1, 3)), RangeBearing(0.1, 0.03)
    motion: Any = Odometry(0.02, 0.01, 0.02, 0.01) if increments else Unicycle(0.1, 0.05)
    for k in range(n):
        poses[k + 1] = motion.move(poses[k], u[k], 0.1)
    rows = rng.integers(0, 4, len(ot))
    z = [sensor.predict(poses[int(t / 0.1)], landmarks[i]) for t, i in zip(ot, rows.tolist(), strict=True)]
    truth = Truth(0.1 * np.arange(n + 1), poses, landmarks)
    return Log(ct, u, ot, rows, np.array(z), tuple(range(4)), 0.1 * n, increments, truth)


@pytest.mark.parametrize("increments", [False, True])
@pytest.mark.parametrize("name", ["ekf", "fej", "invariant", "ukf"])
def test_a_filter_runs_over_the_head_as_over_the_beginning_of_the_log(name: str, increments: bool) -> None:
    log = drive(increments)
    motion: Any = Odometry(0.02, 0.01, 0.02, 0.01) if increments else Unicycle(0.1, 0.05)

    def run(log: Log) -> Any:
        return ALL[name](motion, RangeBearing(0.1, 0.03), (0.0, 0.0, 0.0), np.eye(3) * 1e-3).run(log)

    whole = run(log)
    for k in (1, 2, len(log) // 2, len(log) - 1, len(log)):
        part = run(log.head(k))
        assert same(part.times, whole.times[:k])
        assert same(part.poses, whole.poses[:k])
        assert same(part.pose_covariances, whole.pose_covariances[:k])
        n = int(log.schedule.first[k])
        assert same(part.innovations, whole.innovations[:n])
