"""Laws of the unscented filters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from family import SENSORS

from slamkit import EKFSLAM, UKFSLAM, FullUKFSLAM, InputError, Log, ObservabilityConstrainedUKFSLAM, simulate
from slamkit.models import Unicycle
from slamkit.se2 import wrap
from slamkit.simulate import World

P0 = np.diag([0.1, 0.1, np.deg2rad(5.0)]) ** 2


def circle(N: int, sensor: Any) -> World:
    """One and a half times around a circle of 2.5 m inside a ring of N landmarks, sighted up to 4 m away."""
    rng = np.random.default_rng(N)
    angle, distance = 2 * np.pi * (np.arange(N) + rng.random(N)) / N, rng.uniform(3.2, 5.0, N)
    return World(
        name="circle",
        landmarks=dict(enumerate(np.column_stack([distance * np.cos(angle), 2.5 + distance * np.sin(angle)]))),
        motion=Unicycle(0.05, 0.05),
        sensor=sensor,
        controls=np.tile([1.0, 0.4], (24, 1)),
        dt=1.0,
        pose=np.zeros(3),
        pose_covariance=P0,
        max_range=4.0,
    )


def apart(filters: Sequence[Any], reference: Any, log: Log) -> Any:
    """Largest difference of each filter's mean and covariance over a run, in the reference's standard deviations."""
    largest = np.zeros((len(filters), 2))
    for step in log:
        reference.step(step.u, step.dt, step.scan)
        P = reference.P
        sigma = np.sqrt(np.diag(P))
        for f, largest_of_f in zip(filters, largest, strict=True):
            f.step(step.u, step.dt, step.scan)
            assert f.landmark_ids == reference.landmark_ids
            off = f.x - reference.x
            off[2] = wrap(off[2])
            now = np.abs(off / sigma).max(), np.abs((f.P - P) / np.outer(sigma, sigma)).max()
            largest_of_f[:] = np.maximum(largest_of_f, now)
    return largest


@pytest.mark.parametrize("sensor", SENSORS)
@pytest.mark.parametrize("N", [5, 20, 50])
def test_sigma_points_of_a_part_are_enough(N: int, sensor: str) -> None:
    """The default agrees with sigma points of the whole state at α = 1e-3; a filter that has none does not."""
    world = circle(N, SENSORS[sensor])
    log = simulate(world, np.random.default_rng(0))
    arguments = (world.motion, world.sensor, world.pose, P0)
    reference = FullUKFSLAM(*arguments, alpha=1e-3)
    part, none = apart([UKFSLAM(*arguments), EKFSLAM(*arguments)], reference, log)
    assert len(reference.landmark_ids) == N
    assert np.all(part <= 1e-3)
    assert none[0] > 0.1


def test_the_constraint_is_for_sigma_points_of_a_part() -> None:
    world = circle(5, SENSORS["relative"])
    with pytest.raises(InputError, match="'full'"):
        ObservabilityConstrainedUKFSLAM(world.motion, world.sensor, sigma_points="full")


def heading(x: Any, scale: float = 1.0) -> Any:
    return scale * x[2:3]


@pytest.mark.parametrize("kind", [UKFSLAM, FullUKFSLAM, ObservabilityConstrainedUKFSLAM])
def test_an_extra_sensor_is_used_as_in_the_family_or_as_in_filterpy(kind: Any) -> None:
    def new() -> Any:
        f = kind(Unicycle(0.1, 0.05), SENSORS["range-bearing"], pose_covariance=P0)
        f.step((1.0, 0.1), 1.0, {1: (3.0, 0.2), 2: (4.0, -0.2)})
        return f

    def turn(a: Any, b: Any) -> Any:
        return wrap(a - b)

    R, z = np.array([[1e-3]]), np.array([0.12])
    filters = [new() for _ in range(8)]
    a, b, c, d, e, g, h, i = filters
    a.update(z, lambda x: np.eye(1, len(x), 2), heading, R, residual=turn)
    b.update(z, None, heading, R=1e-3, residual=turn)
    c.update(z, R, hx=heading, residual=turn)
    d.update(z, R=R, hx=heading, UT=None, residual=turn)
    e.update(z, None, heading, R, (), (1.0,), turn)
    g.update(z, R, hx=heading, residual=turn, scale=1.0)
    h.update(z, None, heading, R, hx_args=1.0)
    i.update(0.12, 1e-3, None, hx=heading)
    for f in filters[1:]:
        assert np.array_equal(f.x, a.x) and np.array_equal(f.P, a.P) and np.array_equal(f.K, a.K)
    assert a.pose_covariance[2, 2] < new().pose_covariance[2, 2]
    x = a.x
    a.update(None, None, None)
    a.update(None, hx=heading)
    assert np.array_equal(a.x, x)
    for wrong in (
        lambda: a.update(z),
        lambda: a.update(z, R),
        lambda: a.update(z, R, lambda *_: None, hx=heading),
        lambda: a.update(z, R, hx=heading, UT=heading),
        lambda: a.update(z, None, heading, R, scale=1.0),
        lambda: a.update(z, None, lambda x: "a", R),
    ):
        with pytest.raises(InputError):
            wrong()
    assert np.array_equal(a.x, x)
