"""The result of a study."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from slamkit.arrays import Array
from slamkit.errors import InputError
from slamkit.logs import History, Log, PathLike
from slamkit.study import findings, folder, report, summary
from slamkit.study.gauge_check import GaugeCheck
from slamkit.study.tasks import Part, Task
from slamkit.study.trial import Trial, repeat

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from slamkit.study.settings import Settings


@dataclass(frozen=True, eq=False, repr=False)
class Study:
    """Filters compared over the same runs."""

    facts: Mapping[str, Any]  #: the settings, as a file keeps them
    times: Array  #: (K,) time at the end of each step [s]
    trials: Mapping[str, tuple[Trial, ...]]  #: filter → its trial in every run
    gauge: Mapping[str, GaugeCheck]  #: filter → its gauge check; empty if none was made
    start_time: float = 0.0  #: time at which the first step begins [s]
    _origin: Settings | None = None

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
    def simulated(self) -> bool:
        """Whether the runs were simulated; otherwise they are one recorded log, aligned with its truth."""
        return bool(self.facts["simulated"])

    @property
    def failures(self) -> list[Trial]:
        """Trials that failed or diverged."""
        return [t for trials in self.trials.values() for t in trials if t.diverged]

    @property
    def all_failed(self) -> bool:
        """Whether no filter finished any run, so that the study has no numbers."""
        return not any(self.finished(name) for name in self.trials)

    @property
    def unobservable(self) -> int | None:
        """How many of the gauge's three directions the motion and the sensor model leave unobservable.

        3, unless something anchors the map, such as a sensor that measures bearings from north. None if there was no
        gauge check. See :class:`GaugeCheck`.
        """
        return next((c.unobservable for c in self.gauge.values() if c.unobservable is not None), None)

    def finished(self, filter: str) -> list[Trial]:
        """Trials that a filter finished, diverged or not. Its numbers are taken over these.

        Raises
        ------
        InputError
            There is no such filter in the study.
        """
        return [t for t in self._trials(filter) if t.error is None]

    def rerun(self, k: int, filter: str) -> tuple[History, Log]:
        """Run trial k of one filter again, in this process; see :func:`run_trial`.

        Raises
        ------
        InputError
            There is no such trial, or the study was loaded: its files hold no world.
        """
        self._trials(filter)
        if self._origin is None:
            raise InputError(f"a loaded study has no world to run: call run_trial(world, {self.seed}, {k}, {filter!r})")
        return repeat(self._origin, k, filter)

    def summary(self) -> dict[str, dict[str, Any]]:
        """Every filter in numbers that JSON can hold; None if there is no value.

        Returns
        -------
        dict
            Filter → dict with

            - ``pose_nees``, ``position_nees``, ``heading_nees``: mean over the runs of the mean over the steps, scaled
              to 3, 2 and 1 degrees of freedom. A step with a singular P counts with the rank of P.
              ``pose_nees_median``: median over the runs. ``pose_nees_above_6``: share of the runs with a mean above 6.
              ``pose_nees_low``, ``pose_nees_high``: 95 % bounds of the mean of M independent values
              (:func:`slamkit.evaluate.chi2_bounds`). They hold at one step; means over steps scatter less;
            - ``position_rmse_m``, ``heading_rmse_deg`` over all steps and runs;
            - ``landmark_nees`` (2 degrees of freedom) and ``landmark_rmse_m`` of the final map;
            - ``gauge_nees``, ``gauge_nees_median`` (3 degrees of freedom) and ``relative_nees_per_dof`` of the final
              state (:func:`slamkit.evaluate.gauge.nees_split`), with their 95 % bounds ``gauge_nees_low``,
              ``gauge_nees_high``, ``relative_nees_low`` and ``relative_nees_high``;
            - ``nis_per_dof``: mean over the runs of the mean NIS per degree of freedom. It needs no truth;
            - ``nullity``, ``gauge_deviation_drop``, ``stochastic_gauge_m``, ``equivariance``: see :class:`GaugeCheck`;
            - ``seconds_per_step``: median over the runs;
            - ``runs``; ``finished``: runs that enter the numbers; ``failed``: runs in which the filter raised or gave
              values that are not finite; ``diverged``: failed runs and runs beyond the study's limit. A diverged run
              that finished enters the numbers;
            - ``…_se``: standard errors over the runs.
        """
        return {name: summary.summarise(self, name) for name in self.trials}

    def findings(self) -> list[str]:
        """What the numbers show, in sentences.

        Returns
        -------
        list of str
            Which filters claim too little uncertainty, in the gauge or in the relative map; whether the gauge explains
            all of the standard EKF's inconsistency; for a recorded log, which filters claim to have learnt the gauge;
            or that every trial failed. May be empty.

        Notes
        -----
        A filter claims too little uncertainty if its mean NEES of the final state
        (:func:`slamkit.evaluate.gauge.nees_split`) is above a bound. Consistent filters, all of the study together,
        exceed their bounds in either part with a probability of 5 % (Bonferroni). A filter claims to have learnt the
        gauge if the gauge deviation falls by more than a thousandth although all three directions of the gauge are
        unobservable. A recorded log is aligned with its truth, so its errors show nothing about the gauge.
        """
        return findings.findings(self)

    def table(self) -> list[dict[str, Any]]:
        """One row for each trial. :meth:`to_csv` writes the same rows, :meth:`frame` gives them as a DataFrame.

        Returns
        -------
        list of dict
            Keys: filter, trial, error, diverged, note, pose_nees, position_nees, heading_nees, position_rmse_m,
            heading_rmse_deg, landmarks, landmark_nees, landmark_rmse_m, gauge_nees, gauge_dof, relative_nees_per_dof,
            nis_per_dof, seconds_per_step; NaN if there is no number.
        """
        return summary.table_rows(self)

    def to_csv(self, path: PathLike | None = None) -> str:
        """:meth:`table` as CSV: a header, then one line for each trial. An empty field means that there is no value.

        Parameters
        ----------
        path : path, optional
            File to write as well.

        Returns
        -------
        str
        """
        return report.written(report.csv_text(self), path)

    def to_latex(self, path: PathLike | None = None) -> str:
        """The main numbers of :meth:`summary` as a LaTeX tabular: one line for each filter, ± one standard error.

        Parameters
        ----------
        path : path, optional
            File to write as well.

        Returns
        -------
        str
            Needs no LaTeX package.
        """
        return report.written(report.latex_text(self), path)

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
        """The study as Markdown: accuracy and consistency, the gauge, failed trials and numbers that are left out."""
        return report.markdown_text(self)

    def __repr__(self) -> str:
        return f"<Study of {report.size(self)}: {', '.join(self.filters)}{report.failed(self)}>"

    def _repr_html_(self) -> str:
        return report.html_text(self)

    def figures(self) -> dict[str, Figure]:
        """The study's figures: overview, nees, claims, coverage, bars, cost and gauge.

        Returns
        -------
        dict
            Name → figure; write one with :func:`slamkit.plots.save`. Without a truth only gauge is there, and gauge
            needs a gauge check.
        """
        from slamkit.study.figures import figures

        return figures(self)

    def overview(self) -> Figure:
        """The study in one figure.

        Returns
        -------
        Figure
            Above, the NEES per degree of freedom of every filter's final state in two parts that add up: the relative
            map and the gauge. If no NEES could be split, the pose takes the gauge's place. Below on the left, the
            gauge deviation in the gauge check. Below on the right, the heading error of the standard EKF beside what
            it claims; without the standard EKF, of the filter with the largest gauge NEES.

        Raises
        ------
        InputError
            No trial has a truth.
        """
        from slamkit.study.figures import overview

        return overview(self)

    def save(self, folder_: PathLike) -> None:
        """Write the study into a folder, which is made if it does not exist; :meth:`load` reads it.

        Raises
        ------
        InputError
            The folder holds a study with other settings.
        """
        store = folder.Store.open(folder_, self.facts, self.times)
        store.begin(self.start_time, self.runs)
        for name, check in self.gauge.items():
            store.write(Task(-1, name), check)
        for k in range(self.runs):
            store.write(Task(k), [self.trials[name][k] for name in self.trials])

    @classmethod
    def load(cls, folder_: PathLike) -> Study:
        """Read a study that :func:`compare` or :meth:`save` left in a folder.

        Raises
        ------
        LogFileError
            There is no study, it is unfinished, or a file is damaged or belongs to another study. The message names
            the file.
        """
        store, start_time, runs, parts = folder.load(folder_)
        return assemble(store.facts, store.times, start_time, runs, parts, None)

    def _trials(self, filter: str) -> tuple[Trial, ...]:
        if filter not in self.trials:
            raise InputError(f"no filter {filter!r} in the study, it has {', '.join(self.trials)}")
        return self.trials[filter]


def assemble(
    facts: Mapping[str, Any],
    times: Array,
    start_time: float,
    runs: int,
    parts: Mapping[Task, Part],
    origin: Settings | None,
) -> Study:
    """A study from its parts."""
    names = list(facts["filters"])
    trials: dict[str, list[Trial]] = {name: [] for name in names}
    for k in range(runs):
        part = parts[Task(k)]
        assert isinstance(part, list)
        for trial in part:
            trials[trial.filter].append(trial)
    checks = {name: parts[Task(-1, name)] for name in names if Task(-1, name) in parts}
    return Study(
        facts=MappingProxyType(dict(facts)),
        times=times,
        trials=MappingProxyType({name: tuple(t) for name, t in trials.items()}),
        gauge=MappingProxyType({name: c for name, c in checks.items() if isinstance(c, GaugeCheck)}),
        start_time=start_time,
        _origin=origin,
    )
