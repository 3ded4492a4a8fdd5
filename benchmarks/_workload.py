"""The work of every contender: a survey that maps a field of landmarks, then a drive through it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from slamkit import EKFSLAM, Log, Scan, Storage
from slamkit.arrays import Array
from slamkit.models import RangeBearing, Unicycle
from slamkit.se2 import wrap
from slamkit.simulate import random_world, simulate

IntArray = NDArray[np.int64]

SIGHTINGS = 8  #: per step of the drive; all landmarks if there are fewer
DRIVE = 5000  #: steps
DENSITY = 0.1  #: landmarks per square metre
NEAREST = 0.5  #: [m]; nearer landmarks are sighted last, because the range noise is large compared with their range
SIGMA_V, SIGMA_OMEGA = 0.02, float(np.deg2rad(0.1))  #: [m/s], [rad/s]
SIGMA_RANGE, SIGMA_BEARING = 0.1, float(np.deg2rad(2.0))  #: [m], [rad]
START = np.array([0.1, 0.1, 0.01])  #: standard deviations of the first pose [m, m, rad]; they correlate all landmarks

_STRIDE = (SIGHTINGS / DENSITY) ** 0.5  # [m]; a square of this side holds SIGHTINGS landmarks on average
_SURVEY_DT = 0.4  # [s]; one stride in this time is 80 km/h


@dataclass(frozen=True, eq=False)
class Work:
    """Steps in flat arrays. Each contender converts them to its own form.

    Step k applies ``controls[k]`` for ``dt[k]``, followed by the sightings first[k] … first[k+1]-1. The first `survey`
    steps sight each landmark once, so that landmark i is the i-th to be appended to the state. All later sightings are
    of mapped landmarks.
    """

    landmarks: int  #: N; the ids are 0 … N-1
    survey: int  #: number of steps of the survey
    times: Array  #: (K + 1,) [s]
    controls: Array  #: (K, 2): speed [m/s], turn rate [rad/s]
    first: IntArray  #: (K + 1,)
    ids: IntArray  #: (M,), ascending within a step
    z: Array  #: (M, 2): range [m], bearing [rad]
    pose: Array  #: (3,) where the filters start

    @property
    def steps(self) -> int:
        """K, including the survey."""
        return len(self.controls)

    @property
    def dim(self) -> int:
        """D = 3 + 2N."""
        return 3 + 2 * self.landmarks

    @cached_property
    def dt(self) -> Array:
        """Durations (K,) [s], computed from the times as in a log."""
        return np.diff(self.times)

    def log(self, begin: int, end: int) -> Log:
        """Steps begin … end-1 as a log."""
        seen = slice(self.first[begin], self.first[end])
        return Log(
            control_times=self.times[begin:end],
            controls=self.controls[begin:end],
            observation_times=np.repeat(self.times[begin + 1 : end + 1], np.diff(self.first[begin : end + 1])),
            observation_ids=self.ids[seen],
            observations=self.z[seen],
            landmark_ids=tuple(range(self.landmarks)),
            end_time=float(self.times[end]),
        )

    def scan(self, step: int) -> Scan:
        """The sightings of one step."""
        seen = slice(self.first[step], self.first[step + 1])
        return Scan(tuple(self.ids[seen].tolist()), self.z[seen])

    def surveyed(self, storage: Storage | None = None) -> EKFSLAM:
        """The standard EKF after the survey: every landmark is mapped and the covariance is dense."""
        motion, sensor = Unicycle(SIGMA_V, SIGMA_OMEGA), RangeBearing(SIGMA_RANGE, SIGMA_BEARING)
        f = EKFSLAM(motion, sensor, self.pose, np.diag(START**2), storage=storage)
        f.run(self.log(0, self.survey))
        return f


def make_work(landmarks: int, rng: np.random.Generator, *, drive: int = DRIVE, scattered: bool = False) -> Work:
    """A field of landmarks, a survey that maps them, and a drive that sights them again.

    Parameters
    ----------
    landmarks : int
    rng : numpy.random.Generator
    drive : int
        Steps of 0.1 s after the survey.
    scattered : bool
        False: each step of the drive sights the nearest landmarks, so that the landmarks in view change slowly.
        True: each step sights landmarks drawn anew from the whole map. No robot does that. It is the worst case for a
        filter that takes advantage of staying in one place.
    """
    world = random_world(rng, landmarks, steps=drive, density=DENSITY)
    world = replace(world, motion=Unicycle(SIGMA_V, SIGMA_OMEGA))
    start, moves, stops, arrivals = _survey_path(max(10.0, (landmarks / DENSITY) ** 0.5))
    places = np.array(list(world.landmarks.values()))
    stop = cKDTree(stops).query(places)[1]
    order = np.argsort(stop, kind="stable")
    places, seen_at = places[order], arrivals[stop[order]]

    survey = simulate(replace(world, landmarks={}, controls=moves, dt=_SURVEY_DT, pose=start), rng)
    tour = simulate(replace(world, landmarks={}), rng)
    assert survey.truth is not None and tour.truth is not None
    if scattered:
        count = min(SIGHTINGS, landmarks)
        rows = np.sort([rng.choice(landmarks, count, replace=False) for _ in range(drive)], axis=1)
    else:
        rows = _nearest(places, tour.truth.poses[1:, :2])

    poses = np.concatenate([survey.truth.poses[1:], tour.truth.poses[1:]])
    steps = np.concatenate([seen_at, np.repeat(np.arange(len(moves), len(poses)), rows.shape[1])])
    ids = np.concatenate([np.arange(landmarks), rows.ravel()])
    offset = places[ids] - poses[steps, :2]
    z = np.column_stack([np.hypot(*offset.T), np.arctan2(offset[:, 1], offset[:, 0]) - poses[steps, 2]])
    z += rng.normal(0.0, (SIGMA_RANGE, SIGMA_BEARING), z.shape)
    z[:, 0], z[:, 1] = np.abs(z[:, 0]), wrap(z[:, 1])
    return Work(
        landmarks=landmarks,
        survey=len(moves),
        times=np.concatenate([survey.truth.times, survey.truth.times[-1] + tour.truth.times[1:]]),
        controls=np.concatenate([survey.controls, tour.controls]),
        first=np.searchsorted(steps, np.arange(len(poses) + 1)),
        ids=ids,
        z=z,
        pose=start + rng.normal(0.0, START),
    )


def _survey_path(side: float) -> tuple[Array, Array, Array, IntArray]:
    """First pose (3,), controls (T, 2), stops (n, 2), and the steps (n,) that end at the stops.

    The path covers a square around the origin in lanes, with turns on the spot, and ends at the origin, where the drive
    begins.
    """
    lanes = int(np.ceil(side / _STRIDE))
    stride = side / lanes
    at = stride * (np.arange(lanes) - (lanes - 1) / 2)
    stops = np.array([(x, y) for n, y in enumerate(at) for x in (at if n % 2 == 0 else at[::-1])])
    way_back = np.linspace(stops[-1], (0.0, 0.0), int(np.ceil(np.hypot(*stops[-1]) / stride)) + 1)[1:]
    start = np.array([stops[0, 0] - stride, stops[0, 1], 0.0])
    moves: list[tuple[float, float]] = []
    arrivals: list[int] = []
    x, y, heading = start.tolist()
    for goal_x, goal_y in (*stops.tolist(), *way_back.tolist()):
        direction = float(np.arctan2(goal_y - y, goal_x - x))
        if abs(wrap(direction - heading)) > 1e-9:
            moves.append((0.0, float(wrap(direction - heading)) / _SURVEY_DT))
        moves.append((float(np.hypot(goal_x - x, goal_y - y)) / _SURVEY_DT, 0.0))
        x, y, heading = goal_x, goal_y, direction
        arrivals.append(len(moves) - 1)
    moves.append((0.0, float(wrap(-heading)) / _SURVEY_DT))
    return start, np.array(moves), stops, np.array(arrivals[: len(stops)])


def _nearest(places: Array, positions: Array) -> IntArray:
    """Rows of the landmarks sighted from each position, ascending."""
    candidates = min(len(places), 2 * SIGHTINGS)
    distance, rows = cKDTree(places).query(positions, candidates)
    order = np.argsort(np.where(distance < NEAREST, np.inf, distance), axis=1, kind="stable")
    chosen: IntArray = np.sort(np.take_along_axis(rows, order, axis=1)[:, :SIGHTINGS], axis=1)
    return chosen
