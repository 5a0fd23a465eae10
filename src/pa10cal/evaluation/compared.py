"""The models of a calibration side by side, on held-out poses of its campaign or of another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pa10cal.calibration.uncertainty import align_nominal
from pa10cal.discovery.given import Extended
from pa10cal.discovery.preparation import MeasurementSetup
from pa10cal.discovery.preparation import prepared as made_ready
from pa10cal.evaluation import holdout
from pa10cal.fit.angles_seen import AngleCoverage
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations, poses_of, reading_groups
from pa10cal.observe.order import with_arrivals
from pa10cal.results import evaluation as results
from pa10cal.results.record import CampaignIdentity
from pa10cal.terms.joint_spring import nominal

#: Kinds of poses that are repeated.
_KINDS = ("grid", "holdout")
UNCALIBRATED, EXTENDED = "uncalibrated", "extended"


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Models to judge, and the campaign to judge them by."""

    every: Observations  # single readings of the campaign
    # fitted models by name; where none is called `uncalibrated`, the nominal model stands for it,
    # its base aligned once on the unloaded positions
    models: Mapping[str, FittedModel]
    extended: Extended | None  # the model with the effects that are missing, or None
    setup: MeasurementSetup  # what is known of the campaign besides the poses

    def judge(
        self, *, kind: str = "holdout", elsewhere: bool = False, cuts_s: Sequence[float] = ()
    ) -> dict[str, results.HeldOutModel]:
        """Judge the models.

        Args:
            kind: of the poses to judge by: `holdout`, or `grid` for those of the calibration.
            elsewhere: whether the models are of another campaign, so that base and tool are fitted
                anew.
            cuts_s: times at which the base moved, in order: it is then fitted part by part.

        Returns:
            Errors by model; none where there are no such poses. Elsewhere the extended model is
            never worse than the last of the others where base and tool were fitted: its effects are
            left out where they do not help there.

        Raises:
            CalibrationError: when base and tool are not determined by the poses.
        """
        every, models, extended, setup = self.every, self.models, self.extended, self.setup
        if not (every.kind == kind).any():
            return {}
        if UNCALIBRATED not in models:
            rigid = nominal(next(iter(models.values())).arm)
            T_instr_base = align_nominal(rigid, poses_of(every, "grid"))
            models = {UNCALIBRATED: FittedModel(rigid, np.zeros(0), T_instr_base), **models}

        # Those far from the last model, which knows most, by what its own poses scatter.
        *_, best = models.values()
        suspected = None
        if kind == "holdout" and not elsewhere and (every.kind == "grid").any():
            suspected = made_ready(every, best, setup).suspected

        def errors(
            model: FittedModel, every: Observations, seen: AngleCoverage | None
        ) -> results.HeldOutModel:
            poses = holdout.prepared(every, kind, model, setup, cuts_s)
            beyond = None if seen is None else ~seen.inside(poses.states.q_rad)
            return holdout.held_out_errors(model, poses, beyond, suspected)

        def there(model: FittedModel, every: Observations) -> tuple[FittedModel, float]:
            """Return a model as it is judged, and what it leaves of poses it is placed by."""
            if not elsewhere:
                return model, 0.0
            placed = holdout.placed(model, every, setup, cuts_s)
            return placed.model, placed.rms_mm

        learnt = None if extended is None else extended.seen
        # In another campaign what is new is told by the same angles for all models.
        seen = learnt or best.seen if elsewhere else None
        found, left_mm = {}, np.inf
        for name, model in models.items():
            at, left_mm = there(model, every)
            found[name] = errors(at, every, seen)
        if extended is not None:
            arrived = with_arrivals(every)[0]
            at, with_effects_mm = there(extended.model, arrived)
            # Effects that do not even help in the poses to which base and tool were fitted stay
            # away.
            *_, last = found.values()
            helps = not elsewhere or with_effects_mm < left_mm
            found[EXTENDED] = errors(at, arrived, seen or learnt) if helps else last
        return found

    def judge_in_parts(
        self, cuts_s: Sequence[float]
    ) -> tuple[dict[str, results.HeldOutModel], tuple[results.PartOfCampaign, ...]]:
        """Judge the models with a base for every part of the campaign; return the parts too."""
        found = self.judge(elsewhere=True, cuts_s=cuts_s)
        return found, holdout.parts_of(*self.best(cuts_s), cuts_s)

    def best(self, cuts_s: Sequence[float] = ()) -> tuple[holdout.Placed, Observations]:
        """Return what leaves least of the calibration poses, and the readings as it takes them."""
        *_, last = self.models.values()
        best = holdout.placed(last, self.every, self.setup, cuts_s)
        if self.extended is None:
            return best, self.every
        arrived = with_arrivals(self.every)[0]
        with_effects = holdout.placed(self.extended.model, arrived, self.setup, cuts_s)
        return (with_effects, arrived) if with_effects.rms_mm < best.rms_mm else (best, self.every)


def held_out_record(
    campaign: CampaignIdentity, calibration: str, own: Evaluation
) -> results.HoldoutRecord:
    """Judge models on held-out poses of their own campaign.

    Where the verdict tells steps, they are judged with a base for every part as well.

    Raises:
        CalibrationError: when base and tool are not determined by the poses.
    """
    found = own.judge()
    cuts_s: Sequence[float] = ()
    if found and own.extended is not None and not own.every.measured.campaigns:
        cuts_s = holdout.worth_cutting(own.every, own.extended.steps_s)
    parts = by_parts = None
    if cuts_s:
        in_parts, parts = own.judge_in_parts(cuts_s)
        by_parts = _errors_of(in_parts)
    return results.HoldoutRecord(
        campaign=campaign.name,
        provenance=campaign.provenance,
        calibration=calibration,
        configurations=_configurations(found),
        models=found,
        parts=parts,
        by_parts=by_parts,
        note=None if found else "no held-out rows measured",
    )


def transfer_record(
    campaign: CampaignIdentity, from_: str, there: Evaluation
) -> results.TransferRecord:
    """Judge models of one campaign in another, part by part where instrument or base moved there.

    Raises:
        CalibrationError: when base and tool are not determined by the poses.
    """
    found = there.judge(elsewhere=True)
    cuts_s: Sequence[float] = ()
    if found:
        best, arrived = there.best()
        cuts_s = holdout.steps_elsewhere(best.model, arrived, there.setup)
    parts = one_base = None
    if cuts_s:
        one_base = _errors_of(found)
        found, parts = there.judge_in_parts(cuts_s)
    return results.TransferRecord(
        campaign=campaign.name,
        provenance=campaign.provenance,
        from_=from_,
        configurations=_configurations(found),
        models=found,
        parts=parts,
        one_base=one_base,
    )


def _configurations(models: Mapping[str, results.HeldOutModel]) -> int:
    return max((model.configurations for model in models.values()), default=0)


def _errors_of(models: Mapping[str, results.HeldOutModel]) -> dict[str, results.Accuracy]:
    """Return the errors of models over all configurations."""
    return {
        name: results.Accuracy(
            **{key: getattr(model, key) for key in results.Accuracy.model_fields}
        )
        for name, model in models.items()
    }


def judged_where_repeated(
    own: Evaluation, *, held_out: Mapping[str, results.HeldOutModel]
) -> dict[str, Mapping[str, results.HeldOutModel]]:
    """Judge models on all configurations of the kinds that have repeats, by kind.

    Args:
        held_out: errors of the held-out poses, as `own.judge()` gave them.
    """
    found: dict[str, Mapping[str, results.HeldOutModel]] = {}
    for kind in _KINDS:
        single = own.every.of_kind(kind)
        if len(single) == len(np.unique(reading_groups(single))):
            continue
        known = held_out if kind == "holdout" else None
        found[kind] = known or own.judge(kind=kind)
    return found


def said_of_parts(parts: Sequence[results.PartOfCampaign]) -> str:
    """Return in one sentence how instrument or base moved between parts; empty where not."""
    moves = [
        f"{part.moved_by_mm:.2g} mm before {part.from_s:g} s"
        for part in parts
        if part.moved_by_mm is not None
    ]
    if not moves:
        return ""
    return f"instrument or base moved at once, by {', '.join(moves)}: a base for every part"


def summary(record: results.HoldoutRecord, *, springs: bool) -> str:
    """Return the errors in one line.

    Args:
        springs: whether the arm was calibrated with springs; linear and cubic are else one model.
    """
    if not record.models:
        return "no held-out rows to evaluate"
    rigid = {"linear": "calibrated", "cubic": ""}
    names = {name: name if springs else rigid.get(name, name) for name in record.models}
    errors = ", ".join(
        f"{names[name]} {results.mean_and_peak(model, model.trusted)}"
        for name, model in record.models.items()
        if names[name]
    )
    return f"held out ({record.configurations}): mean/peak {errors}"
