"""Where the results of a run go."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from slamkit.cli.options import FIGURES
from slamkit.cli.printing import print_json
from slamkit.errors import InputError
from slamkit.evaluate.run_report import Assessment, write_figure, write_json, write_run
from slamkit.logs import Log

__all__ = ["STDOUT", "Outputs"]

STDOUT = Path("-")  #: what stands for standard output


@dataclass(frozen=True)
class Outputs:
    """The files that the options of a command ask for."""

    json: Path | None = None
    plot: Path | None = None
    out: Path | None = None
    save: Path | None = None

    @property
    def json_on_stdout(self) -> bool:
        """Whether standard output belongs to the JSON, so that tables go to stderr."""
        return self.json == STDOUT

    def prepare(self) -> None:
        """Make the folders, and refuse before the run what could not be written after it.

        Raises
        ------
        InputError
            A file is a folder, or the name of a figure has an unknown ending.
        OSError
            A folder cannot be made.
        """
        if self.plot is not None and self.plot.suffix.lower() not in FIGURES:
            raise InputError(f"--plot is {self.plot}, expected a name that ends in {', '.join(FIGURES)}")
        for file in (None if self.json_on_stdout else self.json, self.plot, self.save):
            if file is not None:
                if file.is_dir():
                    raise InputError(f"{file} is a folder, expected a file to write")
                file.parent.mkdir(parents=True, exist_ok=True)
        if self.out is not None:
            self.out.mkdir(parents=True, exist_ok=True)

    def write_json(self, facts: Any) -> None:
        """Write the numbers, if they are asked for."""
        if self.json_on_stdout:
            print_json(facts)
        elif self.json is not None:
            write_json(self.json, facts)

    def write(self, assessment: Assessment, log: Log, f: Any, title: str) -> None:
        """Write everything about a run that is asked for."""
        self.write_json(assessment.summary)
        if self.plot is not None:
            write_figure(self.plot, assessment.overview(log, title))
        if self.out is not None:
            write_run(self.out, assessment, log, title)
        if self.save is not None:
            f.save(self.save)
