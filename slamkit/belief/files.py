"""A belief as named arrays, for files: what is written, and what arrays must be before they become a belief."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slamkit.belief.belief import Belief
from slamkit.belief.layout import BASE, BLOCK, FIELDS
from slamkit.belief.packed import PANEL, expand, packed_bytes
from slamkit.errors import InputError

#: dtype and shape of every array, see `slamkit.belief.layout.Field`. ``n`` is the length of the estimator's own fields.
FORMS: dict[str, tuple[Any, tuple[str | int, ...]]] = {
    f"{part}.{name}": (np.int64 if field.kind in ("index", "integers") else np.float64, field.file)
    for part, fields in FIELDS.items()
    for name, field in fields.items()
    if field.file is not None
} | {"last.w": (np.float64, ("update", "dim")), "own": (np.float64, ("n",))}

#: May hold an infinity, which means that there is no bound.
UNBOUNDED = ("resting.most_columns",)

#: Largest D for which the covariance is checked by a decomposition, O(D³). Above it every pair of entries is checked.
DECOMPOSED = 600


def to_arrays(belief: Belief) -> dict[str, NDArray[Any]]:
    """Everything that `load_arrays` needs to continue exactly; flushes first."""
    belief.flush()
    belief._pack()
    belief._reads = 0
    s, D, rows = belief.state, belief.active, belief.state.last.rows
    held = {"active": D, "dim": belief.dim, "update": rows}
    out: dict[str, NDArray[Any]] = {}
    for name, (dtype, shape) in FORMS.items():
        part, _, field = name.partition(".")
        if name == "last.w":
            out[name] = belief.gain_rows
        elif name == "own":
            out[name] = s.own[: belief.own_fields.fixed]
        else:
            value = np.asarray(getattr(getattr(s, part), field), dtype=dtype)
            out[name] = value[tuple(slice(0, held.get(n) if isinstance(n, str) else n) for n in shape)]
    out["belief.cov"] = np.tril(out["belief.cov"])
    return out


def load_arrays(belief: Belief, ids: Iterable[Hashable], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Let a belief of no landmarks become the one that arrays of the right dtypes and number of dimensions describe.

    Raises
    ------
    InputError
        The arrays do not fit each other, the ids or the belief, or hold what no belief can.
    """
    number = {name: a.item() for name, a in arrays.items() if a.shape == ()}
    named = tuple(ids)
    slots = {i: belief.base + BLOCK * n for n, i in enumerate(named)}
    D, dim, C = number["belief.active"], number["belief.dim"], number["resting.columns"]
    if len(slots) != len(named) or belief.base + BLOCK * len(slots) != dim:
        raise InputError(f"the file holds {len(slots)} different landmark ids and a state of {dim} dimensions")
    resting = len(arrays["resting.mean"])
    if C == 0:
        expected = {"active": dim, "resting": resting, "store": packed_bytes(resting) // 8}
    else:
        if not C == BASE == belief.base:
            raise InputError(
                f"resting.columns is {C}, expected 0 or {BASE} for a filter with {belief.base} base entries"
            )
        expected = {"active": BASE, "resting": max(resting, dim), "store": packed_bytes(resting) // 8}
    if resting % PANEL:
        raise InputError(f"resting.mean has {resting} entries, expected a multiple of {PANEL}")
    rows = len(arrays["last.y"])
    expected |= {"dim": dim, "update": rows, "n": belief.own_fields.fixed}
    if expected["active"] != D or number["last.rows"] != rows:
        raise InputError(
            f"belief.active is {D} and last.rows {number['last.rows']}, expected {expected['active']}, {rows}"
        )
    for name, (dtype, shape) in FORMS.items():
        wanted = tuple(expected[n] if isinstance(n, str) else n for n in shape)
        a = arrays[name]
        if a.shape != wanted or a.dtype != dtype:
            raise InputError(f"{name} has shape {a.shape} of {a.dtype}, expected {wanted} of {np.dtype(dtype)}")
        if name in UNBOUNDED:
            if not a >= 0:
                raise InputError(f"{name} is {a}, expected a number ≥ 0")
        elif not np.isfinite(a).all():
            raise InputError(f"{name} holds a value that is not finite")
    for name in ("resting.debt", "resting.spent", "resting.spent_plain"):
        if number[name] < 0:
            raise InputError(f"{name} is {number[name]}, expected a number ≥ 0")
    _check_covariance("belief.cov", arrays["belief.cov"])
    if C:
        _check_packed("resting.store", arrays["resting.store"], dim)
        _check_base(arrays)
    if rows and not (np.diag(arrays["last.L"]) > 0).all():
        raise InputError("last.L is not the Cholesky factor of a positive definite S")
    _lay_out(belief, slots, arrays, number)


def _lay_out(
    belief: Belief, slots: dict[Hashable, int], arrays: Mapping[str, NDArray[Any]], number: Mapping[str, Any]
) -> None:
    D, dim, C, rows = (number[n] for n in ("belief.active", "belief.dim", "resting.columns", "last.rows"))
    kept: dict[str, Any] = {part: {} for part in FIELDS} | {"own": arrays["own"]}
    kept["resting"] = belief._flush_prices()
    for name, a in arrays.items():
        part, _, field = name.partition(".")
        if field and name != "last.w":
            kept[part][field] = number.get(name, a)
    local = np.full(dim, -1, dtype=np.int64)
    local[:D] = np.arange(D)
    kept["belief"] |= {"local": local, "owner": np.arange(D)}
    kept["last"] |= {"active": -1, "dim": dim}
    if C:
        kept["resting"] |= {"Phi": np.eye(BASE), "minus_Psi": np.zeros((BASE, BASE)), "activated": np.arange(BASE)}
    room = BASE + 8 * BLOCK
    belief._lay_out(kept, max(D, room), max(8, -(-rows // belief._k)), room if C else 0, dim)
    belief.slots, belief._whole_w = slots, arrays["last.w"]
    belief._squares, belief._reads = [], 0


def _check_covariance(name: str, lower: NDArray[np.float64]) -> None:
    """A lower triangle must be that of a positive semidefinite matrix."""
    if len(lower) <= DECOMPOSED:
        P = lower + np.tril(lower, -1).T
        scale = float(np.abs(P).max(initial=0.0))
        smallest = float(np.linalg.eigvalsh(P)[0])
        if smallest < -1e-9 * scale:
            raise InputError(f"{name} is not positive semidefinite: its smallest eigenvalue is {smallest:.3g}")
        return
    diagonal = np.diag(lower)
    _check_rows(name, diagonal, ((0, lower),))


def _check_packed(name: str, store: NDArray[np.float64], dim: int) -> None:
    """A packed triangle must be that of a positive semidefinite matrix; a large one is checked panel by panel."""
    if dim <= DECOMPOSED:
        P = np.empty((dim, dim))
        expand(store, P)
        _check_covariance(name, np.tril(P))
        return
    panels = []
    start = 0
    for row in range(0, dim, PANEL):
        width = row + PANEL
        panels.append((row, store[start : start + PANEL * width].reshape(PANEL, width)[: dim - row]))
        start += PANEL * width
    diagonal = np.concatenate([np.diagonal(panel, row) for row, panel in panels])[:dim]
    _check_rows(name, diagonal, panels)


def _check_base(arrays: Mapping[str, NDArray[Any]]) -> None:
    """The base of a compressed belief is active and stored: both must say the same."""
    b = BASE
    P = np.empty((b, b))
    expand(arrays["resting.store"], P)
    for name, active, stored in (
        ("cov", arrays["belief.cov"], np.tril(P)),
        ("mean", arrays["belief.mean"], arrays["resting.mean"][:b]),
        ("linearised_at", arrays["belief.linearised_at"], arrays["resting.linearised_at"][:b]),
    ):
        if not np.array_equal(active, stored):
            raise InputError(f"belief.{name} is {active.tolist()}, but what is stored of the base is {stored.tolist()}")


def _check_rows(name: str, diagonal: NDArray[np.float64], panels: Iterable[tuple[int, NDArray[np.float64]]]) -> None:
    """|P_ij| ≤ √(P_ii P_jj), but for rounding: what no covariance can break, and cheap to ask of a large one."""
    if (diagonal < 0).any():
        raise InputError(f"{name} has a negative variance: {diagonal.min():.3g}")
    deviations = np.sqrt(diagonal)
    for row, panel in panels:
        width = min(panel.shape[1], len(deviations))
        bound = np.outer(deviations[row : row + len(panel)], deviations[:width])
        beyond = np.abs(np.tril(panel[:, :width], row)) > bound * (1 + 1e-6) + 1e-12 * diagonal.max()
        if beyond.any():
            raise InputError(f"{name} is not positive semidefinite: a covariance is larger than its variances allow")
