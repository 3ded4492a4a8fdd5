"""Drive once through a world and log what the robot commands and sees."""

from __future__ import annotations

from collections.abc import Iterator
from math import pi

import numpy as np
from numpy.typing import ArrayLike

from slamkit.arrays import Array
from slamkit.errors import ModelError
from slamkit.logs import Log, Truth
from slamkit.se2 import wrap, wrap_angle
from slamkit.simulate.world import World, square_root

__all__ = ["simulate"]


def simulate(world: World, rng: np.random.Generator) -> Log:
    """Drive once through a world.

    Step k (0 ≤ k < T) moves the robot from time k·dt to (k+1)·dt. Then the robot sights the landmarks. Noise is added
    to the control, to the pose after the move and to the measurement, as :class:`slamkit.protocols.MotionModel` and
    :class:`slamkit.protocols.SensorModel` define it. A sighting that its noise makes impossible (a negative range) is
    left out.

    Initial pose, control noise, pose noise, measurement noise and detection each have a generator of their own, with a
    fixed number of draws in each step. Changing the sensor therefore leaves the motion unchanged, a landmark in view
    has the same noise whatever other landmarks are in view, and a shorter run is the beginning of a longer one.

    Parameters
    ----------
    world : World
    rng : numpy.random.Generator
        Its state determines the run: the same state gives the same log, bit for bit. The call advances it.

    Returns
    -------
    Log
        Controls at k·dt, sightings at (k+1)·dt, and the truth at k·dt for k = 0 … T. `landmark_ids` are the sighted
        landmarks in the world's order. The truth has every landmark.

    Raises
    ------
    ModelError
        A model gave a matrix that is not a covariance, or a pose that is not finite.
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
    poses[0] = world.pose + square_root(world.pose_covariance) @ start.standard_normal(3)
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
    # Every step draws noise for all landmarks. A chunk of steps at a time limits the memory for it.
    chunk = max(1, 10**6 // max(1, landmarks.size))
    for first in range(0, len(poses), chunk):
        part = poses[first : first + chunk]
        draws = measurement.standard_normal((len(part), len(landmarks), len(root)))
        detected = detection.random((len(part), len(landmarks))) < world.detection_probability
        dx, dy = landmarks[:, 0] - part[:, :1], landmarks[:, 1] - part[:, 1:2]
        distance = np.hypot(dx, dy)
        in_view = detected & (distance >= world.min_range) & (distance <= world.max_range)
        if world.field_of_view < 2 * pi:
            in_view &= np.abs(wrap(np.arctan2(dy, dx) - part[:, 2:])) <= world.field_of_view / 2
        for step, row in np.argwhere(in_view).tolist():
            z = sensor.predict(part[step], landmarks[row]) + root @ draws[step, row]
            # The residual to zero is z with its angles wrapped. It is NaN when no sensor could have given z.
            z = sensor.residual(z, zero)
            if np.all(np.isfinite(z)):
                yield first + step, row, z


class _RootOf:
    """Square root of a model's covariances. It is computed again only when the covariance changes."""

    def __init__(self, name: str, size: int) -> None:
        self.name, self.size = name, size
        self.root: Array = np.empty((0, 0))
        self.known: bytes | None = None  # the covariance as it was given: bytes compare faster than arrays

    def __call__(self, covariance: ArrayLike) -> Array:
        given = np.asarray(covariance)
        if given.tobytes() != self.known:
            matrix = np.array(given, dtype=float)
            if matrix.shape != (self.size, self.size):
                raise ModelError(f"{self.name} has shape {matrix.shape}, expected ({self.size}, {self.size})")
            try:
                self.root = square_root(matrix)
            except ValueError as error:
                raise ModelError(f"{self.name} {error}") from None
            self.known = given.tobytes()
        return self.root
