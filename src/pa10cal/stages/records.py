"""Reading the JSON records that one stage writes and another reads."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pa10cal.errors import RecordError

#: The `schema` of each kind of record.
BASE_FRAME = "pa10cal-base-frame/1"
CALIBRATION = "pa10cal-calibration/1"
HOLDOUT = "pa10cal-holdout/1"
MONTECARLO = "pa10cal-montecarlo/1"


def read_record(path: Path, schema: str, needs: tuple[str, ...] = ()) -> dict[str, Any]:
    """Read a JSON record of a given schema.

    Args:
        path: the file.
        schema: what its `schema` must be.
        needs: keys it must have.

    Raises:
        RecordError: when it cannot be read, or is another kind of file, or lacks a key.
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
    return dict(content)
