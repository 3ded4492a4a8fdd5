"""A study in numbers: means over the runs, standard errors and bounds."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from slamkit import evaluate
from slamkit.arrays import Array

if TYPE_CHECKING:
    from slamkit.study.study import Study
    from slamkit.study.trial import Trial

COLUMNS = ("pose", "position", "heading")


def summarise(study: Study, name: str) -> dict[str, Any]:
    """One filter in numbers; see :meth:`slamkit.study.Study.summary`."""
    done = study.finished(name)
    split = with_split(done)
    mapped = [t for t in done if np.isfinite(t.landmark_rmse_m)]
    mse = np.array([t.mean_square_error for t in done]).reshape(-1, 2)
    check = study.gauge.get(name)
    times = [t.seconds_per_step for t in done]
    return {
        **_nees(done),
        **_root_mean("position_rmse_m", mse[:, 0]),
        **_root_mean("heading_rmse_deg", np.degrees(np.degrees(mse[:, 1]))),
        **_mean("landmark_nees", [t.landmark_nees for t in done]),
        **_root_mean("landmark_rmse_m", [t.landmark_rmse_m**2 for t in mapped], [t.landmarks for t in mapped]),
        **_gauge_nees([t for t in split if t.gauge_dof > 0]),
        **_relative_nees(split),
        **_mean("nis_per_dof", [t.nis_mean / t.nis_dof for t in done if t.nis_dof]),
        "nullity": None if check is None else check.nullity,
        "gauge_deviation_drop": None if check is None else check.deviation_drop,
        "stochastic_gauge_m": None if check is None else check.stochastic_gauge_m,
        "equivariance": None if check is None else check.equivariance,
        "seconds_per_step": float(np.median(times)) if times else None,
        "runs": study.runs,
        "finished": len(done),
        "failed": study.runs - len(done),
        "diverged": sum(t.diverged for t in study.trials[name]),
    }


def with_split(trials: Iterable[Trial]) -> list[Trial]:
    """Trials whose final NEES could be split into gauge and relative map."""
    return [t for t in trials if np.isfinite(t.relative_nees) and t.relative_dof > 0]


def bounds_of(
    dof: float, runs: int, scale: float = 1.0, probability: float = 0.95
) -> tuple[float | None, float | None]:
    """Bounds of the mean over the runs of a χ² variable times a scale; None without runs."""
    if not runs:
        return None, None
    bounds = evaluate.chi2_bounds(dof, runs, probability)
    return scale * float(bounds.lower), scale * float(bounds.upper)


def table_rows(study: Study) -> list[dict[str, Any]]:
    """One row a trial; see :meth:`slamkit.study.Study.table`."""
    return [_row(t) for trials in study.trials.values() for t in trials]


def _row(t: Trial) -> dict[str, Any]:
    position, heading = np.sqrt(t.mean_square_error)
    return {
        "filter": t.filter,
        "trial": t.number,
        "error": t.error,
        "diverged": t.diverged,
        "note": t.note,
        **{f"{n}_nees": float(v) for n, v in zip(COLUMNS, t.mean_nees, strict=True)},
        "position_rmse_m": float(position),
        "heading_rmse_deg": float(np.degrees(heading)),
        "landmarks": t.landmarks,
        "landmark_nees": t.landmark_nees,
        "landmark_rmse_m": t.landmark_rmse_m,
        "gauge_nees": t.gauge_nees,
        "gauge_dof": t.gauge_dof,
        "relative_nees_per_dof": t.relative_nees / t.relative_dof if t.relative_dof else float("nan"),
        "nis_per_dof": t.nis_mean / t.nis_dof if t.nis_dof else float("nan"),
        "seconds_per_step": t.seconds_per_step,
    }


def _nees(done: list[Trial]) -> dict[str, Any]:
    nees = np.array([t.mean_nees for t in done]).reshape(-1, 3)
    out: dict[str, Any] = {}
    for column, title in enumerate(COLUMNS):
        out |= _mean(f"{title}_nees", nees[:, column])
    pose = nees[np.isfinite(nees[:, 0]), 0]
    robust = evaluate.summary(pose, 3.0, 6.0) if len(pose) else None
    low, high = bounds_of(3.0, len(pose))
    return out | {
        "pose_nees_median": None if robust is None else robust.median,
        "pose_nees_above_6": None if robust is None else robust.share_above,
        "pose_nees_low": low,
        "pose_nees_high": high,
    }


def _gauge_nees(split: list[Trial]) -> dict[str, Any]:
    nees = np.array([3 * t.gauge_nees / t.gauge_dof for t in split])
    dof = float(np.mean([t.gauge_dof for t in split])) if split else 3.0
    low, high = bounds_of(dof, len(split), 3.0 / dof)
    return {
        **_mean("gauge_nees", nees),
        "gauge_nees_median": float(np.median(nees)) if split else None,
        "gauge_nees_low": low,
        "gauge_nees_high": high,
    }


def _relative_nees(split: list[Trial]) -> dict[str, Any]:
    dof = float(np.mean([t.relative_dof for t in split])) if split else 1.0
    low, high = bounds_of(dof, len(split), 1.0 / dof)
    return {
        **_mean("relative_nees_per_dof", [t.relative_nees / t.relative_dof for t in split]),
        "relative_nees_low": low,
        "relative_nees_high": high,
    }


def _mean(key: str, values: Iterable[float] | Array) -> dict[str, float | None]:
    """Mean over the runs that have a value, and its standard error."""
    v = np.array(list(values), dtype=float)
    v = v[np.isfinite(v)]
    error = float(np.std(v, ddof=1) / np.sqrt(len(v))) if len(v) > 1 else None
    return {key: float(v.mean()) if len(v) else None, f"{key}_se": error}


def _root_mean(
    key: str, squares: Iterable[float] | Array, weights: Iterable[int] | None = None
) -> dict[str, float | None]:
    """Root of the (weighted) mean of mean squares over the runs, and its standard error by the delta method."""
    v = np.array(list(squares), dtype=float)
    w = np.ones(len(v)) if weights is None else np.array(list(weights), dtype=float)
    v, w = v[np.isfinite(v)], w[np.isfinite(v)]
    if not len(v):
        return {key: None, f"{key}_se": None}
    root = float(np.sqrt(np.sum(w * v) / np.sum(w)))
    if len(v) == 1:
        return {key: root, f"{key}_se": None}
    spread = np.sqrt(np.sum((w / w.mean() * (v - root**2)) ** 2) / (len(v) - 1) / len(v))
    return {key: root, f"{key}_se": float(spread / (2 * root)) if root > 0 else 0.0}
