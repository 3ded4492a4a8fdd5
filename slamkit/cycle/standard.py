"""The standard EKF's linearisation, which most of the family shares in part."""

from __future__ import annotations

from typing import Any

from slamkit.compiled import compiled, rows_of
from slamkit.se2 import wrap_angle


@compiled("void(models, state, vector, vector, real)", generic=True)
def motion_noise(models: Any, state: Any, pose: Any, u: Any, dt: float) -> None:
    """Q ← G Σ_u Gᵀ + pose noise, with G already in the state."""
    models.control_noise(u, dt, models.motion_params, state.scratch.sigma_u)
    models.pose_noise(pose, u, dt, models.motion_params, state.last.Q)
    add_control_noise(state)


@compiled("void(state)")
def add_control_noise(state: Any) -> None:
    """Q ← Q + G Σ_u Gᵀ."""
    G, sigma, Q = state.scratch.G, state.scratch.sigma_u, state.last.Q
    m = G.shape[1]
    if m == 2:
        for i in range(3):
            a = G[i, 0] * sigma[0, 0] + G[i, 1] * sigma[1, 0]
            b = G[i, 0] * sigma[0, 1] + G[i, 1] * sigma[1, 1]
            for j in range(3):
                Q[i, j] += a * G[j, 0] + b * G[j, 1]
        return
    for i in range(3):
        for b in range(m):
            s = 0.0
            for a in range(m):
                s += G[i, a] * sigma[a, b]
            for j in range(3):
                Q[i, j] += s * G[j, b]


@compiled("void(models, state, vector, real)", generic=True)
def motion(models: Any, state: Any, u: Any, dt: float) -> None:
    """Linearise the motion at the current estimate."""
    pose, params = state.belief.mean[:3], models.motion_params
    if models.predicts_all:
        models.predict_all(
            pose, u, dt, params, state.scratch.pose, state.last.F, state.scratch.G, state.scratch.sigma_u, state.last.Q
        )
        add_control_noise(state)
    else:
        models.move(pose, u, dt, params, state.scratch.pose)
        models.motion_jacobians(pose, u, dt, params, state.last.F, state.scratch.G)
        motion_noise(models, state, pose, u, dt)
    state.scratch.pose[2] = wrap_angle(state.scratch.pose[2])


@compiled("void(models, state, vector, vector, index, vector, index)", generic=True)
def sensor(models: Any, state: Any, pose: Any, landmark: Any, slot: int, z: Any, row: int) -> None:
    """Linearise the sensor at the given pose and landmark."""
    k = z.shape[0]
    y, H_pose, H_landmark = (
        rows_of(state.last.y, row, k),
        rows_of(state.scratch.H_pose, row, k),
        rows_of(state.scratch.H_landmark, row, k),
    )
    params, z_hat = models.sensor_params, state.scratch.z_hat
    if models.linearises:
        models.linearise(pose, landmark, z, params, z_hat, y, H_pose, H_landmark)
    else:
        models.predict(pose, landmark, params, z_hat)
        models.residual(z, z_hat, params, y)
        models.sensor_jacobians(pose, landmark, params, H_pose, H_landmark)
    R, noise = models.R, state.scratch.noise
    for i in range(k):
        for j in range(k):
            noise[row + i, j] = R[i, j]


@compiled("void(models, state, index, index, vector)", generic=True)
def initialise(models: Any, state: Any, slot: int, place: int, z: Any) -> None:
    """New landmark l = g(x, z): its mean, G_pose = ∂g/∂x, and the block's own noise G_z R G_zᵀ."""
    G, block = state.scratch.G_z, state.scratch.block
    k = z.shape[0]
    pose = state.belief.mean[:3]
    models.invert(pose, z, models.sensor_params, state.belief.mean[slot : slot + 2])
    models.inverse_jacobians(pose, z, models.sensor_params, state.scratch.G_pose, G)
    block[:, :] = 0.0
    for i in range(2):
        for b in range(k):
            s = 0.0
            for a in range(k):
                s += G[i, a] * models.R[a, b]
            for j in range(2):
                block[i, j] += s * G[j, b]


@compiled("void(models, state, integers, flag)", generic=True)
def prepare_scan(models: Any, state: Any, slots: Any, moved: bool) -> None:
    """Nothing to prepare."""


@compiled("void(state)")
def retract(state: Any) -> None:
    """x ← x + dx, heading wrapped."""
    D = state.belief.active
    mean, dx = state.belief.mean[:D], state.scratch.dx[:D]
    for i in range(D):
        mean[i] += dx[i]
    mean[2] = wrap_angle(mean[2])


@compiled("void(state, vector, matrix)")
def report(state: Any, pose: Any, covariance: Any) -> None:
    """The belief is in standard coordinates already."""
    for i in range(3):
        pose[i] = state.belief.mean[i]
        for j in range(i + 1):
            covariance[i, j] = covariance[j, i] = state.belief.cov[i, j]
