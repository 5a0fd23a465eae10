"""Lines of a file of rows: text in any usual encoding, or the rows of a workbook or of arrays.

Files that cannot be read, are damaged, or are too large are refused before any row is yielded.
"""

from __future__ import annotations

import codecs
import csv
import gzip
import hashlib
import io
import json
import os
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, NamedTuple, cast

from pa10cal.campaign.binary_rows import HEAD_BYTES, kind_of_bytes, rows_of_binary
from pa10cal.errors import RawDataError
from pa10cal.input_files import open_file, reason

#: Largest files that are read, unpacked, and most lines.
LARGEST_BYTES, MOST_LINES = 310_000_000, 5_000_000
#: Bytes that are read at a time; a longer line is none of a table.
BLOCK_BYTES = 1 << 20
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
#: Letters that such files usually have besides ASCII: units, German, French and Spanish.
_USUAL = frozenset("°µ²³±ΔäöüÄÖÜßàâçèéêëîïôùûÀÇÈÉÊáíóúñÁÍÓÚÑ")
_ASCII = bytes(range(128))
#: Files beside a data set of lerobot that state the names of columns of arrays.
_STATES_NAMES = ("meta/info.json", "info.json")
#: Beginnings of files that are packed in another way than with gzip.
_PACKED = {
    b"\x28\xb5\x2f\xfd": "zstd",
    b"\xfd7zXZ": "xz",
    b"BZh": "bzip2",
    b"7z\xbc\xaf": "7-Zip",
    b"PK\x03\x04": "zip",
}
#: Signs that end a field of a table, or quote it.
_NOT_IN_FIELDS = str.maketrans('\t"\n', " ' ")


class TextLine(NamedTuple):
    """A line that is not blank."""

    number: int  # from 1
    text: str
    ended: bool  # whether a line end follows


def comma_fields(text: str) -> list[str]:
    """Return the fields of a line with commas between them, quoted or not."""
    try:
        fields = next(csv.reader([text]), [])
    except csv.Error:  # a field of more than 131072 characters
        fields = text.split(",")
    return [field.strip() for field in fields]


def table_row(fields: Iterable[str]) -> str:
    """Return a row of a table that is made of a file: tabs between the fields."""
    return "\t".join(field.translate(_NOT_IN_FIELDS) for field in fields)


def lines_of(
    path: Path, within: Path | None = None, notes: list[str] | None = None
) -> Iterator[TextLine]:
    """Yield the lines that are not blank; rows of a file that is no text with tabs between cells.

    Args:
        path: the file.
        within: folder that it must lie in; None for anywhere.
        notes: a list to which parts of the file that are not read are added.

    Raises:
        RawDataError: when the file is not there, damaged, larger than is read, or cannot be read.
    """
    if kind := binary_kind(path, within):
        yield from _rows_of_binary(kind, path, within, [] if notes is None else notes)
        return
    encoding = encoding_of(path, within)
    with _unpacked(path, within) as content:
        text = io.TextIOWrapper(content, encoding=encoding, errors="replace")
        for number, line in enumerate(text, start=1):
            if "\x00" in line:
                raise _no_text(f"{path}:{number}")
            if line.strip():
                yield TextLine(number, line.removesuffix("\n"), line.endswith("\n"))


def encoding_of(path: Path, within: Path | None = None) -> str:
    """Return the encoding of a file of text, by its bytes; see `lines_of`.

    It is that of a byte-order mark, else UTF-8 if valid, else the encoding of one byte a letter in
    which most letters beyond ASCII are usual ones.
    """
    decoder = codecs.getincrementaldecoder("utf-8")()
    valid, size, lines, odd, head = True, 0, 1, bytearray(), b""
    with _unpacked(path, within) as content:
        while block := content.read(BLOCK_BYTES):
            head = head or block[:4096]
            size += len(block)
            if size > LARGEST_BYTES:
                raise _too_large(path)
            ends = max(block.count(b"\n"), block.count(b"\r"))
            if not ends and len(block) == BLOCK_BYTES:
                raise RawDataError(
                    "a line is too long for rows of numbers",
                    where=f"{path}:{lines}",
                    allowed=f"at most {BLOCK_BYTES} letters",
                    remedy="export the file with a line for each row",
                )
            lines += ends
            if lines > MOST_LINES:
                raise RawDataError(
                    "the file has too many lines",
                    where=str(path),
                    allowed=f"at most {MOST_LINES}",
                    remedy="leave out what is not needed, such as samples between the dwells, or "
                    "split the campaign",
                )
            if valid:
                try:
                    decoder.decode(block)
                except UnicodeDecodeError:
                    valid = False
            odd += block.translate(None, _ASCII)[: BLOCK_BYTES - len(odd)]
    for mark, encoding in _MARKS:
        if head.startswith(mark):
            return encoding
    packed = next((how for begins, how in _PACKED.items() if head.startswith(begins)), "")
    if packed or kind_of_bytes(head, path.with_suffix("").suffix.lower()):
        raise RawDataError(
            "the file is packed in a way that is not read",
            where=str(path),
            value=packed or "gzip, of a file that is no text",
            allowed="files as they are, and text packed with gzip",
            remedy="unpack it",
        )
    if b"\x00" in head:
        even, uneven = head[::2].count(0), head[1::2].count(0)
        if max(even, uneven) > 0.4 * len(head) / 2 and min(even, uneven) == 0:
            return "utf-16-le" if uneven > even else "utf-16-be"
        raise _no_text(f"{path}:1", head)

    def usual(encoding: str) -> int:
        return sum(letter in _USUAL for letter in odd.decode(encoding, errors="replace"))

    return "utf-8" if valid else max(_ONE_BYTE, key=usual)


def binary_kind(path: Path, within: Path | None = None) -> str:
    """Return the kind of a file that is no text, such as workbook; empty for text."""
    with _opened(path, within) as content:
        return kind_of_bytes(content.read(HEAD_BYTES), path.suffix.lower())


def _opened(path: Path, within: Path | None) -> io.BufferedReader:
    try:
        return open_file(path, within)
    except FileNotFoundError:
        raise RawDataError(
            "the file is not there",
            where=str(path),
            allowed="a text file, plain or gzipped, or a workbook",
            remedy="check the path and the name",
        ) from None
    except OSError as error:
        raise RawDataError(
            f"the file cannot be read: {reason(error)}",
            where=str(path),
            allowed="a text file, plain or gzipped, or a workbook",
            remedy="give a file that can be read",
        ) from None


@contextmanager
def _unpacked(path: Path, within: Path | None) -> Iterator[IO[bytes]]:
    """Open a file, plain or gzipped."""
    with _opened(path, within) as content:
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


def _rows_of_binary(
    kind: str, path: Path, within: Path | None, notes: list[str]
) -> Iterator[TextLine]:
    """Yield the rows of a file that is no text; numbers in full, times as ISO 8601."""
    letters, names, said = 0, {}, list[str]()
    if kind in ("json", "parquet") and (stated := names_beside(path)) is not None:
        names = _names_in(stated)
    with _opened(path, within) as file:
        if os.fstat(file.fileno()).st_size > LARGEST_BYTES:
            raise _too_large(path)
        read = hashlib.file_digest(file, "sha256").hexdigest(), kind, json.dumps(names)
        file.seek(0)
        if read in _RECENT:
            lines, said = _RECENT[read]
            notes += said
            yield from lines
            return
        lines = []
        for number, text in rows_of_binary(kind, path, file, names, said):
            letters += len(text)
            if letters > LARGEST_BYTES:
                raise _too_large(path)
            line = TextLine(number, text, ended=True)
            if letters <= _RECENT_LETTERS:
                lines.append(line)
            yield line
    notes += said
    if letters <= _RECENT_LETTERS:
        _RECENT[read] = lines, said
        if len(_RECENT) > _RECENT_FILES:
            del _RECENT[next(iter(_RECENT))]


#: Rows of files that were read lately, by content and kind, as one command reads a file several
#: times; files and letters kept, at most.
_RECENT: dict[tuple[str, str, str], tuple[list[TextLine], list[str]]] = {}
_RECENT_FILES, _RECENT_LETTERS = 4, 20_000_000


def names_beside(path: Path) -> Path | None:
    """Return the file that may state the names of the columns of `path`; None for none."""
    stated = (path.parent / each for each in _STATES_NAMES)
    return next((each for each in stated if each.is_file()), None)


def _names_in(path: Path) -> dict[str, list[str]]:
    """Return names of columns by array, as a data set of lerobot states them; empty if it does not.

    The file must lie in the folder of the data.
    """
    folder = path.parents[1] if path.parent.name == "meta" else path.parent
    try:
        with open_file(path, folder) as file:
            features = json.loads(file.read(BLOCK_BYTES))["features"]
        stated = {key: feature.get("names") for key, feature in features.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}
    names = {}
    for key, listed in stated.items():
        # Older data sets have one more level, by the kind of the axis: {"motors": [...]}.
        if isinstance(listed, dict) and len(listed) == 1:
            (listed,) = listed.values()
        if isinstance(listed, list) and all(isinstance(name, str) for name in listed):
            prefix = "" if key == "observation.state" else f"{key} "
            names[key] = [f"{prefix}{name}" for name in listed]
    return names


def _too_large(path: Path) -> RawDataError:
    most_mb = LARGEST_BYTES / 1e6
    return RawDataError(
        "the file, unpacked, is larger than is read",
        where=str(path),
        value=f"more than {most_mb:.0f} MB",
        allowed=f"at most {most_mb:.0f} MB of text",
        remedy="leave out what is not needed, such as samples between the dwells, or split the "
        "campaign",
    )


def _no_text(where: str, head: bytes = b"") -> RawDataError:
    begins = "".join(
        letter for letter in head[:20].decode("ascii", "ignore") if " " <= letter <= "~"
    )
    return RawDataError(
        "the file is not UTF-8 text, nor text in another usual encoding",
        where=where,
        value=f"it begins with {begins}" if begins else None,
        allowed="UTF-8, UTF-16, or an encoding of Windows (cp1252) or DOS (cp850); or a file of "
        "arrays, a workbook, a take or a bag as docs/raw-data.md lists them",
        remedy="export it as UTF-8, or a file of another version in one that is listed",
    )
