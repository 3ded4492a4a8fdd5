"""What a filter estimated while it ran over a log."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamkit.arrays import Array, Indices
from slamkit.errors import InputError
from slamkit.logs.archive import Field, check_arrays, decode_id, encode_id, read_archive, reading, write_archive
from slamkit.logs.atomic import PathLike, write_files
from slamkit.logs.csv import LANDMARK_COLUMNS, TRUTH_COLUMNS, csv_id
from slamkit.logs.display import count, html_table, span
from slamkit.logs.text_tables import csv_text, text_columns


@dataclass(frozen=True, eq=False, repr=False)
class History:
    """What a filter estimated while it ran over a log.

    Arrays over the K steps hold the belief after the step's observations. Arrays over the M observations follow the
    log's order.
    """

    filter: str  #: name of the estimator
    times: Array  #: (K,) [s]
    poses: Array  #: (K, 3) [m, m, rad]
    pose_covariances: Array  #: (K, 3, 3)
    observation_times: Array  #: (M,) [s], of the step that used them
    observation_ids: Indices  #: (M,) rows of `landmark_ids`; -1 where the id is not in the final map
    innovations: Array  #: (M, k) z - ẑ; NaN where the sighting started a landmark
    nis: Array  #: (M,) yᵀS⁻¹y; NaN where the sighting started a landmark
    accepted: NDArray[np.bool_]  #: (M,) False where the gate rejected the sighting
    landmark_ids: tuple[Hashable, ...]  #: ids in the order of the final map
    landmarks: Array  #: (L, 2) final map [m]
    landmark_covariances: Array  #: (L, 2, 2) [m²]
    seconds: float = float("nan")  #: wall-clock time of the run [s]

    @property
    def dof(self) -> int:
        """Degrees of freedom of one innovation."""
        return int(self.innovations.shape[1])

    @property
    def rejected(self) -> int:
        """Number of sightings that the gate rejected."""
        return int(np.count_nonzero(~self.accepted))

    def __repr__(self) -> str:
        parts = [repr(self.filter), count(len(self.times), "step"), self._sightings(), self._map(), span(self.times)]
        return f"History({', '.join(part for part in parts if part)})"

    def _repr_html_(self) -> str:
        rows = {
            "filter": self.filter,
            "steps": str(len(self.times)),
            "sightings": self._sightings(),
            "map": self._map(),
            "time": span(self.times),
            "run time": f"{self.seconds:.3g} s" if np.isfinite(self.seconds) else "unknown",
        }
        return html_table("History", rows)

    def _sightings(self) -> str:
        return f"{count(len(self.nis), 'sighting')} ({self.rejected} rejected)"

    def _map(self) -> str:
        return count(len(self.landmark_ids), "landmark")

    def save(self, path: PathLike) -> None:
        """Write the history to one file (npz, without pickle); :meth:`load` gives it back exactly.

        Parameters
        ----------
        path : path
            File to write, under exactly this name; a file that is there is replaced once the new one is complete.

        Raises
        ------
        InputError
            A landmark id that a file cannot hold (see :meth:`Log.save`), or arrays that do not fit together.
        """
        facts = {
            "filter": self.filter,
            "landmark_ids": [encode_id(i) for i in self.landmark_ids],
            "seconds": float(self.seconds),
        }
        self._check()
        write_archive(path, "History", facts, {name: getattr(self, name) for name in _ARRAYS})

    @classmethod
    def load(cls, path: PathLike) -> History:
        """Read what :meth:`save` wrote.

        Raises
        ------
        LogFileError
            The file is missing, damaged, or holds something else; the message names it.
        """
        with reading(path, "History"):
            facts, arrays = read_archive(path, "History", _ARRAYS, _FACTS)
            ids = tuple(map(decode_id, facts.pop("landmark_ids")))
            fields: dict[str, Any] = arrays | facts
            history = cls(**fields, landmark_ids=ids)
            history._check()
            return history

    def _check(self) -> None:
        """Check the arrays against each other."""
        L = len(self.landmark_ids)
        check_arrays({name: np.asarray(getattr(self, name)) for name in _ARRAYS}, _ARRAYS, {"L": L})
        if np.any(self.observation_ids >= L):
            raise InputError(f"observation_ids holds {self.observation_ids.max()}, there are {L} landmark_ids")
        for name in ("times", "observation_times"):
            t = getattr(self, name)
            back = np.flatnonzero(np.diff(t) < 0)
            if len(back):
                raise InputError(f"{name} steps back from {t[back[0]]} to {t[back[0] + 1]} s at row {back[0] + 1}")

    def write_tum(self, path: PathLike) -> None:
        """Write the trajectory in the TUM form; see :func:`slamkit.exchange.write_tum`."""
        from slamkit.exchange.tum import write_tum  # here, because exchange is built on logs

        write_tum(path, self.times, self.poses)

    def write_csv(self, folder: PathLike) -> None:
        """Write trajectory.csv and map.csv.

        Parameters
        ----------
        folder : path
            trajectory.csv has a row per step: ``t,x,y,theta,sxx,sxy,sxtheta,syy,sytheta,sthetatheta`` [s, m, m, rad
            and the covariance's entries in their products]; map.csv a row per landmark: ``id,x,y,sxx,sxy,syy``
            [m, m, m²]. Both are replaced together, as for :meth:`Log.write_csv`.

        Raises
        ------
        InputError
            A landmark id that is neither int nor str (see :meth:`Log.write_csv`); nothing is written then.
        """
        P, S = self.pose_covariances, self.landmark_covariances
        of_pose = ("sxx", "sxy", "sxtheta", "syy", "sytheta", "sthetatheta")
        poses = text_columns(self.times, self.poses, P[:, *np.triu_indices(3)])
        ids = [csv_id(i) for i in self.landmark_ids]
        positions = text_columns(self.landmarks, S[:, *np.triu_indices(2)])
        contents = {
            "trajectory.csv": csv_text((*TRUTH_COLUMNS, *of_pose), poses),
            "map.csv": csv_text((*LANDMARK_COLUMNS, "sxx", "sxy", "syy"), [ids, *positions]),
        }
        write_files(Path(folder), contents)


# What a file of a history holds: K steps, M observations of k numbers, L landmarks. A filter that diverged may have
# left estimates that are not finite.
_ARRAYS = {
    "times": Field(np.float64, ("K",)),
    "poses": Field(np.float64, ("K", 3), finite=False),
    "pose_covariances": Field(np.float64, ("K", 3, 3), finite=False),
    "observation_times": Field(np.float64, ("M",)),
    "observation_ids": Field(np.int64, ("M",), lower=-1),
    "innovations": Field(np.float64, ("M", "k"), finite=False),
    "nis": Field(np.float64, ("M",), finite=False),
    "accepted": Field(np.bool_, ("M",)),
    "landmarks": Field(np.float64, ("L", 2), finite=False),
    "landmark_covariances": Field(np.float64, ("L", 2, 2), finite=False),
}
_FACTS: dict[str, type | tuple[type, ...]] = {"filter": str, "landmark_ids": list, "seconds": float}
