"""The unscented filter: derivatives are replaced by regressions over sigma points."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter
from numpy.typing import ArrayLike

from slamkit.arrays import Array, finite_number, real_array
from slamkit.cycle import EstimatorFunctions
from slamkit.errors import InputError
from slamkit.filters.assignment import locked
from slamkit.filters.filterpy_attributes import as_tuple
from slamkit.filters.landmark_filter import LandmarkFilter
from slamkit.filters.regressions import (
    PROBE,
    initialise,
    moments,
    motion,
    own,
    sensor,
    spread,
    whole_columns,
    whole_initialise,
    whole_motion,
    whole_update,
)
from slamkit.protocols import MotionModel, SensorModel


class Fit(NamedTuple):
    """A function's regression over sigma points of n dimensions."""

    centre: Array  #: (r,) its value at the mean
    mean: Array  #: (r,) shift of its mean from there
    half: Array  #: (r, n) its covariance with the whitened state
    error: Array  #: (r, r) covariance that the regression does not explain


_WHOLE = EstimatorFunctions(motion=whole_motion, initialise=whole_initialise, update=whole_update)


class UKFSLAM(LandmarkFilter, UnscentedKalmanFilter):  # type: ignore[misc, override]  # properties here
    """Unscented Kalman filter SLAM, with sigma points over what a function depends on.

    Parameters
    ----------
    motion, sensor, pose, pose_covariance, order, gate, snapshots
        As of :class:`slamkit.EKFSLAM`.
    sigma_points : {"partial", "full"}
        "partial": sigma points over the pose and the one landmark of a sighting, over the pose and the control's
        noise for a prediction; the regression then goes through the sparse update: O(D²) or less. "full": over the
        whole state, O(D³), for reference.
    alpha, beta, kappa : float
        Scaling of van der Merwe's sigma points, which lie α √(n + κ) standard deviations from the mean. The smaller
        α, the closer to the second-order limit, from which a filter differs as α². The mean is a second difference,
        so rounding enters it as 1/α²: the default keeps the estimates within 1e-9 of frame-independent where an α of
        1e-3 leaves 1e-7, and within 1e-3 standard deviations of what the full transform gives with that α.

    Attributes
    ----------
    x, P, y, S, K, z, log_likelihood, likelihood, mahalanobis
        As in filterpy; x and P are read-only copies: assign to change them.
    points_fn, Wm, Wc, sigmas_f
        Sigma points of the whole state, formed when asked for.

    Notes
    -----
    Sigma points are drawn anew before every update; filterpy's own filter does not, and three updates after one
    prediction can make it give a negative variance. The matrix root is taken in robot axes, so the filter does not
    depend on the choice of the world's axes. Angles are subtracted and averaged as angles. The filter is inexact in
    what a regression is inexact in: it adds the error of the linear fit to the noise. Partial sigma points know
    nothing of how the errors of two landmarks' fits go together: with ``order="batch"`` they are taken as independent,
    which the full ones need not do. Like the standard EKF it learns a heading that nothing measures.

    References
    ----------
    Julier & Uhlmann, Proc. IEEE 92(3) (2004); van der Merwe, dissertation (2004);
    Huang, Mourikis & Roumeliotis, IEEE ICRA (2009), for the regression on the part that a measurement depends on.
    """

    name = "ukf"
    own_fields = own
    fixed_attributes = ("sigma_points",)
    functions = EstimatorFunctions(motion=motion, sensor=sensor, initialise=initialise)

    def __init__(
        self,
        motion: MotionModel,
        sensor: SensorModel,
        pose: ArrayLike = (0.0, 0.0, 0.0),
        pose_covariance: ArrayLike | None = None,
        order: str = "sequential",
        *,
        sigma_points: str = "partial",
        alpha: float = 2.5e-2,
        beta: float = 2.0,
        kappa: float = 0.0,
        **options: Any,
    ) -> None:
        if sigma_points not in ("partial", "full"):
            raise InputError(f"sigma_points is {sigma_points!r}, expected 'partial' or 'full'")
        self.compresses = sigma_points == "partial"
        if sigma_points == "full":
            self.functions = _WHOLE  # type: ignore[misc]  # of this filter alone
        super().__init__(motion, sensor, pose, pose_covariance, order, **options)
        self.sigma_points = sigma_points
        self._set_scaling(alpha, beta, kappa)

    def _set_scaling(self, alpha: float, beta: float, kappa: float) -> None:
        values = [finite_number(n, v) for n, v in (("alpha", alpha), ("beta", beta), ("kappa", kappa))]
        if not (0 < values[0] <= 1 and values[2] > -1):
            raise InputError(f"alpha, beta, kappa are {alpha}, {beta}, {kappa}; expected 0 < alpha ≤ 1 and kappa > -1")
        mine = own(self._belief.state)
        mine.alpha, mine.beta, mine.kappa = values

    @property
    def alpha(self) -> float:
        """Spread of the sigma points; it may be assigned to."""
        return own(self._belief.state).alpha  # type: ignore[no-any-return]

    @alpha.setter
    @locked
    def alpha(self, value: float) -> None:
        self._set_scaling(value, self.beta, self.kappa)

    @property
    def beta(self) -> float:
        """Weight of the centre in the covariance; it may be assigned to."""
        return own(self._belief.state).beta  # type: ignore[no-any-return]

    @beta.setter
    @locked
    def beta(self, value: float) -> None:
        self._set_scaling(self.alpha, value, self.kappa)

    @property
    def kappa(self) -> float:
        """Secondary scaling of the sigma points; it may be assigned to."""
        return own(self._belief.state).kappa  # type: ignore[no-any-return]

    @kappa.setter
    @locked
    def kappa(self, value: float) -> None:
        self._set_scaling(self.alpha, self.beta, value)

    @property
    def points_fn(self) -> MerweScaledSigmaPoints:  # type: ignore[override]
        """filterpy's generator of sigma points over the whole state, with the filter's α, β, κ."""
        return MerweScaledSigmaPoints(self.dim_x, self.alpha, self.beta, self.kappa)

    @property
    def Wm(self) -> Array:  # type: ignore[override]  # noqa: N802
        """Weights (2D + 1,) of the mean."""
        return np.asarray(self.points_fn.Wm)

    @property
    def Wc(self) -> Array:  # type: ignore[override]  # noqa: N802
        """Weights (2D + 1,) of the covariance."""
        return np.asarray(self.points_fn.Wc)

    @property
    @locked
    def sigmas_f(self) -> Array:  # type: ignore[override]
        """Sigma points (2D + 1, D) of the current belief, root in robot axes."""
        columns = self._columns() * spread(self._belief.state, self.dim_x)
        return np.vstack([self.x, self.x + columns.T, self.x - columns.T])

    @locked
    def update(  # type: ignore[override]
        self,
        z: ArrayLike | None,
        HJacobian: Any = None,
        Hx: Callable[..., ArrayLike] | None = None,
        R: ArrayLike | float | None = None,
        args: Any = (),
        hx_args: Any = (),
        residual: Callable[[Any, Any], Any] = np.subtract,
        *,
        hx: Callable[..., ArrayLike] | None = None,
        **named: Any,
    ) -> None:
        """Filterpy's own update, for an extra sensor on the full state (a compass, a GPS).

        The call is that of every filter: ``update(z, HJacobian, Hx, R)``. The form of filterpy's unscented filter,
        ``update(z, R, hx=…)``, works as well.

        Parameters
        ----------
        z : array_like (r,) or None
            Measurement; None: nothing happens.
        HJacobian : callable, optional
            Not used, and may be None: a regression of `Hx` over sigma points stands in its place.
        Hx : callable
            ``Hx(x, *hx_args)``: the measurement (r,) that x (D,) would give.
        R : array_like (r, r) or float, optional
            Noise covariance; the sensor model's by default. With `hx` it may be the second argument.
        args : tuple
            Further arguments of `HJacobian`; not used.
        hx_args : tuple
            Further arguments of `Hx`.
        residual : callable
            ``residual(z, z_hat)``, for measurements that do not subtract (angles).
        hx : callable, optional
            filterpy's name for `Hx`: ``hx(x, **named)``.
        **named
            Further arguments of `hx`.

        Raises
        ------
        InputError
            A shape does not fit, or a value is not finite. The belief stays as it was.
        """
        if hx is not None:
            if Hx is not None or named.pop("UT", None) is not None:
                raise InputError("UT is given, but the unscented transform is this filter's own")
            R, further = HJacobian if R is None else R, ()
        else:
            hx, further = Hx, as_tuple(hx_args)
            if named:
                raise InputError(f"update has no argument {next(iter(named))!r} beside Hx; give hx_args=(…)")
        if z is None:
            super().update(None, None, None)  # type: ignore[arg-type]
            return
        if not callable(hx):
            raise InputError("Hx is missing: the function of the state that was measured")

        def at(x: Array) -> Array:
            return np.atleast_1d(real_array("Hx's result", hx(x, *further, **named)))

        H, fit = self._matrix(at, lambda a, b: np.atleast_1d(real_array("the residual", residual(a, b))))
        noise = self._noise(R, len(fit.error)) + fit.error
        super().update(z, lambda x: H, lambda x: at(x) + fit.mean, noise, residual=residual)

    # -- sigma points over the whole state ----------------------------------------------------------------------------

    def _columns(self, floor: float = 0.0) -> Array:
        """Root (D, D) of P, taken in robot axes; a floor makes it invertible, for a regression and nothing else."""
        C = np.empty((self.dim_x, self.dim_x))
        whole_columns(
            np.ascontiguousarray(self._belief.covariance), self._belief.state.belief.mean[2], self.dim_x, floor, C
        )
        return C

    def _matrix(self, f: Callable[[Array], Array], subtract: Callable[[Any, Any], Array]) -> tuple[Array, Fit]:
        """Regression of f over sigma points of the whole state, and its matrix (r, D)."""
        columns, x, state = self._columns(PROBE), self._belief.mean, self._belief.state
        n = len(x)
        # Bad input makes NaN here, which the caller refuses; NumPy need not warn of it as well.
        with np.errstate(invalid="ignore"):
            centre = f(x)
            plus = np.array([subtract(f(x + d), centre) for d in spread(state, n) * columns.T])
            minus = np.array([subtract(f(x - d), centre) for d in spread(state, n) * columns.T])
        r = plus.shape[1]
        fit = Fit(centre, np.empty(r), np.empty((r, n)), np.empty((r, r)))
        moments(state, plus, minus, fit.half, fit.error, fit.mean, r, n, n)
        return np.asarray(np.linalg.solve(columns.T, fit.half.T).T), fit

    def _regression(self, slot: int) -> tuple[Array, Array] | None:
        if self.sigma_points == "partial":
            return None
        models, k = self._models, self.dim_z

        def predict(x: Array) -> Array:
            out = np.empty(k)
            models.predict(x[:3], x[slot : slot + 2], models.sensor_params, out)
            return out

        def residual(z: Array, z_hat: Array) -> Array:
            out = np.empty(k)
            models.residual(z, z_hat, models.sensor_params, out)
            return out

        H, fit = self._matrix(predict, residual)
        return H, models.R + fit.error

    def _facts(self) -> dict[str, Any]:
        return {"sigma_points": self.sigma_points, "alpha": self.alpha, "beta": self.beta, "kappa": self.kappa}

    def _resume(self, facts: dict[str, Any]) -> None:
        self._set_scaling(facts["alpha"], facts["beta"], facts["kappa"])

    @classmethod
    def _options(cls, facts: dict[str, Any]) -> dict[str, Any]:
        return {n: facts[n] for n in ("sigma_points", "alpha", "beta", "kappa")}


class FullUKFSLAM(UKFSLAM):
    """:class:`UKFSLAM` with sigma points over the whole state: the O(D³) reference.

    Parameters, attributes and errors are those of :class:`UKFSLAM`.
    """

    name = "ukf-full"

    def __init__(self, *args: Any, sigma_points: str = "full", **options: Any) -> None:
        super().__init__(*args, sigma_points=sigma_points, **options)
