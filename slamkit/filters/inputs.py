"""Controls and sightings from outside, as arrays that compiled code can take."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from slamkit.arrays import Array, real_array
from slamkit.errors import InputError
from slamkit.logs import Scan

#: Stands for a control where there is none.
NO_CONTROL = np.zeros(1)


def control_array(u: ArrayLike, length: int, model: object) -> Array:
    """A control (m,) of the model's `length`, which is 0 where any is fine.

    Raises
    ------
    InputError
        It is not an array of numbers, or has another shape.
    """
    control = _taken_as_it_is("u", u)
    if control.ndim != 1 or len(control) == 0 or (length and len(control) != length):
        wanted = f"({length},)" if length else "(m,)"
        raise InputError(f"u has shape {control.shape}, {type(model).__name__} takes {wanted}")
    return control


def sightings(scan: Scan | Mapping[Hashable, ArrayLike], k: int, model: object) -> tuple[Sequence[Hashable], Array]:
    """Ids and measurements (n, k) of a scan.

    Raises
    ------
    InputError
        It is no scan, its arrays do not fit the sensor, or an id occurs twice or cannot be hashed.
    """
    values: Any
    ids: Sequence[Hashable]
    if isinstance(scan, Scan):
        ids, values = scan.ids, scan.z
    elif isinstance(scan, Mapping):
        ids, values = tuple(scan), list(scan.values())
    else:
        raise InputError(f"scan is a {type(scan).__name__}, expected a mapping id → z or a slamkit.Scan")
    z = _taken_as_it_is("scan", values)
    if len(ids) == 0 and z.size == 0:
        return (), np.empty((0, k))
    if z.shape != (len(ids), k):
        name = type(model).__name__
        raise InputError(f"the scan's z has shape {z.shape}, {len(ids)} sightings by {name} need ({len(ids)}, {k})")
    try:
        repeated = len(set(ids)) != len(ids)
    except TypeError as error:
        raise InputError(f"a landmark id of the scan is not hashable: {error}") from None
    if repeated:
        twice = next(i for n, i in enumerate(ids) if i in ids[:n])
        raise InputError(f"landmark {twice!r} occurs twice in one scan")
    return ids, z


def hashable(landmark_id: Hashable) -> Hashable:
    """The id, if it can be one.

    Raises
    ------
    InputError
        It cannot be hashed.
    """
    try:
        hash(landmark_id)
    except TypeError as error:
        raise InputError(f"a landmark id must be hashable: {error}") from None
    return landmark_id


def _taken_as_it_is(name: str, value: Any) -> Array:
    """An array that compiled code can read where it lies, without a copy; anything else as `real_array` gives it."""
    if type(value) is np.ndarray and value.dtype == np.float64 and value.flags.carray:
        return value
    return real_array(name, value)
