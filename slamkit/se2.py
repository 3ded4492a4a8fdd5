"""The rigid motions of the plane.

A pose is an array (3,): x [m], y [m], heading θ [rad], counter-clockwise, wrapped to [-π, π).
All functions take arrays of shape (..., 3) and broadcast over the leading axes.
"""

from __future__ import annotations

from math import pi

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slamkit.compiled import compiled

Array = NDArray[np.float64]


def wrap(angle: ArrayLike) -> Array:
    """Wrap angles to [-π, π).

    Parameters
    ----------
    angle : array_like, any shape
        Angle [rad].

    Returns
    -------
    ndarray, same shape
        The same angle in [-π, π) [rad].
    """
    a = np.asarray(angle, dtype=float)
    # An angle in range comes back to the bit; only one that is far from it is rounded by a modulo.
    near = np.where(np.abs(a) > 3 * np.pi, np.mod(a + np.pi, 2 * np.pi) - np.pi, a)
    wrapped = np.where(near < -np.pi, near + 2 * np.pi, np.where(near >= np.pi, near - 2 * np.pi, near))
    return np.where(wrapped >= np.pi, -np.pi, wrapped)


@compiled("real(real)")
def wrap_angle(a: float) -> float:
    """The angle of compiled code in [-π, π); one that is there already comes back to the bit."""
    if -pi <= a < pi:
        return a
    if abs(a) > 3.0 * pi:
        a = (a + pi) % (2.0 * pi) - pi
    # What else a sum of two angles may be needs no modulo, which takes ten times as long.
    wrapped = a + 2.0 * pi if a < -pi else a - 2.0 * pi if a >= pi else a
    return -pi if wrapped >= pi else wrapped  # in this order NaN stays NaN


def rotation(angle: ArrayLike) -> Array:
    """Rotation matrix (..., 2, 2) by `angle` [rad]: robot axes to world axes."""
    a = np.asarray(angle, dtype=float)
    c, s = np.cos(a), np.sin(a)
    return np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)


def compose(a: ArrayLike, b: ArrayLike) -> Array:
    """The motion b applied in the frame of a: a ∘ b.

    Parameters
    ----------
    a, b : array_like (..., 3)
        Poses [m, m, rad].

    Returns
    -------
    ndarray (..., 3)
    """
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    p = a[..., :2] + np.squeeze(rotation(a[..., 2]) @ b[..., :2, None], -1)
    return np.concatenate([p, wrap(a[..., 2] + b[..., 2])[..., None]], -1)


def inverse(a: ArrayLike) -> Array:
    """The motion that undoes a: ``compose(a, inverse(a))`` is the identity."""
    a = np.asarray(a, dtype=float)
    p = -np.squeeze(np.swapaxes(rotation(a[..., 2]), -1, -2) @ a[..., :2, None], -1)
    return np.concatenate([p, wrap(-a[..., 2])[..., None]], -1)


def between(a: ArrayLike, b: ArrayLike) -> Array:
    """The motion from a to b, seen from a: ``inverse(a) ∘ b``."""
    return compose(inverse(a), b)


def transform(a: ArrayLike, points: ArrayLike) -> Array:
    """Points (..., 2) given in the frame of the pose a (3,), in the frame in which a is given."""
    a, points = np.asarray(a, dtype=float), np.asarray(points, dtype=float)
    moved: Array = points @ rotation(a[2]).T + a[:2]
    return moved


def _v_matrix(theta: Array) -> Array:
    """V(θ) = [sin θ/θ, -(1-cos θ)/θ; (1-cos θ)/θ, sin θ/θ], smooth through θ = 0."""
    half = np.sinc(theta / (2 * np.pi))
    a = np.sinc(theta / np.pi)
    b = theta / 2 * half**2
    return np.stack([np.stack([a, -b], -1), np.stack([b, a], -1)], -2)


def exp(xi: ArrayLike) -> Array:
    """Exponential map: the pose reached by the constant twist xi = (ξx, ξy, ξθ) in unit time."""
    xi = np.asarray(xi, dtype=float)
    p = np.squeeze(_v_matrix(xi[..., 2]) @ xi[..., :2, None], -1)
    return np.concatenate([p, wrap(xi[..., 2])[..., None]], -1)


def log(a: ArrayLike) -> Array:
    """Logarithm: the twist (ξx, ξy, ξθ) with ``exp(log(a)) == a``; ξθ in [-π, π)."""
    a = np.asarray(a, dtype=float)
    theta = wrap(a[..., 2])
    xi = np.squeeze(np.linalg.solve(_v_matrix(theta), a[..., :2, None]), -1)
    return np.concatenate([xi, theta[..., None]], -1)
