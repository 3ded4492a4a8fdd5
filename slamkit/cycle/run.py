"""Many steps in one call, recorded."""

from __future__ import annotations

from typing import Any

import numpy as np

from slamkit.compiled import compiled
from slamkit.cycle.status import DUE, OK


@compiled(
    "index(policy, models, state, matrix, vector, integers, integers, integers, integers, matrix, "
    "index, index, matrix, cube, matrix, vector, flags)",
    generic=True,
)
def run(
    policy: Any, models: Any, state: Any, controls: Any, dt: Any, control: Any, first: Any, which: Any, slot_of: Any,
    z: Any, begin_at: int, end_at: int, poses: Any, covariances: Any, innovations: Any, nis: Any, accepted: Any,
) -> int:  # fmt: skip
    """Steps begin_at … end_at-1 of a schedule, recorded, until one is not OK; gives the number of steps done,
    which ``state.scratch.steps_done`` counts as well.

    The last status stays in ``state.scratch.status``: OK at the end, DUE after a step that is done, else that of the
    step that was refused. ``which[j]`` is the log's landmark in observation j, ``slot_of`` maps it to its slot (-1: not
    in the map yet).
    """
    slots = np.empty(state.scratch.nis.shape[0], np.int64)
    for i in range(begin_at, end_at):
        lo, n = first[i], first[i + 1] - first[i]
        for j in range(n):
            slots[j] = slot_of[which[lo + j]]
        state.scratch.step_row, state.scratch.first_row = i, lo
        status = policy.step(policy, models, state, controls[max(control[i], 0)], dt[i], slots[:n], z[lo : lo + n])
        state.scratch.status = status
        for j in range(n):
            slot_of[which[lo + j]] = slots[j]
        if status != OK and status != DUE:
            return i
        policy.report(state, poses[i], covariances[i])
        for j in range(n):
            for r in range(innovations.shape[1]):
                innovations[lo + j, r] = state.scratch.innovations[j, r]
            nis[lo + j] = state.scratch.nis[j]
            accepted[lo + j] = state.scratch.accepted[j]
        state.scratch.steps_done = i + 1
        if status == DUE:
            return i + 1
    return end_at
