"""``slamkit fetch NAME N``: download a data set."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.progress import DownloadColumn

from slamkit.cli.errors import RunError
from slamkit.cli.options import completing
from slamkit.cli.printing import bar
from slamkit.datasets import DATASETS
from slamkit.errors import LogFileError

__all__ = ["fetch_set"]

OFFERED = [name for name, data_set in DATASETS.items() if data_set.source is not None]


def fetch_set(
    name: Annotated[
        str,
        typer.Argument(metavar="NAME", help=f"Data set: {', '.join(OFFERED)}.", autocompletion=completing(OFFERED)),
    ],
    number: Annotated[int, typer.Argument(metavar="N", help="Number of the set.")],
    folder: Annotated[
        Path | None,
        typer.Option("--folder", metavar="DIR", help="Where to put it. Default: the user's cache folder."),
    ] = None,
    base_url: Annotated[
        str | None,
        typer.Option("--base-url", metavar="URL", help="Another address of the folder with the sets' files."),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print the path only, without progress.")] = False,
) -> None:
    """Download a set from its official address, unless it is there already, and print its path."""
    from slamkit.datasets.fetch import fetch

    try:
        with bar(quiet, DownloadColumn()) as progress:
            task = progress.add_task(f"{name} {number}", total=None)
            path = fetch(name, number, folder, base_url=base_url, progress=lambda n: progress.update(task, completed=n))
    except LogFileError as error:
        raise RunError(str(error)) from error
    print(path)
