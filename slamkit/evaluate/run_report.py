"""One run in a dozen numbers beside dead reckoning, and the folder of files that holds a run."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict

import numpy as np
from numpy.typing import ArrayLike

from slamkit.arrays import Array
from slamkit.errors import InputError
from slamkit.evaluate.dead_reckoning import dead_reckoning
from slamkit.evaluate.trajectory import Evaluation, evaluate
from slamkit.logs import History, Log, PathLike, replacing, write_files
from slamkit.protocols import MotionModel

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Assessment", "RunSummary", "assess", "summarise", "write_figure", "write_json", "write_run"]


class RunSummary(TypedDict):
    """A run in numbers that JSON can hold: None where there is no truth, or nothing to average."""

    filter: str  #: the estimator's command-line name
    steps: int  #: steps of the log's schedule that were run
    observations: int  #: sightings in these steps
    rejected: int  #: of these, rejected by the gate
    landmarks: int  #: landmarks in the final map
    ate_m: float | None  #: absolute trajectory error, aligned [m]; None for fewer than three matched poses
    dead_reckoning_ate_m: float | None  #: absolute trajectory error of the motion model alone, aligned by itself [m]
    landmark_rmse_m: float | None  #: root mean square error of the landmarks, see :func:`slamkit.evaluate.evaluate` [m]
    heading_rmse_deg: float | None  #: root mean square error of the heading, with the trajectory's alignment [°]
    matched: int  #: poses with a truth: the evidence behind ate_m and heading_rmse_deg
    nis_mean: float | None  #: mean NIS of the sightings that updated the belief
    nis_dof_mean: float | None  #: mean degrees of freedom of these: the mean NIS of a consistent filter
    seconds: float | None  #: wall-clock time of the run [s]


@dataclass(frozen=True, eq=False)
class Assessment:
    """A history beside the truth, and beside dead reckoning over the same steps."""

    history: History
    evaluation: Evaluation  #: of the history
    dead_reckoning: tuple[Array, Array]  #: times (K,) [s] and poses (K, 3) [m, m, rad], in the filter's frame
    dead_reckoning_evaluation: Evaluation

    @property
    def summary(self) -> RunSummary:
        """The run in numbers."""
        history = self.history
        updated = history.accepted & np.isfinite(history.nis)
        any_updated = bool(updated.any())
        return RunSummary(
            filter=history.filter,
            steps=len(history.times),
            observations=len(history.nis),
            rejected=history.rejected,
            landmarks=len(history.landmarks),
            ate_m=_finite(self.evaluation.ate_m),
            dead_reckoning_ate_m=_finite(self.dead_reckoning_evaluation.ate_m),
            landmark_rmse_m=_finite(self.evaluation.landmark_rmse_m),
            heading_rmse_deg=_finite(self.evaluation.heading_rmse_deg),
            matched=self.evaluation.matched,
            nis_mean=_finite(history.nis[updated].mean()) if any_updated else None,
            nis_dof_mean=float(history.dof) if any_updated else None,
            seconds=_finite(history.seconds),
        )

    def overview(self, log: Log, title: str | None = None) -> Figure:
        """Draw the figure of :func:`slamkit.plots.overview`, in the frame of the truth where there is one."""
        from slamkit import plots

        return plots.overview(self.history, log, self.dead_reckoning, alignment=self.evaluation.alignment, title=title)


def assess(
    history: History, log: Log, motion: MotionModel, pose: ArrayLike = (0.0, 0.0, 0.0), *, max_gap: float = 0.1
) -> Assessment:
    """Compare a run with the truth of its log, and with dead reckoning.

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
        Trajectory and dead reckoning are each aligned with the truth, see :func:`slamkit.evaluate.evaluate`.

    Raises
    ------
    InputError
        The history's times are not those of the log's first steps, or `pose` or `max_gap` does not fit.
    ModelError
        The motion model gave a pose that is not finite.
    """
    times, poses = dead_reckoning(log, motion, pose)
    K = len(history.times)
    if not np.array_equal(history.times, times[:K]):
        raise InputError(f"the history's {K} steps are not the first of the log's {len(times)}: it is of another log")
    landmarks = dict(zip(history.landmark_ids, history.landmarks, strict=True))
    return Assessment(
        history=history,
        evaluation=evaluate(history.times, history.poses, log.truth, landmarks, max_gap=max_gap),
        dead_reckoning=(times[:K], poses[:K]),
        dead_reckoning_evaluation=evaluate(times[:K], poses[:K], log.truth, max_gap=max_gap),
    )


def summarise(
    history: History, log: Log, motion: MotionModel, pose: ArrayLike = (0.0, 0.0, 0.0), *, max_gap: float = 0.1
) -> RunSummary:
    """Give a run in numbers: ``assess(...).summary``.

    Parameters and errors are those of :func:`assess`.

    Returns
    -------
    RunSummary
        A dict that JSON can hold.
    """
    return assess(history, log, motion, pose, max_gap=max_gap).summary


def write_json(path: PathLike, facts: RunSummary | Mapping[str, Any]) -> None:
    """Write facts as JSON, one a line. An existing file is replaced once the new one is complete.

    Raises
    ------
    InputError
        A value is not finite (JSON has neither NaN nor infinity), or is of a type that JSON does not have.
    """
    lines = ",\n".join(f"  {json.dumps(name)}: {_json(name, value)}" for name, value in facts.items())
    with replacing(path) as file:
        file.write(f"{{\n{lines}\n}}\n".encode())


def write_figure(path: PathLike, figure: Figure, dpi: float = 200.0) -> None:
    """Write a figure. An existing file is replaced once the new one is complete.

    Parameters
    ----------
    path : path
        Ends in .png, .pdf or .svg.
    figure : Figure
    dpi : float
        Dots per inch.

    Raises
    ------
    InputError
        Another ending, or no such folder.
    """
    from slamkit import plots

    with _replaced_by_name(Path(os.path.realpath(path))) as temporary:
        plots.save(figure, temporary, dpi)


def write_run(folder: PathLike, assessment: Assessment, log: Log, title: str | None = None) -> None:
    """Write everything about a run into a folder, all files or none. The folder is made if it does not exist.

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
    with tempfile.TemporaryDirectory() as temporary:
        staged = Path(temporary)
        write_json(staged / "summary.json", assessment.summary)
        assessment.history.write_tum(staged / "trajectory.txt")
        assessment.history.write_csv(staged)
        assessment.history.save(staged / "history.npz")
        write_figure(staged / "overview.png", assessment.overview(log, title))
        contents = {file.name: file.read_bytes() for file in staged.iterdir()}
    write_files(folder, contents)


@contextmanager
def _replaced_by_name(target: Path) -> Iterator[Path]:
    """Give a path with the same ending as `target`. At the end its file replaces the target."""
    temporary = target.with_name(f".{target.stem}.{os.urandom(8).hex()}{target.suffix}")
    try:
        yield temporary
        os.replace(temporary, target)
    finally:
        temporary.unlink(missing_ok=True)


def _json(name: str, value: Any) -> str:
    try:
        return json.dumps(value, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} cannot be written as JSON: {error}") from None


def _finite(value: float | None) -> float | None:
    """The number, or None if it is not finite."""
    return None if value is None or not np.isfinite(value) else float(value)
