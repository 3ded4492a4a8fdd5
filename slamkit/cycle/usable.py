"""Which sightings a sensor can use, asked before anything changes."""

from __future__ import annotations

from typing import Any

from slamkit.belief.dense import is_finite
from slamkit.compiled import compiled

#: A variance is close to a double's limits where it exceeds the smallest noise by this factor.
CLOSE = 1e10


@compiled("index(models, state, integers, matrix)", generic=True)
def first_unusable(models: Any, state: Any, slots: Any, z: Any) -> int:
    """The first sighting that the sensor cannot use from ``scratch.pose``, or -1; asked before anything changes."""
    for i in range(slots.shape[0]):
        landmark = state.scratch.at[:2]
        if slots[i] >= 0:
            landmark[0], landmark[1] = state.belief.mean[slots[i]], state.belief.mean[slots[i] + 1]
        else:
            models.invert(state.scratch.pose, z[i], models.sensor_params, landmark)
        models.predict(state.scratch.pose, landmark, models.sensor_params, state.scratch.z_hat)
        models.residual(z[i], state.scratch.z_hat, models.sensor_params, state.scratch.effective[: z.shape[1]])
        if not is_finite(state.scratch.effective[: z.shape[1]]):
            return i
    return -1


@compiled("flag(models, state, integers)")
def needs_care(models: Any, state: Any, slots: Any) -> bool:
    """Whether an update of this scan may fail halfway: the variances are so large beside the noise, or negative."""
    cov, R = state.belief.cov, models.R
    smallest = R[0, 0]
    for i in range(1, R.shape[0]):
        smallest = min(smallest, R[i, i])
    bound = CLOSE * smallest
    for i in range(3):
        if not 0.0 <= cov[i, i] <= bound:
            return True
    for slot in slots:
        if slot >= 0 and not (0.0 <= cov[slot, slot] <= bound and 0.0 <= cov[slot + 1, slot + 1] <= bound):
            return True
    return False
