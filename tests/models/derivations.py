"""The models of a robot in symbols, derived by SymPy and evaluated to 60 digits."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import mpmath  # type: ignore[import-untyped]
import numpy as np
import sympy  # type: ignore[import-untyped]
from model_examples import CONTROL_DIM

from slamkit.arrays import Array
from slamkit.models import EulerUnicycle, RangeBearing, Unicycle


@cache
def symbolic(model: Any) -> tuple[Callable[..., Any], ...]:
    """Value and Jacobians, derived by SymPy from each model's definition, as functions of 60 digits."""
    x, y, t, a, b, c, dt = symbols = sympy.symbols("x y theta a b c dt", real=True)
    if model in CONTROL_DIM:
        if model is Unicycle:  # the integral of the body's velocity along the arc
            tau = sympy.Symbol("tau", real=True)
            path = [sympy.integrate(a * f(t + b * tau), (tau, 0, dt), conds="none") for f in (sympy.cos, sympy.sin)]
            path = [p.args[0][0] if isinstance(p, sympy.Piecewise) else p for p in path]
            value = sympy.Matrix([x + path[0], y + path[1], t + b * dt])
        elif model is EulerUnicycle:
            value = sympy.Matrix([x + a * dt * sympy.cos(t), y + a * dt * sympy.sin(t), t + b * dt])
        else:
            value = sympy.Matrix([x + b * sympy.cos(t + a), y + b * sympy.sin(t + a), t + a + c])
        groups: list[list[Any]] = [[x, y, t], [a, b, c][: CONTROL_DIM[model]]]
        values = [value]
    else:
        C = sympy.Matrix([[sympy.cos(t), -sympy.sin(t)], [sympy.sin(t), sympy.cos(t)]])
        body, p = C.T * sympy.Matrix([a - x, b - y]), sympy.Matrix([x, y])
        if model is RangeBearing:
            value = sympy.Matrix([sympy.sqrt(body.dot(body)), sympy.atan2(body[1], body[0])])
            found = p + C * sympy.Matrix([a * sympy.cos(b), a * sympy.sin(b)])
        else:
            value, found = body, p + C * sympy.Matrix([a, b])
        groups, values = [[x, y, t], [a, b]], [value, found]
    made = [sympy.lambdify(symbols, m, "mpmath") for v in values for m in (v, *(v.jacobian(g) for g in groups))]
    return tuple(made)


def exact(function: Callable[..., Any], *numbers: float) -> Array:
    with mpmath.workdps(60):
        matrix = function(*[mpmath.mpf(float(n)) for n in numbers])
        return np.array([[float(matrix[i, j]) for j in range(matrix.cols)] for i in range(matrix.rows)])


def close(got: Array, expected: Array) -> None:
    """Equal to 1e-12 of the largest number of the array."""
    np.testing.assert_allclose(got, expected.reshape(got.shape), rtol=0, atol=1e-12 * np.abs(expected).max())
