"""Labels of any kind are shown, and neither run by a spreadsheet nor taken for markup."""

import csv
import io

import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pa10cal.campaign.raw_rows import Quarantined, quarantine_csv
from pa10cal.figures.table import ResultTable, write_table
from pa10cal.files.output import csv_cell, markdown_cell
from pa10cal.reports.blocks import grid

FORMULAS = ["=1+1", "+cmd|' /C calc'!A0", "@SUM(A1)", "-2+3", "\t=1", "=HYPERLINK('x')"]


@pytest.mark.parametrize("label", FORMULAS)
def test_a_formula_is_text(label: str) -> None:
    assert csv_cell(label) == "'" + label


@pytest.mark.parametrize("value", ["P1", "", "-1.5", "+2e-3", -1.5, None, "a=b", "–", "-inf"])
def test_other_cells_stay(value: object) -> None:
    assert csv_cell(value) == value


@given(st.floats(allow_nan=False))
def test_numbers_as_text_stay(value: float) -> None:
    assert csv_cell(f"{value:+.6g}") == f"{value:+.6g}"


def test_markup_is_shown() -> None:
    assert markdown_cell("<b>a</b> | [x](y)\nz") == r"\<b>a\</b> \| \[x](y) z"
    assert markdown_cell("p < 0.05, [1, 2], `id`") == "p < 0.05, [1, 2], `id`"


@pytest.mark.parametrize("label", FORMULAS)
def test_no_table_holds_a_formula(label: str, tmp_path) -> None:
    data = pd.DataFrame({"pose": [label], "error": [-1.0]})
    write_table(ResultTable("t", data, (grid("", ["pose"], [[label]]),)), "made up", tmp_path, "t")
    ((_, *rows),) = [list(csv.reader(io.StringIO((tmp_path / "t.csv").read_text("utf-8"))))]
    assert rows == [["'" + label, "-1"]]
    listed = quarantine_csv([Quarantined("poses.csv", 3, "no number", label)])
    assert list(csv.reader(io.StringIO(listed)))[1][3] == "'" + label
