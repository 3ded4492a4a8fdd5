"""Accuracy and consistency of estimates.

What concerns the gauge is in :mod:`slamkit.evaluate.gauge`.
"""

from slamkit.evaluate.coverage import Coverage, coverage
from slamkit.evaluate.credibility import inclination, nci
from slamkit.evaluate.dead_reckoning import dead_reckoning
from slamkit.evaluate.nees import (
    ATOL,
    RTOL,
    Bounds,
    NormalizedSquares,
    Summary,
    chi2_bounds,
    heading_nees,
    landmark_nees,
    nees,
    nis,
    pose_nees,
    position_nees,
    state_error,
    state_nees,
    summary,
)
from slamkit.evaluate.run_report import Assessment, RunSummary, assess, summarise, write_figure, write_json, write_run
from slamkit.evaluate.trajectory import (
    MINIMUM_MATCHES,
    Evaluation,
    RelativeError,
    align,
    evaluate,
    nearest,
    relative_error,
)
from slamkit.evaluate.whiteness import Whiteness, whiteness

__all__ = [
    "ATOL",
    "MINIMUM_MATCHES",
    "RTOL",
    "Assessment",
    "Bounds",
    "Coverage",
    "Evaluation",
    "NormalizedSquares",
    "RelativeError",
    "RunSummary",
    "Summary",
    "Whiteness",
    "align",
    "assess",
    "chi2_bounds",
    "coverage",
    "dead_reckoning",
    "evaluate",
    "heading_nees",
    "inclination",
    "landmark_nees",
    "nci",
    "nearest",
    "nees",
    "nis",
    "pose_nees",
    "position_nees",
    "relative_error",
    "state_error",
    "state_nees",
    "summarise",
    "summary",
    "whiteness",
    "write_figure",
    "write_json",
    "write_run",
]
