"""GTSAM's iSAM2, a smoother: it keeps every pose, and its steps become slower with their number.

The extra `bench` installs GTSAM 4.3.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
from _workload import SIGMA_BEARING, SIGMA_RANGE, START, Array, IntArray, Work
from scipy.linalg.lapack import dpotrf, dpotri

from contenders import MissingError
from contenders.dense import move

#: [m]; noise added to each motion, because the noise of speed and turn rate has rank 2 and that of a factor must have
#: full rank. With half of it the Cholesky factorisation of GTSAM fails on 10,000 landmarks.
LEAST = 1e-3


class Smoother:
    """iSAM2 with default parameters. The newest pose is read after each step.

    It starts from the same prior and maps the survey itself. Its result differs from a filter's for three reasons: it
    relinearises the past, it ignores corrections below a millimetre, and it has the noise `LEAST`. The difference goes
    to zero with less noise and smaller thresholds (tests/test_contenders.py).
    """

    tolerance: ClassVar[float] = 1.0  # the largest difference seen is 0.9, at 10,000 landmarks, and 0.2 on smaller maps
    defers: ClassVar[bool] = False
    grows: ClassVar[bool] = True

    def __init__(self, work: Work) -> None:
        try:
            import gtsam  # type: ignore[import-not-found, unused-ignore]
        except ImportError as error:
            raise MissingError(f"no GTSAM 4.3 (pip install 'gtsam>=4.3,<4.4'): {error}") from None
        self.gtsam, self.work = gtsam, work
        self.sight_noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([SIGMA_BEARING, SIGMA_RANGE]))

    def start(self) -> None:
        """Smooth the survey."""
        gtsam = self.gtsam
        self.isam = gtsam.ISAM2(gtsam.ISAM2Params())
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        first = gtsam.Pose2(*self.work.pose)
        graph.add(gtsam.PriorFactorPose2(self._pose_key(0), first, gtsam.noiseModel.Diagonal.Sigmas(START)))
        values.insert(self._pose_key(0), first)
        self.isam.update(graph, values)
        self.pose, self.last = first, 0
        self.ready(0, self.work.survey)()

    def ready(self, begin: int, end: int) -> Callable[[], object]:
        """The factors of each step."""
        steps = [self._factors(k) for k in range(begin, end)]

        def go() -> None:
            for graph, moved, new in steps:
                self._step(graph, moved, new)

        return go

    def _step(self, graph: Any, moved: Any, new: list[tuple[int, float, float]]) -> None:
        gtsam, key = self.gtsam, self._pose_key(self.last + 1)
        guess, values = self.pose.compose(moved), gtsam.Values()
        values.insert(key, guess)
        for landmark, distance, bearing in new:
            place = guess.transformFrom(distance * np.array([np.cos(bearing), np.sin(bearing)]))
            values.insert(self._landmark_key(landmark), place)
        self.isam.update(graph, values)
        self.pose, self.last = self.isam.calculateEstimatePose2(key), self.last + 1

    def _factors(self, k: int) -> tuple[Any, Any, list[tuple[int, float, float]]]:
        """Factors of step k, its motion, and the sightings of landmarks that are new in it."""
        gtsam, work = self.gtsam, self.work
        moved, _, noise = move(np.zeros(3), work.controls[k], float(work.dt[k]))
        c, s = np.cos(moved[2]), np.sin(moved[2])
        turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])  # GTSAM's noise is in the frame of the end
        graph = gtsam.NonlinearFactorGraph()
        noise = turn @ noise @ turn.T + LEAST**2 * np.diag([1.0, 1.0, 0.0])
        # Unless told not to, GTSAM takes a matrix for diagonal whose other entries are below 1e-9: these may be.
        model = gtsam.noiseModel.Gaussian.Covariance(noise, False)
        step = gtsam.Pose2(*moved)
        graph.add(gtsam.BetweenFactorPose2(self._pose_key(k), self._pose_key(k + 1), step, model))
        seen = range(work.first[k], work.first[k + 1])
        sightings = [(int(work.ids[m]), float(work.z[m, 0]), float(work.z[m, 1])) for m in seen]
        for landmark, distance, bearing in sightings:
            keys = self._pose_key(k + 1), self._landmark_key(landmark)
            graph.add(gtsam.BearingRangeFactor2D(*keys, gtsam.Rot2(bearing), distance, self.sight_noise))
        return graph, step, sightings if k < work.survey else []

    def joint(self, at: IntArray) -> tuple[Array, Array]:
        """State and a block of the joint covariance of the newest pose and the map."""
        estimate = self.isam.calculateEstimate()
        pose = estimate.atPose2(self._pose_key(self.last))
        places = [estimate.atPoint2(self._landmark_key(i)) for i in range(self.work.landmarks)]
        chosen = np.unique((at[at >= 3] - 3) // 2)
        P = self.covariance(chosen.tolist())
        turn = np.eye(len(P))
        turn[:2, :2] = pose.rotation().matrix()  # GTSAM expresses pose errors in the frame of the robot
        slots = (at[at >= 3] - 3) // 2
        rows = np.concatenate([at[at < 3], 3 + 2 * np.searchsorted(chosen, slots) + (at[at >= 3] - 3) % 2])
        x = np.concatenate([[pose.x(), pose.y(), pose.theta()], *places])
        return x, (turn @ P @ turn.T)[np.ix_(rows, rows)]

    def covariance(self, landmarks: list[int]) -> Array:
        """Joint covariance of the newest pose and some landmarks, in this order."""
        keys = [self._pose_key(self.last), *(self._landmark_key(i) for i in landmarks)]
        P: Array = self.isam.jointMarginalCovariance(keys).fullMatrix()
        return P

    def _pose_key(self, k: int) -> int:
        key: int = self.gtsam.symbol("x", k)
        return key

    def _landmark_key(self, landmark: int) -> int:
        key: int = self.gtsam.symbol("l", landmark)
        return key


class Joint(Smoother):
    """iSAM2, with the joint covariance of pose and map computed after each step. A filter has it at no cost."""

    def ready(self, begin: int, end: int) -> Callable[[], object]:
        """The factors of each step."""
        steps, everything = [self._factors(k) for k in range(begin, end)], list(range(self.work.landmarks))

        def go() -> None:
            for graph, moved, new in steps:
                self._step(graph, moved, new)
                if self.last > self.work.survey:
                    self.covariance(everything)

        return go

    def covariance(self, landmarks: list[int]) -> Array:
        """Joint covariance of the newest pose and some landmarks, in this order.

        It is computed from the information of all variables in one dense factorisation. GTSAM's own function eliminates
        one variable at a time, which takes 2 to 10 times as long for few poses and the whole map.
        """
        wanted = {self._pose_key(self.last), *(self._landmark_key(i) for i in landmarks)}
        ordering, point = self.gtsam.Ordering(), self.isam.getLinearizationPoint()
        for key in point.keys():  # noqa: SIM118  (not a mapping)
            if key not in wanted:
                ordering.push_back(key)
        ordering.push_back(self._pose_key(self.last))
        for i in landmarks:
            ordering.push_back(self._landmark_key(i))
        information, _ = self.isam.getFactorsUnsafe().linearize(point).hessian(ordering)
        size = 3 + 2 * len(landmarks)
        factor, failed = dpotrf(information, lower=1)
        if failed:
            raise RuntimeError("the information is not positive definite")
        inverse, _ = dpotri(factor[-size:, -size:], lower=1)
        P: Array = np.tril(inverse) + np.tril(inverse, -1).T
        return P
