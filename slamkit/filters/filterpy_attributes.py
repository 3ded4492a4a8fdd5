"""The attributes and the update of a filter as filterpy's users know them."""

from __future__ import annotations

import sys
from collections.abc import Callable
from math import exp, log, pi, sqrt
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_triangular

from slamkit.arrays import Array, covariance, finite_array, finite_number, real_array
from slamkit.errors import UnsupportedError
from slamkit.filters.assignment import Assignable, locked
from slamkit.se2 import wrap

if TYPE_CHECKING:
    from slamkit.belief import Belief


class FilterpyAttributes(Assignable):
    """x, P, F, Q, R, K, S, y, z and the likelihoods, formed when they are asked for, and `update`."""

    if TYPE_CHECKING:
        _belief: Belief
        base: ClassVar[int]
        sensor: Any
        snapshots: bool

        def _to_standard_coordinates(self) -> None: ...
        def _mean(self) -> Array: ...
        def _covariance(self) -> Array: ...
        def _set_mean(self, x: Array) -> None: ...
        def _set_covariance(self, P: Array) -> None: ...
        def _update_dense(self, H: Array, y: Array, R: Array) -> None: ...

    @property
    @locked
    def x(self) -> Array:
        """State (D,) = (x, y, θ, landmarks in the order of `landmark_ids`); a read-only copy. Assign to change it."""
        return _frozen(self._mean())

    @x.setter
    @locked
    def x(self, value: ArrayLike) -> None:
        x = finite_array("x", value, (self.dim_x,))
        x[2] = wrap(x[2])
        self._to_standard_coordinates()
        self._set_mean(x)

    @property
    @locked
    def P(self) -> Array:  # noqa: N802
        """Covariance (D, D) of x as it is now, read-only. Assign to change it: ``f.P = 10 * f.P``.

        What was read never changes. If you read it after every step of a large map, and let go of it before the next
        step but one, you get a read-only view instead of a copy.
        """
        self._to_standard_coordinates()
        return _frozen(self._covariance())

    @P.setter
    @locked
    def P(self, value: ArrayLike) -> None:  # noqa: N802
        P = covariance("P", value, self.dim_x)
        self._to_standard_coordinates()
        self._set_covariance(P)

    @property
    @locked
    def dim_x(self) -> int:
        """D = 3 + 2N, grows with the map."""
        return self._belief.dim - self.base + 3

    @property
    @locked
    def R(self) -> Array:  # noqa: N802
        """The sensor model's noise covariance (k, k)."""
        return _frozen(np.array(self.sensor.R, dtype=float))

    @property
    @locked
    def F(self) -> Array:  # noqa: N802
        """Transition matrix (D, D) of the last prediction, formed when asked for."""
        F = np.eye(self.dim_x)
        F[:3, :3] = self._belief.state.last.F
        return _frozen(F)

    @property
    @locked
    def Q(self) -> Array:  # noqa: N802
        """Process noise (D, D) of the last prediction, formed when asked for."""
        Q = np.zeros((self.dim_x, self.dim_x))
        Q[:3, :3] = self._belief.state.last.Q
        return _frozen(Q)

    @property
    @locked
    def _I(self) -> Array:  # noqa: N802
        return np.eye(self.dim_x)

    @property
    @locked
    def _rows(self) -> int:
        return int(self._belief.state.last.rows)

    @property
    @locked
    def z(self) -> Array:
        """Measurement (r,) of the last update; of the last sighting, or of the whole scan where order is batch."""
        return _frozen(np.array(self._belief.state.last.z[: self._rows]))

    @property
    @locked
    def y(self) -> Array:
        """Innovation (r,) of the last update."""
        return _frozen(np.array(self._belief.state.last.y[: self._rows]))

    @property
    @locked
    def S(self) -> Array:  # noqa: N802
        """Innovation covariance (r, r) of the last update."""
        return _frozen(np.array(self._belief.state.last.S[: self._rows, : self._rows]))

    @property
    @locked
    def SI(self) -> Array:  # noqa: N802
        """Inverse (r, r) of S."""
        return _frozen(np.asarray(np.linalg.inv(self.S), dtype=float))

    @property
    @locked
    def K(self) -> Array:  # noqa: N802
        """Gain (D, r) of the last update; zero in the rows of landmarks that came after it."""
        s, rows = self._belief.state, self._rows
        w = np.delete(self._belief.gain_rows, slice(3, self.base), axis=1)
        return _frozen(solve_triangular(s.last.L[:rows, :rows], w, lower=True, trans="T").T.copy())

    @property
    @locked
    def log_likelihood(self) -> float:
        """Log-likelihood of the last update's innovation."""
        s, rows = self._belief.state, self._rows
        if rows == 0:
            return log(sys.float_info.min)
        half_log_det = float(np.log(np.diag(s.last.L)[:rows]).sum())
        return -0.5 * rows * log(2 * pi) - half_log_det - 0.5 * float(s.last.t[:rows] @ s.last.t[:rows])

    @property
    @locked
    def likelihood(self) -> float:
        """exp(log_likelihood), at least the smallest positive float."""
        return max(exp(self.log_likelihood), sys.float_info.min)

    @property
    @locked
    def mahalanobis(self) -> float:
        """√(yᵀS⁻¹y) of the last update."""
        t = self._belief.state.last.t[: self._rows]
        return sqrt(float(t @ t))

    @property
    @locked
    def x_prior(self) -> Array:
        """State (D,) after the last prediction; kept only where the filter was made with ``snapshots=True``."""
        return self._snapshot("_prior")[0]

    @property
    @locked
    def P_prior(self) -> Array:  # noqa: N802
        """Covariance (D, D) after the last prediction; needs ``snapshots=True``, which costs O(D²) a step."""
        return self._snapshot("_prior")[1]

    @property
    @locked
    def x_post(self) -> Array:
        """State (D,) after the last update; needs ``snapshots=True``."""
        return self._snapshot("_posterior")[0]

    @property
    @locked
    def P_post(self) -> Array:  # noqa: N802
        """Covariance (D, D) after the last update; needs ``snapshots=True``, which costs O(D²) a step."""
        return self._snapshot("_posterior")[1]

    def _snapshot(self, which: str) -> tuple[Array, Array]:
        if not self.snapshots:
            raise UnsupportedError(
                "priors and posteriors are not kept, their copies cost more than the step; make the filter with "
                "snapshots=True, or read x and P between predict and observe"
            )
        return getattr(self, which, (self.x, self.P))

    @locked
    def update(
        self,
        z: ArrayLike | None,
        HJacobian: Callable[..., ArrayLike],
        Hx: Callable[..., ArrayLike],
        R: ArrayLike | float | None = None,
        args: Any = (),
        hx_args: Any = (),
        residual: Callable[[Any, Any], Any] = np.subtract,
    ) -> None:
        """Filterpy's own update, for an extra sensor on the full state (a compass, a GPS).

        Parameters
        ----------
        z : array_like (r,) or None
            Measurement; None: nothing happens.
        HJacobian : callable
            ``HJacobian(x, *args)``: ∂z/∂x (r, D) at the state x (D,).
        Hx : callable
            ``Hx(x, *hx_args)``: the measurement (r,) that x would give.
        R : array_like (r, r) or float, optional
            Noise covariance; the sensor model's by default.
        args, hx_args : tuple
            Further arguments of the two functions.
        residual : callable
            ``residual(z, z_hat)``, for measurements that do not subtract (angles).

        Raises
        ------
        InputError
            A shape does not fit, or a value is not finite. The belief stays as it was.

        Notes
        -----
        The same numbers as filterpy's dense update, at O(r D²) instead of O(D³).
        """
        if z is None:
            self._belief.state.last.rows = 0
            return
        x, measured = self.x, np.atleast_1d(real_array("z", z))
        r = len(measured)
        measured = finite_array("z", measured, (r,))
        H = real_array("HJacobian's result", HJacobian(x, *as_tuple(args)))
        z_hat = Hx(x, *as_tuple(hx_args))
        H = finite_array("HJacobian's result", np.atleast_2d(H), (r, self.dim_x))
        noise = self._noise(R, r)
        y = finite_array("the residual", np.atleast_1d(real_array("the residual", residual(measured, z_hat))), (r,))
        self._to_standard_coordinates()
        self._update_dense(H, y, noise)
        self._belief.state.last.z[:r] = measured
        if self.snapshots:
            self._posterior = self.x, self.P

    def _noise(self, R: ArrayLike | float | None, r: int) -> Array:
        """R (r, r) of an extra sensor, from a matrix, a variance, or None for the sensor model's."""
        if R is not None and np.ndim(R) == 0:
            R = np.eye(r) * finite_number("R", R, lower=0.0)
        return covariance("R", self.R if R is None else R, r)

    def predict_update(self, *args: Any, **kwargs: Any) -> None:
        """Refused: filterpy's form linearises the measurement at the state before the prediction."""
        raise UnsupportedError(
            "predict_update would linearise at the state before the prediction; call predict(u, dt) and then "
            "update(z, HJacobian, Hx), or step(u, dt, scan)"
        )


def as_tuple(arguments: Any) -> tuple[Any, ...]:
    """Further arguments of a function; a lone one needs no tuple."""
    return arguments if isinstance(arguments, tuple) else (arguments,)


def _frozen(a: Array) -> Array:
    a.flags.writeable = False
    return a
