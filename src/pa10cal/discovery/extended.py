"""The calibrated model with the effects that were found missing, and its record."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pa10cal.discovery.blocked_cv.discover import BlockedDiscovery
from pa10cal.discovery.discover import Discovery
from pa10cal.discovery.evidence.fit import apparatus_m, covariance_of
from pa10cal.discovery.operating_point import moved_base
from pa10cal.fit.angles_seen import AnglesSeen
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.model_file import covariance_beside, model_from_plain
from pa10cal.results.codec import read
from pa10cal.results.discovery import ExtendedRecord
from pa10cal.terms.model import Model


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


def extended_by_repeats(found: Discovery) -> FittedModel:
    """Return the extended model of a search by repeats."""
    fit, baseline = found.extended, found.problem.baseline
    terms = (*baseline.model.terms, *fit.effects)
    return replace(
        baseline,
        model=Model(baseline.model.chain, terms),
        x=fit.x[:-6],
        T_instr_base=moved_base(fit.level.T_instr_base, fit.x[-6:]),
        targets_off_m=apparatus_m(found.problem, fit),
        covariance=covariance_of(found.problem, fit)[:-6, :-6],
    )


def extended_by_blocks(found: BlockedDiscovery) -> FittedModel:
    """Return the extended model of a search by blocks of poses."""
    fit = found.extended
    return replace(
        found.survey.baseline,
        model=fit.model,
        x=fit.x,
        T_instr_base=fit.T_instr_base,
        targets_off_m=np.zeros(found.survey.poses.measured.by_apparatus.shape[2]),
        covariance=fit.covariance[:-6, :-6],
        seen=found.seen,
    )


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
