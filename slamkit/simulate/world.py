"""A world: everything about a simulated run except its noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from html import escape
from math import degrees, inf, pi
from typing import Any

import numpy as np

from slamkit.arrays import Array, finite_array
from slamkit.errors import InputError
from slamkit.protocols import MotionModel, SensorModel

__all__ = ["World", "square_root"]


@dataclass(frozen=True, eq=False, repr=False)
class World:
    """Everything about a simulated run except its noise.

    The models describe reality. A filter has models of its own, whose noise may differ.

    Parameters
    ----------
    name : str
        The name in tables and figures.
    landmarks : mapping id → array_like (2,)
        True positions [m]; may be empty.
    motion : MotionModel
        How the robot moves, with the true noise.
    sensor : SensorModel
        What the robot measures, with the true noise.
    controls : array_like (T, m)
        One control for each step, T ≥ 1.
    dt : float
        Duration of a step [s], > 0.
    pose : array_like (3,)
        Where a filter starts [m, m, rad].
    pose_covariance : array_like (3, 3), optional
        The true initial pose is drawn around `pose` with this covariance [m², m·rad, rad²]. Zeros by default: the
        robot starts at `pose`.
    max_range, min_range : float
        A landmark is sighted when its distance [m] is in [min_range, max_range].
    field_of_view : float
        Full angle [rad], centred on the robot's x axis, in which landmarks are sighted, in (0, 2π].
    detection_probability : float
        Probability that a landmark in view gives a sighting, in [0, 1].
    odometry : bool
        False: `controls` are commands. The log holds u, and the robot drives u + w.
        True: the robot drives `controls` exactly, and the log holds what its odometry measures, u - w.
        In both cases pose' = move(pose, logged control + w, dt) with w ~ N(0, control_noise(u, dt)). The estimation
        problem is the same, but a path of commands drifts with its noise and a path of odometry does not.
    increments : bool
        True: a control is the whole motion of a step (odometry increments). False: it is a rate. See
        :class:`slamkit.logs.Log`.

    Raises
    ------
    InputError
        An array has the wrong shape, a value is not finite or outside its interval, `pose_covariance` is not a
        covariance, or a model is a class instead of an instance.
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
        for name, model in (("motion", self.motion), ("sensor", self.sensor)):
            if isinstance(model, type):
                raise InputError(f"{name} is the class {model.__name__}, expected an instance: {model.__name__}(…)")
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
            square_root(self.pose_covariance)
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

    def __repr__(self) -> str:
        size = f"{len(self.landmarks)} landmarks, {len(self.controls)} steps of {self.dt:g} s"
        return f"World({self.name!r}: {size}, {type(self.motion).__name__}, {type(self.sensor).__name__})"

    def _repr_html_(self) -> str:
        """A table of the world's properties, for a notebook."""
        rows = {
            "landmarks": len(self.landmarks),
            "steps": f"{len(self.controls)} of {self.dt:g} s",
            "motion": self.motion,
            "sensor": self.sensor,
            "range [m]": f"{self.min_range:g} to {self.max_range:g}",
            "field of view [°]": f"{degrees(self.field_of_view):g}",
            "detection probability": f"{self.detection_probability:g}",
            "the log holds": "odometry" if self.odometry else "commands",
        }
        cells = "".join(
            f"<tr><th>{escape(name)}</th><td>{escape(str(value))}</td></tr>" for name, value in rows.items()
        )
        return f"<table><caption>World {escape(repr(self.name))}</caption>{cells}</table>"


def square_root(covariance: Array) -> Array:
    """The symmetric square root of a covariance.

    Unlike Cholesky's root it exists for a semidefinite matrix, and the root of a diagonal matrix is diagonal.

    Raises
    ------
    ValueError
        The matrix is not finite, not symmetric or not positive semidefinite. The message begins with a verb.
    """
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
