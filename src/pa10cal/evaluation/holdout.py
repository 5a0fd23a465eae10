"""Models judged on held-out points and loads (paper, Section II.E and Fig. 6).

In poses of their own campaign, or in another campaign with base and tool fitted anew.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from pa10cal.calibration.two_level_problem import align_nominal
from pa10cal.discovery import preparation
from pa10cal.discovery.preparation import MeasurementSetup
from pa10cal.discovery.verdict_records import Extended
from pa10cal.errors import CalibrationError
from pa10cal.evaluation.carried_model import (
    RefittedModel,
    base_steps_s,
    campaign_parts,
    with_enough_poses,
    with_frames_refitted,
)
from pa10cal.evaluation.model_errors import held_out_errors, poses_for_model
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.validity import AngleCoverage
from pa10cal.observe.arrivals import with_arrivals
from pa10cal.observe.observations import Observations, average_repeats, poses_of, reading_groups
from pa10cal.observe.paths import HeldOutPlaces
from pa10cal.results import evaluation as results
from pa10cal.results.record import CampaignIdentity
from pa10cal.rules import COMPARED
from pa10cal.terms.joint_spring import nominal

#: Kinds of poses that are repeated.
_KINDS = ("grid", "holdout")
UNCALIBRATED, EXTENDED = "uncalibrated", "extended"


@dataclass(frozen=True, eq=False)
class CarriedModels:
    """Models judged on held-out poses, with base and tool fitted to the calibration poses."""

    errors: Mapping[str, results.HeldOutModel]  # by the model's name
    last: RefittedModel  # the most complete model


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Models to judge, and the campaign to judge them by."""

    every: Observations  # single readings of the campaign
    # fitted models by name, the most complete last; where none is called `uncalibrated`, the
    # nominal model stands for it, its base aligned once on the unloaded positions
    models: Mapping[str, FittedModel]
    extended: Extended | None  # the model with the effects that are missing, or None
    setup: MeasurementSetup  # what is known of the campaign besides the poses

    @property
    def cuts_s(self) -> tuple[float, ...]:
        """Return when base or instrument moved suddenly, by the verdict; none of a group."""
        if self.extended is None or self.every.measured.campaigns:
            return ()
        return tuple(self.extended.steps_s)

    def judge(
        self, kind: str = "holdout", cuts_s: Sequence[float] = ()
    ) -> dict[str, results.HeldOutModel]:
        """Return errors by model on poses of one kind; empty where there are no such poses.

        Repeats before and after a time in `cuts_s` are averaged apart, with one base for all; then
        no outliers are sought, and errors are not listed by place.
        """
        if not (self.every.kind == kind).any():
            return {}
        models = self._all_models()
        suspected = places = None
        if kind == "holdout" and not cuts_s:
            if (self.every.kind == "grid").any():
                # Outliers are sought by the last model, with the scatter of its calibration poses.
                moved = None if self.extended is None else self.extended.moved
                prepared = preparation.prepared(self.every, self._last, self.setup, moved=moved)
                suspected = prepared.suspected
            held_out, fitted = (average_repeats(self.every.of_kind(k)) for k in ("holdout", "grid"))
            places = HeldOutPlaces.of(held_out, fitted)

        def errors(
            model: FittedModel, every: Observations, seen: AngleCoverage | None
        ) -> results.HeldOutModel:
            poses = poses_for_model(every, kind, model, self.setup, cuts_s)
            beyond = None if seen is None else ~seen.inside(poses.states.q_rad)
            return held_out_errors(model, poses, beyond, suspected, places)

        judged = {name: errors(model, self.every, None) for name, model in models.items()}
        if self.extended is not None:
            extended = self.extended
            judged[EXTENDED] = errors(extended.model, self._with_arrivals(), extended.seen)
        return judged

    def judge_carried(self, cuts_s: Sequence[float] = ()) -> CarriedModels:
        """Judge models on held-out poses of another campaign than that of the models.

        Base and tool are fitted anew to the calibration poses, the base for every part between the
        times `cuts_s`. Under the name of the extended model stands what fits the calibration poses
        best: that model, the same without terms that may not stay with the arm, or the last of the
        others. Held-out poses have no part in this choice.

        Raises:
            CalibrationError: when base and tool are not determined by the poses.
        """

        def refit(model: FittedModel, every: Observations) -> RefittedModel:
            return with_frames_refitted(model, every, self.setup, cuts_s)

        refitted = {name: refit(model, self.every) for name, model in self._all_models().items()}
        *_, last = refitted.values()
        seen = self._last.seen
        if self.extended is not None:
            arrived = self._with_arrivals()
            tried = [last, *(refit(model, arrived) for model in self._extended_variants)]
            refitted[EXTENDED] = last = min(tried, key=lambda each: each.rms_mm)
            # Joint angles are called new by the same coverage for all models.
            seen = self.extended.seen or seen

        def errors(each: RefittedModel) -> results.HeldOutModel:
            poses = poses_for_model(each.every, "holdout", each.model, each.setup, cuts_s)
            beyond = None if seen is None else ~seen.inside(poses.states.q_rad)
            return held_out_errors(each.model, poses, beyond)

        return CarriedModels({name: errors(each) for name, each in refitted.items()}, last)

    @property
    def has_held_out(self) -> bool:
        """Return whether there are held-out poses."""
        return bool((self.every.kind == "holdout").any())

    @property
    def _last(self) -> FittedModel:
        *_, last = self.models.values()
        return last

    def _all_models(self) -> Mapping[str, FittedModel]:
        """Return the models, the nominal arm first where none is called `uncalibrated`."""
        if UNCALIBRATED in self.models:
            return self.models
        rigid = nominal(next(iter(self.models.values())).arm)
        T_instr_base = align_nominal(rigid, poses_of(self.every, "grid"))
        return {UNCALIBRATED: FittedModel(rigid, np.zeros(0), T_instr_base), **self.models}

    def _with_arrivals(self) -> Observations:
        """Return the readings with directions of arrival, which effects may need.

        Where zeros of joints moved, as they would be since the last step: so is the extended model.
        """
        moved = None if self.extended is None else self.extended.moved
        every = self.every if moved is None else moved.corrected(self.every)
        return with_arrivals(every, self._last.arm)[0]

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
    if judged and evaluation.cuts_s:
        cuts_s = with_enough_poses(evaluation.every, evaluation.cuts_s)
    parts = by_parts = None
    if cuts_s:
        with suppress(CalibrationError):
            in_parts = evaluation.judge_carried(cuts_s)
            parts = campaign_parts(in_parts.last, cuts_s)
            by_parts = _overall_errors(in_parts.errors)
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

    Args:
        campaign: the other campaign, which `evaluation` holds.
        from_: name of the models' campaign.

    Raises:
        CalibrationError: when base and tool are not determined by the poses.
    """
    errors: Mapping[str, results.HeldOutModel] = {}
    parts = one_base = None
    if evaluation.has_held_out:
        carried = evaluation.judge_carried()
        errors = carried.errors
        cuts_s = base_steps_s(carried.last)
        if cuts_s:
            with suppress(CalibrationError):
                in_parts = evaluation.judge_carried(cuts_s)
                parts = campaign_parts(in_parts.last, cuts_s)
                errors, one_base = in_parts.errors, _overall_errors(carried.errors)
    return results.TransferRecord(
        from_=from_,
        parts=parts,
        one_base=one_base,
        worse=worse_than_nominal(errors, from_) or None,
        **_shared_keys(campaign, errors),
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

    Those before and after a sudden motion of base or instrument are configurations of their own. If
    there is none, those of held-out poses were judged already: `held_out`, by `evaluation.judge()`.
    """
    judged: dict[str, Mapping[str, results.HeldOutModel]] = {}
    cuts_s = evaluation.cuts_s
    for kind in _KINDS:
        readings = evaluation.every.of_kind(kind)
        if len(readings) == len(np.unique(reading_groups(readings, cuts_s))):
            continue
        known = held_out if kind == "holdout" and not cuts_s else None
        judged[kind] = known or evaluation.judge(kind, cuts_s)
    return judged


def worse_than_nominal(models: Mapping[str, results.HeldOutModel], from_: str) -> str:
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


def base_motion_line(parts: Sequence[results.PartOfCampaign]) -> str:
    """Return in one sentence how instrument or base moved between parts; empty if not at all."""
    moves = [
        f"{part.moved_by_mm:.2f} mm and {part.turned_by_mrad:.2f} mrad before "
        f"{part.from_s - parts[0].from_s:.1f} s"
        for part in parts
        if part.moved_by_mm is not None
    ]
    if not moves:
        return ""
    return (
        f"instrument or base moved suddenly, by {', '.join(moves)} after the first reading: "
        "a base for every part"
    )


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
    *_, last = record.models
    by_weights = record.models[last].by_weights
    if by_weights is not None:
        clauses.append(
            f"without the log, by the torques of the weights as predictions have them: "
            f"{names[last] or last} {results.mean_and_peak(by_weights, None)}"
        )
    return f"held out {'; '.join(clauses)}"
