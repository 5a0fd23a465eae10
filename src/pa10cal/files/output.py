"""Outputs appear whole or not at all: written beside their place, brought to the disk, renamed.

A file that is being written is locked by its process, so that what a killed one left can be told
from what another one writes now, on this machine or on another one.
"""

from __future__ import annotations

import errno
import fcntl
import os
import re
import shutil
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from itertools import chain
from pathlib import Path

from pa10cal.errors import OutputError, one_line

_PARTIAL = ".partial."
#: Ending of a folder that is being replaced.
FORMER = ".former"
#: What a full disk, or a limit on sizes, answers.
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
MAKE_ROOM = "make room on the disk"


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`; move it into place when the block succeeds.

    The temporary name keeps the ending, since writers choose a format by it; see `whole_files`.
    """
    with whole_files(path) as (beside,):
        yield beside


@contextmanager
def whole_files(*paths: Path) -> Iterator[tuple[Path, ...]]:
    """Yield temporary paths beside several outputs; move all into place, or none.

    An output that is such a path itself is written where it is: it stays the file that is locked.

    Raises:
        OutputError: when one of them cannot be written at its place, or there is no room for it.
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
    mine = f".{os.getpid()}{_PARTIAL}"
    besides = tuple(path.with_name(mine + path.name.removeprefix(mine)) for path in paths)
    with ExitStack() as stack:
        for beside in set(besides) - set(paths):
            stack.callback(_remove, beside)
        files = [
            stack.enter_context(_claimed(path, beside))
            for path, beside in zip(paths, besides, strict=True)
        ]
        try:
            yield besides
        except OSError as error:
            if error.errno not in _NO_ROOM:
                raise
            with _writing(paths[0]):
                raise
        # All are on the disk before the first has its name: no crash leaves a name of nothing.
        for path, file in zip(paths, files, strict=True):
            with _writing(path):
                os.fsync(file)
        for path, beside in zip(paths, besides, strict=True):
            with _writing(path):
                os.replace(beside, path)  # noqa: PTH105 -- the atomic call, by its own name


@contextmanager
def _claimed(path: Path, beside: Path) -> Iterator[int]:
    """Make the folder and the locked file, so that an unfit place is known before any work."""
    with _writing(path):
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        path.parent.mkdir(parents=True, exist_ok=True)
        for former in path.parent.iterdir():
            if former.name.endswith(_PARTIAL + path.name):
                _remove_of_dead(former)
        file = os.open(beside, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    try:
        with suppress(OSError):  # a file system without locks
            fcntl.flock(file, fcntl.LOCK_SH)
        yield file
    finally:
        os.close(file)


def _remove(beside: Path) -> None:
    with suppress(OSError):  # where nothing could be written there is nothing to remove
        beside.unlink()


@contextmanager
def folder_beside(place: Path) -> Iterator[Path]:
    """Yield an empty folder beside a place; gone when the block ends, if it was not moved there.

    It is locked while this process lives. What killed ones left beside the place is removed.
    """
    place.parent.mkdir(parents=True, exist_ok=True)
    for left in place.parent.iterdir():
        replaced = left.name.endswith(f"{_PARTIAL}{place.name}{FORMER}") and place.is_dir()
        if replaced or left.name.endswith(_PARTIAL + place.name):
            _remove_of_dead(left)
    beside = place.with_name(f".{os.getpid()}{_PARTIAL}{place.name}")
    beside.mkdir()
    lock = os.open(beside, os.O_RDONLY | os.O_CLOEXEC)
    try:
        with suppress(OSError):  # a file system without locks
            fcntl.flock(lock, fcntl.LOCK_SH)
        yield beside
    finally:
        os.close(lock)
        shutil.rmtree(beside, ignore_errors=True)


def remove_partials(folder: Path) -> None:
    """Remove what killed processes left of outputs below a folder, and nothing of living ones."""
    for place, _, names in os.walk(folder):
        for name in names:
            if name.startswith(".") and _PARTIAL in name:
                _remove_of_dead(Path(place, name))


def _remove_of_dead(partial: Path) -> None:
    """Remove a file or folder beside its place unless the process that writes it lives."""
    with suppress(OSError):
        lock = os.open(partial, os.O_RDONLY if partial.is_dir() else os.O_RDWR)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)  # held by its writer
            shutil.rmtree(partial) if partial.is_dir() else partial.unlink()
        finally:
            os.close(lock)


@contextmanager
def writing_into(
    folder: Path,
    what: str,
    remedy: str,
    allowed: str = "a folder that may be written to, with room in it",
) -> Iterator[None]:
    """Refuse a folder into which the block cannot write `what`, with a remedy (OutputError)."""
    try:
        yield
    except OSError as error:
        raise OutputError(
            f"{what} cannot be written",
            where=str(folder),
            value=os.strerror(error.errno) if error.errno else str(error),
            allowed=allowed,
            remedy=MAKE_ROOM if error.errno in _NO_ROOM else remedy,
        ) from None


def no_room(error: Exception) -> bool:
    """Return whether an error, or the refusal that it was made, is that of a full disk."""
    if isinstance(error, OutputError):
        return error.remedy == MAKE_ROOM
    return isinstance(error, OSError) and error.errno in _NO_ROOM


def _writing(path: Path) -> AbstractContextManager[None]:
    """Refuse a file that the block cannot write."""
    place = path.with_name(path.name.rpartition(_PARTIAL)[2])
    remedy = "give another path, or remove what is in the way"
    allowed = "a file in a folder that may be written to, with room for it"
    return writing_into(place, "the output", remedy, allowed)


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text whole or not at all."""
    with whole_file(path) as beside:
        beside.write_text(text, encoding="utf-8", newline="\n")


# Text of a user's files as a cell of a table: shown as it is, run by nothing, one cell.
#
# A label may be anything. A spreadsheet takes a cell that begins with one of a few signs for a
# formula, also behind blanks and quotes, and where lists are separated by semicolons also one that
# follows a semicolon. A Markdown page takes some text for markup.

#: Numbers, and words of letters: nothing to do for most cells.
_PLAIN = re.compile(r"-?\d[\d.]*(?:e[-+]?\d+)?|[^\W\d_][\w .:/-]*")
_FORMULA = re.compile(
    r"[\s\x00-\x20\x7f\u200b\ufeff'\"]*([=+@\uff1d\uff0b\uff0d\uff20-].*)", re.DOTALL
)
_QUOTED = re.compile(r"[\",\r\n]")
_LISTS = re.compile(r"(;)")


def _runs(piece: str) -> bool:
    """Return whether a spreadsheet would run a text; numbers such as `-1.5` and `+1` are none."""
    found = _FORMULA.fullmatch(piece)
    if found is None:
        return False
    try:
        float(found[1])
    except ValueError:
        return True
    return False


def csv_cell(value: object) -> object:
    """Return a value of a CSV cell; before text that a spreadsheet would run is an apostrophe.

    Numbers, also those given as text (`-1.5`, `+1`), stay as they are. `from_csv_cell` undoes it.
    """
    if not isinstance(value, str) or _PLAIN.fullmatch(value):
        return value
    return "".join(f"'{piece}" if _runs(piece) else piece for piece in _LISTS.split(value))


def from_csv_cell(text: str) -> str:
    """Return the text of which `csv_cell` made a cell."""
    if "'" not in text:
        return text
    return "".join(
        piece[1:] if piece.startswith("'") and _runs(piece[1:]) else piece
        for piece in _LISTS.split(text)
    )


def csv_line(cells: Iterable[object]) -> str:
    """Return a row of a CSV file, with the end of its line; every value is one cell.

    What is not known, None or nan, is empty. The same bytes under every Python: a carriage return
    is quoted too.
    """
    texts = []
    for cell in cells:
        text = "" if cell is None or cell != cell else str(csv_cell(cell))
        if _QUOTED.search(text):
            text = '"' + text.replace('"', '""') + '"'
        texts.append(text)
    return ",".join(texts if texts != [""] else ['""']) + "\n"


def csv_text(header: Iterable[object], rows: Iterable[Iterable[object]]) -> str:
    """Return a CSV file: the one way in which tables go out."""
    return "".join(map(csv_line, chain([header], rows)))


#: What begins markup inside a line: escapes, code, formulas, emphasis but for `_` inside a word,
#: strikes, columns, tags, entities, links but not lists of numbers, addresses.
_MARKUP = re.compile(
    r"[\\`$*~|]|(?<![^\W_])_|_(?![^\W_])|<(?=[A-Za-z/!?])|&(?=#|\w+;)|\[(?!-?[\d., -]+\](?![(\[:]))"
    r"|:(?=//)|(?<=www)\.",
    re.IGNORECASE,
)


def markdown_cell(text: str) -> str:
    """Return text as the cell of a Markdown table: on one line, without columns or markup.

    Every sign of it is shown; what is not visible, such as a mark of direction, by its number.
    """
    return _MARKUP.sub(r"\\\g<0>", one_line(text.replace("\t", " ")))


def markdown_line(text: str) -> str:
    """Return text as a line of a Markdown page: as `markdown_cell`, and it begins no block."""
    shown = markdown_cell(text).strip()
    head = re.match(r"\d{1,9}(?=[.)](\s|$))|(?=[#>+=-]([\s#>+=-]|$))", shown)
    return shown if head is None else f"{head[0]}\\{shown[head.end() :]}"
