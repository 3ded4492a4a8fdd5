"""One run in a dozen numbers beside dead reckoning, and the folder of files that holds a run."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slamkit.errors import InputError
from slamkit.evaluate import trajectory
from slamkit.evaluate.trajectory import Evaluation
from slamkit.logs import History, Log, PathLike, replacing
from slamkit.protocols import MotionModel

if TYPE_CHECKING:
    from collections.abc import Iterator

    from matplotlib.figure import Figure

Array = NDArray[np.float64]


class Summary(TypedDict):
    """A run in numbers, as JSON can hold them: None where there is no truth, or nothing to average."""

    filter: str  #: the estimator's command-line name
    steps: int  #: steps of the log's schedule that were run
    observations: int  #: sightings in these steps
    rejected: int  #: of these, refused by the gate
    landmarks: int  #: landmarks in the final map
    ate_m: float | None  #: absolute trajectory error, aligned [m]
    dead_reckoning_ate_m: float | None  #: the same of the motion model alone, with an alignment of its own [m]
    landmark_rmse_m: float | None  #: root mean square error of the landmarks, with the trajectory's alignment [m]
    heading_rmse_deg: float | None  #: likewise of the heading [°]
    nis_mean: float | None  #: mean NIS of the sightings that corrected the belief
    nis_dof_mean: float | None  #: mean degrees of freedom of these: what nis_mean is for a consistent filter
    seconds: float | None  #: wall-clock time of the run [s]


@dataclass(frozen=True, eq=False)
class Assessment:
    """A history beside the truth, and beside dead reckoning over the same steps."""

    history: History
    evaluation: Evaluation  #: of the history
    dead_reckoning: tuple[Array, Array]  #: times (K,) [s] and poses (K, 3) [m, m, rad], in the filter's frame
    dead_reckoning_evaluation: Evaluation

    @property
    def summary(self) -> Summary:
        """The run in numbers."""
        history = self.history
        corrected = history.accepted & np.isfinite(history.nis)
        any_corrected = bool(corrected.any())
        return Summary(
            filter=history.filter,
            steps=len(history.times),
            observations=len(history.nis),
            rejected=history.rejected,
            landmarks=len(history.landmarks),
            ate_m=_finite(self.evaluation.ate_m),
            dead_reckoning_ate_m=_finite(self.dead_reckoning_evaluation.ate_m),
            landmark_rmse_m=_finite(self.evaluation.landmark_rmse_m),
            heading_rmse_deg=_finite(self.evaluation.heading_rmse_deg),
            nis_mean=_finite(history.nis[corrected].mean()) if any_corrected else None,
            nis_dof_mean=float(history.dof) if any_corrected else None,
            seconds=_finite(history.seconds),
        )

    def overview(self, log: Log, title: str | None = None) -> Figure:
        """The figure of :func:`slamkit.plots.overview`, in the frame of the truth where there is one."""
        from slamkit import plots

        return plots.overview(self.history, log, self.dead_reckoning, alignment=self.evaluation.alignment, title=title)


def assess(
    history: History, log: Log, motion: MotionModel, pose: ArrayLike = (0.0, 0.0, 0.0), *, max_gap: float = 0.1
) -> Assessment:
    """Judge a run by the truth of its log, and by where the motion model alone would have led.

    Parameters
    ----------
    history : History
        Of a run over `log`, or over the first of its steps.
    log : Log
    motion : MotionModel
        For dead reckoning: the filter's own.
    pose : array_like (3,)
        Where the filter started [m, m, rad].
    max_gap : float
        Largest difference in time between a pose and its truth [s].

    Returns
    -------
    Assessment
        Trajectory and dead reckoning are each aligned with the truth, see :func:`slamkit.evaluate.trajectory.evaluate`.

    Raises
    ------
    InputError
        The history's times are not those of the log's first steps, or `pose` or `max_gap` does not fit.
    ModelError
        The motion model gave a pose that is not finite.
    """
    times, poses = trajectory.dead_reckoning(log, motion, pose)
    K = len(history.times)
    if not np.array_equal(history.times, times[:K]):
        raise InputError(f"the history's {K} steps are not the first of the log's {len(times)}: it is of another log")
    landmarks = dict(zip(history.landmark_ids, history.landmarks, strict=True))
    return Assessment(
        history=history,
        evaluation=trajectory.evaluate(history.times, history.poses, log.truth, landmarks, max_gap=max_gap),
        dead_reckoning=(times[:K], poses[:K]),
        dead_reckoning_evaluation=trajectory.evaluate(times[:K], poses[:K], log.truth, max_gap=max_gap),
    )


def summarise(
    history: History, log: Log, motion: MotionModel, pose: ArrayLike = (0.0, 0.0, 0.0), *, max_gap: float = 0.1
) -> Summary:
    """A run in numbers: ``assess(...).summary``.

    Parameters and errors are those of :func:`assess`.

    Returns
    -------
    Summary
        A dict that JSON can hold.
    """
    return assess(history, log, motion, pose, max_gap=max_gap).summary


def write_json(path: PathLike, facts: Summary | Mapping[str, Any]) -> None:
    """Write facts as JSON, one a line; a file that is there is replaced once the new one is complete.

    Raises
    ------
    ValueError
        A number is not finite: JSON knows neither NaN nor infinity.
    """
    lines = ",\n".join(f"  {json.dumps(name)}: {json.dumps(value, allow_nan=False)}" for name, value in facts.items())
    with replacing(path) as file:
        file.write(f"{{\n{lines}\n}}\n".encode())


def write_figure(path: PathLike, figure: Figure, dpi: float = 200.0) -> None:
    """Write a figure; a file that is there is replaced once the new one is complete.

    Parameters
    ----------
    path : path
        Ends in .png, .pdf or .svg.
    figure : Figure
    dpi : float
        Dots an inch.

    Raises
    ------
    InputError
        Another ending, or no such folder.
    """
    from slamkit import plots

    with _replaced_by_name(Path(os.path.realpath(path))) as temporary:
        plots.save(figure, temporary, dpi)


def write_run(folder: PathLike, assessment: Assessment, log: Log, title: str | None = None) -> None:
    """Write everything about a run into a folder, which is made where it does not exist.

    Parameters
    ----------
    folder : path
        It gets summary.json, trajectory.txt (TUM form), trajectory.csv and map.csv (with covariances), history.npz
        (:meth:`slamkit.logs.History.load` reads it) and overview.png.
    assessment : Assessment
    log : Log
        The log that was run: for the truth in the figure.
    title : str, optional
        Of the figure.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / "summary.json", assessment.summary)
    assessment.history.write_tum(folder / "trajectory.txt")
    assessment.history.write_csv(folder)
    assessment.history.save(folder / "history.npz")
    write_figure(folder / "overview.png", assessment.overview(log, title))


@contextmanager
def _replaced_by_name(target: Path) -> Iterator[Path]:
    """A path with the same ending, whose file takes the target's place at the end."""
    temporary = target.with_name(f".{target.stem}.{os.urandom(8).hex()}{target.suffix}")
    try:
        yield temporary
        os.replace(temporary, target)
    finally:
        temporary.unlink(missing_ok=True)


def _finite(value: float | None) -> float | None:
    """The number, or None where JSON has none for it."""
    return None if value is None or not np.isfinite(value) else float(value)
