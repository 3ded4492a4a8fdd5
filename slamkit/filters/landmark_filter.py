"""What every landmark filter does, whichever of filterpy's classes it derives from."""

from __future__ import annotations

import copy
import sys
import threading
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from slamkit.arrays import Array, Indices, covariance, finite_array, finite_number
from slamkit.belief import Belief, Storage
from slamkit.belief.compressed import undisturbed
from slamkit.compiled import Compiled, MachineCode, OwnFields, needed
from slamkit.cycle import EstimatorFunctions, Policy, Status, call
from slamkit.cycle.run import run as run_steps
from slamkit.cycle.step import step, step_at
from slamkit.errors import AssignmentError, InputError, UnsupportedError
from slamkit.filters import explain, running, saving
from slamkit.filters.assignment import locked
from slamkit.filters.filterpy_attributes import FilterpyAttributes
from slamkit.filters.inputs import NO_CONTROL, control_array, hashable, sightings
from slamkit.filters.model_functions import adapt
from slamkit.filters.running import Progress
from slamkit.logs import History, Log, Scan, Schedule
from slamkit.protocols import MotionModel, SensorModel, require_model
from slamkit.se2 import wrap

DONE = (Status.OK, Status.DUE)


class LandmarkFilter(FilterpyAttributes):
    """A filter over a pose and a growing map, composed from a motion and a sensor model.

    Concrete estimators derive from this class and from one of filterpy's. See :class:`slamkit.EKFSLAM` for the
    parameters and the attributes. An estimator states its `name` and what it does otherwise than the standard EKF.

    Notes
    -----
    Threads take turns with one filter: a call waits until another thread's call has ended.
    """

    name: ClassVar[str]  #: the estimator's name on the command line and in figures
    functions: ClassVar[EstimatorFunctions] = EstimatorFunctions()
    own_fields: ClassVar[OwnFields] = OwnFields()  #: numbers that it keeps beside the belief
    iterations: ClassVar[int] = 1  #: linearisations of an update, at most
    base: ClassVar[int] = 3  #: entries of the belief before its first landmark, the pose in front
    linearisation_points: ClassVar[str] = "mean"  #: field of the belief at which the Jacobians take their lever arms
    longest_stretch: ClassVar[int] = sys.maxsize  #: steps that one compiled call over a log may take
    compresses: bool = True  #: whether an update leaves alone what is not in sight, so that it may rest
    fixed_attributes: ClassVar[tuple[str, ...]] = (
        *("name", "functions", "own_fields", "iterations", "base", "linearisation_points", "compresses"),
        *("longest_stretch", "fixed_attributes", "snapshots", "storage", "dim_z", "dim_u", "B"),
    )

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

    def _new_policy(self) -> Policy:
        gate = np.inf if self._gate is None else self._gate
        return Policy(self.functions, gate=gate, iterations=self.iterations, batch=self._order == "batch")

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
        self._run_step(self._control(u), _duration(dt), (), np.empty((0, self.dim_z)))
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
        self._run_step(NO_CONTROL, 0.0, ids, z)
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
        self._run_step(control, duration, ids, z)
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

    # -- what an estimator may do otherwise ---------------------------------------------------------------------------

    def _marginals(self) -> tuple[Array, Array]:
        """Mean (N, 2) and covariance (N, 2, 2) of every landmark by itself, in standard coordinates."""
        self._to_standard_coordinates()
        return self._belief.marginals()

    def _to_standard_coordinates(self) -> None:
        """Bring the covariance to standard coordinates at the current mean."""

    def _lever_points(self) -> Array:
        """Points (D,) at which the Jacobians take their lever arms; the entry of the heading means nothing."""
        return self._belief.linearisation_points(self.linearisation_points)

    def _regression(self, slot: int) -> tuple[Array, Array] | None:
        """H (k, D) and noise (k, k) of a sighting of the landmark at `slot`; None where H is sparse."""
        return None

    def _change_frame(self, rows: Array, pose: Array) -> None:
        """Take rows (dim, n), one an error of the belief, through the change of frame that ends a corrected step.

        `pose` (3,) is the belief's pose after the step's last correction; the step itself is over.
        """

    def _mean(self) -> Array:
        """Mean (D,) in standard coordinates; a copy."""
        return self._belief.mean

    def _covariance(self) -> Array:
        """Covariance (D, D) in standard coordinates; a copy."""
        return self._belief.covariance

    def _set_mean(self, x: Array) -> None:
        """Let x be the mean; P, in standard coordinates, stays."""
        self._belief.mean = x

    def _set_covariance(self, P: Array) -> None:
        """Let P, in standard coordinates, be the covariance; x stays."""
        self._belief.covariance = P

    def _update_dense(self, H: Array, y: Array, R: Array) -> None:
        """Update by ``y = H δ + v``, v ~ N(0, R), with a dense H (r, D) in standard coordinates."""
        self._belief.gain(H, y, R)
        self._belief.update(self._policy.retract)

    def _before_stretch(self, log: Log, schedule: Schedule, done: int) -> None:
        """Prepare the steps of a log from `done` on, at most `longest_stretch` of them."""

    # -- between the caller and the step ------------------------------------------------------------------------------

    def _control(self, u: ArrayLike) -> Array:
        return control_array(u, self.dim_u, self._motion)

    def _take_control_length(self, length: int) -> None:
        """A plain model need not say how long its controls are: the first one that it takes does."""
        if length != self.dim_u:
            self._belief.reserve(0, control_dim=max(length, 1))
            vars(self)["dim_u"] = length

    def _run_step(self, u: Array, dt: float, ids: Sequence[Hashable], z: Array) -> None:
        """Predict over dt, unless it is 0, and use a scan; or raise, and nothing has changed."""
        if dt > 0 and len(u) != self.dim_u:
            known = self.dim_u
            try:
                self._take_control_length(len(u))
                self._run_step(u, dt, ids, z)
            except BaseException:
                vars(self)["dim_u"] = known
                raise
            return
        belief = self._belief
        if len(ids) > len(belief.state.scratch.nis):
            belief.reserve(0, len(ids))
        try:
            slots, all_known = np.fromiter(map(belief.slots.__getitem__, ids), np.int64, len(ids)), True
        except KeyError:
            slots, all_known = np.array([belief.slots.get(i, -1) for i in ids], dtype=np.int64), False
        status = self._call_step(u, dt, slots, z)
        if status == Status.FULL:
            belief.grow_for(slots)
            status = self._call_step(u, dt, slots, z)
        if status == Status.CAREFUL:
            status = self._undoing(lambda: self._call_step(u, dt, slots, z))
        if status not in DONE:
            raise explain.failure(self, status, u, ids, z)
        if not all_known:
            for i, slot in zip(ids, slots.tolist(), strict=True):
                if slot >= 0 and i not in belief.slots:
                    belief.register(i, slot)
        if status == Status.DUE:
            belief.flush_if_due()

    def _call_step(self, u: Array, dt: float, slots: Indices, z: Array) -> int:
        policy, models, state = self._policy, self._models, self._belief.state
        if models.compiled:
            return step_at.jitted(policy.address, models.address, state.address, u, dt, slots, z)  # type: ignore[no-any-return]
        return self._call(step, u, dt, slots, z)

    def _call(self, function: Compiled, *arguments: Any) -> int:
        """Call a function of the cycle; a model in Python may raise in the middle of it, and that is undone."""
        if self._models.compiled:
            return int(call(function, self._policy, self._models, self._belief.state, *arguments))
        return self._undoing(lambda: int(call(function, self._policy, self._models, self._belief.state, *arguments)))

    def _undoing(self, go: Callable[[], int]) -> int:
        """Take one step, and bring the belief back if that raises or is not done."""
        belief = self._belief
        before, status = belief.snapshot(), -1
        belief.state.scratch.careful = True
        try:
            status = go()
        finally:
            belief.state.scratch.careful = False
            if status not in DONE:
                with undisturbed():
                    belief.restore(before)
        return status

    def _compiles(self) -> list[MachineCode]:
        """All machine code that the filter runs, compiled and as Python, what takes longest first."""
        if not self._models.compiled:
            return []
        fields = [*self._policy.values.values(), *self._models.values.values()]
        own = [step, *(f for f in fields if isinstance(f, Compiled) and f is not step)]
        called = [run_steps, step_at, *(f for f in needed(own) if not f.generic)]
        return [*((f, "in_table") for f in own), *((f, "jitted") for f in called)]

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
    return finite_number("dt", dt, above=0.0, unit="seconds")
