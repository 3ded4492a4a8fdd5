"""A numeric Jacobian, and the conformance suite that any model can be put through."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from math import cos, pi, sin
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slamkit import se2
from slamkit.compiled import models_of
from slamkit.errors import InputError, ModelError

Array = NDArray[np.float64]
Point = Mapping[str, Any]  #: where a law is tried: names and values of the arguments

MOTION_METHODS = ("move", "jacobians", "control_noise", "pose_noise")
SENSOR_METHODS = ("predict", "jacobians", "residual", "invert", "inverse_jacobians")
NEAR = 0.1  #: within this range [m] a sensor may answer NaN: it refuses the landmark
EPSILON = float(np.finfo(float).eps)
SHRINK, LEVELS, ORDERS = 1.6, 16, 6  # of the extrapolation: 1.6 lest a periodic function meet every step in phase


def numeric_jacobian(
    f: Callable[[Array], ArrayLike],
    x: ArrayLike,
    *,
    step: ArrayLike | None = None,
    difference: Callable[[Array, Array], ArrayLike] | None = None,
) -> Array:
    """Jacobian by central differences, extrapolated to step zero.

    Up to sixteen steps, each 1.6 times shorter than the one before, give a tableau of extrapolated differences; every
    entry of the Jacobian is taken where its own error estimate is smallest. Smooth functions of order one come out to
    about 1e-12. A step at which f is not finite is passed over, so x may lie close to the edge of f's domain.

    Parameters
    ----------
    f : callable
        From an array (n,) to an array (k,).
    x : array_like (n,)
        The point, in the units of f's argument.
    step : array_like () or (n,), optional
        Longest step of each coordinate; by default 0.1, or 1e-5·\\|x\\| where that is more.
    difference : callable, optional
        ``difference(f(x + h), f(x - h))`` (k,) in place of the plain difference, for values that hold angles.

    Returns
    -------
    ndarray (k, n)
        ∂f/∂x; NaN where f was finite at too few steps to tell.

    Raises
    ------
    InputError
        x is not a finite vector, a step is not positive, or f gives no vector.

    References
    ----------
    Ridders, Advances in Engineering Software 4(2):75-76 (1982).

    Examples
    --------
    >>> import numpy as np
    >>> from slamkit.models import numeric_jacobian
    >>> numeric_jacobian(lambda x: np.array([x[0] * x[1], np.sin(x[1])]), [2.0, 0.0]).round(9)
    array([[0., 2.],
           [0., 1.]])
    """
    x = np.array(x, dtype=float)
    if x.ndim != 1 or not np.all(np.isfinite(x)):
        raise InputError(f"x is {x}, expected a finite vector")
    steps = np.maximum(0.1, 1e-5 * np.abs(x)) if step is None else np.asarray(step, dtype=float)
    if steps.shape not in ((), x.shape) or not np.all(np.isfinite(steps) & (steps > 0)):
        raise InputError(f"step is {steps}, expected one number > 0 or {len(x)} of them")
    steps = np.broadcast_to(steps, x.shape)

    def quotients(i: int) -> Iterator[tuple[Array, Array]]:
        """Central quotients (k,) at shrinking steps, and what the rounding of f alone makes of each."""
        for n in range(LEVELS):
            ahead, behind = x.copy(), x.copy()
            ahead[i] += steps[i] / SHRINK**n
            behind[i] -= steps[i] / SHRINK**n
            width = ahead[i] - behind[i]  # what is left of twice the step after rounding
            a, b = np.array(f(ahead), dtype=float), np.array(f(behind), dtype=float)
            if a.ndim != 1 or a.shape != b.shape:
                raise InputError(f"f gave shapes {a.shape} and {b.shape}, expected one vector length")
            change = np.asarray(a - b if difference is None else difference(a, b), dtype=float)
            yield change / width, EPSILON * np.maximum(np.abs(a), np.abs(b)) / width

    with np.errstate(all="ignore"):
        columns = [_extrapolate(quotients(i)) for i in range(len(x))]
    return np.stack(columns, axis=1) if columns else np.empty((len(np.atleast_1d(f(x))), 0))


def _extrapolate(quotients: Iterator[tuple[Array, Array]]) -> Array:
    """The limit (k,) of quotients at shrinking steps: even powers of the step are removed one by one."""
    best, smallest = np.array(np.nan), np.array(np.inf)
    above: list[Array] = []
    for quotient, rounding in quotients:
        row = [quotient]
        for order, coarser in enumerate(above[:ORDERS], 1):
            factor = SHRINK ** (2 * order)
            row.append((factor * row[-1] - coarser) / (factor - 1))
            error = np.maximum(np.abs(row[-1] - row[-2]), np.abs(row[-1] - coarser))
            better = error < smallest  # never where the error is NaN
            best, smallest = np.where(better, row[-1], best), np.where(better, error, smallest)
        if np.all(smallest <= rounding):
            break  # a shorter step can only do worse
        above = row
    return np.asarray(np.broadcast_to(best, quotient.shape))


def check_model(model: object, *, controls: ArrayLike | None = None, rng: np.random.Generator | None = None) -> None:
    """Put a motion or sensor model through every law that a filter relies on.

    The model is tried at random points and at nasty ones: turn rates down to 1e-12, a robot at rest, bearings at ±π, a
    landmark straight behind, a millimetre away or a kilometre, headings at ±π, coordinates of 1e5 m.

    Both kinds: outputs are float64 arrays of the right shapes and finite; Jacobians are the derivatives (relative
    1e-6); a heading of θ + 2π is the heading θ; methods are deterministic, leave their arguments alone and give new
    arrays; a pickled and a deep copy give the same numbers; compiled `functions`, where the model offers them, agree
    with the methods and fit into a compiled run.
    Motion: the covariances are symmetric positive semidefinite, and `move` is continuous as a control goes to zero.
    Sensors: R is symmetric positive definite; ``predict(pose, invert(pose, z))`` is z; the residual is z - z_hat but
    for whole turns, and follows a small motion of the robot across the seam at ±π. A landmark within 0.1 m may be
    refused with NaN.

    Parameters
    ----------
    model : MotionModel or SensorModel
        Recognised by its methods.
    controls : array_like (n, m), optional
        Controls that the motion model is made for, in its own units; by default random ones within ±2 whose length m is
        the model's `control_dim`, or 2 if it has none.
    rng : numpy.random.Generator, optional
        Source of the random points; by default the same points at every call.

    Raises
    ------
    ModelError
        The model has not the methods of either protocol (they are named), or it breaks a law. The message lists every
        law that is broken, at how many points, and the first of them: the point, what was expected, what came.
    InputError
        `controls` is not a finite matrix, is empty, or its width is not the model's `control_dim`.

    Examples
    --------
    >>> from slamkit.models import RangeBearing, check_model
    >>> check_model(RangeBearing(sigma_range=0.1, sigma_bearing=0.02))
    """
    rng = np.random.default_rng(0) if rng is None else rng
    with np.errstate(all="ignore"):
        if _kind(model) == "MotionModel":
            u, hint = _controls(model, controls, rng)
            report = _Report(model, "MotionModel", hint)
            _check_motion(report, u, rng)
        else:
            report = _Report(model, "SensorModel")
            _check_sensor(report, rng)
    report.close()


def _has(model: object, name: str) -> bool:
    try:
        return callable(getattr(model, name)) or name == "R"
    except AttributeError:
        return False
    except Exception:  # the attribute is there, and fails: the laws will say how
        return True


def _kind(model: object) -> str:
    """The protocol that the model keeps; a ModelError that names what is missing if it keeps none."""
    name = type(model).__name__
    if isinstance(model, type):
        raise ModelError(f"{model.__name__} is a class, expected an instance: check_model({model.__name__}(…))")
    protocols = {"MotionModel": MOTION_METHODS, "SensorModel": ("R", *SENSOR_METHODS)}
    missing = {p: [n for n in names if not _has(model, n)] for p, names in protocols.items()}
    # `jacobians` belongs to both, so it tells nothing.
    offered = {p: len(set(names) - set(missing[p]) - {"jacobians"}) / len(names) for p, names in protocols.items()}
    if not any(offered.values()):
        needs = "; ".join(f"{p} needs {', '.join(names)}" for p, names in protocols.items())
        raise ModelError(f"{name} is neither a motion nor a sensor model: {needs}")
    kind = max(offered, key=offered.__getitem__)
    if missing[kind]:
        raise ModelError(f"{name} has no {', '.join(missing[kind])}: see slamkit.protocols.{kind}")
    return kind


def _controls(model: object, controls: ArrayLike | None, rng: np.random.Generator) -> tuple[Array, str]:
    """Controls to try (n, m), and a hint for errors that a guessed length may cause."""
    m = getattr(model, "control_dim", None)
    if m is not None and (isinstance(m, bool) or not isinstance(m, int | np.integer) or m < 1):
        raise ModelError(f"{type(model).__name__}.control_dim is {m!r}, expected a whole number ≥ 1")
    if controls is None:
        hint = "" if m is not None else "; u was given length 2: set control_dim or give examples in `controls`"
        return rng.uniform(-2, 2, (12, 2 if m is None else int(m))), hint
    try:
        u = np.array(controls, dtype=float)
    except (TypeError, ValueError) as error:
        raise InputError(f"controls must hold numbers in equal rows: {error}") from None
    if u.ndim != 2 or u.size == 0 or not np.all(np.isfinite(u)):
        raise InputError(f"controls is {u}, expected a finite matrix with one control a row")
    if m is not None and u.shape[1] != m:
        raise InputError(f"controls has shape {u.shape}, {type(model).__name__}.control_dim asks for (n, {m})")
    return u, ""


class _Report:
    """Calls a model's methods, collects every law that they break, and keeps the calls to compare with later."""

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
        """What the method gives, one array or a tuple of them, its form checked; None if it cannot be used."""
        given = _copies(at)
        try:
            method = getattr(self.model, name)
            raw, again = method(*given), method(*_copies(at))
        except Exception as error:
            self.fail(f"{name} raises no error", f"{_short(error)}{self.hint}", at)
            return None
        unchanged = [np.array_equal(g, a) for g, a in zip(given, at.values(), strict=True)]
        self.expect(f"{name} leaves its arguments alone", unchanged, at, tuple(at.values()), given)
        results = _tuple(raw) if len(shapes) > 1 else (raw,)
        got, wanted = " and ".join(map(_form, results)), " and ".join(f"float64 {s}" for s in shapes)
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
        """Whether the results are finite; not being so breaks a law, unless it is NaN from a landmark that is near."""
        finite = all(bool(np.all(np.isfinite(r))) for r in results)
        refused = near and not any(np.any(np.isinf(r)) for r in results)
        self.expect(f"{name} is finite", finite or refused, at, "finite numbers", results)
        return finite

    def together(self, name: str, law: str, at: Point, *apart: Array) -> None:
        """The function that does at one blow what others do apart agrees with them, where there is one."""
        function = getattr(getattr(self.model, "functions", None), name, None)
        if function is None:
            return
        found = [np.full(a.shape, np.nan) for a in apart]
        try:
            function(*_copies(at), np.asarray(getattr(self.model, "params", ()), dtype=float), *found)
        except Exception as error:
            self.fail(f"functions.{name} raises no error", _short(error), at)
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
        """`analytic` is the method's derivative; `scale`, the size of what it adds up, sets its rounding."""

        def f(x: Array) -> ArrayLike:
            return getattr(self.model, method)(*_copies({**at, argument: x}))  # type: ignore[no-any-return]

        try:
            numeric = numeric_jacobian(f, at[argument], step=step, difference=difference)
        except Exception as error:
            self.fail(f"{method} raises no error", f"{_short(error)}{self.hint}, as {argument} varies a little", at)
            return
        size = np.maximum(np.abs(analytic), np.abs(numeric))
        # An entry matters as its row and its column do; rows and columns differ in units.
        relative = np.minimum(size.max(axis=1, keepdims=True), size.max(axis=0, keepdims=True))
        self.expect(law, np.abs(analytic - numeric) <= 1e-6 * relative + 1e-10 * scale, at, numeric, analytic)


def _copies(at: Point) -> tuple[Any, ...]:
    return tuple(copy.copy(a) for a in at.values())


def _tuple(value: Any) -> tuple[Any, ...]:
    return tuple(value) if isinstance(value, tuple | list) else (value,)


def _identical(a: tuple[Any, ...], b: tuple[Any, ...]) -> bool:
    return len(a) == len(b) and all(np.array_equal(x, y, equal_nan=True) for x, y in zip(a, b, strict=True))


def _form(value: Any) -> str:
    return f"{value.dtype} {value.shape}" if isinstance(value, np.ndarray) else f"a {type(value).__name__}"


def _text(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{name} = {_text(v)}" for name, v in value.items())
    if isinstance(value, tuple | list):
        return " and ".join(_text(v) for v in value)
    if isinstance(value, np.ndarray):
        return np.array2string(value, precision=12, separator=", ").replace("\n", "")
    return f"{value:.12g}" if isinstance(value, float) else str(value)


def _short(error: Exception) -> str:
    """An error without the pages that a compiler adds to it."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return f"{type(error).__name__}: {' '.join(lines[:3])[:300]}"


def _covariance(report: _Report, law: str, at: Point, a: Array, *, definite: bool = False) -> None:
    scale = float(np.abs(a).max())
    report.expect(law, np.abs(a - a.T) <= 1e-12 * scale, at, "a symmetric matrix", a)
    smallest = float(np.linalg.eigvalsh((a + a.T) / 2)[0])
    ok = smallest > 0 if definite else smallest >= -1e-12 * scale
    report.expect(law, ok, at, f"smallest eigenvalue {'>' if definite else '≥'} 0", smallest)


def _headings(a: Array, b: Array) -> Array:
    """Poses subtracted, their headings as angles."""
    return np.array([*(a - b)[:2], se2.wrap(a[2] - b[2])])


def _turned(pose: Array) -> Array:
    """The same pose, its heading a whole turn further."""
    return np.array([pose[0], pose[1], pose[2] + 2 * pi])


def _poses(rng: np.random.Generator, n: int) -> Array:
    return np.column_stack([rng.uniform(-10, 10, (n, 2)), rng.uniform(-pi, pi, n)])


def _motions(u: Array, rng: np.random.Generator) -> Iterator[tuple[Array, Array, float]]:
    """Pose, control and duration of every trial."""
    for control in u:
        yield _poses(rng, 1)[0], control, float(rng.uniform(0.02, 1.0))
    for heading in (0.0, pi / 2, -pi, np.nextafter(pi, 0), pi):
        yield np.array([1.0, -2.0, heading]), u[0], 0.1
    yield np.array([1e5, -1e5, 0.7]), u[0], 0.5
    yield _poses(rng, 1)[0], u[0], 1e-6
    yield _poses(rng, 1)[0], np.zeros(u.shape[1]), 0.5
    for i in range(u.shape[1]):
        for small in (0.0, 1e-12, -1e-9, 1e-6, -1e-3):
            yield _poses(rng, 1)[0], np.where(np.arange(u.shape[1]) == i, small, u[i % len(u)]), 0.5


def _check_motion(report: _Report, controls: Array, rng: np.random.Generator) -> None:
    m = controls.shape[1]
    for pose, u, dt in _motions(controls, rng):
        at = {"pose": pose, "u": u, "dt": dt}
        noisy = ("control_noise", m, {"u": u, "dt": dt}), ("pose_noise", 3, at)
        noises = [report.output(name, point, (size, size)) for name, size, point in noisy]
        for (name, _, point), noise in zip(noisy, noises, strict=True):
            if noise is not None and report.finite(name, point, noise):
                _covariance(report, f"{name} is symmetric positive semidefinite", point, noise)
        moved, jacobians = report.output("move", at, (3,)), report.output("jacobians", at, (3, 3), (3, m))
        if all(results is not None for results in (moved, jacobians, *noises)):
            law = "drive is move, jacobians, control_noise and pose_noise"
            report.together("drive", law, at, moved, *jacobians, *noises)
        if moved is None or not report.finite("move", at, moved):
            continue
        scale = 1.0 + float(np.abs(pose).max())
        turned = report.output("move", {**at, "pose": _turned(pose)}, (3,))
        if turned is not None:
            error = np.abs(_headings(turned, moved))
            report.expect("move takes the heading as an angle", error <= 1e-9 * scale, at, moved, turned)
        if jacobians is not None and report.finite("jacobians", at, *jacobians):
            report.jacobian("F is ∂move/∂pose", "move", at, "pose", jacobians[0], scale, 0.1, _headings)
            report.jacobian("G is ∂move/∂u", "move", at, "u", jacobians[1], scale, 0.1, _headings)
    for i in range(m):
        _check_continuity(report, np.where(np.arange(m) == i, 0.0, controls[0]), i, _poses(rng, 1)[0])
    _check_calls(report, MOTION_METHODS)


def _check_continuity(report: _Report, u: Array, i: int, pose: Array) -> None:
    """`move` at a small u[i] follows from `move` and G at zero: a quotient like v/ω loses its digits there."""
    at = {"pose": pose, "u": u, "dt": 0.5}
    still, jacobians = report.output("move", at, (3,)), report.output("jacobians", at, (3, 3), (3, len(u)))
    if still is None or jacobians is None or not np.all(np.isfinite([*still, *np.ravel(jacobians[1])])):
        return
    for small in (1e-13, -1e-12, 1e-11, -1e-10, 1e-9, -1e-8):
        near = {**at, "u": np.where(np.arange(len(u)) == i, small, u)}
        moved = report.output("move", near, (3,))
        if moved is not None:
            expected = still + jacobians[1][:, i] * small
            error = np.abs(_headings(moved, expected))
            report.expect("move is continuous as u goes to zero", error <= 1e-6, near, expected, moved)


def _sightings(rng: np.random.Generator) -> Iterator[tuple[Array, float, float]]:
    """Pose, range and bearing of every trial."""
    for pose in _poses(rng, 12):
        yield pose, float(rng.uniform(0.5, 20.0)), float(rng.uniform(-pi, pi))
    for heading in (0.0, -pi, np.nextafter(pi, 0), pi):
        for bearing in (0.0, pi, -pi, pi - 1e-9, 1e-9 - pi):
            yield np.array([1.0, -2.0, heading]), 3.0, bearing
    for bearing in rng.uniform(-pi, pi, 4):
        yield _poses(rng, 1)[0], 1e-3, float(bearing)
        yield _poses(rng, 1)[0], 1e3, float(bearing)
        yield np.array([1e5, -1e5, bearing / 2]), 3.0, float(bearing)


def _check_sensor(report: _Report, rng: np.random.Generator) -> None:
    k = _check_noise(report)
    if k is None:
        return
    measured = []
    for pose, distance, bearing in _sightings(rng):
        landmark = pose[:2] + distance * np.array([cos(pose[2] + bearing), sin(pose[2] + bearing)])
        z = _check_prediction(report, k, pose, landmark, distance)
        if z is not None:
            measured.append(z)
            _check_inverse(report, k, pose, z, distance)
    for z, z_hat in zip(measured, np.roll(measured, 1, axis=0) if measured else (), strict=True):
        _check_residual(report, k, z, z_hat)
    _check_seam(report, k)
    _check_calls(report, SENSOR_METHODS)


def _check_noise(report: _Report) -> int | None:
    """The length k of a measurement, from R; None if R does not tell."""
    law = "R is a symmetric positive definite float64 matrix"
    try:
        R = report.model.R
    except Exception as error:
        report.fail("R raises no error", _short(error))
        return None
    square = isinstance(R, np.ndarray) and R.ndim == 2 and R.shape[0] == R.shape[1] > 0
    if not square or R.dtype != np.float64:
        report.fail(law, f"expected float64 (k, k), got {_form(R)}")
    elif report.finite("R", {}, R):
        _covariance(report, law, {"R": R}, R, definite=True)
    return int(R.shape[0]) if square else None


def _rounding(pose: Array, distance: float) -> float:
    """A bound on what the rounding of coordinates makes of a measurement, of a bearing above all."""
    return 1e-9 + 1e-13 * (1.0 + float(np.abs(pose).max())) * (1.0 + 1.0 / distance)


def _check_prediction(report: _Report, k: int, pose: Array, landmark: Array, distance: float) -> Array | None:
    """The laws on `predict` and `jacobians` at one sighting; its measurement, unless the sensor has none."""
    at = {"pose": pose, "landmark": landmark}
    z: Array | None = report.output("predict", at, (k,))
    if z is None or not report.finite("predict", at, z, near=distance < NEAR):
        return None
    turned = report.output("predict", {**at, "pose": _turned(pose)}, (k,))
    if turned is not None:
        error = np.abs(_residual(report, turned, z))
        bound = _rounding(pose, distance) * (1 + distance)
        report.expect("predict takes the heading as an angle", error <= bound, at, z, turned)
    jacobians = report.output("jacobians", at, (k, 3), (k, 2))
    if jacobians is not None and report.finite("jacobians", at, *jacobians, near=distance < NEAR):
        scale, reach = 1.0 + float(np.abs(pose).max()), min(0.1 * distance, 1.0)
        law, step = "H_pose is ∂predict/∂pose", [reach, reach, 0.1]
        report.jacobian(law, "predict", at, "pose", jacobians[0], scale, step, partial(_residual, report))
        law = "H_landmark is ∂predict/∂landmark"
        report.jacobian(law, "predict", at, "landmark", jacobians[1], scale, reach, partial(_residual, report))
        other = z + 0.1
        law, apart = "sight is predict, residual and jacobians", (z, _residual(report, other, z), *jacobians)
        report.together("sight", law, {**at, "z": other}, *apart)
    return z


def _check_inverse(report: _Report, k: int, pose: Array, z: Array, distance: float) -> None:
    """The laws on `invert` and `inverse_jacobians` at one measurement of a landmark at the given distance."""
    at, scale = {"pose": pose, "z": z}, 1.0 + float(np.abs(pose).max())
    found = report.output("invert", at, (2,))
    if found is None or not report.finite("invert", at, found, near=distance < NEAR):
        return
    again = report.output("predict", {"pose": pose, "landmark": found}, (k,))
    if again is not None:
        bound = _rounding(pose, distance) * (1 + np.abs(z))
        report.expect("predict undoes invert", np.abs(_residual(report, again, z)) <= bound, at, z, again)
    turned = report.output("invert", {**at, "pose": _turned(pose)}, (2,))
    if turned is not None:
        error = np.abs(turned - found)
        report.expect("invert takes the heading as an angle", error <= 1e-9 * (scale + distance), at, found, turned)
    jacobians = report.output("inverse_jacobians", at, (2, 3), (2, k))
    if jacobians is not None and report.finite("inverse_jacobians", at, *jacobians, near=distance < NEAR):
        report.jacobian("G_pose is ∂invert/∂pose", "invert", at, "pose", jacobians[0], scale, 0.1)
        report.jacobian("G_z is ∂invert/∂z", "invert", at, "z", jacobians[1], scale, min(0.1, 0.1 * distance))


def _residual(report: _Report, z: Array, z_hat: Array) -> Array:
    """The model's residual where another law is judged; NaN, which no bound admits, where it fails."""
    try:
        return np.asarray(report.model.residual(z.copy(), z_hat.copy()), dtype=float)
    except Exception:
        return np.full(z.shape, np.nan)


def _check_residual(report: _Report, k: int, z: Array, z_hat: Array) -> None:
    zero = report.output("residual", {"z": z, "z_hat": z}, (k,))
    at = {"z": z, "z_hat": z_hat}
    r = report.output("residual", at, (k,))
    if zero is None or r is None or not report.finite("residual", at, r):
        return
    report.expect("residual is zero at z = z_hat", zero == 0, {"z": z, "z_hat": z}, np.zeros(k), zero)
    d = z - z_hat
    turns = np.round((d - r) / (2 * pi))
    whole = np.abs(d - r - 2 * pi * turns) <= 1e-9 * (1 + np.abs(d))
    shorter = (turns == 0) | (np.abs(r) <= pi * (1 + 1e-12))
    report.expect("residual is z - z_hat but for whole turns", whole & shorter, at, d, r)
    for i in range(k):
        turn = np.where(np.arange(k) == i, 2 * pi, 0.0)
        if not abs(_residual(report, z_hat + turn, z_hat)[i]) <= 1e-9:
            continue  # not an angle
        for n in (-2, -1, 2, 3):
            at = {"z": z_hat + n * turn, "z_hat": z_hat}
            r = report.output("residual", at, (k,))
            if r is not None:
                report.expect("residual wraps angles", np.abs(r) <= 1e-9, at, np.zeros(k), r)


def _check_seam(report: _Report, k: int) -> None:
    """A robot that turns on the spot by a whole circle sees its measurements change smoothly all the way."""
    landmark, seen = np.array([2.0, 1.5]), []
    for heading in np.linspace(-pi, pi, 181):
        z = report.output("predict", {"pose": np.array([0.3, -0.4, heading]), "landmark": landmark}, (k,))
        if z is None or not np.all(np.isfinite(z)):
            return
        seen.append(z)
    changes = np.array([_residual(report, z, z_hat) for z, z_hat in zip(seen[1:], seen[:-1], strict=True)])
    around = (np.roll(changes, 1, axis=0) + np.roll(changes, -1, axis=0)) / 2
    error = np.abs(changes - around).max(axis=1)
    n = int(np.argmax(error))
    at = {"z": seen[n + 1], "z_hat": seen[n]}
    report.expect("residual wraps angles", error[n] <= 1e-3 * (1 + np.abs(seen).max()), at, around[n], changes[n])


def _check_calls(report: _Report, methods: tuple[str, ...]) -> None:
    """The laws that are judged on the calls made so far."""
    for name, at, results, copies in report.calls:
        if not _identical(results, copies):
            detail = f"expected {_text(copies)} to stay, a later call made it {_text(results)}"
            report.fail(f"{name} gives new arrays", detail, at)
    # Some calls of every method tell as much as all of them.
    calls = [c for n in methods for c in [c for c in report.calls if c[0] == n][:60]]
    for law, duplicate in (("survives pickle", _pickled), ("survives deepcopy", copy.deepcopy)):
        try:
            twin = duplicate(report.model)
            for name, at, _, copies in calls:
                got = _tuple(getattr(twin, name)(*_copies(at)))
                report.expect(law, _identical(got, copies), at, copies, got)
        except Exception as error:
            report.fail(law, _short(error))
    if getattr(report.model, "functions", None) is None:
        return
    functions, params = report.model.functions, getattr(report.model, "params", np.empty(0))
    absent = [n for n in methods if not callable(getattr(functions, n, None))]
    if absent:
        report.fail("functions holds one function a method", f"{type(functions).__name__} has no {', '.join(absent)}")
    elif not (isinstance(params, np.ndarray) and params.dtype == np.float64 and params.ndim == 1):
        report.fail("params is a float64 vector", f"expected float64 (n,), got {_form(params)}")
    else:
        for name, at, _, copies in calls:
            outs = tuple(np.full(c.shape, np.nan) for c in copies)
            try:
                getattr(functions, name)(*_copies(at), params.copy(), *outs)
            except Exception as error:
                report.fail(f"functions.{name} raises no error", _short(error), at)
                continue
            same = [
                np.allclose(o, c, rtol=1e-12, atol=1e-12, equal_nan=True) for o, c in zip(outs, copies, strict=True)
            ]
            report.expect(f"functions.{name} agrees with {name}", same, at, copies, outs)
        try:
            _compile(report, functions, params)
        except Exception as error:
            report.fail("functions fit into a compiled run", _short(error))


def _pickled(model: object) -> object:
    return pickle.loads(pickle.dumps(model))


def _compile(report: _Report, functions: Any, params: Array) -> None:
    """Make the structure that a compiled run takes, with a built-in model for the other half."""
    from slamkit.models.motion import Unicycle
    from slamkit.models.sensors import RelativePosition

    motion, sensor = Unicycle(0.1, 0.1), RelativePosition(0.1)
    moves = report.protocol == "MotionModel"
    f, g = (functions, sensor.functions) if moves else (motion.functions, functions)
    both = (params if moves else motion.params), (sensor.params if moves else params)
    R = np.array(sensor.R if moves else report.model.R, dtype=float)
    _ = models_of(f, g, *both, R, compiled=True).handle
