"""``slamkit demo``: one simulated run, and a comparison of all filters, with figures and files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from slamkit import plots
from slamkit.cli.compare import study_with_bar, write_study
from slamkit.cli.csv_folder import write_log
from slamkit.cli.errors import running
from slamkit.cli.estimate import estimate
from slamkit.cli.models_file import Settings
from slamkit.cli.options import Quiet
from slamkit.cli.outputs import Outputs
from slamkit.cli.printing import bar, comparison_table, failures, output, remarks, run_table
from slamkit.evaluate.run_report import write_figure
from slamkit.filters import FILTERS
from slamkit.logs import Log
from slamkit.simulate import WORLDS, simulate

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["demo"]

SEED = 1
RUNS = 10  #: of the comparison


def demo(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Where to write.")] = Path("slamkit-demo"),
    quiet: Quiet = False,
) -> None:
    """Simulate the loop world (always the same run), run dead reckoning and EKF-SLAM, and write figures and files.

    Then compare all filters on a few runs of the standing world, where no sighting gives information about the heading.
    """
    from slamkit.study import prepare

    outputs = Outputs(out=out)
    outputs.prepare()
    world, standing = WORLDS["loop"](), WORLDS["standing"]()
    with running():
        with bar(quiet) as progress:
            progress.add_task("loading (the first run compiles for half a minute)", total=None)
            prepare(FILTERS, [world, standing])
        log = simulate(world, np.random.default_rng(SEED))
        write_log(out / "log", world, log)
        log.save(out / "log.npz")
        settings = Settings(world.motion, world.sensor, world.pose, world.pose_covariance)
        run = estimate(lambda: settings.make(FILTERS["ekf"]), log, settings.start, outputs, "loop world", quiet)
        write_figure(out / "correlation.png", correlation_figure(settings.make(FILTERS["ekf"]), log))
        title = "Ten loops of a simulated robot"
        output(run_table(title, run), f"Figures, log and numbers are in {out}", quiet=quiet)
        study = study_with_bar(quiet, dict(FILTERS), standing, RUNS, SEED)
        write_study(out / "comparison", study)
    title = f"A robot that stands still and looks {len(study.times)} times: {study.runs} runs"
    command = f"slamkit compare --world standing --filters all --runs {study.runs} --seed {study.seed}"
    where = f"Its figures are in {out / 'comparison'} ({command})"
    output("", comparison_table(study, title), *remarks(study), *failures(study), where, quiet=quiet)


def correlation_figure(f: Any, log: Log, instants: int = 60) -> Figure:
    """How the covariance becomes dense: with a third of the map, with the whole map, and at the end.

    Parameters
    ----------
    f : LandmarkFilter
        A new filter; it is run over the log.
    log : Log
    instants : int
        How many times the density is measured.
    """
    at = set(np.geomspace(1, len(log), instants).round().astype(int).tolist())  # most of them while the map grows
    covariances, times = [], []
    for step, (time, u, dt, scan) in enumerate(log, 1):
        if u is None:
            f.observe_scan(scan)
        else:
            f.step(u, dt, scan)
        if step in at and f.landmarks:
            covariances.append(f.P)
            times.append(time)
    dims = np.array([len(P) for P in covariances])
    shown = [int(np.argmax(dims >= 3 + (dims[-1] - 3) / 3)), int(np.argmax(dims == dims[-1])), len(dims) - 1]
    with plots.new_figure(10.0, 6.4) as figure:
        panels = figure.subplot_mosaic([["a", "b", "c"], ["density"] * 3], height_ratios=[1.3, 1.0])
        for panel, k in zip("abc", shown, strict=True):
            ids = f.landmark_ids[: (dims[k] - 3) // 2]
            plots.plot_correlation(panels[panel], covariances[k], ids, times[k], colorbar=panel == "c")
        plots.plot_density(panels["density"], covariances, times)
        panels["density"].set_xscale("log")
    return figure
