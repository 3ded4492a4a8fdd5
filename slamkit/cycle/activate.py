"""Activate: landmarks in sight become active, so that an estimator sees active coordinates alone."""

from __future__ import annotations

from typing import Any

from slamkit.belief.active import activate
from slamkit.compiled import compiled


@compiled("flag(state, integers)")
def activate_scan(state: Any, slots: Any) -> bool:
    """Make the landmarks of a scan active and give their slots there; False, and nothing has changed, without room."""
    local = state.belief.local
    new = resting = 0
    for slot in slots:
        if slot < 0:
            new += 2
        elif local[slot] < 0:
            resting += 2
    if state.belief.active + new + resting > state.belief.mean.shape[0] or state.belief.dim + new > local.shape[0]:
        return False
    if resting > 0 and state.resting.columns + resting > state.resting.theta.shape[0]:
        return False
    for i in range(slots.shape[0]):
        slot = slots[i]
        if slot >= 0:
            slots[i] = local[slot] if local[slot] >= 0 else activate(state, slot)
    return True


@compiled("void(state, integers)")
def to_map_slots(state: Any, slots: Any) -> None:
    """Active slots → slots in the map."""
    for i in range(slots.shape[0]):
        if slots[i] >= 0:
            slots[i] = state.belief.owner[slots[i]]
