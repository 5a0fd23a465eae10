"""Text of a user's files as a cell of a table: shown as it is, run by nothing.

A label may be anything. A spreadsheet takes a cell that begins with one of a few signs for a
formula, and a Markdown page takes some text for markup.
"""

from __future__ import annotations

import re

_FORMULA = ("=", "+", "-", "@", "\t", "\r")
_TAG = re.compile(r"<(?=[A-Za-z/!?])")
_LINK = re.compile(r"\[(?=[^\]]*\][(\[:])")


def csv_cell(value: object) -> object:
    """Return a value of a CSV cell; text that a spreadsheet would run begins with an apostrophe.

    Numbers, also those given as text (`-1.5`, `+1`), stay as they are.
    """
    if not isinstance(value, str) or not value.startswith(_FORMULA):
        return value
    try:
        float(value)
    except ValueError:
        return f"'{value}"
    return value


def markdown_cell(text: str) -> str:
    """Return text as the cell of a Markdown table: on one line, without columns or markup."""
    text = " ".join(text.split("\n")).replace("|", "\\|")
    return _LINK.sub(r"\\[", _TAG.sub(r"\\<", text))
