"""What every landmark filter does, whichever of filterpy's classes it derives from."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import asdict, replace
from math import exp, isfinite, log, pi, sqrt
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solve_triangular

from slamkit.belief import BLOCK, Belief, Storage
from slamkit.compiled import FAILING, ROWS, STATUS, Compiled, MachineCode, Models, Policy, call, models_of, needed
from slamkit.cycle import standard, steps
from slamkit.errors import (
    DivergenceError,
    InputError,
    LogFileError,
    MemoryCapError,
    ModelError,
    SlamkitError,
    UnsupportedError,
)
from slamkit.logs import History, Log, Scan, Schedule, decode_id, encode_id, read_archive, reading, write_archive
from slamkit.models import model_from_dict, model_to_dict
from slamkit.protocols import MotionFunctions, MotionModel, SensorFunctions, SensorModel
from slamkit.se2 import wrap

Array = NDArray[np.float64]
Progress = bool | Callable[[int, int], None]


class PolicyFunctions(NamedTuple):
    """The functions in which estimators differ; `slamkit.cycle.steps` says what each one does."""

    motion: Compiled = standard.motion
    sensor: Compiled = standard.sensor
    start: Compiled = standard.start
    scan: Compiled = standard.scan
    correct: Compiled = steps.correct
    retract: Compiled = standard.retract
    report: Compiled = standard.report


class LandmarkFilter:
    """A filter over a pose and a growing map, composed from a motion and a sensor model.

    Concrete estimators derive from this class and from one of filterpy's. See :class:`slamkit.EKFSLAM` for the
    parameters and the attributes.
    """

    name: ClassVar[str]  #: the estimator's name on the command line and in figures
    functions: ClassVar[PolicyFunctions] = PolicyFunctions()
    iterations: ClassVar[int] = 1
    base: ClassVar[int] = 3  #: entries of the belief before its first landmark, the pose in front
    feet: ClassVar[str] = "mean"  #: array of the state at which the Jacobians take their lever arms
    compresses: bool = True  #: whether an update leaves alone what is not in sight, so that it may rest

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
        _require(motion, MotionModel, "motion")
        _require(sensor, SensorModel, "sensor")
        R = _covariance("the sensor's R", sensor.R, None, definite=True)
        x = _array("pose", pose, (3,))
        P = np.zeros((3, 3)) if pose_covariance is None else _covariance("pose_covariance", pose_covariance, 3)
        if order not in ("sequential", "batch"):
            raise InputError(f"order is {order!r}, expected 'sequential' or 'batch'")
        if not isinstance(storage, Storage | None):
            raise InputError(f"storage is {storage!r}, expected None or a slamkit.Storage")
        self.motion, self.sensor, self.order, self._gate = motion, sensor, order, _largest_nis(gate)
        self.snapshots, self.storage = snapshots, Storage() if storage is None else storage
        self.dim_z, self.B = len(R), 0
        self.dim_u = int(getattr(motion, "control_dim", 0))
        x[2] = wrap(x[2])
        rest = (0, self.base - 3)
        # With snapshots P is copied at every step anyhow.
        compresses = self.compresses and not snapshots
        storage = self.storage if compresses else replace(self.storage, compress_above=sys.maxsize // 4)
        self._belief = Belief(np.pad(x, rest), np.pad(P, rest), self.dim_z, max(self.dim_u, 1), storage)
        self._models = _adapt(motion, sensor, R)
        self._policy = self._new_policy()

    def _new_policy(self) -> Policy:
        gate = np.inf if self.gate is None else float(self.gate)
        return Policy(
            **self.functions._asdict(),
            step=steps.step,
            gate=gate,
            iterations=self.iterations,
            batch=self.order == "batch",
        )

    @property
    def gate(self) -> float | None:
        """Largest NIS of a sighting that is accepted, None for all; assign to change it."""
        return self._gate

    @gate.setter
    def gate(self, value: float | None) -> None:
        self._gate = _largest_nis(value)
        self._policy = self._new_policy()

    # -- the cycle ----------------------------------------------------------------------------------------------------

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
        self._advance(self._control(u), _duration(dt), (), np.empty((0, self.dim_z)))
        if self.snapshots:
            self._prior = self.x, self.P

    def observe(self, landmark_id: Hashable, z: ArrayLike) -> None:
        """Take one sighting: a new landmark extends the map, a known one corrects the belief.

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
        self.observe_scan(Scan((landmark_id,), _array("z", z, (self.dim_z,))[None]))

    def observe_scan(self, scan: Scan | Mapping[Hashable, ArrayLike]) -> None:
        """Take all sightings of one instant, in their order, or stacked where ``order="batch"``."""
        ids, z = self._sightings(scan)
        self._advance(_NO_CONTROL, 0.0, ids, z)
        if self.snapshots:
            self._posterior = self.x, self.P

    def step(self, u: ArrayLike, dt: float, scan: Scan | Mapping[Hashable, ArrayLike]) -> None:
        """Predict, then take the whole scan.

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
        if self.snapshots:
            before, attributes = self._belief.snapshot(), dict(vars(self))
            self.predict(u, dt)
            try:
                self.observe_scan(scan)
            except Exception:
                self._belief.restore(before)
                vars(self).update(attributes)
                raise
            return
        control, duration = self._control(u), _duration(dt)
        ids, z = self._sightings(scan)
        self._advance(control, duration, ids, z)

    def run(self, log: Log, progress: Progress = False) -> History:
        """Run over a whole log, in one compiled call a stretch where both models are compiled.

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
            The belief is then as it was after the last good step; ``error.history`` holds what was recorded, as it
            does for a KeyboardInterrupt.
        """
        if not isinstance(log, Log):
            raise InputError(f"log is a {type(log).__name__}, expected a slamkit.Log")
        schedule = log.schedule
        K, M = len(schedule.times), len(log.observations)
        if M and log.observations.shape[1] != self.dim_z:
            columns = log.observations.shape[1]
            raise InputError(f"the log's observations have {columns} columns, the sensor's R {self.dim_z}")
        controls = log.controls if np.any(schedule.control >= 0) else _NO_CONTROL[None]
        if np.any(schedule.control >= 0):
            self._control(controls[0])
        z = np.ascontiguousarray(log.observations) if M else np.empty((0, self.dim_z))
        poses, covariances = np.empty((K, 3)), np.empty((K, 3, 3))
        innovations, nis, accepted = np.empty((M, self.dim_z)), np.empty(M), np.empty(M, dtype=np.bool_)
        true_poses, true_landmarks = self._truth_for(log, schedule)
        widest = int(np.diff(schedule.first).max(initial=1))
        slot_of = np.array([self._belief.slots.get(i, -1) for i in log.landmark_ids], dtype=np.int64)
        unseen = int(np.count_nonzero(slot_of < 0))
        self._belief.reserve(0 if self.compresses else unseen, widest, exactly=True)
        self._belief.expect(unseen)
        done, stretch, started = 0, 1, time.perf_counter()
        report = _reporter(progress, K)
        failure: SlamkitError | KeyboardInterrupt | None = None
        try:
            while done < K and failure is None:
                arguments = (
                    controls, schedule.dt, schedule.control, schedule.first, log.observation_ids, slot_of, z,
                    true_poses, true_landmarks, done, min(done + stretch, K),
                    poses, covariances, innovations, nis, accepted,
                )  # fmt: skip
                begun = time.perf_counter()
                done = self._guarded(steps.run, *arguments)
                if self._models.compiled:
                    # A call is to take a while, but an interrupt is to be heard and progress to be seen.
                    stretch = 4 * stretch if time.perf_counter() - begun < LONG_CALL else max(1, stretch // 2)
                self._name(log.landmark_ids, slot_of)
                status = int(self._belief.state.size[STATUS])
                if status == steps.DUE:
                    self._belief.tend()
                elif status == steps.FULL:
                    rows = slice(schedule.first[done], schedule.first[done + 1])
                    self._belief.widen(slot_of[log.observation_ids[rows]])
                elif status != steps.OK:
                    rows = slice(schedule.first[done], schedule.first[done + 1])
                    ids = [log.landmark_ids[i] for i in log.observation_ids[rows]]
                    u = controls[max(int(schedule.control[done]), 0)]
                    failure = self._failure(status, u, ids, z[rows], f" at time {schedule.times[done]} s of the log")
                report(done)
        except (KeyboardInterrupt, MemoryCapError) as error:
            # An interrupt may come between a compiled stretch and the naming of the landmarks which that has started.
            self._name(log.landmark_ids, slot_of)
            failure = error
        finally:
            report(None)
        landmarks, landmark_covariances = self._marginals()
        index = {i: n for n, i in enumerate(self._belief.slots)}
        rows_of = np.array([index.get(i, -1) for i in log.landmark_ids], dtype=np.int64)
        seen_until = int(schedule.first[done])
        history = History(
            filter=self.name,
            times=schedule.times[:done],
            poses=poses[:done],
            pose_covariances=covariances[:done],
            observation_times=np.repeat(schedule.times, np.diff(schedule.first))[:seen_until],
            observation_ids=rows_of[log.observation_ids[:seen_until]] if M else np.empty(0, dtype=np.int64),
            innovations=innovations[:seen_until],
            nis=nis[:seen_until],
            accepted=accepted[:seen_until],
            landmark_ids=self._belief.ids,
            landmarks=landmarks,
            landmark_covariances=landmark_covariances,
            seconds=time.perf_counter() - started,
        )
        if failure is not None:
            failure.history = history  # type: ignore[union-attr]
            raise failure
        return history

    def _name(self, ids: Sequence[Hashable], slot_of: NDArray[np.int64]) -> None:
        """Name the landmarks that compiled code has started, in the order of their slots."""
        belief = self._belief
        if belief.base + BLOCK * len(belief.slots) < belief.dim:
            new = np.flatnonzero(slot_of >= belief.base + BLOCK * len(belief.slots))
            for i in new[np.argsort(slot_of[new])]:
                belief.register(ids[i], int(slot_of[i]))

    def remove(self, landmark_id: Hashable) -> None:
        """Take a landmark out of the map; the rest of the belief stays as it is.

        Raises
        ------
        InputError
            There is no such landmark.
        """
        self._belief.remove(_hashable(landmark_id))

    def update(
        self,
        z: ArrayLike | None,
        HJacobian: Callable[..., ArrayLike],
        Hx: Callable[..., ArrayLike],
        R: ArrayLike | float | None = None,
        args: Any = (),
        hx_args: Any = (),
        residual: Callable[[Any, Any], Any] = np.subtract,
    ) -> None:
        """Filterpy's own update, for an extra sensor on the full state (a compass, a GPS).

        Parameters
        ----------
        z : array_like (r,) or None
            Measurement; None: nothing happens.
        HJacobian : callable
            ``HJacobian(x, *args)``: ∂z/∂x (r, D) at the state x (D,).
        Hx : callable
            ``Hx(x, *hx_args)``: the measurement (r,) that x would give.
        R : array_like (r, r) or float, optional
            Noise covariance; the sensor model's by default.
        args, hx_args : tuple
            Further arguments of the two functions.
        residual : callable
            ``residual(z, z_hat)``, for measurements that do not subtract (angles).

        Raises
        ------
        InputError
            A shape does not fit, or a value is not finite. The belief stays as it was.

        Notes
        -----
        The same numbers as filterpy's dense update, at O(r D²) instead of O(D³).
        """
        if z is None:
            self._belief.state.size[ROWS] = 0
            return
        x = self.x
        measured = np.atleast_1d(np.asarray(z, dtype=float))
        r = len(measured)
        H = np.asarray(HJacobian(x, *(args if isinstance(args, tuple) else (args,))), dtype=float)
        z_hat = Hx(x, *(hx_args if isinstance(hx_args, tuple) else (hx_args,)))
        measured = _array("z", measured, (r,))
        H = _array("HJacobian's result", np.atleast_2d(H), (r, self.dim_x))
        noise = self.R if R is None else np.eye(r) * float(R) if np.ndim(R) == 0 else R  # type: ignore[arg-type]
        noise = _covariance("R", noise, r)
        y = _array("the residual", np.atleast_1d(np.asarray(residual(measured, z_hat), dtype=float)), (r,))
        self._settle()
        self._correct(H, y, noise)
        self._belief.state.z[:r] = measured
        if self.snapshots:
            self._posterior = self.x, self.P

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

    def _report(self) -> tuple[Array, Array]:
        pose, covariance = np.empty(3), np.empty((3, 3))
        self._policy.report(self._belief.state, pose, covariance)
        return pose, covariance

    @property
    def landmark_ids(self) -> tuple[Hashable, ...]:
        """Ids of the map's landmarks in the order of x."""
        return self._belief.ids

    @property
    def landmarks(self) -> dict[Hashable, Array]:
        """The map: id → position (2,) [m]; copies."""
        mean = self._belief.mean
        return {i: mean[s : s + 2].copy() for i, s in self._belief.slots.items()}

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
        """
        self._settle()
        return self._belief.marginal(ids, base=pose)

    def _marginals(self) -> tuple[Array, Array]:
        """Mean (N, 2) and covariance (N, 2, 2) of every landmark by itself, in standard coordinates."""
        self._settle()
        return self._belief.marginals()

    def flush(self) -> None:
        """Bring the covariance of what is not in sight up to date, in place; reading `P` does it too.

        Nothing needs it: it is for a moment when there is time. On a small map there is nothing to do.
        """
        self._belief.flush()

    def _settle(self) -> None:
        """Bring the covariance to standard coordinates at the current mean."""

    def _feet(self) -> Array:
        """Points (D,) at which the Jacobians take their lever arms; the entry of the heading means nothing."""
        return self._belief.points(self.feet)

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

    def _place(self, x: Array) -> None:
        """Take x for the mean; P, in standard coordinates, stays."""
        self._belief.mean = x

    def _place_covariance(self, P: Array) -> None:
        """Take P, in standard coordinates, for the covariance; x stays."""
        self._belief.covariance = P

    def _correct(self, H: Array, y: Array, R: Array) -> None:
        """Update by ``y = H δ + v``, v ~ N(0, R), with a dense H (r, D) in standard coordinates."""
        self._belief.gain(H, y, R)
        self._belief.correct(self._policy.retract)

    # -- as filterpy's users know it ----------------------------------------------------------------------------------

    @property
    def x(self) -> Array:
        """State (D,) = (x, y, θ, landmarks in the order of `landmark_ids`); a read-only copy. Assign to change it."""
        return _frozen(self._mean())

    @x.setter
    def x(self, value: ArrayLike) -> None:
        x = _array("x", value, (self.dim_x,))
        x[2] = wrap(x[2])
        self._settle()
        self._place(x)

    @property
    def P(self) -> Array:  # noqa: N802
        """Covariance (D, D) of x as it is now, read-only. Assign to change it: ``f.P = 10 * f.P``.

        What was read never changes. Who reads it after every step of a large map, and lets go of it before the next but
        one, pays for no copy.
        """
        self._settle()
        return _frozen(self._covariance())

    @P.setter
    def P(self, value: ArrayLike) -> None:  # noqa: N802
        P = _covariance("P", value, self.dim_x)
        self._settle()
        self._place_covariance(P)

    @property
    def dim_x(self) -> int:
        """D = 3 + 2N, grows with the map."""
        return self._belief.dim - self.base + 3

    @property
    def R(self) -> Array:  # noqa: N802
        """The sensor model's noise covariance (k, k)."""
        return _frozen(np.array(self.sensor.R, dtype=float))

    @property
    def F(self) -> Array:  # noqa: N802
        """Transition matrix (D, D) of the last prediction, formed when asked for."""
        F = np.eye(self.dim_x)
        F[:3, :3] = self._belief.state.F
        return _frozen(F)

    @property
    def Q(self) -> Array:  # noqa: N802
        """Process noise (D, D) of the last prediction, formed when asked for."""
        Q = np.zeros((self.dim_x, self.dim_x))
        Q[:3, :3] = self._belief.state.Q
        return _frozen(Q)

    @property
    def _I(self) -> Array:  # noqa: N802
        return np.eye(self.dim_x)

    @property
    def _rows(self) -> int:
        return int(self._belief.state.size[ROWS])

    @property
    def z(self) -> Array:
        """Measurement (r,) of the last update; of the last sighting, or of the whole scan where order is batch."""
        return _frozen(np.array(self._belief.state.z[: self._rows]))

    @property
    def y(self) -> Array:
        """Innovation (r,) of the last update."""
        return _frozen(np.array(self._belief.state.y[: self._rows]))

    @property
    def S(self) -> Array:  # noqa: N802
        """Innovation covariance (r, r) of the last update."""
        return _frozen(np.array(self._belief.state.S[: self._rows, : self._rows]))

    @property
    def SI(self) -> Array:  # noqa: N802
        """Inverse (r, r) of S."""
        return _frozen(np.asarray(np.linalg.inv(self.S), dtype=float))

    @property
    def K(self) -> Array:  # noqa: N802
        """Gain (D, r) of the last update; zero in the rows of landmarks that came after it."""
        s, rows = self._belief.state, self._rows
        w = np.delete(self._belief.gain_rows, slice(3, self.base), axis=1)
        return _frozen(solve_triangular(s.L[:rows, :rows], w, lower=True, trans="T").T.copy())

    @property
    def log_likelihood(self) -> float:
        """Log-likelihood of the last update's innovation."""
        s, rows = self._belief.state, self._rows
        if rows == 0:
            return log(sys.float_info.min)
        half_log_det = float(np.log(np.diag(s.L)[:rows]).sum())
        return -0.5 * rows * log(2 * pi) - half_log_det - 0.5 * float(s.t[:rows] @ s.t[:rows])

    @property
    def likelihood(self) -> float:
        """exp(log_likelihood), at least the smallest positive float."""
        return max(exp(self.log_likelihood), sys.float_info.min)

    @property
    def mahalanobis(self) -> float:
        """√(yᵀS⁻¹y) of the last update."""
        t = self._belief.state.t[: self._rows]
        return sqrt(float(t @ t))

    @property
    def x_prior(self) -> Array:
        """State (D,) after the last prediction; kept only where the filter was made with ``snapshots=True``."""
        return self._snapshot("_prior")[0]

    @property
    def P_prior(self) -> Array:  # noqa: N802
        """Covariance (D, D) after the last prediction; needs ``snapshots=True``, which costs O(D²) a step."""
        return self._snapshot("_prior")[1]

    @property
    def x_post(self) -> Array:
        """State (D,) after the last update; needs ``snapshots=True``."""
        return self._snapshot("_posterior")[0]

    @property
    def P_post(self) -> Array:  # noqa: N802
        """Covariance (D, D) after the last update; needs ``snapshots=True``, which costs O(D²) a step."""
        return self._snapshot("_posterior")[1]

    def _snapshot(self, which: str) -> tuple[Array, Array]:
        if not self.snapshots:
            raise UnsupportedError(
                "priors and posteriors are not kept, their copies cost more than the step; make the filter with "
                "snapshots=True, or read x and P between predict and observe"
            )
        return getattr(self, which, (self.x, self.P))

    def __repr__(self) -> str:
        x, y, theta = self.pose
        return (
            f"{type(self).__name__}(pose=({x:.3f} m, {y:.3f} m, {np.degrees(theta):.2f}°), "
            f"landmarks={len(self._belief.slots)}, motion={self.motion!r}, sensor={self.sensor!r})"
        )

    # -- between the caller and the step ------------------------------------------------------------------------------

    def _control(self, u: ArrayLike) -> Array:
        control = np.ascontiguousarray(u, dtype=float) if isinstance(u, np.ndarray) else _numbers("u", u)
        if control.ndim != 1 or len(control) == 0 or (self.dim_u and len(control) != self.dim_u):
            wanted = f"({self.dim_u},)" if self.dim_u else "(m,)"
            raise InputError(f"u has shape {control.shape}, {type(self.motion).__name__} takes {wanted}")
        if self.dim_u == 0:
            # A plain model need not say how long its controls are: the first one does.
            self.dim_u = len(control)
            self._belief.reserve(0, control_dim=self.dim_u)
        return control

    def _sightings(self, scan: Scan | Mapping[Hashable, ArrayLike]) -> tuple[Sequence[Hashable], Array]:
        values: Any
        ids: Sequence[Hashable]
        if isinstance(scan, Scan):
            ids, values = scan.ids, scan.z
        elif isinstance(scan, Mapping):
            ids, values = tuple(scan), list(scan.values())
        else:
            raise InputError(f"scan is a {type(scan).__name__}, expected a mapping id → z or a slamkit.Scan")
        z = np.ascontiguousarray(values, dtype=float) if isinstance(values, np.ndarray) else _numbers("scan", values)
        if len(ids) == 0 and z.size == 0:
            return (), np.empty((0, self.dim_z))
        if z.shape != (len(ids), self.dim_z):
            raise InputError(
                f"the scan's z has shape {z.shape}, {len(ids)} sightings by {type(self.sensor).__name__} "
                f"need ({len(ids)}, {self.dim_z})"
            )
        return ids, z

    def _advance(self, u: Array, dt: float, ids: Sequence[Hashable], z: Array) -> None:
        belief = self._belief
        try:
            repeated = len(set(ids)) != len(ids)
        except TypeError as error:
            raise InputError(f"a landmark id of the scan is not hashable: {error}") from None
        if repeated:
            twice = next(i for n, i in enumerate(ids) if i in ids[:n])
            raise InputError(f"landmark {twice!r} occurs twice in one scan")
        if len(ids) > len(belief.state.nis):
            belief.reserve(0, len(ids))
        try:
            slots, all_known = np.fromiter(map(belief.slots.__getitem__, ids), np.int64, len(ids)), True
        except KeyError:
            slots, all_known = np.array([belief.slots.get(i, -1) for i in ids], dtype=np.int64), False
        status = self._take_step(u, dt, slots, z)
        if status == steps.FULL:
            belief.widen(slots)
            status = self._take_step(u, dt, slots, z)
        if not all_known and status in (steps.OK, steps.DUE, steps.NOT_DEFINITE):
            for i, slot in zip(ids, slots.tolist(), strict=True):
                if slot >= 0 and i not in belief.slots:
                    belief.register(i, slot)
        if status == steps.DUE:
            belief.tend()
        elif status != steps.OK:
            raise self._failure(status, u, ids, z, "")

    def _take_step(self, u: Array, dt: float, slots: NDArray[np.int64], z: Array) -> int:
        policy, models, state = self._policy, self._models, self._belief.state
        if models.compiled:
            # Numba's own dispatcher: the call around it takes as long as a sighting.
            take = steps.step_at.dispatcher
            return take(policy.address, models.address, state.address, u, dt, slots, z)  # type: ignore[no-any-return]
        return self._guarded(steps.step, u, dt, slots, z)

    def _compiles(self) -> list[MachineCode]:
        """All machine code that the filter runs, compiled and as Python, what takes longest first."""
        if not self._models.compiled:
            return []
        fields = [*self._policy.fields.values(), *self._models.fields.values()]
        own = [steps.step, *(f for f in fields if isinstance(f, Compiled) and f is not steps.step)]
        called = [steps.run, steps.step_at, *(f for f in needed(own) if not f.generic)]
        return [*((f, "entry") for f in own), *((f, "dispatcher") for f in called)]

    def _guarded(self, step: Compiled, *arguments: Any) -> int:
        """Run a step; a model in Python that raises in the middle of it leaves the belief as it was."""
        if self._models.compiled:
            return int(call(step, self._policy, self._models, self._belief.state, *arguments))
        before = self._belief.snapshot()
        try:
            return int(call(step, self._policy, self._models, self._belief.state, *arguments))
        except BaseException:
            self._belief.restore(before)
            raise

    def _failure(self, status: int, u: Array, ids: Sequence[Hashable], z: Array, where: str) -> SlamkitError:
        """Why the last step was refused; asked only then, so a good step pays for no explanation."""
        state = self._belief.state
        bad = [(n, i) for n, i in enumerate(ids) if not np.all(np.isfinite(z[n]))]
        if not np.all(np.isfinite(u)):
            return InputError(f"u is {u}, expected finite numbers{where}")
        if bad:
            return InputError(f"z of landmark {bad[0][1]!r} is {z[bad[0][0]]}, expected finite numbers{where}")
        validate = getattr(self.sensor, "validate", None)
        if validate is not None:
            try:
                validate(z)
            except InputError as error:
                return InputError(f"{error}{where}")
        if status == steps.BAD_MOTION:
            name = type(self.motion).__name__
            return ModelError(f"{name} gave a pose, F or Q that is not finite for u = {u} at pose {self.pose}{where}")
        n = int(state.size[FAILING])
        if status == steps.BAD_SIGHTING:
            i, name = ids[n], type(self.sensor).__name__
            if i in self._belief.slots:
                distance = float(np.hypot(*(self._belief.marginal([i])[0] - state.pose[:2])))
                what = f"landmark {i!r} lies {distance:.3g} m from the robot"
            else:
                what = f"landmark {i!r} was measured at {z[n]}"
            return InputError(f"{what}: too close, or outside of what {name} can predict and invert{where}")
        return DivergenceError(f"S is not positive definite: the covariance has lost its definiteness{where}")

    # -- copies and files ---------------------------------------------------------------------------------------------

    def save(self, path: str | Path) -> None:
        """Write the filter to an npz file without pickle; a loaded one continues bit for bit.

        Parameters
        ----------
        path : str or Path
            Replaced only by a complete file.

        Raises
        ------
        InputError
            A landmark id is none of int, str, float, bool, None or a tuple of these.
        """
        facts = {
            "filter": self.name,
            "order": self.order,
            "gate": self.gate,
            "snapshots": self.snapshots,
            "storage": asdict(self.storage),
            "dim_u": self.dim_u,
            "ids": [encode_id(i) for i in self._belief.ids],
            "motion": model_to_dict(self.motion),
            "sensor": model_to_dict(self.sensor),
            **self._facts(),
        }
        write_archive(path, "filter", facts, self._belief.arrays())

    @classmethod
    def load(cls, path: str | Path, motion: MotionModel | None = None, sensor: SensorModel | None = None) -> Self:
        """Read a filter that `save` wrote.

        Parameters
        ----------
        path : str or Path
        motion, sensor : models, optional
            Needed where the filter was made with models that are not slamkit's own: a file holds no code.

        Raises
        ------
        LogFileError
            The file cannot be read, is damaged, or holds another filter.
        InputError
            A model of your own is missing.
        """
        with reading(path, "filter"):
            facts, arrays = read_archive(path, "filter")
            if facts["filter"] != cls.name:
                raise LogFileError(f"{path} holds the filter {facts['filter']!r}, expected {cls.name!r}")
            models: dict[str, Any] = {}
            for what, given in (("motion", motion), ("sensor", sensor)):
                models[what] = given if given is not None or facts[what] is None else model_from_dict(facts[what])
            missing = [n for n, model in models.items() if model is None]
        if missing:
            raise InputError(f"{path} was written with a {missing[0]} model of its user: give load({missing[0]}=…)")
        with reading(path, "filter"):
            new = cls(
                **models,
                order=facts["order"],
                gate=facts["gate"],
                snapshots=facts["snapshots"],
                storage=Storage(**facts["storage"]),
                **cls._options(facts),
            )
            new.dim_u = facts["dim_u"]
            new._belief.reserve(0, control_dim=max(new.dim_u, 1))
            new._belief.take([decode_id(i) for i in facts["ids"]], arrays)
            new._resume(facts)
        return new

    def _truth_for(self, log: Log, schedule: Schedule) -> tuple[Array, Array]:
        """True poses (K, 3) at the ends of the steps and true landmarks (L, 2), for a filter that is told them."""
        return np.empty((0, 3)), np.empty((0, 2))

    def _resume(self, facts: dict[str, Any]) -> None:
        """Take up what `_facts` wrote, after everything else is in place."""

    def _facts(self) -> dict[str, Any]:
        """What a variant adds to the file."""
        return {}

    @classmethod
    def _options(cls, facts: dict[str, Any]) -> dict[str, Any]:
        """The constructor's arguments that a variant added."""
        return {}

    def __getstate__(self) -> dict[str, Any]:
        return {n: v for n, v in self.__dict__.items() if n not in ("_models", "_policy")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._models = _adapt(self.motion, self.sensor, np.array(self.sensor.R, dtype=float))
        self._policy = self._new_policy()


_NO_CONTROL = np.zeros(1)

LONG_CALL = 0.05  #: [s] a compiled call over many steps that takes less is followed by one over four times as many


def _require(model: object, protocol: type, what: str) -> None:
    missing = [n for n in _METHODS[protocol] if not hasattr(model, n)]
    if missing:
        raise ModelError(
            f"{what} is a {type(model).__name__}, which has no {', '.join(missing)}: see {protocol.__name__}"
        )


_METHODS: dict[Any, tuple[str, ...]] = {
    MotionModel: ("move", "jacobians", "control_noise", "pose_noise"),
    SensorModel: ("R", "predict", "jacobians", "residual", "invert", "inverse_jacobians"),
}


def _adapt(motion: MotionModel, sensor: SensorModel, R: Array) -> Models:
    """Both models as functions that write into their last arguments: compiled ones as they are, others wrapped."""
    motion_functions, sensor_functions = getattr(motion, "functions", None), getattr(sensor, "functions", None)
    both = motion_functions is not None and sensor_functions is not None
    if motion_functions is None:
        motion_functions = MotionFunctions(
            _filling(motion, "move"), _filling(motion, "jacobians"), _filling(motion, "control_noise"),
            _filling(motion, "pose_noise"),
        )  # fmt: skip
    if sensor_functions is None:
        sensor_functions = SensorFunctions(
            _filling(sensor, "predict"), _filling(sensor, "jacobians"), _filling(sensor, "residual"),
            _filling(sensor, "invert"), _filling(sensor, "inverse_jacobians"),
        )  # fmt: skip
    moving, seeing = (
        np.ascontiguousarray(getattr(model, "params", np.empty(0)), dtype=float) for model in (motion, sensor)
    )
    return models_of(motion_functions, sensor_functions, moving, seeing, np.ascontiguousarray(R), compiled=both)


_OUTPUTS = {"jacobians": 2, "inverse_jacobians": 2}


def _filling(model: object, name: str) -> Callable[..., None]:
    """A method of a plain model as a function (…, params, out…) that fills its outputs, shapes checked."""
    method, outputs = getattr(model, name), _OUTPUTS.get(name, 1)

    def fill(*arguments: Any) -> None:
        given, outs = arguments[: -outputs - 1], arguments[-outputs:]
        results = method(*given)
        for out, result in zip(outs, results if outputs > 1 else (results,), strict=True):
            value = np.asarray(result, dtype=float)
            if value.shape != out.shape:
                raise ModelError(f"{type(model).__name__}.{name} gave shape {value.shape}, expected {out.shape}")
            out[...] = value

    return fill


def _frozen(a: Array) -> Array:
    a.flags.writeable = False
    return a


def _numbers(name: str, value: Any) -> Array:
    try:
        return np.array(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} must hold numbers in equal rows: {error}") from None


def _array(name: str, value: Any, shape: tuple[int, ...]) -> Array:
    a = _numbers(name, value)
    if a.shape != shape:
        raise InputError(f"{name} has shape {a.shape}, expected {shape}")
    if not np.all(np.isfinite(a)):
        raise InputError(f"{name} is {a}, expected finite numbers")
    return a


def _covariance(name: str, value: Any, size: int | None, definite: bool = False) -> Array:
    """A symmetric positive semidefinite (or definite) matrix, or an InputError that says what is wrong with it."""
    a = _numbers(name, value)
    n = size if size is not None else (a.shape[0] if a.ndim else 0)
    a = _array(name, a, (n, n))
    scale = float(np.abs(a).max(initial=0.0))
    asymmetry = float(np.abs(a - a.T).max(initial=0.0))
    if asymmetry > 1e-9 * scale:
        raise InputError(f"{name} is not symmetric: it differs from its transpose by {asymmetry:.3g}")
    a = (a + a.T) / 2
    smallest = float(np.linalg.eigvalsh(a)[0]) if n else 0.0
    if smallest < -1e-10 * scale or (definite and smallest <= 0):
        kind = "positive definite" if definite else "positive semidefinite"
        raise InputError(f"{name} is not {kind}: its smallest eigenvalue is {smallest:.3g}")
    return a


def _largest_nis(gate: float | None) -> float | None:
    if gate is not None and not gate > 0:
        raise InputError(f"gate is {gate!r}, expected None or the largest NIS to accept, > 0")
    return gate


def _duration(dt: float) -> float:
    try:
        duration = float(dt)
    except (TypeError, ValueError):
        raise InputError(f"dt is {dt!r}, expected a number of seconds > 0") from None
    if not (isfinite(duration) and duration > 0):
        raise InputError(f"dt is {duration} s, expected a finite time > 0")
    return duration


def _hashable(landmark_id: Hashable) -> Hashable:
    try:
        hash(landmark_id)
    except TypeError as error:
        raise InputError(f"a landmark id must be hashable: {error}") from None
    return landmark_id


def _reporter(progress: Progress, total: int) -> Callable[[int | None], None]:
    """A function that is told how many steps are done, and None at the end."""
    if progress is False:
        return lambda done: None
    if callable(progress):
        tell = progress
        return lambda done: None if done is None else tell(done, total)
    from rich.progress import Progress as Bar

    bar = Bar(transient=True)
    task = bar.add_task("steps", total=total)
    bar.start()
    return lambda done: bar.stop() if done is None else bar.update(task, completed=done)
