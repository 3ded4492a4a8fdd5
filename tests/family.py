"""Every filter, motion model and sensor model that the laws are tried on. A registered one is among them."""

from __future__ import annotations

from typing import Any

import numpy as np

from slamkit import Log, Truth, models
from slamkit.filters import FILTERS as ALL
from slamkit.models import Unicycle, parameters_of
from slamkit.registry import Registry

__all__ = [
    "ALL",
    "FILTERS",
    "MOTIONS",
    "ORDERS",
    "P0",
    "ROUNDING",
    "SENSORS",
    "PlainMotion",
    "PlainSensor",
    "control_for",
    "drive",
    "extra_sensor",
]
#: The ideal filter knows the truth of its log only: it takes part in the laws that run over a log.
FILTERS: dict[str, Any] = {name: kind for name, kind in ALL.items() if name != "ideal"}
ORDERS = ("sequential", "batch")
#: Arguments of the models that are not tried with their typical noise.
_ARGUMENTS: dict[str, tuple[float, ...]] = {
    "unicycle": (0.1, 0.05),
    "euler": (0.1, 0.05),
    "odometry": (0.02, 0.01, 0.02, 0.01),
    "ackermann": (0.1, 0.02, 1.5, 0.4, 0.8, 0.2),
    "range-bearing": (0.1, 0.03),
    "relative": (0.15,),
}


def _made(registry: Registry[Any]) -> dict[str, Any]:
    """An instance of every registered model."""
    typical = {name: [value for _, value in parameters_of(kind).values()] for name, kind in registry.items()}
    return {name: kind(*_ARGUMENTS.get(name, typical[name])) for name, kind in registry.items()}


MOTIONS: dict[str, Any] = {
    **_made(models.MOTIONS),
    "unicycle-pose-noise": Unicycle(0.1, 0.05, pose_noise=np.diag([1e-3, 2e-3, 1e-4])),
}
SENSORS: dict[str, Any] = _made(models.SENSORS)
#: To how many digits two ways of computing the same agree: regressions over close sigma points cancel some.
ROUNDING = {name: 1e-9 if "ukf" in name else 1e-13 for name in ALL}
P0 = np.diag([0.02, 0.03, 0.01])


class PlainMotion:
    """A motion model as a user writes it: the methods of the protocol and nothing else."""

    def __init__(self, model: Any) -> None:
        self.model = model

    def move(self, pose: Any, u: Any, dt: float) -> Any:
        return self.model.move(pose, u, dt)

    def jacobians(self, pose: Any, u: Any, dt: float) -> Any:
        return self.model.jacobians(pose, u, dt)

    def control_noise(self, u: Any, dt: float) -> Any:
        return self.model.control_noise(u, dt)

    def pose_noise(self, pose: Any, u: Any, dt: float) -> Any:
        return self.model.pose_noise(pose, u, dt)


class PlainSensor:
    """A sensor model as a user writes it."""

    def __init__(self, model: Any) -> None:
        self.model = model

    @property
    def R(self) -> Any:  # noqa: N802
        return self.model.R

    def predict(self, pose: Any, landmark: Any) -> Any:
        return self.model.predict(pose, landmark)

    def jacobians(self, pose: Any, landmark: Any) -> Any:
        return self.model.jacobians(pose, landmark)

    def residual(self, z: Any, z_hat: Any) -> Any:
        return self.model.residual(z, z_hat)

    def invert(self, pose: Any, z: Any) -> Any:
        return self.model.invert(pose, z)

    def inverse_jacobians(self, pose: Any, z: Any) -> Any:
        return self.model.inverse_jacobians(pose, z)


def control_for(motion: Any, rng: np.random.Generator) -> Any:
    """A control that the model understands."""
    if motion.control_dim == 3:
        return np.array([0.1, 0.3, -0.05]) * rng.uniform(0.5, 1.5, 3)
    return np.array([1.0, 0.3]) * rng.uniform(0.5, 1.5, 2)


def drive(motion: Any, sensor: Any, steps: int = 40, landmarks: int = 6, seen: int = 4, seed: int = 1) -> Log:
    """A noisy log in which every landmark turns up at some time; the noise is the models' own."""
    rng = np.random.default_rng(seed)
    positions = rng.uniform(-6, 6, (landmarks, 2))
    pose, dt = np.array([0.3, -0.2, 3.0]), 0.4
    u = np.array([control_for(motion, rng) for _ in range(steps)])
    chol = np.linalg.cholesky(np.asarray(sensor.R))
    rows: list[Any] = []
    poses = [pose]
    for k in range(steps):
        pose = motion.move(pose, u[k] + 0.02 * rng.normal(size=u.shape[1]), dt)
        poses.append(pose)
        for i in rng.choice(landmarks, seen, replace=False):
            if np.hypot(*(positions[i] - pose[:2])) > 0.5:
                noise = chol @ rng.normal(size=len(chol))
                rows.append(((k + 1) * dt, int(i), sensor.predict(pose, positions[i]) + noise))
    return Log(
        np.arange(steps) * dt,
        u,
        np.array([r[0] for r in rows]),
        np.array([r[1] for r in rows]),
        np.array([r[2] for r in rows]),
        tuple(f"L{i}" for i in range(landmarks)),
        truth=Truth(np.arange(steps + 1) * dt, poses, {f"L{i}": p for i, p in enumerate(positions)}),
    )


def extra_sensor(f: Any, z: Any, h: Any, jacobian: Any, *, R: Any, residual: Any = np.subtract) -> None:
    """filterpy's update, in the one form that every filter takes."""
    f.update(z, jacobian, h, R=R, residual=residual)
