"""Normalised squares eᵀP⁻¹e of stacks of vectors, also for covariances that are not of full rank."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slamkit.arrays import Array, Indices, finite_number
from slamkit.errors import DivergenceError, InputError
from slamkit.evaluate.stacks import common_shape, covariance_stack, finite_stack

RTOL = 1e-12  #: an eigenvalue below this share of the largest counts as zero
ATOL = 1e-9  #: a standard deviation below this (in units of the state) counts as zero

# An error outside the eigenspace of a covariance may be this many times the largest standard deviation that the
# thresholds treat as zero.
_OUTSIDE_SIGMAS = 6.0


@dataclass(frozen=True, eq=False)
class NormalizedSquares:
    """Normalised squares eᵀP⁻¹e (NEES or NIS), each with its degrees of freedom."""

    values: Array  #: (...) eᵀP⁻¹e; χ² with `dof` degrees of freedom for a consistent estimator
    dof: Indices  #: (...) rank of P

    @property
    def per_dof(self) -> Array:
        """(...) values / dof: 1 on average for a consistent estimator; NaN where dof is 0."""
        return np.asarray(np.divide(self.values, self.dof, out=np.full_like(self.values, np.nan), where=self.dof > 0))


def normalized_squares(
    name: str, vector: ArrayLike, matrix_name: str, matrix: ArrayLike, rtol: float = RTOL, atol: float = ATOL
) -> NormalizedSquares:
    """Compute eᵀP⁻¹e on the eigenspace of P; see :func:`slamkit.evaluate.nees.nees` for the rule and the errors.

    Parameters
    ----------
    name, matrix_name : str
        What vector and matrix are called in an error message.
    vector : array_like (..., d)
    matrix : array_like (..., d, d)
    rtol, atol : float
        Thresholds of the eigenspace.
    """
    e = finite_stack(name, vector, 1)
    rtol, atol = finite_number("rtol", rtol, lower=0.0), finite_number("atol", atol, lower=0.0)
    if not rtol < 1:
        raise InputError(f"rtol is {rtol}, expected a share of the largest eigenvalue, < 1")
    d = e.shape[-1]
    P = covariance_stack(matrix_name, matrix, d)
    shape = common_shape(name, e.shape[:-1], matrix_name, P.shape[:-2])
    P = np.broadcast_to(P / 2 + P.mT / 2, (*shape, d, d)).reshape(-1, d, d)
    e = np.broadcast_to(e, (*shape, d)).reshape(-1, d)
    values, proven = _full_rank_squares(e, P, rtol, atol)
    rank = np.full(len(e), d)
    rest = np.flatnonzero(~proven)
    if len(rest):
        values[rest], rank[rest] = _eigenspace_squares(e[rest], P[rest], rtol, atol, rest, shape)
    return NormalizedSquares(values.reshape(shape), rank.reshape(shape))


def _full_rank_squares(e: Array, P: Array, rtol: float, atol: float) -> tuple[Array, NDArray[np.bool_]]:
    """EᵀP⁻¹e by Cholesky, and where that proves P to be of full rank under the eigenspace rule."""
    L = np.zeros_like(P)
    # LAPACK's factorisation stops the whole stack at its first singular matrix. This one leaves NaN there.
    with np.errstate(all="ignore"):
        for j in range(P.shape[-1]):
            column = P[:, j:, j] - (L[:, j:, :j] @ L[:, j, :j, None])[..., 0]
            L[:, j:, j] = column / np.sqrt(column[:, :1])
        rows = np.flatnonzero(np.all(np.isfinite(L), axis=(1, 2)))
        root = np.linalg.inv(L[rows])
        # λ_min ≥ 1/‖L⁻¹‖²_F and λ_max ≤ tr P: a matrix that passes here also passes with its eigenvalues.
        smallest = 1 / np.sum(root**2, axis=(1, 2))
        enough = smallest > np.maximum(rtol * np.trace(P[rows], axis1=1, axis2=2), atol**2)
    values, proven = np.zeros(len(P)), np.zeros(len(P), dtype=np.bool_)
    values[rows] = np.sum((root @ e[rows, :, None])[..., 0] ** 2, axis=1)
    proven[rows] = enough
    return values, proven


def _eigenspace_squares(
    e: Array, P: Array, rtol: float, atol: float, rows: Indices, shape: tuple[int, ...]
) -> tuple[Array, Indices]:
    """EᵀP⁺e on the eigenspace above the threshold, and its rank; `rows` and `shape` name the matrix in an error."""
    lam, V = np.linalg.eigh(P)
    floor = np.maximum(rtol * lam[:, -1], atol**2)
    for i in np.flatnonzero(lam[:, 0] < -floor)[:1]:
        raise DivergenceError(
            f"the covariance{_where(rows[i], shape)} is not positive semi-definite: "
            f"its eigenvalues run from {lam[i, 0]:.3g} to {lam[i, -1]:.3g}"
        )
    kept = lam > floor[:, None]
    rank = kept.sum(axis=1)
    along = (V.mT @ e[..., None])[..., 0]
    outside = np.sqrt(np.sum(np.where(kept, 0.0, along) ** 2, axis=1))
    allowed = _OUTSIDE_SIGMAS * np.sqrt(floor * (e.shape[-1] - rank))
    for i in np.flatnonzero(outside > allowed)[:1]:
        raise DivergenceError(
            f"the error{_where(rows[i], shape)} leaves the eigenspace of its covariance (rank {rank[i]} of "
            f"{e.shape[-1]}) by {outside[i]:.3g}, rounding explains at most {allowed[i]:.3g}: "
            "the filter claims to know exactly what it has wrong"
        )
    return np.sum(np.where(kept, along**2 / np.where(kept, lam, 1.0), 0.0), axis=1), rank


def _where(row: int, shape: tuple[int, ...]) -> str:
    return f" at {tuple(map(int, np.unravel_index(row, shape)))}" if shape else ""
