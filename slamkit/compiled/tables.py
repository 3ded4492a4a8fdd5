"""Tables: rows of memory that Python and compiled code share, field by field.

A table crosses into compiled code as one address, whatever it holds; compiled code loads its fields from the memory
behind it. A field is a number (``real``, ``index``, ``flag``), an array, a function, or another table, which lies
inside the row of the first. Nothing here imports Numba.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

__all__ = ["TABLES", "TILE", "OwnFields", "OwnNumbers", "Shared", "Table", "aligned"]

#: Doubles of a cache line. Tiles of a matrix have this many rows and columns.
TILE = 8

#: Array fields: dtype and number of dimensions.
ARRAYS: dict[str, tuple[Any, int]] = {
    "vector": (np.dtype(np.float64), 1),
    "matrix": (np.dtype(np.float64), 2),
    "cube": (np.dtype(np.float64), 3),
    "integers": (np.dtype(np.int64), 1),
    "flags": (np.dtype(np.bool_), 1),
}
NUMBERS = ("real", "index", "flag")

#: Every table that was declared, by name.
TABLES: dict[str, Table] = {}


class Table:
    """The declaration of a table.

    Parameters
    ----------
    name : str
        The word for it in the signatures of compiled functions.
    **fields
        For each field a word (``real``, ``index``, ``flag``, ``vector``, ``matrix``, ``cube``, ``integers``,
        ``flags``), the signature of a function such as ``"void(vector, real)"``, or another Table.

    Attributes
    ----------
    fields : dict
    first : dict
        Field → its first word in the row.
    words : int
        Length of the row, in words of eight bytes.
    """

    def __init__(self, name: str, **fields: str | Table) -> None:
        assert not {"table", "values", "address"} & fields.keys(), f"a reserved name in the table {name}"
        self.name, self.fields = name, fields
        self.first: dict[str, int] = {}
        self.words = 0
        for field, kind in fields.items():
            self.first[field] = self.words
            self.words += kind.words if isinstance(kind, Table) else _words(kind)
        TABLES[name] = self

    def __repr__(self) -> str:
        return f"Table({self.name!r}, {', '.join(self.fields)})"


def _words(kind: str) -> int:
    """An array takes its address and its shape, everything else one word."""
    return 1 + ARRAYS[kind][1] if kind in ARRAYS else 1


def is_function(kind: object) -> bool:
    """Whether a field's kind is the signature of a function."""
    return isinstance(kind, str) and "(" in kind


def aligned(shape: int | tuple[int, ...], dtype: DTypeLike = np.float64) -> NDArray[Any]:
    """An array of zeros that starts at a cache line: to load a vector register across two lines takes twice as long."""
    line, kind = 8 * TILE, np.dtype(dtype)
    size = kind.itemsize * int(np.prod(shape))
    memory = np.zeros(size + line, dtype=np.uint8)
    first = -memory.ctypes.data % line
    return memory[first : first + size].view(kind).reshape(shape)


class Shared:
    """A table in memory. Assigning to a field writes it where compiled code reads it, and the reverse.

    Parameters
    ----------
    table : Table
    **values
        A value for each field: a number, a C-contiguous array of the field's dtype, a compiled function, or a mapping
        for a table inside. Missing numbers are 0.
    """

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...

    def __init__(self, table: Table, **values: Any) -> None:
        self._place(table, aligned(table.words, np.int64), values)

    def _place(self, table: Table, row: NDArray[np.int64], values: Mapping[str, Any]) -> None:
        vars(self).update(table=table, _row=row, _reals=row.view(np.float64))
        for name, kind in table.fields.items():
            if isinstance(kind, Table):
                inside, first = Shared.__new__(Shared), table.first[name]
                inside._place(kind, row[first : first + kind.words], values.get(name, {}))
                vars(self)[name] = inside
            elif name in values:
                setattr(self, name, values[name])
            else:
                assert kind in NUMBERS, f"{table.name}.{name} is missing"

    def __setattr__(self, name: str, value: Any) -> None:
        table = self.table
        kind, at = table.fields[name], table.first[name]
        assert isinstance(kind, str), f"{table.name}.{name} is a table"
        if kind == "real":
            self._reals[at] = value
        elif kind in NUMBERS:
            self._row[at] = value
        else:
            if kind in ARRAYS:
                dtype, ndim = ARRAYS[kind]
                assert value.flags.c_contiguous and value.ndim == ndim and value.dtype == dtype, f"{table.name}.{name}"
                self._row[at : at + 1 + ndim] = value.ctypes.data, *value.shape
            else:
                vars(self).pop("address", None)
            vars(self)[name] = value

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            # Arrays, functions and tables inside are attributes of the object; numbers are in the row alone.
            fields = self.__dict__.get("table")
            kind = fields.fields.get(name) if fields is not None else None
            if kind == "real":
                return float(self._reals[fields.first[name]])
            if kind == "index":
                return int(self._row[fields.first[name]])
            if kind == "flag":
                return bool(self._row[fields.first[name]])
            raise AttributeError(name)

    @property
    def values(self) -> dict[str, Any]:
        """Every field by name; a mapping for a table inside."""
        return {
            name: getattr(self, name).values if isinstance(kind, Table) else getattr(self, name)
            for name, kind in self.table.fields.items()
        }

    def __getstate__(self) -> dict[str, Any]:
        return {"table": self.table.name, "values": self.values}

    def __setstate__(self, state: dict[str, Any]) -> None:
        table = TABLES[state["table"]]
        self._place(table, aligned(table.words, np.int64), state["values"])

    def __deepcopy__(self, memo: dict[int, Any]) -> Any:
        new = type(self).__new__(type(self))
        new._place(self.table, aligned(self.table.words, np.int64), _copied(self.values))
        return new

    @cached_property
    def address(self) -> int:
        """Address of the row, which compiled functions take. Functions are compiled now, unless they are already."""
        for name, kind in self.table.fields.items():
            if is_function(kind):
                from slamkit.compiled.cache import load_numba_types

                self._row[self.table.first[name]] = load_numba_types().address_of(getattr(self, name), str(kind))
        return int(self._row.ctypes.data)

    @cached_property
    def _numba_type_(self) -> Any:
        from slamkit.compiled.cache import load_numba_types

        return load_numba_types().table_type(self.table.name)


def _copied(value: Any) -> Any:
    """Arrays copied, so that each starts at a cache line; everything else as it is."""
    if isinstance(value, dict):
        return {name: _copied(inside) for name, inside in value.items()}
    if isinstance(value, np.ndarray):
        copy = aligned(value.shape, value.dtype)
        copy[...] = value
        return copy
    return value


class OwnFields:
    """The numbers that one estimator keeps beside its belief, by name.

    Declare them once in the estimator's file, name the declaration as the class's `own_fields`, and read or assign them
    in its functions, in Python and in compiled code alike. They are saved, loaded, copied and undone with the belief.

    Parameters
    ----------
    per_sighting : dict, optional
        Name → n for a matrix with a row of n numbers for each sighting of a scan. There may be one.
    **sizes : int
        Name → 1 for a number, n > 1 for a vector (n,).

    Examples
    --------
    >>> kept = OwnFields(alpha=1, start=3)
    >>> class State:
    ...     own = np.zeros(4)
    >>> mine = kept(State)
    >>> mine.alpha = 0.5
    >>> mine.start[2] = 1.0
    >>> State.own.tolist()
    [0.5, 0.0, 0.0, 1.0]
    """

    generic = False

    def __init__(self, per_sighting: Mapping[str, int] | None = None, **sizes: int) -> None:
        self.sizes, self.per_sighting = dict(sizes), dict(per_sighting or {})
        assert len(self.per_sighting) <= 1
        self.first: dict[str, int] = {}
        at = 0
        for name, size in sizes.items():
            self.first[name] = at
            at += size
        self.fixed = at  #: numbers that do not depend on the length of a scan
        for name in self.per_sighting:
            self.first[name] = at

    def size(self, sightings: int) -> int:
        """Length of ``state.own`` where scans have up to this many sightings."""
        return self.fixed + sightings * sum(self.per_sighting.values())

    def __call__(self, state: Any) -> OwnNumbers:
        return OwnNumbers(self, state.own)

    @property
    def plain(self) -> OwnFields:
        """What stands for it in Python: itself."""
        return self

    @cached_property
    def jitted(self) -> Any:
        """What stands for it in compiled code."""
        from slamkit.compiled.cache import load_numba_types

        return load_numba_types().own_accessor(self)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "jitted"}


class OwnNumbers:
    """An estimator's own numbers by name, in the memory of a state."""

    def __init__(self, fields: OwnFields, memory: NDArray[np.float64]) -> None:
        vars(self).update(_fields=fields, _memory=memory)

    def __getattr__(self, name: str) -> Any:
        fields, memory = vars(self)["_fields"], vars(self)["_memory"]
        if name in fields.per_sighting:
            return memory[fields.fixed :].reshape(-1, fields.per_sighting[name])
        if name not in fields.sizes:
            raise AttributeError(name)
        at, size = fields.first[name], fields.sizes[name]
        return float(memory[at]) if size == 1 else memory[at : at + size]

    def __setattr__(self, name: str, value: Any) -> None:
        fields = vars(self)["_fields"]
        if name not in fields.sizes:
            raise AttributeError(name)
        at, size = fields.first[name], fields.sizes[name]
        vars(self)["_memory"][at : at + size] = value
