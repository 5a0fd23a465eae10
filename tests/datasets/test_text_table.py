"""Text tables: numbers by column, bad rows listed, what is wrong throughout refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pa10cal.datasets.text_table import read_bare_table, read_headed_table
from pa10cal.errors import RawDataError

HEADED = "a;b;c\r\n1,5;2;x\r\n-0,25;3e-2;\r\n4;5,0;7\r\n"


def read(folder, text, required=("a", "b"), optional=()):
    (folder / "t.csv").write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_headed_table(folder, "t.csv", required, optional, separator=";", decimal=",")


def listed(table):
    return [(row.line, row.reason, row.value) for row in table.left_out]


def test_reads_named_columns_with_decimal_commas(tmp_path):
    table = read(tmp_path, HEADED)
    np.testing.assert_array_equal(table.numbers(["b", "a"]), [[2, 1.5], [0.03, -0.25], [5, 4]])
    assert list(table.line) == [2, 3, 4]
    assert set(table.columns) == {"a", "b"}
    assert listed(table) == []


def test_a_byte_order_mark_and_other_line_ends_change_nothing(tmp_path):
    plain = read(tmp_path, HEADED)
    marked = read(tmp_path, b"\xef\xbb\xbf" + HEADED.replace("\r\n", "\n\n").encode())
    np.testing.assert_array_equal(plain.numbers(["a", "b"]), marked.numbers(["a", "b"]))
    assert list(marked.line) == [3, 5, 7]


def test_bad_rows_are_listed_with_line_and_value(tmp_path):
    good = "".join(f"{k},5;{k};1\n" for k in range(6))
    bad = "x;1;1\n1.5;1;1\n;1;1\nnan;1;1\ninf;1;1\n1;2\n0,5;0;1\n"
    table = read(tmp_path, "a;b;c\n" + good + bad)
    assert listed(table) == [
        (13, "the number of fields is not 3", "2"),
        (8, "not a finite number", "a = 'x'"),
        (9, "not a finite number", "a = '1.5'"),
        (10, "not a finite number", "a = ''"),
        (11, "not a finite number", "a = 'nan'"),
        (12, "not a finite number", "a = 'inf'"),
        (14, "repeats an earlier row", ""),
    ]
    assert len(table) + len(table.left_out) == table.total == 13
    with pytest.raises(
        RawDataError, match=r"t\.csv:8: 7 of 13 rows would be quarantined, 5 of them"
    ):
        table.refuse_too_many(0.5)
    table.refuse_too_many(0.6)


def test_an_optional_field_may_be_blank(tmp_path):
    table = read(tmp_path, "a;b;c\n1;2;\n1;3;-\n1;4;0,5\n1;5;?\n", optional=("c", "d"))
    np.testing.assert_array_equal(table.columns["c"], [np.nan, np.nan, 0.5])
    assert "d" not in table.columns
    assert listed(table) == [(5, "not a finite number", "c = '?'")]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"t\.csv:1: the file is empty"),
        (" \n\n", r"t\.csv:1: the file is empty"),
        ("a;b\n", r"t\.csv:1: there is no row under the header"),
        ("\na,b\n1,2\n", r"t\.csv:2: the fields are separated by commas .*semicolons between"),
        ("a\tb\n1\t2\n", r"t\.csv:1: the fields are separated by tabs"),
        ("a;c\n1;2\n", r"t\.csv:1: missing column b \(got 'a;c'\)"),
        ("c;d\n1;2\n", r"t\.csv:1: missing columns a, b"),
        (
            "a;b\n1;2\n1.5;1\n1;2.5\n",
            r"t\.csv:3: decimal points where decimal commas are expected \(got '1\.5'\)",
        ),
    ],
)
def test_refuses_what_is_wrong_throughout(tmp_path, text, message):
    with pytest.raises(RawDataError, match=message):
        read(tmp_path, text)


def test_bare_rows_keep_their_lines(tmp_path):
    (tmp_path / "t.txt").write_text("1 2\n\n3  nan\n4\t-\n5 6,5\n7 8\n\n")
    table = read_bare_table(tmp_path, "t.txt", ("x", "y"), may_be_blank=True)
    np.testing.assert_array_equal(table.columns["y"], [2, np.nan, np.nan, 8])
    assert list(table.line) == [1, 3, 4, 6]
    assert listed(table) == [
        (2, "the number of fields is not 2", "0"),
        (5, "not a finite number", "y = '6,5'"),
    ]
    strict = read_bare_table(tmp_path, "t.txt", ("x", "y"))
    assert list(strict.line) == [1, 6]


def test_decimal_commas_where_points_are_expected(tmp_path):
    (tmp_path / "t.txt").write_text("1,5 2\n3,5 4\n")
    with pytest.raises(RawDataError, match="decimal commas where decimal points are expected"):
        read_bare_table(tmp_path, "t.txt", ("x", "y"))


@settings(deadline=None, max_examples=30)
@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=9))
def test_what_is_written_comes_back(tmp_path_factory, values):
    folder = tmp_path_factory.mktemp("round")
    rows = [f"{value!r};{k}".replace(".", ",") for k, value in enumerate(values)]
    table = read(folder, "a;b\n" + "\n".join(rows))
    np.testing.assert_array_equal(table.columns["a"], values)
