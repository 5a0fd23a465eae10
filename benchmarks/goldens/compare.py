"""Compare digests of a run with the frozen ones, under the list of intended differences."""

from __future__ import annotations

import re
from collections.abc import Container
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.goldens.digest import FileDigest, Group, StudyDigest
from pa10cal.errors import RecordError

#: Numbers are equal within this part of their group's size.
RELATIVE = 1e-9
#: Differences below this are zero, whatever the unit: covariances [m²] of micrometres are 1e-12.
ABSOLUTE = 1e-18

WHATS = ("rename file", "rename key", "rename value", "ignore", "gone", "within")
COLUMNS = ("what", "files", "old", "new", "reason")


@dataclass
class Intended:
    """One row of `differences.md`.

    Attributes:
        what: one of `WHATS`.
        files: regular expression a path must contain, of the run's names.
        old: regular expression of a path or key, or the text of a value.
        new: what stands there now; for `within` the relative tolerance; else empty.
        reason: why the difference is intended.
        used: how often it was needed.
    """

    what: str
    files: re.Pattern[str]
    old: re.Pattern[str]
    new: str
    reason: str
    used: int = 0


@dataclass
class Comparison:
    """What differs in one study, each a line of text.

    Attributes:
        files: number of files compared.
        keys: number of keys compared.
        differences: by path, what is neither equal nor intended.
        added_files: paths that the frozen record has not.
        added_keys: by path, keys that the frozen record has not.
    """

    files: int = 0
    keys: int = 0
    differences: dict[str, list[str]] = field(default_factory=dict)
    added_files: list[str] = field(default_factory=list)
    added_keys: dict[str, list[str]] = field(default_factory=dict)


def read_intended(path: Path) -> list[Intended]:
    """Read the tables of intended differences from a Markdown file; other lines of it are prose.

    Raises:
        RecordError: a row has not the five columns, or one of them is not allowed.
    """
    rows: list[Intended] = []
    inside = False
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        cells = [c.strip() for c in re.split(r"(?<!\\)\|", line.strip())[1:-1]]
        cells = [_plain(cell.replace("\\|", "|")) for cell in cells]
        if not cells or not any(c.strip("-: ") for c in cells):
            inside = inside and bool(cells)
        elif tuple(cells) == COLUMNS:
            inside = True
        elif inside:
            rows.append(_intended(cells, f"{path.name}, line {number}"))
    return rows


def _plain(cell: str) -> str:
    """Return a cell without the marks of code around it."""
    inner = cell.strip("`")
    return inner if "`" not in inner and cell == f"`{inner}`" else cell.replace("``", "")


def _intended(cells: list[str], where: str) -> Intended:
    remedy = "mend the row, see the explanation above the tables"

    def refuse(wrong: str, allowed: str, value: object = None) -> RecordError:
        return RecordError(wrong, where=where, value=value, allowed=allowed, remedy=remedy)

    if len(cells) != len(COLUMNS):
        raise refuse("wrong number of columns", ", ".join(COLUMNS), len(cells))
    what, files, old, new, reason = cells
    if what not in WHATS:
        raise refuse("unknown kind of difference", ", ".join(WHATS), what)
    if not reason:
        raise refuse("no reason is given", "one sentence why the difference is intended")
    try:
        if what == "within":
            float(new)
        old = re.escape(old) if what == "rename value" else old
        return Intended(what, re.compile(files), re.compile(old), new, reason)
    except (ValueError, re.error) as error:
        raise refuse(str(error), "a regular expression; for `within` a number") from error


def compare(
    frozen: StudyDigest, run: StudyDigest, intended: list[Intended], *, partial: bool = False
) -> Comparison:
    """Compare a study's digest with its frozen one.

    Args:
        frozen: as it was.
        run: as it is.
        intended: differences with a reason; their `used` is counted up.
        partial: files missing in the run are no difference.
    """
    result = Comparison()
    renamed = {_renamed(path, run, "rename file", intended): file for path, file in frozen.items()}
    result.added_files = sorted(set(run) - set(renamed))
    for path, old in sorted(renamed.items()):
        rows = [row for row in intended if row.files.search(path)]
        if path not in run:
            if not partial and not _intended_as("gone", rows, "file"):
                result.differences[path] = ["file is missing"]
            continue
        result.files += 1
        lines, added = _compare_file(old, run[path], rows)
        result.keys += len(old)
        if lines:
            result.differences[path] = lines
        if added:
            result.added_keys[path] = added
    return result


def _renamed(name: str, run: Container[str], what: str, rows: list[Intended]) -> str:
    """Return the run's name of a path or key; what still has its old name keeps it."""
    if name in run:
        return name
    new = name
    for row in rows:
        if row.what == what:
            new, times = row.old.subn(row.new, new)
            row.used += times
    return new


def _intended_as(what: str, rows: list[Intended], key: str) -> bool:
    for row in rows:
        if row.what == what and row.old.search(key):
            row.used += 1
            return True
    return False


def _compare_file(
    old: FileDigest, new: FileDigest, rows: list[Intended]
) -> tuple[list[str], list[str]]:
    lines = []
    old = {_renamed(key, new, "rename key", rows): group for key, group in old.items()}
    for key, group in old.items():
        difference = _missing(key, new) if key not in new else _compare_group(group, new[key], ())
        if difference is None:
            continue
        if _intended_as("ignore" if _is_there(key, new) else "gone", rows, key):
            continue
        withins = [row for row in rows if row.what == "within" and row.old.search(key)]
        values = [row for row in rows if row.what == "rename value"]
        if key in new and (withins or values):
            difference = _compare_group(group, new[key], (*withins, *values))
        if difference is not None:
            lines.append(f"{key or 'value'}: {difference}")
    return lines, [key for key in new if key not in old]


def _is_there(key: str, new: FileDigest) -> bool:
    """Return whether the key is there, or is in a list or mapping that is empty on either side."""
    parts = re.split(r"(?=\.|\[\])", key)
    around = {"".join(parts[:count]) for count in range(1, len(parts) + 1)}
    return bool(around & set(new)) or any(
        other.startswith((f"{key}.", f"{key}[]")) for other in new
    )


def _missing(key: str, new: FileDigest) -> str:
    """A list or mapping that was empty and is filled now, or the other way round, is said so."""
    deeper = [other for other in new if other.startswith((f"{key}.", f"{key}[]"))]
    return f"was one value, is {deeper[0]}" if deeper else "key is missing"


def _compare_group(old: Group, new: Group, rows: tuple[Intended, ...]) -> str | None:
    """Return in words what differs, or None."""
    relative = max((float(row.new) for row in rows if row.what == "within"), default=RELATIVE)
    if old["n"] != new["n"]:
        return f"{new['n']} values, were {old['n']}"
    found = _compare_texts(old, new, [row for row in rows if row.what == "rename value"])
    found = found or _compare_numbers(old, new, relative)
    if found is None:
        for row in rows:
            row.used += row.what == "within"
    return found


def _compare_texts(old: Group, new: Group, rows: list[Intended]) -> str | None:
    if old.get("p") != new.get("p"):
        return "values are missing at other positions"
    before, after = old.get("t", []), new.get("t", [])
    for row in rows:
        if after != before:
            replaced = [row.new if row.old.fullmatch(text) else text for text in before]
            row.used += replaced != before
            before = replaced
    if len(before) != len(after):
        return f"texts {_some(after, new)}, were {_some(before, old)}"
    for place, (a, b) in enumerate(zip(before, after, strict=True)):
        if a != b:
            return f"{b!r}, was {a!r}" + (f" (text {place + 1} of {len(after)})" if place else "")
    return "texts differ" if old.get("h") != new.get("h") else None


def _some(texts: list[str], group: Group) -> str:
    shown = ", ".join(repr(text) for text in texts[:3]) + (" ..." if len(texts) > 3 else "")
    return shown or ("long" if "h" in group else "none")


def _compare_numbers(old: Group, new: Group, relative: float) -> str | None:
    key = "s" if "s" in old else "x"
    before, after = old.get(key, []), new.get(key, [])
    if len(before) != len(after):
        return "texts among the numbers are more or fewer"
    if not before:
        return None
    size = before[1] if key == "s" else max(map(abs, before))
    worst = max(abs(b - a) for a, b in zip(before, after, strict=True))
    if worst > relative * size + ABSOLUTE:
        part = worst / size if size else float("inf")
        if key == "x":
            return f"{_list(after)}, was {_list(before)} ({part:.1e} of its size)"
        return f"{old['n']} values differ by {part:.1e} of their size"
    if "i" in old and "i" in new and old["i"] != new["i"]:
        return "integers differ"
    return None


def _list(values: list[float]) -> str:
    return ", ".join(f"{value:.12g}" for value in values)
