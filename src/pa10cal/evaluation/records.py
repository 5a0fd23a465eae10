"""`evaluation/holdout.json` and `transfer_<campaign>.json`: models on held-out poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pa10cal.evaluation.compared import Carried
from pa10cal.results.accuracy import Accuracy
from pa10cal.results.evaluation import HeldOutModel, HoldoutRecord, PartOfCampaign, TransferRecord
from pa10cal.results.record import Campaign


def holdout_record(
    campaign: Campaign,
    calibration: str,
    models: dict[str, HeldOutModel],
    by_parts: Carried | None = None,
) -> HoldoutRecord:
    """Return the record of some models on held-out poses.

    Args:
        campaign: whose poses they are.
        calibration: load case of the calibration judged.
        models: errors by model; empty where no poses were held out.
        by_parts: the same with a base for every part, where instrument or base moved at once.
    """
    return HoldoutRecord(
        campaign=campaign.name,
        provenance=campaign.provenance,
        calibration=calibration,
        configurations=max((model.configurations for model in models.values()), default=0),
        models=models,
        parts=None if by_parts is None else by_parts.parts or None,
        by_parts=None if by_parts is None else errors_of(by_parts.models) or None,
        note=None if models else "no held-out rows measured",
    )


def transfer_record(campaign: Campaign, from_: str, carried: Carried) -> TransferRecord:
    """Return the record of the models of one campaign in another.

    Args:
        campaign: in which they are judged.
        from_: the other.
        carried: what became of them.
    """
    models = carried.models
    return TransferRecord(
        campaign=campaign.name,
        provenance=campaign.provenance,
        from_=from_,
        configurations=max((model.configurations for model in models.values()), default=0),
        models=models,
        parts=carried.parts or None,
        one_base=errors_of(carried.one_base) or None,
    )


def errors_of(models: Mapping[str, HeldOutModel]) -> dict[str, Accuracy]:
    """Return the errors of models over all configurations."""
    return {
        name: Accuracy(**{key: getattr(model, key) for key in Accuracy.model_fields})
        for name, model in models.items()
    }


def said_of_parts(parts: Sequence[PartOfCampaign]) -> str:
    """Return in one sentence how instrument or base moved between parts; empty where not."""
    moves = [
        f"{part.moved_by_mm:.2g} mm before {part.from_s:g} s"
        for part in parts
        if part.moved_by_mm is not None
    ]
    if not moves:
        return ""
    return f"instrument or base moved at once, by {', '.join(moves)}: a base for every part"


def summary(record: HoldoutRecord, *, springs: bool) -> str:
    """Return the errors in one line.

    Args:
        record: the errors.
        springs: whether the arm was calibrated with springs; linear and cubic are else one model.
    """
    if not record.models:
        return "no held-out rows to evaluate"
    rigid = {"linear": "calibrated", "cubic": ""}
    names = {name: name if springs else rigid.get(name, name) for name in record.models}
    errors = ", ".join(
        f"{names[name]} {model.mean_mm:.3f}/{model.peak_mm:.3f} mm"
        for name, model in record.models.items()
        if names[name]
    )
    return f"held out ({record.configurations}): mean/peak {errors}"
