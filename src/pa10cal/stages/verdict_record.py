"""`discovery/verdict.json`: what is missing from the model, and what became of the gap."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from pa10cal.calibration.accuracy import Accuracy
from pa10cal.discovery.discover import Discovery
from pa10cal.discovery.evidence.confirm import LeftOut
from pa10cal.discovery.evidence.judge import FLIP_RATE, MAP, Finding, Unexplained, shared_error_mm
from pa10cal.discovery.evidence.search import threshold
from pa10cal.discovery.gap import Gap, Paired
from pa10cal.terms.effects.effect import Effect


def verdict_record(found: Discovery, error_rate: float) -> dict[str, Any]:
    """Return the verdict as the results' contract has it, without the suggested poses."""
    judgement = found.judgement
    needed = threshold(len(found.family), error_rate)
    return {
        "verdict": judgement.verdict,
        "effects": [_effect(finding, needed) for finding in judgement.findings],
        "unexplained": _unexplained(found),
        "not_testable": [
            {**name_of(entry.effect), "why": entry.why}
            for entry in found.not_testable
            if not entry.effect.generic
        ],
        "not_told_apart": [[name_of(effect) for effect in group] for group in found.alike],
        "gap": {
            "noise_floor_mm": found.noise_floor_mm,
            "train": gap_record(found.train),
            "holdout": None if found.holdout is None else gap_record(found.holdout),
        },
        "search": {
            "candidates": len(found.family),
            "error_rate": error_rate,
            "needed_nats": needed,
            "shared_error_mm": {
                "before": shared_error_mm(found.problem, judgement.found.nothing.pose_variance),
                "after": shared_error_mm(found.problem, judgement.found.score.pose_variance),
            },
        },
    }


def name_of(effect: Effect) -> dict[str, str]:
    """Return an effect's name and place."""
    return {"id": effect.id, "of": effect.of}


def _effect(finding: Finding, needed: float) -> dict[str, Any]:
    known = finding.effect.report(np.zeros(len(finding.effect.parameters))).parameters
    std = np.sqrt(np.diag(finding.covariance))
    confirmation = finding.confirmation
    return {
        **name_of(finding.effect),
        "parameters": {
            parameter.name: {"value": float(value), "std": float(sigma), "unit": parameter.unit}
            for parameter, value, sigma in zip(known, finding.x, std, strict=True)
        },
        "alternatives": [name_of(effect) for effect in finding.alternatives],
        "evidence": {
            "lost_without_it_nats": confirmation.loss,
            "needed_nats": needed,
            "p_sign_flips_max_t": confirmation.p_flips,
            "p_needed": FLIP_RATE,
            "poses_left_out": asdict(confirmation.poses),
            "loads_left_out": _left_out(confirmation.loads),
        },
    }


def _left_out(found: LeftOut | None) -> dict[str, float] | None:
    return None if found is None else asdict(found)


def _unexplained(found: Discovery) -> dict[str, Any] | None:
    """Return where something without a name sits: the largest first, all of them in a list."""
    judgement = found.judgement
    places = [_place(entry) for entry in judgement.unexplained]
    maps = [f.effect for f in judgement.findings if f.effect.id == MAP]
    if not places and maps:
        # A map says where and not why: its cause is in no row of the vocabulary.
        places = [
            {"of": effect.of, "form": MAP, "shared_error_mm": None, "why": "cause not known"}
            for effect in maps
        ]
    return {**places[0], "all": places} if places else None


def _place(entry: Unexplained) -> dict[str, Any]:
    return {
        "of": entry.of,
        "form": None if entry.generic is None else entry.generic.id,
        "shared_error_mm": entry.shared_mm,
        "why": (
            "no effect of the vocabulary explains what the readings of a pose share"
            if entry.generic is None
            else f"a smooth unknown function ({entry.generic.id}) of {entry.of} predicts it better "
            "than any name"
        ),
    }


def gap_record(found: Gap) -> dict[str, Any]:
    """Return the gap before and after, over all loads and load by load."""
    return {
        "before": _accuracy(found.before),
        "after": _accuracy(found.after),
        "noise_floor_mm": found.noise_floor_mm,
        "reduction": _paired(found.reduction),
        "per_load": {
            f"{load:g}N": {
                "before": _accuracy(before),
                "after": _accuracy(after),
                "reduction": _paired(found.reduction_by_load[load]),
            }
            for load, (before, after) in found.by_load.items()
        },
    }


def _accuracy(accuracy: Accuracy) -> dict[str, Any]:
    return asdict(accuracy)


def _paired(paired: Paired) -> dict[str, Any]:
    return {
        "mean_mm": paired.mean_mm,
        "interval95_mm": [paired.low_mm, paired.high_mm],
        "poses": paired.poses,
    }
