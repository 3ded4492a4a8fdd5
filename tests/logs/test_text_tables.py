"""One reader for all text tables: the same numbers on its fast and its careful path, and errors with a line."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from log_examples import same

from slamkit.errors import LogFileError
from slamkit.logs import Log, Table, read_table, text_tables

HEADER = (lambda names: names == ("a", "b"), "a,b")


def by_comma(text: str) -> Table:
    return read_table("f.csv", text.encode(), header=HEADER)


def by_blank(text: str) -> Table:
    return read_table("f.dat", text.encode(), ("a", "b"), delimiter=None)


@given(st.lists(st.tuples(st.floats(allow_nan=False, allow_infinity=False), st.integers(-9, 9)), max_size=5), st.data())
def test_numbers_come_back_to_the_last_bit_on_both_paths(rows: list[tuple[float, int]], data: st.DataObject) -> None:
    gaps = st.sampled_from(["", "\n", "# note\n", "  \r\n", "\t# µ\r"])
    lines = [f"{a!r}{{0}}{b}{data.draw(st.sampled_from(['', '  ', ' # x']))}\n{data.draw(gaps)}" for a, b in rows]
    expected = np.reshape(np.array(rows, dtype=float), (-1, 2))
    start = data.draw(gaps)
    for read, between, header in ((by_comma, " , ", "a,b\n"), (by_blank, " \t ", "")):
        text = start + header + "".join(line.format(between) for line in lines)
        fast = read(text)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(text_tables, "_numbers_at_once", lambda *_: None)
            careful = read(text)
        for table in (fast, careful):
            assert same(table.numbers, expected) and table.columns == ("a", "b")
            plain = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
            for row, (a, _) in enumerate(rows):
                assert plain[table.line(row) - 1].startswith(repr(a))


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("1", "2: 1 fields '1', expected 2: a,b"),
        ("1{0}2{0}3", "2: 3 fields '1.2.3', expected 2: a,b"),
        ("1{0}x", "2: 'x' is not a number, expected b in column 2 of a,b"),
        ("1_0{0}2", "2: '1_0' is not a number, expected a in column 1 of a,b"),
        ("0x10{0}2", "2: '0x10' is not a number"),
        ("1{0}１", "2: '１' is not a number"),
        ("1{0}1j", "2: '1j' is not a number"),
        ("1{0}nan", "2: nan is not finite, expected b in column 2"),
        ("1{0}-Infinity", "2: -inf is not finite"),
        ("1{0}1e999", "2: inf is not finite"),
    ],
)
def test_the_first_wrong_row_is_named_with_its_line(row: str, message: str) -> None:
    with pytest.raises(LogFileError, match=rf"^f\.csv:{message}"):
        by_comma("a,b\n" + row.format(",") + "\n1,2\n")
    with pytest.raises(LogFileError, match=rf"^f\.dat:{message}"):
        by_blank("1 2\n" + row.format(" ") + "\n1 2\n")


def test_bytes_that_are_not_utf8_are_fine_in_a_comment_only() -> None:
    table = read_table("f", b"1 2 # \xb5\n", ("a", "b"), delimiter=None)
    assert table.numbers.tolist() == [[1.0, 2.0]]
    with pytest.raises(LogFileError, match="f:2: byte 0xb5, expected UTF-8 text"):
        read_table("f", b"1 2\n1 \xb52\n", ("a", "b"), delimiter=None)


@pytest.mark.parametrize("content", [b"", b"# only\n\n", b"\xef\xbb\xbf"])
def test_a_table_may_have_no_rows_but_not_no_header(content: bytes, recwarn: Any) -> None:
    assert read_table("f", content, ("a", "b"), delimiter=None).numbers.shape == (0, 2)
    assert by_comma("a,b\n").numbers.shape == (0, 2)
    with pytest.raises(LogFileError, match="f: the file is empty, expected the header a,b"):
        read_table("f", content, header=HEADER)
    assert len(recwarn) == 0


@pytest.mark.parametrize("other", [";", "\t", "|", " "])
def test_a_wrong_delimiter_is_named(tmp_path: Any, other: str) -> None:
    with pytest.raises(LogFileError) as caught:
        by_comma(f"# x\na{other}b\n1{other}2\n")
    given = repr(f"a{other}b")
    assert str(caught.value) == f"f.csv:2: one column {given}, expected a,b: is the delimiter {other!r}? expected ','"
    (tmp_path / "controls.csv").write_text("t,v,omega\n0,1,0.1\n")
    (tmp_path / "observations.csv").write_text(f"t{other}id{other}x{other}y\n0{other}a{other}1{other}2\n")
    with pytest.raises(LogFileError, match=r"observations\.csv:1: .*is the delimiter"):
        Log.read_csv(tmp_path)


def test_a_header_without_another_delimiter_gets_no_such_hint() -> None:
    with pytest.raises(LogFileError) as caught:
        by_comma("a,c\n")
    assert "delimiter" not in str(caught.value)
