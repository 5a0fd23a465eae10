"""`discovery/analysis.json`: all that the discovery figures show."""

from __future__ import annotations

from typing import Any

from pa10cal.calibration.base_parameters import report_base
from pa10cal.discovery.discover import Discovery
from pa10cal.discovery.gap import Gap
from pa10cal.discovery.lack_of_fit import lack_of_fit
from pa10cal.discovery.naming import errors_by_name
from pa10cal.stages.extended_record import parameter_records
from pa10cal.stages.lack_of_fit_record import lack_of_fit_record
from pa10cal.stages.naming_record import naming_record
from pa10cal.stages.verdict_record import name_of


def analysis_record(found: Discovery) -> dict[str, Any]:
    """Return what is left before and after, step by step, and what had been bent."""
    problem, steps = found.problem, found.judgement.found.steps
    return {
        "before": lack_of_fit_record(lack_of_fit(problem, found.start)),
        "after": lack_of_fit_record(lack_of_fit(problem, found.extended)),
        "steps": [
            {
                "effects": [name_of(effect) for effect in step.effects],
                "gain_nats": step.gain,
                "rms_mm": step.rms_mm,
            }
            for step in steps
        ],
        "naming": naming_record(
            errors_by_name(problem, found.extended, found.train, found.holdout)
        ),
        "parameter_shifts": _shifts(found),
        "gap": {
            "train": _rows(found, found.train),
            "holdout": None if found.holdout is None else _rows(found, found.holdout),
        },
        "noise_floor_mm": found.noise_floor_mm,
    }


def _shifts(found: Discovery) -> list[dict[str, Any]]:
    """Return every parameter of the calibrated model, and once the effects joined it."""
    baseline = found.problem.baseline
    reports = (baseline.model.report(baseline.x), report_base(baseline.T_instr_base))
    before = {
        parameter.name: float(value)
        for report in reports
        for parameter, value in zip(report.parameters, report.values, strict=True)
    }
    after = parameter_records(found, found.extended)
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
        for name, entry in after.items()
    ]


def _rows(found: Discovery, gap: Gap) -> list[dict[str, Any]]:
    """Return every averaged configuration with its errors before and after, base axes."""
    T_instr_base = found.problem.baseline.T_instr_base
    p_base_mm = (
        1e3
        * (gap.poses.measured.T_instr_target[:, :3, 3] - T_instr_base[:3, 3])
        @ T_instr_base[:3, :3]
    )
    return [
        {
            "pose": str(gap.poses.pose[k]),
            "load_N": float(gap.poses.states.load_N[k]),
            "place_mm": p_base_mm[k].tolist(),
            "before_mm": gap.found_before.position_mm[k].tolist(),
            "after_mm": gap.found_after.position_mm[k].tolist(),
        }
        for k in range(len(gap.poses))
    ]
