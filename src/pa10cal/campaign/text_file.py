"""Lines of a file of text, whatever its encoding: plain, gzipped, or a sheet of a workbook."""

from __future__ import annotations

import codecs
import gzip
import importlib
import io
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, NamedTuple, cast

import pandas as pd

from pa10cal.errors import RawDataError

#: Files of more text than this, unpacked, are refused; so many bytes are read at a time.
LARGEST_BYTES = 310_000_000
BLOCK_BYTES = 1 << 22
#: Byte-order marks, the longest first: that of UTF-32 begins with that of UTF-16.
_MARKS = (
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
#: Encodings of one byte a letter, the commonest first: Windows, DOS, old Macintosh.
_ONE_BYTE = ("cp1252", "cp850", "mac_roman")
#: What such files hold besides ASCII: units, letters of German, French and Spanish.
_USUAL = frozenset("°µ²³±ΔäöüÄÖÜßàâçèéêëîïôùûÀÇÈÉÊáíóúñÁÍÓÚÑ")
#: Beginnings of workbooks: of archives (.xlsx, .ods), and of the older kind (.xls).
_ARCHIVE, _OLE = b"PK\x03\x04", b"\xd0\xcf\x11\xe0"


class Line(NamedTuple):
    """A line that is not blank."""

    number: int  # from 1
    text: str
    ended: bool  # whether a line end follows


def lines_of(path: Path) -> Iterator[Line]:
    """Yield the lines that are not blank; rows of a workbook with tabs between the cells.

    Raises:
        RawDataError: when the file is not there, damaged, larger than is read, or no text.
    """
    if is_workbook(path):
        yield from _rows_of_workbook(path)
        return
    encoding = encoding_of(path)
    with _unpacked(path) as content:
        text = io.TextIOWrapper(content, encoding=encoding, errors="replace")
        for number, line in enumerate(text, start=1):
            if "\x00" in line:
                raise _no_text(path, number)
            if line.strip():
                yield Line(number, line.removesuffix("\n"), line.endswith("\n"))


def encoding_of(path: Path) -> str:
    """Return the encoding of a file of text, told from its bytes; see `lines_of`.

    A byte-order mark says it; text that is valid UTF-8 is UTF-8; of one byte a letter it is the
    encoding whose letters are such as units, German, French and Spanish have.
    """
    decoder = codecs.getincrementaldecoder("utf-8")()
    valid, size, odd, head = True, 0, bytearray(), b""
    with _unpacked(path) as content:
        while block := content.read(BLOCK_BYTES):
            head = head or block[:4096]
            size += len(block)
            if size > LARGEST_BYTES:
                raise _too_large(path)
            if valid:
                try:
                    decoder.decode(block)
                except UnicodeDecodeError:
                    valid = False
            odd += block.translate(None, _ASCII)[: BLOCK_BYTES - len(odd)]
    for mark, encoding in _MARKS:
        if head.startswith(mark):
            return encoding
    if b"\x00" in head:
        even, uneven = head[::2].count(0), head[1::2].count(0)
        if max(even, uneven) > 0.4 * len(head) / 2 and min(even, uneven) == 0:
            return "utf-16-le" if uneven > even else "utf-16-be"
        raise _no_text(path, 1)
    if valid:
        return "utf-8"

    def usual(encoding: str) -> int:
        return sum(letter in _USUAL for letter in odd.decode(encoding, errors="replace"))

    return max(_ONE_BYTE, key=usual)


_ASCII = bytes(range(128))


def is_workbook(path: Path) -> bool:
    """Return whether a file is a workbook, such as .xlsx, .ods or .xls."""
    try:
        with path.open("rb") as content:
            head = content.read(4)
    except OSError as error:
        raise _unreadable(path, error) from None
    return head == _OLE or (head == _ARCHIVE and path.suffix.lower() != ".zip")


@contextmanager
def _unpacked(path: Path) -> Iterator[IO[bytes]]:
    """Open a file, plain or gzipped."""
    try:
        content = path.open("rb")
    except OSError as error:
        raise _unreadable(path, error) from None
    with content:
        packed = content.read(2) == b"\x1f\x8b"
        content.seek(0)
        try:
            yield cast("IO[bytes]", gzip.GzipFile(fileobj=content)) if packed else content
        except (EOFError, gzip.BadGzipFile, zlib.error):
            raise RawDataError(
                "the compressed file is damaged or cut short",
                where=str(path),
                allowed="a whole gzip file",
                remedy="copy or export it again",
            ) from None


def _rows_of_workbook(path: Path) -> Iterator[Line]:
    """Yield the rows of the sheet with the most cells; numbers in full, times as ISO 8601."""
    if path.stat().st_size > LARGEST_BYTES:
        raise _too_large(path)
    importlib.import_module("python_calamine")  # said by its name where it is missing
    try:
        sheets = pd.read_excel(path, sheet_name=None, header=None, dtype=object, engine="calamine")
    except Exception as error:
        raise RawDataError(
            "the workbook cannot be read",
            where=str(path),
            value=" ".join(str(error).split()),
            allowed="a workbook without a password (.xlsx, .ods or .xls)",
            remedy="save it again, or export the sheet as text",
        ) from None
    sheet = max(sheets.values(), key=lambda each: int(each.notna().to_numpy().sum()), default=None)
    if sheet is None:
        return
    for number, row in enumerate(sheet.itertuples(index=False), start=1):
        cells = [_cell(value) for value in row]
        if any(cells):
            yield Line(number, "\t".join(cells), ended=True)


def _cell(value: object) -> str:
    if value is None or value is pd.NaT or (isinstance(value, float) and value != value):
        return ""
    if isinstance(value, float) and value.is_integer() and abs(value) < 1e15:
        return str(int(value))
    text = value.isoformat() if hasattr(value, "isoformat") else str(value)
    return " ".join(text.split())


def _no_text(path: Path, line: int) -> RawDataError:
    return RawDataError(
        "the file is not UTF-8 text, nor text in another usual encoding",
        where=f"{path}:{line}",
        allowed="UTF-8, UTF-16, or an encoding of Windows (cp1252) or DOS (cp850)",
        remedy="export it as UTF-8",
    )


def _too_large(path: Path) -> RawDataError:
    return RawDataError(
        "the file, unpacked, is larger than is read",
        where=str(path),
        value=f"more than {LARGEST_BYTES / 1e6:.0f} MB",
        allowed=f"at most {LARGEST_BYTES / 1e6:.0f} MB of text",
        remedy="leave out what is not needed, such as samples between the dwells, or "
        "split the campaign",
    )


def _unreadable(path: Path, error: OSError) -> RawDataError:
    there = path.exists()
    return RawDataError(
        "the file cannot be read" if there else "the file is not there",
        where=str(path),
        value=error.strerror or str(error),
        allowed="a text file, plain or gzipped, or a workbook",
        remedy="check its permissions" if there else "check the path and the name",
    )
