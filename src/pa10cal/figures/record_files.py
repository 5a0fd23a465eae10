"""Result files read and checked: which campaign's they are, what they follow, how a fit ended."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from pydantic import ValidationError

from pa10cal.errors import RawDataError, RecordError
from pa10cal.figures.records import AnyCalibration, Record

if TYPE_CHECKING:
    import pyarrow as pa

_R = TypeVar("_R", bound=Record)

CONVERGED = "converged"
_POSES_SCHEMA = "pa10cal-poses/1"


def read_content(path: Path, schema: str, stage: str, campaign: str) -> dict[str, object]:
    """Read a JSON result of a campaign.

    Args:
        path: the file.
        schema: what its `schema` must be.
        stage: which writes it, for the message.
        campaign: whose it must be.

    Raises:
        RawDataError: when it is missing, is no such result, or is another campaign's.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise _missing(path, stage) from None
    except (OSError, ValueError) as error:
        raise _foreign(path, str(error), schema, stage) from None
    content = content if isinstance(content, dict) else {}
    _check_header(path, content, schema, stage, campaign)
    return content


def as_record(
    content: dict[str, object], kind: type[_R], path: Path, schema: str, stage: str
) -> _R:
    """Return the part of a result that pictures are drawn from.

    Raises:
        RawDataError: when a key is missing or does not fit.
    """
    try:
        return kind.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise _foreign(path, f"{key}: {first['msg']}", schema, stage) from None


def check_converged(path: Path, found: AnyCalibration) -> None:
    """Refuse to draw anything of a calibration of which a fit did not converge.

    Raises:
        RecordError: naming the file, the fit, and why it stopped.
    """
    for key, fit in found.fits.items():
        if fit.status != CONVERGED:
            raise RecordError(
                "the fit did not converge, so nothing is drawn of it",
                where=f"{path}: {key}" if key else str(path),
                value=f"{fit.status}: {fit.reason}",
                allowed=f"a calibration whose status is {CONVERGED}",
                remedy="allow more steps (calibration.max_iterations), free fewer parameters or "
                "measure more poses, and run the calibrate stage again",
            )


def read_pose_table(path: Path, columns: tuple[str, ...], campaign: str) -> pa.Table:
    """Read columns of the table of poses, in order of time.

    Args:
        path: `ingest/poses.parquet`.
        columns: wanted; none for all.
        campaign: whose it must be.

    Raises:
        RawDataError: when it is missing, lacks a column, is no such table, or is another
            campaign's.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    if not path.is_file():
        raise _missing(path, "ingest")
    try:
        table = pq.read_table(path, columns=list(columns) or None)
    except (OSError, pa.ArrowException) as error:
        reason = " ".join(str(error).split())
        raise _foreign(path, reason, _POSES_SCHEMA, "ingest") from None
    header = {k.decode(): v.decode() for k, v in (table.schema.metadata or {}).items()}
    _check_header(path, header, _POSES_SCHEMA, "ingest", campaign)
    if absent := set(columns) - set(table.column_names):
        raise _foreign(path, f"no column {sorted(absent)[0]}", _POSES_SCHEMA, "ingest")
    return table.sort_by("time_s")


def _check_header(
    path: Path, header: dict[str, object], schema: str, stage: str, campaign: str
) -> None:
    if header.get("schema") != schema:
        raise _foreign(path, header.get("schema", "no schema"), schema, stage)
    if header.get("campaign") != campaign:
        raise RawDataError(
            "the result is another campaign's",
            where=str(path),
            value=header.get("campaign"),
            allowed=campaign,
            remedy="give the campaign's own --results-dir, or run its stages again",
        )


def _missing(path: Path, stage: str) -> RawDataError:
    return RawDataError(
        "a result that the picture is drawn from is missing",
        where=str(path),
        allowed=f"a file that the {stage} stage wrote",
        remedy=f"run the {stage} stage first",
    )


def _foreign(path: Path, value: object, schema: str, stage: str) -> RawDataError:
    return RawDataError(
        "the result cannot be read",
        where=str(path),
        value=value,
        allowed=f"a file of schema {schema} that the {stage} stage wrote",
        remedy=f"run the {stage} stage again",
    )


def read_study(path: Path, kind: type[_R], schema: str, what: str, stage: str) -> _R:
    """Read the record of a study, which is of no campaign.

    Args:
        path: the file.
        kind: type of the record.
        schema: what its `schema` must be.
        what: what it is, for the message.
        stage: which writes it, for the message.

    Raises:
        RecordError: when the file is missing or is no such record.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content.get("schema") != schema:
            raise ValueError(f"schema {content.get('schema')}")
        return kind.model_validate(content)
    except (OSError, ValueError, AttributeError) as error:
        where = error.errors()[0]["loc"] if isinstance(error, ValidationError) else error
        raise RecordError(
            f"the {what} cannot be read",
            where=str(path),
            value=str(where),
            allowed=f"a file of schema {schema}",
            remedy=f"run the {stage} stage again",
        ) from None
