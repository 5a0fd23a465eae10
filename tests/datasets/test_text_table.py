"""Text tables: numbers by column, bad rows listed, what is wrong throughout refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pa10cal.datasets.text_table import read_bare_table
from pa10cal.errors import RawDataError


def listed(table):
    return [(row.line, row.reason, row.value) for row in table.left_out]


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
    rows = [f"{value!r} {k}" for k, value in enumerate(values)]
    (folder / "t.txt").write_text("\n".join(rows))
    table = read_bare_table(folder, "t.txt", ("a", "b"))
    np.testing.assert_array_equal(table.columns["a"], values)


def test_bad_rows_are_listed_and_too_many_refused(tmp_path):
    (tmp_path / "t.txt").write_text("1 2\n3 x\n4 5 6\ninf 1\n7 8\n")
    table = read_bare_table(tmp_path, "t.txt", ("a", "b"))
    assert len(table) + len(table.left_out) == table.total == 5
    with pytest.raises(
        RawDataError, match=r"t\.txt:2: 3 of 5 rows would be quarantined, 2 of them"
    ):
        table.refuse_too_many(0.5)
    table.refuse_too_many(0.6)


@pytest.mark.parametrize("text", ["", " \n\n"])
def test_an_empty_file_is_refused(tmp_path, text):
    (tmp_path / "t.txt").write_text(text)
    with pytest.raises(RawDataError, match=r"t\.txt:1: the file is empty"):
        read_bare_table(tmp_path, "t.txt", ("a", "b"))
