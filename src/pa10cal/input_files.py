"""The one gate of files that are read: regular files, and where they are named, inside a folder.

What a user names on the command line or in the settings may lie anywhere, and may be a link. What
a file names, or what stands in a folder that somebody sent, has to lie in that folder once all
links are followed. Neither may be a pipe, a device, a socket or a folder: such are not even opened,
for some wait for ever when they are, and some never end.
"""

from __future__ import annotations

import csv
import errno
import io
import os
import stat
from collections.abc import Iterator, Sequence
from pathlib import Path

from typing_extensions import Buffer, override

#: Kinds of what stands at a path, and what each is called.
_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISLNK, "a link that leads to itself"),
    (stat.S_ISFIFO, "a pipe; save what comes out of it as a file first"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)
#: Never wait for somebody who writes; never become what the terminal belongs to.
_READ = os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY
_PASS = getattr(os, "O_PATH", os.O_RDONLY) | os.O_DIRECTORY | os.O_CLOEXEC | os.O_NOFOLLOW


class UnfitFileError(OSError):
    """What stands at a path must not be read; `strerror` says why."""


def open_file(path: Path, *within: Path | None) -> io.BufferedReader:
    """Open a regular file to read its bytes.

    Args:
        path: the file.
        within: folders, in one of which it must lie once links are followed; it may lie anywhere
            where none is given, or None alone.

    Raises:
        UnfitFileError: when it is no regular file, leads out of the folders, or cannot be a name.
        OSError: when it is not there or cannot be opened.
    """
    try:
        folders = [folder for folder in within if folder is not None]
        file = _inside(path, folders) if folders else _anywhere(path)
    except ValueError:
        raise _unfit(path, "no file can have such a name") from None
    try:
        # Once more, of what was opened: another may have taken the place of what was looked at.
        _refuse_other_kinds(os.fstat(file), path)
        return os.fdopen(file, "rb")
    except OSError:
        os.close(file)
        raise


def read_file(path: Path, most_bytes: int, *within: Path | None) -> bytes:
    """Return the bytes of a regular file; see `open_file`.

    Raises:
        UnfitFileError: also when it is larger than `most_bytes`.
        OSError: when it is not there or cannot be read.
    """
    with open_file(path, *within) as file:
        _refuse_larger(os.fstat(file.fileno()).st_size, path, most_bytes)
        content = file.read(most_bytes + 1)
    _refuse_larger(len(content), path, most_bytes)  # it grows, or does not know its size
    return content


def read_csv(path: Path, most_bytes: int, *within: Path | None) -> Iterator[tuple[int, list[str]]]:
    """Yield the rows of a table of UTF-8 text with their first line; blank ones not.

    See `read_file`. As of any generator, errors are raised when rows are asked for.

    Raises:
        OSError, ValueError: saying why it cannot be read, without its content.
    """
    with open_file(path, *within) as content:
        _refuse_larger(os.fstat(content.fileno()).st_size, path, most_bytes)
        counted = io.BufferedReader(_Counted(content, path, most_bytes))
        rows = csv.reader(io.TextIOWrapper(counted, "utf-8-sig", newline=""), strict=True)
        line = 1
        try:
            for row in rows:
                if any(map(str.strip, row)):
                    yield line, row
                line = rows.line_num + 1
        except UnicodeDecodeError:
            raise ValueError("it is not UTF-8 text") from None
        except csv.Error as error:
            raise ValueError(f"line {rows.line_num}: {error}") from None


class _Counted(io.RawIOBase):
    """The bytes of a file, which is refused as soon as more are read than is allowed."""

    def __init__(self, file: io.BufferedReader, path: Path, most_bytes: int) -> None:
        self._file, self._path, self._most_bytes, self._read = file, path, most_bytes, 0

    @override
    def readable(self) -> bool:
        return True

    @override
    def readinto(self, buffer: Buffer, /) -> int:
        content = self._file.read1(memoryview(buffer).nbytes)
        self._read += len(content)
        _refuse_larger(self._read, self._path, self._most_bytes)
        memoryview(buffer)[: len(content)] = content
        return len(content)


#: Files beside a data set of lerobot that state the names of columns of arrays.
_STATES_NAMES = ("meta/info.json", "info.json")


def names_beside(path: Path) -> Path | None:
    """Return the file that may state the names of the columns of `path`; None for none.

    It lies in the folder of `path`.
    """
    stated = (path.parent / each for each in _STATES_NAMES)
    return next((each for each in stated if is_file(each, path.parent)), None)


def is_file(path: Path, *within: Path | None) -> bool:
    """Return whether `open_file` would take a path for a file; nothing is opened."""
    try:
        folders = [folder for folder in within if folder is not None]
        real = Path(_real(path, folders)[1]) if folders else path
        return stat.S_ISREG(real.stat().st_mode)
    except (OSError, ValueError):
        return False


def reason(error: OSError | ValueError) -> str:
    """Return in words why a file cannot be read, without its path.

    Errors of this module do not quote its content; others may.
    """
    if isinstance(error, FileNotFoundError):
        return "the file is not there"
    return (isinstance(error, OSError) and error.strerror) or str(error) or "it is refused"


def _unfit(path: Path, why: str) -> UnfitFileError:
    return UnfitFileError(errno.EINVAL, why, str(path))


def _refuse_larger(size: int, path: Path, most_bytes: int) -> None:
    if size > most_bytes:
        exact = size < 1e5 or size < 1.01 * most_bytes
        sizes = (f"{n} bytes" if exact else f"{n / 1e6:.3g} MB" for n in (size, most_bytes))
        raise _unfit(path, "{}, at most {} are read".format(*sizes))


def _refuse_other_kinds(of: os.stat_result, path: Path) -> None:
    """Refuse what is no regular file."""
    if not stat.S_ISREG(of.st_mode):
        what = next((words for is_one, words in _KINDS if is_one(of.st_mode)), "no file")
        raise _unfit(path, f"it is {what}")


def _anywhere(path: Path) -> int:
    try:
        _refuse_other_kinds(path.stat(), path)
    except OSError as error:
        if error.errno == errno.ELOOP:
            _refuse_other_kinds(path.lstat(), path)
        raise
    return os.open(path, _READ)


def _real(path: Path, within: Sequence[Path]) -> tuple[str, str]:
    """Return the folder that a path lies in, and the path, both without links."""
    real = os.path.realpath(path)
    for folder in within:
        root = os.path.realpath(folder)
        if Path(real).is_relative_to(root):
            return root, real
    places = " or ".join(map(str, dict.fromkeys(within)))
    raise _unfit(path, f"it leads out of the folder {places}; copy the file there")


def _inside(path: Path, within: Sequence[Path]) -> int:
    """Open a path by way of the folders on it, none of which may have become a link meanwhile."""
    root, real = _real(path, within)
    *folders, name = Path(real).relative_to(root).parts or (".",)
    at = os.open(root, _PASS)
    try:
        for folder in folders:
            below = os.open(folder, _PASS, dir_fd=at)
            os.close(at)
            at = below
        _refuse_other_kinds(os.stat(name, dir_fd=at, follow_symlinks=False), path)
        return os.open(name, _READ | os.O_NOFOLLOW, dir_fd=at)
    finally:
        os.close(at)
