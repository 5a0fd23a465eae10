"""The calibrated model with the effects that were found missing, read from its record."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pa10cal.fit.angles_seen import AnglesSeen
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.model_file import covariance_beside, model_from_plain
from pa10cal.results.codec import read
from pa10cal.results.discovery import ExtendedRecord


@dataclass(frozen=True, eq=False)
class Extended:
    """The model with the effects that were missing.

    Attributes:
        model: the model.
        seen: joint angles that its maps have learnt from; None where it has learnt nothing that
            stops there.
        arrival_from_order: whether directions of arrival are those of the order of poses.
    """

    model: FittedModel
    seen: AnglesSeen | None = None
    arrival_from_order: bool = False


def read_extended(path: Path, campaign: str) -> Extended:
    """Read `discovery/extended.json` and the covariance beside it.

    Raises:
        RecordError: when it is of another campaign or lacks a key.
        ModelError: when its model cannot be made of what is written.
        TermError: when it has a term that is not known.
    """
    record = read(ExtendedRecord, path, campaign)
    model = model_from_plain(
        record.fitted_model,
        where=f"{path}: fitted_model",
        covariance=covariance_beside(path),
    )
    seen = model.seen if record.angles_seen is not None else None
    return Extended(model, seen, record.arrival_from_order)
