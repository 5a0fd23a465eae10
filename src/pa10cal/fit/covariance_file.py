"""The covariance of a fitted model, in a file beside its own; one that is none is refused."""

from __future__ import annotations

import math
import os
import struct
import zlib
from io import BytesIO
from pathlib import Path
from tokenize import TokenError
from typing import BinaryIO
from zipfile import BadZipFile, ZipFile, ZipInfo

import numpy as np

from pa10cal.arm.chain import BASE
from pa10cal.arrays import Array
from pa10cal.errors import ModelError, refusals_beside
from pa10cal.fit.fitted import Fitted
from pa10cal.input_files import UnfitFileError, open_file, reason

#: No covariance has more than this: that of eight thousand parameters. Maps of twelve joints, with
#: the finest waves that were ever found, have half of them.
MOST_BYTES = 512_000_000
#: What reads the header of an array, by the version of its format.
_HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}
_UNIX = 3  # in the headers of a zip file
#: Of a correlation matrix: how unlike its transpose, and how far below zero the eigenvalues of one
#: may lie that was solved with directions that the poses hardly identify.
_SYMMETRIC_WITHIN, _EIGENVALUES_ABOVE = 1e-3, -1e-3
#: What numpy and zipfile raise of files that are none: a header is a Python expression.
_UNREADABLE = (
    *(OSError, EOFError, ValueError, KeyError, IndexError, TypeError, RuntimeError),
    *(SyntaxError, TokenError, BadZipFile, struct.error, zlib.error),
)
_refusal = refusals_beside(__file__, ModelError)


def covariance_path(path: Path) -> Path:
    """Return the path of the covariance of the model in a file."""
    return path.with_name(f"{path.stem}.covariance.npz")


def write_covariance(model: Fitted, path: Path) -> None:
    """Write the covariance of a model's parameters, with their names (.npz).

    Equal numbers are equal bytes: `np.savez` has headers that depend on the release of Python, and
    compression on that of zlib.
    """
    names = [*(parameter.name for parameter in model.model.parameters), *BASE]
    covariance = np.zeros((0, 0)) if model.covariance is None else model.covariance
    with ZipFile(path, "w") as file:
        for name, array in (("names", np.array(names)), ("covariance", covariance)):
            member = ZipInfo(f"{name}.npy")
            member.create_system, member.external_attr = _UNIX, 0o644 << 16
            content = BytesIO()
            np.lib.format.write_array(content, array, version=(1, 0), allow_pickle=False)
            file.writestr(member, content.getvalue())


def covariance_beside(path: Path) -> Array | None:
    """Return the covariance in the file beside a model's own; None where there is none.

    Raises:
        ModelError: when there is one that cannot be read.
    """
    beside = covariance_path(path)
    try:
        # A link to a model has its covariance beside it, or where the model itself lies.
        with open_file(beside, path.parent, path.resolve().parent) as file:
            covariance = _read(file)
    except FileNotFoundError:
        return None
    except UnfitFileError as error:
        raise _refusal("unfit covariance", beside, None, reason(error)) from None
    except _UNREADABLE:
        raise _refusal("no covariance", beside) from None
    return covariance if len(covariance) else None


def _read(file: BinaryIO) -> Array:
    """Return the covariance in a file; nothing is allocated that the file does not hold.

    Raises:
        ValueError, KeyError, BadZipFile: when there is none.
    """
    size = os.fstat(file.fileno()).st_size
    if size > MOST_BYTES:
        raise ValueError("it is too large")
    with ZipFile(file) as archive:
        of = archive.getinfo("covariance.npy")
        if of.file_size > MOST_BYTES:
            raise ValueError("it is too large, unpacked")
        content = BytesIO(archive.read(of))
    version = np.lib.format.read_magic(content)
    if version not in _HEADERS:
        raise ValueError("another version")
    shape, _, dtype = _HEADERS[version](content)
    if dtype.hasobject or math.prod(shape) * dtype.itemsize > of.file_size:
        raise ValueError("it promises more than it holds")
    content.seek(0)
    return np.asarray(np.lib.format.read_array(content, allow_pickle=False))


def checked_covariance(covariance: Array, size: int, where: str) -> Array:
    """Return a covariance that random numbers can have; see `FittedModel.covariance`.

    Args:
        size: of the parameters and the base.
        where: file of the model, for messages.

    Raises:
        ModelError: when it is of another shape, has no finite numbers, a variance below zero, or
            correlations that no random numbers have.
    """
    place = f"{where}: covariance"
    if covariance.shape != (size, size):
        raise _refusal("shape", place, None, covariance.shape, size)
    if covariance.dtype.kind not in "fiu" or not np.isfinite(covariance).all():
        raise _refusal("numbers", place)
    variance = np.diag(covariance)
    if (variance < 0.0).any():
        worst = int(np.argmin(variance))
        raise _refusal("variance", place, float(variance[worst]), worst)
    # A parameter that is held has none; then it goes with no other.
    std = np.sqrt(np.where(variance > 0.0, variance, 1.0))
    correlation = covariance / std / std[:, None]
    if np.abs(correlation - correlation.T).max(initial=0.0) > _SYMMETRIC_WITHIN:
        raise _refusal("symmetry", place)
    held = covariance[variance == 0.0]
    if (held != 0.0).any() or np.linalg.eigvalsh(correlation)[0] < _EIGENVALUES_ABOVE:
        raise _refusal("correlation", place)
    return np.asarray(covariance, dtype=float)
