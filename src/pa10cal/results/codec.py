"""Records from and to JSON files."""

from __future__ import annotations

import reprlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from pydantic import ValidationError
from pydantic_core import from_json

from pa10cal.errors import RecordError
from pa10cal.files.output import whole_file
from pa10cal.input_files import read_file, reason
from pa10cal.results.record import Record

_R = TypeVar("_R", bound=Record)

#: A record of a hundred thousand poses has half of it; values are counted by what divides them.
_MOST_BYTES, _MOST_VALUES = 128_000_000, 5_000_000
#: Letters of an offending value that are shown.
_MOST_LETTERS = 80


def read(kind: type[_R], path: Path, campaign: str | None = None, within: Path | None = None) -> _R:
    """Read a record; keys that its type does not know are passed over.

    Args:
        kind: its type.
        path: the file.
        campaign: whose it must be; None for any.
        within: folder that it must lie in; None for anywhere.

    Raises:
        RecordError: when the file is missing or cannot be read, is another kind of file or of
            another campaign, lacks a key, or holds what the key does not allow.
    """
    with _refused(kind, path, "the record is", f"a JSON file with schema {kind.SCHEMA}"):
        content = from_json(_read(path, within), allow_inf_nan=False)
    return _checked(kind, content, str(path), campaign)


def read_lines(kind: type[_R], path: Path) -> list[_R]:
    """Read a file of records, one a line.

    Raises:
        RecordError: as `read` does, naming the line.
    """
    with _refused(kind, path, "the records are", f"one line of schema {kind.SCHEMA} each"):
        text = _read(path)
        if text.count(b"\n") + text.count(b"\r") > _MOST_VALUES:
            raise ValueError(f"more than {_MOST_VALUES} lines")
        contents = [from_json(line, allow_inf_nan=False) for line in text.splitlines()]
    return [_checked(kind, each, f"{path}:{k}", None) for k, each in enumerate(contents, start=1)]


@contextmanager
def _refused(kind: type[Record], path: Path, subject: str, allowed: str) -> Iterator[None]:
    """Raise a RecordError that begins with `subject`, as `the record is`, if the block fails."""
    try:
        yield
    except FileNotFoundError:
        raise RecordError(
            f"{subject} missing",
            where=str(path),
            allowed=f"a file that pa10cal {kind.COMMAND} wrote",
            remedy=f"run pa10cal {kind.COMMAND} first",
        ) from None
    except (OSError, ValueError) as error:
        raise RecordError(
            f"{subject.rpartition(' ')[0]} cannot be read",
            where=str(path),
            value=reason(error),
            allowed=allowed,
            remedy=f"run pa10cal {kind.COMMAND} again",
        ) from None


def _read(path: Path, within: Path | None = None) -> bytes:
    text = read_file(path, _MOST_BYTES, within)
    if sum(map(text.count, (b",", b"[", b"{"))) > _MOST_VALUES:
        raise ValueError(f"more than {_MOST_VALUES} values")
    return text


def schema_of(path: Path) -> str | None:
    """Return the schema that a JSON file states; None where it cannot be read or states none."""
    try:
        content = from_json(_read(path), allow_inf_nan=False)
    except (OSError, ValueError):
        return None
    found = content.get("schema") if isinstance(content, dict) else None
    return found if isinstance(found, str) else None


def write(record: Record, path: Path) -> None:
    """Write a record, whole or not at all.

    Raises:
        OutputError: when the file cannot be written.
    """
    text = record.model_dump_json(indent=1)
    with whole_file(path) as beside:
        beside.write_text(text + "\n", encoding="utf-8", newline="\n")


def lines(records: Iterable[Record]) -> str:
    """Return records as text, one a line."""
    return "".join(record.model_dump_json() + "\n" for record in records)


def _checked(kind: type[_R], content: Any, where: str, campaign: str | None) -> _R:
    """Return the record of what a file, or a line of it, holds."""
    found = content.get("schema") if isinstance(content, dict) else None
    if found != kind.SCHEMA:
        raise RecordError(
            "not a record of this kind",
            where=where,
            value=found,
            allowed=f"schema {kind.SCHEMA}",
            remedy=f"give a file that pa10cal {kind.COMMAND} wrote",
        )
    if campaign is not None and content.get("campaign") != campaign:
        raise RecordError(
            "the record is of another campaign",
            where=where,
            value=content.get("campaign"),
            allowed=campaign,
            remedy="give the results of this campaign, or run its commands again",
        )
    try:
        record = kind.kind_of(content).model_validate(content, extra="ignore")
    except ValidationError as error:
        raise _unfit(kind, error, where) from None
    assert isinstance(record, kind)
    return record


def _unfit(kind: type[Record], error: ValidationError, where: str) -> RecordError:
    """Describe what is wrong with the first key that is."""
    first, *others = error.errors(include_url=False)
    key = ".".join(str(part) for part in first["loc"])
    more = f", and {len(others)} more" if others else ""
    if first["type"] == "missing":
        return RecordError(
            f"the record lacks {key}{more}",
            where=where,
            allowed=f"every key of schema {kind.SCHEMA}",
            remedy=f"run pa10cal {kind.COMMAND} again",
        )
    what = key or "the record"
    return RecordError(
        f"{what} is not as it should be{more}",
        where=where,
        value=_Shortened(first["input"]),
        allowed=first["msg"].removeprefix("Input should be ").removeprefix("Value error, "),
        remedy=f"run pa10cal {kind.COMMAND} again",
    )


class _Shortened(NamedTuple):
    """A value of any size, shown in brief."""

    value: object

    def __repr__(self) -> str:
        text = reprlib.repr(self.value)
        return text if len(text) <= _MOST_LETTERS else f"{text[: _MOST_LETTERS - 4]} ..."
