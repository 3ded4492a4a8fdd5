"""The true poses and landmarks of a run."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field

import numpy as np

from slamkit.arrays import Array, finite_array
from slamkit.errors import InputError
from slamkit.logs.display import count


@dataclass(frozen=True, eq=False, repr=False)
class Truth:
    """What is known about the true poses and landmarks.

    Parameters
    ----------
    times : array_like (n,)
        Times [s] at which the pose is known; may be sparse or empty. They are sorted.
    poses : array_like (n, 3)
        True poses [m, m, rad].
    landmarks : mapping id → (2,), optional
        True positions [m].

    Raises
    ------
    InputError
        An array has the wrong shape or holds a value that is not a finite number.
    """

    times: Array
    poses: Array
    landmarks: Mapping[Hashable, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        times = finite_array("truth times", self.times, (-1,))
        empty = np.size(self.poses) == 0
        poses = finite_array("truth poses", np.empty((0, 3)) if empty else self.poses, (-1, -1))
        if poses.shape != (len(times), 3):
            raise InputError(f"truth poses have shape {poses.shape}, {len(times)} times need ({len(times)}, 3)")
        if not isinstance(self.landmarks, Mapping):
            raise InputError(f"truth landmarks are a {type(self.landmarks).__name__}, expected a mapping id → (2,)")
        order = np.lexsort((*poses.T[::-1], times))
        object.__setattr__(self, "times", times[order])
        object.__setattr__(self, "poses", poses[order])
        landmarks = {i: finite_array(f"truth of landmark {i!r}", p, (2,)) for i, p in self.landmarks.items()}
        object.__setattr__(self, "landmarks", landmarks)

    def until(self, time: float) -> Truth:
        """The poses up to the first time after `time` [s], and all landmarks.

        For any moment up to `time`, the nearest poses are the same as in the whole truth.
        """
        after = int(np.searchsorted(self.times, time, side="right"))
        if after < len(self.times):
            after = int(np.searchsorted(self.times, self.times[after], side="right"))
        return Truth(self.times[:after], self.poses[:after], self.landmarks)

    def summary(self) -> str:
        """How much is known, in a few words."""
        return f"{count(len(self.times), 'pose')}, {count(len(self.landmarks), 'landmark')}"

    def __repr__(self) -> str:
        return f"Truth({self.summary()})"
