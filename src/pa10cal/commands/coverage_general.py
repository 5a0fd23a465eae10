"""Command `coverage_general`.

Each case is an arm under an instrument, twice over. Arms that depart by the model's own parameters
show whether parameters lie in their intervals, and predictions in theirs; arms that depart in any
way have no true parameters, and show it by predictions alone. The truth is read here, after the
estimate is made, and nowhere else.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pa10cal.calibration.options import CalibrationOptions
from pa10cal.evaluation.options import CoverageOptions

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from pa10cal.arm.description import Arm
    from pa10cal.calibration.general.calibrate import GeneralCalibration
    from pa10cal.calibration.general.unknowns import Unknowns
    from pa10cal.cell.options import TrackerOptions
    from pa10cal.cell.robot import Robot
    from pa10cal.evaluation.coverage import Coverage
    from pa10cal.evaluation.options import CoverageCase

#: Poses in which each calibration has to predict.
_PREDICTED_POSES = 40
#: Targets sit about their design by so much, and in any attitude; nothing states where.
_TARGET_M, _TARGET_RAD = 0.05, 1.0
#: Streams of random numbers, apart for what they draw.
_OWN, _ANY, _OTHER_POSES = 1, 2, 3


def coverage_general(
    *,
    out: Path,
    table: Path,
    settings: CoverageOptions = CoverageOptions(),
    calibration: CalibrationOptions = CalibrationOptions(),
) -> None:
    """Count the same with the general model, arm by arm and instrument by instrument.

    Args:
        out: record to write (.json).
        table: a summary of it to write (.csv).
        settings: section coverage.
        calibration: section calibration.
    """
    import csv

    from pa10cal.files.output import whole_file, write_json
    from pa10cal.files.schemas import COVERAGE_GENERAL

    options = calibration
    records = [_record(case, settings, options) for case in settings.cases]
    write_json(
        out,
        {
            "schema": COVERAGE_GENERAL,
            "provenance": "synthetic: virtual cell, no hidden effect",
            "settings": settings.model_dump(mode="json"),
            "cases": records,
        },
    )
    with whole_file(table) as path, path.open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(("case", "of", "inside_percent", "from_percent", "to_percent", "rms_score"))
        rows.writerows(row for record in records for row in _rows(record))


@dataclass(frozen=True)
class _Study:
    """Scores of the campaigns of one case.

    Attributes:
        unknowns: parameters sought and left out, and names of all that were scored.
        parameters: (C, k) scores, nan where one had no interval.
        predictions: (C, m) scores.
        converged: (C,) whether the fits ended where they should.
    """

    unknowns: Unknowns
    names: tuple[str, ...]
    parameters: NDArray[np.float64]
    predictions: NDArray[np.float64]
    converged: NDArray[np.bool_]


def _record(
    case: CoverageCase, settings: CoverageOptions, options: CalibrationOptions
) -> dict[str, Any]:
    """Work out one case: the record of it."""
    from pa10cal.evaluation.coverage import coverage
    from pa10cal.evaluation.known_truth import class_of

    targets = f"{case.targets} target{'s' if case.targets > 1 else ''}"
    title = f"{case.robot}, {targets if case.instrument == 'points' else case.instrument}"
    own, free = (_study(case, settings, options, any_way) for any_way in (False, True))
    found = coverage(own.parameters)
    classes = [class_of(name) for name in own.names]
    record = {
        "case": title + (", springs" if case.flexible_joints else ""),
        **case.model_dump(mode="json"),
        "campaigns": len(own.converged),
        "converged": float(own.converged.mean()),
        "unknowns": len(own.names),
        "redundant": {each.name: each.said_by for each in own.unknowns.redundant},
        "parameters": {
            **_summary(found),
            "by_class": {
                kind: _summary(coverage(own.parameters[:, [each == kind for each in classes]]))
                for kind in sorted(set(classes))
            },
            "by_parameter": {
                name: {"inside": float(inside), "rms": float(rms)}
                for name, inside, rms in zip(
                    own.names, found.by_parameter, found.rms_by_parameter, strict=True
                )
            },
        },
        "predictions": _summary(coverage(own.predictions)),
        "departing_in_any_way": {
            "campaigns": len(free.converged),
            "converged": float(free.converged.mean()),
            "predictions": _summary(coverage(free.predictions)),
        },
    }
    shares = (found, coverage(own.predictions), coverage(free.predictions))
    print(
        f"{record['case']}: "
        + ", ".join(
            f"{what} {100 * share.inside:.1f} % ({share.rms:.2f})"
            for what, share in zip(("parameters", "predictions", "of any arm"), shares, strict=True)
        )
        + " inside (rms score)",
        flush=True,
    )
    return record


def _summary(found: Coverage) -> dict[str, Any]:
    return {
        "inside": found.inside,
        "inside_interval95": [found.inside_low, found.inside_high],
        "rms": found.rms,
    }


def _rows(record: dict[str, Any]) -> list[tuple[str, ...]]:
    """Return the lines of the table that one case has."""
    shares = {
        "all parameters": record["parameters"],
        **record["parameters"]["by_class"],
        "predictions": record["predictions"],
        "predictions, arm departing in any way": record["departing_in_any_way"]["predictions"],
    }
    return [
        (
            record["case"],
            of,
            *(f"{100 * x:.1f}" for x in (share["inside"], *share["inside_interval95"])),
            f"{share['rms']:.3f}",
        )
        for of, share in shares.items()
    ]


def _study(
    case: CoverageCase,
    settings: CoverageOptions,
    options: CalibrationOptions,
    any_way: bool,
) -> _Study:
    """Simulate and calibrate the campaigns of a case; score parameters and predictions."""

    import numpy as np

    from pa10cal.cell.individual import draw_individual
    from pa10cal.evaluation.known_truth import parameter_scores, prediction_scores
    from pa10cal.files.arms import load_arm
    from pa10cal.stages.simulated_observations import (
        draw_by_unknowns,
        exact_observations,
        truth_of,
    )

    arm, plan = load_arm(case.robot), _plan(case, settings)
    options = options.with_springs(case.flexible_joints)
    unknowns = _unknowns(arm, plan, options, settings.random_seed)
    by_name: list[dict[str, float]] = []
    predictions, converged = [], []
    for seed in range(settings.random_seed, settings.random_seed + settings.general_campaigns):
        rng = np.random.default_rng([seed, _ANY if any_way else _OWN])
        if any_way:
            individual = draw_individual(arm, plan, rng)
            truth = truth_of(individual, {})
        else:
            individual, truth = draw_by_unknowns(arm, plan, unknowns, rng)
        found = _calibrated(arm, individual, plan, options, seed)
        by_name.append(parameter_scores(found, truth))
        others = exact_observations(individual, plan, _PREDICTED_POSES, seed + _OTHER_POSES * 10**6)
        predictions.append(prediction_scores(found, others))
        converged.append(found.fit.converged)
    names = tuple(dict.fromkeys(name for scores in by_name for name in scores))
    scores = [[each.get(name, np.nan) for name in names] for each in by_name]
    return _Study(
        unknowns, names, np.array(scores), np.array(predictions), np.array(converged, dtype=bool)
    )


def _unknowns(arm: Arm, plan: TrackerOptions, options: CalibrationOptions, seed: int) -> Unknowns:
    """Return what arm and instrument can tell, which is the same in every campaign."""
    import numpy as np

    from pa10cal.calibration.general.start import find_start
    from pa10cal.calibration.general.unknowns import choose_unknowns
    from pa10cal.cell.individual import draw_individual
    from pa10cal.stages.simulated_observations import measured, observations_of

    individual = draw_individual(arm, plan, np.random.default_rng(seed))
    seen = observations_of(measured(individual, plan, seed))
    start = find_start(arm, seen)
    return choose_unknowns(
        arm, options.tolerances, seen.measured, start.T_instr_base, start.targets_m
    )


def _plan(case: CoverageCase, settings: CoverageOptions) -> TrackerOptions:
    from pa10cal.cell.options import TrackerOptions

    return TrackerOptions(
        instrument=case.instrument,
        poses=settings.poses,
        holdout_share=0.0,
        flexible_joints=case.flexible_joints,
        hardening=False,
        targets=case.targets,
        states_targets=False,
        target_m=_TARGET_M,
        target_rad=_TARGET_RAD,
        position_mm=settings.position_mm,
        attitude_rad=settings.attitude_rad,
    )


def _calibrated(
    arm: Arm, individual: Robot, plan: TrackerOptions, options: CalibrationOptions, seed: int
) -> GeneralCalibration:
    """Measure an individual and calibrate it."""
    from pa10cal.calibration.general.calibrate import calibrate_general
    from pa10cal.calibration.general.start import find_start
    from pa10cal.stages.simulated_observations import (
        measured,
        observations_of,
        payload_of_individual,
    )

    seen = observations_of(measured(individual, plan, seed))
    payload = payload_of_individual(individual)
    return calibrate_general(arm, seen, find_start(arm, seen), payload, options)
