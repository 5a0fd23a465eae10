"""Lines of a file of rows: text in any usual encoding, or the rows of a workbook or of arrays.

Rows of files that are no text become lines too, with tabs between the cells: whatever reads a
table reads text. Such files are read in a child process, see `binary_child`, whose death is a
refusal. Its limits of memory and time hold whatever a file promises.
"""

from __future__ import annotations

import codecs
import csv
import gzip
import hashlib
import importlib.util
import io
import json
import os
import re
import signal
import subprocess
import sys
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, NamedTuple, cast

from pa10cal.errors import MissingPackageError, RawDataError
from pa10cal.input_files import names_beside, open_file, reason

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
#: Beginnings of files that are packed in another way than with gzip.
_PACKED = {
    b"\x28\xb5\x2f\xfd": "zstd",
    b"\xfd7zXZ": "xz",
    b"BZh": "bzip2",
    b"7z\xbc\xaf": "7-Zip",
    b"PK\x03\x04": "zip",
}
#: Remedy for a file that is too large.
_LEAVE_OUT = (
    "leave out what is not needed, such as samples between the dwells, or split the campaign"
)
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
    """Return the encoding of a file of text, by all its bytes.

    It is that of a byte-order mark, else UTF-8 if valid, else the encoding of one byte a letter in
    which most letters beyond ASCII are usual ones.

    Raises:
        RawDataError: as `lines_of`; it is here that a file is found to be too large.
    """
    head, beyond_ascii, is_utf8 = _read_through(path, within)
    for mark, encoding in _MARKS:
        if head.startswith(mark):
            return encoding
    packed = next((how for begins, how in _PACKED.items() if head.startswith(begins)), "")
    kind = _kind_of_bytes(head, path.with_suffix("").suffix.lower())  # name.mat of name.mat.gz
    if packed or kind:
        raise RawDataError(
            "the file is packed in a way that is not read",
            where=str(path),
            value=packed or "gzip, of a file that is no text",
            allowed="files as they are, and text packed with gzip",
            remedy="unpack it",
        )
    if b"\x00" in head:
        # ASCII in UTF-16 has a zero in every second byte: behind each letter, or before it.
        even, uneven = head[::2].count(0), head[1::2].count(0)
        if max(even, uneven) > 0.4 * len(head) / 2 and min(even, uneven) == 0:
            return "utf-16-le" if uneven > even else "utf-16-be"
        raise _no_text(f"{path}:1", head)

    def usual(encoding: str) -> tuple[int, int]:
        letters = beyond_ascii.decode(encoding, errors="replace")
        # The commonest of all decides where others are as many: `°` of a Macintosh is `í` in DOS.
        return sum(letter in _USUAL for letter in letters), letters.count("°")

    return "utf-8" if is_utf8 else max(_ONE_BYTE, key=usual)


def _read_through(path: Path, within: Path | None) -> tuple[bytes, bytes, bool]:
    """Return the first bytes of a file, those beyond ASCII, and whether all are valid UTF-8."""
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
                    remedy=_LEAVE_OUT,
                )
            if valid:
                try:
                    decoder.decode(block)
                except UnicodeDecodeError:
                    valid = False
            odd += block.translate(None, _ASCII)[: BLOCK_BYTES - len(odd)]
    return head, bytes(odd), valid


def binary_kind(path: Path, within: Path | None = None) -> str:
    """Return the kind of a file that is no text, such as workbook; empty for text."""
    with _opened(path, within) as content:
        return _kind_of_bytes(content.read(HEAD_BYTES), path.suffix.lower())


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
        file.seek(0)  # the child reads on from where the file stands
        if read in _RECENT:
            lines, said = _RECENT[read]
            notes += said
            yield from lines
            return
        lines = []
        for number, text in _rows_of_child(kind, path, file, names, said):
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
        remedy=_LEAVE_OUT,
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


# Files that are no text, by the bytes at their beginning, and their rows.

#: Limits of the child, within which are a million rows of ten numbers: memory [bytes], time on the
#: processor [s].
MOST_BYTES, MOST_S = 1_025_000_000, 18
#: Largest file, unpacked [bytes], and largest sheet of a workbook [cells].
MOST_UNPACKED, MOST_CELLS = 1_000_000_000, 20_000_000

#: Bags of ROS 1, and of ROS 2 in its two ways to store them.
BAGS = ("bag", "db3", "mcap")
#: Bytes at the beginning of a file by which its kind is recognised.
HEAD_BYTES = 1024
#: Beginnings of files, by kind; of archives (.xlsx, .ods), and of older workbooks (.xls).
_BEGINNINGS = (
    (b"\xd0\xcf\x11\xe0", "workbook"),
    (b"MATLAB 7.3 MAT-file", "hdf5"),
    (b"\x89HDF\r\n\x1a\n", "hdf5"),
    (b"MATLAB 5.0 MAT-file", "mat"),
    (b"PAR1", "parquet"),
    (b"\x93NUMPY", "npz"),
    (b"#ROSBAG V2.0", "bag"),
    (b"SQLite format 3\x00", "db3"),
    (b"\x89MCAP0\r\n", "mcap"),
)
#: C3D: the first byte is the block of the parameters, the second is 0x50.
_C3D = re.compile(rb"[\x01-\x08]\x50", re.DOTALL)
_ARCHIVE = b"PK\x03\x04"
_JSON = re.compile(rb'(?:\xef\xbb\xbf)?\s*(?:\[\s*)?\{\s*(?:"|\})')
#: Optional packages by the kind that they read.
_BAG = "rosbags"
_PACKAGES = {"workbook": "python_calamine", "c3d": "ezc3d"} | dict.fromkeys(BAGS, _BAG)
_TITLES = {
    "workbook": "the workbook",
    "mat": "the MATLAB file",
    "npz": "the NumPy file",
    "json": "the JSON file",
    "parquet": "the Parquet file",
    "c3d": "the C3D file",
} | dict.fromkeys(BAGS, "the bag")


def _kind_of_bytes(head: bytes, suffix: str) -> str:
    """Return the kind of a file that is read as arrays or cells; empty for text."""
    for beginning, kind in _BEGINNINGS:
        if head.startswith(beginning):
            return kind
    if head.startswith(_ARCHIVE) and suffix != ".zip":
        return "npz" if suffix == ".npz" else "workbook"
    if suffix == ".mat" and b"\x00" in head:  # version 4 has no words at its beginning
        return "mat"
    if _C3D.match(head):
        return "c3d"
    return "json" if _JSON.match(head) else ""


def _rows_of_child(
    kind: str, path: Path, file: IO[bytes], names: Mapping[str, Sequence[str]], notes: list[str]
) -> Iterator[tuple[int, str]]:
    """Yield the rows of a file: numbers from 1, tabs between the cells.

    Of a workbook they are those of the sheet with the most cells; of arrays those of the length
    that most columns have, below a row of names.

    Args:
        kind: what the file is, see `_kind_of_bytes`.
        path: what messages name.
        file: the file, open at its beginning.
        names: names of the columns of arrays, by the name of the array.
        notes: a list to which parts that are not read are added.

    Raises:
        RawDataError: when it cannot be read, or not within limits of memory and time.
    """
    if kind == "hdf5":
        raise RawDataError(
            "the file is HDF5, as MATLAB writes it with -v7.3",
            where=str(path),
            allowed="a MATLAB file of version 7 or before, or text",
            remedy="in MATLAB save it as version 7, save('name.mat', '-v7'), or write a table: "
            "writematrix([q p], 'name.csv')",
        )
    package = _PACKAGES.get(kind)
    if package is not None and importlib.util.find_spec(package) is None:
        raise MissingPackageError(package)
    limits = (MOST_BYTES, MOST_S, MOST_UNPACKED, MOST_CELLS)
    child = subprocess.Popen(
        [sys.executable, "-P", str(Path(__file__).with_name("binary_child.py"))]
        + [kind, json.dumps({name: list(of) for name, of in names.items()})]
        + [str(limit) for limit in limits],
        stdin=file,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        encoding="utf-8",
    )
    assert child.stdout is not None
    try:
        for line in child.stdout:
            number, _, text = line.removesuffix("\n").partition("\t")
            if number.startswith("!"):
                raise _refused(path, kind, number[1:], text)
            if number == "?":
                notes.append(text)
            else:
                yield int(number), text
        if child.wait():
            slow = -child.returncode in (signal.SIGXCPU, signal.SIGKILL)
            raise _refused(path, kind, "time" if slow else "memory", "")
    finally:
        child.kill()
        child.stdout.close()
        child.wait()


#: Refusals (message, what is allowed, remedy) by the reason of the child, and by the kind of
#: file where that matters.
_REFUSALS = {
    "unreadable": (
        "{title} cannot be read",
        "a whole file, as it was written",
        "copy or save it again, or export the rows as text",
    ),
    "unreadable workbook": (
        "{title} cannot be read",
        "a workbook without a password (.xlsx, .ods or .xls)",
        "save it again, or export the sheet as text",
    ),
    "json": (
        "{title} is cut short or damaged",
        "a whole document, or a whole record in each line",
        "copy or save it again",
    ),
    "objects": (
        "{title} holds no arrays",
        "matrices, or structs of them",
        "in MATLAB write it as text: writetable(T, 'name.csv')",
    ),
    "topics": (
        "{title} holds neither joints nor a target",
        "messages of sensor_msgs/JointState, or of geometry_msgs: PoseStamped, PointStamped, "
        "TransformStamped; tf",
        "record the topic of the joints' states, or that of the target",
    ),
    "arrays": (
        "{title} holds no arrays with a row for each configuration",
        "arrays of as many rows: joint positions, and what was measured",
        "save both with a row for each configuration, or export them as text",
    ),
    "cell": (
        "a cell stands far from the others",
        "a sheet of at most {cells} cells, counted from A1 to the last one",
        "delete the rows and columns beyond the table, or save the sheet as CSV",
    ),
    "unpacked": (
        "{title}, unpacked, is larger than is read",
        "at most {unpacked_mb:.0f} MB",
        "save what is needed as CSV",
    ),
    "unpacked workbook": (
        "{title}, unpacked, is larger than is read",
        "at most {unpacked_mb:.0f} MB",
        "save the sheet as CSV, without what is not needed",
    ),
}


def _refused(path: Path, kind: str, why: str, said: str) -> RawDataError:
    limits = {"cells": MOST_CELLS, "unpacked_mb": MOST_UNPACKED / 1e6}
    where, value = str(path), said
    if why in ("memory", "time"):
        what = "{title} needs more memory or time than tables of readings do"
        allowed = f"at most {MOST_BYTES / 1e6:.0f} MB and {MOST_S} s"
        remedy = f"save {'the sheet' if kind == 'workbook' else 'what is needed'} as CSV"
        value = f"more {why}"
    else:
        what, allowed, remedy = _REFUSALS.get(f"{why} {kind}") or _REFUSALS[why]
    if why == "json":
        line, _, value = said.partition("\t")
        where = f"{path}:{line}"
    return RawDataError(
        what.format(title=_TITLES[kind]),
        where=where,
        value=value,
        allowed=allowed.format(**limits),
        remedy=remedy,
    )
