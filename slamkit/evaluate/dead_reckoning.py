"""Dead reckoning: the path that the motion model alone gives."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from slamkit import se2
from slamkit.arrays import Array, finite_array
from slamkit.errors import ModelError
from slamkit.logs import Log
from slamkit.protocols import MotionModel

__all__ = ["dead_reckoning"]


def dead_reckoning(log: Log, motion: MotionModel, pose: ArrayLike = (0.0, 0.0, 0.0)) -> tuple[Array, Array]:
    """Integrate the controls of a log with the motion model, without any sighting.

    xₖ = f(xₖ₋₁, uₖ, dtₖ) for each step of the log's schedule that has a duration; the heading is wrapped to [-π, π).

    Parameters
    ----------
    log : Log
    motion : MotionModel
    pose : array_like (3,)
        Start of the path [m, m, rad].

    Returns
    -------
    times : ndarray (K,)
        Time at the end of each step of ``log.schedule`` [s], as in a History.
    poses : ndarray (K, 3)
        Pose at that time [m, m, rad].

    Raises
    ------
    InputError
        `pose` has a wrong shape or is not finite.
    ModelError
        The model gave a pose that is not finite.
    """
    x = finite_array("pose", pose, (3,))
    x[2] = se2.wrap(x[2])
    schedule = log.schedule
    poses = np.empty((len(schedule.times), 3))
    for k, (dt, row) in enumerate(zip(schedule.dt.tolist(), schedule.control.tolist(), strict=True)):
        if dt > 0:
            x = np.array(motion.move(x, log.controls[row], dt))
            x[2] = se2.wrap(x[2])
        poses[k] = x
    if not np.all(np.isfinite(poses)):
        step = int(np.argmin(np.isfinite(poses).all(1)))
        raise ModelError(f"{motion!r} gave a pose that is not finite at {schedule.times[step]} s (step {step})")
    return schedule.times.copy(), poses
