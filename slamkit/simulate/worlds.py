"""The built-in worlds and their names on the command line."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from math import inf, pi
from typing import Literal

import numpy as np

from slamkit.arrays import Array
from slamkit.errors import InputError
from slamkit.models import EulerUnicycle, RangeBearing, RelativePosition, Unicycle
from slamkit.protocols import SensorModel
from slamkit.registry import Registry
from slamkit.se2 import wrap
from slamkit.simulate.world import World

__all__ = ["WORLDS", "lesson_world", "loop_world", "random_world", "ring_world", "standing_world"]


def lesson_world() -> World:
    """Three landmarks, fifteen steps: the introductory lesson's demo.

    v = 0.5 m/s, ω = 5 °/s, dt = 0.2 s from the origin. Landmarks 0, 1 and 2 are corners of a square of 5 m and always
    in view. Pose noise Q = diag(0.02² m², 0.02² m², (1°)²) in each step, range 0.1 m, bearing 2°, initial pose 0.05 m
    and 2°. In the lesson's demo the robot drove and started without error. Here the robot has the noise that the demo's
    filter assumes, so that a consistent filter can show its consistency.

    Returns
    -------
    World
    """
    degree = pi / 180
    return World(
        name="lesson",
        landmarks={0: np.array([5.0, 0.0]), 1: np.array([5.0, 5.0]), 2: np.array([0.0, 5.0])},
        motion=Unicycle(0.0, 0.0, pose_noise=np.diag([0.02**2, 0.02**2, degree**2])),
        sensor=RangeBearing(0.1, 2 * degree),
        controls=np.tile([0.5, 0.08726646259971647], (15, 1)),
        dt=0.2,
        pose=np.zeros(3),
        pose_covariance=np.diag([0.05**2, 0.05**2, (2 * degree) ** 2]),
    )


def loop_world(sensor: Literal["relative", "range-bearing"] = "relative", map_seed: int = 0) -> World:
    """Ten loops on a circle of 10 m between two rings of landmarks: experiments A and D of the reference.

    dt 1 s, v 0.25 m/s, ω 0.025 rad/s, 2500 steps, 20 landmarks 0.5-5 m off the path, σ_v = 0.05·v/√2,
    σ_ω = 0.05·v·2√2, range 0.5-5 m, P₀ = 1e-8 I; relative positions with 0.1 m an axis, or range and bearing with
    0.1 m and 2°.

    The reference leaves these open; they are our choice. The circle is centred at (0, 10), so that the robot starts on
    it at the origin. Each twentieth of the circle has one landmark at a random angle, alternately outside and inside,
    with an offset that is uniform in 0.5-5 m. The robot drives the circle exactly and the log holds its odometry: ten
    loops of commands with this noise (1.8 rad of heading at the end) would leave the map.

    Parameters
    ----------
    sensor : {"relative", "range-bearing"}
        Experiment A: relative positions. Experiment D: range and bearing.
    map_seed : int
        Seed of the landmarks. It affects nothing else: the runs of a study share a map.

    Returns
    -------
    World

    Raises
    ------
    InputError
        `sensor` is unknown.

    References
    ----------
    After Huang, Mourikis & Roumeliotis, IJRR 29(5):502-528 (2010), section 6.
    """
    sensors: dict[str, SensorModel] = {
        "relative": RelativePosition(0.1),
        "range-bearing": RangeBearing(0.1, np.deg2rad(2.0)),
    }
    if sensor not in sensors:
        raise InputError(f"sensor is {sensor!r}, expected one of {', '.join(map(repr, sensors))}")
    v, omega, count = 0.25, 0.025, 20
    rng = np.random.default_rng(map_seed)
    angle = 2 * pi * (np.arange(count) + rng.random(count)) / count
    offset = rng.uniform(0.5, 5.0, count) * np.where(np.arange(count) % 2 == 0, 1, -1)
    return World(
        name="loop" if sensor == "relative" else f"loop ({sensor})",
        landmarks=_ring(v / omega, angle, v / omega + offset),
        motion=Unicycle(0.05 * v / np.sqrt(2), 0.05 * v * 2 * np.sqrt(2)),
        sensor=sensors[sensor],
        controls=np.tile([v, omega], (2500, 1)),
        dt=1.0,
        pose=np.zeros(3),
        pose_covariance=1e-8 * np.eye(3),
        max_range=5.0,
        min_range=0.5,
        odometry=True,
    )


def ring_world() -> World:
    """A circle inside a ring of 20 landmarks: experiment B of the reference, the 2-D SLAM benchmark of UKF-M.

    dt 1 s, v 0.25 m/s, ω 1.5 °/s (so r = v/ω = 9.55 m), 2500 steps, landmarks evenly spaced at r + 3 m around the
    same centre, relative positions with 0.1 m an axis, range 1-5 m, σ_v = 0.05·v/√2, σ_ω = 0.05·v·2√2, P₀ = 0. As in
    the publication, the robot drives the circle exactly and the log holds its odometry.

    The publication leaves these open; they are our choice. The robot starts at the origin, the circle is centred at
    (0, r), and the first landmark is directly to the right of the start.

    Returns
    -------
    World

    References
    ----------
    Brossard, Barrau & Bonnabel, A code for unscented Kalman filtering on manifolds (UKF-M), ICRA (2020), and the
    benchmark page "2D Robot SLAM" of its documentation.
    """
    v, omega, count = 0.25, np.deg2rad(1.5), 20
    return World(
        name="ring",
        landmarks=_ring(v / omega, 2 * pi * np.arange(count) / count - pi / 2, np.full(count, v / omega + 3.0)),
        motion=EulerUnicycle(0.05 * v / np.sqrt(2), 0.05 * v * 2 * np.sqrt(2)),
        sensor=RelativePosition(0.1),
        controls=np.tile([v, omega], (2500, 1)),
        dt=1.0,
        pose=np.zeros(3),
        max_range=5.0,
        min_range=1.0,
        odometry=True,
    )


def standing_world(sigma_theta: float = pi / 36) -> World:
    """A robot that stands still and looks 300 times: experiment C of the reference.

    The robot stands at the origin with P₀ = diag(0.01² m², 0.01² m², σ_θ²). Five landmarks are 10 m away at -1 … 1 rad.
    Range 0.1 m, bearing 1°, no motion noise. Sightings from one place give no information about the heading: its
    claimed standard deviation must stay σ_θ. The reference gives no time between scans; here it is 1 s.

    Parameters
    ----------
    sigma_theta : float
        Initial standard deviation of the heading [rad], ≥ 0; 5° by default.

    Returns
    -------
    World
    """
    bearing = np.linspace(-1.0, 1.0, 5)
    return World(
        name="standing",
        landmarks=dict(enumerate(10.0 * np.column_stack([np.cos(bearing), np.sin(bearing)]))),
        motion=Unicycle(0.0, 0.0),
        sensor=RangeBearing(0.1, np.deg2rad(1.0)),
        controls=np.zeros((300, 2)),
        dt=1.0,
        pose=np.zeros(3),
        pose_covariance=np.diag([0.01**2, 0.01**2, float(sigma_theta) ** 2]),
    )


def random_world(
    rng: np.random.Generator,
    landmarks: int = 100,
    *,
    steps: int = 1000,
    density: float = 0.1,
    max_range: float = 5.0,
    sensor: SensorModel | None = None,
) -> World:
    """Any number of landmarks in a square, and a path among them, for benchmarks and tests.

    The landmarks are uniform in a square around the origin. Its side follows from their density and is at least 10 m.
    The robot starts in the middle and drives at 1 m/s (dt 0.1 s) to one random place after another. It turns at most
    1 rad/s and never leaves the square. The log holds its odometry, with noise of 0.1 m/s and 0.1 rad/s.

    Parameters
    ----------
    rng : numpy.random.Generator
        Draws the map and the path. The call advances it.
    landmarks : int
        Number of landmarks, ≥ 0; their ids are 0, 1, ….
    steps : int
        Number of steps, ≥ 1.
    density : float
        Landmarks per square metre, > 0. On average, π·max_range²·density landmarks are in view, 8 by default.
    max_range : float
        Range of the sensor [m].
    sensor : SensorModel, optional
        Range 0.1 m and bearing 2° by default.

    Returns
    -------
    World

    Raises
    ------
    InputError
        A number is outside its interval.
    """
    for name, fits, given in (
        ("landmarks", landmarks >= 0, landmarks),
        ("steps", steps >= 1, steps),
        ("density", 0 < density < inf, density),
    ):
        if not fits:
            raise InputError(f"{name} is {given}, expected {'≥ 0' if name == 'landmarks' else '> 0'}")
    v, turn, dt = 1.0, 1.0, 0.1
    side = max(10.0, float(np.sqrt(landmarks / density)))
    places = rng.uniform(-side / 2, side / 2, (landmarks, 2))
    # A turn takes the robot at most 2 v/turn beyond the place that it comes from or drives to.
    reach = side / 2 - 2 * v / turn
    motion = Unicycle(0.1, 0.1)
    pose, goal = np.zeros(3), rng.uniform(-reach, reach, 2)
    controls = np.empty((steps, 2))
    for k in range(steps):
        # The robot could circle forever around a goal that is nearer than its turning circle is wide.
        while np.hypot(*(goal - pose[:2])) < 2 * v / turn:
            goal = rng.uniform(-reach, reach, 2)
        off = wrap(np.arctan2(goal[1] - pose[1], goal[0] - pose[0]) - pose[2])
        controls[k] = v, np.clip(off / dt, -turn, turn)
        pose = motion.move(pose, controls[k], dt)
    return World(
        name=f"random {landmarks}",
        landmarks=dict(enumerate(places)),
        motion=motion,
        sensor=RangeBearing(0.1, np.deg2rad(2.0)) if sensor is None else sensor,
        controls=controls,
        dt=dt,
        pose=np.zeros(3),
        max_range=max_range,
        odometry=True,
    )


def _ring(radius: float, angle: Array, distance: Array) -> dict[Hashable, Array]:
    """Landmarks at polar coordinates around the centre of the circle that a left turn from the origin drives."""
    return dict(enumerate(np.column_stack([distance * np.cos(angle), radius + distance * np.sin(angle)])))


def _check(item: object) -> None:
    if not (isinstance(item, World) or callable(item)):
        raise InputError(f"a world must be a slamkit.World or a function that returns one, got {item!r}")


#: Command-line name → function that makes the world. ``WORLDS.register(name, function)`` adds one of your own.
WORLDS: Registry[Callable[..., World]] = Registry(
    "world", {"lesson": lesson_world, "loop": loop_world, "ring": ring_world, "standing": standing_world}, _check
)
