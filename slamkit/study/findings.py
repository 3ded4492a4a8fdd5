"""What a study's numbers show, in sentences."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from slamkit.study.summary import bounds_of, with_split
from slamkit.study.wording import count, short

if TYPE_CHECKING:
    from slamkit.study.study import Study


def findings(study: Study) -> list[str]:
    """See :meth:`slamkit.study.Study.findings`."""
    if study.all_failed:
        first = study.failures[0]
        return [
            f"Every trial failed ({count(len(study.failures), 'trial')}); "
            f"the first was {first.filter} in run {first.number}: {short(first.error)}"
        ]
    judged = [n for n in study.filters if with_split(study.finished(n))]
    said = _overconfident(study, judged) if judged else []
    if "ekf" in judged:
        said += _standard_ekf(study)
    if not study.simulated and (learnt := learners(study)):
        falls = ", ".join(f"{n} (its claimed deviation falls by up to {d:.0%})" for n, d in learnt.items())
        said.append(f"These filters claim to have learnt the gauge, which no measurement observes: {falls}.")
    return said


def gauge_explains_all(study: Study, name: str) -> bool | None:
    """Whether a learnt gauge explains all of a filter's inconsistency; None if the filter has not learnt its gauge."""
    gauge, limit = nees_per_dof(study, name, "gauge")
    if gauge <= limit or name not in learners(study):
        return None
    relative, limit = nees_per_dof(study, name, "relative")
    return relative <= limit


def learners(study: Study) -> dict[str, float]:
    """Filters whose gauge deviation falls although nothing observes the gauge, and the fall as a share."""
    if study.unobservable is not None and study.unobservable < 3:
        return {}
    drops = {n: c.deviation_drop for n, c in study.gauge.items()}
    return {n: drop for n, drop in drops.items() if drop is not None and drop > 1e-3}


def nees_per_dof(study: Study, name: str, part: str) -> tuple[float, float]:
    """NEES per degree of freedom of one part of the final state, and its upper bound; -inf and inf if there is none."""
    split = with_split(study.finished(name))
    if part == "gauge":
        split = [t for t in split if t.gauge_dof > 0] if study.simulated else []
    if not split:
        return -np.inf, np.inf
    dof = np.array([getattr(t, f"{part}_dof") for t in split], dtype=float)
    value = float(np.mean(np.array([getattr(t, f"{part}_nees") for t in split]) / dof))
    _, limit = bounds_of(dof.mean(), len(split), 1.0 / dof.mean(), 1.0 - 0.05 / len(study.trials))
    assert limit is not None
    return value, limit


def _overconfident(study: Study, judged: list[str]) -> list[str]:
    parts = []
    for part, title in (("gauge", "in the gauge"), ("relative", "in the relative map")):
        excess = {n: nees for n in judged for nees, limit in [nees_per_dof(study, n, part)] if nees > limit}
        if excess:
            ranked = sorted(excess, key=excess.__getitem__, reverse=True)
            parts.append(f"{title} {', '.join(f'{n} {excess[n]:.2f}' for n in ranked)}")
    if parts:
        what = "NEES per degree of freedom; a consistent filter has 1"
        return [f"These filters claim too little uncertainty ({what}): {'; '.join(parts)}."]
    if study.simulated:
        return [f"In {count(study.runs, 'run')}, no filter was found to claim too little uncertainty."]
    return []


def _standard_ekf(study: Study) -> list[str]:
    """Whether the gauge explains the inconsistency of the standard EKF."""
    explained = gauge_explains_all(study, "ekf")
    if explained is None:
        return []
    gauge, relative = nees_per_dof(study, "ekf", "gauge")[0], nees_per_dof(study, "ekf", "relative")[0]
    numbers = f"{gauge:.2f} in the gauge, {relative:.2f} in the relative map"
    if not explained:
        return [f"The ekf claims to have learnt the gauge. It is overconfident about the relative map too ({numbers})."]
    return [
        f"All of the ekf's inconsistency ({numbers}) comes from the gauge: no measurement observes the gauge, yet the "
        f"deviation that the ekf claims for it falls by up to {learners(study)['ekf']:.0%}."
    ]
