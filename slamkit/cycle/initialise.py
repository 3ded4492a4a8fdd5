"""Initialise: start a landmark from its first sighting."""

from __future__ import annotations

from math import isfinite
from typing import Any

from slamkit.belief.dense import augment
from slamkit.compiled import compiled
from slamkit.cycle.linearise import record_non_finite


@compiled("real(state, index)")
def started_variance(state: Any, r: int) -> Any:
    """Variance of coordinate r of the landmark that is about to start: (G_pose P G_poseᵀ + block)_rr."""
    cov, G = state.belief.cov, state.scratch.G_pose
    a, b, c = G[r, 0], G[r, 1], G[r, 2]
    return (
        state.scratch.block[r, r]
        + a * (a * cov[0, 0] + 2.0 * (b * cov[1, 0] + c * cov[2, 0]))
        + b * (b * cov[1, 1] + 2.0 * c * cov[2, 1])
        + c * c * cov[2, 2]
    )


@compiled("index(policy, models, state, index, vector)", generic=True)
def initialise(policy: Any, models: Any, state: Any, place: int, z: Any) -> Any:
    """Start a landmark from its first sighting; gives its slot.

    The sighting is refused, and the slot is -1, if the mean or the covariance is one that no belief can hold.
    """
    slot = state.belief.active
    policy.initialise(models, state, slot, place, z)
    G, block, mean = state.scratch.G_pose, state.scratch.block, state.belief.mean
    total = mean[slot] + mean[slot + 1] + block[0, 0] + block[0, 1] + block[1, 1]
    for i in range(2):
        total += G[i, 0] + G[i, 1] + G[i, 2]
    # Rounding may leave the determinant of a block of rank one just below zero.
    least = -1e-9 * block[0, 0] * block[1, 1]
    if not (
        isfinite(total)
        and isfinite(started_variance(state, 0) + started_variance(state, 1))
        and block[0, 0] >= 0.0
        and block[1, 1] >= 0.0
        and block[0, 0] * block[1, 1] - block[0, 1] * block[1, 0] >= least
    ):
        record_non_finite(state, place, models.R.shape[0])
        # Vectors of four numbers reach beyond what is active.
        mean[slot] = mean[slot + 1] = 0.0
        state.belief.linearised_at[slot] = state.belief.linearised_at[slot + 1] = 0.0
        return -1
    augment(state, slot)
    return slot
