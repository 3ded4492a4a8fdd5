"""Run one filter over one log, with a progress bar, and keep what was done if the run fails."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from numpy.typing import ArrayLike
from rich.progress import BarColumn, TextColumn

from slamkit import plots
from slamkit.cli.errors import RunError, reason, running
from slamkit.cli.outputs import Outputs
from slamkit.cli.printing import bar
from slamkit.evaluate.run_report import Assessment, assess, write_run
from slamkit.logs import Log

__all__ = ["estimate"]


def estimate(
    make: Callable[[], Any], log: Log, pose: ArrayLike, outputs: Outputs, title: str, quiet: bool
) -> Assessment:
    """Run a filter, judge the run and write the files that are asked for.

    Parameters
    ----------
    make : callable
        Gives a new filter.
    log : Log
    pose : array_like (3,)
        Where the filter starts [m, m, rad].
    outputs : Outputs
        If the run fails, ``--out`` gets its first steps.
    title : str
        Of the log, for the figure.
    quiet : bool
        No progress bar.

    Raises
    ------
    InputError
        The filter cannot be made.
    RunError
        The run failed.
    """
    f = make()
    titled = f"{title}: {plots.style(f.name).label}"
    try:
        with bar(quiet, BarColumn(), TextColumn("{task.completed:.0f}/{task.total:.0f} steps")) as progress:
            task = progress.add_task(f"{titled}: loading (the first run compiles for half a minute)", total=len(log))
            # Loading the compiled code does not count as run time. An error in the first step returns in the run.
            with suppress(Exception):
                make().run(log.head(1))
            progress.update(task, description=titled)
            history = f.run(log, progress=lambda done, total: progress.update(task, completed=done, total=total))
    except (Exception, KeyboardInterrupt) as error:
        done = _keep(error, f, log, pose, outputs, titled)
        if isinstance(error, KeyboardInterrupt):
            if done:
                print(f"interrupted; {done}", file=sys.stderr)
            raise
        raise RunError(f"{reason(error)}; {done}" if done else reason(error)) from error
    with running():
        assessment = assess(history, log, f.motion, pose)
        outputs.write(assessment, log, f, titled)
    return assessment


def _keep(error: BaseException, f: Any, log: Log, pose: ArrayLike, outputs: Outputs, title: str) -> str:
    """Write the steps that were done into ``--out`` and say so; empty if there is nothing to write."""
    history = getattr(error, "history", None)
    if history is None or outputs.out is None:
        return ""
    try:
        write_run(outputs.out, assess(history, log, f.motion, pose), log, f"{title}, incomplete")
    except Exception as second:
        return f"its first {len(history.times)} of {len(log)} steps could not be written: {reason(second)}"
    return f"its first {len(history.times)} of {len(log)} steps are in {outputs.out}"
