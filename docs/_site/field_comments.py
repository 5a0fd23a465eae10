"""What comments say of a class's fields: each stands behind its field, or above it."""

from __future__ import annotations

import ast
import inspect
import textwrap
from functools import cache


@cache
def comments(of: type) -> dict[str, str]:
    """Return the comment on every field that a class itself defines; empty where there is none."""
    lines = textwrap.dedent(inspect.getsource(of)).splitlines()
    found = {}
    for statement in ast.parse("\n".join(lines)).body[0].body:  # type: ignore[attr-defined]
        if not isinstance(statement, ast.AnnAssign):
            continue
        row = statement.lineno - 2
        above: list[str] = []
        while lines[row].lstrip().startswith("# "):
            above.insert(0, lines[row].lstrip()[2:])
            row -= 1
        behind = lines[(statement.end_lineno or statement.lineno) - 1].partition("  # ")[2]
        found[ast.unparse(statement.target)] = " ".join(above) or behind
    return found


def comment_on(of: type, field: str) -> str:
    """Return the comment on a field, the class's own or that of the class it comes from."""
    return next((said[field] for part in of.__mro__ if (said := _own(part)).get(field)), "")


def _own(part: type) -> dict[str, str]:
    return comments(part) if part.__module__.startswith("pa10cal") else {}
