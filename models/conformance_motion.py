"""The laws of motion models."""

from __future__ import annotations

from collections.abc import Iterator
from math import pi

import numpy as np

from slamkit import se2
from slamkit.arrays import Array
from slamkit.models.conformance_report import Report, check_calls, check_covariance, random_poses, turned
from slamkit.protocols import METHODS, MotionModel


def _subtract_poses(a: Array, b: Array) -> Array:
    """a - b for poses, with the difference of the headings wrapped."""
    return np.array([*(a - b)[:2], se2.wrap(a[2] - b[2])])


def _motions(u: Array, rng: np.random.Generator) -> Iterator[tuple[Array, Array, float]]:
    """Pose, control and duration of every test point."""
    for control in u:
        yield random_poses(rng, 1)[0], control, float(rng.uniform(0.02, 1.0))
    for heading in (0.0, pi / 2, -pi, np.nextafter(pi, 0), pi):
        yield np.array([1.0, -2.0, heading]), u[0], 0.1
    yield np.array([1e5, -1e5, 0.7]), u[0], 0.5
    yield random_poses(rng, 1)[0], u[0], 1e-6
    yield random_poses(rng, 1)[0], np.zeros(u.shape[1]), 0.5
    for i in range(u.shape[1]):
        for small in (0.0, 1e-12, -1e-9, 1e-6, -1e-3):
            yield random_poses(rng, 1)[0], np.where(np.arange(u.shape[1]) == i, small, u[i % len(u)]), 0.5


def check_motion(report: Report, controls: Array, rng: np.random.Generator) -> None:
    """Test the report's motion model against all laws."""
    m = controls.shape[1]
    for pose, u, dt in _motions(controls, rng):
        at = {"pose": pose, "u": u, "dt": dt}
        noisy = ("control_noise", m, {"u": u, "dt": dt}), ("pose_noise", 3, at)
        noises = [report.output(name, point, (size, size)) for name, size, point in noisy]
        for (name, _, point), noise in zip(noisy, noises, strict=True):
            if noise is not None and report.finite(name, point, noise):
                check_covariance(report, f"{name} is symmetric positive semidefinite", point, noise)
        moved, jacobians = report.output("move", at, (3,)), report.output("jacobians", at, (3, 3), (3, m))
        if all(results is not None for results in (moved, jacobians, *noises)):
            law = "predict_all is move, jacobians, control_noise and pose_noise"
            report.fused("predict_all", law, at, moved, *jacobians, *noises)
        if moved is None or not report.finite("move", at, moved):
            continue
        scale = 1.0 + float(np.abs(pose).max())
        again = report.output("move", {**at, "pose": turned(pose)}, (3,))
        if again is not None:
            error = np.abs(_subtract_poses(again, moved))
            report.expect("move takes the heading as an angle", error <= 1e-9 * scale, at, moved, again)
        if jacobians is not None and report.finite("jacobians", at, *jacobians):
            report.jacobian("F is ∂move/∂pose", "move", at, "pose", jacobians[0], scale, 0.1, _subtract_poses)
            report.jacobian("G is ∂move/∂u", "move", at, "u", jacobians[1], scale, 0.1, _subtract_poses)
    for i in range(m):
        _check_continuity(report, np.where(np.arange(m) == i, 0.0, controls[0]), i, random_poses(rng, 1)[0])
    check_calls(report, METHODS[MotionModel])


def _check_continuity(report: Report, u: Array, i: int, pose: Array) -> None:
    """`move` at a small u[i] agrees with `move` and G at zero. A quotient like v/ω loses its digits there."""
    at = {"pose": pose, "u": u, "dt": 0.5}
    still, jacobians = report.output("move", at, (3,)), report.output("jacobians", at, (3, 3), (3, len(u)))
    if still is None or jacobians is None or not np.all(np.isfinite([*still, *np.ravel(jacobians[1])])):
        return
    for small in (1e-13, -1e-12, 1e-11, -1e-10, 1e-9, -1e-8):
        near = {**at, "u": np.where(np.arange(len(u)) == i, small, u)}
        moved = report.output("move", near, (3,))
        if moved is not None:
            expected = still + jacobians[1][:, i] * small
            error = np.abs(_subtract_poses(moved, expected))
            report.expect("move is continuous as u goes to zero", error <= 1e-6, near, expected, moved)
