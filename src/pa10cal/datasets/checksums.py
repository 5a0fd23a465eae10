"""Files of a data set against the checksums of their published version."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from pa10cal.errors import RawDataError


@dataclass(frozen=True)
class Differing:
    """A file that is not the published one."""

    place: str  # the file, or its address
    found: str  # its SHA-256
    published: str  # that of the published file


def sha256(content: bytes) -> str:
    """Return the checksum as text."""
    return hashlib.sha256(content).hexdigest()


def refuse_missing(folder: Path, files: Iterable[str]) -> None:
    """Stop when files are not in the folder.

    Raises:
        RawDataError: naming all that are missing.
    """
    files = tuple(files)
    if not folder.is_dir():
        raise RawDataError(
            "there is no such folder",
            where="folder of the data set",
            value=str(folder),
            allowed=f"a folder with {', '.join(files)}",
            remedy="correct the path, or fetch the data set",
        )
    missing = [name for name in files if not (folder / name).is_file()]
    if missing:
        raise RawDataError(
            "files of the data set are missing in the folder",
            where=str(folder),
            value=", ".join(missing),
            allowed=f"a folder with {', '.join(files)}",
            remedy="copy the missing files there, or fetch the data set again",
        )


def differing_files(folder: Path, published: Mapping[str, str]) -> tuple[Differing, ...]:
    """Return the files whose SHA-256 is not the published one.

    Args:
        folder: the data set's folder.
        published: checksum by path; all these files are there.
    """
    found = {name: sha256((folder / name).read_bytes()) for name in published}
    return tuple(
        Differing(str(folder / name), found[name], expected)
        for name, expected in published.items()
        if found[name] != expected
    )


def refusal_of(differing: tuple[Differing, ...], version: str, remedy: str) -> RawDataError:
    """Return the refusal of files that are not those of a version, with both checksums of each."""
    first, others = differing[0], differing[1:]
    also = "".join(f"; so does {each.place} (SHA-256 {each.found})" for each in others)
    return RawDataError(
        "the checksum differs from that of the published file",
        where=first.place,
        value=f"SHA-256 {first.found}{also}",
        allowed=f"SHA-256 {', '.join(each.published for each in differing)} (version {version})",
        remedy=remedy,
    )
