"""CSV as it comes from instruments: rows as text with their physical lines, bad rows listed.

What makes a single row unusable quarantines it; what makes the file unusable (another
separator, decimal commas throughout, a missing column, nothing in it) stops with one message.
"""

from __future__ import annotations

import difflib
import gzip
import zlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pa10cal.campaign.quarantine import Quarantined, quarantined
from pa10cal.errors import RawDataError

Array = NDArray[np.float64]

#: Share of rows that must write their last field in one format for a shorter one to count as cut.
SAME_FORMAT = 0.99

CUT = "the last line is cut short"
FIELDS = "the number of fields differs from the header"


@dataclass(frozen=True)
class RawRows:
    """Rows of one CSV file, as text.

    Attributes:
        file: name of the file.
        columns: fields of every column, in the order of the file.
        line: (N,) physical line of every row, the header being line 1.
        total: rows in the file, quarantined ones included.
        unused: columns that were not requested.
        quarantined: rows that are not used.
    """

    file: str
    columns: dict[str, NDArray[np.object_]]
    line: NDArray[np.int64]
    total: int
    unused: tuple[str, ...]
    quarantined: tuple[Quarantined, ...]

    def take(self, keep: NDArray[np.bool_], reason: str, values: Sequence[object]) -> RawRows:
        """Keep some rows; quarantine the others with a reason and (for each of them) a value."""
        return RawRows(
            self.file,
            {name: column[keep] for name, column in self.columns.items()},
            self.line[keep],
            self.total,
            self.unused,
            (*self.quarantined, *quarantined(self.file, self.line[~keep], reason, values)),
        )


def column_names(path: Path) -> list[str]:
    """Return the names in the header of a CSV file, none where there is no header."""
    header = next((text for text in _read_lines(path) if text.strip()), "")
    return _fields(header) if header else []


def read_rows(
    path: Path,
    required: Sequence[str],
    optional: Sequence[str] = (),
    together: Sequence[str] = (),
) -> RawRows:
    """Read a CSV file, plain or gzipped.

    Rows with another number of fields than the header, exact repeats of an earlier row and a last
    line that was cut short are quarantined.

    Args:
        path: the file; a byte-order mark and Windows line ends are accepted.
        required: columns that must be there.
        optional: columns that may be there.
        together: columns that are all there or all absent.

    Raises:
        RawDataError: when the file is empty, is no UTF-8 text, uses another separator or decimal
            commas throughout, or lacks a required column.
    """
    lines = _read_lines(path)
    ended = lines[-1] == ""
    numbered = [(k, text) for k, text in enumerate(lines, start=1) if text.strip()]
    if not numbered:
        raise _refusal(path, 1, "the file is empty", "a header and rows", "export it again")
    header_line, header_text = numbered[0]
    header = _fields(header_text)
    needed = [*required, *(together if set(together) & set(header) else ())]
    _check_header(path, header_line, header_text, header, needed)
    rows = [_fields(text) for _, text in numbered[1:]]
    line = np.array([k for k, _ in numbered[1:]], dtype=np.int64)
    if not rows:
        raise _refusal(path, header_line, "there is no row under the header", "rows", "export it")
    widths = np.array([len(row) for row in rows])
    _refuse_systematic_width(path, widths, len(header), line)
    right = widths == len(header)
    cut = not ended and widths[-1] < len(header)
    wrong = ~right
    wrong[-1] &= not cut
    listed = (
        *quarantined(path.name, line[wrong], f"{FIELDS} {len(header)}", widths[wrong]),
        *quarantined(path.name, line[-1:] if cut else [], CUT, [numbered[-1][1]] if cut else []),
    )
    table = np.array([row for row in rows if len(row) == len(header)], dtype=object)
    columns = dict(zip(header, table.T, strict=True))
    unused = tuple(name for name in header if name not in (*needed, *optional))
    raw = RawRows(path.name, columns, line[right], len(rows), unused, listed)
    if not ended and right[-1]:
        raw = _without_cut_last(raw, header[-1])
    return _without_repeats(raw)


def numbers(
    raw: RawRows, names: Sequence[str], *, may_be_blank: bool = False
) -> tuple[RawRows, Array]:
    """Read columns as finite numbers; rows where one is none are quarantined.

    Args:
        raw: the rows.
        names: columns.
        may_be_blank: whether an empty field is nan, rather than none.

    Returns:
        The remaining rows and their numbers (N, len(names)).
    """
    parsed = np.empty((len(raw.line), len(names)))
    good = np.empty(parsed.shape, dtype=bool)
    for k, name in enumerate(names):
        column = raw.columns[name]
        parsed[:, k] = pd.to_numeric(pd.Series(column), errors="coerce")
        good[:, k] = np.isfinite(parsed[:, k]) | ((column == "") if may_be_blank else False)
    keep = np.asarray(good.all(axis=1))
    if keep.all():
        return raw, parsed
    first_bad = np.argmin(good[~keep], axis=1)
    rows = np.flatnonzero(~keep)
    values = [
        f"{names[k]} = {raw.columns[names[k]][row]!r}"
        for row, k in zip(rows, first_bad, strict=True)
    ]
    return raw.take(keep, "not a finite number", values), parsed[keep]


def whole_numbers(raw: RawRows, name: str) -> tuple[RawRows, NDArray[np.int64]]:
    """Read a column as whole numbers; other rows are quarantined."""
    raw, found = numbers(raw, [name])
    column = found[:, 0]
    keep = column == np.round(column)
    values = [f"{name} = {value:g}" for value in column[~keep]]
    return raw.take(keep, "not a whole number", values), column[keep].astype(np.int64)


def choices(raw: RawRows, name: str, allowed: Sequence[str]) -> RawRows:
    """Keep the rows whose column holds one of the allowed words."""
    column = raw.columns[name]
    keep = np.isin(column.astype(str), list(allowed))
    values = [f"{name} = {value!r}" for value in column[~keep]]
    return raw.take(keep, f"{name} is none of {', '.join(allowed)}", values)


def _read_lines(path: Path) -> list[str]:
    """Return the physical lines; the last is empty when the file ends with a line end."""
    content = path.read_bytes()
    if content[:2] == b"\x1f\x8b":
        try:
            content = gzip.decompress(content)
        except (EOFError, gzip.BadGzipFile, zlib.error):
            raise RawDataError(
                "the compressed file is damaged or cut short",
                where=str(path),
                allowed="a whole gzip file",
                remedy="copy or export it again",
            ) from None
    if b"\x00" in content:
        raise _refusal(path, 1, "the file is not UTF-8 text", "UTF-8", "export it as UTF-8")
    text = content.decode("utf-8-sig", errors="replace")
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def _fields(text: str) -> list[str]:
    return [field.strip(' \t"') for field in text.split(",")]


def _check_header(
    path: Path, line: int, text: str, header: Sequence[str], required: Sequence[str]
) -> None:
    for separator, name in ((";", "semicolons"), ("\t", "tabs")):
        if text.count(separator) > text.count(","):
            raise _refusal(
                path,
                line,
                f"the fields are separated by {name}",
                "commas between fields, decimal points",
                "export the file with commas, and with decimal points",
            )
    twice = [name for name, times in Counter(header).items() if times > 1]
    if twice:
        raise _refusal(path, line, f"column {twice[0]} occurs twice", "once", "remove one")
    missing = [name for name in required if name not in header]
    if missing:
        others = [name for name in header if name not in required]
        near = difflib.get_close_matches(missing[0], others, n=1, cutoff=0.5)
        raise RawDataError(
            f"missing column{'s' if len(missing) > 1 else ''} {', '.join(missing)}",
            where=f"{path}:{line}",
            value=", ".join(header),
            allowed=", ".join(required),
            remedy=f"is it {near[0]!r}? rename it" if near else "add it, or check the header",
        )


def _refuse_systematic_width(
    path: Path, widths: NDArray[np.int64], expected: int, line: NDArray[np.int64]
) -> None:
    wrong = widths != expected
    if 2 * wrong.sum() <= len(widths):
        return
    first = int(np.argmax(wrong))
    commas = widths[first] > expected
    raise _refusal(
        path,
        int(line[first]),
        f"{wrong.sum()} of {len(widths)} rows have another number of fields than the header "
        f"({widths[first]} for {expected})" + ("; decimal commas" if commas else ""),
        "one field for each column, decimal points",
        "export the file with decimal points" if commas else "export the file again",
    )


def _without_cut_last(raw: RawRows, last_column: str) -> RawRows:
    """Quarantine a last line without a line end whose last number lacks digits others have."""
    decimals = np.array([len(field.partition(".")[2]) for field in raw.columns[last_column]])
    usual = int(np.bincount(decimals).argmax())
    if decimals[-1] >= usual or np.mean(decimals[:-1] == usual) < SAME_FORMAT:
        return raw
    keep = np.arange(len(decimals)) < len(decimals) - 1
    return raw.take(keep, CUT, [raw.columns[last_column][-1]])


def _without_repeats(raw: RawRows) -> RawRows:
    keep = ~pd.DataFrame(raw.columns).duplicated().to_numpy()
    return raw.take(keep, "repeats an earlier row", [""] * int((~keep).sum()))


def _refusal(path: Path, line: int, what: str, allowed: str, remedy: str) -> RawDataError:
    return RawDataError(what, where=f"{path}:{line}", allowed=allowed, remedy=remedy)
