"""`evaluation/holdout.json`: models on held-out poses."""

from __future__ import annotations

from pa10cal.results.evaluation import HeldOutModel, HoldoutRecord
from pa10cal.results.record import Campaign


def holdout_record(
    campaign: Campaign, calibration: str, models: dict[str, HeldOutModel]
) -> HoldoutRecord:
    """Return the record of some models on held-out poses.

    Args:
        campaign: whose poses they are.
        calibration: load case of the calibration judged.
        models: errors by model; empty where no poses were held out.
    """
    return HoldoutRecord(
        campaign=campaign.name,
        provenance=campaign.provenance,
        calibration=calibration,
        configurations=max((model.configurations for model in models.values()), default=0),
        models=models,
        note=None if models else "no held-out rows measured",
    )


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
