"""The sightings of one instant, and one step of a log."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence, Set
from dataclasses import dataclass
from typing import NamedTuple

from numpy.typing import ArrayLike

from slamkit.arrays import Array
from slamkit.errors import InputError


@dataclass(frozen=True, eq=False)
class Scan:
    """The landmarks sighted at one instant.

    Parameters
    ----------
    ids : sequence of hashable
        One id per sighting; no id twice.
    z : array_like (n, k)
        One measurement per row. It is kept as it is; a filter checks its numbers.

    Raises
    ------
    InputError
        `ids` is not a sequence, `z` has no rows, or their lengths differ.
    """

    ids: Sequence[Hashable]
    z: ArrayLike

    def __post_init__(self) -> None:
        if isinstance(self.ids, str | bytes | Mapping | Set) or not hasattr(self.ids, "__getitem__"):
            raise InputError(f"ids of a scan are {self.ids!r}, expected a sequence of ids such as a tuple")
        try:
            n, rows = len(self.ids), len(self.z)  # type: ignore[arg-type]
        except TypeError:
            raise InputError(f"z of a scan is {self.z!r}, expected one measurement per id, shape (n, k)") from None
        if n != rows:
            raise InputError(f"a scan has {n} ids and {rows} rows of z, expected as many rows as ids")

    def __len__(self) -> int:
        return len(self.ids)


class LogStep(NamedTuple):
    """One step of a log, as iterating over a :class:`Log` gives it."""

    time: float  #: end of the step [s]
    u: Array | None  #: control (m,); None where dt is 0
    dt: float  #: duration of the prediction [s]; 0 where there is nothing to predict
    scan: Scan  #: what is sighted at the end of the step
