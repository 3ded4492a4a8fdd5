"""One step of every estimator: predict, take the scan, report.

The same source runs compiled (compiled models) and as Python (a model in plain Python). What distinguishes an
estimator stands in its policy:

``motion(models, state, u, dt)``
    writes the pose to arrive at, F and Q.
``sensor(models, state, pose, landmark, slot, z, row)``
    linearises one sighting at (pose, landmark): writes its rows of y, H_pose, H_landmark and noise.
``start(models, state, slot, place, z)``
    writes a new landmark's mean, G_pose and the noise of its block; `place` is the sighting's place in the scan.
``scan(models, state, slots, moved)``
    is told which landmarks a scan holds (-1: not in the map) before it is taken, and whether a prediction preceded it.
``correct(policy, models, state, n)``
    makes one update by the n sightings in ``state.scratch.slots`` and ``state.last.z``: a status.
``retract(state)``
    moves the mean by dx, in the estimator's own error coordinates.
``report(state, pose, covariance)``
    writes the pose and its covariance in standard coordinates.
``step(policy, models, state, u, dt, slots, z)``
    the step itself, `step` below: by its address, so that it is machine code once and not in each caller.
``gate, iterations, batch``
    largest NIS that is accepted; linearisations of an update; whether a scan is one stacked update.
"""

from __future__ import annotations

from math import inf, isfinite, nan
from typing import Any

import numpy as np

from slamkit.belief.kernels import (
    SMALL,
    absorb,
    activate,
    augment,
    cholesky,
    downdate,
    forward,
    is_finite,
    project,
    propagate,
    record,
    save,
    undo,
    whiten,
)
from slamkit.compiled import (
    ACTIVE,
    ACTIVE_THEN,
    COLUMNS,
    DEBT,
    FAILING,
    LIMIT,
    MOST,
    ODD,
    PER_SQUARE,
    ROWS,
    SPENT,
    SPENT_PLAIN,
    START,
    STATUS,
    STAYS,
    WHOLE,
    WHOLE_THEN,
    compiled,
    intrinsics,
    part,
)

#: FULL: nothing has happened, for want of room. DUE: the step is done, and the belief would be tended to.
OK, BAD_MOTION, BAD_SIGHTING, NOT_DEFINITE, FULL, DUE = 0, 1, 2, 3, 4, 5


@compiled("index(models, state, integers, matrix)", generic=True)
def first_bad(models: Any, state: Any, slots: Any, z: Any) -> int:
    """The first sighting that the sensor cannot use from ``state.scratch.pose``, or -1; asked before anything changes."""
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


@compiled("void(state, index, index)")
def drop(state: Any, place: int, k: int) -> None:
    """The sighting at this place of the scan gave no finite numbers: it is refused."""
    state.scratch.non_finite += 1
    state.scratch.accepted[place], state.scratch.nis[place] = False, inf
    for r in range(k):
        state.scratch.innovations[place, r] = nan


@compiled("flag(policy, models, state, index)", generic=True)
def linearise_one(policy: Any, models: Any, state: Any, j: int) -> bool:
    """Linearise sighting j of ``state.scratch.slots`` at ``state.scratch.at``; False, and it is refused, without finite numbers."""
    k = models.R.shape[0]
    at, y, H_pose, H_landmark, first = state.scratch.at, state.last.y, state.scratch.H_pose, state.scratch.H_landmark, j * k
    landmark, z = rows_of(at, 3 + 2 * j, 2), rows_of(state.last.z, first, k)
    policy.sensor(models, state, rows_of(at, 0, 3), landmark, state.scratch.slots[j], z, first)
    total = 0.0
    for r in range(first, first + k):
        # A sum is finite only if all of it is, or if it is so large that no filter can use it.
        total += (y[r] + H_pose[r, 0]) + (H_pose[r, 1] + H_pose[r, 2]) + (H_landmark[r, 0] + H_landmark[r, 1])
    if isfinite(total):
        return True
    drop(state, state.scratch.order[j], k)
    return False


@compiled("index(policy, models, state, index)", generic=True)
def linearise(policy: Any, models: Any, state: Any, n: int) -> int:
    """Linearise the n sightings in ``state.scratch.slots`` at ``state.scratch.at``; how many of them gave finite numbers.

    Those that did not (a landmark that an earlier sighting of the scan moved onto the robot) are refused.
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


@compiled("index(policy, models, state, index)", generic=True)
def screen(policy: Any, models: Any, state: Any, n: int) -> int:
    """Record each innovation and NIS, drop those beyond the gate; how many stay, -1 if S is not definite."""
    k = models.R.shape[0]
    kept = 0
    for j in range(n):
        place = state.scratch.order[j]
        if not cholesky(state.last.S, state.last.L, j * k, k):
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


@compiled("void(state, index)")
def aim(state: Any, n: int) -> None:
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
def advance(state: Any, n: int) -> float:
    """Move ``state.scratch.at`` to mean + dx; the largest change."""
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


@compiled("index(policy, state, index, index)", generic=True)
def settle(policy: Any, state: Any, n: int, k: int) -> int:
    """Carry out an update that is prepared."""
    size = state.size
    state.last.rows, state.last.active, state.last.dim = n * k, state.belief.active, state.belief.dim
    downdate(state, n * k)
    # The mean moves before dx is used otherwise.
    policy.retract(state)
    if state.resting.columns > 0:
        record(state, n, k)
    return OK


@compiled("void(state, index)")
def refuse(state: Any, rows: int) -> None:
    """An update beyond the gate is on record with y, S and L as they are and a gain of zero: it has changed nothing."""
    size = state.size
    state.last.rows, state.last.active, state.last.dim = rows, state.belief.active, state.belief.dim
    for r in range(rows):
        for i in range(state.belief.active):
            state.last.w[r, i] = 0.0
        for i in range(state.resting.columns):
            state.last.g[r, i] = 0.0


@compiled("index(state, index)")
def dismiss(state: Any, rows: int) -> int:
    """`refuse` all rows of an update that is not factored yet."""
    if not cholesky(state.last.S, state.last.L, 0, rows):
        return NOT_DEFINITE
    forward(state.last.L, state.last.y, state.last.t, 0, rows)
    refuse(state, rows)
    return OK


@compiled("index(policy, models, state)", generic=True)
def correct_one(policy: Any, models: Any, state: Any) -> Any:
    """The update by one sighting of two rows, which nearly every update is."""
    at, mean, y, slot, place = state.scratch.at, state.belief.mean, state.last.y, state.scratch.slots[0], state.scratch.order[0]
    at[0], at[1], at[2], at[3], at[4] = mean[0], mean[1], mean[2], mean[slot], mean[slot + 1]
    if not linearise_one(policy, models, state, 0):
        return dismiss(state, 0)
    nis = absorb(state, policy.gate)
    state.scratch.innovations[place, 0], state.scratch.innovations[place, 1], state.scratch.nis[place] = y[0], y[1], nis
    state.scratch.accepted[place] = nis <= policy.gate
    if nis <= policy.gate:
        return NOT_DEFINITE if nis < 0.0 else settle(policy, state, 1, 2)
    refuse(state, 2)
    return OK


@compiled("index(policy, models, state, index)", generic=True)
def correct_stacked(policy: Any, models: Any, state: Any, n: int) -> Any:
    """The same of any number and any length."""
    k = models.R.shape[0]
    aim(state, n)
    n = linearise(policy, models, state, n)
    project(state, n, k)
    kept = screen(policy, models, state, n)
    if kept < 0:
        return NOT_DEFINITE
    if kept == 0:
        return dismiss(state, n * k)
    factored = kept == n == 1  # by `screen`, and t is there as well
    if kept < n:
        n = kept
        aim(state, n)
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
        if iteration + 1 == policy.iterations or advance(state, n) < 1e-12:
            break
        linearise(policy, models, state, n)
        shift_innovation(state, n, k)
        project(state, n, k)
    return settle(policy, state, n, k)


@compiled("index(policy, models, state, index)", generic=True)
def correct(policy: Any, models: Any, state: Any, n: int) -> Any:
    """One update by the n sightings in ``state.scratch.slots`` and ``state.last.z``, stacked.

    With more than one iteration it is the iterated EKF: linearise at the last iterate until it stands still
    (Bell & Cathey, IEEE TAC 38(2), 1993: Gauss-Newton on the same cost).
    """
    if n == 1 and models.R.shape[0] == 2 and policy.iterations == 1:
        return correct_one(policy, models, state)
    return correct_stacked(policy, models, state, n)


@compiled("index(policy, models, state, index, vector)", generic=True)
def begin(policy: Any, models: Any, state: Any, place: int, z: Any) -> Any:
    """Start a landmark from its first sighting; its slot."""
    slot = state.belief.active
    policy.start(models, state, slot, place, z)
    if not isfinite(state.belief.mean[slot] + state.belief.mean[slot + 1]):
        state.scratch.non_finite += 1
    augment(state, slot)
    return slot


@compiled("index(policy, models, state, integers, matrix, flag)", generic=True)
def take(policy: Any, models: Any, state: Any, slots: Any, z: Any, moved: bool) -> Any:
    """Take a scan: correct by the landmarks that are known, start the others and write their slots.

    One after the other, each linearised anew, or (``policy.batch``) all known ones in one stacked update first.
    """
    n, k = z.shape
    policy.scan(models, state, slots, moved)
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
            status = policy.correct(policy, models, state, known)
            if status != OK:
                return status
        for i in range(n):
            if slots[i] < 0:
                slots[i] = begin(policy, models, state, i, z[i])
        return OK
    for i in range(n):
        if slots[i] >= 0:
            state.scratch.slots[0], state.scratch.order[0] = slots[i], i
            for r in range(k):
                state.last.z[r] = z[i, r]
            status = policy.correct(policy, models, state, 1)
            if status != OK:
                return status
        else:
            slots[i] = begin(policy, models, state, i, z[i])
    return OK


@compiled("flag(state, integers)")
def awaken(state: Any, slots: Any) -> bool:
    """Make the landmarks of a scan active and give their slots there; False, and nothing has changed, without room."""
    size, local = state.size, state.belief.local
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
def rename(state: Any, slots: Any) -> None:
    """Active slots → slots in the map."""
    for i in range(slots.shape[0]):
        if slots[i] >= 0:
            slots[i] = state.belief.owner[slots[i]]


@compiled("index(state, index)")
def upkeep(state: Any, n: int) -> int:
    """`DUE` where it pays to flush after a scan of n sightings, else `OK`.

    A larger active part makes every update dearer; a flush makes it small again, but the base and what is in sight
    will soon be in the next flush too. So a flush pays once the excess since the last has reached the price of that.
    ``state.work`` holds, in multiply-adds: the excess (`DEBT`); the price for each coordinate in sight and D²
    (`PER_SQUARE`), and a flush's fixed price (`START`); the columns at which a flush is due anyway (`MOST`); the
    dimension above which the belief is compressed (`LIMIT`); what the updates since the last flush cost (`SPENT`), and
    would have cost had nothing rested (`SPENT_PLAIN`); for how many steps nothing is to rest (`STAYS`).
    """
    size, work = state.size, state.work
    C = state.resting.columns
    if C == 0:
        if state.belief.dim <= state.resting.limit:
            return OK
        state.resting.stays -= 1.0
        return DUE if state.resting.stays < 0.0 else OK
    D, need, whole = float(state.belief.active), 3.0 + 2.0 * n, float(state.belief.dim)
    cost = D * D + 2.0 * D * C + C * C
    state.resting.spent += n * cost
    state.resting.spent_plain += n * whole * whole
    state.resting.debt += n * max(0.0, cost - 4.0 * need * need)
    if state.resting.V.shape[1] > 0 or state.resting.debt > state.resting.price_per_square * need * whole * whole + state.resting.fixed_price or state.resting.most_columns < C:
        return DUE
    return OK


@compiled("flag(state)")
def finite_motion(state: Any) -> bool:
    """Whether a motion's pose, F and Q are finite; a sum is finite only if all of it is."""
    pose, F, Q = state.scratch.pose, state.last.F, state.last.Q
    total = pose[0] + pose[1] + pose[2]
    for i in range(3):
        total += F[i, 0] + F[i, 1] + F[i, 2] + Q[i, 0] + Q[i, 1] + Q[i, 2]
    return isfinite(total)


@compiled("void(state)")
def remember(state: Any) -> None:
    """Keep what a prediction is about to write besides its pose."""
    before, memory, F, Q = state.scratch.refused, state.memory, state.last.F, state.last.Q
    for i in range(6):
        before[i] = memory[i]
    for i in range(3):
        for j in range(3):
            before[6 + 3 * i + j], before[15 + 3 * i + j] = F[i, j], Q[i, j]


@compiled("index(state, integers, real, index)")
def refuse_step(state: Any, slots: Any, dt: float, status: int) -> int:
    """Give back the caller's slots, and what `remember` has kept where there was a prediction; the status."""
    before, memory, F, Q = state.scratch.refused, state.memory, state.last.F, state.last.Q
    rename(state, slots)
    if dt > 0.0:
        for i in range(6):
            memory[i] = before[i]
        for i in range(3):
            for j in range(3):
                F[i, j], Q[i, j] = before[6 + 3 * i + j], before[15 + 3 * i + j]
    return status


@compiled("index(policy, models, state, integers, matrix, real)", generic=True)
def advance_and_take(policy: Any, models: Any, state: Any, slots: Any, z: Any, dt: float) -> Any:
    """Carry out a prediction that is prepared, unless dt is 0, and take the scan."""
    if dt > 0.0:
        for i in range(3):
            state.belief.mean[i] = state.scratch.pose[i]
        propagate(state)
    return take(policy, models, state, slots, z, dt > 0.0)


@compiled("index(policy, models, state, vector, real, integers, matrix)", generic=True)
def step(policy: Any, models: Any, state: Any, u: Any, dt: float, slots: Any, z: Any) -> Any:
    """Predict over dt (unless it is 0), then take the scan. A refused step has changed nothing.

    The slots are those of the whole map; those of new landmarks are written.
    """
    if not awaken(state, slots):
        return FULL
    if dt > 0.0:
        remember(state)
        policy.motion(models, state, u, dt)
        if not finite_motion(state):
            return refuse_step(state, slots, dt, BAD_MOTION)
    else:
        for i in range(3):
            state.scratch.pose[i] = state.belief.mean[i]
    size, D = state.size, state.belief.active
    before = state.last.rows, state.last.active, state.last.dim
    state.scratch.non_finite = 0
    if state.resting.columns == 0 and state.belief.mean.shape[0] <= SMALL and state.last.rows <= 2 and models.sights and not policy.batch:
        # To save so little is cheaper than to ask every sighting first; only where one fails they are asked after all.
        save(state)
        status = advance_and_take(policy, models, state, slots, z, dt)
        if state.scratch.non_finite == 0:
            rename(state, slots)
            return upkeep(state, slots.shape[0]) if status == OK else status
        for i in range(slots.shape[0]):
            slots[i] = slots[i] if slots[i] < D else -1
        undo(state, D)
        state.last.rows, state.last.active, state.last.dim = before
    bad = first_bad(models, state, slots, z)
    if bad >= 0:
        state.scratch.failing = bad
        return refuse_step(state, slots, dt, BAD_SIGHTING)
    status = advance_and_take(policy, models, state, slots, z, dt)
    rename(state, slots)
    return upkeep(state, slots.shape[0]) if status == OK else status


as_policy, as_models, as_state = intrinsics("structures", "as_policy", "as_models", "as_state")


@compiled("index(index, index, index, vector, real, integers, matrix)")
def step_at(policy: int, models: int, state: int, u: Any, dt: float, slots: Any, z: Any) -> Any:
    """`step` with the addresses of its tables, for a caller in Python to whom every microsecond counts."""
    return as_policy(policy).step(as_policy(policy), as_models(models), as_state(state), u, dt, slots, z)


@compiled(
    "index(policy, models, state, matrix, vector, integers, integers, integers, integers, matrix, matrix, matrix, "
    "index, index, matrix, cube, matrix, vector, flags)",
    generic=True,
    allocates=True,
)
def run(
    policy: Any, models: Any, state: Any, controls: Any, dt: Any, control: Any, first: Any, which: Any, slot_of: Any,
    z: Any, true_poses: Any, true_landmarks: Any, begin_at: int, end_at: int,
    poses: Any, covariances: Any, innovations: Any, nis: Any, accepted: Any,
) -> int:  # fmt: skip
    """Steps begin_at … end_at-1 of a schedule, recorded, until one is not OK; how many are done.

    The last status stays in the state: OK at the end, DUE after a step that is done, else that of the one refused.

    ``which[j]`` is the log's landmark in observation j, ``slot_of`` maps it to its slot (-1: not in the map yet);
    the true poses and landmarks are empty unless the filter is told them.
    """
    slots = np.empty(state.scratch.nis.shape[0], np.int64)
    for i in range(begin_at, end_at):
        lo, n = first[i], first[i + 1] - first[i]
        for j in range(n):
            slots[j] = slot_of[which[lo + j]]
            if true_landmarks.shape[0] > 0:
                for c in range(2):
                    state.scratch.truth[j, c] = true_landmarks[which[lo + j], c]
        if true_poses.shape[0] > 0:
            for c in range(3):
                state.memory[c] = true_poses[i, c]
        status = policy.step(policy, models, state, controls[max(control[i], 0)], dt[i], slots[:n], z[lo : lo + n])
        for j in range(n):
            slot_of[which[lo + j]] = slots[j]
        state.scratch.status = status
        if status != OK and status != DUE:
            return i
        policy.report(state, poses[i], covariances[i])
        for j in range(n):
            for r in range(innovations.shape[1]):
                innovations[lo + j, r] = state.scratch.innovations[j, r]
            nis[lo + j] = state.scratch.nis[j]
            accepted[lo + j] = state.scratch.accepted[j]
        if status == DUE:
            return i + 1
    return end_at
