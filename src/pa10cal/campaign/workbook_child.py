"""Reads the workbook at standard input, in a process of its own with little memory and time.

The reader of workbooks is not ours: one far cell, or a few bytes that unpack to gigabytes, and it
takes all memory or aborts. Nothing of the project is imported here. Rows go to standard output,
`number<tab>cells`, tabs between the cells; what is wrong goes there too, `!kind<tab>words`.

python -P workbook_child.py BYTES SECONDS UNPACKED CELLS < workbook
"""

from __future__ import annotations

import re
import resource
import sys
import zipfile
from datetime import date, datetime, time

_INPUT = "/dev/fd/0"
_BLOCK_BYTES = 1 << 20
#: A workbook has a few tens of parts.
_MOST_PARTS = 10_000
#: Rows that have been read may take so many times as long until they are written.
_WRITING = 4
_CELL = re.compile(rb""" r=["']([A-Z]{1,3})([0-9]{1,7})["']""")
#: No table has so many columns; to look for these alone is quick.
_FAR_COLUMN = re.compile(rb""" r=["']([A-Z]{3})([0-9]{1,7})["']""")
#: Words that stand for no value.
_NONE = frozenset(
    ("", "#N/A", "#N/A N/A", "#NA", "-1.#IND", "-1.#QNAN", "-NaN", "-nan", "1.#IND", "1.#QNAN"),
) | frozenset(("<NA>", "N/A", "NA", "NULL", "NaN", "None", "n/a", "nan", "null"))


def _main(most_bytes: int, most_s: int, most_unpacked: int, most_cells: int) -> str:
    """Print the rows of the sheet with the most cells, and return what is wrong."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_AS, (most_bytes, most_bytes))
    resource.setrlimit(resource.RLIMIT_CPU, (most_s, _WRITING * most_s))
    if zipfile.is_zipfile(_INPUT):
        with zipfile.ZipFile(_INPUT) as archive:
            if len(archive.infolist()) > _MOST_PARTS:
                return f"!unreadable\t{len(archive.infolist())} parts"
            unpacked = sum(each.file_size for each in archive.infolist())
            if unpacked > most_unpacked:
                return f"!unpacked\t{unpacked / 1e6:.0f} MB"
            for name in archive.namelist():
                if name.startswith("xl/worksheets/") and (cell := _far(archive, name, most_cells)):
                    return f"!cell\t{cell}"

    from python_calamine import SheetTypeEnum, load_workbook

    book, most, best = load_workbook(_INPUT), -1, None
    sheets = [each for each in book.sheets_metadata if each.typ == SheetTypeEnum.WorkSheet]
    for each in sheets:
        sheet = book.get_sheet_by_name(each.name)
        several = len(sheets) > 1
        cells = sum(len(row) - row.count("") for row in sheet.iter_rows()) if several else 0
        if cells > most:
            most, best = cells, sheet
    if best is None or best.start is None:
        return ""
    # All is in memory, and no more than fits there.
    resource.setrlimit(resource.RLIMIT_CPU, (_WRITING * most_s,) * 2)
    left = "\t" * best.start[1]
    for number, row in enumerate(best.iter_rows(), start=1):
        text = "\t".join(map(_text, row))
        if text.strip("\t"):
            sys.stdout.write(f"{number}\t{left}{text}\n")
    return ""


def _far(archive: zipfile.ZipFile, name: str, most_cells: int) -> str:
    """Return a cell of a sheet that makes it too large, or nothing."""
    rest = b""
    with archive.open(name) as file:
        while block := file.read(_BLOCK_BYTES):
            block = rest + block
            rest = block[-40:]
            last = block.rfind(b" r=", 0, -20)
            for found in (_FAR_COLUMN.search(block), last >= 0 and _CELL.search(block, last)):
                if found and _column(found[1]) * int(found[2]) > most_cells:
                    return (found[1] + found[2]).decode()
    return ""


def _column(letters: bytes) -> int:
    number = 0
    for letter in letters:
        number = number * 26 + letter - 64
    return number


def _text(value: object) -> str:
    """Return a cell: numbers in full, times as ISO 8601."""
    if isinstance(value, float):
        if value != value:
            return ""
        return str(int(value)) if value.is_integer() else str(value)
    if isinstance(value, datetime | time):
        return value.isoformat()
    if isinstance(value, date):
        return datetime(value.year, value.month, value.day).isoformat()
    text = str(value)
    return "" if text in _NONE else " ".join(text.split())


if __name__ == "__main__":
    sys.stdout.reconfigure(encoding="utf-8", errors="replace", newline="\n")  # type: ignore[union-attr]
    try:
        wrong = _main(*map(int, sys.argv[1:]))
    except MemoryError:
        wrong = "!memory\t"
    except BrokenPipeError:  # whoever reads has seen enough
        wrong = ""
    except Exception as error:  # of a reader that is not ours
        wrong = f"!unreadable\t{' '.join(str(error).split())}"
    if wrong:
        print(wrong)
