"""The extended model that commands read, from `discovery/extended.json`.

Apart from the command that writes it: no command imports at once what takes time.
"""

from __future__ import annotations

from pathlib import Path

from pa10cal.discovery.given import Extended
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.model_file import covariance_beside, model_from_plain
from pa10cal.results.codec import read
from pa10cal.results.discovery import ExtendedRecord
from pa10cal.terms.effects.effect import Effect


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
        FittedModel,
        where=f"{path}: fitted_model",
        covariance=covariance_beside(path),
    )
    seen = model.seen if record.angles_seen is not None else None
    return Extended(model, seen, record.arrival_from_order, record.steps_s or ())


def effects_of(model: FittedModel) -> list[Effect]:
    """Return the effects of the vocabulary that a model holds."""
    return [term for term in model.model.terms if isinstance(term, Effect)]
