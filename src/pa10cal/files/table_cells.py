"""Text of a user's files as one cell of a table, which is shown as it is and never run.

A label may be any text. A spreadsheet takes a cell that begins with one of a few signs for a
formula, also behind blanks and quotes; where lists are separated by semicolons, also what follows a
semicolon. A Markdown page takes some text for markup.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from itertools import chain

from pa10cal.errors import one_line

#: Numbers and words of letters, as most cells are: they stay as they are.
_PLAIN = re.compile(r"-?\d[\d.]*(?:e[-+]?\d+)?|[^\W\d_][\w .:/-]*")
_FORMULA = re.compile(
    r"[\s\x00-\x20\x7f\u200b\ufeff'\"]*([=+@\uff1d\uff0b\uff0d\uff20-].*)", re.DOTALL
)
_QUOTED = re.compile(r"[\",\r\n]")
_LISTS = re.compile(r"(;)")


def _runs(piece: str) -> bool:
    """Return whether a spreadsheet would run a text; it does not run numbers such as `-1.5`."""
    match = _FORMULA.fullmatch(piece)
    if match is None:
        return False
    try:
        float(match[1])
    except ValueError:
        return True
    return False


def csv_cell(value: object) -> object:
    """Return a value of a CSV cell, with an apostrophe before text that a spreadsheet would run.

    Numbers, also those given as text (`-1.5`, `+1`), stay as they are. `from_csv_cell` undoes it.
    """
    if not isinstance(value, str) or _PLAIN.fullmatch(value):
        return value
    return "".join(f"'{piece}" if _runs(piece) else piece for piece in _LISTS.split(value))


def from_csv_cell(text: str) -> str:
    """Return the text of a cell that `csv_cell` made."""
    if "'" not in text:
        return text
    return "".join(
        piece[1:] if piece.startswith("'") and _runs(piece[1:]) else piece
        for piece in _LISTS.split(text)
    )


def csv_line(cells: Iterable[object]) -> str:
    """Return a row of a CSV file with its newline; every value is one cell, None and nan are empty.

    A carriage return is quoted too, so the bytes are the same under every Python.
    """
    texts = []
    for cell in cells:
        text = "" if cell is None or cell != cell else str(csv_cell(cell))
        if _QUOTED.search(text):
            text = '"' + text.replace('"', '""') + '"'
        texts.append(text)
    return ",".join(texts if texts != [""] else ['""']) + "\n"


def csv_text(header: Iterable[object], rows: Iterable[Iterable[object]]) -> str:
    """Return a CSV file; all tables are written by it."""
    return "".join(map(csv_line, chain([header], rows)))


#: Signs that begin markup inside a line: escapes, code, formulas, emphasis (not `_` inside a word),
#: strikes, columns, tags, entities, links (not lists of numbers), addresses.
_MARKUP = re.compile(
    r"[\\`$*~|]|(?<![^\W_])_|_(?![^\W_])|<(?=[A-Za-z/!?])|&(?=#|\w+;)|\[(?!-?[\d., -]+\](?![(\[:]))"
    r"|:(?=//)|(?<=www)\.",
    re.IGNORECASE,
)


def markdown_cell(text: str) -> str:
    """Return text as the cell of a Markdown table: on one line, columns and markup escaped.

    Characters that are not visible, such as a mark of direction, are shown by their numbers.
    """
    return _MARKUP.sub(r"\\\g<0>", one_line(text.replace("\t", " ")))


def markdown_line(text: str) -> str:
    """Return text as a line of a Markdown page: a `markdown_cell` that does not begin a block."""
    line = markdown_cell(text).strip()
    # The number of a list item, or nothing before the sign of a heading, quote or list.
    head = re.match(r"\d{1,9}(?=[.)](\s|$))|(?=[#>+=-]([\s#>+=-]|$))", line)
    return line if head is None else f"{head[0]}\\{line[head.end() :]}"
