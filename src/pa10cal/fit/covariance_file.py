"""The covariance of a fitted model, in a file beside its own; one that is none is refused."""

from __future__ import annotations

import math
import os
import struct
import zlib
from io import BytesIO
from pathlib import Path
from tokenize import TokenError
from typing import Any, BinaryIO
from zipfile import BadZipFile, ZipFile, ZipInfo

import numpy as np

from pa10cal.arm.chain import BASE
from pa10cal.arrays import Array
from pa10cal.errors import ModelError
from pa10cal.fit.fitted import Fitted
from pa10cal.input_files import UnfitFileError, open_file, reason
from pa10cal.observe.instrument import target_coordinates
from pa10cal.rules import LISTS

#: What reads the header of an array, by the version of its format.
_HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}
#: In the headers of a zip file (format).
_UNIX, _MODE = 3, 0o644 << 16
_WRITE_AGAIN = "write the model again, or remove the file to go without uncertainties"
#: What numpy and zipfile raise of files that are none: a header is a Python expression.
_UNREADABLE = (
    *(OSError, EOFError, ValueError, KeyError, IndexError, TypeError, RuntimeError),
    *(SyntaxError, TokenError, BadZipFile, struct.error, zlib.error),
)


def covariance_path(path: Path) -> Path:
    """Return the path of the covariance of the model in a file."""
    return path.with_name(f"{path.stem}.covariance.npz")


def write_covariance(model: Fitted, path: Path) -> None:
    """Write the covariance of a model's parameters, with their names (.npz).

    Equal numbers are equal bytes: `np.savez` has headers that depend on the release of Python, and
    compression on that of zlib.
    """
    names = [*(parameter.name for parameter in model.model.parameters), *BASE]
    names += target_coordinates(model.target_names)
    covariance = np.zeros((0, 0)) if model.covariance is None else model.covariance
    with ZipFile(path, "w") as file:
        for name, array in (("names", np.array(names)), ("covariance", covariance)):
            member = ZipInfo(f"{name}.npy")
            member.create_system, member.external_attr = _UNIX, _MODE
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
        raise ModelError(
            f"the covariance of the model cannot be read: {reason(error)}",
            where=str(beside),
            allowed="a file beside the model",
            remedy="copy it there, or go without uncertainties",
        ) from None
    except _UNREADABLE:
        raise ModelError(
            "the covariance of the model cannot be read",
            where=str(beside),
            allowed="the file that this package wrote beside the model",
            remedy=_WRITE_AGAIN,
        ) from None
    return covariance if len(covariance) else None


def _read(file: BinaryIO) -> Array:
    """Return the covariance in a file; nothing is allocated that the file does not hold.

    Raises:
        ValueError, KeyError, BadZipFile: when there is none.
    """
    size = os.fstat(file.fileno()).st_size
    if size > LISTS.most_bytes:
        raise ValueError("it is too large")
    with ZipFile(file) as archive:
        of = archive.getinfo("covariance.npy")
        if of.file_size > LISTS.most_bytes:
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


def checked_covariance(covariance: Array, size: int, where: str, of_targets: int = 0) -> Array:
    """Return a covariance that random numbers can have; see `FittedModel.covariance`.

    Args:
        size: of the parameters and the base.
        of_targets: coordinates of targets after these; zero where it has none of them.
        where: file of the model, for messages.

    Raises:
        ModelError: when it is of another shape, has no finite numbers, a variance below zero, or
            correlations that no random numbers have.
    """

    def refusal(what: str, allowed: str, **more: Any) -> ModelError:
        about = {"where": f"{where}: covariance", "remedy": _WRITE_AGAIN, **more}
        return ModelError(what, allowed=allowed, **about)

    whole = size + of_targets
    if covariance.shape not in {(size, size), (whole, whole)}:
        what = f"a covariance of shape {covariance.shape}"
        allowed = f"({whole}, {whole}): parameters, base, targets"
        raise refusal(what, allowed, remedy="write the model again")
    if covariance.dtype.kind not in "fiu" or not np.isfinite(covariance).all():
        raise refusal("a covariance that is not made of finite numbers", "finite numbers")
    variance = np.diag(covariance)
    if (variance < 0.0).any():
        worst = int(np.argmin(variance))
        what = f"a variance below zero, that of parameter {worst}"
        raise refusal(what, "variances of zero or more", value=float(variance[worst]))
    # A parameter that is held has none; then it goes with no other.
    std = np.sqrt(np.where(variance > 0.0, variance, 1.0))
    correlation = covariance / std / std[:, None]
    if np.abs(correlation - correlation.T).max(initial=0.0) > LISTS.symmetric_within:
        allowed = "that of a with b equal to that of b with a"
        raise refusal("a covariance that is not symmetric", allowed)
    held = covariance[variance == 0.0]
    if (held != 0.0).any() or np.linalg.eigvalsh(correlation)[0] < LISTS.eigenvalues_above:
        raise refusal("correlations that no random numbers have", "no eigenvalue below zero")
    return np.pad(np.asarray(covariance, dtype=float), (0, whole - len(covariance)))
