"""``slamkit simulate WORLD``: simulate a run and write it as a log."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from slamkit.cli.csv_folder import write_log
from slamkit.cli.options import Quiet, completing
from slamkit.cli.printing import output
from slamkit.cli.worlds import find_world
from slamkit.simulate import WORLDS, simulate

__all__ = ["simulate_world"]


def simulate_world(
    world: Annotated[
        str,
        typer.Argument(
            metavar="WORLD",
            help=f"One of {', '.join(WORLDS)}, or module:function of your own.",
            autocompletion=completing(WORLDS),
        ),
    ],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Where to write.")],
    seed: Annotated[int, typer.Option("--seed", metavar="S", min=0, help="The same seed gives the same bytes.")] = 0,
    quiet: Quiet = False,
) -> None:
    """Simulate a run and write it as CSV files, with its truth. models.json says which models and noise made it."""
    made = find_world(world)
    log = simulate(made, np.random.default_rng(seed))
    write_log(out, made, log)
    output(f"{len(log)} steps and {len(log.observations)} sightings are in {out}", quiet=quiet)
