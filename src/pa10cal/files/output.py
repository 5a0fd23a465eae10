"""Outputs appear whole or not at all: written beside their place, then renamed."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from pa10cal.errors import OutputError


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`; move it into place when the block succeeds.

    The temporary name keeps the ending, since writers choose a format by it.

    Raises:
        OutputError: when nothing can be written at this place.
    """
    with whole_files(path) as (beside,):
        yield beside


@contextmanager
def whole_files(*paths: Path) -> Iterator[tuple[Path, ...]]:
    """Yield temporary paths beside several outputs; move all into place, or none.

    Raises:
        OutputError: when one of them cannot be written at its place.
    """
    twice = [
        path for k, path in enumerate(paths) if path.resolve() in {p.resolve() for p in paths[:k]}
    ]
    if twice:
        raise OutputError(
            "two outputs have the same path",
            where=str(twice[0]),
            allowed="a different path for each output",
            remedy="give different paths",
        )
    besides = tuple(path.with_name(f".{os.getpid()}.partial.{path.name}") for path in paths)
    try:
        for path, beside in zip(paths, besides, strict=True):
            _claim(path, beside)
        yield besides
        for path, beside in zip(paths, besides, strict=True):
            _move(beside, path)
    finally:
        for beside in besides:
            _remove(beside)


def _claim(path: Path, beside: Path) -> None:
    """Make the folder and the temporary file, so that an unfit place is known before any work."""
    try:
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        path.parent.mkdir(parents=True, exist_ok=True)
        beside.touch()
    except OSError as error:
        raise _unwritable(path, error) from None


def _move(beside: Path, path: Path) -> None:
    try:
        os.replace(beside, path)  # noqa: PTH105 -- the atomic call, by its own name
    except OSError as error:
        raise _unwritable(path, error) from None


def _remove(beside: Path) -> None:
    with suppress(OSError):  # where nothing could be written there is nothing to remove
        beside.unlink()


@contextmanager
def writing_into(folder: Path, what: str, remedy: str) -> Iterator[None]:
    """Refuse a folder into which the block cannot write.

    Args:
        folder: the folder.
        what: what cannot be written then, such as `the results`.
        remedy: what to do about it.

    Raises:
        OutputError: naming the folder.
    """
    try:
        yield
    except OSError as error:
        raise OutputError(
            f"{what} cannot be written",
            where=str(folder),
            value=error.strerror,
            allowed="a folder that may be written to",
            remedy=remedy,
        ) from None


def _unwritable(path: Path, error: OSError) -> OutputError:
    return OutputError(
        "the output cannot be written",
        where=str(path),
        value=error.strerror,
        allowed="a file in a folder that may be written to",
        remedy="give another path, or remove what is in the way",
    )


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text whole or not at all."""
    with whole_file(path) as beside:
        beside.write_text(text, encoding="utf-8", newline="\n")
