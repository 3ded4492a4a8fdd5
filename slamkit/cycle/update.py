"""Update: correct the belief by sightings of known landmarks."""

from __future__ import annotations

from typing import Any

from slamkit.belief.active import record
from slamkit.belief.dense import cholesky, downdate, forward, project, project_and_gate, whiten
from slamkit.compiled import compiled
from slamkit.cycle.linearise import linearise, linearise_at_mean, linearise_one, move_iterate, shift_innovation
from slamkit.cycle.status import NOT_DEFINITE, OK
from slamkit.cycle.usable import CLOSE

#: Noise below this share of the prior variance that a sighting compares is lost in the rounding of a double.
LOST = 1e-14
#: A variance [m², rad²] no further below zero than this is rounding.
TINY = 1e-12


@compiled("flag(models, state, index)", generic=True)
def noise_is_lost(models: Any, state: Any, j: int) -> bool:
    """Whether the noise of sighting j is beyond a double's digits beside the prior variances that H P Hᵀ sums.

    H P Hᵀ may be small all the same: a start that is unknown by a kilometre cancels, and leaves rounding.
    """
    cov, H, H_landmark, slot = state.belief.cov, state.scratch.H_pose, state.scratch.H_landmark, state.scratch.slots[j]
    k = models.R.shape[0]
    for r in range(j * k, (j + 1) * k):
        prior = H[r, 0] * H[r, 0] * cov[0, 0] + H[r, 1] * H[r, 1] * cov[1, 1] + H[r, 2] * H[r, 2] * cov[2, 2]
        prior += H_landmark[r, 0] * H_landmark[r, 0] * cov[slot, slot]
        prior += H_landmark[r, 1] * H_landmark[r, 1] * cov[slot + 1, slot + 1]
        noise = models.R[r - j * k, r - j * k]
        if not noise >= LOST * prior:
            largest = max(max(cov[0, 0], cov[1, 1]), max(cov[2, 2], max(cov[slot, slot], cov[slot + 1, slot + 1])))
            # Else it is a lever arm that is large: the landmark is close.
            if not largest <= CLOSE * noise:
                return True
    return False


@compiled("index(policy, models, state, index)", generic=True)
def gate_sightings(policy: Any, models: Any, state: Any, n: int) -> int:
    """Record each innovation and NIS, reject those beyond the gate. Gives how many stay, -1 if S is not definite."""
    k = models.R.shape[0]
    kept = 0
    for j in range(n):
        place = state.scratch.order[j]
        if noise_is_lost(models, state, j) or not cholesky(state.last.S, state.last.L, j * k, k):
            return -1
        nis = forward(state.last.L, state.last.y, state.last.t, j * k, k)
        for r in range(k):
            state.scratch.innovations[place, r] = state.last.y[j * k + r]
        state.scratch.nis[place], state.scratch.accepted[place] = nis, nis <= policy.gate
        if nis <= policy.gate:
            state.scratch.slots[kept], state.scratch.order[kept] = state.scratch.slots[j], state.scratch.order[j]
            if kept < j:
                for r in range(k):
                    state.last.z[kept * k + r] = state.last.z[j * k + r]
            kept += 1
    return kept


@compiled("index(policy, state, index, index)", generic=True)
def commit_update(policy: Any, state: Any, n: int, k: int) -> int:
    """Carry out an update that is prepared."""
    state.last.rows, state.last.active, state.last.dim = n * k, state.belief.active, state.belief.dim
    downdate(state, n * k)
    definite = variances_hold(state, n)
    # The mean moves before dx is used otherwise.
    policy.retract(state)
    if state.resting.columns > 0:
        record(state, n, k)
    return OK if definite else NOT_DEFINITE


@compiled("flag(state, index)")
def variances_hold(state: Any, n: int) -> Any:
    """Whether no variance that an update of n sightings has reduced is below zero, but for rounding."""
    cov, slots = state.belief.cov, state.scratch.slots
    definite = cov[0, 0] >= -TINY and cov[1, 1] >= -TINY and cov[2, 2] >= -TINY
    for j in range(n):
        slot = slots[j]
        definite = definite and cov[slot, slot] >= -TINY and cov[slot + 1, slot + 1] >= -TINY
    return definite


@compiled("void(state, index)")
def record_rejected(state: Any, rows: int) -> None:
    """Record an update beyond the gate: y, S and L as they are, and a gain of zero. It changes nothing else."""
    state.last.rows, state.last.active, state.last.dim = rows, state.belief.active, state.belief.dim
    for r in range(rows):
        for i in range(state.belief.active):
            state.last.w[r, i] = 0.0
        for i in range(state.resting.columns):
            state.last.g[r, i] = 0.0


@compiled("index(state, index)")
def record_all_rejected(state: Any, rows: int) -> int:
    """Factor S of an update and record all of its rows as rejected."""
    if not cholesky(state.last.S, state.last.L, 0, rows):
        return NOT_DEFINITE
    forward(state.last.L, state.last.y, state.last.t, 0, rows)
    record_rejected(state, rows)
    return OK


@compiled("index(policy, models, state)", generic=True)
def update_one(policy: Any, models: Any, state: Any) -> Any:
    """The update by one sighting of two rows, which nearly every update is."""
    at, mean, y, slot, place = (
        state.scratch.at,
        state.belief.mean,
        state.last.y,
        state.scratch.slots[0],
        state.scratch.order[0],
    )
    at[0], at[1], at[2], at[3], at[4] = mean[0], mean[1], mean[2], mean[slot], mean[slot + 1]
    if not linearise_one(policy, models, state, 0):
        return record_all_rejected(state, 0)
    nis = project_and_gate(state, policy.gate)
    state.scratch.innovations[place, 0], state.scratch.innovations[place, 1], state.scratch.nis[place] = y[0], y[1], nis
    state.scratch.accepted[place] = nis <= policy.gate
    if nis <= policy.gate:
        return NOT_DEFINITE if nis < 0.0 or noise_is_lost(models, state, 0) else commit_update(policy, state, 1, 2)
    record_rejected(state, 2)
    return OK


@compiled("index(policy, models, state, index)", generic=True)
def update(policy: Any, models: Any, state: Any, n: int) -> Any:
    """One update by the n sightings in ``state.scratch.slots`` and ``state.last.z``, stacked.

    With more than one iteration it is the iterated EKF: linearise at the last iterate until it stands still
    (Bell & Cathey, IEEE TAC 38(2), 1993: Gauss-Newton on the same cost).
    """
    if n == 1 and models.R.shape[0] == 2 and policy.iterations == 1:
        return update_one(policy, models, state)
    k = models.R.shape[0]
    linearise_at_mean(state, n)
    n = linearise(policy, models, state, n)
    project(state, n, k)
    kept = gate_sightings(policy, models, state, n)
    if kept < 0:
        return NOT_DEFINITE
    if kept == 0:
        return record_all_rejected(state, n * k)
    factored = kept == n == 1  # by `gate_sightings`, and t is there as well
    if kept < n:
        n = kept
        linearise_at_mean(state, n)
        linearise(policy, models, state, n)
        project(state, n, k)
    rows = n * k
    for r in range(rows):
        state.scratch.effective[r] = state.last.y[r]
    for iteration in range(policy.iterations):
        if not factored or iteration > 0:
            if not cholesky(state.last.S, state.last.L, 0, rows):
                return NOT_DEFINITE
            forward(state.last.L, state.scratch.effective, state.last.t, 0, rows)
        whiten(state, rows)
        if iteration + 1 == policy.iterations or move_iterate(state, n) < 1e-12:
            break
        linearise(policy, models, state, n)
        shift_innovation(state, n, k)
        project(state, n, k)
    return commit_update(policy, state, n, k)
