"""Verdicts on blind trials and their truths: two files of JSON lines, one line a trial."""

from __future__ import annotations

import json
from typing import Any

from pa10cal.cell.trials import Trial
from pa10cal.files.schemas import TRIAL_TRUTH


def truth_record(trial: Trial) -> dict[str, Any]:
    """Return what a trial hides and how it was measured."""
    settings = trial.settings
    return {
        "schema": TRIAL_TRUTH,
        "campaign": trial.name,
        "kind": trial.kind,
        "layout": settings.poses.layout,
        "path": settings.path,
        "temperature_drift_C": settings.temperature_drift_C,
        "flexible_joints": list(settings.flexible_joints),
        "hidden_effects": [
            {**effect.model_dump(), "size": size}
            for effect, size in zip(settings.hidden_effects, trial.sizes, strict=True)
        ],
        "stated_uncertainty_mm": settings.stated_uncertainty_mm,
        "mass_factor": list(settings.mass_factor),
    }


def json_line(record: dict[str, Any]) -> str:
    """Return a record as one line of JSON.

    Raises:
        ValueError: when a number is not finite.
    """
    return json.dumps(record, ensure_ascii=False, allow_nan=False) + "\n"
