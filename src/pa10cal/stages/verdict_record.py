"""`discovery/verdict.json`: what is missing from the model, and what became of the gap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from pa10cal.calibration.accuracy import Accuracy
from pa10cal.discovery.discover import Discovery
from pa10cal.discovery.evidence.confirm import Confirmation, LeftOut
from pa10cal.discovery.evidence.judge import FLIP_RATE, shared_error_mm
from pa10cal.discovery.evidence.search import threshold
from pa10cal.discovery.gap import Gap, Paired
from pa10cal.discovery.verdict import Finding, Unexplained, without_a_cause
from pa10cal.terms.effects.effect import Effect


def verdict_record(found: Discovery, error_rate: float) -> dict[str, Any]:
    """Return the verdict as the results' contract has it, without the suggested poses."""
    judgement = found.judgement
    needed = threshold(len(found.family), error_rate)
    return {
        "verdict": judgement.verdict,
        "effects": [_effect(finding, needed) for finding in judgement.findings],
        "unexplained": unexplained_record(judgement.findings, judgement.unexplained),
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


def _effect(finding: Finding[Confirmation], needed: float) -> dict[str, Any]:
    known = finding.effect.report(np.zeros(len(finding.effect.parameters))).parameters
    std = np.sqrt(np.diag(finding.covariance))
    confirmation = finding.proof
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


def unexplained_record(
    findings: Sequence[Finding[object]], unexplained: Sequence[Unexplained]
) -> dict[str, Any] | None:
    """Return where something without a name sits: the largest first, all of them in a list."""
    places = [
        {
            "of": entry.of,
            "form": entry.form,
            "shared_error_mm": entry.error_mm,
            "why": entry.why,
        }
        for entry in without_a_cause(findings, unexplained)
    ]
    return {**places[0], "all": places} if places else None


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
    return accuracy.model_dump()


def _paired(paired: Paired) -> dict[str, Any]:
    return {
        "mean_mm": paired.mean_mm,
        "interval95_mm": [paired.low_mm, paired.high_mm],
        "poses": paired.poses,
    }
