"""Monte Carlo studies: many filters over the same simulated runs, or one recorded log, judged on the same terms."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, fields, is_dataclass
from functools import cached_property
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slamkit import evaluate, se2
from slamkit.compiled import Compiled, MachineCode
from slamkit.errors import DivergenceError, InputError, LogFileError
from slamkit.evaluate import trajectory
from slamkit.filters import FILTERS, IdealEKFSLAM
from slamkit.logs import History, Log, PathLike, read_archive, reading, write_archive
from slamkit.protocols import MotionModel, SensorModel
from slamkit.simulate import World, simulate

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from slamkit.filters.landmark_filter import LandmarkFilter

__all__ = ["GAUGE_COVARIANCE", "GAUGE_MOTION", "GaugeCheck", "Study", "Trial", "compare", "prepare", "run_trial"]

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Called as (motion, sensor, pose, pose_covariance, **options); gives a filter.
FilterFactory = Callable[..., "LandmarkFilter"]

#: P₀ of the uncertain start in the gauge checks: 0.1 m, 0.1 m, 5°.
GAUGE_COVARIANCE: Array = np.diag([0.1**2, 0.1**2, np.deg2rad(5.0) ** 2])
#: Rigid motion [m, m, rad] of the frame in the check of equivariance.
GAUGE_MOTION: Array = np.array([5.0, -3.0, 1.1])

_FULL = np.array([3, 2, 1])  # degrees of freedom of pose, position and heading
_COLUMNS = ("pose", "position", "heading")


@dataclass(frozen=True, eq=False)
class Trial:
    """What one filter did in one run, beside the truth; NaN where there is no truth or the filter failed.

    Errors are estimate minus truth in the truth's frame. A simulation's frame is known, so nothing is aligned there;
    a recorded log's trajectory is aligned first (:func:`slamkit.evaluate.trajectory.align`).
    """

    filter: str  #: its name in the study
    number: int  #: k of the run
    error: str | None  #: what stopped the filter; None where it came to the end
    diverged: bool  #: it failed, or its position error passed the study's limit
    note: str | None  #: why numbers are missing although the filter came to the end
    errors: Array  #: (K, 3) after each step [m, m, rad]
    sigmas: Array  #: (K, 3) claimed standard deviations [m, m, rad]
    nees: Array  #: (K, 3) NEES of pose, position, heading
    dof: IntArray  #: (K, 3) their degrees of freedom: 3, 2, 1, or less where P is singular; 0 where NEES is NaN
    landmarks: int  #: landmarks in the final map
    landmark_nees: float  #: mean NEES of one landmark (2 degrees of freedom) at the end
    landmark_rmse_m: float  #: root mean square error of the final map [m]
    gauge_nees: float  #: at the end, see :func:`slamkit.evaluate.gauge.nees_split`
    gauge_dof: int
    relative_nees: float  #: likewise
    relative_dof: int
    nis_mean: float  #: mean NIS of the sightings that corrected the belief
    nis_dof: int  #: degrees of freedom of one
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


@dataclass(frozen=True, eq=False)
class GaugeCheck:
    """What one filter makes of its gauge, on the shortened first run, started from :data:`GAUGE_COVARIANCE`."""

    filter: str
    error: str | None  #: why a number is missing
    nullity: int | None  #: see :func:`slamkit.evaluate.gauge.nullity`; None where it failed
    times: Array  #: (n,) [s]
    deviations: Array  #: (n,) gauge deviation after each step [rad]
    deviation_drop: float | None  #: largest fall of these, as a share of the largest of them
    stochastic_gauge_m: float | None  #: see :func:`slamkit.evaluate.gauge.stochastic_gauge` [m]
    equivariance: float | None  #: see :func:`slamkit.evaluate.gauge.equivariance`, under :data:`GAUGE_MOTION`


def compare(
    filters: Iterable[str] | Mapping[str, FilterFactory],
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
    """Run every filter over the same runs and judge them on the same terms.

    Run k is simulated from ``SeedSequence(seed).spawn(…)[k]``: it depends on the seed and on k alone, every filter
    gets the same log of it, and :func:`run_trial` repeats it by itself.

    Parameters
    ----------
    filters : iterable of str, or mapping name → factory
        Names of :data:`slamkit.filters.FILTERS`; or classes of your own (anything that is called with motion, sensor,
        pose, pose_covariance and `options`, and gives a filter) under names of your own.
    world : World, Log or path
        A world to simulate, or a recorded log (the object, or its folder of CSV files), which is one run. Where a
        recorded log has no truth, the numbers that need it are missing.
    runs : int, optional
        Number M of simulated runs; 50 by default. A recorded log is 1 run.
    seed : int
        Not negative.
    jobs : int
        Number of worker processes; -1: one a core. One, too, is a process of its own, so that its arithmetic is the
        others': the result does not depend on `jobs`.
    backend : str
        ``"processes"`` of this machine; ``"dask"``: the Dask client that is in force, or else a cluster of `jobs`
        worker processes on this machine; or the address of a Dask scheduler, as ``"tcp://host:8786"``.
    folder : path, optional
        Where each run is kept as soon as it is finished. With the same settings a study takes up what is there: after
        an interruption, or to go on to more runs. :meth:`Study.load` reads it.
    progress : bool or callable
        True: a bar, if there is a terminal; a callable is given (parts done, parts in all).
    motion, sensor : models, optional
        The filters'; by default those of the world. A recorded log needs them.
    pose, pose_covariance : array_like (3,) and (3, 3), optional
        Where every filter starts [m, m, rad] and how well that is known; by default what the world says. For a
        recorded log the origin, known exactly.
    options : mapping, optional
        Further arguments of every filter, as ``{"order": "batch"}``.
    diverged_at : float
        A run counts as diverged where the position error passes this many times the world's size, the diagonal of
        the smallest box (along the axes) around the true path and the true landmarks; and where the filter raises or
        says what is not finite.
    gauge_steps : int
        Steps of the first run on which :class:`GaugeCheck` is made; 0 leaves it out.
    max_gap : float
        Largest difference in time between a pose and its truth [s].

    Returns
    -------
    Study
        The same for any number of `jobs`, either backend and after an interruption, but for the measured times.

    Raises
    ------
    InputError
        An argument does not fit, or `folder` holds a study with other settings. What a filter raises in a run is
        recorded in that trial instead.

    Notes
    -----
    Workers use one thread of linear algebra each. An object whose settings cannot be told from its attributes (a
    closure, say) is known to `folder` by its name only.
    """
    setup = _setup(
        filters, world, runs, seed, motion, sensor, pose, pose_covariance, options, diverged_at, gauge_steps, max_gap
    )
    if isinstance(jobs, bool) or not isinstance(jobs, int) or not (jobs >= 1 or jobs == -1):
        raise InputError(f"jobs is {jobs!r}, expected the number of worker processes, or -1 for one a core")
    if backend != "processes" and backend != "dask" and "://" not in backend:
        raise InputError(
            f"backend is {backend!r}, expected 'processes', 'dask' or the address of a Dask scheduler (tcp://host:port)"
        )
    store = None if folder is None else _Store.open(folder, setup.facts, setup.times, setup.runs)
    tasks: list[_Task] = [(name, -1) for name in setup.filters if gauge_steps] + [("", k) for k in range(setup.runs)]
    parts: dict[_Task, _Part] = {} if store is None else store.read(tasks)
    missing = [task for task in tasks if task not in parts]
    with _reporting(progress, len(tasks)) as report:
        report(len(parts))
        for task, part in _performed(setup, missing, jobs, backend):
            parts[task] = part
            if store is not None:
                store.write(task, part)
            report(len(parts))
    return _study(setup.facts, setup.times, setup.runs, parts, setup)


def prepare(filters: Iterable[str], worlds: Iterable[World], *, jobs: int = -1) -> None:
    """Compile what filters need in worlds, a share in each process, so that a first run does not do it on one core.

    What is compiled is kept on disk. :func:`compare` does this by itself; do it earlier where something else, on one
    core, would compile first.

    Parameters
    ----------
    filters : iterable of str
        Names of :data:`slamkit.filters.FILTERS`.
    worlds : iterable of World
    jobs : int
        Number of worker processes; -1: one a core.

    Raises
    ------
    InputError
        A name is unknown.
    """
    names = list(filters)
    setups = [_setup(names, w, 1, 0, None, None, None, None, None, 1.0, 0, 0.1) for w in worlds]
    with _workers(jobs) as parallel:
        _compile(setups, parallel)


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
    """One trial of a study by itself.

    Parameters
    ----------
    world, seed, motion, sensor, pose, pose_covariance, options
        As :func:`compare` was given them.
    k : int
        Number of the run; 0 for a recorded log.
    filter : str or factory
        Name of :data:`slamkit.filters.FILTERS`, or a class of your own.

    Returns
    -------
    history : History
        To the bit what the study saw. Linear algebra on more than one thread rounds differently in maps of some
        fifty landmarks or more: there, let OMP_NUM_THREADS=1 for the same bits.
    log : Log

    Raises
    ------
    InputError
        An argument does not fit.
    Exception
        Whatever the filter raised in the study, it raises again.
    """
    chosen = [filter] if isinstance(filter, str) else {getattr(filter, "name", "filter"): filter}
    runs = None if isinstance(world, World) else 1
    setup = _setup(chosen, world, runs, seed, motion, sensor, pose, pose_covariance, options, 1.0, 0, 0.1)
    return _rerun(setup, k, next(iter(setup.filters)))


@dataclass(frozen=True, eq=False)
class Study:
    """Filters compared over the same runs."""

    facts: Mapping[str, Any]  #: the settings, as a file keeps them
    times: Array  #: (K,) time of each step [s]
    trials: Mapping[str, tuple[Trial, ...]]  #: filter → its trial in every run
    gauge: Mapping[str, GaugeCheck]  #: filter → its gauge check; empty where none was made
    _origin: _Setup | None = field(default=None, repr=False)

    @property
    def filters(self) -> tuple[str, ...]:
        """Names of the filters."""
        return tuple(self.trials)

    @property
    def runs(self) -> int:
        """Number M of runs."""
        return len(next(iter(self.trials.values())))

    @property
    def seed(self) -> int:
        """Seed of the runs."""
        return int(self.facts["seed"])

    @property
    def world(self) -> str:
        """Name of the world, or of the log."""
        return str(self.facts["world"])

    @property
    def failures(self) -> list[Trial]:
        """Trials that failed or diverged."""
        return [t for trials in self.trials.values() for t in trials if t.diverged]

    def finished(self, filter: str) -> list[Trial]:
        """Trials in which a filter came to the end, diverged or not: those that enter its numbers."""
        return [t for t in self._trials(filter) if t.error is None]

    def rerun(self, k: int, filter: str) -> tuple[History, Log]:
        """Run trial k of one filter again, alone and in this process; see :func:`run_trial`.

        Raises
        ------
        InputError
            There is no such trial, or the study was loaded: files hold no world.
        """
        self._trials(filter)
        if self._origin is None:
            raise InputError(
                f"a study that was loaded has no world to run: call run_trial(world, {self.seed}, {k}, {filter!r})"
            )
        return _rerun(self._origin, k, filter)

    def summary(self) -> dict[str, dict[str, Any]]:
        """Every filter in numbers that JSON can hold, None where there is none.

        Returns
        -------
        dict
            Filter → dict with

            - ``pose_nees``, ``position_nees``, ``heading_nees``: mean over the runs of the mean over the steps, for 3,
              2 and 1 degrees of freedom (a step at which P is singular counts with the rank it has);
              ``pose_nees_median`` over the runs, ``pose_nees_above_6``: the share of the runs whose mean lies above 6;
              ``pose_nees_low``, ``pose_nees_high``: 95 % bounds of the mean of that many independent values
              (:func:`slamkit.evaluate.chi2_bounds`): of one step; the mean over steps scatters less;
            - ``position_rmse_m``, ``heading_rmse_deg`` over all steps and runs;
            - ``landmark_nees`` (2 degrees of freedom) and ``landmark_rmse_m`` of the final map;
            - ``gauge_nees``, ``gauge_nees_median`` (3 degrees of freedom) and ``relative_nees_per_dof`` of the final
              state (:func:`slamkit.evaluate.gauge.nees_split`), with their 95 % bounds ``gauge_nees_low``, ``…_high``
              and ``relative_nees_low``, ``…_high``;
            - ``nis_per_dof``: mean over the runs of the mean NIS, which needs no truth, per degree of freedom;
            - ``nullity``, ``gauge_deviation_drop``, ``stochastic_gauge_m``, ``equivariance``: see :class:`GaugeCheck`;
            - ``seconds_per_step``: median over the runs;
            - ``runs``, ``finished`` (the runs that enter the numbers: those in which the filter did not fail) and
              ``diverged`` (failures, and errors beyond the study's limit; the latter do enter);
            - ``…_se``: standard errors over the runs.
        """
        return {name: self._summary_of(name) for name in self.trials}

    def _summary_of(self, name: str) -> dict[str, Any]:
        done = self.finished(name)
        nees = np.array([t.mean_nees for t in done]).reshape(-1, 3)
        mse = np.array([t.mean_square_error for t in done]).reshape(-1, 2)
        mapped = [t for t in done if np.isfinite(t.landmark_rmse_m)]
        split = [t for t in done if np.isfinite(t.relative_nees) and t.relative_dof > 0]
        gauge_nees = np.array([3 * t.gauge_nees / t.gauge_dof for t in split if t.gauge_dof > 0])
        out: dict[str, Any] = {}
        for column, title in enumerate(_COLUMNS):
            out |= _mean(f"{title}_nees", nees[:, column])
        pose = nees[np.isfinite(nees[:, 0]), 0]
        robust = evaluate.summary(pose, 3.0, 6.0) if len(pose) else None
        low, high = _bounds(3.0, len(pose))
        gauge_dof = float(np.mean([t.gauge_dof for t in split if t.gauge_dof > 0])) if len(gauge_nees) else 3.0
        gauge_low, gauge_high = _bounds(gauge_dof, len(gauge_nees), 3.0 / gauge_dof)
        out |= {
            "pose_nees_median": None if robust is None else robust.median,
            "pose_nees_above_6": None if robust is None else robust.share_above,
            "pose_nees_low": low,
            "pose_nees_high": high,
            **_root_mean("position_rmse_m", mse[:, 0]),
            **_root_mean("heading_rmse_deg", np.degrees(np.degrees(mse[:, 1]))),
            **_mean("landmark_nees", [t.landmark_nees for t in done]),
            **_root_mean("landmark_rmse_m", [t.landmark_rmse_m**2 for t in mapped], [t.landmarks for t in mapped]),
            **_mean("gauge_nees", gauge_nees),
            "gauge_nees_median": float(np.median(gauge_nees)) if len(gauge_nees) else None,
            "gauge_nees_low": gauge_low,
            "gauge_nees_high": gauge_high,
            **_mean("relative_nees_per_dof", [t.relative_nees / t.relative_dof for t in split]),
        }
        dof = float(np.mean([t.relative_dof for t in split])) if split else 1.0
        low, high = _bounds(dof, len(split), 1.0 / dof)
        check = self.gauge.get(name)
        times = [t.seconds_per_step for t in done]
        return out | {
            "relative_nees_low": low,
            "relative_nees_high": high,
            **_mean("nis_per_dof", [t.nis_mean / t.nis_dof for t in done if t.nis_dof]),
            "nullity": None if check is None else check.nullity,
            "gauge_deviation_drop": None if check is None else check.deviation_drop,
            "stochastic_gauge_m": None if check is None else check.stochastic_gauge_m,
            "equivariance": None if check is None else check.equivariance,
            "seconds_per_step": float(np.median(times)) if times else None,
            "runs": self.runs,
            "finished": len(done),
            "diverged": sum(t.diverged for t in self.trials[name]),
        }

    def findings(self) -> list[str]:
        """What the numbers say, one sentence each and no more than they say.

        Returns
        -------
        list of str
            Which filters claim too little, in the gauge or in the relative map; what the inconsistency of the standard
            EKF is; where errors cannot tell, which filters claim to have learnt their gauge. May be empty.

        Notes
        -----
        A filter claims too little where its mean NEES of the final state (:func:`slamkit.evaluate.gauge.nees_split`)
        lies above a bound that consistent filters, all of the study taken together, pass in either part with a
        probability of 5 % (Bonferroni). It claims to have learnt its gauge where the gauge deviation falls by more
        than a thousandth. A recorded log is aligned with its truth, so that errors say nothing of the gauge there.
        """
        out = []
        known = [n for n, v in self.summary().items() if v["relative_nees_per_dof"] is not None]
        if known:
            too_sure = []
            for part, title in (("gauge", "in the gauge "), ("relative", "in the relative map ")):
                excess = {n: nees for n in known for nees, limit in [self._part(n, part)] if nees > limit}
                if excess:
                    ranked = sorted(excess, key=excess.__getitem__, reverse=True)
                    too_sure.append(title + ", ".join(f"{n} {excess[n]:.2f}" for n in ranked))
            if too_sure:
                what = "NEES per degree of freedom, 1 where a filter is consistent"
                out.append(f"Claim too little ({what}): {'; '.join(too_sure)}.")
            elif self.facts["simulated"]:
                out.append(f"No filter is seen to claim too little in {_count(self.runs, 'run')}.")
        if "ekf" in known and self._learnt_gauge_is_all("ekf") is not None:
            gauge, relative = self._part("ekf", "gauge")[0], self._part("ekf", "relative")[0]
            fall = self.gauge["ekf"].deviation_drop
            assert fall is not None
            where = f"{gauge:.2f} in the gauge, {relative:.2f} in the relative map"
            if self._learnt_gauge_is_all("ekf"):
                out.append(
                    f"All of the ekf's inconsistency ({where}) is a gauge that it claims to have learnt: "
                    f"nothing measures it, yet its claimed deviation falls by up to {fall:.0%}."
                )
            else:
                out.append(
                    f"The ekf claims to have learnt its gauge, and is too sure of its relative map as well ({where})."
                )
        if not self.facts["simulated"]:
            learnt = [
                f"{n} (its claimed deviation falls by up to {c.deviation_drop:.0%})" for n, c in self._learners.items()
            ]
            if learnt:
                out.append(f"Claim to have learnt the gauge, which nothing measures: {', '.join(learnt)}.")
        return out

    def _part(self, name: str, part: str) -> tuple[float, float]:
        """NEES per degree of freedom of one part of the final state, and the bound of :meth:`findings`; -inf: none."""
        split = [t for t in self.finished(name) if np.isfinite(t.relative_nees) and t.relative_dof > 0]
        if part == "gauge":
            split = [t for t in split if t.gauge_dof > 0] if self.facts["simulated"] else []
        if not split:
            return -np.inf, np.inf
        dof = np.array([getattr(t, f"{part}_dof") for t in split], dtype=float)
        value = float(np.mean(np.array([getattr(t, f"{part}_nees") for t in split]) / dof))
        _, limit = _bounds(dof.mean(), len(split), 1.0 / dof.mean(), 1.0 - 0.05 / len(self.trials))
        assert limit is not None
        return value, limit

    @property
    def _learners(self) -> dict[str, GaugeCheck]:
        return {n: c for n, c in self.gauge.items() if c.deviation_drop is not None and c.deviation_drop > 1e-3}

    def _learnt_gauge_is_all(self, name: str) -> bool | None:
        """Whether a learnt gauge is all that a filter is wrong about; None where none is seen to be learnt."""
        (gauge, limit), (relative, relative_limit) = self._part(name, "gauge"), self._part(name, "relative")
        return relative <= relative_limit if gauge > limit and name in self._learners else None

    def table(self) -> list[dict[str, Any]]:
        """One row a trial, as a tidy table has it.

        Returns
        -------
        list of dict
            Keys: filter, trial, error, diverged, note, pose_nees, position_nees, heading_nees, position_rmse_m,
            heading_rmse_deg, landmarks, landmark_nees, landmark_rmse_m, gauge_nees, gauge_dof, relative_nees_per_dof,
            nis_per_dof, seconds_per_step; NaN where there is no number.
        """
        rows = []
        for trials in self.trials.values():
            for t in trials:
                position, heading = np.sqrt(t.mean_square_error)
                rows.append(
                    {
                        "filter": t.filter,
                        "trial": t.number,
                        "error": t.error,
                        "diverged": t.diverged,
                        "note": t.note,
                        **{f"{n}_nees": float(v) for n, v in zip(_COLUMNS, t.mean_nees, strict=True)},
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
                )
        return rows

    def frame(self) -> Any:
        """:meth:`table` as a pandas DataFrame.

        Raises
        ------
        InputError
            pandas is not installed.
        """
        try:
            import pandas
        except ImportError:
            raise InputError("a DataFrame needs pandas: install slamkit[pandas], or use table()") from None
        return pandas.DataFrame(self.table())

    def report(self) -> str:
        """The study as Markdown: accuracy and consistency, the gauge, and every trial that went wrong."""
        s, trials = self.summary(), self.failures
        first = next(iter(s.values()))
        size = f"{_count(self.runs, 'run')} of {len(self.times)} steps"
        lines = [f"# {self.world}: {len(s)} filters, {size}", ""]
        if self.facts["simulated"]:
            lines += [
                f"Seed {self.seed}; every filter ran on the same logs. ± is one standard error over the runs.",
                "",
            ]
        else:
            lines += ["A recorded log: errors are taken after alignment with the truth, where there is one.", ""]
        lines += [" ".join(self.findings()), ""] if self.findings() else []
        columns = {
            "pose NEES (3)": ("pose_nees", 2),
            "heading NEES (1)": ("heading_nees", 2),
            "position RMSE [m]": ("position_rmse_m", 3),
            "heading RMSE [°]": ("heading_rmse_deg", 2),
            "landmark NEES (2)": ("landmark_nees", 2),
            "landmark RMSE [m]": ("landmark_rmse_m", 3),
            "NIS per dof": ("nis_per_dof", 2),
        }
        head = ["filter", *columns, "median pose NEES", "share above 6", "µs a step", "diverged"]
        rows = [
            [
                name,
                *(_cell(v, key, digits) for key, digits in columns.values()),
                _number(v["pose_nees_median"], ".2f"),
                _number(v["pose_nees_above_6"], ".0%"),
                _number(v["seconds_per_step"], ".1f", 1e6),
                f"{v['diverged']} of {v['runs']}",
            ]
            for name, v in s.items()
        ]
        lines += ["## Accuracy and consistency", "", *_markdown(head, rows), ""]
        if first["pose_nees_low"] is not None:
            low, high = first["pose_nees_low"], first["pose_nees_high"]
            lines += [f"A consistent filter's mean pose NEES at one step lies in [{low:.2f}, {high:.2f}] (95 %).", ""]
        head = [
            "filter",
            "relative NEES per dof",
            "gauge NEES (3)",
            "its median",
            "nullity",
            "gauge deviation falls by",
            "stochastic gauge [m]",
            "equivariance",
        ]
        rows = [
            [
                name,
                _cell(v, "relative_nees_per_dof", 2),
                _cell(v, "gauge_nees", 2),
                _number(v["gauge_nees_median"], ".2f"),
                _number(v["nullity"], "d"),
                _number(v["gauge_deviation_drop"], ".1e"),
                _number(v["stochastic_gauge_m"], ".1e"),
                _number(v["equivariance"], ".1e"),
            ]
            for name, v in s.items()
        ]
        lines += ["## The gauge", "", *_markdown(head, rows), ""]
        if first["relative_nees_low"] is not None:
            low, high = first["relative_nees_low"], first["relative_nees_high"]
            line = f"A consistent filter's relative NEES per dof lies in [{low:.2f}, {high:.2f}] (95 %)"
            if first["gauge_nees_low"] is not None:
                line += f", its gauge NEES in [{first['gauge_nees_low']:.2f}, {first['gauge_nees_high']:.2f}]"
            lines += [f"{line}.", ""]
        lines += [
            "Three directions of the state, the gauge, are unobservable: nullity is 3 and the gauge deviation never "
            "falls in a filter that does not claim to have learnt them.",
            "",
        ]
        if trials:
            limit = float(self.facts["diverged_at"])
            why = f"position error beyond {limit:g} times the world's size"
            lines += ["## Failed and diverged trials", ""]
            lines += [
                *_markdown(["filter", "trial", "why"], [[t.filter, str(t.number), t.error or why] for t in trials])
            ]
            lines += [""]
        notes = [(t.filter, f"trial {t.number}: {t.note}") for f in self.trials.values() for t in f if t.note]
        notes += [(c.filter, f"gauge check: {c.error}") for c in self.gauge.values() if c.error]
        if notes:
            lines += ["## Missing numbers", "", *_markdown(["filter", "why"], notes), ""]
        return "\n".join(lines)

    def save(self, folder: PathLike) -> None:
        """Write the study into a folder, which is made where it does not exist; :meth:`load` reads it.

        Raises
        ------
        InputError
            The folder holds a study with other settings.
        """
        store = _Store.open(folder, self.facts, self.times, self.runs)
        for task, part in self._parts().items():
            store.write(task, part)

    def _parts(self) -> dict[_Task, _Part]:
        parts: dict[_Task, _Part] = {(name, -1): check for name, check in self.gauge.items()}
        return parts | {("", k): [self.trials[name][k] for name in self.trials] for k in range(self.runs)}

    @classmethod
    def load(cls, folder: PathLike) -> Study:
        """Read a study that :func:`compare` or :meth:`save` left in a folder.

        Raises
        ------
        LogFileError
            There is none, it is unfinished, or a file is damaged; the message names it.
        """
        path = Path(folder) / _STUDY
        with reading(path, "study"):
            facts, arrays = read_archive(path, "study")
            runs = int(facts.pop("runs"))
            names = list(facts["filters"])
        tasks: list[_Task] = [(name, -1) for name in names if facts["gauge_steps"]] + [("", k) for k in range(runs)]
        store = _Store(Path(folder), names)
        parts = store.read(tasks)
        missing = [store.path(task).name for task in tasks if task not in parts]
        if missing:
            raise LogFileError(
                f"{folder} holds an unfinished study: {missing[0]} and {len(missing) - 1} more are missing; "
                "call compare with the same settings to go on"
            )
        return _study(facts, arrays["times"], runs, parts, None)

    def _trials(self, filter: str) -> tuple[Trial, ...]:
        if filter not in self.trials:
            raise InputError(f"no filter {filter!r} in the study, it has {', '.join(self.trials)}")
        return self.trials[filter]

    # -- figures ------------------------------------------------------------------------------------------------------

    def figures(self) -> dict[str, Figure]:
        """The study's figures: overview, nees, claims, coverage, bars, cost and, where it was checked, gauge.

        Returns
        -------
        dict
            Name → figure; write one with :func:`slamkit.plots.save`. Those that need the truth are left out where
            no trial has one.
        """
        from slamkit import plots

        figures = {}
        if self._judged:
            figures["overview"] = self.overview()
            with _figure(7.0, 3.6) as figure:
                self._plot_nees(figure.subplots())
            figures["nees"] = figure
            figures["claims"] = self._claims()
            with _figure(4.6, 4.9) as figure:
                covered = {
                    name: evaluate.coverage(values, dof)
                    for name in self._judged
                    for values, dof in [self._pose_nees(name)]
                    if np.any(dof > 0)
                }
                if covered:
                    levels = next(iter(covered.values())).levels
                    plots.plot_coverage(figure.subplots(), levels, {n: c.share for n, c in covered.items()})
            if covered:
                figures["coverage"] = figure
            figures["bars"] = self._bars()
            s = {n: v for n, v in self.summary().items() if v["position_rmse_m"] is not None}
            with _figure(5.6, 4.2) as figure:
                plots.plot_cost(
                    figure.subplots(),
                    {n: v["seconds_per_step"] for n, v in s.items()},
                    {n: v["position_rmse_m"] for n, v in s.items()},
                    {n: v["position_rmse_m_se"] or 0.0 for n, v in s.items()},
                )
            figures["cost"] = figure
        if any(len(c.deviations) for c in self.gauge.values()):
            with _figure(6.2, 3.6) as figure:
                self._plot_gauge(figure.subplots())
            figures["gauge"] = figure
        return figures

    def overview(self) -> Figure:
        """The study at a glance: who claims too little of the relative map, who of how the whole lies in the world.

        Returns
        -------
        Figure
            Above, for every filter, the NEES per degree of freedom of its final state in two parts that add up: the
            relative map, and the gauge; below, the gauge deviation in the gauge check, which may not fall, and the
            heading error of the standard EKF (without it, of the filter with the largest gauge NEES) beside what it
            claims. Where no NEES could be split the pose takes the gauge's place.

        Raises
        ------
        InputError
            No trial has a truth.
        """
        if not self._judged:
            raise InputError(f"no filter came to an end with a truth to compare with in {self.runs} runs")
        from slamkit import plots

        s = self.summary()
        split = any(s[n]["gauge_nees"] is not None for n in self._judged)
        key = "gauge_nees" if split else "pose_nees"
        subject = "ekf" if "ekf" in self._judged else max(self._judged, key=lambda n: s[n][key] or 0.0)
        with _figure(10.0, 7.8) as figure:
            halves: Any = figure.subfigures(2, 1, height_ratios=[1.0, 1.15])
            above, below = halves
            panels = above.subplots(1, 2, sharex=True, sharey=True)
            titles = (
                "What lies where, as the robot sees it: the relative map",
                f"Where {'robot and map lie as one: the gauge' if split else 'the robot lies: the pose'}"
                f"{'' if self.facts['simulated'] else ' (after alignment)'}",
            )
            edges = []
            shown = (("relative_nees_per_dof", 1.0), (key, 1.0 / 3.0))
            for ax, title, (of, scale) in zip(panels, titles, shown, strict=True):
                self._plot_bars(ax, of, "NEES per degree of freedom (consistent: 1)", scale)
                ax.set_title(title, fontsize=9, loc="left")
                edges += ax.get_xlim()
            panels[0].set_xlim(min(edges), max(edges))
            left, right = below.subfigures(1, 2)
            if any(len(c.deviations) for c in self.gauge.values()):
                title = "What is claimed of the heading of the gauge: it may never fall"
                self._plot_gauge(left.subplots())
            else:
                title = "NEES of the pose over time"
                self._plot_nees(left.subplots())
            left.suptitle(title, fontsize=9, x=0.01, ha="left")
            self._plot_claim(right.subplots(), subject)
            title = f"Heading of the {plots.style(subject).label}: its error and what it claims"
            right.suptitle(title, fontsize=9, x=0.01, ha="left")
            figure.suptitle(self._headline(subject, s), fontsize=11)
        return figure

    def _headline(self, subject: str, s: Mapping[str, Mapping[str, Any]]) -> str:
        """What the numbers say of one filter; no more than they say."""
        from slamkit import plots

        v, label = s[subject], plots.style(subject).label
        size = f"{self.world}, {_count(v['finished'], 'run')}"
        if v["gauge_nees"] is None:
            return size
        relative, gauge = v["relative_nees_per_dof"], v["gauge_nees"] / 3
        numbers = f"NEES per degree of freedom {relative:.2f} in the relative map, {gauge:.2f} in the gauge"
        if self._learnt_gauge_is_all(subject):
            return (
                f"All that is inconsistent in the {label} is a gauge that it claims to have learnt\n{numbers} ({size})"
            )
        return f"{label}: {numbers}\n{size}"

    @cached_property
    def _judged(self) -> list[str]:
        """Filters with at least one trial that has errors."""
        return [n for n in self.trials if any(np.isfinite(t.errors).any() for t in self.finished(n))]

    def _pose_nees(self, name: str) -> tuple[Array, IntArray]:
        """Pose NEES and its degrees of freedom (M, K) of the finished trials."""
        done = self.finished(name)
        dof = np.array([t.dof[:, 0] for t in done])
        return np.where(dof > 0, [t.nees[:, 0] for t in done], 0.0), dof

    def _plot_nees(self, ax: Axes) -> None:
        from slamkit import plots

        values = {}
        for name in self._judged:
            nees, dof = self._pose_nees(name)
            values[name] = np.where(dof > 0, 3 * nees / np.maximum(dof, 1), np.nan)
        plots.plot_nees(ax, self._elapsed, values, 3, label="pose NEES (3 degrees of freedom)")

    def _plot_claim(self, ax: Axes, name: str, *, legend: bool = True) -> None:
        from slamkit import plots

        done = self.finished(name)
        errors, sigmas = (np.degrees([getattr(t, kind)[:, 2] for t in done]) for kind in ("errors", "sigmas"))
        plots.plot_claim(ax, name, self._elapsed, errors, sigmas, legend=legend)

    def _claims(self) -> Figure:
        from matplotlib.patches import Patch

        from slamkit import plots

        n = len(self._judged)
        # As few empty places as can be, then as few rows.
        columns = max(range(min(n, 2), min(n, 4) + 1), key=lambda c: (-(-n % c), c))
        rows = -(-n // columns)
        with _figure(min(3.6 * columns, 11.0), 0.6 + 2.1 * rows) as figure:
            axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
            drawn = axes.flat[:n]
            for ax, name in zip(drawn, self._judged, strict=True):
                self._plot_claim(ax, name, legend=False)
            for ax in axes.flat[n:]:
                ax.remove()
            for k, ax in enumerate(drawn):
                ax.set_ylabel(ax.get_ylabel() if k % columns == 0 else "")
                ax.tick_params(labelbottom=k + columns >= n)
            figure.supxlabel(drawn[0].get_xlabel(), fontsize=9)
            for ax in drawn:
                ax.set_xlabel("")
            for handle in plots.shared_legend(figure, drawn).legend_handles:
                if isinstance(handle, Patch):
                    handle.set_facecolor("0.55")  # of every filter in its own colour
        return figure

    def _plot_gauge(self, ax: Axes) -> None:
        from slamkit import plots

        checks = [c for c in self.gauge.values() if len(c.deviations)]
        n = min(len(c.times) for c in checks)
        t = checks[0].times[:n]
        plots.plot_gauge(ax, t - self._start, {c.filter: np.degrees(c.deviations[:n]) for c in checks})

    def _plot_bars(self, ax: Axes, key: str, label: str, scale: float = 1.0) -> None:
        from slamkit import plots

        s = self.summary()
        band = None
        edge = key.removesuffix("_per_dof")
        if f"{edge}_low" in next(iter(s.values())):
            limits = [(v[f"{edge}_low"], v[f"{edge}_high"]) for v in s.values() if v[f"{edge}_low"] is not None]
            band = (scale * limits[0][0], scale * limits[0][1]) if limits else None
        expected = {"pose_nees": 3.0, "gauge_nees": 3.0, "landmark_nees": 2.0, "relative_nees_per_dof": 1.0}.get(key)
        values = {n: float("nan") if v[key] is None else scale * v[key] for n, v in s.items()}
        if np.all(np.isnan(list(values.values()))):
            ax.text(0.5, 0.5, f"no {label}", transform=ax.transAxes, ha="center", va="center", color="0.4")
            return
        errors = {n: scale * (v[f"{key}_se"] or 0.0) for n, v in s.items()}
        reference = None if expected is None else scale * expected
        plots.plot_bars(ax, values, errors, label=label, band=band, reference=reference)

    def _bars(self) -> Figure:
        panels = {
            "position_rmse_m": "position RMSE [m]",
            "heading_rmse_deg": "heading RMSE [deg]",
            "landmark_rmse_m": "landmark RMSE [m]",
            "pose_nees": "pose NEES (3)",
            "landmark_nees": "landmark NEES (2)",
            "relative_nees_per_dof": "relative NEES per degree of freedom",
        }
        with _figure(11.0, 0.8 + 0.62 * len(self.trials)) as figure:
            for ax, (key, label) in zip(figure.subplots(2, 3, sharey=True).flat, panels.items(), strict=True):
                self._plot_bars(ax, key, label)
        return figure

    @property
    def _start(self) -> float:
        return float(self.times[0]) if len(self.times) else 0.0

    @property
    def _elapsed(self) -> Array:
        return self.times - self._start


# -- one part of a study, as a worker makes it ------------------------------------------------------------------------

#: ("", k): all filters over run k; (filter, -1): its gauge check.
_Task = tuple[str, int]
_Part = list[Trial] | GaugeCheck


@dataclass(frozen=True, eq=False)
class _Setup:
    """All that a worker needs."""

    name: str
    world: World | Log
    filters: Mapping[str, FilterFactory]
    runs: int
    seed: int
    motion: MotionModel
    sensor: SensorModel
    pose: Array
    pose_covariance: Array
    options: Mapping[str, Any]
    diverged_at: float
    gauge_steps: int
    max_gap: float

    @property
    def simulated(self) -> bool:
        return isinstance(self.world, World)

    @cached_property
    def times(self) -> Array:
        """(K,) ends of the steps [s]."""
        if isinstance(self.world, Log):
            return self.world.schedule.times
        return np.asarray(float(self.world.dt) * np.arange(1, len(self.world.controls) + 1, dtype=np.float64))

    @cached_property
    def facts(self) -> dict[str, Any]:
        """The settings by which a folder knows its study; not the number of runs, which may grow."""
        from slamkit import __version__

        return {
            "slamkit": __version__,
            "simulated": self.simulated,
            "world": self.name,
            "seed": self.seed,
            "filters": {name: _digest(kind) for name, kind in self.filters.items()},
            "world_content": _digest(self.world),
            "motion": _digest(self.motion),
            "sensor": _digest(self.sensor),
            "start": _digest((self.pose, self.pose_covariance)),
            "options": _digest(self.options),
            "diverged_at": self.diverged_at,
            "gauge_steps": self.gauge_steps,
            "max_gap": self.max_gap,
        }

    def log(self, k: int) -> Log:
        if isinstance(self.world, Log):
            return self.world
        return simulate(self.world, np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(k,))))

    def make(self, name: str) -> LandmarkFilter:
        return self.filters[name](self.motion, self.sensor, self.pose, self.pose_covariance, **self.options)


def _setup(
    filters: Iterable[str] | Mapping[str, FilterFactory],
    world: World | Log | PathLike,
    runs: int | None,
    seed: int,
    motion: MotionModel | None,
    sensor: SensorModel | None,
    pose: ArrayLike | None,
    pose_covariance: ArrayLike | None,
    options: Mapping[str, Any] | None,
    diverged_at: float,
    gauge_steps: int,
    max_gap: float,
) -> _Setup:
    """Check everything that can be checked before the first run."""
    name = world.name if isinstance(world, World) else "recorded log"
    if not isinstance(world, World | Log):
        try:
            path = Path(world)
        except TypeError:
            raise InputError(f"world is a {type(world).__name__}, expected a World, a Log or a folder") from None
        name, world = path.resolve().name, Log.read_csv(path)
    simulated = isinstance(world, World)
    count = (50 if simulated else 1) if runs is None else runs
    for what, value, least in (("runs", count, 1), ("seed", seed, 0), ("gauge_steps", gauge_steps, 0)):
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
            raise InputError(f"{what} is {value!r}, expected an integer of at least {least}")
    if not simulated and count != 1:
        raise InputError(f"runs is {count}, but a recorded log is 1 run")
    for what, number in (("diverged_at", diverged_at), ("max_gap", max_gap)):
        if not 0 < number < np.inf:
            raise InputError(f"{what} is {number!r}, expected a finite number > 0")
    if isinstance(world, World):
        motion, sensor = motion or world.motion, sensor or world.sensor
        pose = world.pose if pose is None else pose
        pose_covariance = world.pose_covariance if pose_covariance is None else pose_covariance
    if motion is None or sensor is None:
        raise InputError("a recorded log does not say how the robot moves and sees: give motion=… and sensor=…")
    setup = _Setup(
        name=name,
        world=world,
        filters=_chosen(filters),
        runs=int(count),
        seed=int(seed),
        motion=motion,
        sensor=sensor,
        pose=np.array((0.0, 0.0, 0.0) if pose is None else pose, dtype=float),
        pose_covariance=np.array(np.zeros((3, 3)) if pose_covariance is None else pose_covariance, dtype=float),
        options=dict(options or {}),
        diverged_at=float(diverged_at),
        gauge_steps=int(gauge_steps),
        max_gap=float(max_gap),
    )
    # A wrong model or start would fail in every trial: one of slamkit's own filters tells so now.
    FILTERS["ekf"](setup.motion, setup.sensor, setup.pose, setup.pose_covariance)
    return setup


def _chosen(filters: Iterable[str] | Mapping[str, FilterFactory]) -> dict[str, FilterFactory]:
    if isinstance(filters, Mapping):
        chosen = dict(filters)
    else:
        names = [filters] if isinstance(filters, str) else list(filters)
        unknown = [n for n in names if n not in FILTERS]
        if unknown:
            raise InputError(f"filter {unknown[0]!r} is unknown, expected some of {', '.join(FILTERS)}")
        if len(set(names)) != len(names):
            raise InputError(f"filters {', '.join(names)} name one twice")
        chosen = {n: FILTERS[n] for n in names}
    if not chosen:
        raise InputError(f"filters is empty, expected some of {', '.join(FILTERS)}, or a mapping name → class")
    for name, kind in chosen.items():
        if not isinstance(name, str) or not callable(kind):
            raise InputError(f"filter {name!r} is {kind!r}, expected a name (str) and a class or factory")
    return chosen


def _rerun(setup: _Setup, k: int, name: str) -> tuple[History, Log]:
    limit = None if setup.simulated else 1
    if isinstance(k, bool) or not isinstance(k, int | np.integer) or k < 0 or (limit is not None and k >= limit):
        raise InputError(f"k is {k!r}, expected the number of a run: {'≥ 0' if limit is None else '0'}")
    log = setup.log(int(k))
    return setup.make(name).run(log), log


def _perform(setup: _Setup, task: _Task) -> _Part:
    name, k = task
    if name:
        return _gauge_check(setup, name)
    try:
        log = setup.log(k)
    except Exception as error:
        return [_failed(setup, name, k, f"the simulation: {_text(error)}") for name in setup.filters]
    return [_trial(setup, log, name, k) for name in setup.filters]


def _trial(setup: _Setup, log: Log, name: str, k: int) -> Trial:
    try:
        # The first call in a process reads compiled code from a file; that is no time of a step.
        setup.make(name).run(_beginning(log, 2))
        filter = setup.make(name)
        history = filter.run(log)
        poses, covariances = history.poses, history.pose_covariances
        bad = ~(np.isfinite(poses).all(1) & np.isfinite(covariances).all((1, 2)))
        if bad.any():
            raise DivergenceError(f"pose or covariance not finite at {history.times[np.argmax(bad)]} s")
    # Whatever a filter raises belongs to its trial: the study goes on.
    except Exception as error:
        return _failed(setup, name, k, _text(error))
    return _judge(setup, log, name, k, filter, history)


def _judge(setup: _Setup, log: Log, name: str, k: int, filter: LandmarkFilter, history: History) -> Trial:
    K = len(history.times)
    truth, poses, covariances = log.truth, history.poses, history.pose_covariances
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    errors, nees = np.full((K, 3), np.nan), np.full((K, 3), np.nan)
    dof = np.zeros((K, 3), dtype=np.int64)
    frame, limit = np.zeros(3), np.inf
    notes: list[str] = []
    landmark_nees = landmark_rmse = gauge_nees = relative_nees = float("nan")
    gauge_dof = relative_dof = 0
    if truth is not None:
        rows, matched = trajectory.nearest(history.times, truth.times, setup.max_gap)
    if truth is not None and len(rows):
        true = truth.poses[matched]
        if not setup.simulated:
            frame = trajectory.align(poses[rows, :2], true[:, :2])
            poses = se2.compose(frame, poses)
            A = np.eye(3)
            A[:2, :2] = se2.rotation(frame[2])
            covariances = A @ covariances @ A.T
            variances = np.diagonal(covariances, axis1=1, axis2=2)
        errors[rows] = evaluate.state_error(poses[rows], true)
        kinds = (evaluate.pose_nees, evaluate.position_nees, evaluate.heading_nees)
        for column, kind in enumerate(kinds):
            nees[rows, column], dof[rows, column] = _each_step(kind, poses[rows], covariances[rows], true, notes)
        places = np.array([*truth.poses[:, :2], *truth.landmarks.values()]).reshape(-1, 2)
        limit = setup.diverged_at * float(np.hypot(*np.ptp(places, axis=0)))
        known = [i in truth.landmarks for i in history.landmark_ids]
        if any(known):
            C = se2.rotation(frame[2])
            places = se2.transform(frame, history.landmarks[known])
            P = C @ history.landmark_covariances[known] @ C.T
            there = np.array([truth.landmarks[i] for i in history.landmark_ids if i in truth.landmarks])
            landmark_rmse = float(np.sqrt(np.mean(np.sum((places - there) ** 2, axis=1))))
            squares, _ = _each_step(evaluate.landmark_nees, places, P, there, notes)
            landmark_nees = float(squares.mean())
        if any(known) and all(known) and rows[-1] == K - 1:
            from slamkit.evaluate import gauge

            back = se2.inverse(frame)
            moved = {i: se2.transform(back, p) for i, p in truth.landmarks.items()}
            try:
                split = gauge.nees_split(filter, se2.compose(back, true[-1]), moved)
                gauge_nees, gauge_dof = split.gauge, split.gauge_dof
                relative_nees, relative_dof = split.relative, split.relative_dof
            # A filter of the user's own need not offer what the split asks of it.
            except Exception as error:
                notes.append(f"split of NEES: {_text(error)}")
    corrected = history.nis[history.accepted & np.isfinite(history.nis)]
    far = np.hypot(errors[:, 0], errors[:, 1])
    return Trial(
        filter=name,
        number=k,
        error=None,
        diverged=bool(np.any(far > limit)),
        note=_note(notes),
        errors=errors,
        sigmas=np.sqrt(np.where(variances >= 0, variances, np.nan)),
        nees=nees,
        dof=dof,
        landmarks=len(history.landmark_ids),
        landmark_nees=landmark_nees,
        landmark_rmse_m=landmark_rmse,
        gauge_nees=gauge_nees,
        gauge_dof=gauge_dof,
        relative_nees=relative_nees,
        relative_dof=relative_dof,
        nis_mean=float(corrected.mean()) if len(corrected) else float("nan"),
        nis_dof=history.dof,
        seconds=float(history.seconds),
    )


def _each_step(
    kind: Callable[..., evaluate.NormalizedSquares], estimate: Array, P: Array, truth: Array, notes: list[str]
) -> tuple[Array, IntArray]:
    """Values and degrees of freedom (n,); NaN and 0, and a note, where the error contradicts P or P is indefinite."""
    try:
        squares = kind(estimate, P, truth)
        return np.where(squares.dof > 0, squares.values, np.nan), squares.dof
    except DivergenceError as error:
        if len(estimate) == 1:
            notes.append(f"{kind.__name__}: {_text(error)}")
            return np.array([np.nan]), np.array([0])
    # One such step among thousands is found by halving.
    n = len(estimate) // 2
    halves = [_each_step(kind, estimate[h], P[h], truth[h], notes) for h in (slice(0, n), slice(n, None))]
    return np.concatenate([v for v, _ in halves]), np.concatenate([d for _, d in halves])


def _failed(setup: _Setup, name: str, k: int, why: str) -> Trial:
    nan, K = float("nan"), len(setup.times)
    blank = np.full((K, 3), nan)
    return Trial(
        filter=name, number=k, error=why, diverged=True, note=None, errors=blank, sigmas=blank, nees=blank,
        dof=np.zeros((K, 3), dtype=np.int64), landmarks=0, landmark_nees=nan, landmark_rmse_m=nan, gauge_nees=nan,
        gauge_dof=0, relative_nees=nan, relative_dof=0, nis_mean=nan, nis_dof=0, seconds=nan,
    )  # fmt: skip


def _gauge_check(setup: _Setup, name: str) -> GaugeCheck:
    from slamkit.evaluate import gauge

    errors: dict[str, list[str]] = {}  # why → what is missing for that

    def attempt(what: str, number: Callable[[], Any]) -> Any:
        try:
            return number()
        # As in a trial: what a filter cannot do is recorded.
        except Exception as error:
            errors.setdefault(_text(error), []).append(what)
            return None

    def said() -> str | None:
        return "; ".join(f"{', '.join(what)}: {why}" for why, what in errors.items()) or None

    log = attempt("the simulation", lambda: _beginning(setup.log(0), setup.gauge_steps))
    times, deviations = np.empty(0), np.empty(0)
    if log is None:
        return GaugeCheck(name, said(), None, times, deviations, None, None, None)
    kind, models = setup.filters[name], (setup.motion, setup.sensor)
    options = dict(setup.options)
    if isinstance(kind, type) and issubclass(kind, IdealEKFSLAM):
        options["truth"] = log.truth

    def start() -> LandmarkFilter:
        return kind(*models, setup.pose, GAUGE_COVARIANCE, **options)

    nullity = attempt("nullity", lambda: gauge.nullity(start(), log).nullity)
    found = attempt("gauge deviation", lambda: gauge.gauge_deviations(start(), log))
    drop = None
    if found is not None and len(found):
        times, deviations = log.schedule.times, found
        drop = gauge.gauge_drop(found) / float(found.max()) if found.max() > 0 else 0.0
    stochastic = attempt(
        "stochastic gauge",
        lambda: gauge.stochastic_gauge(kind, *models, log, GAUGE_COVARIANCE, setup.pose, **options),
    )
    turned = attempt(
        "equivariance",
        lambda: gauge.equivariance(kind, *models, log, GAUGE_MOTION, setup.pose, GAUGE_COVARIANCE, **options),
    )
    return GaugeCheck(name, said(), nullity, times, deviations, drop, stochastic, turned)


def _beginning(log: Log, steps: int) -> Log:
    """The first steps of a log, as a log."""
    times = log.schedule.times
    if steps >= len(times):
        return log
    end = float(times[steps - 1])
    acting, seen = log.control_times < end, log.observation_times <= end
    return Log(
        control_times=log.control_times[acting],
        controls=log.controls[acting],
        observation_times=log.observation_times[seen],
        observation_ids=log.observation_ids[seen],
        observations=log.observations[seen],
        landmark_ids=log.landmark_ids,
        end_time=end,
        increments=log.increments,
        truth=log.truth,
    )


def _note(notes: Sequence[str]) -> str | None:
    more = f"; and {len(notes) - 3} more" if len(notes) > 3 else ""
    return "; ".join(notes[:3]) + more if notes else None


def _text(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"


# -- where the parts are made -----------------------------------------------------------------------------------------


def _performed(
    setup: _Setup, tasks: Sequence[_Task], jobs: int, backend: str
) -> Generator[tuple[_Task, _Part], None, None]:
    """Every task with what became of it, in the order in which they are finished."""
    if not tasks:
        return
    if backend == "processes":
        from joblib import delayed

        with _workers(jobs) as parallel:
            _compile([setup], parallel)
            yield from parallel(delayed(_labelled)(setup, task) for task in tasks)
        return
    with _client(jobs, backend) as (distributed, client):
        [common] = client.scatter([setup], broadcast=True, hash=False)
        futures = [client.submit(_labelled, common, task, pure=False) for task in tasks]
        try:
            for _, result in distributed.as_completed(futures, with_results=True):
                yield result
        finally:
            client.cancel(futures)


@contextmanager
def _workers(jobs: int) -> Iterator[Any]:
    """Joblib's worker processes, which last from one call to the next."""
    from joblib import Parallel, parallel_config

    # One thread each: with more, linear algebra sums in another order, and the result would depend on the jobs.
    with parallel_config("loky", n_jobs=jobs, inner_max_num_threads=1):
        yield Parallel(return_as="generator_unordered", batch_size=1)


def _compile(setups: Sequence[_Setup], parallel: Any) -> None:
    """Let each process compile a share: otherwise all of them would begin with the same functions."""
    from joblib import delayed

    functions: dict[MachineCode, None] = {}
    for setup in setups:
        for name in setup.filters:
            # What a filter of the user's own cannot do is recorded in its trials.
            with suppress(Exception):
                functions.update(dict.fromkeys(setup.make(name)._compiles()))
    for _ in parallel(delayed(_compile_one)(*f) for f in functions):
        pass


def _compile_one(function: Compiled, attribute: str) -> None:
    # Likewise what does not compile.
    with suppress(Exception):
        getattr(function, attribute)


def _labelled(setup: _Setup, task: _Task) -> tuple[_Task, _Part]:
    return task, _perform(setup, task)


@contextmanager
def _client(jobs: int, backend: str) -> Iterator[tuple[Any, Any]]:
    """Dask's module and the client that was asked for; one that is made here is closed."""
    try:
        dask: Any = import_module("distributed")
    except ImportError:
        raise InputError(f"backend {backend!r} needs Dask: install slamkit[dask]") from None
    if backend != "dask":
        with dask.Client(backend) as client:
            yield dask, client
        return
    try:
        client = dask.get_client()
    except ValueError:
        workers = None if jobs == -1 else jobs
        local = {"threads_per_worker": 1, "processes": True, "dashboard_address": None}
        with dask.LocalCluster(n_workers=workers, **local) as cluster, dask.Client(cluster) as client:
            yield dask, client
        return
    yield dask, client


@contextmanager
def _reporting(progress: bool | Callable[[int, int], None], total: int) -> Iterator[Callable[[int], None]]:
    """A function that is told how many parts are done."""
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


# -- the folder -------------------------------------------------------------------------------------------------------

_STUDY = "study.npz"
_TRIAL_ARRAYS = ("errors", "sigmas", "nees", "dof")
_CHECK_ARRAYS = ("times", "deviations")


@dataclass(frozen=True)
class _Store:
    """A study's folder: study.npz, one trial-….npz a run, one gauge-….npz a filter."""

    folder: Path
    filters: Sequence[str]

    @classmethod
    def open(cls, folder: PathLike, facts: Mapping[str, Any], times: Array, runs: int) -> _Store:
        """A folder for a study with these settings; refused where it holds one with others."""
        folder = Path(folder)
        path = folder / _STUDY
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"folder {folder} cannot be made: {error.strerror}") from None
        if path.exists():
            with reading(path, "study"):
                found, _ = read_archive(path, "study")
                there = int(found.pop("runs"))
            differing = [n for n in {**facts, **found} if facts.get(n) != found.get(n)]
            if differing:
                n = differing[0]
                pair = [found.get(n), facts.get(n)]
                if n == "filters" and list(pair[0] or ()) != list(pair[1] or ()):
                    pair = [", ".join(names or ()) for names in pair]  # they say more than the digests
                raise InputError(
                    f"{folder} holds a study with other settings: {', '.join(differing)} ({n} is {pair[0]!r} there, "
                    f"{pair[1]!r} here); choose another folder, or the same settings"
                )
            runs = max(runs, there)
        write_archive(path, "study", {**facts, "runs": runs}, {"times": times})
        return cls(folder, list(facts["filters"]))

    def path(self, task: _Task) -> Path:
        name, k = task
        return self.folder / (f"gauge-{self.filters.index(name)}.npz" if name else f"trial-{k:06d}.npz")

    def write(self, task: _Task, part: _Part) -> None:
        if isinstance(part, GaugeCheck):
            facts = _scalars(part, _CHECK_ARRAYS)
            write_archive(self.path(task), "gauge check", facts, {n: getattr(part, n) for n in _CHECK_ARRAYS})
            return
        arrays = {f"{row}.{n}": getattr(t, n) for row, t in enumerate(part) for n in _TRIAL_ARRAYS}
        write_archive(self.path(task), "trial", {"trials": [_scalars(t, _TRIAL_ARRAYS) for t in part]}, arrays)

    def read(self, tasks: Iterable[_Task]) -> dict[_Task, _Part]:
        """The parts that are there."""
        parts: dict[_Task, _Part] = {}
        for task in tasks:
            path = self.path(task)
            if not path.exists():
                continue
            if task[0]:
                with reading(path, "gauge check"):
                    facts, arrays = read_archive(path, "gauge check")
                    parts[task] = GaugeCheck(**(facts | {n: arrays[n] for n in _CHECK_ARRAYS}))
                continue
            with reading(path, "trial"):
                facts, arrays = read_archive(path, "trial")
                found = [
                    Trial(**(scalars | {n: arrays[f"{row}.{n}"] for n in _TRIAL_ARRAYS}))
                    for row, scalars in enumerate(facts["trials"])
                ]
                if [t.filter for t in found] != list(self.filters) or any(t.number != task[1] for t in found):
                    raise LogFileError(f"{path} holds other trials than its name says, or of other filters")
                parts[task] = found
        return parts


def _study(
    facts: Mapping[str, Any], times: Array, runs: int, parts: Mapping[_Task, _Part], origin: _Setup | None
) -> Study:
    names = list(facts["filters"])
    trials: dict[str, list[Trial]] = {name: [] for name in names}
    for k in range(runs):
        part = parts["", k]
        assert isinstance(part, list)
        for trial in part:
            trials[trial.filter].append(trial)
    checks = {name: parts[name, -1] for name in names if (name, -1) in parts}
    return Study(
        facts=MappingProxyType(dict(facts)),
        times=times,
        trials=MappingProxyType({name: tuple(t) for name, t in trials.items()}),
        gauge=MappingProxyType({name: c for name, c in checks.items() if isinstance(c, GaugeCheck)}),
        _origin=origin,
    )


def _scalars(part: Trial | GaugeCheck, arrays: Sequence[str]) -> dict[str, Any]:
    return {f.name: getattr(part, f.name) for f in fields(part) if f.name not in arrays}


def _digest(value: object) -> str:
    """A short name of a value: equal for equal content, in every process."""
    hash_ = hashlib.sha256()
    _feed(hash_, value)
    return hash_.hexdigest()[:16]


def _feed(hash_: Any, value: Any) -> None:
    kind = value if isinstance(value, type) or hasattr(value, "__qualname__") else type(value)
    hash_.update(f"<{kind.__module__}.{kind.__qualname__}>".encode())
    if isinstance(value, np.ndarray):
        hash_.update(f"{value.dtype.str}{value.shape}".encode() + np.ascontiguousarray(value).tobytes())
    elif isinstance(value, Mapping):
        for key, item in value.items():
            _feed(hash_, key)
            _feed(hash_, item)
    elif isinstance(value, list | tuple):
        for item in value:
            _feed(hash_, item)
    elif value is None or isinstance(value, bool | int | float | complex | str | bytes | np.generic):
        hash_.update(repr(value).encode())
    elif kind is not value:
        named = [f.name for f in fields(value)] if is_dataclass(value) else list(getattr(value, "__dict__", {}))
        _feed(hash_, {name: getattr(value, name) for name in named})


# -- numbers and their text -------------------------------------------------------------------------------------------


def _mean(key: str, values: Iterable[float]) -> dict[str, float | None]:
    """Mean over the runs that have a value, and its standard error."""
    v = np.array(list(values), dtype=float)
    v = v[np.isfinite(v)]
    error = float(np.std(v, ddof=1) / np.sqrt(len(v))) if len(v) > 1 else None
    return {key: float(v.mean()) if len(v) else None, f"{key}_se": error}


def _root_mean(key: str, squares: Iterable[float], weights: Iterable[int] | None = None) -> dict[str, float | None]:
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


def _bounds(dof: float, runs: int, scale: float = 1.0, probability: float = 0.95) -> tuple[float | None, float | None]:
    """Bounds of the mean over the runs of a χ² variable times a scale."""
    if not runs:
        return None, None
    bounds = evaluate.chi2_bounds(dof, runs, probability)
    return scale * float(bounds.lower), scale * float(bounds.upper)


def _number(value: float | None, form: str, scale: float = 1) -> str:
    return "–" if value is None else format(scale * value, form)


def _cell(values: Mapping[str, Any], key: str, digits: int) -> str:
    if values[key] is None or values[f"{key}_se"] is None:
        return _number(values[key], f".{digits}f")
    return f"{values[key]:.{digits}f} ± {values[f'{key}_se']:.{digits}f}"


def _count(n: int, noun: str) -> str:
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def _markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    def line(cells: Sequence[str]) -> str:
        return "| " + " | ".join(c.replace("|", "\\|").replace("\n", " ") for c in cells) + " |"

    return [line(head), line(["---"] * len(head)), *map(line, rows)]


@contextmanager
def _figure(width: float, height: float) -> Iterator[Figure]:
    """An empty figure in the style of `slamkit.plots`, which holds while it is drawn."""
    import matplotlib
    from matplotlib.figure import Figure

    from slamkit import plots

    with matplotlib.rc_context(plots._PAPER):
        yield Figure(figsize=(width, height), layout="constrained")
