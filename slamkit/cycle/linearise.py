"""Linearise the sightings of an update."""

from __future__ import annotations

from math import inf, isfinite, nan
from typing import Any

from slamkit.compiled import compiled, rows_of


@compiled("void(state, index, index)")
def record_non_finite(state: Any, place: int, k: int) -> None:
    """Record that the sighting at this place of the scan gave no finite numbers. It counts as rejected."""
    state.scratch.non_finite_sightings += 1
    state.scratch.accepted[place], state.scratch.nis[place] = False, inf
    for r in range(k):
        state.scratch.innovations[place, r] = nan


@compiled("flag(policy, models, state, index)", generic=True)
def linearise_one(policy: Any, models: Any, state: Any, j: int) -> bool:
    """Linearise sighting j of ``scratch.slots`` at ``scratch.at``. Without finite numbers it is rejected: False."""
    k = models.R.shape[0]
    at, y, H_pose, H_landmark, first = (
        state.scratch.at,
        state.last.y,
        state.scratch.H_pose,
        state.scratch.H_landmark,
        j * k,
    )
    landmark, z = rows_of(at, 3 + 2 * j, 2), rows_of(state.last.z, first, k)
    policy.sensor(models, state, rows_of(at, 0, 3), landmark, state.scratch.slots[j], z, first)
    total = 0.0
    for r in range(first, first + k):
        # A sum is finite only if all of it is, or if it is so large that no filter can use it.
        total += (y[r] + H_pose[r, 0]) + (H_pose[r, 1] + H_pose[r, 2]) + (H_landmark[r, 0] + H_landmark[r, 1])
    if isfinite(total):
        return True
    record_non_finite(state, state.scratch.order[j], k)
    return False


@compiled("index(policy, models, state, index)", generic=True)
def linearise(policy: Any, models: Any, state: Any, n: int) -> int:
    """Linearise the n sightings in ``scratch.slots`` at ``scratch.at``. Gives how many of them gave finite numbers.

    The others are rejected, such as a landmark that an earlier sighting of the scan moved onto the robot.
    """
    k = models.R.shape[0]
    slots, order, z, at = state.scratch.slots, state.scratch.order, state.last.z, state.scratch.at
    kept = 0
    for j in range(n):
        if kept < j:
            slots[kept], order[kept] = slots[j], order[j]
            at[3 + 2 * kept], at[4 + 2 * kept] = at[3 + 2 * j], at[4 + 2 * j]
            for r in range(k):
                z[kept * k + r] = z[j * k + r]
        if linearise_one(policy, models, state, kept):
            kept += 1
    return kept


@compiled("void(state, index)")
def linearise_at_mean(state: Any, n: int) -> None:
    """Linearise at the mean."""
    at, mean, slots = state.scratch.at, state.belief.mean, state.scratch.slots
    at[0], at[1], at[2] = mean[0], mean[1], mean[2]
    for j in range(n):
        at[3 + 2 * j], at[4 + 2 * j] = mean[slots[j]], mean[slots[j] + 1]


@compiled("void(state, index, index)")
def shift_innovation(state: Any, n: int, k: int) -> None:
    """effective ← y - H (mean - at): the innovation of the linear model that touches h at ``state.scratch.at``."""
    for r in range(n * k):
        slot, at = state.scratch.slots[r // k], 3 + 2 * (r // k)
        s = state.last.y[r]
        for c in range(3):
            s -= state.scratch.H_pose[r, c] * (state.belief.mean[c] - state.scratch.at[c])
        for c in range(2):
            s -= state.scratch.H_landmark[r, c] * (state.belief.mean[slot + c] - state.scratch.at[at + c])
        state.scratch.effective[r] = s


@compiled("real(state, index)")
def move_iterate(state: Any, n: int) -> float:
    """Move ``state.scratch.at`` to mean + dx; gives the largest change."""
    change = 0.0
    for c in range(3):
        new = state.belief.mean[c] + state.scratch.dx[c]
        change = max(change, abs(new - state.scratch.at[c]))
        state.scratch.at[c] = new
    for j in range(n):
        slot = state.scratch.slots[j]
        for c in range(2):
            new = state.belief.mean[slot + c] + state.scratch.dx[slot + c]
            change = max(change, abs(new - state.scratch.at[3 + 2 * j + c]))
            state.scratch.at[3 + 2 * j + c] = new
    return change
