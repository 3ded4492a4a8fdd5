"""The conformance suite for motion and sensor models."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from slamkit.arrays import Array
from slamkit.errors import InputError, ModelError
from slamkit.models.conformance_motion import check_motion
from slamkit.models.conformance_report import Report
from slamkit.models.conformance_sensor import INVERSE, check_sensor
from slamkit.protocols import METHODS, MotionModel, SensorModel


def check_model(model: object, *, controls: ArrayLike | None = None, rng: np.random.Generator | None = None) -> None:
    """Test a motion or sensor model against every law that a filter relies on.

    The model is tested at random points and at difficult ones: turn rates down to 1e-12, a robot at rest, bearings at
    ±π, a landmark straight behind, a millimetre or a kilometre away, headings at ±π, coordinates of 1e5 m.

    Laws of both kinds: outputs are finite float64 arrays of the right shapes; Jacobians are the derivatives (relative
    1e-6); a heading of θ + 2π is the heading θ; methods are deterministic, leave their arguments alone and return new
    arrays; a pickled copy and a deep copy give the same numbers; if the model has compiled `functions`, they agree
    with the methods and fit into a compiled run.
    Laws of motions: the covariances are symmetric positive semidefinite, and `move` is continuous as a control goes
    to zero.
    Laws of sensors: R is symmetric positive definite; ``predict(pose, invert(pose, z))`` is z; the residual is
    z - z_hat apart from whole turns, and follows a small motion of the robot across the seam at ±π. A sensor may
    return NaN for a landmark within 0.1 m. A sensor may have no inverse, that is neither `invert` nor
    `inverse_jacobians`; the laws about the inverse are then skipped.

    Parameters
    ----------
    model : MotionModel or SensorModel
        The methods decide which of the two it is.
    controls : array_like (n, m), optional
        Controls that the motion model is made for, in its own units. By default random ones within ±2; their length m
        is the model's `control_dim`, or 2 if it has none.
    rng : numpy.random.Generator, optional
        Source of the random points. By default every call uses the same points.

    Raises
    ------
    ModelError
        The model lacks methods of its protocol, or breaks a law. The message names the missing methods, or lists
        every broken law with the number of points at which it is broken and, for the first point, the arguments,
        the expected result and the actual one.
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
            report = Report(model, "MotionModel", hint)
            check_motion(report, u, rng)
        else:
            report = Report(model, "SensorModel")
            check_sensor(report, rng)
    report.close()


def _has(model: object, name: str) -> bool:
    try:
        return callable(getattr(model, name)) or name == "R"
    except AttributeError:
        return False
    except Exception:  # the attribute exists but raises: the laws report how
        return True


def _kind(model: object) -> str:
    """The protocol that the model implements; a ModelError that names what is missing if it implements none."""
    name = type(model).__name__
    if isinstance(model, type):
        raise ModelError(f"{model.__name__} is a class, expected an instance: check_model({model.__name__}(…))")
    protocols = {"MotionModel": METHODS[MotionModel], "SensorModel": ("R", *METHODS[SensorModel])}
    missing = {p: [n for n in names if not _has(model, n)] for p, names in protocols.items()}
    if missing["SensorModel"] == list(INVERSE):
        return "SensorModel"  # a sensor without an inverse
    # `jacobians` belongs to both protocols, so it does not count.
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
