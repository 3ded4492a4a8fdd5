"""Predict: where the motion leads, prepared without being committed."""

from __future__ import annotations

from math import isfinite
from typing import Any

from slamkit.belief.dense import propagate
from slamkit.compiled import compiled
from slamkit.cycle.status import BAD_MOTION, NOT_DEFINITE, OK


@compiled("flag(state)")
def finite_motion(state: Any) -> bool:
    """Whether a motion's pose, F and Q are finite; a sum is finite only if all of it is."""
    pose, F, Q = state.scratch.pose, state.last.F, state.last.Q
    total = pose[0] + pose[1] + pose[2]
    for i in range(3):
        total += F[i, 0] + F[i, 1] + F[i, 2] + Q[i, 0] + Q[i, 1] + Q[i, 2]
    return isfinite(total)


@compiled("real(state, index)")
def predicted_variance(state: Any, i: int) -> Any:
    """Variance of entry i of the pose after the prediction that is prepared: (F P Fᵀ + Q)_ii."""
    cov, F = state.belief.cov, state.last.F
    a, b, c = F[i, 0], F[i, 1], F[i, 2]
    return (
        state.last.Q[i, i]
        + a * (a * cov[0, 0] + 2.0 * (b * cov[1, 0] + c * cov[2, 0]))
        + b * (b * cov[1, 1] + 2.0 * c * cov[2, 1])
        + c * c * cov[2, 2]
    )


@compiled("void(state)")
def keep_refused(state: Any) -> None:
    """Keep what a prediction is about to write besides its pose."""
    refused, F, Q, own = state.scratch.refused, state.last.F, state.last.Q, state.own
    for i in range(3):
        for j in range(3):
            refused[3 * i + j], refused[9 + 3 * i + j] = F[i, j], Q[i, j]
    for i in range(own.shape[0]):
        state.scratch.refused_own[i] = own[i]


@compiled("index(policy, models, state, vector, real)", generic=True)
def prepare(policy: Any, models: Any, state: Any, u: Any, dt: float) -> int:
    """Write the pose to arrive at, F and Q. The belief has not moved; `give_back` undoes what is written."""
    if dt > 0.0:
        keep_refused(state)
        policy.motion(models, state, u, dt)
        if not finite_motion(state):
            return BAD_MOTION
        if not isfinite(predicted_variance(state, 0) + predicted_variance(state, 1) + predicted_variance(state, 2)):
            return NOT_DEFINITE
    else:
        for i in range(3):
            state.scratch.pose[i] = state.belief.mean[i]
    return OK


@compiled("void(state)")
def commit(state: Any) -> None:
    """Carry out the prediction that is prepared."""
    for i in range(3):
        state.belief.mean[i] = state.scratch.pose[i]
    propagate(state)


@compiled("index(state, real, index)")
def give_back(state: Any, dt: float, status: int) -> int:
    """Bring back F, Q and the estimator's own numbers from before a prediction that is refused; gives the status."""
    if dt > 0.0:
        refused, F, Q, own = state.scratch.refused, state.last.F, state.last.Q, state.own
        for i in range(3):
            for j in range(3):
                F[i, j], Q[i, j] = refused[3 * i + j], refused[9 + 3 * i + j]
        for i in range(own.shape[0]):
            own[i] = state.scratch.refused_own[i]
    return status
