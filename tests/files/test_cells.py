"""Labels of any kind are shown, and neither run by a spreadsheet nor taken for markup."""

import csv
import io

import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from markdown_it import MarkdownIt

from pa10cal.campaign.csv_rows import read_rows
from pa10cal.campaign.raw_rows import Quarantined, quarantine_csv
from pa10cal.errors import one_line
from pa10cal.figures.table import ResultTable, write_table
from pa10cal.files.table_cells import csv_cell, csv_text, from_csv_cell, markdown_cell
from pa10cal.input_files import read_csv
from pa10cal.reports.blocks import grid

FORMULAS = [
    *("=1+1", "+cmd|' /C calc'!A0", "@SUM(A1)", "-2+3", "\t=1", "=HYPERLINK('x')"),
    *(" =1+1", "\xa0@A1", "\r=1", "\n-A1", "'=1", '"=1"', " ' -A1", "\ufeff=1", "\uff1d1+1", "-"),
]


@pytest.mark.parametrize("label", FORMULAS)
def test_a_formula_is_text(label: str) -> None:
    assert csv_cell(label) == "'" + label


def test_a_formula_behind_a_semicolon_is_text() -> None:
    assert csv_cell("a; =1+1;-1.5;b=c;@x") == "a;' =1+1;-1.5;b=c;'@x"


@pytest.mark.parametrize(
    "value", ["P1", "", "-1.5", "+2e-3", -1.5, None, "a=b", "–", "-inf", " -1.5", "it's", "a-b"]
)
def test_other_cells_stay(value: object) -> None:
    assert csv_cell(value) == value


@given(st.floats(allow_nan=False))
def test_numbers_as_text_stay(value: float) -> None:
    assert csv_cell(f"{value:+.6g}") == f"{value:+.6g}"


def test_markup_is_shown() -> None:
    assert markdown_cell("<b>a</b> | [x](y)\nz") == r"\<b>a\</b> \| \[x](y) z"
    assert markdown_cell("p < 0.05, [1, 2], theta_2 & K_cub") == "p < 0.05, [1, 2], theta_2 & K_cub"


MARKUP = {
    "entity": "&lt;b&gt; &#60; &#x3c;",
    "escape": r"\<b>x</b> \| \`",
    "emphasis": "*a* **b** _c_ __d__ ~e~ ~~f~~ _a_b_",
    "code": "`a` ``b`` `<i>`",
    "link": "[a](javascript:x) [a [b] c](d) [a\\]b](c) ![x](y) [a][b] [x]: y [1](y) <http://a.b>",
    "address": "http://a.b/c www.a.b HTTPS://x",
    "formula": "$a$ $$b$$",
    "tag": "<script>x</script> <!-- a --> <?x?> <a.b@c.d>",
    "columns": "a | b || c",
    "lines": "a\rb\nc\r\n# d",
    "terminal": "a\x1b[2J\x9b\u202e\u2066\u200f\u2028b",
    "heading": "# a",
    "rule": "---",
    "list": "- a",
    "numbered": "1. a",
    "quotation": "> a",
}


@pytest.mark.parametrize("kind", MARKUP)
def test_no_markup_of_any_kind_is_left(kind: str, tmp_path) -> None:
    """As a reader of Markdown sees it: text alone, and all of it."""
    text = MARKUP[kind]
    data = pd.DataFrame({text: [text], "b": [1.0]})
    table = ResultTable(text, data, (grid(text, [text, "b"], [[text, "1"]]),), (text,))
    write_table(table, text, tmp_path, "t")
    written = (tmp_path / "t.md").read_bytes().decode()
    assert all(line.isprintable() for line in written.split("\n"))
    tokens = MarkdownIt("gfm-like", {"linkify": False}).parse(written)
    seen = [token for token in tokens if token.type == "inline"]
    assert {child.type for token in seen for child in token.children} <= {"text", "text_special"}
    assert [token.tag for token in tokens if token.nesting == 1 and token.tag[0] in "hptu"] == [
        *(
            "h1",
            "p",
            "h2",
            "table",
            "thead",
            "tr",
            "th",
            "th",
            "tbody",
            "tr",
            "td",
            "td",
            "ul",
            "p",
        ),
    ]
    words = ["".join(child.content for child in token.children) for token in seen]
    plain = one_line(text)
    assert words == [plain, plain, plain, plain, "b", plain, "1", plain]


@pytest.mark.parametrize("label", FORMULAS)
def test_no_table_holds_a_formula(label: str, tmp_path) -> None:
    data = pd.DataFrame({"pose": [label], "error": [-1.0]})
    write_table(ResultTable("t", data, (grid("", ["pose"], [[label]]),)), "made up", tmp_path, "t")
    text = (tmp_path / "t.csv").read_bytes().decode()
    _, *rows = csv.reader(io.StringIO(text, newline=""))
    assert rows == [["'" + label, "-1"]]
    listed = quarantine_csv([Quarantined("poses.csv", 3, "no number", label)])
    assert list(csv.reader(io.StringIO(listed, newline="")))[1][3] == "'" + label


LABELS = [
    *("a,90.0", 'a"b', "a\rb", "a\nb", "a\r\nb", "", "'", "''=1", "a;'=1", "\u2028", "=1,2;-A"),
    *FORMULAS,
]


def _read_back(labels: list[str]) -> list[str]:
    rows = csv.reader(io.StringIO(csv_text(["id"], [[each] for each in labels]), newline=""))
    return [from_csv_cell(cell) for (cell,) in list(rows)[1:]]


def test_every_label_is_one_cell_and_read_back_as_it_was() -> None:
    assert _read_back(LABELS) == LABELS


@given(st.lists(st.text(alphabet="=+-@'\" ,;\t\r\n1a.e", max_size=6), min_size=1, max_size=5))
def test_any_label_is_read_back_as_it_was(labels: list[str]) -> None:
    assert _read_back(labels) == labels
    assert [from_csv_cell(str(csv_cell(csv_cell(each)))) for each in labels] == [
        csv_cell(each) for each in labels
    ]


def test_the_readers_of_rows_take_the_apostrophe_off(tmp_path) -> None:
    """Of lists and campaigns; a reader of rows strips blanks, and takes no line break in a cell."""
    labels = [
        each for each in LABELS if each == each.strip(' \t"\xa0') and not set(each) & {*"\r\n"}
    ]
    path = tmp_path / "a.csv"
    path.write_text(csv_text(["id", "x"], ((each, 1.0) for each in labels)), "utf-8", newline="\n")
    assert [row[0] for _, row in read_csv(path, 10_000)][1:] == list(map(csv_cell, labels))
    assert read_rows(path, ["id", "x"], repeats=True).text_of("id").tolist() == labels


def test_what_is_not_known_is_empty() -> None:
    assert csv_text(["a", "b"], [(None, float("nan")), (1, -0.5)]) == "a,b\n,\n1,-0.5\n"
