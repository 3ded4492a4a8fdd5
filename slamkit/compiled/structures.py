"""The types of compiled code and the three structures it shares with Python. Importing this module imports Numba.

A structure crosses into compiled code as one pointer, whatever it holds. That matters twice: a call with two dozen
array arguments would cost microseconds, and a function that is passed as an argument costs 30 µs at every call.
"""

# mypy: disable-error-code="misc, no-untyped-def, untyped-decorator, no-untyped-call"
# Numba has no type information, and these signatures are written in its own types.

from __future__ import annotations

from typing import Any

from numba import njit, types
from numba.experimental import structref

void, real, index, flag = types.void, types.float64, types.int64, types.boolean
vector, matrix, cube = types.float64[::1], types.float64[:, ::1], types.float64[:, :, ::1]
integers, flags = types.int64[::1], types.boolean[::1]

SHARED = {"cache": True, "error_model": "numpy"}


def function(*arguments: Any) -> types.FunctionType:
    """Type of a function that writes into its last arguments."""
    return types.FunctionType(void(*arguments))


@structref.register
class StateType(types.StructRef):
    """Belief and workspace."""


@structref.register
class ModelsType(types.StructRef):
    """A motion and a sensor model."""


@structref.register
class PolicyType(types.StructRef):
    """What distinguishes one estimator."""


class StateHandle(structref.StructRefProxy):
    """A state as Python holds it."""


class ModelsHandle(structref.StructRefProxy):
    """Models as Python holds them."""


class PolicyHandle(structref.StructRefProxy):
    """A policy as Python holds it."""


structref.define_boxing(StateType, StateHandle)
structref.define_boxing(ModelsType, ModelsHandle)
structref.define_boxing(PolicyType, PolicyHandle)

STATE_FIELDS = {
    "mean": vector,  # (capacity,) pose, then two numbers a landmark
    "cov": matrix,  # (capacity, capacity) lower triangle
    "points": vector,  # (capacity,) where the lever arms of the Jacobians are taken, if not at the mean
    "memory": vector,  # (6,) a variant's own few numbers
    "size": integers,  # (5,) D, rows of the last update, D at the last update, failing sighting, status
    "pose": vector,  # (3,) the pose that the step arrives at
    "F": matrix,  # (3, 3)
    "Q": matrix,  # (3, 3)
    "G": matrix,  # (3, m)
    "sigma_u": matrix,  # (m, m)
    "at": vector,  # (3 + 2n,) the point at which a scan is linearised
    "slots": integers,  # (n,) slots of the sightings that an update uses
    "order": integers,  # (n,) their places in the scan
    "innovations": matrix,  # (n, k) what the scan's sightings said, in the scan's order
    "nis": vector,  # (n,)
    "truth": matrix,  # (n, 2) true positions of the scan's landmarks, where a filter is told them
    "accepted": flags,  # (n,)
    "z": vector,  # (rows,) their measurements, one after the other
    "z_hat": vector,  # (k,) one predicted measurement
    "y": vector,  # (rows,) innovation
    "effective": vector,  # (rows,) innovation as the linear update wants it
    "H_pose": matrix,  # (rows, 3)
    "H_landmark": matrix,  # (rows, 2)
    "noise": matrix,  # (rows, k) the k × k noise of each sighting, one below the other
    "S": matrix,  # (rows, rows)
    "L": matrix,  # (rows, rows) lower Cholesky factor of S
    "w": matrix,  # (rows, capacity) L⁻¹ H P
    "t": vector,  # (rows,) L⁻¹ y
    "dx": vector,  # (capacity,) correction in the filter's error coordinates
    "gathered": matrix,  # (5, capacity) rows of the covariance under the sighting at hand
    "G_pose": matrix,  # (2, 3)
    "G_z": matrix,  # (2, k)
    "block": matrix,  # (2, 2) noise of a new landmark
}
MODELS_FIELDS = {
    "move": function(vector, vector, real, vector, vector),
    "motion_jacobians": function(vector, vector, real, vector, matrix, matrix),
    "control_noise": function(vector, real, vector, matrix),
    "pose_noise": function(vector, vector, real, vector, matrix),
    "predict": function(vector, vector, vector, vector),
    "sensor_jacobians": function(vector, vector, vector, matrix, matrix),
    "residual": function(vector, vector, vector, vector),
    "invert": function(vector, vector, vector, vector),
    "inverse_jacobians": function(vector, vector, vector, matrix, matrix),
    "motion_params": vector,
    "sensor_params": vector,
    "R": matrix,
}
state = StateType(list(STATE_FIELDS.items()))
models = ModelsType(list(MODELS_FIELDS.items()))
POLICY_FIELDS = {
    "motion": function(models, state, vector, real),
    "sensor": function(models, state, vector, vector, index, vector, index),
    "start": function(models, state, index, index, vector),
    "scan": function(models, state, integers, flag),
    "retract": function(state),
    "report": function(state, vector, matrix),
    "gate": real,
    "iterations": index,
    "batch": flag,
}
policy = PolicyType(list(POLICY_FIELDS.items()))


@njit(state(*STATE_FIELDS.values()), **SHARED)
def make_state(
    mean, cov, points, memory, size, pose, F, Q, G, sigma_u, at, slots, order, innovations, nis,
    truth, accepted, z, z_hat, y, effective, H_pose, H_landmark, noise, S, L, w, t, dx, gathered, G_pose, G_z, block,
):  # fmt: skip
    """The compiled twin of a state."""
    s = structref.new(state)
    s.mean, s.cov, s.points, s.memory, s.size = mean, cov, points, memory, size
    s.pose, s.F, s.Q, s.G, s.sigma_u = pose, F, Q, G, sigma_u
    s.slots, s.order, s.innovations, s.nis, s.accepted = slots, order, innovations, nis, accepted
    s.truth = truth
    s.at, s.z, s.z_hat, s.y, s.effective = at, z, z_hat, y, effective
    s.H_pose, s.H_landmark, s.noise = H_pose, H_landmark, noise
    s.S, s.L, s.w, s.t, s.dx, s.gathered = S, L, w, t, dx, gathered
    s.G_pose, s.G_z, s.block = G_pose, G_z, block
    return s


@njit(models(*MODELS_FIELDS.values()), **SHARED)
def make_models(
    move, motion_jacobians, control_noise, pose_noise, predict, sensor_jacobians, residual, invert, inverse_jacobians,
    motion_params, sensor_params, R,
):  # fmt: skip
    """The compiled twin of a pair of models."""
    s = structref.new(models)
    s.move, s.motion_jacobians, s.control_noise, s.pose_noise = move, motion_jacobians, control_noise, pose_noise
    s.predict, s.sensor_jacobians, s.residual = predict, sensor_jacobians, residual
    s.invert, s.inverse_jacobians = invert, inverse_jacobians
    s.motion_params, s.sensor_params, s.R = motion_params, sensor_params, R
    return s


@njit(policy(*POLICY_FIELDS.values()), **SHARED)
def make_policy(motion, sensor, start, scan, retract, report, gate, iterations, batch):
    """The compiled twin of a policy."""
    s = structref.new(policy)
    s.motion, s.sensor, s.start, s.scan, s.retract, s.report = motion, sensor, start, scan, retract, report
    s.gate, s.iterations, s.batch = gate, iterations, batch
    return s


MAKERS = {"state": make_state, "models": make_models, "policy": make_policy}
WORDS = {
    "void": void, "real": real, "index": index, "flag": flag, "vector": vector, "matrix": matrix, "cube": cube,
    "integers": integers, "flags": flags, "state": state, "models": models, "policy": policy,
}  # fmt: skip
