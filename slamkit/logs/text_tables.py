"""Tables of numbers in text files, read with an error that names file, line and column, and written.

One reader for all text formats: fields between commas or between blanks, with or without a header, comments from # to
the end of a line, blank lines, a byte order mark, and any line ends.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from io import StringIO
from itertools import chain

import numpy as np

from slamkit.arrays import Array
from slamkit.errors import LogFileError

# Names of columns → whether a header may consist of them.
KnownHeader = Callable[[tuple[str, ...]], bool]


@dataclass(frozen=True, eq=False, repr=False)
class Table:
    """The rows of a text file: numbers, one column of texts where the format has one, and the line of each row."""

    name: str  #: the file, for an error message
    columns: tuple[str, ...]  #: names of all columns
    numbers: Array  #: (rows, columns without the text column)
    texts: list[str]  #: (rows,) the text column; empty where there is none
    _lines: Sequence[int] | Callable[[], Sequence[int]]

    def line(self, row: int) -> int:
        """Number of the line, from 1, on which a row stands."""
        lines = self._lines() if callable(self._lines) else self._lines
        return lines[row]

    def error(self, row: int, message: str) -> LogFileError:
        """The error that names the file and the line of a row."""
        return LogFileError(f"{self.name}:{self.line(row)}: {message}")


def read_table(
    name: str | os.PathLike[str],
    content: bytes,
    columns: Sequence[str] | None = None,
    *,
    header: tuple[KnownHeader, str] | None = None,
    delimiter: str | None = ",",
    text_column: str | None = None,
) -> Table:
    """Read a table of finite numbers.

    Parameters
    ----------
    name : str or path-like
        The file's name, for error messages.
    content : bytes
        The file: UTF-8, with or without a byte order mark. In a comment any byte is allowed.
    columns : sequence of str, optional
        Names of the columns of a file without a header.
    header : (callable, str), optional
        For a file whose first row names its columns: a function that says whether it knows such a header, and what it
        expects, in words.
    delimiter : str or None
        What stands between fields; None for blanks and tabs. With a comma, a field may stand in double quotes.
    text_column : str, optional
        Name of a column that holds texts, such as ids, instead of numbers.

    Raises
    ------
    LogFileError
        The header is missing or unknown, a row has the wrong number of fields, a field is not a finite number, a text
        is empty, or a byte is not UTF-8: file, line, column, what was given and what was expected.
    """
    name = str(name)
    text = content.decode("utf-8-sig", errors="surrogateescape")
    rows = _rows(name, text, delimiter)
    begin = 0
    if header is not None:
        begin, names = _read_header(name, rows, *header, delimiter)
    else:
        assert columns is not None, "a table has either columns or a header"
        names = tuple(columns)
    first = next(rows, None)
    if first is not None and text_column not in names:
        numbers = _numbers_at_once(text, begin, len(names), delimiter)
        if numbers is not None:

            def lines() -> list[int]:
                return [line for line, _ in _rows(name, text, delimiter) if line > begin]

            return Table(name, names, numbers, [], lines)
    rest = chain([first], rows) if first is not None else rows
    return _read_rows(name, rest, names, text_column, "," if delimiter == "," else " ")


def _numbers_at_once(text: str, skip: int, columns: int, delimiter: str | None) -> Array | None:
    """The numbers of all rows by NumPy's fast reader; None where a row has to be looked at, as it may be wrong."""
    lines = StringIO(text, newline=None)
    for _ in range(skip):
        lines.readline()
    try:
        numbers = np.loadtxt(lines, delimiter=delimiter, ndmin=2)
    except ValueError:
        return None
    return numbers if numbers.shape[1] == columns and np.isfinite(numbers).all() else None


def _read_header(
    name: str, rows: Iterator[tuple[int, list[str]]], known: KnownHeader, expected: str, delimiter: str | None
) -> tuple[int, tuple[str, ...]]:
    """Line and names of the header."""
    line, fields = next(rows, (0, []))
    if not fields:
        raise LogFileError(f"{name}: the file is empty, expected the header {expected}")
    if not known(tuple(fields)):
        other = _other_delimiter(fields, known) if delimiter == "," else None
        hint = f": is the delimiter {other!r}? expected ','" if other else ""
        given = ",".join(fields)
        raise LogFileError(f"{name}:{line}: header is {given!r}, expected {expected}{hint}")
    return line, tuple(fields)


def _other_delimiter(fields: list[str], known: KnownHeader) -> str | None:
    """The delimiter with which a header of one column would be known, or would at least have several columns."""
    if len(fields) != 1:
        return None
    found = [d for d in (";", "\t", "|", " ") if d in fields[0]]
    right = [d for d in found if known(tuple(field.strip() for field in fields[0].split(d)))]
    return next(iter(right + found), None)


def _read_rows(
    name: str, rows: Iterator[tuple[int, list[str]]], names: tuple[str, ...], text_column: str | None, between: str
) -> Table:
    """Read row by row, so that the first wrong one can be named."""
    at = names.index(text_column) if text_column in names else None
    expected = f"{len(names)}: {','.join(names)}"
    texts: list[str] = []
    numbers: list[list[float]] = []
    lines: list[int] = []
    for line, fields in rows:
        if len(fields) != len(names):
            given = between.join(fields)
            raise LogFileError(f"{name}:{line}: {len(fields)} fields {given!r}, expected {expected}")
        if at is not None:
            if not fields[at]:
                raise LogFileError(f"{name}:{line}: the {text_column} is empty, expected an integer or a name")
            texts.append(fields[at])
        numbers.append([_number(name, line, names, i, field) for i, field in enumerate(fields) if i != at])
        lines.append(line)
    array = np.reshape(np.array(numbers, dtype=float), (len(lines), len(names) - (at is not None)))
    return Table(name, names, array, texts, lines)


def _number(name: str, line: int, names: tuple[str, ...], column: int, field: str) -> float:
    try:
        # Python reads 1_000 as a thousand, and digits of other scripts; no other program writes them so.
        value = float(field if field.isascii() and "_" not in field else "")
    except ValueError:
        wrong = f"{field!r} is not a number"
    else:
        if -np.inf < value < np.inf:
            return value
        wrong = f"{value} is not finite"
    raise LogFileError(f"{name}:{line}: {wrong}, expected {names[column]} in column {column + 1} of {','.join(names)}")


def _rows(name: str, text: str, delimiter: str | None) -> Iterator[tuple[int, list[str]]]:
    """Line number and fields of every row that holds any."""
    for number, line in enumerate(StringIO(text, newline=None), 1):
        row = line.partition("#")[0].strip()
        if not row:
            continue
        wrong = next((c for c in row if "\udc80" <= c <= "\udcff"), None)
        if wrong is not None:
            raise LogFileError(f"{name}:{number}: byte {ord(wrong) - 0xDC00:#04x}, expected UTF-8 text")
        try:
            yield number, split_row(row, delimiter)
        except csv.Error as error:
            raise LogFileError(f"{name}:{number}: {row!r}: {error}, expected fields between commas") from None


def split_row(row: str, delimiter: str | None = ",") -> list[str]:
    """The fields of one row."""
    if delimiter == "," and '"' in row:
        fields = next(csv.reader([row], skipinitialspace=True, strict=True))
    else:
        fields = row.split(delimiter)
    return [field.strip() for field in fields]


def text_columns(*arrays: Array) -> list[list[str]]:
    """Columns of arrays (n,) or (n, m) as texts from which every number comes back to the last bit."""
    return [list(map(repr, column)) for a in arrays for column in np.atleast_2d(a.T).tolist()]


def csv_text(names: Iterable[str], columns: Sequence[Sequence[str]]) -> bytes:
    """A file of a header and the rows of these columns."""
    return "".join(f"{','.join(row)}\n" for row in [tuple(names), *zip(*columns, strict=True)]).encode()
