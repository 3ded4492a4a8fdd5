"""Reading a filter changes nothing, nor does keeping priors and posteriors."""

from __future__ import annotations

from typing import Any

import numpy as np
from family import ALL, drive
from filter_examples import all_filters, every_filter, every_order, every_sensor, every_storage, grown, make, same

from slamkit import simulate
from slamkit.simulate import WORLDS

READS = ("x", "P", "K", "S", "y", "z", "F", "Q", "pose", "pose_covariance", "landmarks", "log_likelihood")


def read_all(f: Any) -> dict[str, Any]:
    return {name: getattr(f, name) for name in READS} | {"marginal": f.marginal(f.landmark_ids, pose=True)}


@all_filters
@every_order
def test_snapshots_change_nothing(name: str, order: str) -> None:
    world = WORLDS["loop"]()
    log = simulate(world, np.random.default_rng(1)).head(120)
    options = {"order": order} | ({"truth": log.truth} if name == "ideal" else {})
    arguments = world.motion, world.sensor, world.pose, world.pose_covariance
    with_them, without = (ALL[name](*arguments, snapshots=on, **options) for on in (True, False))
    for time, u, dt, scan in log:
        for f in (with_them, without):
            if u is None:
                f.observe_scan(scan)
            else:
                f.step(u, dt, scan)
        assert np.array_equal(with_them.pose, without.pose), time
    assert same(with_them, without)


@every_filter
@every_order
@every_sensor
def test_reading_does_not_change_a_small_filter(name: str, order: str, sensor: str) -> None:
    """Whatever is read between steps, the filter goes on as if it had not been."""
    a, b = make(name, sensor=sensor, order=order), make(name, sensor=sensor, order=order)
    log = drive(a.motion, a.sensor)
    for step in log:
        for f in (a, b):
            f.step(step.u, step.dt, step.scan)
        read_all(a)
    assert same(a, b)


@every_filter
@every_storage
def test_every_attribute_is_the_same_after_P_was_read(name: str, storage: Any) -> None:  # noqa: N802
    f = grown(name, storage=storage)
    f.step((1.0, 0.1), 0.3, {"L0": (3.0, 0.4), "L1": (2.0, -0.8)})
    f.observe("L0", (3.05, 0.42))
    before = read_all(f)
    assert np.any(before["K"])
    _ = f.P
    f.flush()
    after = read_all(f)
    for attribute in READS:
        if attribute == "landmarks":
            assert before[attribute].keys() == after[attribute].keys()
            continue
        scale = np.abs(before[attribute]).max()
        np.testing.assert_allclose(after[attribute], before[attribute], atol=1e-12 * scale, rtol=0, err_msg=attribute)


@every_filter
@every_storage
def test_the_gain_moves_the_mean(name: str, storage: Any) -> None:
    """x + K y is the mean after an update, in the coordinates of x: K is that of the state before it.

    The iterated EKF's gain belongs to its last iterate, and not to the innovation y at the first.
    """
    if name == "iterated":
        return
    f = grown(name, storage=storage)
    for read in (False, True):
        if read:
            _ = f.P
        x = f.x
        f.observe("L0", f.sensor.predict(f.pose, f.landmarks["L0"]) + np.full(2, 1e-5))
        np.testing.assert_allclose(f.x - x, f.K @ f.y, atol=1e-8)
