"""Take a scan: update by the landmarks that are known, initialise the others."""

from __future__ import annotations

from math import nan
from typing import Any

from slamkit.compiled import compiled
from slamkit.cycle.initialise import initialise
from slamkit.cycle.status import OK


@compiled("index(policy, models, state, integers, matrix, flag)", generic=True)
def process_scan(policy: Any, models: Any, state: Any, slots: Any, z: Any, moved: bool) -> Any:
    """Update by the landmarks that are known, initialise the others and write their slots.

    One after the other, each linearised anew, or (``policy.batch``) all known ones in one stacked update first.
    """
    n, k = z.shape
    policy.prepare_scan(models, state, slots, moved)
    for i in range(n):
        if slots[i] < 0:
            state.scratch.nis[i], state.scratch.accepted[i] = nan, True
            for r in range(k):
                state.scratch.innovations[i, r] = nan
    if policy.batch:
        known = 0
        for i in range(n):
            if slots[i] >= 0:
                state.scratch.slots[known], state.scratch.order[known] = slots[i], i
                for r in range(k):
                    state.last.z[known * k + r] = z[i, r]
                known += 1
        if known > 0:
            status = policy.update(policy, models, state, known)
            if status != OK:
                return status
        for i in range(n):
            if slots[i] < 0:
                slots[i] = initialise(policy, models, state, i, z[i])
        return OK
    for i in range(n):
        if slots[i] >= 0:
            state.scratch.slots[0], state.scratch.order[0] = slots[i], i
            for r in range(k):
                state.last.z[r] = z[i, r]
            status = policy.update(policy, models, state, 1)
            if status != OK:
                return status
        else:
            slots[i] = initialise(policy, models, state, i, z[i])
    return OK
