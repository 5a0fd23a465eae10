"""Do 95 % intervals hold the truth of simulated campaigns in 95 % of cases?

The paper's robot, touched, is calibrated with the paper's model. Each other case is an arm under an
instrument, calibrated with the general model, twice over: arms that depart by the model's own
parameters show whether parameters lie in their intervals, and predictions in theirs; arms that
depart in any way have no true parameters, and show it by predictions alone. The truth is looked at
after the estimate is made, and nowhere else.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.calibration.calibrate import calibrate
from pa10cal.calibration.general.calibrate import calibrate_general, find_start
from pa10cal.calibration.general.problem import Unknowns, choose_unknowns
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.calibration.paper import parameter_records
from pa10cal.evaluation.options import CoverageCaseOptions, CoverageOptions
from pa10cal.files.arms import load_arm
from pa10cal.lab import simulated
from pa10cal.lab.cell.campaign import simulate_campaign
from pa10cal.lab.cell.individual import draw_individual
from pa10cal.lab.cell.options import SimulateOptions, TrackerOptions
from pa10cal.lab.cell.robot import Robot
from pa10cal.lab.cell.write import truth_record
from pa10cal.observe.kinds import instruments
from pa10cal.observe.observations import Observations, average_repeats, poses_of
from pa10cal.observe.quantities import Start
from pa10cal.results import studies as results
from pa10cal.terms.joint_spring import baseline

PROVENANCE = "synthetic: virtual cell, no hidden effect"
#: Poses in which each calibration has to predict.
_PREDICTED_POSES = 40
#: Targets sit about their design by so much, and in any orientation; nothing states where.
_TARGET_M, _TARGET_RAD = 0.05, 1.0
#: Streams of random numbers, apart for what they draw.
_OWN, _ANY, _OTHER_POSES = 1, 2, 3


def coverage_study(
    options: CoverageOptions, calibration: CalibrationOptions, say: Callable[[str], None]
) -> results.CoverageRecord:
    """Simulate and calibrate all campaigns, and count what their intervals hold.

    Args:
        options: how many campaigns, and the cases of the general model.
        calibration: how to calibrate.
        say: takes one line for each case that is done.

    Raises:
        ArmError: for an arm that is not known.
    """
    for case in options.cases:  # a name that does not exist is refused before any work
        load_arm(case.robot)
    paper = _papers_model(options, calibration)
    say(_line("pa10_6ce, touched balls, paper's model", {"parameters": paper}))
    cases = []
    for case in options.cases:
        cases.append(_general_model(case, options, calibration))
        say(
            _line(
                cases[-1].case,
                {
                    "parameters": cases[-1].parameters,
                    "predictions": cases[-1].predictions,
                    "of any arm": cases[-1].departing_in_any_way.predictions,
                },
            )
        )
    return results.CoverageRecord(
        provenance=PROVENANCE,
        settings=options.model_dump(mode="json"),
        paper=paper,
        cases=tuple(cases),
    )


def coverage_table(record: results.CoverageRecord) -> str:
    """Return the same in brief, as CSV: one line for each class of parameters of a case."""
    shares: list[tuple[str, str, results.Coverage]] = [
        ("pa10_6ce, touched balls, paper's model", "all parameters", record.paper)
    ]
    for case in record.cases:
        free = case.departing_in_any_way.predictions
        shares += [
            (case.case, "all parameters", case.parameters),
            *((case.case, kind, share) for kind, share in case.parameters.by_class.items()),
            (case.case, "predictions", case.predictions),
            (case.case, "predictions, arm departing in any way", free),
        ]
    rows = [
        (title, of, *(f"{100 * x:.1f}" for x in (s.inside, *s.inside_interval95)), f"{s.rms:.3f}")
        for title, of, s in shares
    ]
    header = ["case", "of", "inside_percent", "from_percent", "to_percent", "rms_score"]
    text: str = pd.DataFrame(rows, columns=header).to_csv(index=False, lineterminator="\n")
    return text


def _line(title: str, shares: dict[str, results.Coverage]) -> str:
    shown = (f"{what} {100 * s.inside:.1f} % ({s.rms:.2f})" for what, s in shares.items())
    return f"{title}: {', '.join(shown)} inside (rms score)"


def _papers_model(
    options: CoverageOptions, calibration: CalibrationOptions
) -> results.PaperCoverage:
    """Score every identifiable parameter of the paper's robot, campaign by campaign."""
    seeds = range(options.random_seed, options.random_seed + options.campaigns)
    scores = [_touched_scores(SimulateOptions(random_seed=seed), calibration) for seed in seeds]
    names = [name for name in scores[0] if all(name in row for row in scores)]
    table = np.array([[row[name] for name in names] for row in scores])
    return results.PaperCoverage(
        campaigns=len(scores),
        parameters=simulated.coverage_by_parameter(names, table),
        **dict(simulated.coverage(table)),
    )


def _touched_scores(simulate: SimulateOptions, options: CalibrationOptions) -> dict[str, float]:
    """Simulate, ingest and calibrate one campaign; score every identifiable parameter."""
    arm = load_arm(simulate.robot)
    made = simulate_campaign("coverage", arm, simulate, "text_e7")
    readings = poses_of(simulated.as_read(made).observations, average=False)
    found = calibrate(
        baseline(arm, options.flexible_joints, options.tolerances),
        average_repeats(readings),
        options,
        readings,
        1e-3 * options.apparatus_uncertainty_mm,
    )
    return simulated.reported_scores(parameter_records(found), truth_record(made).parameters)


@dataclass(frozen=True)
class _Scores:
    """Scores of the campaigns of one case."""

    unknowns: Unknowns  # parameters sought and left out, and names of all that were scored
    names: tuple[str, ...]
    parameters: Array  # (C, k) scores, nan where one had no interval
    predictions: Array  # (C, m) scores
    converged: NDArray[np.bool_]  # (C,) whether the fits ended where they should


def _general_model(
    case: CoverageCaseOptions, options: CoverageOptions, calibration: CalibrationOptions
) -> results.CoverageCase:
    """Compute one case of the general model."""
    targets = f"{case.targets} target{'s' if case.targets > 1 else ''}"
    several = instruments()[case.instrument].several_targets
    title = f"{case.robot}, {targets if several else case.instrument}"
    own, free = (_scores(case, options, calibration, any_way) for any_way in (False, True))
    classes = [simulated.class_of(name) for name in own.names]
    return results.CoverageCase(
        case=title + (", springs" if case.flexible_joints else ""),
        **case.model_dump(mode="json"),
        campaigns=len(own.converged),
        converged=float(own.converged.mean()),
        unknowns=len(own.names),
        redundant={each.name: each.replaced_by for each in own.unknowns.redundant},
        parameters=results.ClassCoverage(
            **dict(simulated.coverage(own.parameters)),
            by_class={
                kind: simulated.coverage(own.parameters[:, [each == kind for each in classes]])
                for kind in sorted(set(classes))
            },
            by_parameter=simulated.coverage_by_parameter(own.names, own.parameters),
        ),
        predictions=simulated.coverage(own.predictions),
        departing_in_any_way=results.FreeDeparture(
            campaigns=len(free.converged),
            converged=float(free.converged.mean()),
            predictions=simulated.coverage(free.predictions),
        ),
    )


def _scores(
    case: CoverageCaseOptions,
    options: CoverageOptions,
    calibration: CalibrationOptions,
    any_way: bool,
) -> _Scores:
    """Simulate and calibrate the campaigns of a case; score parameters and predictions."""
    arm, plan = load_arm(case.robot), _plan(case, options)
    calibration = calibration.with_springs(case.flexible_joints)
    # What arm and instrument can identify is the same in every campaign.
    any_robot = draw_individual(arm, plan, np.random.default_rng(options.random_seed))
    seen, start = _seen(any_robot, plan, options.random_seed)
    unknowns = choose_unknowns(arm, calibration.tolerances, seen.measured, start)
    by_name: list[dict[str, float]] = []
    predictions, converged = [], []
    for seed in range(options.random_seed, options.random_seed + options.general_campaigns):
        rng = np.random.default_rng([seed, _ANY if any_way else _OWN])
        if any_way:
            robot = draw_individual(arm, plan, rng)
        else:
            robot = simulated.draw_by_unknowns(arm, plan, unknowns, rng)
        payload = simulated.payload_of_individual(robot)
        found = calibrate_general(arm, *_seen(robot, plan, seed), payload, calibration)
        by_name.append(simulated.parameter_scores(found, robot))
        others = simulated.exact_observations(
            robot, plan, _PREDICTED_POSES, seed + _OTHER_POSES * 10**6
        )
        predictions.append(simulated.prediction_scores(found, others))
        converged.append(found.fit.converged)
    names = tuple(dict.fromkeys(name for scores in by_name for name in scores))
    scores = [[each.get(name, np.nan) for name in names] for each in by_name]
    return _Scores(
        unknowns, names, np.array(scores), np.array(predictions), np.array(converged, dtype=bool)
    )


def _seen(robot: Robot, plan: TrackerOptions, seed: int) -> tuple[Observations, Start]:
    """Measure a robot, and return what a calibration starts from."""
    seen = simulated.observations_of(simulated.measure(robot, plan, seed))
    return seen, find_start(robot.arm, seen)


def _plan(case: CoverageCaseOptions, options: CoverageOptions) -> TrackerOptions:
    return TrackerOptions(
        instrument=case.instrument,
        poses=options.poses,
        holdout_share=0.0,
        flexible_joints=case.flexible_joints,
        hardening=False,
        targets=case.targets,
        states_targets=False,
        target_m=_TARGET_M,
        target_rad=_TARGET_RAD,
        position_mm=options.position_mm,
        attitude_rad=options.attitude_rad,
    )
