"""The functions in which estimators differ.

What distinguishes an estimator stands in its policy:

``associate(policy, models, state, slots, z)``
    writes the slot of every sighting whose landmark is not given.
``motion(models, state, u, dt)``
    writes the pose to arrive at, F and Q.
``prepare_scan(models, state, slots, moved)``
    is told which landmarks a scan holds (-1: not in the map) before it is taken, and whether a prediction preceded it.
``sensor(models, state, pose, landmark, slot, z, row)``
    linearises one sighting at (pose, landmark): writes its rows of y, H_pose, H_landmark and noise.
``update(policy, models, state, n)``
    makes one update by the n sightings in ``state.scratch.slots`` and ``state.last.z``: a status.
``retract(state)``
    moves the mean by dx, in the estimator's own error coordinates.
``initialise(models, state, slot, place, z)``
    writes a new landmark's mean, G_pose and the noise of its block; `place` is the sighting's place in the scan.
``report(state, pose, covariance)``
    writes the pose and its covariance in standard coordinates.
``step(policy, models, state, u, dt, slots, z)``, ``process_scan(policy, models, state, slots, z, moved)``
    the step itself, and its second half: by their addresses, so that they are machine code once, not in each caller.
``gate, iterations, batch``
    largest NIS that is accepted; linearisations of an update; whether a scan is one stacked update.
"""

from __future__ import annotations

from functools import cached_property
from types import SimpleNamespace
from typing import Any, NamedTuple

from slamkit.compiled import Compiled, Models, Shared, Table
from slamkit.cycle import standard
from slamkit.cycle.associate import known_ids
from slamkit.cycle.scan import process_scan
from slamkit.cycle.step import step
from slamkit.cycle.update import update

POLICY = Table(
    "policy",
    associate="void(policy, models, state, integers, matrix)",
    motion="void(models, state, vector, real)",
    prepare_scan="void(models, state, integers, flag)",
    sensor="void(models, state, vector, vector, index, vector, index)",
    update="index(policy, models, state, index)",
    retract="void(state)",
    initialise="void(models, state, index, index, vector)",
    report="void(state, vector, matrix)",
    process_scan="index(policy, models, state, integers, matrix, flag)",
    step="index(policy, models, state, vector, real, integers, matrix)",
    gate="real",
    iterations="index",
    batch="flag",
)


class EstimatorFunctions(NamedTuple):
    """The functions in which an estimator differs from the standard EKF; the module's docstring says what each does."""

    motion: Compiled = standard.motion
    sensor: Compiled = standard.sensor
    initialise: Compiled = standard.initialise
    prepare_scan: Compiled = standard.prepare_scan
    update: Compiled = update
    retract: Compiled = standard.retract
    report: Compiled = standard.report
    associate: Compiled = known_ids


class Policy(Shared):
    """What distinguishes one estimator, and the step that all have in common."""

    def __init__(self, functions: EstimatorFunctions, *, gate: float, iterations: int, batch: bool) -> None:
        super().__init__(
            POLICY,
            **functions._asdict(),
            process_scan=process_scan,
            step=step,
            gate=gate,
            iterations=iterations,
            batch=batch,
        )

    @cached_property
    def plain(self) -> SimpleNamespace:
        """The same policy with the Python forms of its functions."""
        forms = {n: v.plain if isinstance(v, Compiled) and v.generic else v for n, v in self.values.items()}
        return SimpleNamespace(**forms)


def call(function: Compiled, policy: Policy, models: Models, *arguments: Any) -> Any:
    """Call a function of the cycle: as machine code where the models allow it, else the same source as Python."""
    if models.compiled:
        return function(policy, models, *arguments)
    return function.plain(policy.plain, models, *arguments)
