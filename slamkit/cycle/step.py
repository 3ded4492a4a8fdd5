"""One step of every estimator: predict, associate, activate, update, initialise.

The same source runs compiled (compiled models) and as Python (a model in plain Python).
`slamkit.cycle.estimator` lists the functions in which estimators differ.
"""

from __future__ import annotations

from typing import Any

from slamkit.belief.rollback import SMALL, save_small, undo_small
from slamkit.compiled import compiled, intrinsics
from slamkit.cycle.activate import activate_scan, to_map_slots
from slamkit.cycle.predict import commit, give_back, prepare
from slamkit.cycle.status import BAD_SIGHTING, CAREFUL, FULL, NOT_DEFINITE, OK
from slamkit.cycle.upkeep import upkeep
from slamkit.cycle.usable import first_unusable, needs_care


@compiled("index(policy, models, state, vector, real, integers, matrix)", generic=True)
def step(policy: Any, models: Any, state: Any, u: Any, dt: float, slots: Any, z: Any) -> Any:
    """Predict over dt (unless it is 0), then take the scan. A refused step has changed nothing.

    The slots are those of the whole map, -1 for a new landmark, whose slot is written.
    """
    status = prepare(policy, models, state, u, dt)
    if status != OK:
        return give_back(state, dt, status)
    policy.associate(policy, models, state, slots, z)
    if not activate_scan(state, slots):
        return give_back(state, dt, FULL)
    small = (
        state.resting.columns == 0
        and state.belief.mean.shape[0] <= SMALL
        and state.last.rows <= 2
        and models.linearises
        and not policy.batch
    )
    if small:
        status = try_small(policy, models, state, slots, z, dt)
        if status != BAD_SIGHTING:
            to_map_slots(state, slots)
            if status == OK:
                return upkeep(state, slots.shape[0])
            return give_back(state, dt, status)
    failing = first_unusable(models, state, slots, z)
    if failing >= 0:
        state.scratch.failing = failing
        to_map_slots(state, slots)
        return give_back(state, dt, BAD_SIGHTING)
    if not state.scratch.careful and needs_care(models, state, slots, dt > 0.0):
        to_map_slots(state, slots)
        return give_back(state, dt, CAREFUL)
    state.scratch.non_finite_sightings = 0
    status = predict_then_update(policy, models, state, slots, z, dt)
    to_map_slots(state, slots)
    return upkeep(state, slots.shape[0]) if status == OK else status


@compiled("index(policy, models, state, integers, matrix, real)", generic=True)
def try_small(policy: Any, models: Any, state: Any, slots: Any, z: Any, dt: float) -> Any:
    """Take a step of a small belief without asking whether it can be taken, and undo it where it could not.

    To save so little costs less than to ask every sighting first.
    """
    D = state.belief.active
    rows, active, dim = state.last.rows, state.last.active, state.last.dim
    save_small(state)
    state.scratch.non_finite_sightings = 0
    status = predict_then_update(policy, models, state, slots, z, dt)
    if status == OK and state.scratch.non_finite_sightings == 0:
        return OK
    for i in range(slots.shape[0]):
        slots[i] = slots[i] if slots[i] < D else -1
    undo_small(state, D)
    state.last.rows, state.last.active, state.last.dim = rows, active, dim
    return BAD_SIGHTING if state.scratch.non_finite_sightings > 0 else NOT_DEFINITE


@compiled("index(policy, models, state, integers, matrix, real)", generic=True)
def predict_then_update(policy: Any, models: Any, state: Any, slots: Any, z: Any, dt: float) -> Any:
    """Carry out a prediction that is prepared, unless dt is 0, and take the scan."""
    if dt > 0.0:
        commit(state)
    return policy.process_scan(policy, models, state, slots, z, dt > 0.0)


as_policy, as_models, as_state = intrinsics("numba_types", "as_policy", "as_models", "as_state")


@compiled("index(index, index, index, vector, real, integers, matrix)")
def step_at(policy: int, models: int, state: int, u: Any, dt: float, slots: Any, z: Any) -> Any:
    """`step` with the addresses of its tables, for a caller in Python to whom every microsecond counts."""
    return as_policy(policy).step(as_policy(policy), as_models(models), as_state(state), u, dt, slots, z)
