"""`discovery/analysis.json` of a search by blocks of poses left out: all that its figures show."""

from __future__ import annotations

from typing import Any

from pa10cal.calibration.base_parameters import report_base
from pa10cal.discovery.blocked_cv.discover import BlockedDiscovery
from pa10cal.discovery.blocked_cv.gaps import PartedGap
from pa10cal.discovery.blocked_cv.lack import lack_of_fit
from pa10cal.discovery.operating_point import OperatingPoint
from pa10cal.stages.blocked_cv_record import parameters_of
from pa10cal.stages.lack_of_fit_record import lack_of_fit_record
from pa10cal.stages.naming_record import naming_record
from pa10cal.stages.verdict_record import name_of


def blocked_analysis(found: BlockedDiscovery) -> dict[str, Any]:
    """Return all that the figures of discovery show."""
    survey, extended = found.survey, found.extended
    baseline = survey.baseline
    fits = {
        "before": OperatingPoint(baseline.model, baseline.x, baseline.T_instr_base),
        "after": OperatingPoint(extended.model, extended.x, extended.T_instr_base),
    }
    rows = 6 * len(survey.poses)
    return {
        **{
            when: lack_of_fit_record(lack_of_fit(survey, place, found.noise))
            for when, place in fits.items()
        },
        "steps": [
            {
                "effects": [name_of(member.effect) for member in step.members],
                "left_of_a_row": float(step.squares.sum()) / rows,
            }
            for step in found.steps
        ],
        "naming": naming_record(found.named),
        "parameter_shifts": _shifts(found),
        "gap": {
            "train": _rows(found, found.train),
            "holdout": None if found.holdout is None else _rows(found, found.holdout),
        },
        "noise_floor_mm": found.noise.floor_mm,
    }


def _shifts(found: BlockedDiscovery) -> list[dict[str, Any]]:
    """Return every parameter of the calibrated model, and once the effects joined it."""
    baseline = found.survey.baseline
    reports = (baseline.model.report(baseline.x), report_base(baseline.T_instr_base))
    before = {
        parameter.name: float(value)
        for report in reports
        for parameter, value in zip(report.parameters, report.values, strict=True)
    }
    return [
        {
            "name": name,
            "unit": entry["unit"],
            "before": before[name],
            "after": entry["value"],
            "std": entry["std"],
            "tolerance": entry["tolerance"],
            "identifiable": entry["identifiable"],
        }
        for name, entry in parameters_of(found).items()
    ]


def _rows(found: BlockedDiscovery, gap: PartedGap) -> list[dict[str, Any]]:
    """Return every configuration with its errors before and after, along base axes."""
    T_instr_base, poses = found.survey.baseline.T_instr_base, gap.whole.poses
    p_base_mm = (
        1e3 * (poses.measured.T_instr_target[:, :3, 3] - T_instr_base[:3, 3]) @ T_instr_base[:3, :3]
    )
    before_mm, after_mm = (
        found_.position_mm for found_ in (gap.whole.found_before, gap.whole.found_after)
    )
    return [
        {
            "pose": str(poses.pose[k]),
            "load_N": float(poses.states.load_N[k]),
            "place_mm": p_base_mm[k].tolist(),
            "before_mm": before_mm[k].tolist(),
            "after_mm": after_mm[k].tolist(),
            "extrapolated": not gap.inside[k],
        }
        for k in range(len(poses))
    ]
