"""Writes outputs whole or not at all.

An output is written beside its place, brought to the disk and renamed. The process that writes it
locks it meanwhile: a file that a killed process left differs so from one that is being written, on
this machine or on another one.
"""

from __future__ import annotations

import errno
import fcntl
import os
import re
import shutil
import stat
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from pathlib import Path

from pa10cal.errors import OutputError

#: Name of a file or folder that is being written, by the number of the process that writes it.
_PARTIAL_NAME = re.compile(r"\.\d+\.partial\.(.+)", re.DOTALL)
#: Ending of the name of a folder that is being replaced.
FORMER = ".former"
#: Errors of a full disk, or of a limit on sizes, and the remedy.
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
MAKE_ROOM = "make room on the disk"


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`; move it into place when the block succeeds.

    The temporary name keeps the ending, by which writers choose a format; see `whole_files`.
    """
    with whole_files(path) as (beside,):
        yield beside


@contextmanager
def whole_files(*paths: Path) -> Iterator[tuple[Path, ...]]:
    """Yield temporary paths beside several outputs; move all into place, or none.

    An output whose path is such a temporary one already is written to it: it stays locked. An
    output that replaces a file has its permissions, and one at a link is written to what is linked.

    Raises:
        OutputError: when one of them cannot be written at its place, or there is no room for it.
    """
    paths = tuple(map(_place_of, paths))
    resolved: set[Path] = set()
    for path in paths:
        if path.resolve() in resolved:
            raise OutputError(
                "two outputs have the same path",
                where=str(path),
                allowed="a different path for each output",
                remedy="give different paths",
            )
        resolved.add(path.resolve())
    own = _partial_name("")
    besides = tuple(
        path if path.name.startswith(own) else path.with_name(_partial_name(path.name))
        for path in paths
    )
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
        # All are on the disk before the first is renamed: no crash leaves a name without content.
        for path, file in zip(paths, files, strict=True):
            with _writing(path):
                os.fsync(file)
                with suppress(OSError):  # none is there, or the file system has no permissions
                    os.fchmod(file, stat.S_IMODE(path.stat().st_mode))
        for path, beside in zip(paths, besides, strict=True):
            with _writing(path):
                os.replace(beside, path)  # noqa: PTH105 -- the atomic call, by its own name


def _partial_name(name: str) -> str:
    """Return the name under which this process writes an output of that name."""
    return f".{os.getpid()}.partial.{name}"


def is_partial(path: Path) -> bool:
    """Return whether a path is that of an output that some process writes, or left half-written."""
    return _PARTIAL_NAME.fullmatch(path.name) is not None


def _is_partial_of(name: str, output: str) -> bool:
    """Return whether a name is one under which some process writes an output of that name."""
    partial = _PARTIAL_NAME.fullmatch(name)
    return partial is not None and partial[1] == output


def _place_of(path: Path) -> Path:
    """Return where an output goes, which at a link is what is linked.

    Raises:
        OutputError: when a folder, device or pipe is there, which no file can replace.
    """
    with _writing(path):
        place = path.resolve() if path.is_symlink() else path
        if place.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        if place.exists() and not place.is_file():
            raise OSError("a device or pipe is there")
    return place


@contextmanager
def _claimed(path: Path, beside: Path) -> Iterator[int]:
    """Make the folder and the locked file, so that an unfit place is refused before any work."""
    with _writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        for former in path.parent.iterdir():
            if _is_partial_of(former.name, path.name):
                _remove_of_dead(former)
        # A file system without locks may keep what a killed process of the same number wrote.
        begun_anew = 0 if beside == path else os.O_TRUNC
        file = os.open(beside, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | begun_anew, 0o666)
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
    """Yield an empty folder beside a place; it is removed when the block ends, unless it was moved.

    It is locked by this process. Folders that killed processes left beside the place are removed.
    """
    place.parent.mkdir(parents=True, exist_ok=True)
    for folder in place.parent.iterdir():
        replaced = _is_partial_of(folder.name, place.name + FORMER) and place.is_dir()
        if replaced or _is_partial_of(folder.name, place.name):
            _remove_of_dead(folder)
    beside = place.with_name(_partial_name(place.name))
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
    """Remove the partial outputs of killed processes below a folder, not those of living ones."""
    for place, _, names in os.walk(folder):
        for name in names:
            if is_partial(Path(name)):
                _remove_of_dead(Path(place, name))


def _remove_of_dead(partial: Path) -> None:
    """Remove a partial file or folder unless the process that writes it lives."""
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
    """Raise an OutputError with a remedy if the block cannot write `what` into a folder."""
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


def remove_results(results: Path, *names: str) -> None:
    """Remove the files and folders of these names that are in a folder of results.

    Raises:
        OutputError: when they cannot be removed.
    """
    with writing_into(results, "the results", "give another folder, or let it be written to"):
        for name in names:
            path = results / name
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink(missing_ok=True)


def no_room(error: Exception) -> bool:
    """Return whether an error, or the refusal made of it, is that of a full disk."""
    if isinstance(error, OutputError):
        return error.remedy == MAKE_ROOM
    return isinstance(error, OSError) and error.errno in _NO_ROOM


def _writing(path: Path) -> AbstractContextManager[None]:
    """Raise an OutputError if the block cannot write a file, named by its final place."""
    partial = _PARTIAL_NAME.fullmatch(path.name)
    place = path if partial is None else path.with_name(partial[1])
    remedy = "give another path, or remove what is in the way"
    allowed = "a file in a folder that may be written to, with room for it"
    return writing_into(place, "the output", remedy, allowed)


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text whole or not at all."""
    with whole_file(path) as beside:
        beside.write_text(text, encoding="utf-8", newline="\n")
