"""The laws of sensor models."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from math import cos, pi, sin

import numpy as np

from slamkit.arrays import Array
from slamkit.models.conformance_report import Report, check_calls, check_covariance, form, random_poses, short, turned
from slamkit.protocols import METHODS, SensorModel

NEAR = 0.1  #: a sensor may return NaN for a landmark within this range [m]
INVERSE = ("invert", "inverse_jacobians")  #: methods that a sensor without an inverse does not have


def _sightings(rng: np.random.Generator) -> Iterator[tuple[Array, float, float]]:
    """Pose, range and bearing of every test point."""
    for pose in random_poses(rng, 12):
        yield pose, float(rng.uniform(0.5, 20.0)), float(rng.uniform(-pi, pi))
    for heading in (0.0, -pi, np.nextafter(pi, 0), pi):
        for bearing in (0.0, pi, -pi, pi - 1e-9, 1e-9 - pi):
            yield np.array([1.0, -2.0, heading]), 3.0, bearing
    for bearing in rng.uniform(-pi, pi, 4):
        yield random_poses(rng, 1)[0], 1e-3, float(bearing)
        yield random_poses(rng, 1)[0], 1e3, float(bearing)
        yield np.array([1e5, -1e5, bearing / 2]), 3.0, float(bearing)


def check_sensor(report: Report, rng: np.random.Generator) -> None:
    """Test the report's sensor model against all laws; those of the inverse only if it has one."""
    invertible = any(hasattr(report.model, name) for name in INVERSE)
    k = _check_noise(report)
    if k is None:
        return
    measured = []
    for pose, distance, bearing in _sightings(rng):
        landmark = pose[:2] + distance * np.array([cos(pose[2] + bearing), sin(pose[2] + bearing)])
        z = _check_prediction(report, k, pose, landmark, distance)
        if z is not None:
            measured.append(z)
            if invertible:
                _check_inverse(report, k, pose, z, distance)
    for z, z_hat in zip(measured, np.roll(measured, 1, axis=0) if measured else (), strict=True):
        _check_residual(report, k, z, z_hat)
    _check_seam(report, k)
    check_calls(report, tuple(n for n in METHODS[SensorModel] if invertible or n not in INVERSE))


def _check_noise(report: Report) -> int | None:
    """The length k of a measurement, from R; None if R has a wrong shape."""
    law = "R is a symmetric positive definite float64 matrix"
    try:
        R = report.model.R
    except Exception as error:
        report.fail("R raises no error", short(error))
        return None
    square = isinstance(R, np.ndarray) and R.ndim == 2 and R.shape[0] == R.shape[1] > 0
    if not square or R.dtype != np.float64:
        report.fail(law, f"expected float64 (k, k), got {form(R)}")
    elif report.finite("R", {}, R):
        check_covariance(report, law, {"R": R}, R, definite=True)
    return int(R.shape[0]) if square else None


def _rounding(pose: Array, distance: float) -> float:
    """A bound on the error that rounded coordinates cause in a measurement. It is largest for a bearing."""
    return 1e-9 + 1e-13 * (1.0 + float(np.abs(pose).max())) * (1.0 + 1.0 / distance)


def _check_prediction(report: Report, k: int, pose: Array, landmark: Array, distance: float) -> Array | None:
    """The laws of `predict` and `jacobians` at one sighting. Returns its measurement, None if there is none."""
    at = {"pose": pose, "landmark": landmark}
    z: Array | None = report.output("predict", at, (k,))
    if z is None or not report.finite("predict", at, z, near=distance < NEAR):
        return None
    again = report.output("predict", {**at, "pose": turned(pose)}, (k,))
    if again is not None:
        error = np.abs(_residual(report, again, z))
        bound = _rounding(pose, distance) * (1 + distance)
        report.expect("predict takes the heading as an angle", error <= bound, at, z, again)
    jacobians = report.output("jacobians", at, (k, 3), (k, 2))
    if jacobians is not None and report.finite("jacobians", at, *jacobians, near=distance < NEAR):
        scale, reach = 1.0 + float(np.abs(pose).max()), min(0.1 * distance, 1.0)
        law, step = "H_pose is ∂predict/∂pose", [reach, reach, 0.1]
        report.jacobian(law, "predict", at, "pose", jacobians[0], scale, step, partial(_residual, report))
        law = "H_landmark is ∂predict/∂landmark"
        report.jacobian(law, "predict", at, "landmark", jacobians[1], scale, reach, partial(_residual, report))
        other = z + 0.1
        law, apart = "linearise is predict, residual and jacobians", (z, _residual(report, other, z), *jacobians)
        report.fused("linearise", law, {**at, "z": other}, *apart)
    return z


def _check_inverse(report: Report, k: int, pose: Array, z: Array, distance: float) -> None:
    """The laws of `invert` and `inverse_jacobians` at one measurement of a landmark at the given distance."""
    at, scale = {"pose": pose, "z": z}, 1.0 + float(np.abs(pose).max())
    found = report.output("invert", at, (2,))
    if found is None or not report.finite("invert", at, found, near=distance < NEAR):
        return
    again = report.output("predict", {"pose": pose, "landmark": found}, (k,))
    if again is not None:
        bound = _rounding(pose, distance) * (1 + np.abs(z))
        report.expect("predict undoes invert", np.abs(_residual(report, again, z)) <= bound, at, z, again)
    again = report.output("invert", {**at, "pose": turned(pose)}, (2,))
    if again is not None:
        error = np.abs(again - found)
        report.expect("invert takes the heading as an angle", error <= 1e-9 * (scale + distance), at, found, again)
    jacobians = report.output("inverse_jacobians", at, (2, 3), (2, k))
    if jacobians is not None and report.finite("inverse_jacobians", at, *jacobians, near=distance < NEAR):
        report.jacobian("G_pose is ∂invert/∂pose", "invert", at, "pose", jacobians[0], scale, 0.1)
        report.jacobian("G_z is ∂invert/∂z", "invert", at, "z", jacobians[1], scale, min(0.1, 0.1 * distance))


def _residual(report: Report, z: Array, z_hat: Array) -> Array:
    """The model's residual, for use in another law; NaN, which exceeds every bound, if it raises an error."""
    try:
        return np.asarray(report.model.residual(z.copy(), z_hat.copy()), dtype=float)
    except Exception:
        return np.full(z.shape, np.nan)


def _check_residual(report: Report, k: int, z: Array, z_hat: Array) -> None:
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
    report.expect("residual is z - z_hat apart from whole turns", whole & shorter, at, d, r)
    for i in range(k):
        turn = np.where(np.arange(k) == i, 2 * pi, 0.0)
        if not abs(_residual(report, z_hat + turn, z_hat)[i]) <= 1e-9:
            continue  # not an angle
        for n in (-2, -1, 2, 3):
            at = {"z": z_hat + n * turn, "z_hat": z_hat}
            r = report.output("residual", at, (k,))
            if r is not None:
                report.expect("residual wraps angles", np.abs(r) <= 1e-9, at, np.zeros(k), r)


def _check_seam(report: Report, k: int) -> None:
    """While a robot turns on the spot by a whole circle, its measurements change smoothly."""
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
