"""The files of a data set: their checksums, and fetching them from where they are published."""

from __future__ import annotations

import hashlib
import urllib.request
from collections.abc import Mapping
from dataclasses import dataclass
from http.client import HTTPException
from pathlib import Path
from urllib.parse import quote

from pa10cal.datasets.data_set import DataSet, Published
from pa10cal.errors import RawDataError
from pa10cal.files.output import whole_files
from pa10cal.input_files import is_file, open_file, reason

#: Longest wait for an answer [s].
TIMEOUT_S = 60.0


@dataclass(frozen=True)
class Differing:
    """A file that is not the published one."""

    place: str  # the file, or its address
    found: str  # its SHA-256
    published: str  # that of the published file


def sha256(content: bytes) -> str:
    """Return the checksum as text."""
    return hashlib.sha256(content).hexdigest()


def _sha256_of(folder: Path, name: str) -> str:
    try:
        with open_file(folder / name, folder) as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise unreadable(folder / name, error) from None


def unreadable(path: Path, error: OSError) -> RawDataError:
    """Return the refusal of a file of a data set that cannot be read."""
    return RawDataError(
        f"a file of the data set cannot be read: {reason(error)}",
        where=str(path),
        allowed="the file as it was published",
        remedy="copy it there, or fetch the data set again",
    )


def differing_files(folder: Path, published: Mapping[str, str]) -> tuple[Differing, ...]:
    """Return the files whose SHA-256 is not the published one.

    Args:
        folder: holds all of them.
        published: their published checksums by name.

    Raises:
        RawDataError: when one cannot be read.
    """
    found = {name: _sha256_of(folder, name) for name in published}
    return tuple(
        Differing(str(folder / name), found[name], expected)
        for name, expected in published.items()
        if found[name] != expected
    )


def refusal_of(differing: tuple[Differing, ...], published: Published, remedy: str) -> RawDataError:
    """Return the refusal of files that differ from the published version, with both checksums."""
    first, *others = differing
    also = "".join(f"; so does {file.place} (SHA-256 {file.found})" for file in others)
    sums = ", ".join(file.published for file in differing)
    return RawDataError(
        "the checksum differs from that of the published file",
        where=first.place,
        value=f"SHA-256 {first.found}{also}",
        allowed=f"SHA-256 {sums} (version {published.version})",
        remedy=remedy,
    )


def fetch(dataset: DataSet, folder: Path, source: str | None = None) -> tuple[str, ...]:
    """Fetch all files of a data set into a folder: the pinned version, or nothing.

    Published files that are there already are not fetched again.

    Args:
        dataset: to fetch.
        folder: to write to.
        source: folder or address to take the files from; None for where they are published.

    Returns:
        The paths that were fetched.

    Raises:
        RawDataError: when a file cannot be fetched, or is not the published one.
        OutputError: when the folder cannot be written to.
    """
    published = dataset.published
    missing = {
        name: checksum
        for name, checksum in published.sha256.items()
        if not is_file(folder / name, folder) or _sha256_of(folder, name) != checksum
    }
    base = published.address
    if source is not None:
        base = source if "://" in source else Path(source).expanduser().resolve().as_uri()
        base = base if base.endswith("/") else f"{base}/"
    contents = {name: _content(base + quote(name)) for name in missing}
    differing = tuple(
        Differing(base + name, sha256(content), missing[name])
        for name, content in contents.items()
        if sha256(content) != missing[name]
    )
    if differing:
        raise refusal_of(differing, published, "fetch it again, or from another source")
    with whole_files(*(folder / name for name in missing)) as besides:
        for beside, content in zip(besides, contents.values(), strict=True):
            beside.write_bytes(content)
    return tuple(missing)


def _content(address: str) -> bytes:
    try:
        with urllib.request.urlopen(address, timeout=TIMEOUT_S) as answer:
            content: bytes = answer.read()
    except (OSError, HTTPException, ValueError) as error:
        cause = getattr(error, "reason", error)  # without the name of the function that failed
        raise RawDataError(
            "the file cannot be fetched",
            where=address.removeprefix("file://"),
            value=str(getattr(cause, "strerror", None) or cause),
            allowed="an address that can be reached, or a folder with the file",
            remedy="check the connection, or name a copy of the data set as the source",
        ) from None
    return content
