"""Geometry of a state s = (p, θ, l₁ … l_N), D = 3 + 2N, that moves as one rigid body; J = [0 -1; 1 0]."""

from __future__ import annotations

import numpy as np
from scipy.linalg import block_diag

from slamkit import se2
from slamkit.arrays import Array

J = np.array([[0.0, -1.0], [1.0, 0.0]])


def turned(points: Array) -> Array:
    """Multiply every position of a state (D,) by J; the heading becomes 0."""
    out = np.zeros_like(points)
    out[0], out[1] = -points[1], points[0]
    out[3::2], out[4::2] = -points[4::2], points[3::2]
    return out


def seen_by_robot(x: Array) -> Array:
    """Give the landmarks of a state (D,) in the robot's frame, R(θ)ᵀ(l - p): (N, 2) [m]."""
    seen: Array = (x[3:].reshape(-1, 2) - x[:2]) @ se2.rotation(x[2])
    return seen


def rotations(angle: float, N: int) -> Array:
    """Give diag(R, 1, R …) (D, D): how a rotation of the frame acts on errors of a state with N landmarks."""
    R = se2.rotation(angle)
    return np.asarray(block_diag(R, 1.0, np.kron(np.eye(N), R)))
