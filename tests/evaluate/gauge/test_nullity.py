"""Laws of the nullity of a recorded run."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from family import PlainMotion, PlainSensor
from gauge_runs import (
    KEEPS,
    P0,
    decided,
    every_order,
    every_sensor,
    keepers,
    log_of,
    make,
    told,
    with_a_late_landmark,
    world,
)

from slamkit import FirstEstimatesEKFSLAM, InputError, Log, simulate
from slamkit.compiled import compiled
from slamkit.cycle.standard import initialise as standard_initialise
from slamkit.evaluate import gauge
from slamkit.evaluate.gauge.pose_given_map import body_covariance
from slamkit.filters import FILTERS
from slamkit.models import Unicycle


@decided
@every_order
@every_sensor
def test_nullity_is_three_unless_the_heading_is_learnt(name: str, order: str, sensor: str) -> None:
    log = log_of(sensor)
    f = make(name, log, sensor, order=order)
    found = gauge.nullity(f, log)
    values = found.singular_values
    assert len(f.landmark_ids) == 0  # a copy made the run
    assert values.shape == (13,) and np.all(np.diff(values) <= 0)
    assert found.nullity == (3 if KEEPS[name] else 2)
    # A regression is not blind to where the map lies: what is cubic in the heading remains, as α².
    # Sigma points of the whole state lie farther out.
    remains = {"ukf": 1e-6, "ukf-full": 2e-6}.get(name)
    assert np.all(values[-found.nullity :] < (2e-13 if remains is None else remains * values[0]))
    assert np.all(values[: -found.nullity] > 1e-2)


@every_order
@every_sensor
def test_the_standard_matrix_is_that_of_the_textbook(order: str, sensor: str) -> None:
    """One landmark a scan, so that every Jacobian can be had from the outside."""
    w, rng = world(sensor), np.random.default_rng(3)
    f = FILTERS["ekf"](w.motion, w.sensor, w.pose, P0, order=order)
    for i, p in w.landmarks.items():
        f.observe(i, w.sensor.predict(w.pose, p))
    start, root = copy.deepcopy(f), np.linalg.cholesky(w.sensor.R)
    times, ids, z, rows, Phi = [], [], [], [], np.eye(13)
    pose = w.pose
    for k, u in enumerate(w.controls):
        pose = w.motion.move(pose, u, w.dt)
        times.append((k + 1) * w.dt)
        ids.append(k % 5)
        z.append(w.sensor.predict(pose, w.landmarks[k % 5]) + root @ rng.normal(size=2))
        F = np.eye(13)
        F[:3, :3] = w.motion.jacobians(f.pose, u, w.dt)[0]
        Phi = F @ Phi
        f.predict(u, w.dt)
        H, slot = np.zeros((2, 13)), 3 + 2 * ids[-1]
        H[:, :3], H[:, slot : slot + 2] = w.sensor.jacobians(f.pose, f.landmarks[ids[-1]])
        rows.append(np.linalg.solve(root, H @ Phi))
        f.observe(ids[-1], z[-1])
    log = Log(np.arange(len(times)) * w.dt, w.controls, times, ids, z, tuple(range(5)))
    expected = np.linalg.svd(np.concatenate(rows), compute_uv=False)
    np.testing.assert_allclose(gauge.nullity(start, log).singular_values, expected, atol=1e-10 * expected[0])


@decided
def test_plain_models_have_the_same_nullity(name: str) -> None:
    log, w = log_of(), world()
    plain = FILTERS[name](PlainMotion(w.motion), PlainSensor(w.sensor), w.pose, P0, **told(name, log))
    a, b = gauge.nullity(make(name, log), log), gauge.nullity(plain, log)
    np.testing.assert_allclose(a.singular_values, b.singular_values, atol=1e-9 * a.singular_values[0])


def test_landmarks_that_nothing_ties_together_add_to_the_nullity() -> None:
    w = world()
    log = Log([0.0], [(0.0, 0.0)], [1.0], [0], [(2.0, 0.3)], (0, "never seen"))
    found = gauge.nullity(FILTERS["ekf"](w.motion, w.sensor), log)
    assert found.singular_values.shape == (5,)
    assert found.nullity == 3
    empty = gauge.nullity(
        FILTERS["ekf"](w.motion, w.sensor), Log([0.0], [(0.0, 0.0)], [], [], np.empty((0, 2)), (), 1.0)
    )
    assert empty.nullity == 3


@compiled("void(models, state, index, index, vector)", generic=True)
def published_start(models: Any, state: Any, slot: int, place: int, z: Any) -> None:
    """G_x = [I, J(l - p_{k|k})], with the lever arm at the updated position, as published."""
    standard_initialise(models, state, slot, place, z)
    state.belief.linearised_at[slot : slot + 2] = state.belief.mean[slot : slot + 2]


class Published(FirstEstimatesEKFSLAM):
    """First estimates but for the initialisation."""

    functions = FirstEstimatesEKFSLAM.functions._replace(initialise=published_start)


def test_a_wrong_initialisation_shows() -> None:
    log, w = with_a_late_landmark(log_of()), world()
    right, wrong = (kind(w.motion, w.sensor, w.pose, P0) for kind in (FirstEstimatesEKFSLAM, Published))
    assert gauge.nullity(right, log).nullity == 3
    assert gauge.nullity(wrong, log).nullity == 2
    plain = PlainMotion(w.motion), PlainSensor(w.sensor)
    assert gauge.stochastic_gauge(FirstEstimatesEKFSLAM, *plain, log, P0, w.pose) < 1e-11
    assert gauge.stochastic_gauge(Published, *plain, log, P0, w.pose) > 1e-6


@keepers
@every_order
def test_a_late_landmark_is_no_exception(name: str, order: str) -> None:
    log = with_a_late_landmark(log_of())
    f = make(name, log, order=order)
    assert gauge.nullity(f, log).nullity == 3
    d = gauge.gauge_deviations(f, log)
    assert gauge.gauge_drop(d) <= 1e-9 * d[0]


@pytest.mark.parametrize("tolerance", [0.0, -1.0, 1.0, np.nan])
def test_tolerances_that_are_no_share(tolerance: float) -> None:
    with pytest.raises(InputError, match="tolerance"):
        gauge.nullity(make("ekf", log_of()), log_of(), tolerance)


@every_sensor
def test_regressions_on_the_whole_state_see_what_those_on_a_part_see(sensor: str) -> None:
    """They are dense, but what they hold of other landmarks than the one in sight is of the order of α²."""
    log = log_of(sensor)
    part, whole = (gauge.nullity(make(name, log, sensor), log).singular_values for name in ("ukf", "ukf-full"))
    np.testing.assert_allclose(whole[:-2], part[:-2], rtol=1e-3)
    f = make("ukf-full", log, sensor)
    f.run(log)
    H, _ = f._regression(f._belief.slots[3])
    own = np.r_[0:3, 9:11]
    expected = np.hstack(f.sensor.jacobians(f.pose, f.landmarks[3]))
    np.testing.assert_allclose(H[:, own], expected, atol=0.05)
    assert np.abs(np.delete(H, own, axis=1)).max() < 1e-3


@every_order
@every_sensor
def test_the_robocentric_matrix_holds_what_the_filter_learns(order: str, sensor: str) -> None:
    """Without motion noise the landmarks seen by the robot have the matrix's information, whatever their axes."""
    exact = replace(world(sensor), motion=Unicycle(0.0, 0.0))
    log = with_a_late_landmark(simulate(exact, np.random.default_rng(1)))
    f = FILTERS["robocentric"](exact.motion, exact.sensor, exact.pose, P0, order=order)
    found = gauge.nullity(f, log)
    f.run(log)
    assert found.nullity == 3
    assert np.all(found.singular_values[-3:] < 1e-12)
    _, information = np.linalg.slogdet(np.linalg.inv(body_covariance(f)[3:, 3:]))
    np.testing.assert_allclose(2 * np.log(found.singular_values[:-3]).sum(), information, atol=1e-9)
