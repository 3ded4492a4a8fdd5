"""One trial: one filter over one run, compared with the truth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from slamkit import evaluate, se2
from slamkit.arrays import Array
from slamkit.errors import DivergenceError, InputError
from slamkit.evaluate import MINIMUM_MATCHES
from slamkit.logs import History, Log, Truth

if TYPE_CHECKING:
    from slamkit.filters.landmark_filter import LandmarkFilter
    from slamkit.study.settings import Settings

IntArray = NDArray[np.int64]

_FULL = np.array([3, 2, 1])  # degrees of freedom of pose, position and heading

#: What a user's filter or model may raise. It belongs to its trial, and the study goes on. SystemExit is included: a
#: filter that calls sys.exit would otherwise end a worker process.
RAISED = (Exception, SystemExit)


@dataclass(frozen=True, eq=False)
class Trial:
    """What one filter did in one run, compared with the truth.

    Numbers are NaN if there is no truth or the filter failed. Errors are estimate minus truth in the truth's frame. In
    a simulation the filter shares that frame, so nothing is aligned. The trajectory of a recorded log is aligned first
    (:func:`slamkit.evaluate.evaluate`). It has no errors if the truth does not determine the alignment.
    """

    filter: str  #: its name in the study
    number: int  #: k of the run
    error: str | None  #: what stopped the filter; None if it finished
    diverged: bool  #: it failed, or its position error exceeded the study's limit
    note: str | None  #: which numbers are left out although the filter finished, and why
    errors: Array = field(repr=False)  #: (K, 3) after each step [m, m, rad]
    sigmas: Array = field(repr=False)  #: (K, 3) claimed standard deviations [m, m, rad]
    nees: Array = field(repr=False)  #: (K, 3) NEES of pose, position, heading
    #: (K, 3) their degrees of freedom: 3, 2, 1, or less if P is singular; 0 where NEES is NaN
    dof: IntArray = field(repr=False)
    landmarks: int  #: landmarks in the final map
    landmark_nees: float  #: mean NEES of one landmark (2 degrees of freedom) at the end
    landmark_rmse_m: float  #: root mean square error of the final map [m]
    gauge_nees: float  #: at the end, see :func:`slamkit.evaluate.gauge.nees_split`
    gauge_dof: int  #: its degrees of freedom
    relative_nees: float  #: at the end, see :func:`slamkit.evaluate.gauge.nees_split`
    relative_dof: int  #: its degrees of freedom
    nis_mean: float  #: mean NIS of the sightings that updated the belief
    nis_dof: int  #: degrees of freedom of one NIS
    seconds: float  #: wall-clock time of the run [s]

    @property
    def seconds_per_step(self) -> float:
        """Wall-clock time of one step [s]."""
        return self.seconds / max(len(self.errors), 1)

    @property
    def mean_nees(self) -> Array:
        """(3,) mean NEES of pose, position and heading over the steps, scaled to 3, 2 and 1 degrees of freedom."""
        dof = self.dof.sum(0)
        total = np.where(self.dof > 0, self.nees, 0.0).sum(0)
        return np.asarray(np.divide(_FULL * total, dof, out=np.full(3, np.nan), where=dof > 0))

    @property
    def mean_square_error(self) -> Array:
        """(2,) mean square error of position [m²] and heading [rad²] over the steps that have a truth."""
        known = self.errors[np.isfinite(self.errors).all(1)]
        if not len(known):
            return np.full(2, np.nan)
        squared = np.mean(known**2, axis=0)
        return np.array([squared[0] + squared[1], squared[2]])


def run_filters(settings: Settings, k: int, names: Sequence[str]) -> list[Trial]:
    """Run these filters over run k. What a filter raises is recorded in its trial."""
    try:
        log = settings.log(k)
    except RAISED as error:
        return [failed_trial(settings, name, k, f"the simulation: {text_of(error)}") for name in names]
    return [_run_filter(settings, log, name, k) for name in names]


def repeat(settings: Settings, k: int, name: str) -> tuple[History, Log]:
    """Run trial k of one filter in this process."""
    limit = None if settings.simulated else 1
    if isinstance(k, bool) or not isinstance(k, int | np.integer) or k < 0 or (limit is not None and k >= limit):
        raise InputError(f"k is {k!r}, expected the number of a run: {'≥ 0' if limit is None else '0'}")
    log = settings.log(int(k))
    return settings.make(name).run(log), log


def failed_trial(settings: Settings, name: str, k: int, why: str) -> Trial:
    """A trial without numbers."""
    nan, K = float("nan"), len(settings.times)
    blank = np.full((K, 3), nan)
    return Trial(
        filter=name, number=k, error=why, diverged=True, note=None, errors=blank, sigmas=blank, nees=blank,
        dof=np.zeros((K, 3), dtype=np.int64), landmarks=0, landmark_nees=nan, landmark_rmse_m=nan, gauge_nees=nan,
        gauge_dof=0, relative_nees=nan, relative_dof=0, nis_mean=nan, nis_dof=0, seconds=nan,
    )  # fmt: skip


def text_of(error: BaseException) -> str:
    """Kind and message of an error."""
    return f"{type(error).__name__}: {error}"


def _run_filter(settings: Settings, log: Log, name: str, k: int) -> Trial:
    try:
        # The first call in a process loads compiled code from a file. That must not count as time of a step.
        settings.make(name).run(log.head(2))
        filter = settings.make(name)
        history = filter.run(log)
        finite = np.isfinite(history.poses).all(1) & np.isfinite(history.pose_covariances).all((1, 2))
        if not finite.all():
            raise DivergenceError(f"pose or covariance not finite at {history.times[np.argmin(finite)]} s")
        return _judge(settings, log, name, k, filter, history)
    except RAISED as error:
        return failed_trial(settings, name, k, text_of(error))


def _judge(settings: Settings, log: Log, name: str, k: int, filter: LandmarkFilter, history: History) -> Trial:
    """Compare a run with the truth of its log."""
    K, truth = len(history.times), log.truth
    poses, covariances = history.poses, history.pose_covariances
    errors, nees, dof = np.full((K, 3), np.nan), np.full((K, 3), np.nan), np.zeros((K, 3), dtype=np.int64)
    limit = np.inf
    notes: list[tuple[str, str]] = []
    numbers: dict[str, Any] = dict(_NO_MAP)
    rows, matched = evaluate.nearest(history.times, () if truth is None else truth.times, settings.max_gap)
    frame = None if truth is None else _frame(settings, history, truth, notes)
    if truth is not None and frame is not None:
        numbers |= _judge_map(history, truth, frame, notes)
        if frame.any():
            poses = se2.compose(frame, poses)
            A = np.eye(3)
            A[:2, :2] = se2.rotation(frame[2])
            covariances = A @ covariances @ A.T
    if truth is not None and frame is not None and len(rows) >= (1 if settings.simulated else MINIMUM_MATCHES):
        true = truth.poses[matched]
        errors[rows] = evaluate.state_error(poses[rows], true)
        kinds = (evaluate.pose_nees, evaluate.position_nees, evaluate.heading_nees)
        for column, kind in enumerate(kinds):
            nees[rows, column], dof[rows, column] = each_step(kind, poses[rows], covariances[rows], true, notes)
        places = np.array([*truth.poses[:, :2], *truth.landmarks.values()]).reshape(-1, 2)
        limit = settings.diverged_at * float(np.hypot(*np.ptp(places, axis=0)))
        if history.landmark_ids and all(i in truth.landmarks for i in history.landmark_ids) and rows[-1] == K - 1:
            numbers |= _split(filter, truth, true[-1], frame, notes)
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    updates = history.nis[history.accepted & np.isfinite(history.nis)]
    far = np.hypot(errors[:, 0], errors[:, 1])
    return Trial(
        filter=name,
        number=k,
        error=None,
        diverged=bool(np.any(far > limit)),
        note=_summed_up(notes, {"landmark": len(history.landmark_ids)}, len(rows)),
        errors=errors,
        sigmas=np.sqrt(np.where(variances >= 0, variances, np.nan)),
        nees=nees,
        dof=dof,
        landmarks=len(history.landmark_ids),
        nis_mean=float(updates.mean()) if len(updates) else float("nan"),
        nis_dof=int(history.dof),
        seconds=float(history.seconds),
        **numbers,
    )


_NO_MAP = {
    "landmark_nees": float("nan"),
    "landmark_rmse_m": float("nan"),
    "gauge_nees": float("nan"),
    "gauge_dof": 0,
    "relative_nees": float("nan"),
    "relative_dof": 0,
}


def _frame(settings: Settings, history: History, truth: Truth, notes: list[tuple[str, str]]) -> Array | None:
    """The motion (3,) that takes the estimate into the frame of the truth; None if the truth does not determine it."""
    if settings.simulated:
        return np.zeros(3)
    landmarks = dict(zip(history.landmark_ids, history.landmarks, strict=True))
    evaluation = evaluate.evaluate(history.times, history.poses, truth, landmarks, max_gap=settings.max_gap)
    if evaluation.aligned_by is not None:
        return evaluation.alignment
    evidence = f"{evaluation.matched} poses and {evaluation.matched_landmarks} landmarks have a truth"
    notes.append(("alignment", f"{evidence}, which does not determine the alignment"))
    return None


def _judge_map(history: History, truth: Truth, frame: Array, notes: list[tuple[str, str]]) -> dict[str, Any]:
    """Error and NEES of the final map's landmarks that have a truth, after moving the map by `frame`."""
    known = [i in truth.landmarks for i in history.landmark_ids]
    if not any(known):
        return {}
    C = se2.rotation(frame[2])
    places = se2.transform(frame, history.landmarks[known])
    P = C @ history.landmark_covariances[known] @ C.T
    there = np.array([truth.landmarks[i] for i in history.landmark_ids if i in truth.landmarks])
    squares, _ = each_step(evaluate.landmark_nees, places, P, there, notes)
    return {
        "landmark_rmse_m": float(np.sqrt(np.mean(np.sum((places - there) ** 2, axis=1)))),
        "landmark_nees": float(squares.mean()),
    }


def _split(
    filter: LandmarkFilter, truth: Truth, true_pose: Array, frame: Array, notes: list[tuple[str, str]]
) -> dict[str, Any]:
    """NEES of the final state, split into gauge and relative map."""
    from slamkit.evaluate import gauge

    back = se2.inverse(frame)
    landmarks = {i: se2.transform(back, p) for i, p in truth.landmarks.items()}
    try:
        split = gauge.nees_split(filter, se2.compose(back, true_pose), landmarks)
    # A user's own filter need not have what the split uses.
    except RAISED as error:
        notes.append(("split", text_of(error)))
        return {}
    return {
        "gauge_nees": split.gauge,
        "gauge_dof": split.gauge_dof,
        "relative_nees": split.relative,
        "relative_dof": split.relative_dof,
    }


def each_step(
    kind: Callable[..., evaluate.NormalizedSquares],
    estimate: Array,
    P: Array,
    truth: Array,
    notes: list[tuple[str, str]],
) -> tuple[Array, IntArray]:
    """Values and degrees of freedom (n,) of a NEES at every step.

    If the error contradicts P or P is indefinite at a step, that step has NaN and 0, and `notes` gets an entry.
    """
    try:
        squares = kind(estimate, P, truth)
        return np.where(squares.dof > 0, squares.values, np.nan), squares.dof
    except DivergenceError as error:
        if len(estimate) == 1:
            notes.append((kind.__name__.removesuffix("_nees"), text_of(error)))
            return np.array([np.nan]), np.array([0])
    # Bisection finds the few bad steps among thousands.
    n = len(estimate) // 2
    halves = [each_step(kind, estimate[h], P[h], truth[h], notes) for h in (slice(0, n), slice(n, None))]
    return np.concatenate([v for v, _ in halves]), np.concatenate([d for _, d in halves])


def _summed_up(notes: Sequence[tuple[str, str]], of: dict[str, int], steps: int) -> str | None:
    """Which numbers are left out, how often, and the first reason for each."""
    said = []
    for what in dict.fromkeys(what for what, _ in notes):
        reasons = [why for w, why in notes if w == what]
        if what == "alignment":
            said.append(f"errors are left out: {reasons[0]}")
        elif what == "split":
            said.append(f"gauge NEES and relative NEES are left out: {reasons[0]}")
        elif what == "landmark":
            said.append(f"landmark NEES is left out, because of {len(reasons)} of {of[what]} landmarks: {reasons[0]}")
        else:
            all_ = " (all)" if len(reasons) == steps else ""
            said.append(f"{what} NEES leaves out {len(reasons)} of {steps} steps{all_}: {reasons[0]}")
    return "; ".join(said) or None
