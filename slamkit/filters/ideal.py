"""The ideal EKF: every Jacobian at the truth. It cannot be built, only simulated; it is what the others aim at."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from slamkit.arrays import Array, finite_number
from slamkit.compiled import compiled
from slamkit.cycle.estimator import EstimatorFunctions
from slamkit.cycle.standard import initialise as standard_initialise
from slamkit.cycle.standard import motion as standard_motion
from slamkit.cycle.standard import motion_noise
from slamkit.cycle.standard import sensor as standard_sensor
from slamkit.errors import InputError
from slamkit.filters.assignment import locked
from slamkit.filters.ekf import EKFSLAM
from slamkit.filters.running import Progress
from slamkit.logs import History, Log, Schedule, Truth, decode_id, encode_id
from slamkit.protocols import MotionModel, SensorModel

# ``belief.linearised_at`` holds the true state, ``scratch.told_of_steps`` the true pose at the end of each step,
# and ``scratch.told_of_sightings`` the true landmark of each sighting.


@compiled("void(models, state, vector, real)", generic=True)
def motion(models: Any, state: Any, u: Any, dt: float) -> None:
    """F = [I, J(p'_true - p_true); 0 1], G and Q at the true pose."""
    standard_motion(models, state, u, dt)
    pose, F = state.belief.linearised_at[:3], state.last.F
    arrived = np.empty(3)
    models.move(pose, u, dt, models.motion_params, arrived)
    models.motion_jacobians(pose, u, dt, models.motion_params, F, state.scratch.G)
    motion_noise(models, state, pose, u, dt)
    # The model's own lever arm ends where the noiseless control leads; the truth is elsewhere.
    true_pose = state.scratch.told_of_steps[state.scratch.step_row]
    F[0, 2] -= true_pose[1] - arrived[1]
    F[1, 2] += true_pose[0] - arrived[0]


@compiled("void(models, state, integers, flag)", generic=True)
def prepare_scan(models: Any, state: Any, slots: Any, moved: bool) -> None:
    """The robot is where it is."""
    if moved:
        true_pose = state.scratch.told_of_steps[state.scratch.step_row]
        for i in range(3):
            state.belief.linearised_at[i] = true_pose[i]


@compiled("void(models, state, vector, vector, index, vector, index)", generic=True)
def sensor(models: Any, state: Any, pose: Any, landmark: Any, slot: int, z: Any, row: int) -> None:
    """The innovation at the estimate, H at the truth."""
    standard_sensor(models, state, pose, landmark, slot, z, row)
    rows = slice(row, row + z.shape[0])
    true_pose, true_landmark = state.belief.linearised_at[:3], state.belief.linearised_at[slot : slot + 2]
    models.sensor_jacobians(
        true_pose, true_landmark, models.sensor_params, state.scratch.H_pose[rows], state.scratch.H_landmark[rows]
    )


@compiled("void(models, state, index, index, vector)", generic=True)
def initialise(models: Any, state: Any, slot: int, place: int, z: Any) -> None:
    """The landmark from the estimate, G_x and G_z at the truth."""
    landmark = state.scratch.told_of_sightings[state.scratch.first_row + place]
    exact = np.empty(z.shape[0])
    models.predict(state.belief.linearised_at[:3], landmark, models.sensor_params, exact)
    x, y, heading = state.belief.mean[0], state.belief.mean[1], state.belief.mean[2]
    state.belief.mean[0], state.belief.mean[1], state.belief.mean[2] = (
        state.belief.linearised_at[0],
        state.belief.linearised_at[1],
        state.belief.linearised_at[2],
    )
    standard_initialise(models, state, slot, place, exact)
    state.belief.mean[0], state.belief.mean[1], state.belief.mean[2] = x, y, heading
    models.invert(state.belief.mean[:3], z, models.sensor_params, state.belief.mean[slot : slot + 2])
    state.belief.linearised_at[slot], state.belief.linearised_at[slot + 1] = landmark[0], landmark[1]


class IdealEKFSLAM(EKFSLAM):
    """Ideal EKF-SLAM: Jacobians at the truth, which only a simulation knows.

    Parameters
    ----------
    motion, sensor, pose, pose_covariance, order
        As of :class:`slamkit.EKFSLAM`.
    truth : Truth, optional
        The true poses at the end of every prediction and the true landmarks. `run` takes the log's own where this
        is None.
    **options
        Further options of :class:`slamkit.EKFSLAM`.

    Raises
    ------
    InputError
        It is asked to work without the truth, or the truth lacks a landmark or a pose within `TOLERANCE` of a step.

    Notes
    -----
    The filter keeps a clock, which starts at the truth's first time and goes on with every prediction.

    References
    ----------
    Huang, Mourikis & Roumeliotis, IJRR 29(5):502-528 (2010), section 4.2.
    """

    name = "ideal"
    linearisation_points = "linearised_at"
    functions = EstimatorFunctions(motion=motion, sensor=sensor, initialise=initialise, prepare_scan=prepare_scan)

    TOLERANCE = 1e-3  #: how far [s] a true pose may lie from the time at which it is needed

    def __init__(
        self,
        motion: MotionModel,
        sensor: SensorModel,
        pose: ArrayLike = (0.0, 0.0, 0.0),
        pose_covariance: ArrayLike | None = None,
        order: str = "sequential",
        truth: Truth | None = None,
        **options: Any,
    ) -> None:
        super().__init__(motion, sensor, pose, pose_covariance, order, **options)
        self._truth: Truth | None = None
        self.time = 0.0
        if truth is not None:
            self._learn(truth)

    @property
    def truth(self) -> Truth | None:
        """What the filter knows of the truth. Assigning sets its clock to the first time of the truth."""
        return self._truth

    @truth.setter
    @locked
    def truth(self, value: Truth | None) -> None:
        self._learn(value)

    def _learn(self, truth: Truth | None) -> None:
        if not isinstance(truth, Truth | None):
            raise InputError(f"truth is a {type(truth).__name__}, expected a slamkit.Truth")
        if truth is None or len(truth.times) == 0:
            raise InputError("the ideal filter needs the truth: give truth=…, or run a log that has one")
        self._truth, self.time = truth, float(truth.times[0])
        self._belief.state.belief.linearised_at[:3] = truth.poses[0]

    @locked
    def run(self, log: Log, progress: Progress = False) -> History:
        """As :meth:`EKFSLAM.run`; the truth is the log's, unless the filter has been given one."""
        if isinstance(log, Log) and self.truth is None:
            self._learn(log.truth)
        try:
            history = super().run(log, progress)
        except BaseException as failure:  # whatever a model in Python raises
            self._set_clock(getattr(failure, "history", None))
            raise
        self._set_clock(history)
        return history

    def _set_clock(self, history: History | None) -> None:
        if history is not None and len(history.times):
            self.time = float(history.times[-1])

    def _before_run(self, log: Log, schedule: Schedule) -> None:
        poses = np.array([self._true_pose(t) for t in schedule.times]).reshape(-1, 3)
        self._tell(poses, self._true_landmarks(log.landmark_ids)[log.observation_ids])

    def _tell(self, poses: Array, landmarks: Array) -> None:
        """Write the true poses that steps arrive at, and the true landmarks of their sightings."""
        scratch = self._belief.state.scratch
        scratch.told_of_steps, scratch.told_of_sightings = poses, np.ascontiguousarray(landmarks)
        scratch.step_row = scratch.first_row = 0

    def _apply_step(self, u: Array, dt: float, ids: Sequence[Hashable], z: Array) -> None:
        if self.truth is None:
            self._learn(None)
        self._tell(self._true_pose(self.time + dt)[None].copy(), self._true_landmarks(ids))
        super()._apply_step(u, dt, ids, z)
        self.time += dt

    def _true_pose(self, time: float) -> Array:
        assert self.truth is not None
        times = self.truth.times
        near = int(np.clip(np.searchsorted(times, time), 1, max(len(times) - 1, 1)))
        k = min((near - 1, min(near, len(times) - 1)), key=lambda i: abs(float(times[i]) - time))
        if abs(float(times[k]) - time) > self.TOLERANCE:
            raise InputError(f"the truth has no pose at {time} s: the nearest is at {times[k]} s")
        return np.asarray(self.truth.poses[k])

    def _true_landmarks(self, ids: Sequence[Hashable]) -> Array:
        assert self.truth is not None
        missing = [i for i in ids if i not in self.truth.landmarks]
        if missing:
            raise InputError(f"the truth has no landmark {missing[0]!r}")
        return np.array([self.truth.landmarks[i] for i in ids]).reshape(-1, 2)

    def _facts(self) -> dict[str, Any]:
        truth = self.truth
        return {
            "time": self.time,
            "truth": None
            if truth is None
            else {
                "times": truth.times.tolist(),
                "poses": truth.poses.tolist(),
                "landmarks": [[encode_id(i), p.tolist()] for i, p in truth.landmarks.items()],
            },
        }

    @classmethod
    def _options(cls, facts: dict[str, Any]) -> dict[str, Any]:
        known = facts["truth"]
        if known is None:
            return {}
        landmarks = {decode_id(i): np.array(p) for i, p in known["landmarks"]}
        return {"truth": Truth(np.array(known["times"]), np.array(known["poses"]).reshape(-1, 3), landmarks)}

    def _resume(self, facts: dict[str, Any]) -> None:
        self.time = finite_number("time", facts["time"])
