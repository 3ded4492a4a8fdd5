"""A motion and a sensor model as compiled code sees them."""

from __future__ import annotations

from typing import Any

from slamkit.compiled.decorator import compiled
from slamkit.compiled.tables import Shared, Table

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
