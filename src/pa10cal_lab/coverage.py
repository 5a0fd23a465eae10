"""The study of coverage: whether 95 % intervals contain the truth of 95 % of simulated campaigns.

The paper's robot, touched, is calibrated with the paper's model. Each other case is an arm under an
instrument, calibrated with the general model, for two kinds of robots: those that deviate only by
parameters of the model show coverage of parameters and of predictions; those that deviate in any
way have no true parameters, and show that of predictions only. The truth is used after estimation
only.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import JsonValue
from scipy.special import ndtri, stdtrit

from pa10cal.arrays import Array
from pa10cal.calibration.general.calibrate import calibrate_general, find_start
from pa10cal.calibration.general.unknowns import ChosenUnknowns, choose_unknowns
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.calibration.paper import parameter_records
from pa10cal.calibration.two_level_fit import calibrate
from pa10cal.files.arms import load_arm
from pa10cal.files.table_cells import csv_text
from pa10cal.observe.kinds import instruments
from pa10cal.observe.observations import Observations, average_repeats, poses_of
from pa10cal.observe.quantities import Start
from pa10cal.results import record
from pa10cal.terms.joint_spring import baseline
from pa10cal_lab.cell.campaign import simulate_campaign
from pa10cal_lab.cell.individual import draw_individual
from pa10cal_lab.cell.options import SimulateOptions, TrackerOptions
from pa10cal_lab.cell.robot import Robot
from pa10cal_lab.cell.write import truth_record
from pa10cal_lab.options import CoverageCaseOptions, CoverageOptions
from pa10cal_lab.simulated import (
    as_read,
    class_of,
    draw_by_unknowns,
    exact_observations,
    measure,
    observations_of,
    parameter_scores,
    payload_of_individual,
    prediction_scores,
    reported_scores,
)

PROVENANCE = "synthetic: virtual cell, no hidden effect"
_PAPERS = "pa10_6ce, touched balls, paper's model"
#: Level of the intervals.
LEVEL = 0.95
#: Number of poses that each calibration predicts.
_PREDICTED_POSES = 40
#: Standard deviation of a target about its design [m], and of its orientation [rad]; neither is
#: stated to the calibration.
_TARGET_M, _TARGET_RAD = 0.05, 1.0
#: Numbers of random streams: robots that deviate by parameters of the model, those that deviate in
#: any way, and poses to predict.
_OWN, _ANY, _OTHER_POSES = 1, 2, 3


# The record of the study.


class ParameterCoverage(record.Part):
    """How often the interval of one parameter holds the truth."""

    inside: float  # share inside the 95 % interval
    rms: float  # root mean square of error over standard uncertainty


class Coverage(ParameterCoverage):
    """How often intervals hold the truth."""

    inside_interval95: tuple[float, float]  # 95 % interval of the share


class PaperCoverage(Coverage):
    """The paper's robot under touched balls, calibrated with the paper's model."""

    campaigns: int  # campaigns simulated
    parameters: Mapping[record.ParameterKey, ParameterCoverage]  # by parameter


class ClassCoverage(Coverage):
    """Coverage of the parameters of one arm under one instrument."""

    # by class of parameters: `angles`, `lengths`, `base`, `tool`, ...
    by_class: Mapping[Annotated[str, record.Key("class")], Coverage]
    by_parameter: Mapping[record.ParameterKey, ParameterCoverage]  # by parameter


class FreeDeparture(record.Part):
    """Arms that depart in any way, which have no true parameters."""

    campaigns: int  # campaigns simulated
    converged: float  # share of fits that converged
    predictions: Coverage  # of predicted positions


class CoverageCase(record.Part):
    """One arm under one instrument."""

    case: str  # the case in words
    robot: str  # name of the arm
    instrument: str  # kind of the instrument
    targets: int  # number of targets
    flexible_joints: tuple[int, ...]  # joints with a spring, from 1
    campaigns: int  # campaigns simulated
    converged: float  # share of fits that converged
    unknowns: int  # parameters fitted
    # parameters not fitted, and those that replace them
    redundant: Mapping[record.ParameterKey, Mapping[record.ParameterKey, float]]
    parameters: ClassCoverage  # of parameters
    predictions: Coverage  # of predicted positions
    departing_in_any_way: FreeDeparture  # arms that depart in any way


@record.filed("pa10cal-coverage/2", "coverage.json", by="coverage")
class CoverageRecord(record.Record):
    """`coverage.json`: how often intervals hold the truth of simulated campaigns."""

    provenance: str  # where the data come from
    settings: Mapping[Annotated[str, record.Key("option")], JsonValue]  # settings of the study
    paper: PaperCoverage  # the paper's model
    cases: tuple[CoverageCase, ...]  # the general model, one entry an arm and instrument


# Shares of scores, and the study.


def coverage(scores: Array) -> Coverage:
    """Return the share of scores (campaigns, parameters) inside their intervals.

    A parameter without an interval in some campaign has nan there. The confidence interval of the
    share treats campaigns as independent, but not the parameters of one campaign.
    """
    shares = np.nanmean(_inside(scores), axis=1)
    count = len(shares)
    half = (
        float(stdtrit(count - 1, 0.975) * shares.std(ddof=1) / np.sqrt(count)) if count > 1 else 1.0
    )
    inside = float(shares.mean())
    return Coverage(
        inside=inside,
        inside_interval95=(max(0.0, inside - half), min(1.0, inside + half)),
        rms=float(np.sqrt(np.nanmean(scores**2))),
    )


def coverage_by_parameter(names: Sequence[str], scores: Array) -> dict[str, ParameterCoverage]:
    """Return the coverage of each parameter by scores (campaigns, parameters)."""
    inside = np.nanmean(_inside(scores), axis=0).tolist()
    rms = np.sqrt(np.nanmean(scores**2, axis=0)).tolist()
    return {name: ParameterCoverage(inside=inside[k], rms=rms[k]) for k, name in enumerate(names)}


def _inside(scores: Array) -> Array:
    """Return 1 where the interval contains the truth, 0 where it does not, nan without one."""
    inside = np.abs(scores) <= ndtri(0.5 + LEVEL / 2.0)
    return np.where(np.isfinite(scores), inside, np.nan)


def coverage_study(
    options: CoverageOptions, calibration: CalibrationOptions, say: Callable[[str], None]
) -> CoverageRecord:
    """Simulate and calibrate all campaigns, and return the coverage of their intervals.

    Args:
        options: number of campaigns, and the cases of the general model.
        calibration: how to calibrate.
        say: called with one line for each case that is finished.

    Raises:
        ArmError: for an arm that is not known.
    """
    for case_options in options.cases:  # an unknown arm is refused before any work
        load_arm(case_options.robot)
    paper = _papers_model(options, calibration)
    say(_line(_PAPERS, {"parameters": paper}))
    cases = []
    for case_options in options.cases:
        case = _general_model(case_options, options, calibration)
        shares = {"parameters": case.parameters, "predictions": case.predictions}
        say(_line(case.case, shares | {"of any arm": case.departing_in_any_way.predictions}))
        cases.append(case)
    return CoverageRecord(
        provenance=PROVENANCE,
        settings=options.model_dump(mode="json"),
        paper=paper,
        cases=tuple(cases),
    )


def coverage_table(study: CoverageRecord) -> str:
    """Return a summary as CSV: one line for each class of parameters of a case."""
    shares: list[tuple[str, str, Coverage]] = [(_PAPERS, "all parameters", study.paper)]
    for case in study.cases:
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
    return csv_text(header, rows)


def _line(title: str, shares: dict[str, Coverage]) -> str:
    shown = (f"{what} {100 * s.inside:.1f} % ({s.rms:.2f})" for what, s in shares.items())
    return f"{title}: {', '.join(shown)} inside (rms score)"


def _papers_model(options: CoverageOptions, calibration: CalibrationOptions) -> PaperCoverage:
    """Score every identifiable parameter of the paper's robot, campaign by campaign."""
    seeds = range(options.random_seed, options.random_seed + options.campaigns)
    scores = [_touched_scores(seed, calibration) for seed in seeds]
    names = [name for name in scores[0] if all(name in row for row in scores)]
    table = np.array([[row[name] for name in names] for row in scores])
    return PaperCoverage(
        campaigns=len(scores),
        parameters=coverage_by_parameter(names, table),
        **dict(coverage(table)),
    )


def _touched_scores(seed: int, options: CalibrationOptions) -> dict[str, float]:
    """Simulate, ingest and calibrate one campaign; score every identifiable parameter."""
    simulate = SimulateOptions(random_seed=seed)
    arm = load_arm(simulate.robot)
    made = simulate_campaign("coverage", arm, simulate)
    readings = poses_of(as_read(made).observations, average=False)
    found = calibrate(
        baseline(arm, options.flexible_joints, options.tolerances),
        average_repeats(readings),
        options,
        readings,
        1e-3 * options.apparatus_uncertainty_mm,
    )
    return reported_scores(parameter_records(found), truth_record(made).parameters)


class _Scores(NamedTuple):
    """Scores of the campaigns of one case."""

    unknowns: ChosenUnknowns  # parameters that were estimated or left out
    names: tuple[str, ...]  # names of all k parameters that were scored
    parameters: Array  # (C, k) scores, nan where one had no interval
    predictions: Array  # (C, m) scores
    converged: NDArray[np.bool_]  # (C,) whether the fit converged


def _general_model(
    case: CoverageCaseOptions, options: CoverageOptions, calibration: CalibrationOptions
) -> CoverageCase:
    """Return the coverage of one case of the general model."""
    targets = f"{case.targets} target{'s' if case.targets > 1 else ''}"
    several = instruments()[case.instrument].several_targets
    title = f"{case.robot}, {targets if several else case.instrument}"
    own, free = (_scores(case, options, calibration, any_way) for any_way in (False, True))
    classes = [class_of(name) for name in own.names]
    return CoverageCase(
        case=title + (", springs" if case.flexible_joints else ""),
        **case.model_dump(mode="json"),
        campaigns=len(own.converged),
        converged=float(own.converged.mean()),
        unknowns=len(own.names),
        redundant={each.name: each.replaced_by for each in own.unknowns.redundant},
        parameters=ClassCoverage(
            **dict(coverage(own.parameters)),
            by_class={
                kind: coverage(own.parameters[:, [each == kind for each in classes]])
                for kind in sorted(set(classes))
            },
            by_parameter=coverage_by_parameter(own.names, own.parameters),
        ),
        predictions=coverage(own.predictions),
        departing_in_any_way=FreeDeparture(
            campaigns=len(free.converged),
            converged=float(free.converged.mean()),
            predictions=coverage(free.predictions),
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
            robot = draw_by_unknowns(arm, plan, unknowns, rng)
        payload = payload_of_individual(robot)
        found = calibrate_general(arm, *_seen(robot, plan, seed), payload, calibration)
        by_name.append(parameter_scores(found, robot))
        others = exact_observations(robot, plan, _PREDICTED_POSES, seed + _OTHER_POSES * 10**6)
        predictions.append(prediction_scores(found, others))
        converged.append(found.fit.converged)
    names = tuple(dict.fromkeys(name for scores in by_name for name in scores))
    scores = [[each.get(name, np.nan) for name in names] for each in by_name]
    return _Scores(
        unknowns, names, np.array(scores), np.array(predictions), np.array(converged, dtype=bool)
    )


def _seen(robot: Robot, plan: TrackerOptions, seed: int) -> tuple[Observations, Start]:
    """Measure a robot; return the observations and the start of their calibration."""
    seen = observations_of(measure(robot, plan, seed))
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
