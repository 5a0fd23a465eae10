"""What a search by blocks of poses left out comes to, as the JSON records of discovery."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pa10cal.calibration.accuracy import Accuracy
from pa10cal.calibration.base_parameters import report_base
from pa10cal.discovery.blocked_cv.discover import BlockedDiscovery
from pa10cal.discovery.blocked_cv.gaps import PartedGap
from pa10cal.discovery.blocked_cv.judge import Prediction
from pa10cal.discovery.blocked_cv.noise import NEARLY_SAME
from pa10cal.discovery.blocked_cv.search import LEAST_SHARE, STANDARD_ERRORS
from pa10cal.discovery.blocked_cv.survey import BLOCKS
from pa10cal.discovery.operating_point import possible_sizes
from pa10cal.discovery.verdict import Finding
from pa10cal.errors import RecordError
from pa10cal.fit.angles_seen import AnglesSeen
from pa10cal.stages.extended_record import form_record, records_of, surroundings_record
from pa10cal.stages.verdict_record import gap_record, name_of, unexplained_record

Array = NDArray[np.float64]

METHOD = "blocks of poses left out"
#: A parameter known no better than this part of what is possible is not told by the data.
_TOLD = 1.0 / 3.0


def blocked_verdict(found: BlockedDiscovery, error_rate: float) -> dict[str, Any]:
    """Return the verdict as the results' contract has it, without the suggested poses."""
    return {
        "verdict": found.verdict,
        "method": METHOD,
        "effects": [_effect(finding) for finding in found.findings],
        "unexplained": unexplained_record(found.findings, found.unexplained),
        "not_testable": [
            {**name_of(entry.effect), "why": entry.why}
            for entry in found.not_testable
            if not entry.effect.generic
        ],
        "not_told_apart": [],
        "gap": {
            "noise_floor_mm": found.noise.floor_mm,
            "noise_floor_from": _floor_from(found),
            "train": _parted(found.train),
            "holdout": None if found.holdout is None else _parted(found.holdout),
        },
        "left_over": {
            **asdict(found.remaining),
            "over_floor": found.remaining.over_floor,
            "tried": [
                {
                    **name_of(entry.effect),
                    "gain": entry.gain,
                    "gain_std": entry.gain_std,
                    "helps": entry.helps,
                    "positions_and_attitudes_agree": entry.kinds_agree,
                }
                for entry in found.tried
            ],
        },
        "search": {
            "candidates": found.candidates,
            "error_rate": error_rate,
            "blocks": BLOCKS,
            "needed": {
                "standard_errors": STANDARD_ERRORS,
                "sum_of_squares": found.least_gain,
                "part_of_what_is_left_over_noise": LEAST_SHARE,
            },
            "poses_weighing_less": int(np.sum(found.extended.weighing.weight < 1.0)),
            "refit_converged": found.extended.converged,
        },
        "angles_seen": angles_record(found.seen),
    }


def blocked_extended(found: BlockedDiscovery) -> dict[str, Any]:
    """Return the extended model: parameters with uncertainties, effects, and what restores it."""
    extended, survey = found.extended, found.survey
    own = len(survey.baseline.x)
    return {
        "effects": [
            {
                **name_of(effect),
                "form": form_record(effect),
                "x": extended.x[extended.columns_of(effect)].tolist(),
            }
            for effect in extended.effects
        ],
        "parameters": parameters_of(found),
        "x": extended.x[:own].tolist(),
        "T_instr_base": extended.T_instr_base.tolist(),
        "targets_off_m": [0.0] * survey.poses.measured.by_apparatus.shape[2],
        "baseline": {
            "x": survey.baseline.x.tolist(),
            "T_instr_base": survey.baseline.T_instr_base.tolist(),
        },
        "context": surroundings_record(survey.context),
        "angles_seen": angles_record(found.seen),
    }


def angles_record(seen: AnglesSeen) -> list[dict[str, Any]]:
    """Return the stretches that each joint's poses have seen [rad; m of a sliding joint]."""
    return [
        {"turns": turns, "stretches": stretches.tolist()}
        for stretches, turns in zip(seen.intervals, seen.turns, strict=True)
    ]


def read_angles(record: dict[str, Any], where: str) -> AnglesSeen | None:
    """Return the angles that a model's poses have seen; None where the record has none.

    Raises:
        RecordError: when they are not what `angles_record` wrote.
    """
    if record.get("angles_seen") is None:
        return None
    try:
        return AnglesSeen(
            tuple(
                np.array(joint["stretches"], dtype=float).reshape(-1, 2)
                for joint in record["angles_seen"]
            ),
            tuple(bool(joint["turns"]) for joint in record["angles_seen"]),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise RecordError(
            "the angles seen cannot be read",
            where=where,
            value=str(error),
            allowed="for each joint whether it turns, and stretches of two numbers",
            remedy="run the discover stage again",
        ) from None


def _effect(finding: Finding[Prediction]) -> dict[str, Any]:
    effect, proof = finding.effect, finding.proof
    known = effect.report(np.zeros(len(effect.parameters))).parameters
    std = np.sqrt(np.diag(finding.covariance))
    return {
        **name_of(effect),
        "form": form_record(effect),
        "parameters": {
            parameter.name: {"value": float(value), "std": float(sigma), "unit": parameter.unit}
            for parameter, value, sigma in zip(known, finding.x, std, strict=True)
        },
        "alternatives": [name_of(other) for other in finding.alternatives],
        "evidence": {"blocks_left_out": {**asdict(proof), "z": proof.z}},
    }


def _floor_from(found: BlockedDiscovery) -> str:
    if found.noise.pairs:
        return (
            f"{found.noise.pairs} pairs of poses closer than {1e3 * NEARLY_SAME:g} mrad in every "
            "joint"
        )
    return "the instrument's stated uncertainty: hardly any pose is repeated"


def _parted(found: PartedGap) -> dict[str, Any]:
    """Return a gap with what holds inside the angles seen in the fit, and beyond them."""
    return {
        **gap_record(found.whole),
        "inside": _pair(found.before_inside, found.after_inside),
        "extrapolated": _pair(found.before_beyond, found.after_beyond),
    }


def _pair(before: Accuracy | None, after: Accuracy | None) -> dict[str, Any] | None:
    if before is None or after is None:
        return None
    return {"before": before.model_dump(), "after": after.model_dump()}


def parameters_of(found: BlockedDiscovery) -> dict[str, dict[str, Any]]:
    """Return every parameter of the calibrated model as it is with the effects, and the base."""
    extended, baseline = found.extended, found.survey.baseline
    own = len(baseline.x)
    covariance = extended.covariance
    report = baseline.model.report(extended.x[:own])
    std = np.sqrt(np.diag(covariance)[:own])
    told = std < _TOLD * possible_sizes(baseline.model)
    records = records_of(report, covariance[:own, :own])
    for name, row in zip(records, report.jacobian != 0.0, strict=True):
        records[name]["identifiable"] = bool(np.all(told[row]))
    base = records_of(report_base(extended.T_instr_base), _of_base(found))
    for record in base.values():
        record["identifiable"] = True
    return records | base


def _of_base(found: BlockedDiscovery) -> Array:
    """Return the covariance of the base frame: origin along the instrument's axes, small turns."""
    along = np.eye(6)
    along[:3, :3] = found.survey.baseline.T_instr_base[:3, :3]
    covariance: Array = along @ found.extended.covariance[-6:, -6:] @ along.T
    return covariance
