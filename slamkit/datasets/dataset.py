"""What a reader of a data set offers: its name, its options, its defaults, and where the data come from."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Final

from numpy.typing import ArrayLike

from slamkit.arrays import finite_number
from slamkit.errors import InputError
from slamkit.logs import Log
from slamkit.protocols import MotionModel, SensorModel

REQUIRED: Final = object()  #: the default of an option that has to be given


@dataclass(frozen=True, eq=False, repr=False)
class Recording:
    """A log that was read from a data set, and the defaults that suit it."""

    log: Log
    title: str  #: what the log is, for a table or a figure, such as ``"MRCLAM set 1, robot 3"``
    motion: MotionModel  #: motion model with the default noise
    sensor: SensorModel  #: sensor model with the default noise
    gate: float | None = None  #: largest NIS to accept; None accepts every sighting
    pose: ArrayLike = (0.0, 0.0, 0.0)  #: where a filter starts [m, m, rad]
    pose_covariance: ArrayLike | None = None  #: (3, 3) of that pose; None means that it is exact
    notes: tuple[str, ...] = ()  #: sentences about what was left out or corrected

    def __repr__(self) -> str:
        return f"Recording({self.title!r}, {self.log!r})"


@dataclass(frozen=True)
class Option:
    """An option of a reader, both a keyword of :meth:`DataSet.read` and an option of the command line.

    An option `long_name` is ``--long-name`` on the command line.
    """

    name: str  #: a Python identifier
    kind: type  #: int, float, str or bool
    help: str  #: one sentence
    default: Any = REQUIRED  #: REQUIRED where the option has to be given
    choices: tuple[str, ...] = ()  #: the values that an option of kind str may have; empty allows any
    metavar: str | None = None  #: what stands for the value in a help text, such as ``"K"``

    def check(self, value: Any) -> Any:
        """Return `value` as this option's kind.

        Raises
        ------
        InputError
            It is of another kind, not finite, or not one of the choices.
        """
        if value is None and self.default is None:
            return None
        if self.kind is float:
            return finite_number(self.name, value)
        if self.kind is str and isinstance(value, os.PathLike):
            value = os.fspath(value)
        if not isinstance(value, self.kind) or (self.kind is int and isinstance(value, bool)):
            raise InputError(f"{self.name} is {value!r}, expected {_KINDS[self.kind]}")
        if self.choices and value not in self.choices:
            raise InputError(f"{self.name} is {value!r}, expected one of {', '.join(self.choices)}")
        return value


_KINDS: dict[type, str] = {int: "an integer", str: "text", bool: "True or False"}


@dataclass(frozen=True)
class Source:
    """Where the publishers of a data set offer its files."""

    base_url: str  #: official address of the folder with the files
    file: str  #: name of a file, with ``{number}`` for the number of a set
    numbers: range  #: numbers of the sets
    check: Callable[[Path], None]  #: raises LogFileError where a file is damaged or is not a set


@dataclass(frozen=True, repr=False)
class DataSet:
    """One kind of data set: how its files are read, and what it is.

    To add one, write a module with a reader and a DataSet, and list that in ``slamkit/datasets/registry.py``. The
    command line, the help texts and the documentation follow from it. A data set of your own is registered with
    ``DATASETS.register(name, data_set)`` or named ``module:attribute`` on the command line.
    """

    name: str  #: name on the command line, such as ``"victoria-park"``
    description: str  #: one line
    citation: str  #: the publication that its authors ask to be cited
    path: str  #: what a path names: ``"ZIP"``, ``"DIR"`` or ``"FILE"``
    path_help: str  #: one sentence about that path
    reader: Callable[..., Recording]  #: ``reader(path, **options)``
    options: tuple[Option, ...] = ()
    source: Source | None = None  #: where :func:`slamkit.datasets.fetch` finds it; None where it cannot be fetched

    def __repr__(self) -> str:
        return f"DataSet({self.name!r}: {self.description})"

    def read(self, path: str | os.PathLike[str], **options: Any) -> Recording:
        """Read a log.

        Parameters
        ----------
        path : str or path-like
            As `path_help` says.
        **options
            Those in `options`, by name. An option with a default may be missing.

        Returns
        -------
        Recording

        Raises
        ------
        InputError
            An option is unknown, missing, of the wrong kind or out of range.
        LogFileError
            A file is missing, damaged, or of another form; the message names the file and, where it can, the line.
        """
        known = {option.name: option for option in self.options}
        for name in options:
            if name not in known:
                close = get_close_matches(name, known, 1)
                hint = f"; did you mean {close[0]}?" if close else ""
                raise InputError(f"{self.name} has no option {name!r}, expected {', '.join(known) or 'none'}{hint}")
        values = {}
        for name, option in known.items():
            value = options.get(name, option.default)
            if value is REQUIRED:
                raise InputError(f"{self.name} needs the option {name}: {option.help}")
            values[name] = option.check(value)
        return self.reader(path, **values)


def check_data_set(item: object) -> None:
    """Raise InputError where `item` is not a DataSet; the registry's check."""
    if not isinstance(item, DataSet):
        raise InputError(f"{item!r} is a {type(item).__name__}, expected a slamkit.datasets.DataSet")
