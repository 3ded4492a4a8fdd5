"""Laws of dead reckoning."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from slamkit import logs, se2
from slamkit.errors import ModelError
from slamkit.evaluate import dead_reckoning
from slamkit.models import Odometry, Unicycle

Array = NDArray[np.float64]

# Both take lists and any ids, which their annotations do not say.
Log: Any = logs.Log
Truth: Any = logs.Truth


def test_dead_reckoning_is_the_motion_model_step_by_step() -> None:
    rng = np.random.default_rng(0)
    u = rng.normal(size=(30, 2))
    motion = Unicycle(0.1, 0.1)
    log = Log(np.arange(30.0), u, [3.4, 3.4, 8.0], np.array([0, 1, 0]), np.ones((3, 2)), ("a", "b"), end_time=30.0)
    times, poses = dead_reckoning(log, motion, (1.0, 2.0, 3.0))
    np.testing.assert_array_equal(times, log.schedule.times)
    assert poses.shape == (len(log), 3)
    pose = np.array([1.0, 2.0, 3.0])
    for k in range(30):
        pose = motion.move(pose, u[k], 1.0)
        error = poses[times == k + 1][0] - pose
        assert np.abs([*error[:2], se2.wrap(error[2])]).max() < 1e-9
    assert 3.4 in times
    assert np.all((poses[:, 2] >= -np.pi) & (poses[:, 2] < np.pi))


def test_without_controls_the_robot_stays() -> None:
    log = Log(np.empty(0), np.empty((0, 2)), [1.0, 2.0], np.array([0, 0]), np.ones((2, 2)), ("a",))
    times, poses = dead_reckoning(log, Unicycle(0.1, 0.1), (1.0, 2.0, 0.5))
    assert times.tolist() == [1.0, 2.0]
    assert poses.tolist() == [[1.0, 2.0, 0.5]] * 2


def test_increments_are_whole() -> None:
    log = Log([0.0, 1.0], [[0.0, 1.0, 0.5], [0.0, 1.0, 0.0]], [0.3], np.array([0]), [[1.0, 0.0]], ("a",), 2.0, True)
    _, poses = dead_reckoning(log, Odometry(0.1, 0.1, 0.1, 0.1))
    np.testing.assert_allclose(poses, [[1, 0, 0.5], [1 + np.cos(0.5), np.sin(0.5), 0.5]], atol=1e-12)


def test_a_model_that_leaves_the_finite_is_named() -> None:
    class Breaking(Unicycle):
        def move(self, *_: Any) -> Array:
            return np.full(3, np.nan)

    log = Log([0.0], [[0.0, 1.0]], [], np.empty(0, dtype=np.int64), np.empty((0, 2)), (), end_time=2.0)
    with pytest.raises(ModelError, match="not finite at 2"):
        dead_reckoning(log, Breaking(0.1, 0.1))
