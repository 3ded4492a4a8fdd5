"""Rigid motions of the plane, SE(2).

A pose is an array (3,): x [m], y [m], heading θ [rad], counter-clockwise, wrapped to [-π, π).
Functions of poses take arrays of shape (..., 3) and broadcast over the leading axes, unless they say otherwise.
"""

from __future__ import annotations

from math import pi

import numpy as np
from numpy.typing import ArrayLike

from slamkit.arrays import Array
from slamkit.compiled import compiled


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
    # An angle in range is returned unchanged. Only an angle far out of range is rounded, by the modulo.
    near = np.where(np.abs(a) > 3 * np.pi, np.mod(a + np.pi, 2 * np.pi) - np.pi, a)
    wrapped = np.where(near < -np.pi, near + 2 * np.pi, np.where(near >= np.pi, near - 2 * np.pi, near))
    return np.where(wrapped >= np.pi, -np.pi, wrapped)


@compiled("real(real)")
def wrap_angle(a: float) -> float:
    """Wrap one angle [rad] to [-π, π), for compiled code. An angle in range is returned unchanged."""
    if -pi <= a < pi:
        return a
    if abs(a) > 3.0 * pi:
        a = (a + pi) % (2.0 * pi) - pi
    # A sum of two wrapped angles needs no modulo, which takes ten times as long.
    wrapped = a + 2.0 * pi if a < -pi else a - 2.0 * pi if a >= pi else a
    return -pi if wrapped >= pi else wrapped  # NaN fails every comparison and is returned


def rotation(angle: ArrayLike) -> Array:
    """Rotation matrix from robot axes to world axes.

    Parameters
    ----------
    angle : array_like (...)
        Heading [rad].

    Returns
    -------
    ndarray (..., 2, 2)
    """
    a = np.asarray(angle, dtype=float)
    c, s = np.cos(a), np.sin(a)
    return np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)


def compose(a: ArrayLike, b: ArrayLike) -> Array:
    """Composition a ∘ b: the motion b applied in the frame of a.

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
    """Inverse motion: ``compose(a, inverse(a))`` is the identity.

    Parameters
    ----------
    a : array_like (..., 3)
        Pose [m, m, rad].

    Returns
    -------
    ndarray (..., 3)
    """
    a = np.asarray(a, dtype=float)
    p = -np.squeeze(np.swapaxes(rotation(a[..., 2]), -1, -2) @ a[..., :2, None], -1)
    return np.concatenate([p, wrap(-a[..., 2])[..., None]], -1)


def between(a: ArrayLike, b: ArrayLike) -> Array:
    """Motion from a to b in the frame of a: ``inverse(a) ∘ b``.

    Parameters
    ----------
    a, b : array_like (..., 3)
        Poses [m, m, rad].

    Returns
    -------
    ndarray (..., 3)
    """
    return compose(inverse(a), b)


def transform(a: ArrayLike, points: ArrayLike) -> Array:
    """Transform points from the frame of a pose to the frame in which the pose is given.

    Parameters
    ----------
    a : array_like (3,)
        Pose [m, m, rad]; a single one.
    points : array_like (..., 2)
        Points in the frame of a [m].

    Returns
    -------
    ndarray (..., 2)
        The points in the frame in which a is given [m].
    """
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
    """Exponential map: the pose reached by a constant twist in unit time.

    Parameters
    ----------
    xi : array_like (..., 3)
        Twist (ξx, ξy, ξθ) [m, m, rad].

    Returns
    -------
    ndarray (..., 3)
        Pose [m, m, rad].
    """
    xi = np.asarray(xi, dtype=float)
    p = np.squeeze(_v_matrix(xi[..., 2]) @ xi[..., :2, None], -1)
    return np.concatenate([p, wrap(xi[..., 2])[..., None]], -1)


def log(a: ArrayLike) -> Array:
    """Logarithm: the twist with ``exp(log(a)) == a``.

    Parameters
    ----------
    a : array_like (..., 3)
        Pose [m, m, rad].

    Returns
    -------
    ndarray (..., 3)
        Twist (ξx, ξy, ξθ) [m, m, rad], with ξθ in [-π, π).
    """
    a = np.asarray(a, dtype=float)
    theta = wrap(a[..., 2])
    xi = np.squeeze(np.linalg.solve(_v_matrix(theta), a[..., :2, None]), -1)
    return np.concatenate([xi, theta[..., None]], -1)
