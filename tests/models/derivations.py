"""The models of a robot in symbols, derived by SymPy and evaluated to 60 digits."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import mpmath  # type: ignore[import-untyped]
import numpy as np
import sympy  # type: ignore[import-untyped]
from model_examples import CONTROL_DIM, VICTORIA_PARK

from slamkit.arrays import Array
from slamkit.models import Ackermann, EulerUnicycle, RangeBearing, Unicycle


@cache
def symbolic(model: Any) -> tuple[Callable[..., Any], ...]:
    """Value and Jacobians, derived by SymPy from each model's definition, as functions of 60 digits."""
    x, y, t, a, b, c, dt = symbols = sympy.symbols("x y theta a b c dt", real=True)
    if model in CONTROL_DIM:
        tau = sympy.Symbol("tau", real=True)
        # the integrals of cos θ and sin θ along the arc with the turn rate b
        path = [sympy.integrate(f(t + b * tau), (tau, 0, dt), conds="none") for f in (sympy.cos, sympy.sin)]
        path = [p.args[0][0] if isinstance(p, sympy.Piecewise) else p for p in path]
        if model is Unicycle:
            value = sympy.Matrix([x + a * path[0], y + a * path[1], t + b * dt])
        elif model is Ackermann:
            L, H, ahead, left = (sympy.Rational(str(n)) for n in VICTORIA_PARK)
            speed = a / (1 - sympy.tan(b) * H / L)
            omega = speed * sympy.tan(b) / L
            w_x, w_y = speed - omega * left, omega * ahead
            c_path, s_path = (p.subs(b, omega) for p in path)
            value = sympy.Matrix([x + w_x * c_path - w_y * s_path, y + w_x * s_path + w_y * c_path, t + omega * dt])
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
