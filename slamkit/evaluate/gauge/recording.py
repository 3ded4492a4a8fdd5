"""What an estimator linearised: its linearisation points, and the Jacobians of every update of a run.

This is the only file of the gauge package that reads what an estimator keeps to itself.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np

from slamkit.arrays import Array, Indices
from slamkit.compiled import Models
from slamkit.evaluate.gauge.rigid_body import turned
from slamkit.filters.landmark_filter import LandmarkFilter
from slamkit.logs import Log


def steps(filter: LandmarkFilter, log: Log) -> Iterator[float]:
    """Run a log step by step; yields the duration [s] of each step's prediction after the step."""
    for step in log:
        if step.u is None:
            filter.observe_scan(step.scan)
        else:
            filter.step(step.u, step.dt, step.scan)
        yield step.dt


def linearisation_points(filter: LandmarkFilter) -> Array:
    """Give the state (D,) at which the estimator takes its lever arms; its belief is in standard coordinates then."""
    filter._to_standard_coordinates()
    return filter._lever_points()


def observability_matrix(filter: LandmarkFilter, log: Log) -> Array:
    """Stack R^(-1/2) H_k Φ_{k-1} … Φ_0 over all sightings of a log, with the Jacobians that the estimator used.

    Parameters
    ----------
    filter : LandmarkFilter
        The estimator at the start of the log. A copy makes the run, as Python.
    log : Log

    Returns
    -------
    ndarray (rows, D)
        One block of rows for each sighting. Landmarks that the log never sights have no columns.
    """
    f, sightings, corrected = _recording(filter)
    D = f.dim_x + 2 * sum(i not in f.landmarks for i in log.landmark_ids)
    own = f.base - 3  # a belief in a frame of its own begins with the robot there, whose error starts at zero
    Phi, rows = np.eye(own + D)[:, own:], [np.zeros((0, D))]
    for dt in steps(f, log):
        if dt > 0:
            Phi[:3] = f._belief.state.last.F @ Phi[:3]
        rows += [H @ Phi[at] for at, H in sightings]
        sightings.clear()
        if corrected:
            f._change_frame(Phi, corrected[-1])
            corrected.clear()
        before = f._lever_points()
        Phi[: f.dim_x] += np.outer(turned(linearisation_points(f) - before), Phi[2])
    return np.concatenate(rows)[:, : f.dim_x]


def _recording(filter: LandmarkFilter) -> tuple[LandmarkFilter, list[tuple[Indices, Array]], list[Array]]:
    """A copy that runs as Python and appends to two lists.

    The first gets, for each sighting, the coordinates (n,) that it depends on and the whitened H (k, n) on them. The
    second gets the pose (3,) after each update.
    """
    f = copy.deepcopy(filter)
    policy = f._new_policy()
    own = policy.plain
    sightings: list[tuple[Indices, Array]] = []
    corrected: list[Array] = []
    dense: dict[int, tuple[Array, Array]] = {}

    def keep(at: Indices, H: Array, noise: Array) -> None:
        sightings.append((at, np.linalg.solve(np.linalg.cholesky(noise), H)))

    def block(slot: int) -> Indices:
        return np.array([0, 1, 2, slot, slot + 1])

    # A dense H belongs to the belief before the update. A sparse one is still in the state at the end of the update.
    def update(policy: Any, models: Any, state: Any, n: int) -> int:
        dense.clear()
        for slot in state.scratch.slots[:n].tolist():
            regression = f._regression(slot)
            if regression is not None:
                dense[slot] = regression
        return int(own.update(policy, models, state, n))

    # Every update ends in one retraction.
    def retract(state: Any) -> None:
        scratch = state.scratch
        k = scratch.noise.shape[1]
        for j, slot in enumerate(scratch.slots[: state.last.rows // k].tolist()):
            rows = slice(j * k, (j + 1) * k)
            if slot in dense:
                keep(np.arange(state.belief.dim), *dense[slot])
            else:
                H = np.hstack([scratch.H_pose[rows], scratch.H_landmark[rows]])
                keep(block(int(state.belief.owner[slot])), H, scratch.noise[rows])
        own.retract(state)
        corrected.append(state.belief.mean[:3].copy())

    def initialise(models: Any, state: Any, slot: int, place: int, z: Any) -> None:
        own.initialise(models, state, slot, place, z)
        scratch = state.scratch
        keep(block(state.belief.dim), np.hstack([-scratch.G_pose, np.eye(2)]), scratch.block)

    recorded = {"update": update, "retract": retract, "initialise": initialise}
    vars(policy)["plain"] = SimpleNamespace(**{**vars(own), **recorded})
    vars(f).update(_policy=policy, _models=Models(compiled=False, **f._models.values))
    return f, sightings, corrected
