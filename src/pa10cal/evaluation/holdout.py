"""Models judged on held-out points and loads (paper, Section II.E and Fig. 6).

In poses of their own campaign, or in another campaign with base and tool fitted anew.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from pa10cal.calibration.accuracy import align_nominal
from pa10cal.discovery import preparation
from pa10cal.discovery.given import Extended
from pa10cal.discovery.preparation import MeasurementSetup
from pa10cal.errors import CalibrationError
from pa10cal.evaluation.in_parts import Placed, parts_of, placed, steps_elsewhere, worth_cutting
from pa10cal.evaluation.model_errors import held_out_errors, poses_for_model
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.validity import AngleCoverage
from pa10cal.observe.arrivals import with_arrivals
from pa10cal.observe.observations import (
    Observations,
    average_repeats,
    poses_of,
    reading_groups,
)
from pa10cal.observe.paths import HeldOutPlaces
from pa10cal.results import evaluation as results
from pa10cal.results.record import CampaignIdentity
from pa10cal.rules import COMPARED
from pa10cal.terms.joint_spring import nominal

#: Kinds of poses that are repeated.
_KINDS = ("grid", "holdout")
UNCALIBRATED, EXTENDED = "uncalibrated", "extended"


class _JudgedElsewhere(NamedTuple):
    """Errors of a model on held-out poses, and in the poses that base and tool were fitted to."""

    held_out: results.HeldOutModel
    fitted_rms_mm: float


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Models to judge, and the campaign to judge them by."""

    every: Observations  # single readings of the campaign
    # fitted models by name, the most complete last; where none is called `uncalibrated`, the
    # nominal model stands for it, its base aligned once on the unloaded positions
    models: Mapping[str, FittedModel]
    extended: Extended | None  # the model with the effects that are missing, or None
    setup: MeasurementSetup  # what is known of the campaign besides the poses

    def judge(self, kind: str = "holdout") -> dict[str, results.HeldOutModel]:
        """Return errors by model on poses of one kind; empty where there are no such poses."""
        if not (self.every.kind == kind).any():
            return {}
        models = self._with_uncalibrated()
        suspected = places = None
        if kind == "holdout":
            if (self.every.kind == "grid").any():
                # Outliers are sought by the last model, with the scatter of its calibration poses.
                suspected = preparation.prepared(self.every, self._last, self.setup).suspected
            held_out, fitted = (average_repeats(self.every.of_kind(k)) for k in ("holdout", "grid"))
            places = HeldOutPlaces.of(held_out, fitted)

        def errors(
            model: FittedModel, every: Observations, seen: AngleCoverage | None
        ) -> results.HeldOutModel:
            poses = poses_for_model(every, kind, model, self.setup)
            beyond = None if seen is None else ~seen.inside(poses.states.q_rad)
            return held_out_errors(model, poses, beyond, suspected, places)

        judged = {name: errors(model, self.every, None) for name, model in models.items()}
        if self.extended is not None:
            extended = self.extended
            judged[EXTENDED] = errors(extended.model, self._with_arrivals(), extended.seen)
        return judged

    def judge_elsewhere(self, cuts_s: Sequence[float] = ()) -> dict[str, results.HeldOutModel]:
        """Return errors by model on held-out poses of another campaign than that of the models.

        Base and tool are fitted anew to the calibration poses, the base for every part between the
        times `cuts_s`. Under the name of the extended model stands what fits the calibration poses
        best: that model, the same without terms that may not stay with the arm, or the last of the
        others. Held-out poses have no part in this choice.

        Raises:
            CalibrationError: when base and tool are not determined by the poses.
        """
        if not (self.every.kind == "holdout").any():
            return {}
        models = self._with_uncalibrated()
        # Joint angles are called new by the same coverage for all models.
        seen = self._last.seen
        if self.extended is not None and self.extended.seen is not None:
            seen = self.extended.seen

        def judged(model: FittedModel, every: Observations) -> _JudgedElsewhere:
            refitted = placed(model, every, self.setup, cuts_s)
            poses = poses_for_model(every, "holdout", refitted.model, self.setup, cuts_s)
            beyond = None if seen is None else ~seen.inside(poses.states.q_rad)
            return _JudgedElsewhere(held_out_errors(refitted.model, poses, beyond), refitted.rms_mm)

        by_name = {name: judged(model, self.every) for name, model in models.items()}
        if self.extended is not None:
            arrived = self._with_arrivals()
            *_, last = by_name.values()
            tried = [last, *(judged(model, arrived) for model in self._extended_variants)]
            by_name[EXTENDED] = min(tried, key=lambda each: each.fitted_rms_mm)
        return {name: each.held_out for name, each in by_name.items()}

    def judge_in_parts(
        self, cuts_s: Sequence[float]
    ) -> tuple[dict[str, results.HeldOutModel], tuple[results.PartOfCampaign, ...]]:
        """Judge the models with a base for every part of the campaign; return the parts too.

        Raises:
            CalibrationError: when the poses of a part do not identify its base.
        """
        judged = self.judge_elsewhere(cuts_s)
        return judged, parts_of(*self.best_placed(cuts_s), cuts_s)

    def best_placed(self, cuts_s: Sequence[float] = ()) -> tuple[Placed, Observations]:
        """Return what fits the calibration poses best, and the readings with what it needs.

        The last model, or a variant of the extended one, with base and tool fitted.
        """
        best = placed(self._last, self.every, self.setup, cuts_s)
        arrived = self._with_arrivals()
        tried = [placed(model, arrived, self.setup, cuts_s) for model in self._extended_variants]
        extended = min(tried, key=lambda each: each.rms_mm, default=best)
        return (extended, arrived) if extended.rms_mm < best.rms_mm else (best, self.every)

    @property
    def _last(self) -> FittedModel:
        *_, last = self.models.values()
        return last

    def _with_uncalibrated(self) -> Mapping[str, FittedModel]:
        """Return the models, the nominal arm first where none is called `uncalibrated`."""
        if UNCALIBRATED in self.models:
            return self.models
        rigid = nominal(next(iter(self.models.values())).arm)
        T_instr_base = align_nominal(rigid, poses_of(self.every, "grid"))
        return {UNCALIBRATED: FittedModel(rigid, np.zeros(0), T_instr_base), **self.models}

    def _with_arrivals(self) -> Observations:
        """Return the readings with directions of arrival, which effects may need."""
        return with_arrivals(self.every, self._last.arm)[0]

    @property
    def _extended_variants(self) -> tuple[FittedModel, ...]:
        """Return the extended model, and it without terms that may not stay with the arm."""
        if self.extended is None:
            return ()
        whole = self.extended.model
        of_last = {(term.id, term.of) for term in self._last.model.terms}
        terms = whole.model.terms
        kept = [term for term in terms if term.stays_with_arm or (term.id, term.of) in of_last]
        return (whole,) if len(kept) == len(terms) else (whole, whole.only(*kept))


def held_out_record(
    campaign: CampaignIdentity, calibration: str, evaluation: Evaluation
) -> results.HoldoutRecord:
    """Judge models on held-out poses of their own campaign.

    Where the verdict has steps in time, they are judged with a base for every part as well, if the
    poses of each identify it.
    """
    judged = evaluation.judge()
    cuts_s: Sequence[float] = ()
    if judged and evaluation.extended is not None and not evaluation.every.measured.campaigns:
        cuts_s = worth_cutting(evaluation.every, evaluation.extended.steps_s)
    parts = by_parts = None
    if cuts_s:
        with suppress(CalibrationError):
            in_parts, parts = evaluation.judge_in_parts(cuts_s)
            by_parts = _overall_errors(in_parts)
    return results.HoldoutRecord(
        calibration=calibration,
        parts=parts,
        by_parts=by_parts,
        note=None if judged else "no held-out rows measured",
        **_shared_keys(campaign, judged),
    )


def transfer_record(
    campaign: CampaignIdentity, from_: str, evaluation: Evaluation
) -> results.TransferRecord:
    """Judge models of one campaign in another, part by part where instrument or base moved there.

    With one base for all parts where the poses of one do not identify its own.

    `from_` is the name of the models' campaign.

    Raises:
        CalibrationError: when base and tool are not determined by the poses.
    """
    judged = evaluation.judge_elsewhere()
    cuts_s: Sequence[float] = ()
    if judged:
        best, readings = evaluation.best_placed()
        cuts_s = steps_elsewhere(best.model, readings, evaluation.setup)
    parts = one_base = None
    if cuts_s:
        of_one_base = judged
        with suppress(CalibrationError):
            judged, parts = evaluation.judge_in_parts(cuts_s)
            one_base = _overall_errors(of_one_base)
    return results.TransferRecord(
        from_=from_,
        parts=parts,
        one_base=one_base,
        worse=said_of_worse(judged, from_) or None,
        **_shared_keys(campaign, judged),
    )


def _shared_keys(
    campaign: CampaignIdentity, models: Mapping[str, results.HeldOutModel]
) -> dict[str, Any]:
    return {
        "campaign": campaign.name,
        "provenance": campaign.provenance,
        "configurations": max((each.configurations for each in models.values()), default=0),
        "models": models,
    }


def _overall_errors(models: Mapping[str, results.HeldOutModel]) -> dict[str, results.Accuracy]:
    """Return the errors of models over all configurations."""
    return {
        name: results.Accuracy.model_validate(model, from_attributes=True)
        for name, model in models.items()
    }


def judged_where_repeated(
    evaluation: Evaluation, *, held_out: Mapping[str, results.HeldOutModel]
) -> dict[str, Mapping[str, results.HeldOutModel]]:
    """Judge models on all configurations of the kinds that have repeats, by kind.

    Those of held-out poses were judged already: `held_out`, from `evaluation.judge()`.
    """
    judged: dict[str, Mapping[str, results.HeldOutModel]] = {}
    for kind in _KINDS:
        readings = evaluation.every.of_kind(kind)
        if len(readings) == len(np.unique(reading_groups(readings))):
            continue
        known = held_out if kind == "holdout" else None
        judged[kind] = known or evaluation.judge(kind)
    return judged


def said_of_worse(models: Mapping[str, results.HeldOutModel], from_: str) -> str:
    """Return in one sentence which carried models are worse than the nominal arm; empty if none."""
    nominal_mm = models[UNCALIBRATED].rms_mm if models else 0.0
    worse = [
        f"{name} {model.rms_mm:.3f} mm rms"
        for name, model in models.items()
        if model.rms_mm > COMPARED.worse_ratio * nominal_mm
    ]
    if not worse:
        return ""
    return (
        f"worse here than the nominal arm, which has {nominal_mm:.3f} mm rms with base and tool "
        f"fitted alike: {', '.join(worse)}; what {from_} determined does not hold here, do not use "
        "it: calibrate this campaign, and compare the two models"
    )


def said_of_parts(parts: Sequence[results.PartOfCampaign]) -> str:
    """Return in one sentence how instrument or base moved between parts; empty if not at all."""
    moves = [
        f"{part.moved_by_mm:.2g} mm before {part.from_s:g} s"
        for part in parts
        if part.moved_by_mm is not None
    ]
    if not moves:
        return ""
    return f"instrument or base moved suddenly, by {', '.join(moves)}: a base for every part"


def summary(record: results.HoldoutRecord, *, springs: bool) -> str:
    """Return the errors in one line; without springs linear and cubic are one model."""
    if not record.models:
        return "no held-out rows to evaluate"
    rigid = {"linear": "calibrated", "cubic": ""}
    names = {name: name if springs else rigid.get(name, name) for name in record.models}
    by_place: dict[str, dict[str, results.PartAccuracy]] = {}
    for name, model in record.models.items():
        for place, part in model.by_place.items():
            by_place.setdefault(place, {})[name] = part
    clauses = []
    for place, part_by_name in by_place.items():
        errors = ", ".join(
            f"{names[name]} {results.mean_and_peak(part, part.trusted)}"
            for name, part in part_by_name.items()
            if names[name]
        )
        count = max(part.configurations for part in part_by_name.values())
        start = f"{place} ({count})" if place else f"({count})"
        clauses.append(f"{start}: mean/peak {errors}")
    return f"held out {'; '.join(clauses)}"
