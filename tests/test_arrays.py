"""Numbers from outside: what the checks accept, and what they refuse."""

from __future__ import annotations

from collections.abc import Callable
from decimal import Decimal
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from slamkit.arrays import check_symmetric, covariance, finite_array, finite_number, index_array, real_array
from slamkit.errors import InputError


def read_only(a: Any) -> Any:
    a = np.array(a, dtype=float)
    a.flags.writeable = False
    return a


def unaligned(a: Any) -> Any:
    a = np.array(a, dtype=float)
    view = np.zeros(a.nbytes + 1, np.uint8)[1:].view(float).reshape(a.shape)
    view[...] = a
    return view


class Subclass(np.ndarray[Any, Any]):
    pass


FORMS: dict[str, Callable[[list[list[float]]], Any]] = {
    "list": lambda a: a,
    "floats": np.array,
    "read-only": read_only,
    "frombuffer": lambda a: np.frombuffer(np.array(a).tobytes()).reshape(np.shape(a)),
    "broadcast": lambda a: np.broadcast_to(np.array(a), np.shape(a)),
    "unaligned": unaligned,
    "big-endian": lambda a: np.array(a, dtype=">f8"),
    "columns first": np.asfortranarray,
    "every other": lambda a: np.repeat(np.array(a), 2, axis=1)[:, ::2],
    "float32": lambda a: np.array(a, dtype=np.float32),
    "integers": lambda a: np.array(a, dtype=np.int8),
    "objects": lambda a: np.array(a, dtype=object),
    "fractions": lambda a: [[Fraction(int(v)) for v in row] for row in a],
    "subclass": lambda a: np.array(a).view(Subclass),
    "nothing masked": lambda a: np.ma.array(a, mask=False),
}


@pytest.mark.parametrize("form", FORMS)
def test_every_form_of_real_numbers_becomes_a_plain_writable_copy(form: str) -> None:
    values = [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]
    given = FORMS[form](values)
    for a in (real_array("z", given), finite_array("z", given, (3, 2)), finite_array("z", given, (-1, -1))):
        assert type(a) is np.ndarray
        assert a.dtype == np.dtype(np.float64) and a.dtype.isnative
        assert a.flags.c_contiguous and a.flags.writeable and a.flags.aligned and a.flags.owndata
        assert a.tolist() == values
        assert not np.may_share_memory(a, given)


NO_NUMBERS: dict[str, Any] = {
    "complex list": [1 + 1j, 0.0],
    "complex array": np.array([1.0 + 0j, 0.0]),
    "complex objects": np.array([1j, 0.0], dtype=object),
    "masked": np.ma.array([1.0, 2.0], mask=[True, False]),
    "masked rows": [np.ma.array([1.0, 2.0], mask=[True, False])],
    "time span": np.array([1, 2], "m8[s]"),
    "date": np.array(["2024-01-01", "2024-01-02"], "M8[D]"),
    "text": "soon",
    "digits": ["1", "2"],
    "digits among numbers": [1, "2"],
    "digits among objects": np.array([1, "2"], dtype=object),
    "bytes": b"ab",
    "none": None,
    "none inside": [1.0, None],
    "decimal": [Decimal(1), Decimal(2)],
    "too large": [10**400, 0],
    "ragged": [[1.0, 2.0], [1.0]],
    "object": object(),
    "dict": {0: 1.0},
    "record": np.zeros(2, dtype=[("x", float)]),
}


@pytest.mark.parametrize("kind", NO_NUMBERS)
def test_what_is_not_real_numbers_is_refused(kind: str) -> None:
    for check in (real_array, lambda name, value: finite_array(name, value, (2,)), covariance):
        with pytest.raises(InputError, match=r"^z must be numbers, given "):
            check("z", NO_NUMBERS[kind])


@pytest.mark.parametrize(
    ("value", "shape", "message"),
    [
        ([1.0, 2.0], (3,), r"z has shape \(2,\), expected \(3,\)"),
        ([1.0, 2.0], (-1, 2), r"z has shape \(2,\), expected \(n, 2\)"),
        (1.0, (1,), r"z has shape \(\), expected \(1,\)"),
        ([[1.0], [np.nan]], (2, 1), "z is not finite at row 1: nan"),
        (np.inf, (), "z is not finite: inf"),
        (np.array([1e400], dtype=np.longdouble), (1,), "z is not finite"),
    ],
)
def test_a_finite_array_says_what_is_wrong(value: Any, shape: tuple[int, ...], message: str) -> None:
    with pytest.raises(InputError, match=message):
        finite_array("z", value, shape)


@pytest.mark.parametrize("value", [2, 2.0, np.float32(2), np.int8(2), np.array(2.0), Fraction(2)])
def test_a_number_is_a_float_afterwards(value: Any) -> None:
    number = finite_number("dt", value, above=0)
    assert type(number) is float and number == 2.0


@pytest.mark.parametrize(
    "value",
    [10**400, -(10**400), 10**5000, np.nan, np.inf, True, np.True_, np.array(True), "1", None, 1j, [1.0], np.ones(1),
     np.ma.masked, np.timedelta64(1, "s"), object()],
    ids=lambda v: type(v).__name__,
)  # fmt: skip
def test_what_is_no_finite_number_is_refused(value: Any) -> None:
    with pytest.raises(InputError, match=r"^dt is .*, expected a finite number of seconds > 0$"):
        finite_number("dt", value, above=0, unit="seconds")
    with pytest.raises(InputError, match=r"^dt is .*, expected a finite number$"):
        finite_number("dt", value)


@pytest.mark.parametrize(
    ("value", "bounds", "message"),
    [
        (0, {"above": 0}, "x is 0, expected a finite number > 0"),
        (-1, {"lower": 0}, "x is -1, expected a finite number ≥ 0"),
        (2, {"lower": 0, "upper": 1}, "x is 2, expected a finite number ≥ 0 and ≤ 1"),
    ],
)
def test_a_number_has_bounds(value: float, bounds: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        finite_number("x", value, **bounds)
    assert finite_number("x", 0.5, **bounds) == 0.5


def test_a_covariance_is_exactly_symmetric_afterwards() -> None:
    rng = np.random.default_rng(0)
    root = rng.normal(size=(5, 5))
    P = root @ root.T
    assert covariance("P", P).tobytes() == ((P + P.T) / 2).tobytes()
    P[0, 1] *= 1 + 1e-12
    symmetric = covariance("P", P, 5, definite=True)
    assert np.array_equal(symmetric, symmetric.T)
    assert symmetric[0, 1] == pytest.approx(P[1, 0], rel=1e-11)


@pytest.mark.parametrize("scale", [1e-300, 1.0, 1e300, 1.7e308])
def test_a_covariance_may_have_any_scale(scale: float) -> None:
    assert np.array_equal(covariance("P", scale * np.eye(3), definite=True), scale * np.eye(3))
    assert np.array_equal(covariance("P", np.zeros((3, 3))), np.zeros((3, 3)))
    assert covariance("P", np.empty((0, 0)), definite=True).shape == (0, 0)
    with pytest.raises(InputError, match="P is not positive semidefinite"):
        covariance("P", np.diag([scale, -1e-6 * scale]))


@pytest.mark.parametrize(
    ("value", "size", "definite", "message"),
    [
        (np.eye(2), 3, False, r"P has shape \(2, 2\), expected \(3, 3\)"),
        (np.ones((2, 3)), None, False, r"P has shape \(2, 3\), expected \(2, 2\)"),
        (1.0, None, False, r"P has shape \(\), expected"),
        (np.full((2, 2), np.nan), None, False, "P is not finite"),
        ([[1.0, 0.5], [0.4, 1.0]], None, False, "P is not symmetric: it differs from its transpose by 0.1"),
        ([[1.0, 1.7e308], [-1.7e308, 1.0]], None, False, "P is not symmetric"),
        ([[1.0, 2.0], [2.0, 1.0]], None, False, "P is not positive semidefinite: its smallest eigenvalue is -1"),
        (np.diag([1.0, 0.0]), None, True, "P is not positive definite: its smallest eigenvalue is 0"),
    ],
)
def test_a_covariance_says_what_is_wrong(value: Any, size: int | None, definite: bool, message: str) -> None:
    with pytest.raises(InputError, match=message):
        covariance("P", value, size, definite=definite)


def test_the_first_matrix_of_a_stack_that_is_not_symmetric_is_named() -> None:
    stack = np.tile(np.eye(2), (2, 3, 1, 1))
    check_symmetric("P", stack)
    check_symmetric("P", np.empty((0, 2, 2)))
    stack[1, 2, 0, 1] = 0.25
    with pytest.raises(InputError, match=r"P is not symmetric at \(1, 2\): it differs from its transpose by 0.25"):
        check_symmetric("P", stack)


@pytest.mark.parametrize("value", [[0, 2], np.array([0, 2], dtype=np.uint8), np.array([0, 2], dtype=">i4")])
def test_row_numbers_are_native_integers_afterwards(value: Any) -> None:
    rows = index_array("rows", value, (-1,), 3)
    assert rows.tolist() == [0, 2]
    assert rows.dtype == np.dtype(np.int64) and rows.flags.writeable and rows.flags.c_contiguous
    assert index_array("rows", [], (-1,), 0).dtype == np.int64
    assert index_array("rows", [-1], (1,), 3, lowest=-1).tolist() == [-1]


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ([0.0], "rows has dtype float64, expected integers"),
        ([True], "rows has dtype bool, expected integers"),
        ([2**64], "rows has dtype object, expected integers"),
        (np.ma.array([1], mask=[True]), "rows has masked entries, expected integers"),
        ([3], "rows runs from 3 to 3, expected 0 to 2"),
        ([-1], "rows runs from -1 to -1, expected 0 to 2"),
        (np.array([2**63], dtype=np.uint64), "rows runs from 9223372036854775808"),
        ([[0]], r"rows has shape \(1, 1\), expected \(n,\)"),
        ([[0], [0, 1]], "rows must be integers"),
    ],
)
def test_row_numbers_say_what_is_wrong(value: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        index_array("rows", value, (-1,), 3)
