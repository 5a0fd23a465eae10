"""Workbooks are read in a process of its own: what is in them, and what would take all memory."""

from __future__ import annotations

import io
import zipfile
from collections import deque
from itertools import repeat

import pytest
from benchmarks.broken_fleet import workbook

from made_up_exports import _ods
from pa10cal.campaign import text_lines
from pa10cal.campaign.text_lines import encoding_of, lines_of
from pa10cal.errors import RawDataError

HEAD = '<worksheet xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"><sheetData>'
END = "</sheetData></worksheet>"
MB = 10**6


def sheet(*rows):
    return HEAD + "".join(rows) + END


def written(path, *rows):
    workbook(path, sheet(*rows))
    return path


@pytest.mark.parametrize("encoding", ["cp1252", "cp850", "mac_roman"])
@pytest.mark.parametrize("header", ["A1 [°]", "A1 [°];Höhe [µm]", "Größe", "position mesurée [°]"])
def test_letters_of_one_byte_tell_the_encoding(tmp_path, encoding, header):
    path = tmp_path / "a.csv"
    path.write_bytes(header.encode(encoding))
    assert encoding_of(path) == encoding
    (line,) = lines_of(path)
    assert line.text == header


def test_cells_stand_where_they_are_and_are_written_in_full(tmp_path):
    path = written(
        tmp_path / "a.xlsx",
        '<row r="3"><c r="C3"><v>1</v></c><c r="E3" t="str"><v>NA</v></c>',
        '<c r="F3"><v>0.1</v></c><c r="G3"><v>1e20</v></c></row>',
        '<row r="6"><c r="D6" t="str"><v>a\tb\n°</v></c><c r="E6" t="b"><v>1</v></c></row>',
    )
    assert [(line.number, line.text) for line in lines_of(path)] == [
        (3, "\t\t1\t\t\t0.1\t100000000000000000000"),
        (6, "\t\t\ta b °\tTrue\t\t"),
    ]


def test_a_sheet_without_cells_has_no_rows(tmp_path):
    assert list(lines_of(written(tmp_path / "a.xlsx"))) == []


def test_what_is_not_needed_is_not_waited_for(tmp_path):
    rows = (f'<row r="{k}"><c r="A{k}"><v>{k}</v></c></row>' for k in range(1, 50_000))
    lines = lines_of(written(tmp_path / "a.xlsx", *rows))
    assert next(lines).text == "1"
    lines.close()


def test_a_reader_that_dies_is_a_refusal(tmp_path, monkeypatch):
    monkeypatch.setattr(text_lines, "MOST_BYTES", 40 * MB)
    rows = (f'<row r="{k}"><c r="A{k}"><v>{k}</v></c></row>' for k in range(1, 500_000))
    with pytest.raises(RawDataError, match=r"a\.xlsx: .*more memory.*save the sheet as CSV"):
        list(lines_of(written(tmp_path / "a.xlsx", *rows)))


def far(path):
    workbook(path)


def far_of_many(path):
    """In the middle of a sheet, its attributes in another order."""
    rows = [f'<row r="{k}"><c r="A{k}"><v>{k}</v></c></row>' for k in range(1, 50_000)]
    rows[30_000] = '<row r="99"><c s="1" r="XFD1040000"><v>1</v></c></row>'
    written(path, *rows)


def far_and_hidden(path):
    """Not found by looking for it: the reader dies."""
    written(path, "<row><c r = 'A1'><v>1</v></c></row><row><c\nr='XFD1048576'><v>1</v></c></row>")


def one_string_often(path):
    """Each cell a copy of one long text."""
    cells = (f'<row r="{k}"><c r="A{k}" t="s"><v>0</v></c></row>' for k in range(1, 100_000))
    written(path, *cells)
    _added(path, {"xl/sharedStrings.xml": f"<sst><si><t>{'x' * MB}</t></si></sst>"})
    content = _files(path)
    of = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
    content["xl/_rels/workbook.xml.rels"] = content["xl/_rels/workbook.xml.rels"].replace(
        b"</Relationships>",
        f'<Relationship Id="s" Type="{of}/sharedStrings" Target="sharedStrings.xml"/>'
        "</Relationships>".encode(),
    )
    _write(path, content)


def repeated(path):
    """A cell of an .ods that stands for 82 million."""
    cell = '<table:table-cell office:value-type="float" office:value="1.0"'
    content = _ods([[1.0]])
    path.write_bytes(content)
    files = _files(path)
    text = (
        files["content.xml"].decode().replace(cell, cell + ' table:number-columns-repeated="16384"')
    )
    text = text.replace("<table:table-row>", '<table:table-row table:number-rows-repeated="5000">')
    assert "16384" in text
    _write(path, files | {"content.xml": text.encode()})


def packed(path):
    """One that says how much it is."""
    written(path)
    with (
        zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open("xl/sharedStrings.xml", "w", force_zip64=True) as file,
    ):
        for block in repeat(bytes(MB), 1010):
            file.write(block)


def many_parts(path):
    with zipfile.ZipFile(path, "w") as archive:
        for k in range(50_000):
            archive.writestr(f"{k}", b"")


def _files(path):
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def _added(path, texts):
    _write(path, _files(path) | {name: text.encode() for name, text in texts.items()})


def _write(path, content):
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in content.items():
            stored = zipfile.ZIP_STORED if name == "mimetype" else None
            archive.writestr(name, data, compress_type=stored)
    path.write_bytes(packed.getvalue())


FAR = r"a cell stands far from the others \(got 'XFD10.*delete the rows"
HARMFUL = {
    "far": (far, FAR),
    "far of many": (far_of_many, FAR),
    "far and hidden": (far_and_hidden, "more memory.*save the sheet as CSV"),
    "one string often": (one_string_often, "more memory"),
    "repeated": (repeated, "more memory|more time"),
    "packed": (packed, r"unpacked, is larger than is read \(got '1010 MB'"),
    "many parts": (many_parts, "50000 parts"),
    "none": (lambda path: path.write_bytes(b"PK\x03\x04" + bytes(999)), "cannot be read"),
    "old none": (lambda path: path.write_bytes(b"\xd0\xcf\x11\xe0" + bytes(999)), "cannot be read"),
}


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(
            kind,
            marks=[pytest.mark.slow]
            * (kind in ("far", "one string often", "repeated", "packed", "many parts")),
        )
        for kind in HARMFUL
    ],
)
def test_a_workbook_that_would_take_all_memory_is_refused(attack, kind):
    make, message = HARMFUL[kind]
    path = attack.inside / ("a.ods" if kind == "repeated" else "a.xlsx")
    make(path)
    attack("columns", path).refused(message, path.name)


@pytest.mark.slow
def test_a_million_rows_of_ten_numbers_are_read(tmp_path):
    row = "".join(f'<c r="{letter}%d"><v>-123.4567</v></c>' for letter in "ABCDEFGHIJ")
    rows = (f'<row r="{k}">{row % ((k,) * 10)}</row>' for k in range(1, 1_000_001))
    path = tmp_path / "a.xlsx"
    workbook(path, HEAD + "".join(rows) + END)
    (last,) = deque(lines_of(path), maxlen=1)
    assert (last.number, last.text.count("\t")) == (1_000_000, 9)
