"""The parts into which a study is cut: what a worker is given and what it returns."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, NamedTuple

from slamkit.study.gauge_check import GaugeCheck, check_gauge, failed_check
from slamkit.study.trial import Trial, failed_trial, run_filters

if TYPE_CHECKING:
    from slamkit.study.settings import Settings


class Task(NamedTuple):
    """All filters over one run, or the gauge check of one filter."""

    run: int  #: number k of the run; -1 for a gauge check
    filter: str = ""  #: the filter of a gauge check


#: The result of a task: one trial for each filter, or a gauge check.
Part = list[Trial] | GaugeCheck


def all_tasks(filters: Iterable[str], gauge_steps: int, runs: int) -> list[Task]:
    """The gauge checks, then the runs."""
    checks = [Task(-1, name) for name in filters] if gauge_steps else []
    return checks + [Task(k) for k in range(runs)]


def alone(settings: Settings, task: Task) -> list[Task]:
    """A task, cut so that each piece runs one filter."""
    return [task] if task.filter else [Task(task.run, name) for name in settings.filters]


def perform(settings: Settings, task: Task) -> Part:
    """Do a task, or a piece of one (see :func:`alone`)."""
    if task.run < 0:
        return check_gauge(settings, task.filter)
    return run_filters(settings, task.run, [task.filter] if task.filter else list(settings.filters))


def failed(settings: Settings, task: Task, why: str) -> Part:
    """The result of a task, or a piece of one, that could not be done."""
    if task.run < 0:
        return failed_check(task.filter, why)
    names = [task.filter] if task.filter else settings.filters
    return [failed_trial(settings, name, task.run, why) for name in names]
