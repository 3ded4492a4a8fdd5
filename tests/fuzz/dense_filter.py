"""The standard EKF as a textbook has it, in NumPy: full matrices, one line a formula. A reference, not a design."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Any

import numpy as np

from slamkit.se2 import wrap


class DenseFilter:
    """EKF-SLAM with known ids, after Thrun, Burgard & Fox, Probabilistic Robotics (2005), section 10.2.

    Attributes
    ----------
    x : ndarray (D,)
        Pose, then each landmark in the order of `ids`.
    P : ndarray (D, D)
    F, Q : ndarray (3, 3)
        Of the last prediction.
    y, S, K : ndarray
        Of the last update; a rejected sighting has a gain of zero.
    """

    def __init__(self, motion: Any, sensor: Any, pose: Any, P: Any, order: str, gate: float | None) -> None:
        self.motion, self.sensor, self.order, self.gate = motion, sensor, order, gate
        self.x, self.P, self.ids = np.array(pose, dtype=float), np.array(P, dtype=float), list[Hashable]()
        self.F, self.Q = np.eye(3), np.zeros((3, 3))
        self.y, self.S, self.K = np.empty(0), np.empty((0, 0)), np.empty((3, 0))

    def predict(self, u: Any, dt: float) -> None:
        pose = self.x[:3].copy()
        self.F, G = self.motion.jacobians(pose, u, dt)
        self.Q = G @ self.motion.control_noise(u, dt) @ G.T + self.motion.pose_noise(pose, u, dt)
        F = np.eye(len(self.x))
        F[:3, :3] = self.F
        self.x[:3] = self.motion.move(pose, u, dt)
        self.P = F @ self.P @ F.T
        self.P[:3, :3] += self.Q

    def scan(self, ids: Sequence[Hashable], z: Any) -> None:
        if self.order == "batch":
            known = [j for j, i in enumerate(ids) if i in self.ids]
            if known:
                self._update([ids[j] for j in known], z[known])
            new = [j for j, i in enumerate(ids) if i not in self.ids]
            for j in new:
                self._augment(ids[j], z[j])
            return
        for i, one in zip(ids, z, strict=True):
            if i in self.ids:
                self._update([i], one[None])
            else:
                self._augment(i, one)

    def remove(self, landmark_id: Hashable) -> None:
        at = self._slot(landmark_id)
        self.x, self.K = np.delete(self.x, [at, at + 1]), np.delete(self.K, [at, at + 1], 0)
        self.P = np.delete(np.delete(self.P, [at, at + 1], 0), [at, at + 1], 1)
        self.ids.remove(landmark_id)

    def _slot(self, landmark_id: Hashable) -> int:
        return 3 + 2 * self.ids.index(landmark_id)

    def _linearised(self, ids: Sequence[Hashable], z: Any) -> tuple[Any, Any, Any]:
        """y (r,), H (r, D) and R (r, r) of sightings of known landmarks."""
        k, pose = len(self.sensor.R), self.x[:3]
        y, H = np.empty(k * len(ids)), np.zeros((k * len(ids), len(self.x)))
        for j, i in enumerate(ids):
            at, rows = self._slot(i), slice(k * j, k * j + k)
            landmark = self.x[at : at + 2]
            y[rows] = self.sensor.residual(z[j], self.sensor.predict(pose, landmark))
            H[rows, :3], H[rows, at : at + 2] = self.sensor.jacobians(pose, landmark)
        return y, H, np.kron(np.eye(len(ids)), self.sensor.R)

    def _update(self, ids: Sequence[Hashable], z: Any) -> None:
        kept = [j for j in range(len(ids)) if self._nis(ids[j], z[j]) <= (np.inf if self.gate is None else self.gate)]
        used = kept or list(range(len(ids)))
        y, H, R = self._linearised([ids[j] for j in used], z[used])
        self.y, self.S = y, H @ self.P @ H.T + R
        self.K = self.P @ H.T @ np.linalg.inv(self.S)
        if not kept:
            self.K = np.zeros_like(self.K)
            return
        self.x = self.x + self.K @ y
        self.x[2] = wrap(self.x[2])
        left = np.eye(len(self.x)) - self.K @ H
        self.P = left @ self.P @ left.T + self.K @ R @ self.K.T

    def _nis(self, landmark_id: Hashable, z: Any) -> float:
        y, H, R = self._linearised([landmark_id], z[None])
        return float(y @ np.linalg.solve(H @ self.P @ H.T + R, y))

    def _augment(self, landmark_id: Hashable, z: Any) -> None:
        pose = self.x[:3]
        G_pose, G_z = self.sensor.inverse_jacobians(pose, z)
        cross = G_pose @ self.P[:3]
        block = G_pose @ self.P[:3, :3] @ G_pose.T + G_z @ self.sensor.R @ G_z.T
        self.x = np.append(self.x, self.sensor.invert(pose, z))
        self.P = np.block([[self.P, cross.T], [cross, block]])
        self.K = np.vstack([self.K, np.zeros((2, self.K.shape[1]))])
        self.ids.append(landmark_id)
