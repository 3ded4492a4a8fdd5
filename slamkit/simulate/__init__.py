"""Simulation: a World and a random generator give a Log with its truth."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping
from dataclasses import dataclass, field
from math import inf, pi
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from slamkit.arrays import finite_array
from slamkit.errors import InputError, ModelError
from slamkit.logs import Log, Truth
from slamkit.models import EulerUnicycle, RangeBearing, RelativePosition, Unicycle
from slamkit.protocols import MotionModel, SensorModel
from slamkit.se2 import wrap, wrap_angle

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class World:
    """Everything about a simulated run but its noise.

    The models are those of reality: a filter brings models of its own, and may be wrong about the noise.

    Parameters
    ----------
    name : str
        What tables and figures call it.
    landmarks : mapping id → array_like (2,)
        True positions [m]; may be empty.
    motion : MotionModel
        How the robot moves, with the true noise.
    sensor : SensorModel
        What the robot measures, with the true noise.
    controls : array_like (T, m)
        One control a step, T ≥ 1.
    dt : float
        Duration of a step [s], > 0.
    pose : array_like (3,)
        Where a filter starts [m, m, rad].
    pose_covariance : array_like (3, 3), optional
        Covariance [m², m·rad, rad²] with which the true initial pose is drawn around `pose`; zeros by default: it
        is `pose`.
    max_range, min_range : float
        A landmark is sighted at a distance [m] in [min_range, max_range].
    field_of_view : float
        Full angle [rad] around the robot's x axis in which landmarks are sighted, in (0, 2π].
    detection_probability : float
        Probability that a landmark in sight gives a sighting, in [0, 1].
    odometry : bool
        False: `controls` are commands; the log holds them, and the robot drives u + w.
        True: `controls` are what the robot drives, to the letter, and the log holds what its odometry makes of them,
        u - w. In both cases pose' = move(pose, logged control + w, dt) with w ~ N(0, control_noise(u, dt)): it is the
        same estimation problem, but a path of commands wanders off by its noise, and one of odometry does not.
    increments : bool
        Whether a control is the whole motion of a step (odometry increments) instead of a rate; see
        :class:`slamkit.logs.Log`.

    Raises
    ------
    InputError
        A wrong shape, a value that is not finite or out of its interval, or a covariance that is none.
    """

    name: str
    landmarks: Mapping[Any, Array]
    motion: MotionModel
    sensor: SensorModel
    controls: Array
    dt: float
    pose: Array
    pose_covariance: Array = field(default_factory=lambda: np.zeros((3, 3)))
    max_range: float = inf
    min_range: float = 0.0
    field_of_view: float = 2 * pi
    detection_probability: float = 1.0
    odometry: bool = False
    increments: bool = False

    def __post_init__(self) -> None:
        landmarks = {i: finite_array(f"landmark {i!r}", p, (2,)) for i, p in self.landmarks.items()}
        controls = finite_array("controls", self.controls, (-1, -1))
        if len(controls) == 0:
            raise InputError(f"controls have shape {controls.shape}, expected at least one row")
        for name, value in (
            ("landmarks", landmarks),
            ("controls", controls),
            ("pose", finite_array("pose", self.pose, (3,))),
            ("pose_covariance", finite_array("pose_covariance", self.pose_covariance, (3, 3))),
        ):
            object.__setattr__(self, name, value)
        try:
            _root(self.pose_covariance)
        except ValueError as error:
            raise InputError(f"pose_covariance {error}") from None
        for name, fits, expected in (
            ("dt", 0 < self.dt < inf, "a finite duration > 0 s"),
            ("min_range", 0 <= self.min_range < inf, "a finite range ≥ 0 m"),
            ("max_range", self.max_range >= self.min_range, f"a range ≥ min_range = {self.min_range} m"),
            ("field_of_view", 0 < self.field_of_view <= 2 * pi, "an angle in (0, 2π] rad"),
            ("detection_probability", 0 <= self.detection_probability <= 1, "a probability in [0, 1]"),
        ):
            if not fits:
                raise InputError(f"{name} is {getattr(self, name)}, expected {expected}")


def simulate(world: World, rng: np.random.Generator) -> Log:
    """Drive once through a world.

    Step k (0 ≤ k < T) moves the robot from time k·dt to (k+1)·dt; then it sights the landmarks. The noise enters as
    :class:`slamkit.protocols.MotionModel` and :class:`slamkit.protocols.SensorModel` say: on the control, on the pose
    after the move, on the measurement. A sighting whose noise makes it impossible (a negative range) is not made.

    Initial pose, control noise, pose noise, measurement noise and detection are drawn from generators of their own,
    a fixed number of draws each step. So whatever is changed in the sensor leaves the motion as it was, a landmark in
    sight has the same noise however many others are in sight, and a shorter run is the beginning of the longer one.

    Parameters
    ----------
    world : World
    rng : numpy.random.Generator
        Its state decides the run: the same state gives the same log, to the bit. It is advanced.

    Returns
    -------
    Log
        Controls at k·dt, sightings at (k+1)·dt, the truth at k·dt for k = 0 … T. `landmark_ids` are those sighted, in
        the world's order; the truth has every landmark.

    Raises
    ------
    ModelError
        A model gave a covariance that is none, or a pose that is not finite.
    """
    start, control, pose, measurement, detection = (
        np.random.default_rng(seed) for seed in rng.integers(0, 2**63, (5, 4))
    )
    poses, controls = _drive(world, start, control, pose)
    if not np.all(np.isfinite(poses)):
        step = int(np.argmin(np.isfinite(poses).all(1))) - 1
        raise ModelError(f"world {world.name!r}: {world.motion!r} gave a pose that is not finite in step {step}")
    seen = list(_look(world, poses[1:], measurement, detection))
    steps = np.array([step for step, _, _ in seen], dtype=np.int64)
    rows, ids = np.unique(np.array([row for _, row, _ in seen], dtype=np.int64), return_inverse=True)
    names = list(world.landmarks)
    times: Array = float(world.dt) * np.arange(len(poses), dtype=np.float64)
    return Log(
        control_times=times[:-1],
        controls=controls,
        observation_times=times[steps + 1],
        observation_ids=ids,
        observations=np.array([z for _, _, z in seen]).reshape(len(seen), len(world.sensor.R)),
        landmark_ids=tuple(names[row] for row in rows),
        end_time=float(times[-1]),
        increments=world.increments,
        truth=Truth(times, poses, world.landmarks),
    )


def _drive(
    world: World, start: np.random.Generator, control: np.random.Generator, pose: np.random.Generator
) -> tuple[Array, Array]:
    """True poses (T + 1, 3) and logged controls (T, m)."""
    controls, dt, motion = world.controls, world.dt, world.motion
    control_root, pose_root = _RootOf("control_noise", controls.shape[1]), _RootOf("pose_noise", 3)
    control_draws, pose_draws = control.standard_normal(controls.shape), pose.standard_normal((len(controls), 3))
    logged, poses = np.empty_like(controls), np.empty((len(controls) + 1, 3))
    poses[0] = world.pose + _root(world.pose_covariance) @ start.standard_normal(3)
    poses[0, 2] = wrap(poses[0, 2])
    for k, u in enumerate(controls):
        w = control_root(motion.control_noise(u, dt)) @ control_draws[k]
        driven, logged[k] = (u, u - w) if world.odometry else (u + w, u)
        slip = pose_root(motion.pose_noise(poses[k], u, dt)) @ pose_draws[k]
        poses[k + 1] = motion.move(poses[k], driven, dt) + slip
        poses[k + 1, 2] = wrap_angle(poses[k + 1, 2])
    return poses, logged


def _look(
    world: World, poses: Array, measurement: np.random.Generator, detection: np.random.Generator
) -> Iterator[tuple[int, int, Array]]:
    """Sightings as (step, row of the landmark, measurement)."""
    sensor, landmarks = world.sensor, np.array(list(world.landmarks.values())).reshape(-1, 2)
    root = _RootOf("R", len(sensor.R))(sensor.R)
    zero = np.zeros(len(root))
    together = max(1, 10**6 // max(1, landmarks.size))  # steps; the noise of all landmarks is drawn at every step
    for first in range(0, len(poses), together):
        part = poses[first : first + together]
        draws = measurement.standard_normal((len(part), len(landmarks), len(root)))
        detected = detection.random((len(part), len(landmarks))) < world.detection_probability
        dx, dy = landmarks[:, 0] - part[:, :1], landmarks[:, 1] - part[:, 1:2]
        distance = np.hypot(dx, dy)
        in_sight = detected & (distance >= world.min_range) & (distance <= world.max_range)
        if world.field_of_view < 2 * pi:
            in_sight &= np.abs(wrap(np.arctan2(dy, dx) - part[:, 2:])) <= world.field_of_view / 2
        for step, row in np.argwhere(in_sight).tolist():
            z = sensor.predict(part[step], landmarks[row]) + root @ draws[step, row]
            # The residual to zero is z with its angles wrapped, and NaN where no sensor could have given z.
            z = sensor.residual(z, zero)
            if np.all(np.isfinite(z)):
                yield first + step, row, z


class _RootOf:
    """Square root of a model's covariances, computed anew only where the covariance changes."""

    def __init__(self, name: str, size: int) -> None:
        self.name, self.size = name, size
        self.covariance = self.root = np.empty((0, 0))
        self.known: bytes | None = None  # the covariance as it was given: bytes compare faster than arrays

    def __call__(self, covariance: Array) -> Array:
        covariance = np.asarray(covariance)
        if covariance.tobytes() != self.known:
            self.covariance, self.known = np.array(covariance, dtype=float), covariance.tobytes()
            if self.covariance.shape != (self.size, self.size):
                raise ModelError(f"{self.name} has shape {self.covariance.shape}, expected ({self.size}, {self.size})")
            try:
                self.root = _root(self.covariance)
            except ValueError as error:
                raise ModelError(f"{self.name} {error}") from None
        return self.root


def _root(covariance: Array) -> Array:
    """The symmetric square root: unlike Cholesky's it exists for a semidefinite matrix, and it keeps a diagonal."""
    if not np.all(np.isfinite(covariance)):
        raise ValueError("is not finite")
    scale = np.abs(covariance).max(initial=0.0)
    if np.abs(covariance - covariance.T).max(initial=0.0) > 1e-9 * scale:
        raise ValueError(f"is not symmetric: {covariance.tolist()}")
    values, vectors = np.linalg.eigh(covariance)
    if np.any(values < -1e-12 * scale):
        raise ValueError(f"is not positive semidefinite: its smallest eigenvalue is {values[0]:.3g}")
    root: Array = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    return root


def lesson_world() -> World:
    """Three landmarks, fifteen steps: the introductory lesson's demo.

    v = 0.5 m/s, ω = 5 °/s, dt = 0.2 s from the origin; landmarks 0, 1, 2 on the corners of a square of 5 m, always
    in sight. Pose noise Q = diag(0.02² m², 0.02² m², (1°)²) a step, range 0.1 m, bearing 2°, initial pose 0.05 m and
    2°. The demo itself drove and started without an error; here reality has the noise that the demo's filter claims,
    so that a consistent filter can show that it is.

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

    Chosen where the reference is silent: the circle is centred at (0, 10), so that the robot starts on it at the
    origin; the landmarks are spread evenly in angle, one in each twentieth of the circle and anywhere in it,
    alternately outside and inside, with an offset that is uniform in 0.5-5 m; the robot drives the circle and the log
    holds its odometry, since ten loops of commands with this noise (1.8 rad of heading in the end) would leave the map.

    Parameters
    ----------
    sensor : {"relative", "range-bearing"}
        A: relative positions. D: range and bearing.
    map_seed : int
        Draws the landmarks, and nothing else: the runs of a study share a map.

    Returns
    -------
    World

    Raises
    ------
    InputError
        An unknown sensor.

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
    same centre, relative positions with 0.1 m an axis, range 1-5 m, σ_v = 0.05·v/√2, σ_ω = 0.05·v·2√2, P₀ = 0. The
    robot drives the circle and the log holds its odometry, as there.

    Chosen where the publication is silent: the robot starts at the origin, the circle is centred at (0, r) and the
    first landmark lies straight to the right of the start.

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

    At the origin with P₀ = diag(0.01² m², 0.01² m², σ_θ²), five landmarks 10 m away from there at -1 … 1 rad, range
    0.1 m and bearing 1°, no motion noise. What is seen from one place says nothing of the heading: its claimed
    standard deviation must stay σ_θ. The reference gives no time between scans: 1 s here.

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
    """Any number of landmarks in a square, and a path among them: for benchmarks and tests.

    The landmarks are uniform in a square around the origin that is as large as their density wants, 10 m at least.
    The robot starts in its middle and drives at 1 m/s (dt 0.1 s) to one random place after another, turning at most
    1 rad/s, and never leaves the square. The log holds its odometry: 0.1 m/s and 0.1 rad/s.

    Parameters
    ----------
    rng : numpy.random.Generator
        Draws the map and the path; it is advanced.
    landmarks : int
        Number of landmarks, ≥ 0; their ids are 0, 1, ….
    steps : int
        Number of steps, ≥ 1.
    density : float
        Landmarks per square metre, > 0. On the average π·max_range²·density are in sight, 8 by default.
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
        A number is out of its interval.
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
    # A turn takes the robot at most 2 v/turn beyond the place it comes from or heads for.
    reach = side / 2 - 2 * v / turn
    motion = Unicycle(0.1, 0.1)
    pose, goal = np.zeros(3), rng.uniform(-reach, reach, 2)
    controls = np.empty((steps, 2))
    for k in range(steps):
        # Nearer than its turning circle is wide, the robot might go around its goal for ever.
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


#: The worlds that the command line knows by name.
WORLDS: Mapping[str, Callable[..., World]] = {
    "lesson": lesson_world,
    "loop": loop_world,
    "ring": ring_world,
    "standing": standing_world,
}
