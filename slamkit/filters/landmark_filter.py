"""What every landmark filter does, whichever of filterpy's classes it derives from."""

from __future__ import annotations

import copy
import sys
import threading
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from slamkit.arrays import Array, covariance, finite_array, finite_number
from slamkit.belief import Belief, Storage
from slamkit.errors import AssignmentError, InputError, UnsupportedError
from slamkit.filters import running, saving
from slamkit.filters.assignment import locked
from slamkit.filters.inputs import NO_CONTROL, hashable, sightings
from slamkit.filters.model_functions import adapt
from slamkit.filters.running import Progress
from slamkit.filters.stepping import Stepping
from slamkit.logs import History, Log, Scan
from slamkit.protocols import MotionModel, SensorModel, require_model
from slamkit.se2 import wrap


class LandmarkFilter(Stepping):
    """A filter over a pose and a growing map, composed from a motion and a sensor model.

    Concrete estimators derive from this class and from one of filterpy's. See :class:`slamkit.EKFSLAM` for the
    parameters and the attributes. An estimator states its `name` and what it does otherwise than the standard EKF.

    Notes
    -----
    Threads take turns with one filter: a call waits until another thread's call has ended.
    """

    def __init__(
        self,
        motion: MotionModel,
        sensor: SensorModel,
        pose: ArrayLike = (0.0, 0.0, 0.0),
        pose_covariance: ArrayLike | None = None,
        order: str = "sequential",
        *,
        gate: float | None = None,
        snapshots: bool = False,
        storage: Storage | None = None,
    ) -> None:
        self._lock = threading.RLock()
        require_model(motion, MotionModel, "motion")
        R = _noise(sensor)
        x = finite_array("pose", pose, (3,))
        P = np.zeros((3, 3)) if pose_covariance is None else covariance("pose_covariance", pose_covariance, 3)
        if not isinstance(storage, Storage | None):
            raise InputError(f"storage is {storage!r}, expected None or a slamkit.Storage")
        if not isinstance(snapshots, bool | np.bool_):
            raise InputError(f"snapshots is {snapshots!r}, expected True or False")
        self._motion, self._sensor, self._order, self._gate = motion, sensor, _known_order(order), _largest_nis(gate)
        self.snapshots, self.storage = bool(snapshots), Storage() if storage is None else storage
        self.dim_z, self.B = len(R), 0
        self.dim_u = int(getattr(motion, "control_dim", 0))
        x[2] = wrap(x[2])
        rest = (0, self.base - 3)
        # With snapshots P is copied at every step anyhow.
        compresses = self.compresses and not snapshots
        kept = self.storage if compresses else replace(self.storage, compress_above=sys.maxsize // 4)
        start = np.pad(x, rest), np.pad(P, rest)
        self._belief = Belief(*start, self.dim_z, max(self.dim_u, 1), kept, self.own_fields)
        self._models = adapt(motion, sensor, R)
        self._policy = self._new_policy()

    # -- what it is made of -------------------------------------------------------------------------------------------

    @property
    def motion(self) -> MotionModel:
        """The motion model. Assign another to use it from the next step on."""
        return self._motion

    @motion.setter
    @locked
    def motion(self, value: MotionModel) -> None:
        require_model(value, MotionModel, "motion")
        self._models, self._motion = adapt(value, self._sensor, _noise(self._sensor)), value
        vars(self)["dim_u"] = 0
        self._take_control_length(int(getattr(value, "control_dim", 0)))

    @property
    def sensor(self) -> SensorModel:
        """The sensor model. Assign another, with measurements of the same length, to use it from the next step on."""
        return self._sensor

    @sensor.setter
    @locked
    def sensor(self, value: SensorModel) -> None:
        R = _noise(value)
        if len(R) != self.dim_z:
            raise AssignmentError(f"the sensor gives {len(R)} numbers, this filter is laid out for {self.dim_z}")
        self._models, self._sensor = adapt(self._motion, value, R), value

    @property
    def order(self) -> str:
        """``"sequential"`` or ``"batch"``, see the parameter; it may be assigned to."""
        return self._order

    @order.setter
    @locked
    def order(self, value: str) -> None:
        self._order = _known_order(value)
        self._policy = self._new_policy()

    @property
    def gate(self) -> float | None:
        """Largest NIS of a sighting that is accepted, None for all; it may be assigned to."""
        return self._gate

    @gate.setter
    @locked
    def gate(self, value: float | None) -> None:
        self._gate = _largest_nis(value)
        self._policy = self._new_policy()

    # -- the cycle ----------------------------------------------------------------------------------------------------

    @locked
    def predict(self, u: ArrayLike = 0, dt: float = 0.0) -> None:
        """Move the pose by the control u over dt. Touches the pose's rows only: O(D).

        Parameters
        ----------
        u : array_like (m,)
            Control, in the motion model's units.
        dt : float
            Duration [s], > 0.

        Raises
        ------
        InputError
            Wrong shape, a value that is not finite, dt ≤ 0. The belief stays as it was.
        """
        self._apply_step(self._control(u), _duration(dt), (), np.empty((0, self.dim_z)))
        if self.snapshots:
            self._prior = self.x, self.P

    @locked
    def observe(self, landmark_id: Hashable, z: ArrayLike) -> None:
        """Use one sighting: a new landmark extends the map, a known one corrects the belief.

        Parameters
        ----------
        landmark_id : hashable
        z : array_like (k,)
            Measurement, in the sensor model's units.

        Raises
        ------
        InputError
            Wrong shape, not finite, or not a possible measurement. The belief stays as it was.
        """
        self.observe_scan(Scan((landmark_id,), finite_array("z", z, (self.dim_z,))[None]))

    @locked
    def observe_scan(self, scan: Scan | Mapping[Hashable, ArrayLike]) -> None:
        """Use all sightings of one instant, in their order, or stacked where ``order="batch"``."""
        ids, z = sightings(scan, self.dim_z, self._sensor)
        self._apply_step(NO_CONTROL, 0.0, ids, z)
        if self.snapshots:
            self._posterior = self.x, self.P

    @locked
    def step(self, u: ArrayLike, dt: float, scan: Scan | Mapping[Hashable, ArrayLike]) -> None:
        """Predict, then use the whole scan.

        Parameters
        ----------
        u : array_like (m,)
            Control, in the motion model's units.
        dt : float
            Duration [s], > 0.
        scan : mapping id → z (k,), or Scan
            What was sighted at the end of dt; may be empty.

        Raises
        ------
        InputError
            As `predict` and `observe`, or an id twice in the scan. The belief stays as it was: a step that is
            refused has not predicted either.
        """
        control, duration = self._control(u), _duration(dt)
        ids, z = sightings(scan, self.dim_z, self._sensor)
        prior = None
        if self.snapshots:
            twin = copy.deepcopy(self)
            twin.predict(control, duration)
            prior = twin.x, twin.P
        self._apply_step(control, duration, ids, z)
        if prior is not None:
            self._prior, self._posterior = prior, (self.x, self.P)

    @locked
    def run(self, log: Log, progress: Progress = False) -> History:
        """Run over a whole log.

        Parameters
        ----------
        log : Log
        progress : bool or callable
            True shows a progress bar; a callable is given (steps done, steps in all) now and then.

        Returns
        -------
        History

        Raises
        ------
        InputError
            The log does not fit the models, or holds a measurement that cannot be; the message says at which time.
            The belief is then as it was after the last good step; ``error.history`` holds what was recorded up to
            there, as it does for a KeyboardInterrupt.
        """
        return running.run(self, log, progress)

    @locked
    def remove(self, landmark_id: Hashable) -> None:
        """Take a landmark out of the map; the rest of the belief stays as it is.

        Raises
        ------
        InputError
            There is no such landmark.
        """
        self._belief.remove(hashable(landmark_id))

    def predict_update(self, *args: Any, **kwargs: Any) -> None:
        """Refused: filterpy's form linearises the measurement at the state before the prediction."""
        raise UnsupportedError(
            "predict_update would linearise at the state before the prediction; call predict(u, dt) and then "
            "update(z, HJacobian, Hx), or step(u, dt, scan)"
        )

    # -- what it believes ---------------------------------------------------------------------------------------------

    @property
    def pose(self) -> Array:
        """Pose (3,): x [m], y [m], θ [rad] in [-π, π); a copy."""
        return self._report()[0]

    @property
    def pose_covariance(self) -> Array:
        """Covariance (3, 3) of the pose; a copy."""
        return self._report()[1]

    @locked
    def _report(self) -> tuple[Array, Array]:
        pose, P = np.empty(3), np.empty((3, 3))
        self._policy.report(self._belief.state, pose, P)
        return pose, P

    @property
    def landmark_ids(self) -> tuple[Hashable, ...]:
        """Ids of the map's landmarks in the order of x."""
        return self._belief.ids

    @property
    @locked
    def landmarks(self) -> dict[Hashable, Array]:
        """The map: id → position (2,) [m]; copies."""
        mean = self._belief.mean
        return {i: mean[s : s + 2].copy() for i, s in self._belief.slots.items()}

    @locked
    def marginal(self, ids: Sequence[Hashable], pose: bool = False) -> tuple[Array, Array]:
        """Joint Gaussian of some landmarks, without materialising P.

        Parameters
        ----------
        ids : sequence of hashable
        pose : bool
            True puts the pose in front.

        Returns
        -------
        mean : ndarray (d,)
        covariance : ndarray (d, d)
            d = 2·len(ids), plus 3 with the pose.

        Raises
        ------
        InputError
            `ids` is no sequence, or there is no such landmark.
        """
        self._to_standard_coordinates()
        return self._belief.marginal(ids, base=pose)

    @locked
    def flush(self) -> None:
        """Bring the covariance of landmarks that are out of view up to date, in place; reading `P` does it too.

        Optional: call it when the robot is idle. On a small map there is nothing to do.
        """
        self._belief.flush()

    @property
    def active_dim(self) -> int:
        """Dimension of the part of the state that an update touches: D, or less where part of a large map rests."""
        return self._belief.active

    # -- copies and files ---------------------------------------------------------------------------------------------

    @locked
    def save(self, path: str | Path) -> None:
        """Write the filter to an npz file without pickle; a loaded one continues exactly.

        Parameters
        ----------
        path : str or Path
            Replaced only by a complete file.

        Raises
        ------
        InputError
            A landmark id is none of int, str, float, bool, None or a tuple of these.
        """
        saving.save(self, path)

    @classmethod
    def load(cls, path: str | Path, motion: MotionModel | None = None, sensor: SensorModel | None = None) -> Self:
        """Read a filter that `save` wrote.

        Parameters
        ----------
        path : str or Path
        motion, sensor : models, optional
            Needed where the filter was made with models that are not registered: a file holds no code.

        Raises
        ------
        LogFileError
            The file cannot be read, is damaged, or holds another filter.
        InputError
            A model of your own is missing.
        """
        return saving.load(cls, path, motion, sensor)

    def _resume(self, facts: dict[str, Any]) -> None:
        """Continue from what `_facts` wrote, after everything else is in place."""

    def _facts(self) -> dict[str, Any]:
        """What an estimator adds to the file."""
        return {}

    @classmethod
    def _options(cls, facts: dict[str, Any]) -> dict[str, Any]:
        """The constructor's arguments that an estimator added."""
        return {}

    def __getstate__(self) -> dict[str, Any]:
        with self._lock:
            self._belief._pack()
        return {n: v for n, v in vars(self).items() if n not in ("_models", "_policy", "_lock")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._lock = threading.RLock()
        self._models = adapt(self._motion, self._sensor, np.array(self._sensor.R, dtype=float))
        self._policy = self._new_policy()

    def __repr__(self) -> str:
        x, y, theta = self.pose
        return (
            f"{type(self).__name__}(pose=({x:.3f} m, {y:.3f} m, {np.degrees(theta):.2f}°), "
            f"landmarks={len(self._belief.slots)}, motion={self._motion!r}, sensor={self._sensor!r})"
        )

    def _repr_html_(self) -> str:
        sd = np.sqrt(np.diag(self.pose_covariance))
        x, y, theta = self.pose
        rows = {
            "estimator": self.name,
            "x": f"{x:.3f} ± {sd[0]:.3f} m",
            "y": f"{y:.3f} ± {sd[1]:.3f} m",
            "heading": f"{np.degrees(theta):.2f} ± {np.degrees(sd[2]):.2f}°",
            "landmarks": str(len(self._belief.slots)),
            "motion": type(self._motion).__name__,
            "sensor": type(self._sensor).__name__,
        }
        return "<table>" + "".join(f"<tr><th>{n}</th><td>{v}</td></tr>" for n, v in rows.items()) + "</table>"


def _noise(sensor: SensorModel) -> Array:
    """R (k, k) of a sensor model, after a check of the whole model."""
    require_model(sensor, SensorModel, "sensor")
    return covariance("the sensor's R", sensor.R, definite=True)


def _known_order(order: str) -> str:
    if order not in ("sequential", "batch"):
        raise InputError(f"order is {order!r}, expected 'sequential' or 'batch'")
    return order


def _largest_nis(gate: float | None) -> float | None:
    if gate is None or (isinstance(gate, float) and gate == np.inf):
        return gate
    try:
        return finite_number("gate", gate, above=0.0)
    except InputError:
        raise InputError(f"gate is {gate!r}, expected None or the largest NIS to accept, > 0") from None


def _duration(dt: float) -> float:
    if type(dt) is float and 0.0 < dt < np.inf:  # what every step of a loop gives; the check costs microseconds
        return dt
    return finite_number("dt", dt, above=0.0, unit="seconds")
