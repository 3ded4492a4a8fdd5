"""How a filter keeps a large covariance."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from numbers import Real
from pathlib import Path
from typing import Any

import psutil

from slamkit.errors import InputError, MemoryCapError

#: Landmarks above which a filter defers corrections unless it is told otherwise.
COMPRESS_ABOVE = 64


@dataclass(frozen=True)
class Storage:
    """How a filter keeps a large covariance. No choice changes an estimate by more than rounding.

    Parameters
    ----------
    compress_above : int, optional
        Number of landmarks above which the filter defers updates to landmarks that are out of view. None: above 64,
        unless deferring turns out to cost more, as on a small map where nearly every landmark is always in view. An
        estimator whose every update moves every landmark never defers.
    flush_work : float, optional
        Multiply-adds that one step may spend on a flush. The flush is then spread over as many steps as it needs.
        None: each flush is done at once. One core does 10 to 40 multiply-adds in a nanosecond.
    memory_cap : float, optional
        Largest covariance [bytes]. None: four fifths of the machine's memory.

    Raises
    ------
    InputError
        A number is not positive, or not a number.
    """

    compress_above: int | None = None
    flush_work: float | None = None
    memory_cap: float | None = None

    def __post_init__(self) -> None:
        numbers: dict[str, Any] = {"flush_work": self.flush_work, "memory_cap": self.memory_cap}
        for name, value in numbers.items():
            if value is not None and not (_is(Real, value) and value > 0):
                raise InputError(f"{name} is {value!r}, expected None or a number > 0")
        if self.compress_above is not None and not (_is(Real, self.compress_above) and self.compress_above >= 0):
            raise InputError(f"compress_above is {self.compress_above!r}, expected None or a number of landmarks ≥ 0")

    @property
    def limit(self) -> int:
        """Number of landmarks above which updates are deferred."""
        return COMPRESS_ABOVE if self.compress_above is None else self.compress_above

    @property
    def cap(self) -> float:
        """Largest covariance [bytes]."""
        return _machine_memory() if self.memory_cap is None else self.memory_cap

    def afford(self, size: int, what: str) -> None:
        """Raise MemoryCapError unless `size` bytes are within the cap."""
        if size > self.cap:
            raise MemoryCapError(
                f"{what} takes {size / 1e9:.3g} GB, the cap is {self.cap / 1e9:.3g} GB: Storage(memory_cap=…) sets it"
            )


def _is(kind: type, value: object) -> bool:
    """Whether this is a number of a kind; a bool is not one here."""
    return isinstance(value, kind) and not isinstance(value, bool)


@cache
def _machine_memory() -> float:
    """Four fifths of the machine's memory [bytes]."""
    return 0.8 * float(psutil.virtual_memory().total)


@cache
def half_of_cache() -> float:
    """Half of the machine's largest cache [bytes]; a usual size where the system does not say, as outside Linux."""
    sizes = []
    with suppress(OSError):
        for path in Path("/sys/devices/system/cpu/cpu0/cache").glob("index*/size"):
            sizes.append(path.read_text(encoding="ascii").strip())
    found = [int(size[:-1]) for size in sizes if size[:-1].isdecimal() and size[-1] == "K"]
    return 512.0 * max(found, default=16384)
