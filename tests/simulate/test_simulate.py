"""Laws of the simulation: what is drawn, from which generator, and what the worlds are."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from dataclasses import dataclass, replace
from math import inf, nan, pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.linalg import block_diag

from slamkit.errors import InputError, ModelError
from slamkit.evaluate import dead_reckoning
from slamkit.logs import Log
from slamkit.models import EulerUnicycle, Odometry, RangeBearing, RelativePosition, Unicycle
from slamkit.se2 import wrap
from slamkit.simulate import (
    WORLDS,
    World,
    lesson_world,
    loop_world,
    random_world,
    ring_world,
    simulate,
    standing_world,
)

Array = NDArray[np.float64]
LOGGED = ("control_times", "controls", "observation_times", "observation_ids", "observations")


@dataclass(frozen=True)
class Linear:
    """A motion and sensor model in which every noise can be read off: p' = p + u dt, z = l - p; any covariance."""

    control: Any = ((0.0, 0.0, 0.0),) * 3
    slip: Any = ((0.0, 0.0, 0.0),) * 3
    noise: Any = ((0.0, 0.0), (0.0, 0.0))

    def move(self, pose: Array, u: Array, dt: float) -> Array:
        return pose + u * dt

    def control_noise(self, u: Array, dt: float) -> Array:
        return np.array(self.control)

    def pose_noise(self, pose: Array, u: Array, dt: float) -> Array:
        return np.array(self.slip)

    @property
    def R(self) -> Array:  # noqa: N802
        return np.array(self.noise)

    def predict(self, pose: Array, landmark: Array) -> Array:
        return landmark - pose[:2]

    def residual(self, z: Array, z_hat: Array) -> Array:
        return z - z_hat

    def jacobians(self, *_: Any) -> Any:
        raise AssertionError("a simulation needs no derivative")

    inverse_jacobians = invert = jacobians


def small_world(**changes: Any) -> World:
    fields: dict[str, Any] = {
        "name": "small",
        "landmarks": {"a": (1.0, 2.0), ("b", 1): (-3.0, 0.5), 7: (0.5, -4.0)},
        "motion": Unicycle(0.1, 0.1, pose_noise=np.diag([0.01, 0.02, 0.03]) ** 2),
        "sensor": RangeBearing(0.1, 0.05),
        "controls": np.tile([0.5, 0.3], (40, 1)),
        "dt": 0.25,
        "pose": (1.0, -1.0, 3.0),
        "pose_covariance": np.diag([0.1, 0.2, 0.3]) ** 2,
    }
    return World(**(fields | changes))


def sightings(log: Log) -> dict[tuple[float, Any], bytes]:
    """Measurements by time and id."""
    rows = zip(log.observation_times, log.observation_ids, log.observations, strict=True)
    return {(float(t), log.landmark_ids[i]): z.tobytes() for t, i, z in rows}


def assert_covariance(samples: Array, covariance: Array) -> None:
    """Whitened, the samples have mean 0 and covariance I within six standard errors."""
    n, k = samples.shape
    white = np.linalg.solve(np.linalg.cholesky(covariance), samples.T).T
    assert np.abs(white.mean(0)).max() < 6 / np.sqrt(n)
    assert np.abs(white.T @ white / n - np.eye(k)).max() < 6 * np.sqrt(2 / n)


FULL3 = np.array([[0.04, 0.01, -0.02], [0.01, 0.09, 0.03], [-0.02, 0.03, 0.05]])
FULL2 = np.array([[0.04, -0.03], [-0.03, 0.09]])


@pytest.mark.parametrize("name", WORLDS)
def test_same_seed_same_bytes(name: str) -> None:
    a, b, c = (simulate(WORLDS[name](), np.random.default_rng(seed)) for seed in (3, 3, 4))
    assert all(getattr(a, f).tobytes() == getattr(b, f).tobytes() for f in LOGGED)
    assert a.truth is not None and b.truth is not None
    assert a.truth.poses.tobytes() == b.truth.poses.tobytes()
    assert a.landmark_ids == b.landmark_ids
    assert a.observations.tobytes() != c.observations.tobytes()


@pytest.mark.parametrize("name", WORLDS)
def test_a_world_survives_the_way_to_another_process(name: str) -> None:
    world = WORLDS[name]()
    a, b = (simulate(w, np.random.default_rng(3)) for w in (world, pickle.loads(pickle.dumps(world))))
    assert all(getattr(a, f).tobytes() == getattr(b, f).tobytes() for f in LOGGED)


def test_the_generator_is_advanced() -> None:
    rng = np.random.default_rng(0)
    a, b = simulate(small_world(), rng), simulate(small_world(), rng)
    assert not np.array_equal(a.observations, b.observations)


@pytest.mark.parametrize("name", WORLDS)
def test_one_step_a_control_with_the_truth_at_every_step(name: str) -> None:
    world = WORLDS[name]()
    log = simulate(world, np.random.default_rng(0))
    n = len(world.controls)
    assert log.truth is not None
    np.testing.assert_array_equal(log.truth.times, world.dt * np.arange(n + 1))
    assert log.truth.poses.shape == (n + 1, 3)
    assert np.all((log.truth.poses[:, 2] >= -pi) & (log.truth.poses[:, 2] < pi))
    np.testing.assert_array_equal(log.schedule.times, log.truth.times[1:])
    np.testing.assert_array_equal(log.schedule.control, np.arange(n))
    np.testing.assert_allclose(log.schedule.dt, world.dt, rtol=1e-9)
    assert set(log.truth.landmarks) == set(world.landmarks) >= set(log.landmark_ids)
    assert set(np.unique(log.observation_ids)) == set(range(len(log.landmark_ids)))


@pytest.mark.parametrize(
    "change",
    [
        {"max_range": 3.0},
        {"min_range": 2.0},
        {"field_of_view": 4.0},
        {"detection_probability": 0.5},
        {"sensor": RelativePosition(0.3)},
    ],
)
def test_a_change_of_the_sensor_leaves_the_motion_as_it_was(change: dict[str, Any]) -> None:
    a, b = (simulate(small_world(**c), np.random.default_rng(5)) for c in ({}, change))
    assert a.truth is not None and b.truth is not None
    assert a.truth.poses.tobytes() == b.truth.poses.tobytes()
    assert a.controls.tobytes() == b.controls.tobytes()
    if "sensor" not in change:
        assert 0 < len(sightings(b)) < len(sightings(a))
        assert sightings(b).items() <= sightings(a).items()


def test_a_change_of_the_motion_leaves_initial_pose_and_measurement_noise_as_they_were() -> None:
    worlds = [
        small_world(motion=Linear(), sensor=Linear(noise=FULL2), controls=np.full((20, 3), u), landmarks={0: (1, 2)})
        for u in (0.0, 1.0)
    ]
    a, b = (simulate(w, np.random.default_rng(1)) for w in worlds)
    assert a.truth is not None and b.truth is not None
    np.testing.assert_array_equal(a.truth.poses[0], b.truth.poses[0])
    noise = [log.observations + log.truth.poses[1:, :2] for log in (a, b) if log.truth]
    np.testing.assert_allclose(noise[0], noise[1], atol=1e-12)


@given(st.integers(1, 39))
def test_a_shorter_run_is_the_beginning_of_the_longer(steps: int) -> None:
    world = small_world()
    whole = simulate(world, np.random.default_rng(2))
    part = simulate(replace(world, controls=world.controls[:steps]), np.random.default_rng(2))
    assert whole.truth is not None and part.truth is not None
    np.testing.assert_array_equal(part.truth.poses, whole.truth.poses[: steps + 1])
    np.testing.assert_array_equal(part.controls, whole.controls[:steps])
    assert sightings(part).items() <= sightings(whole).items()


@pytest.mark.parametrize("odometry", [False, True])
@pytest.mark.parametrize(
    ("motion", "controls"),
    [
        (Unicycle(0.0, 0.0), np.tile([0.5, 0.3], (40, 1))),
        (EulerUnicycle(0.0, 0.0), np.tile([0.5, -0.3], (40, 1))),
        (Odometry(0.0, 0.0, 0.0, 0.0), np.tile([0.1, 0.4, -0.3], (40, 1))),
    ],
)
def test_without_noise_reality_is_the_models(motion: Any, controls: Array, odometry: bool) -> None:
    # The smallest noise a sensor may have stands for none.
    world = small_world(
        motion=motion,
        controls=controls,
        odometry=odometry,
        increments=isinstance(motion, Odometry),
        pose_covariance=np.zeros((3, 3)),
        sensor=RangeBearing(1e-12, 1e-12),
    )
    log = simulate(world, np.random.default_rng(0))
    assert log.truth is not None
    np.testing.assert_array_equal(log.truth.poses[0], world.pose)
    np.testing.assert_array_equal(log.controls, controls)
    _, poses = dead_reckoning(log, motion, world.pose)
    error = poses - log.truth.poses[1:]
    assert np.abs(np.column_stack([error[:, :2], wrap(error[:, 2])])).max() < 1e-12
    for k, step in enumerate(log):
        assert step.scan.ids == tuple(world.landmarks)
        for i, z in zip(step.scan.ids, np.asarray(step.scan.z), strict=True):
            z_hat = world.sensor.predict(log.truth.poses[k + 1], world.landmarks[i])
            assert np.abs(world.sensor.residual(z, z_hat)).max() < 1e-10


@pytest.mark.parametrize("odometry", [False, True])
def test_control_noise_has_the_models_covariance(odometry: bool) -> None:
    rng = np.random.default_rng(8)
    world = small_world(
        motion=Linear(control=FULL3), sensor=Linear(), controls=rng.normal(size=(4000, 3)), odometry=odometry
    )
    log = simulate(world, rng)
    assert log.truth is not None
    moved = np.diff(log.truth.poses, axis=0)
    driven = np.column_stack([moved[:, :2], wrap(moved[:, 2])]) / world.dt
    np.testing.assert_allclose(driven if odometry else log.controls, world.controls, atol=1e-9)
    assert_covariance(driven - log.controls, FULL3)


def test_pose_and_measurement_noise_have_the_models_covariance() -> None:
    world = small_world(
        motion=Linear(slip=FULL3), sensor=Linear(noise=FULL2), controls=np.zeros((4000, 3)), landmarks={0: (3.0, 4.0)}
    )
    log = simulate(world, np.random.default_rng(9))
    assert log.truth is not None
    slip = np.diff(log.truth.poses, axis=0)
    slip[:, 2] = wrap(slip[:, 2])
    assert_covariance(slip, FULL3)
    assert_covariance(log.observations - ([3.0, 4.0] - log.truth.poses[1:, :2]), FULL2)


def test_the_noises_are_independent() -> None:
    linear = Linear(control=FULL3, slip=FULL3, noise=FULL2)
    world = small_world(
        motion=linear, sensor=linear, controls=np.zeros((4000, 3)), landmarks={0: (3.0, 4.0)}, odometry=True
    )
    log = simulate(world, np.random.default_rng(6))
    assert log.truth is not None
    slip = np.diff(log.truth.poses, axis=0)
    slip[:, 2] = wrap(slip[:, 2])
    samples = np.hstack([-log.controls, slip, log.observations - ([3.0, 4.0] - log.truth.poses[1:, :2])])
    assert_covariance(samples, block_diag(FULL3, FULL3, FULL2))


def test_control_noise_follows_the_control() -> None:
    turn, drive = [0.3, 0.0, 0.0], [0.0, 0.5, 0.0]
    world = small_world(
        motion=Odometry(0.04, 0.0, 0.09, 0.0),
        controls=np.tile([turn, drive], (2000, 1)),
        odometry=True,
        increments=True,
    )
    w = world.controls - simulate(world, np.random.default_rng(3)).controls
    assert_covariance(w[::2, :1], np.array([[0.04 * 0.3**2]]))
    assert_covariance(w[1::2, 1:2], np.array([[0.09 * 0.5**2]]))
    assert np.all(w[::2, 1:] == 0) and np.all(w[1::2, [0, 2]] == 0)


def test_the_initial_pose_is_drawn_from_its_covariance() -> None:
    world = small_world(pose_covariance=FULL3, controls=np.zeros((1, 2)), pose=np.zeros(3))
    rng = np.random.default_rng(4)
    first = np.array([log.truth.poses[0] for log in (simulate(world, rng) for _ in range(1000)) if log.truth])
    assert_covariance(first, FULL3)


@settings(max_examples=50)
@given(
    st.floats(0, 4),
    st.floats(0, 6),
    st.floats(0.1, 2 * pi),
    st.sampled_from([RelativePosition(0.1), RangeBearing(0.01, 0.05)]),
    st.integers(0, 2**32),
)
def test_a_landmark_is_sighted_exactly_where_it_is_in_sight(
    least: float, more: float, view: float, sensor: Any, seed: int
) -> None:
    world = small_world(min_range=least, max_range=least + more, field_of_view=view, sensor=sensor)
    log = simulate(world, np.random.default_rng(seed))
    assert log.truth is not None
    expected = set()
    for time, pose in zip(log.truth.times[1:], log.truth.poses[1:], strict=True):
        for i, landmark in world.landmarks.items():
            forward = complex(*(landmark - pose[:2])) * np.exp(-1j * pose[2])
            if least <= abs(forward) <= least + more and abs(np.angle(forward)) <= view / 2:
                expected.add((float(time), i))
    assert set(sightings(log)) == expected


@given(st.floats(0, 1), st.integers(0, 2**32))
def test_detections_are_as_frequent_as_they_should_be(probability: float, seed: int) -> None:
    world = small_world(detection_probability=probability, controls=np.zeros((200, 2)))
    count, n = len(sightings(simulate(world, np.random.default_rng(seed)))), 600
    assert abs(count - n * probability) <= 6 * np.sqrt(n * probability * (1 - probability)) + 3
    assert probability > 0 or count == 0
    assert probability < 1 or count == n


def test_no_sensor_gives_what_it_cannot() -> None:
    world = small_world(sensor=RangeBearing(1.0, 3.0), landmarks={0: (1.2, -1.0)}, controls=np.zeros((500, 2)))
    log = simulate(world, np.random.default_rng(0))
    assert 100 < len(log.observations) < 450
    assert np.all(log.observations[:, 0] >= 0)
    assert np.all((log.observations[:, 1] >= -pi) & (log.observations[:, 1] < pi))


def test_a_robot_on_a_landmark_or_in_an_empty_world_sees_nothing() -> None:
    still: dict[str, Any] = {
        "motion": Unicycle(0, 0),
        "controls": np.zeros((5, 2)),
        "pose_covariance": np.zeros((3, 3)),
    }
    for landmarks in ({}, {0: (1.0, -1.0)}):
        log = simulate(small_world(landmarks=landmarks, **still), np.random.default_rng(0))
        assert log.observations.shape == (0, 2)
        assert len(log) == 5


def test_the_lesson_world_is_the_lessons() -> None:
    demo = json.loads((Path(__file__).parents[1] / "lesson_demo.json").read_text())
    world = lesson_world()
    assert list(world.landmarks) == [0, 1, 2]
    np.testing.assert_array_equal(list(world.landmarks.values()), demo["landmarks"])
    np.testing.assert_array_equal(
        np.column_stack([world.controls, np.full(15, world.dt)]), [step["u"] for step in demo["steps"]]
    )
    np.testing.assert_array_equal(world.motion.control_noise(world.controls[0], world.dt), np.zeros((2, 2)))
    np.testing.assert_allclose(world.motion.pose_noise(world.pose, world.controls[0], world.dt), demo["Q"], rtol=1e-15)
    np.testing.assert_allclose(world.sensor.R, demo["R"], rtol=1e-15)
    np.testing.assert_allclose(world.pose_covariance, demo["P0"], rtol=1e-15)
    assert not world.pose.any()
    # Without its noise the robot goes where the demo's went.
    exact = replace(world, motion=Unicycle(0, 0), pose_covariance=np.zeros((3, 3)))
    truth = simulate(exact, np.random.default_rng(0)).truth
    assert truth is not None
    np.testing.assert_allclose(truth.poses[1:], [step["truth"] for step in demo["steps"]], atol=1e-12)


@given(st.integers(0, 2**32))
@settings(max_examples=20)
def test_the_loop_worlds_landmarks_lie_in_two_rings(map_seed: int) -> None:
    worlds = [loop_world("relative", map_seed), loop_world("range-bearing", map_seed)]
    places = [np.array(list(w.landmarks.values())) for w in worlds]
    np.testing.assert_array_equal(places[0], places[1])
    off = np.hypot(places[0][:, 0], places[0][:, 1] - 10) - 10
    assert np.all((np.abs(off) >= 0.5 - 1e-9) & (np.abs(off) <= 5 + 1e-9))
    assert np.count_nonzero(off > 0) == np.count_nonzero(off < 0) == 10
    other = np.array(list(loop_world(map_seed=map_seed + 1).landmarks.values()))
    assert not np.array_equal(places[0], other)


@pytest.mark.parametrize(("world", "radius"), [(loop_world(), 10.0), (ring_world(), 0.25 / np.deg2rad(1.5))])
def test_the_robot_drives_the_circle_and_its_odometry_drifts_off(world: World, radius: float) -> None:
    log = simulate(world, np.random.default_rng(0))
    assert log.truth is not None
    # Euler's chords turn after each step instead of during it: off the circle by half a step at most.
    away = np.hypot(log.truth.poses[:, 0], log.truth.poses[:, 1] - radius) - radius
    assert np.abs(away).max() < 0.13
    assert len(log.truth.poses) == 2501
    _, reckoned = dead_reckoning(log, world.motion, world.pose)
    assert np.abs(reckoned[-1] - log.truth.poses[-1]).max() > 0.1
    np.testing.assert_allclose(world.motion.control_noise(world.controls[0], 1.0), np.diag([0.0125**2 / 2, 0.00125]))
    np.testing.assert_allclose(world.sensor.R, 0.01 * np.eye(2))


def test_the_ring_worlds_landmarks_are_evenly_spaced_three_metres_outside() -> None:
    world = ring_world()
    z = np.array([complex(*p) for p in world.landmarks.values()]) - 1j * 0.25 / np.deg2rad(1.5)
    np.testing.assert_allclose(np.abs(z), 0.25 / np.deg2rad(1.5) + 3)
    np.testing.assert_allclose(np.angle(np.roll(z, -1) / z), 2 * pi / 20)
    assert not world.pose_covariance.any()


@given(st.floats(0, 1))
@settings(max_examples=10)
def test_the_standing_robot_stands(sigma: float) -> None:
    world = standing_world(sigma)
    log = simulate(world, np.random.default_rng(1))
    assert log.truth is not None
    assert np.all(log.truth.poses == log.truth.poses[0])
    np.testing.assert_allclose(world.pose_covariance, np.diag([1e-4, 1e-4, sigma**2]))
    polar = np.array([complex(*p) for p in world.landmarks.values()])
    np.testing.assert_allclose(np.abs(polar), 10)
    np.testing.assert_allclose(np.angle(polar), [-1, -0.5, 0, 0.5, 1], atol=1e-12)
    assert len(log.observations) == 1500


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 300), st.integers(1, 400), st.floats(0.01, 3), st.integers(0, 2**32))
def test_a_random_world_has_its_landmarks_and_its_path_in_one_square(
    count: int, steps: int, density: float, seed: int
) -> None:
    world = random_world(np.random.default_rng(seed), count, steps=steps, density=density)
    half = max(10.0, np.sqrt(count / density)) / 2
    assert list(world.landmarks) == list(range(count))
    log = simulate(world, np.random.default_rng(seed))
    assert log.truth is not None
    assert np.abs(log.truth.poses[:, :2]).max() <= half
    assert np.abs(np.array(list(world.landmarks.values())).reshape(-1, 2)).max(initial=0.0) <= half
    assert len(world.controls) == steps


def test_a_random_world_keeps_its_density() -> None:
    rng = np.random.default_rng(0)
    seen = []
    for _ in range(12):
        log = simulate(random_world(rng, 2000, steps=300, density=0.2, max_range=3.0), rng)
        seen.append(np.diff(log.schedule.first).mean())
    # Independent worlds: six standard errors.
    assert abs(np.mean(seen) - pi * 3**2 * 0.2) < 6 * np.std(seen) / np.sqrt(len(seen)) < 2


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("landmarks", {0: (1.0, 2.0, 3.0)}),
        ("landmarks", {0: (1.0, nan)}),
        ("controls", np.zeros(3)),
        ("controls", np.zeros((0, 2))),
        ("controls", [[inf, 0.0]]),
        ("controls", "fast"),
        ("dt", 0.0),
        ("dt", -1.0),
        ("dt", nan),
        ("dt", inf),
        ("pose", (0.0, 0.0)),
        ("pose", (0.0, nan, 0.0)),
        ("pose_covariance", np.eye(2)),
        ("pose_covariance", np.diag([1.0, 1.0, -1.0])),
        ("pose_covariance", [[1, 1, 0], [0, 1, 0], [0, 0, 1]]),
        ("min_range", -1.0),
        ("min_range", inf),
        ("max_range", -1.0),
        ("max_range", nan),
        ("field_of_view", 0.0),
        ("field_of_view", 7.0),
        ("detection_probability", 1.5),
        ("detection_probability", nan),
    ],
)
def test_a_world_that_cannot_be_is_refused_by_name(field: str, value: Any) -> None:
    with pytest.raises(InputError, match=field if field != "landmarks" else "landmark 0"):
        small_world(**{field: value})


@pytest.mark.parametrize("call", [lambda: loop_world("sonar"), lambda: standing_world(nan)])  # type: ignore[arg-type]
def test_factories_refuse_what_they_do_not_know(call: Callable[[], World]) -> None:
    with pytest.raises(InputError):
        call()


@pytest.mark.parametrize("wrong", [{"landmarks": -1}, {"steps": 0}, {"density": 0.0}, {"density": nan}])
def test_a_random_world_refuses_impossible_numbers(wrong: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=next(iter(wrong))):
        random_world(np.random.default_rng(0), **wrong)


@pytest.mark.parametrize(
    ("model", "message"),
    [
        ({"control": np.diag([1.0, 1.0, -1.0])}, "control_noise is not positive semidefinite"),
        ({"slip": np.triu(np.ones((3, 3)))}, "pose_noise is not symmetric"),
        ({"slip": np.eye(2)}, r"pose_noise has shape \(2, 2\)"),
        ({"noise": np.full((2, 2), nan)}, "R is not finite"),
    ],
)
def test_a_model_without_a_covariance_is_named(model: dict[str, Any], message: str) -> None:
    linear = Linear(**model)
    with pytest.raises(ModelError, match=message):
        simulate(small_world(motion=linear, sensor=linear, controls=np.zeros((3, 3))), np.random.default_rng(0))


def test_a_model_that_leaves_the_finite_is_named() -> None:
    class Breaking(Linear):
        def move(self, pose: Array, u: Array, dt: float) -> Array:
            return np.full(3, nan) if u[0] > 1 else super().move(pose, u, dt)

    world = small_world(motion=Breaking(), sensor=Linear(), controls=[[0, 0, 0], [0, 0, 0], [2, 0, 0], [0, 0, 0]])
    with pytest.raises(ModelError, match=r"not finite in step 2"):
        simulate(world, np.random.default_rng(0))


# ---- what a world says of itself, and the list of worlds ----


@pytest.mark.parametrize("name", WORLDS)
def test_a_world_describes_itself_in_one_short_line_and_one_table(name: str) -> None:
    world = WORLDS[name]()
    assert repr(world).startswith(f"World({world.name!r}: {len(world.landmarks)} landmarks")
    assert len(repr(world)) < 120 and "\n" not in repr(world) and "array" not in repr(world)
    html = world._repr_html_()
    assert html.startswith("<table>") and html.endswith("</table>") and type(world.motion).__name__ in html
    assert "<b>" not in replace(world, name="<b>")._repr_html_()


@pytest.mark.parametrize("what", ["motion", "sensor"])
def test_a_model_class_in_place_of_an_instance_is_refused(what: str) -> None:
    given = {"motion": Unicycle, "sensor": RangeBearing}[what]
    with pytest.raises(InputError, match=rf"{what} is the class {given.__name__}, expected an instance"):
        replace(WORLDS["lesson"](), **{what: given})


def test_a_world_of_ones_own_is_found_by_name_and_by_module(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, register: Any
) -> None:
    (tmp_path / "my_yard.py").write_text("from slamkit.simulate import lesson_world\nyard = lesson_world\nsize = 3\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    assert WORLDS.find("my_yard:yard") is WORLDS["lesson"]
    with pytest.raises(InputError, match=r"expected|must be a slamkit\.World.*3"):
        WORLDS.find("my_yard:size")
    register(WORLDS, "yard", WORLDS["lesson"])
    assert WORLDS.find("yard") is WORLDS["lesson"]
