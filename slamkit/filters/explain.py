"""Why a step was refused; asked only then, so that a good step pays for no explanation."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Any

import numpy as np

from slamkit.arrays import Array
from slamkit.cycle import Status
from slamkit.cycle.usable import CLOSE
from slamkit.errors import DivergenceError, InputError, ModelError, SlamkitError


def failure(filter: Any, status: int, u: Array, ids: Sequence[Hashable], z: Array, where: str = "") -> SlamkitError:
    """The error that says why.

    Parameters
    ----------
    filter : LandmarkFilter
        As it is after the step was refused, or undone.
    status : int
        What the step returned.
    u : ndarray (m,)
    ids : sequence of hashable
    z : ndarray (n, k)
    where : str
        Ends the message.
    """
    state = filter._belief.state
    bad = [(n, i) for n, i in enumerate(ids) if not np.all(np.isfinite(z[n]))]
    if not np.all(np.isfinite(u)):
        return InputError(f"u is {u}, expected finite numbers{where}")
    if bad:
        return InputError(f"z of landmark {bad[0][1]!r} is {z[bad[0][0]]}, expected finite numbers{where}")
    validate = getattr(filter.sensor, "validate", None)
    if validate is not None:
        try:
            validate(z)
        except InputError as error:
            return InputError(f"{error}{where}")
    if status == Status.BAD_MOTION:
        name = type(filter.motion).__name__
        return ModelError(f"{name} gave a pose, F or Q that is not finite for u = {u} at pose {filter.pose}{where}")
    if status == Status.BAD_SIGHTING:
        n = state.scratch.failing
        i, name = ids[n], type(filter.sensor).__name__
        if i in filter._belief.slots:
            distance = float(np.hypot(*(filter._belief.marginal([i])[0] - state.scratch.pose[:2])))
            what = f"landmark {i!r} lies {distance:.3g} m from the robot"
        else:
            what = f"landmark {i!r} was measured at {z[n]}"
        return InputError(f"{what}: too close, or outside of what {name} can predict and invert{where}")
    return DivergenceError(f"the update cannot be computed: {_imbalance(filter, ids)}{where}")


def _imbalance(filter: Any, ids: Sequence[Hashable]) -> str:
    belief = filter._belief
    known = [i for i in ids if i in belief.slots]
    prior = float(np.abs(np.diag(belief.marginal(known, base=True)[1])).max())
    noise = float(np.diag(filter.sensor.R).min())
    if prior > CLOSE * noise:
        return (
            f"a prior variance of {prior:.3g} beside a measurement noise of {noise:.3g} is beyond the 16 digits of a "
            "double; start with a smaller pose_covariance, or state a larger noise"
        )
    return "S or P is no longer positive definite"
