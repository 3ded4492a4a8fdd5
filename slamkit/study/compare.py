"""Run a study, prepare for one, or repeat one trial of it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from slamkit.errors import InputError
from slamkit.logs import History, Log, PathLike
from slamkit.protocols import MotionModel, SensorModel
from slamkit.simulate import World
from slamkit.study import workers
from slamkit.study.folder import Store
from slamkit.study.settings import FilterFactory, check_settings
from slamkit.study.study import Study, assemble
from slamkit.study.tasks import Part, Task, all_tasks
from slamkit.study.trial import repeat


def compare(
    filters: Iterable[str | type] | Mapping[str, FilterFactory | str],
    world: World | Log | PathLike,
    runs: int | None = None,
    seed: int = 0,
    *,
    jobs: int = -1,
    backend: str = "processes",
    folder: PathLike | None = None,
    progress: bool | Callable[[int, int], None] = False,
    motion: MotionModel | None = None,
    sensor: SensorModel | None = None,
    pose: ArrayLike | None = None,
    pose_covariance: ArrayLike | None = None,
    options: Mapping[str, Any] | None = None,
    diverged_at: float = 1.0,
    gauge_steps: int = 200,
    max_gap: float = 0.1,
) -> Study:
    """Run every filter over the same runs and compare them with the truth.

    Run k is simulated from ``SeedSequence(seed).spawn(…)[k]``. It depends only on the seed and on k, and every filter
    gets the same log. :func:`run_trial` repeats it.

    Parameters
    ----------
    filters : iterable of str or class, or mapping name → factory
        Each entry is a name in :data:`slamkit.filters.FILTERS`, a ``"module:attribute"`` string, or a subclass of
        :class:`slamkit.filters.LandmarkFilter`. A class is named by its ``name``, or by its class name if it inherits
        ``name``. A mapping gives names of your own to factories: anything that is called with motion, sensor, pose,
        pose_covariance and `options` and returns a filter, such as ``{"gated": partial(EKFSLAM, gate=0.99)}``.
        Classes of a notebook or script work if they can be pickled by value; otherwise they are refused.
    world : World, Log or path
        A world to simulate, or one recorded log (the object, or its folder of CSV files). If a recorded log has no
        truth, the numbers that need it are missing.
    runs : int, optional
        Number M of simulated runs; 50 by default. A recorded log is 1 run.
    seed : int
        Not negative.
    jobs : int
        Number of worker processes; -1 starts one per core. With 1 the study also runs in a separate process, so the
        result does not depend on `jobs`.
    backend : str
        ``"processes"``: processes on this machine. ``"dask"``: the current Dask client, or a local cluster of `jobs`
        processes if there is none. Or the address of a Dask scheduler, such as ``"tcp://host:8786"``.
    folder : path, optional
        Each run is stored here as soon as it is finished. Calling `compare` again with the same settings continues
        from what is stored, after an interruption or with more runs. :meth:`Study.load` reads the folder.
    progress : bool or callable
        True shows a bar if there is a terminal. A callable is called with (parts done, parts in all).
    motion, sensor : models, optional
        The filters' models; by default those of the world. A recorded log needs both.
    pose, pose_covariance : array_like (3,) and (3, 3), optional
        Start of every filter [m, m, rad] and its covariance; by default the world's. For a recorded log the default
        is the origin, known exactly.
    options : mapping, optional
        Further arguments of every filter, such as ``{"order": "batch"}``.
    diverged_at : float
        A run has diverged if its position error exceeds this many times the world's size, or if the filter raises or
        gives values that are not finite. The size is the diagonal of the smallest axis-parallel box around the true
        path and the true landmarks.
    gauge_steps : int
        Number of steps of the first run on which :class:`GaugeCheck` is made; 0 skips it.
    max_gap : float
        Largest difference in time between a pose and its truth [s].

    Returns
    -------
    Study
        The result is the same for any number of `jobs`, for either backend and after an interruption; only the
        measured times differ. If a filter raises in a run, or its process dies, that trial is recorded as failed and
        the others go on. ``study.failures`` lists these trials.

    Raises
    ------
    InputError
        An argument does not fit, `folder` holds a study with other settings, a Dask scheduler does not answer, or a
        filter or model cannot be sent to worker processes. Nothing has run then.

    Notes
    -----
    Each worker uses one thread for linear algebra. The first call of a filter compiles it; the workers share this
    work.
    """
    settings = check_settings(
        filters, world, runs, seed, motion, sensor, pose, pose_covariance, options, diverged_at, gauge_steps, max_gap
    )
    _check_jobs(jobs)
    if not isinstance(backend, str) or (backend not in ("processes", "dask") and "://" not in backend):
        raise InputError(
            f"backend is {backend!r}, expected 'processes', 'dask' or the address of a Dask scheduler (tcp://host:port)"
        )
    store = None if folder is None else Store.open(folder, settings.facts, settings.times)
    tasks = all_tasks(settings.filters, settings.gauge_steps, settings.runs)
    parts: dict[Task, Part] = {} if store is None else store.read(tasks)
    missing = [task for task in tasks if task not in parts]
    with _reporting(progress, len(tasks)) as report, workers.connect(settings, missing, int(jobs), backend) as results:
        if store is not None:
            store.begin(settings.start_time, settings.runs)
        report(len(parts))
        for task, part in results:
            parts[task] = part
            if store is not None:
                store.write(task, part)
            report(len(parts))
    return assemble(settings.facts, settings.times, settings.start_time, settings.runs, parts, settings)


def prepare(filters: Iterable[str | type], worlds: Iterable[World], *, jobs: int = -1) -> None:
    """Compile what filters need in worlds, shared among worker processes.

    The compiled code is cached on disk. :func:`compare` does this by itself. Call it before code that would otherwise
    compile on one core.

    Parameters
    ----------
    filters : iterable of str or class
        As in :func:`compare`.
    worlds : iterable of World
    jobs : int
        Number of worker processes; -1 starts one per core.

    Raises
    ------
    InputError
        A filter is unknown, or `jobs` does not fit.
    """
    _check_jobs(jobs)
    names = list(filters)
    workers.compile_shared([check_settings(names, w, 1, gauge_steps=0) for w in worlds], jobs)


def run_trial(
    world: World | Log | PathLike,
    seed: int,
    k: int,
    filter: str | FilterFactory,
    *,
    motion: MotionModel | None = None,
    sensor: SensorModel | None = None,
    pose: ArrayLike | None = None,
    pose_covariance: ArrayLike | None = None,
    options: Mapping[str, Any] | None = None,
) -> tuple[History, Log]:
    """Repeat one trial of a study in this process.

    Parameters
    ----------
    world, seed, motion, sensor, pose, pose_covariance, options
        The arguments that :func:`compare` was given.
    k : int
        Number of the run; 0 for a recorded log.
    filter : str or factory
        Name in :data:`slamkit.filters.FILTERS`, a ``"module:attribute"`` string, or a class or factory of your own.

    Returns
    -------
    history : History
        The history that the study saw, bit for bit. In maps of more than about fifty landmarks, linear algebra on
        several threads rounds differently: set OMP_NUM_THREADS=1 there.
    log : Log

    Raises
    ------
    InputError
        An argument does not fit.
    Exception
        Whatever the filter raised in the study.
    """
    chosen = [filter] if isinstance(filter, str) else {getattr(filter, "name", "filter"): filter}
    runs = None if isinstance(world, World) else 1
    settings = check_settings(chosen, world, runs, seed, motion, sensor, pose, pose_covariance, options, gauge_steps=0)
    return repeat(settings, k, next(iter(settings.filters)))


def _check_jobs(jobs: Any) -> None:
    if isinstance(jobs, bool) or not isinstance(jobs, int | np.integer) or not (jobs >= 1 or jobs == -1):
        raise InputError(f"jobs is {jobs!r}, expected the number of worker processes, or -1 for one per core")


@contextmanager
def _reporting(progress: bool | Callable[[int, int], None], total: int) -> Iterator[Callable[[int], None]]:
    """A function to call with the number of parts that are done."""
    if callable(progress):
        yield lambda done: progress(done, total)
        return
    if progress:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        console = Console(stderr=True)
        if console.is_terminal:
            columns = (TextColumn("runs"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
            with Progress(*columns, console=console, transient=True) as bar:
                task = bar.add_task("runs", total=total)
                yield lambda done: bar.update(task, completed=done)
            return
    yield lambda done: None
