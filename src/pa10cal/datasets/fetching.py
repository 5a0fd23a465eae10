"""The files of a public data set, fetched from where they are published, or from a copy."""

from __future__ import annotations

import urllib.request
from http.client import HTTPException
from pathlib import Path
from urllib.parse import quote

from pa10cal.datasets.checksums import Differing, refusal_of, sha256
from pa10cal.datasets.dataset import DataSet
from pa10cal.errors import RawDataError
from pa10cal.files.output import whole_files

#: Longest wait for an answer [s].
TIMEOUT_S = 60.0


def fetch(dataset: DataSet, folder: Path, source: str | None = None) -> tuple[str, ...]:
    """Bring all files of a published data set into a folder: the pinned version, or nothing.

    Files that are there already and are the published ones are not fetched again.

    Args:
        dataset: which.
        folder: where to.
        source: folder or address to take them from; None for where they are published.

    Returns:
        Paths of the files fetched, inside the folder.

    Raises:
        RawDataError: when the data set has no one place, a file cannot be had, or one is not the
            published one.
        OutputError: when the folder cannot be written to.
    """
    published = dataset.published
    if published is None:
        raise RawDataError(
            "this data set is a layout without an address to fetch it from",
            where="data set",
            value=dataset.name,
            allowed="a data set that is published at an address",
            remedy="import a folder of your own",
        )
    expected = {
        name: checksum
        for name, checksum in published.sha256.items()
        if not (folder / name).is_file() or sha256((folder / name).read_bytes()) != checksum
    }
    base = published.address if source is None else _address(source)
    contents = {name: _content(base + quote(name)) for name in expected}
    differing = tuple(
        Differing(base + name, sha256(content), expected[name])
        for name, content in contents.items()
        if sha256(content) != expected[name]
    )
    if differing:
        raise refusal_of(differing, published.version, "fetch it again, or from another source")
    with whole_files(*(folder / name for name in expected)) as besides:
        for beside, content in zip(besides, contents.values(), strict=True):
            beside.write_bytes(content)
    return tuple(expected)


def _address(source: str) -> str:
    """Return what stands in front of a file's path."""
    address = source if "://" in source else Path(source).resolve().as_uri()
    return address if address.endswith("/") else f"{address}/"


def _content(address: str) -> bytes:
    try:
        with urllib.request.urlopen(address, timeout=TIMEOUT_S) as answer:
            content: bytes = answer.read()
    except (OSError, HTTPException, ValueError) as error:
        raise RawDataError(
            "the file cannot be fetched",
            where=address.removeprefix("file://"),
            value=_cause(error),
            allowed="an address that can be reached, or a folder with the file",
            remedy="check the connection, or name a copy of the data set as the source",
        ) from None
    return content


def _cause(error: Exception) -> str:
    """Return the reason, without the name of the function that failed."""
    cause = getattr(error, "reason", error)
    return str(getattr(cause, "strerror", None) or cause)
