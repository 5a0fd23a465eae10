"""Reading the JSON records that one stage writes and another reads."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pa10cal.errors import RecordError


def read_record(
    path: Path, schema: str, needs: tuple[str, ...] = (), campaign: str | None = None
) -> dict[str, Any]:
    """Read a JSON record of a given schema.

    Args:
        path: the file.
        schema: what its `schema` must be.
        needs: keys it must have.
        campaign: whose it must be; None for any.

    Raises:
        RecordError: when it cannot be read, or is another kind of file or of another
            campaign, or lacks a key.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise RecordError(
            "the record cannot be read",
            where=str(path),
            value=str(error),
            allowed=f"a JSON file with schema {schema}",
            remedy="run the stage that writes it again",
        ) from None
    found = content.get("schema") if isinstance(content, dict) else None
    if found != schema:
        raise RecordError(
            "not a record of this kind",
            where=str(path),
            value=found,
            allowed=f"schema {schema}",
            remedy="give the file that the stage before wrote",
        )
    missing = [key for key in needs if key not in content]
    if missing:
        raise RecordError(
            f"the record lacks {', '.join(missing)}",
            where=str(path),
            allowed=", ".join(needs),
            remedy="run the stage that writes it again",
        )
    if campaign is not None and content.get("campaign") != campaign:
        raise RecordError(
            "the record is of another campaign",
            where=str(path),
            value=content.get("campaign"),
            allowed=campaign,
            remedy="give the results of the campaign that --campaign-dir names",
        )
    return dict(content)


def read_pose_matrix(record: dict[str, Any], key: str, path: Path) -> NDArray[np.float64]:
    """Return a homogeneous matrix (4, 4) of a record.

    Raises:
        RecordError: when it is no such matrix.
    """
    return _numbers(record, key, (4, 4), ("a pose", "four rows of four numbers"), path)


def read_vector(record: dict[str, Any], key: str, size: int, path: Path) -> NDArray[np.float64]:
    """Return the numbers (size,) of a record.

    Raises:
        RecordError: when they are not so many finite numbers.
    """
    return _numbers(record, key, (size,), ("a list of numbers", f"{size} finite numbers"), path)


def _numbers(
    record: dict[str, Any], key: str, shape: tuple[int, ...], said: tuple[str, str], path: Path
) -> NDArray[np.float64]:
    what, allowed = said
    try:
        numbers = np.array(record[key], dtype=float)
    except (KeyError, TypeError, ValueError):
        numbers = np.full((), np.nan)
    if numbers.shape != shape or not np.isfinite(numbers).all():
        raise RecordError(
            f"{key} is not {what} as it should be",
            where=str(path),
            value=record.get(key),
            allowed=allowed,
            remedy="run the stage that writes it again",
        )
    return numbers
