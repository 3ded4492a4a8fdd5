"""What lies between a call of a filter and the compiled step, and what an estimator may do otherwise."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from slamkit.arrays import Array, Indices
from slamkit.belief.compressed import undisturbed
from slamkit.compiled import Compiled, MachineCode, Models, OwnFields, needed
from slamkit.cycle import EstimatorFunctions, Policy, call
from slamkit.cycle.run import run as run_steps
from slamkit.cycle.status import CAREFUL, DUE, FULL, OK
from slamkit.cycle.step import step, step_at
from slamkit.filters import explain
from slamkit.filters.filterpy_attributes import FilterpyAttributes
from slamkit.filters.inputs import control_array
from slamkit.logs import Log, Schedule
from slamkit.protocols import MotionModel, SensorModel

DONE = (OK, DUE)


class Stepping(FilterpyAttributes):
    """The policy of an estimator and its steps. An estimator overrides class attributes and the hooks below."""

    name: ClassVar[str]  #: the estimator's name on the command line and in figures
    functions: ClassVar[EstimatorFunctions] = EstimatorFunctions()
    own_fields: ClassVar[OwnFields] = OwnFields()  #: numbers that it keeps beside the belief
    iterations: ClassVar[int] = 1  #: linearisations of an update, at most
    base: ClassVar[int] = 3  #: entries of the belief before its first landmark, the pose in front
    linearisation_points: ClassVar[str] = "mean"  #: field of the belief at which the Jacobians take their lever arms
    compresses: bool = True  #: whether an update leaves alone what is not in sight, so that it may rest
    fixed_attributes: ClassVar[tuple[str, ...]] = (
        *("name", "functions", "own_fields", "iterations", "base", "linearisation_points", "compresses"),
        *("fixed_attributes", "snapshots", "storage", "dim_z", "dim_u", "B"),
    )

    if TYPE_CHECKING:
        dim_u: int
        _motion: MotionModel
        _sensor: SensorModel
        _order: str
        _gate: float | None
        _models: Models
        _policy: Policy

    def _new_policy(self) -> Policy:
        gate = np.inf if self._gate is None else self._gate
        return Policy(self.functions, gate=gate, iterations=self.iterations, batch=self._order == "batch")

    # -- what an estimator may do otherwise ---------------------------------------------------------------------------

    def _marginals(self) -> tuple[Array, Array]:
        """Mean (N, 2) and covariance (N, 2, 2) of every landmark by itself, in standard coordinates."""
        self._to_standard_coordinates()
        return self._belief.marginals()

    def _to_standard_coordinates(self) -> None:
        """Bring the covariance to standard coordinates at the current mean."""

    def _lever_points(self) -> Array:
        """Points (D,) at which the Jacobians take their lever arms; the entry of the heading means nothing."""
        return self._belief.linearisation_points(self.linearisation_points)

    def _regression(self, slot: int) -> tuple[Array, Array] | None:
        """H (k, D) and noise (k, k) of a sighting of the landmark at `slot`; None where H is sparse."""
        return None

    def _change_frame(self, rows: Array, pose: Array) -> None:
        """Take rows (dim, n), one an error of the belief, through the change of frame that ends a corrected step.

        `pose` (3,) is the belief's pose after the step's last correction; the step itself is over.
        """

    def _mean(self) -> Array:
        """Mean (D,) in standard coordinates; a copy."""
        return self._belief.mean

    def _covariance(self) -> Array:
        """Covariance (D, D) in standard coordinates; a copy."""
        return self._belief.covariance

    def _set_mean(self, x: Array) -> None:
        """Let x be the mean; P, in standard coordinates, stays."""
        self._belief.mean = x

    def _set_covariance(self, P: Array) -> None:
        """Let P, in standard coordinates, be the covariance; x stays."""
        self._belief.covariance = P

    def _update_dense(self, H: Array, y: Array, R: Array) -> None:
        """Update by ``y = H δ + v``, v ~ N(0, R), with a dense H (r, D) in standard coordinates."""
        self._belief.gain(H, y, R)
        self._belief.update(self._policy.retract)

    def _before_run(self, log: Log, schedule: Schedule) -> None:
        """Prepare for the steps of a log."""

    # -- between the caller and the step ------------------------------------------------------------------------------

    def _control(self, u: ArrayLike) -> Array:
        return control_array(u, self.dim_u, self._motion)

    def _take_control_length(self, length: int) -> None:
        """A plain model need not say how long its controls are: the first one that it takes does."""
        if length != self.dim_u:
            self._belief.reserve(0, control_dim=max(length, 1))
            vars(self)["dim_u"] = length

    def _apply_step(self, u: Array, dt: float, ids: Sequence[Hashable], z: Array) -> None:
        """Predict over dt, unless it is 0, and use a scan; or raise, and nothing has changed."""
        if dt > 0 and len(u) != self.dim_u:
            known = self.dim_u
            try:
                self._take_control_length(len(u))
                Stepping._apply_step(self, u, dt, ids, z)  # not an override, which has begun already
            except BaseException:
                vars(self)["dim_u"] = known
                raise
            return
        belief = self._belief
        if len(ids) > len(belief.state.scratch.nis):
            belief.reserve(0, len(ids))
        try:
            slots, all_known = np.fromiter(map(belief.slots.__getitem__, ids), np.int64, len(ids)), True
        except KeyError:
            slots, all_known = np.array([belief.slots.get(i, -1) for i in ids], dtype=np.int64), False
        status = self._run_step(u, dt, slots, z)
        if status != OK:
            if status == FULL:
                belief.grow_for(slots)
                status = self._run_step(u, dt, slots, z)
            if status == CAREFUL:
                status = self._undoing(lambda: self._run_step(u, dt, slots, z))
            if status not in DONE:
                raise explain.failure(self, status, u, ids, z)
        if not all_known:
            for i, slot in zip(ids, slots.tolist(), strict=True):
                if slot >= 0 and i not in belief.slots:
                    belief.register(i, slot)
        if status == DUE:
            belief.flush_if_due()

    def _run_step(self, u: Array, dt: float, slots: Indices, z: Array) -> int:
        policy, models, state = self._policy, self._models, self._belief.state
        if models.compiled:
            return step_at.jitted(policy.address, models.address, state.address, u, dt, slots, z)  # type: ignore[no-any-return]
        return self._call(step, u, dt, slots, z)

    def _call(self, function: Compiled, *arguments: Any) -> int:
        """Call a function of the cycle; a model in Python may raise in the middle of it, and that is undone."""
        if self._models.compiled:
            return int(call(function, self._policy, self._models, self._belief.state, *arguments))
        return self._undoing(lambda: int(call(function, self._policy, self._models, self._belief.state, *arguments)))

    def _undoing(self, go: Callable[[], int]) -> int:
        """Take one step, and bring the belief back if that raises or is not done."""
        belief = self._belief
        before, status = belief.snapshot(), -1
        belief.state.scratch.careful = True
        try:
            status = go()
        finally:
            belief.state.scratch.careful = False
            if status not in DONE:
                with undisturbed():
                    belief.restore(before)
        return status

    def _compiles(self) -> list[MachineCode]:
        """All machine code that the filter runs, compiled and as Python, what takes longest first."""
        if not self._models.compiled:
            return []
        fields = [*self._policy.values.values(), *self._models.values.values()]
        own = [step, *(f for f in fields if isinstance(f, Compiled) and f is not step)]
        called = [run_steps, step_at, *(f for f in needed(own) if not f.generic)]
        return [*((f, "in_table") for f in own), *((f, "jitted") for f in called)]
