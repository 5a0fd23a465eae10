"""Text tables: numbers by column, bad rows listed, what is wrong throughout refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pa10cal.campaign.own_columns import refuse_too_many
from pa10cal.datasets.readers import read_bare_table, read_tables
from pa10cal.errors import RawDataError


def test_bare_rows_keep_their_lines(tmp_path):
    (tmp_path / "t.txt").write_text("1 2\n\n3  nan\n4\t-\n5 6,5\n7 8\n\n")
    table = read_bare_table(tmp_path, "t.txt", ("x", "y"))
    np.testing.assert_array_equal(table.columns["y"], [2, 8])
    assert list(table.line) == [1, 6]
    assert {(row.line, row.reason, row.value) for row in table.quarantined} == {
        (2, "the number of fields is not 2", "0"),
        (3, "not a finite number", "y = 'nan'"),
        (4, "not a finite number", "y = '-'"),
        (5, "not a finite number", "y = '6,5' (a decimal comma)"),
    }


def test_a_separator_and_a_header(tmp_path):
    (tmp_path / "t.csv").write_text("a,b\n1, 2\n3,\n5,6\n")
    table = read_bare_table(tmp_path, "t.csv", ("x", "y"), separator=",", header=True)
    np.testing.assert_array_equal(table.numbers_of(("x", "y")), [[1, 2], [5, 6]])
    assert (list(table.line), table.totals) == ([2, 4], {"t.csv": 3})
    assert [row.line for row in table.quarantined] == [3]


def test_tables_that_belong_together_line_by_line(tmp_path):
    (tmp_path / "one.txt").write_text("1\n2\n3\n")
    (tmp_path / "two.txt").write_text("4\nx\n6\n")
    both = read_tables(tmp_path, 0.5, {"one.txt": "v", "two.txt": "w"})
    assert (both["v"].tolist(), both["w"].tolist()) == ([1, 3], [4, 6])


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
    assert len(table) + len(table.quarantined) == table.totals["t.txt"] == 5
    with pytest.raises(
        RawDataError, match=r"t\.txt:2: b: 3 of 5 rows would be quarantined, 2 of them"
    ):
        refuse_too_many(table.quarantined, table.totals, 0.5)
    refuse_too_many(table.quarantined, table.totals, 0.6)


@pytest.mark.parametrize("text", ["", " \n\n"])
def test_an_empty_file_is_refused(tmp_path, text):
    (tmp_path / "t.txt").write_text(text)
    with pytest.raises(RawDataError, match=r"t\.txt:1: the file is empty"):
        read_bare_table(tmp_path, "t.txt", ("a", "b"))
