"""The functions in which estimators differ, and the models, as compiled code sees them.

What distinguishes an estimator stands in its policy:

``associate(policy, models, state, slots, z)``
    writes the slot of every sighting whose landmark is not given.
``motion(models, state, u, dt)``
    writes the pose to arrive at, F and Q.
``prepare_scan(models, state, slots, moved)``
    is told which landmarks a scan holds (-1: not in the map) before it is taken, and whether a prediction preceded it.
``sensor(models, state, pose, landmark, slot, z, row)``
    linearises one sighting at (pose, landmark): writes its rows of y, H_pose, H_landmark and noise.
``update(policy, models, state, n)``
    makes one update by the n sightings in ``state.scratch.slots`` and ``state.last.z``: a status.
``retract(state)``
    moves the mean by dx, in the estimator's own error coordinates.
``initialise(models, state, slot, place, z)``
    writes a new landmark's mean, G_pose and the noise of its block; `place` is the sighting's place in the scan.
``report(state, pose, covariance)``
    writes the pose and its covariance in standard coordinates.
``step(policy, models, state, u, dt, slots, z)``
    the step itself: by its address, so that it is machine code once and not in each caller.
``gate, iterations, batch``
    largest NIS that is accepted; linearisations of an update; whether a scan is one stacked update.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, NamedTuple

from slamkit.compiled import Compiled, Shared, Table, compiled
from slamkit.cycle import standard
from slamkit.cycle.associate import known_ids
from slamkit.cycle.step import step
from slamkit.cycle.update import update

#: A motion and a sensor model as functions that write into their last arguments, see `slamkit.protocols`.
MODELS = Table(
    "models",
    move="void(vector, vector, real, vector, vector)",
    motion_jacobians="void(vector, vector, real, vector, matrix, matrix)",
    control_noise="void(vector, real, vector, matrix)",
    pose_noise="void(vector, vector, real, vector, matrix)",
    predict_all="void(vector, vector, real, vector, vector, matrix, matrix, matrix, matrix)",
    predicts_all="flag",  # whether `predict_all` is the model's own, else it is never called
    predict="void(vector, vector, vector, vector)",
    sensor_jacobians="void(vector, vector, vector, matrix, matrix)",
    residual="void(vector, vector, vector, vector)",
    invert="void(vector, vector, vector, vector)",
    inverse_jacobians="void(vector, vector, vector, matrix, matrix)",
    linearise="void(vector, vector, vector, vector, vector, vector, matrix, matrix)",
    linearises="flag",  # whether `linearise` is the model's own, else it is never called
    motion_params="vector",
    sensor_params="vector",
    R="matrix",
)
POLICY = Table(
    "policy",
    associate="void(policy, models, state, integers, matrix)",
    motion="void(models, state, vector, real)",
    prepare_scan="void(models, state, integers, flag)",
    sensor="void(models, state, vector, vector, index, vector, index)",
    update="index(policy, models, state, index)",
    retract="void(state)",
    initialise="void(models, state, index, index, vector)",
    report="void(state, vector, matrix)",
    step="index(policy, models, state, vector, real, integers, matrix)",
    gate="real",
    iterations="index",
    batch="flag",
)


class EstimatorFunctions(NamedTuple):
    """The functions in which an estimator differs from the standard EKF; the module's docstring says what each does."""

    motion: Compiled = standard.motion
    sensor: Compiled = standard.sensor
    initialise: Compiled = standard.initialise
    prepare_scan: Compiled = standard.prepare_scan
    update: Compiled = update
    retract: Compiled = standard.retract
    report: Compiled = standard.report
    associate: Compiled = known_ids


class Policy(Shared):
    """What distinguishes one estimator, and the step that all have in common."""

    def __init__(self, functions: EstimatorFunctions, *, gate: float, iterations: int, batch: bool) -> None:
        super().__init__(POLICY, **functions._asdict(), step=step, gate=gate, iterations=iterations, batch=batch)

    @property
    def plain(self) -> SimpleNamespace:
        """The same policy with the Python forms of its functions."""
        forms = {n: v.plain if isinstance(v, Compiled) and v.generic else v for n, v in self.values.items()}
        return SimpleNamespace(**forms)


class Models(Shared):
    """A motion and a sensor model for a step.

    Parameters
    ----------
    compiled : bool
        Whether every function can be compiled; if not, steps run as Python.
    **values
        A value for each field of `MODELS`.
    """

    def __init__(self, *, compiled: bool, **values: Any) -> None:
        super().__init__(MODELS, **values)
        vars(self)["compiled"] = compiled


@compiled("void(vector, vector, vector, vector, vector, vector, matrix, matrix)")
def no_linearise(
    pose: Any, landmark: Any, z: Any, params: Any, z_hat: Any, y: Any, H_pose: Any, H_landmark: Any
) -> None:
    """Stands where a sensor model offers no function for this; it is never called."""


@compiled("void(vector, vector, real, vector, vector, matrix, matrix, matrix, matrix)")
def no_predict_all(pose: Any, u: Any, dt: float, params: Any, out: Any, F: Any, G: Any, sigma: Any, noise: Any) -> None:
    """Stands where a motion model offers no function for this; it is never called."""


def models_of(motion: Any, sensor: Any, motion_params: Any, sensor_params: Any, R: Any, *, compiled: bool) -> Models:
    """The models whose functions are these MotionFunctions and SensorFunctions of `slamkit.protocols`."""
    return Models(
        compiled=compiled,
        move=motion.move,
        motion_jacobians=motion.jacobians,
        control_noise=motion.control_noise,
        pose_noise=motion.pose_noise,
        predict_all=motion.predict_all or no_predict_all,
        predicts_all=motion.predict_all is not None,
        predict=sensor.predict,
        sensor_jacobians=sensor.jacobians,
        residual=sensor.residual,
        invert=sensor.invert,
        inverse_jacobians=sensor.inverse_jacobians,
        linearise=sensor.linearise or no_linearise,
        linearises=sensor.linearise is not None,
        motion_params=motion_params,
        sensor_params=sensor_params,
        R=R,
    )


def call(function: Compiled, policy: Policy, models: Models, *arguments: Any) -> Any:
    """Call a function of the cycle: as machine code where the models allow it, else the same source as Python."""
    if models.compiled:
        return function(policy, models, *arguments)
    return function.plain(policy.plain, models, *arguments)
