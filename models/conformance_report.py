"""What the laws of both kinds share: a report of broken laws, and the laws about calls and compiled functions."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable, Mapping
from math import pi
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from slamkit.arrays import Array
from slamkit.compiled import models_of
from slamkit.errors import ModelError
from slamkit.models.numeric_jacobian import numeric_jacobian
from slamkit.models.relative_position import RelativePosition
from slamkit.models.unicycle import Unicycle
from slamkit.protocols import SensorFunctions

Point = Mapping[str, Any]  #: where a law is tested: names and values of the arguments


class Report:
    """Calls a model's methods, collects the laws that they break, and keeps the calls for later comparisons."""

    def __init__(self, model: Any, protocol: str, hint: str = "") -> None:
        self.model, self.protocol, self.hint = model, protocol, hint
        self.broken: dict[str, list[str]] = {}
        self.calls: list[tuple[str, Point, tuple[Array, ...], tuple[Array, ...]]] = []

    def fail(self, law: str, detail: str, at: Point | None = None) -> None:
        self.broken.setdefault(law, []).append(detail if at is None else f"at {_text(at)}: {detail}")

    def expect(self, law: str, holds: Any, at: Point, expected: Any, got: Any) -> None:
        if not np.all(holds):
            self.fail(law, f"expected {_text(expected)}, got {_text(got)}", at)

    def close(self) -> None:
        if not self.broken:
            return
        n = len(self.broken)
        lines = [f"{type(self.model).__name__} breaks {n} law{'s' * (n > 1)} of {self.protocol}:"]
        for law, details in self.broken.items():
            where = f" (at {len(details)} points, the first:)" if len(details) > 1 else ""
            lines.append(f"- {law}{where} {details[0]}")
        raise ModelError("\n".join(lines))

    def output(self, name: str, at: Point, *shapes: tuple[int, ...]) -> Any:
        """The method's result with its form checked: an array, or a tuple of them; None if it cannot be used."""
        given = _copies(at)
        try:
            method = getattr(self.model, name)
            raw, again = method(*given), method(*_copies(at))
        except Exception as error:
            self.fail(f"{name} raises no error", f"{short(error)}{self.hint}", at)
            return None
        unchanged = [np.array_equal(g, a) for g, a in zip(given, at.values(), strict=True)]
        self.expect(f"{name} leaves its arguments alone", unchanged, at, tuple(at.values()), given)
        results = _tuple(raw) if len(shapes) > 1 else (raw,)
        got, wanted = " and ".join(map(form, results)), " and ".join(f"float64 {s}" for s in shapes)
        if got != wanted:
            self.fail(f"{name} gives float64 arrays of the right shape", f"expected {wanted}, got {got}", at)
            return None
        repeated = _tuple(again) if len(shapes) > 1 else (again,)
        self.expect(f"{name} is deterministic", _identical(results, repeated), at, results, repeated)
        if any(np.shares_memory(r, g) for r in results for g in given if isinstance(g, np.ndarray)):
            self.fail(f"{name} gives new arrays", "expected a new array, got one of the arguments", at)
        self.calls.append((name, at, results, tuple(r.copy() for r in results)))
        return results if len(shapes) > 1 else results[0]

    def finite(self, name: str, at: Point, *results: Array, near: bool = False) -> bool:
        """Whether the results are finite. If not, a law is broken, unless they are NaN and the landmark is near."""
        finite = all(bool(np.all(np.isfinite(r))) for r in results)
        refused = near and not any(np.any(np.isinf(r)) for r in results)
        self.expect(f"{name} is finite", finite or refused, at, "finite numbers", results)
        return finite

    def fused(self, name: str, law: str, at: Point, *apart: Array) -> None:
        """The optional fused function, if there is one, agrees with the separate results."""
        function = getattr(getattr(self.model, "functions", None), name, None)
        if function is None:
            return
        found = [np.full(a.shape, np.nan) for a in apart]
        try:
            function(*_copies(at), np.asarray(getattr(self.model, "params", ()), dtype=float), *found)
        except Exception as error:
            self.fail(f"functions.{name} raises no error", short(error), at)
            return
        expected, got = (np.concatenate([a.ravel() for a in arrays]) for arrays in (apart, found))
        self.expect(law, np.abs(got - expected) <= 1e-9 * (1 + np.abs(expected)), at, expected, got)

    def jacobian(
        self,
        law: str,
        method: str,
        at: Point,
        argument: str,
        analytic: Array,
        scale: float,
        step: ArrayLike,
        difference: Callable[[Array, Array], ArrayLike] | None = None,
    ) -> None:
        """`analytic` is the method's derivative. `scale`, the size of its terms, bounds the rounding error."""

        def f(x: Array) -> ArrayLike:
            return getattr(self.model, method)(*_copies({**at, argument: x}))  # type: ignore[no-any-return]

        try:
            numeric = numeric_jacobian(f, at[argument], step=step, difference=difference)
        except Exception as error:
            self.fail(f"{method} raises no error", f"{short(error)}{self.hint}, as {argument} varies a little", at)
            return
        size = np.maximum(np.abs(analytic), np.abs(numeric))
        # Rows and columns have units of their own, so an entry is compared with the largest of its row and column.
        relative = np.minimum(size.max(axis=1, keepdims=True), size.max(axis=0, keepdims=True))
        self.expect(law, np.abs(analytic - numeric) <= 1e-6 * relative + 1e-10 * scale, at, numeric, analytic)


def _copies(at: Point) -> tuple[Any, ...]:
    return tuple(copy.copy(a) for a in at.values())


def _tuple(value: Any) -> tuple[Any, ...]:
    return tuple(value) if isinstance(value, tuple | list) else (value,)


def _identical(a: tuple[Any, ...], b: tuple[Any, ...]) -> bool:
    return len(a) == len(b) and all(np.array_equal(x, y, equal_nan=True) for x, y in zip(a, b, strict=True))


def form(value: Any) -> str:
    return f"{value.dtype} {value.shape}" if isinstance(value, np.ndarray) else f"a {type(value).__name__}"


def _text(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name} = {_text(v)}" for name, v in value.items())
    if isinstance(value, tuple | list):
        return " and ".join(_text(v) for v in value)
    if isinstance(value, np.ndarray):
        return np.array2string(value, precision=12, separator=", ").replace("\n", "")
    return f"{value:.12g}" if isinstance(value, float) else str(value)


def short(error: Exception) -> str:
    """An error's type and first lines, without the compiler's long explanation."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return f"{type(error).__name__}: {' '.join(lines[:3])[:300]}"


def check_covariance(report: Report, law: str, at: Point, a: Array, *, definite: bool = False) -> None:
    """The law that a matrix is symmetric and positive semidefinite, or positive definite."""
    scale = float(np.abs(a).max())
    report.expect(law, np.abs(a - a.T) <= 1e-12 * scale, at, "a symmetric matrix", a)
    smallest = float(np.linalg.eigvalsh((a + a.T) / 2)[0])
    ok = smallest > 0 if definite else smallest >= -1e-12 * scale
    report.expect(law, ok, at, f"smallest eigenvalue {'>' if definite else '≥'} 0", smallest)


def turned(pose: Array) -> Array:
    """The pose with its heading increased by a whole turn."""
    return np.array([pose[0], pose[1], pose[2] + 2 * pi])


def random_poses(rng: np.random.Generator, n: int) -> Array:
    """Poses (n, 3) within 10 m of the origin."""
    return np.column_stack([rng.uniform(-10, 10, (n, 2)), rng.uniform(-pi, pi, n)])


def check_calls(report: Report, methods: tuple[str, ...]) -> None:
    """The laws about all calls so far: new arrays, copies of the model, and compiled functions."""
    for name, at, results, copies in report.calls:
        if not _identical(results, copies):
            detail = f"expected {_text(copies)} to stay, a later call made it {_text(results)}"
            report.fail(f"{name} gives new arrays", detail, at)
    # Sixty calls of each method are enough.
    calls = [c for n in methods for c in [c for c in report.calls if c[0] == n][:60]]
    for law, duplicate in (("survives pickle", _pickled), ("survives deepcopy", copy.deepcopy)):
        try:
            twin = duplicate(report.model)
            for name, at, _, copies in calls:
                got = _tuple(getattr(twin, name)(*_copies(at)))
                report.expect(law, _identical(got, copies), at, copies, got)
        except Exception as error:
            report.fail(law, short(error))
    if getattr(report.model, "functions", None) is None:
        return
    functions, params = report.model.functions, getattr(report.model, "params", np.empty(0))
    absent = [n for n in methods if not callable(getattr(functions, n, None))]
    if absent:
        report.fail("functions holds one function a method", f"{type(functions).__name__} has no {', '.join(absent)}")
    elif not (isinstance(params, np.ndarray) and params.dtype == np.float64 and params.ndim == 1):
        report.fail("params is a float64 vector", f"expected float64 (n,), got {form(params)}")
    else:
        for name, at, _, copies in calls:
            outs = tuple(np.full(c.shape, np.nan) for c in copies)
            try:
                getattr(functions, name)(*_copies(at), params.copy(), *outs)
            except Exception as error:
                report.fail(f"functions.{name} raises no error", short(error), at)
                continue
            same = [
                np.allclose(o, c, rtol=1e-12, atol=1e-12, equal_nan=True) for o, c in zip(outs, copies, strict=True)
            ]
            report.expect(f"functions.{name} agrees with {name}", same, at, copies, outs)
        try:
            _compile(report, functions, params)
        except Exception as error:
            report.fail("functions fit into a compiled run", short(error))


def _pickled(model: object) -> object:
    return pickle.loads(pickle.dumps(model))


def _compile(report: Report, functions: Any, params: Array) -> None:
    """Make the table that a compiled run takes, with a built-in model as the counterpart."""
    motion, sensor = Unicycle(0.1, 0.1), RelativePosition(0.1)
    moves = report.protocol == "MotionModel"
    if not moves and getattr(functions, "invert", None) is None:
        inverse = sensor.functions.invert, sensor.functions.inverse_jacobians
        separate = functions.predict, functions.jacobians, functions.residual
        functions = SensorFunctions(*separate, *inverse, getattr(functions, "linearise", None))
    f, g = (functions, sensor.functions) if moves else (motion.functions, functions)
    both = (params if moves else motion.params), (sensor.params if moves else params)
    R = np.array(sensor.R if moves else report.model.R, dtype=float)
    _ = models_of(f, g, *both, R, compiled=True).handle
