"""The study of coverage: whether 95 % intervals contain the truth of 95 % of simulated campaigns.

The paper's robot, touched, is calibrated with the paper's model. Each other case is an arm under an
instrument, calibrated with the general model, for two kinds of robots: those that depart only by
parameters of the model show coverage of parameters and of predictions; those that depart in any way
have no true parameters, and show that of predictions only. The truth is used after estimation
only.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import JsonValue
from scipy.special import betaincinv, ndtri, stdtrit

from pa10cal.arm.description import Arm
from pa10cal.arrays import Array
from pa10cal.calibration.general.calibrate import (
    GeneralCalibration,
    calibrate_general,
    find_start,
)
from pa10cal.calibration.general.unknowns import ChosenUnknowns, choose_unknowns
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.calibration.paper import parameter_records
from pa10cal.calibration.two_level_fit import calibrate
from pa10cal.errors import CalibrationError
from pa10cal.files.arms import load_arm
from pa10cal.files.table_cells import csv_text
from pa10cal.observe.kinds import sees_several
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
#: Random streams of a campaign's seed: of robots that depart by parameters of the model, and of
#: those that depart in any way.
_BY_PARAMETERS, _IN_ANY_WAY = 1, 2
#: Added to the seed of a campaign for that of the poses to predict.
_OTHER_POSES = 3 * 10**6
#: Difference of the shares of campaigns below which these count as equal.
_EQUAL_SHARES = 1e-9


# The record of the study.


class ParameterCoverage(record.Part):
    """How often the interval of one parameter holds the truth."""

    inside: float  # share inside the 95 % interval
    rms: float  # root mean square of error over standard uncertainty


class Coverage(ParameterCoverage):
    """How often intervals hold the truth, of all fits, those that did not converge among them."""

    inside: float  # mean over campaigns of the share inside the 95 % interval
    # root mean square of error over standard uncertainty, of all outcomes of all campaigns
    rms: float
    inside_interval95: tuple[float, float]  # 95 % interval of the share
    counted: int  # campaigns that count: those in which something had an interval


class PaperCoverage(Coverage):
    """The paper's robot under touched balls, calibrated with the paper's model."""

    campaigns: int  # campaigns simulated
    # share of fits that converged; not given in earlier files
    converged: float | None = record.optional()
    parameters: Mapping[record.ParameterKey, ParameterCoverage]  # by parameter


class ClassCoverage(Coverage):
    """Coverage of the parameters of one arm under one instrument."""

    # by class of parameters: `angles`, `lengths`, `base`, `tool`, ...
    by_class: Mapping[Annotated[str, record.Key("class")], Coverage]
    # by parameter, in the form in which it was solved: of springs `windup_2`
    by_parameter: Mapping[record.ParameterKey, ParameterCoverage]


class DepartureInAnyWay(record.Part):
    """Arms that depart in any way, which have no true parameters."""

    campaigns: int  # campaigns simulated
    converged: float  # share of fits that converged
    # of predicted components of poses: of positions and orientations, or distances
    predictions: Coverage


class CoverageCase(record.Part):
    """One arm under one instrument."""

    case: str  # the case in words
    robot: str  # name of the arm
    instrument: str  # kind of the instrument
    targets: int  # number of targets
    flexible_joints: tuple[int, ...]  # joints with a spring, from 1
    campaigns: int  # campaigns simulated
    converged: float  # share of fits that converged
    unknowns: int  # parameters fitted; where campaigns differ, the most
    # parameters not fitted, and those that replace them in the robot drawn for trial
    redundant: Mapping[record.ParameterKey, Mapping[record.ParameterKey, float]]
    parameters: ClassCoverage  # of parameters
    # of predicted components of poses: of positions and orientations, or distances
    predictions: Coverage
    departing_in_any_way: DepartureInAnyWay  # arms that depart in any way


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

    A parameter without an interval in some campaign has no finite score there. Campaigns in which
    nothing has one do not count. The others count alike in the share, by whose scatter between
    campaigns its interval is; in the rms all scores do.

    Raises:
        CalibrationError: when nothing has an interval in any campaign.
    """
    scores = _with_intervals(scores)
    scores = scores[np.isfinite(scores).any(axis=1)]
    if not len(scores):
        raise CalibrationError(
            "nothing has an interval in any campaign",
            where="coverage",
            allowed="cases whose poses determine some parameter",
            remedy="simulate more poses, or less noise",
        )
    share_of_campaign = np.nanmean(_inside(scores), axis=1)
    return Coverage(
        inside=float(share_of_campaign.mean()),
        inside_interval95=_interval95(share_of_campaign, int(np.isfinite(scores).sum())),
        counted=len(scores),
        rms=float(np.sqrt(np.nanmean(scores**2))),
    )


def _interval95(share_of_campaign: Array, outcomes: int) -> tuple[float, float]:
    """Return the 95 % interval of a share by those of independent campaigns.

    It is that of Clopper and Pearson for an effective number of trials, as many as would scatter
    like the campaigns. The outcomes of a campaign depend on each other: of normal scores, 20 a
    campaign that correlate by 0.5, it held the share of 0.95 in 93 to 95 % of 2000 studies of 10 to
    200 campaigns, of independent ones in 96 to 99 %.

    Source:
        E. L. Korn and B. I. Graubard, Survey Methodology 24 (1998) 193-201.
    """
    campaigns, share = len(share_of_campaign), float(share_of_campaign.mean())
    if campaigns == 1:
        return 0.0, 1.0
    trials = float(campaigns)  # equal shares have no scatter that would tell of more
    if np.ptp(share_of_campaign) > _EQUAL_SHARES:
        trials_a_campaign = share * (1.0 - share) / float(share_of_campaign.var(ddof=1))
        trials = min(campaigns * trials_a_campaign, float(outcomes))
    upper = 0.5 + LEVEL / 2.0
    # The scatter of few campaigns is uncertain: the source's correction by degrees of freedom.
    trials *= float(ndtri(upper) / stdtrit(campaigns - 1, upper)) ** 2
    inside, outside = share * trials, (1.0 - share) * trials
    low = float(betaincinv(inside, outside + 1.0, 1.0 - upper)) if share > 0.0 else 0.0
    high = float(betaincinv(inside + 1.0, outside, upper)) if share < 1.0 else 1.0
    return low, high


def coverage_by_parameter(names: Sequence[str], scores: Array) -> dict[str, ParameterCoverage]:
    """Return the coverage of each parameter by scores (campaigns, parameters).

    Parameters that have an interval in no campaign are left out.
    """
    scores = _with_intervals(scores)
    known = np.flatnonzero(np.isfinite(scores).any(axis=0)).tolist()
    kept = [names[k] for k in known]
    inside = np.nanmean(_inside(scores[:, known]), axis=0).tolist()
    rms = np.sqrt(np.nanmean(scores[:, known] ** 2, axis=0)).tolist()
    return {name: ParameterCoverage(inside=inside[k], rms=rms[k]) for k, name in enumerate(kept)}


def _with_intervals(scores: Array) -> Array:
    """Return scores with nan where there is no interval: where they are not finite."""
    return np.where(np.isfinite(scores), scores, np.nan)


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
        Pa10calError: before the study begins, for a case whose arm is not known, or of which a
            campaign drawn for trial cannot be simulated or calibrated; in its course, when another
            campaign cannot be, or when nothing has an interval.
    """
    prepared = [_prepare(case, options, calibration) for case in options.cases]
    paper = _papers_model(options, calibration)
    say(_line(_PAPERS, {"parameters": paper}))
    cases = []
    titles = titles_of(options.cases)
    for each, title in zip(prepared, titles, strict=True):
        case = _general_model(each, title, options)
        shares = {"parameters": case.parameters, "predictions": case.predictions}
        say(_line(case.case, shares | {"of any arm": case.departing_in_any_way.predictions}))
        cases.append(case)
    return CoverageRecord(
        provenance=PROVENANCE,
        settings=options.model_dump(mode="json")
        | {"calibration": calibration.model_dump(mode="json")},
        paper=paper,
        cases=tuple(cases),
    )


def coverage_table(study: CoverageRecord) -> str:
    """Return a summary as CSV: lines of a case for all parameters, each class, and predictions."""
    shares: list[tuple[str, str, Coverage]] = [(_PAPERS, "all parameters", study.paper)]
    for case in study.cases:
        in_any_way = case.departing_in_any_way.predictions
        shares += [
            (case.case, "all parameters", case.parameters),
            *((case.case, kind, share) for kind, share in case.parameters.by_class.items()),
            (case.case, "predictions", case.predictions),
            (case.case, "predictions, arm departing in any way", in_any_way),
        ]
    rows = [
        (title, of, *(f"{100 * x:.1f}" for x in (s.inside, *s.inside_interval95)), f"{s.rms:.3f}")
        for title, of, s in shares
    ]
    header = ["case", "of", "inside_percent", "from_percent", "to_percent", "rms_score"]
    return csv_text(header, rows)


def _line(title: str, shares: dict[str, Coverage]) -> str:
    """Return what is said of a case that is finished: shares inside, and rms scores."""
    shown = (f"{what} {100 * s.inside:.1f} % ({s.rms:.2f})" for what, s in shares.items())
    return f"{title}: {', '.join(shown)} inside (rms score)"


def _papers_model(options: CoverageOptions, calibration: CalibrationOptions) -> PaperCoverage:
    """Score every identifiable parameter of the paper's robot, campaign by campaign."""
    seeds = range(options.random_seed, options.random_seed + options.campaigns)
    fits = [_touched_fit(seed, calibration) for seed in seeds]
    names, table = _table([fit.scores for fit in fits])
    return PaperCoverage(
        campaigns=len(fits),
        converged=float(np.mean([fit.converged for fit in fits])),
        parameters=coverage_by_parameter(names, table),
        **dict(coverage(table)),
    )


class _TouchedFit(NamedTuple):
    """One campaign of the paper's robot, calibrated."""

    converged: bool
    scores: dict[str, float]  # of every identifiable parameter


def _touched_fit(seed: int, options: CalibrationOptions) -> _TouchedFit:
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
    scores = reported_scores(parameter_records(found), truth_record(made, ()).parameters)
    return _TouchedFit(found.converged, scores)


def _table(by_name: Sequence[Mapping[str, float]]) -> tuple[tuple[str, ...], Array]:
    """Return the names that are scored in some campaign, and scores (C, k), nan where not."""
    names = tuple(dict.fromkeys(name for scores in by_name for name in scores))
    scores = [[each.get(name, np.nan) for name in names] for each in by_name]
    return names, np.array(scores, dtype=float).reshape(len(by_name), len(names))


class _Prepared(NamedTuple):
    """A case that can be simulated and calibrated."""

    options: CoverageCaseOptions
    arm: Arm
    plan: TrackerOptions
    calibration: CalibrationOptions
    # what can be identified of the robot drawn for trial: by name the same of every robot
    unknowns: ChosenUnknowns


def _prepare(
    case: CoverageCaseOptions, options: CoverageOptions, calibration: CalibrationOptions
) -> _Prepared:
    """Return a case, after a campaign of a robot drawn for trial was simulated and calibrated.

    Raises:
        Pa10calError: when it cannot be.
    """
    arm, plan = load_arm(case.robot), _plan(case, options)
    calibration = calibration.with_springs(case.flexible_joints)
    robot = draw_individual(arm, plan, np.random.default_rng(options.random_seed))
    seen, start = _seen(robot, plan, options.random_seed)
    unknowns = choose_unknowns(arm, calibration.tolerances, seen.measured, start)
    calibrate_general(arm, seen, start, payload_of_individual(robot), calibration)
    return _Prepared(case, arm, plan, calibration, unknowns)


class _Campaign(NamedTuple):
    """One campaign of a case, calibrated."""

    found: GeneralCalibration
    robot: Robot
    predictions: Array  # (m,) scores of predicted components


def _campaigns(case: _Prepared, options: CoverageOptions, *, in_any_way: bool) -> list[_Campaign]:
    """Simulate and calibrate the campaigns of a case, and score their predictions.

    Args:
        in_any_way: whether robots depart in any way, or by parameters of the model only.
    """
    arm, plan = case.arm, case.plan
    campaigns = []
    for seed in range(options.random_seed, options.random_seed + options.general_campaigns):
        rng = np.random.default_rng([seed, _IN_ANY_WAY if in_any_way else _BY_PARAMETERS])
        if in_any_way:
            robot = draw_individual(arm, plan, rng)
        else:
            robot = draw_by_unknowns(arm, plan, case.unknowns, rng)
        payload = payload_of_individual(robot)
        found = calibrate_general(arm, *_seen(robot, plan, seed), payload, case.calibration)
        others = exact_observations(robot, plan, _PREDICTED_POSES, seed + _OTHER_POSES)
        campaigns.append(_Campaign(found, robot, prediction_scores(found, others)))
    return campaigns


def titles_of(cases: Sequence[CoverageCaseOptions]) -> list[str]:
    """Return the titles of cases: in brief, and in full of those that are alike in brief."""
    brief = [_title(case) for case in cases]
    return [
        _title(case, in_full=True) if brief.count(title) > 1 else title
        for case, title in zip(cases, brief, strict=True)
    ]


def _title(case: CoverageCaseOptions, *, in_full: bool = False) -> str:
    """Return the title of a case; in full with its instrument and which joints have springs."""
    parts = [case.robot]
    several = sees_several(case.instrument)
    if in_full or not several:
        parts.append(case.instrument)
    if several:
        parts.append(f"{case.targets} target{'s' if case.targets > 1 else ''}")
    if joints := case.flexible_joints:
        parts.append(f"springs {' '.join(map(str, joints))}" if in_full else "springs")
    return ", ".join(parts)


def _general_model(case: _Prepared, title: str, options: CoverageOptions) -> CoverageCase:
    """Return the coverage of one case of the general model."""
    by_parameters = _campaigns(case, options, in_any_way=False)
    in_any_way = _campaigns(case, options, in_any_way=True)
    names, scores = _table([parameter_scores(each.found, each.robot) for each in by_parameters])
    classes = [class_of(name) for name in names]
    return CoverageCase(
        case=title,
        **case.options.model_dump(mode="json"),
        campaigns=len(by_parameters),
        converged=_converged(by_parameters),
        unknowns=max(len(each.found.problem.parameters) for each in by_parameters),
        redundant={each.name: each.replaced_by for each in case.unknowns.redundant},
        parameters=ClassCoverage(
            **dict(coverage(scores)),
            by_class=coverage_by_class(classes, scores),
            by_parameter=coverage_by_parameter(names, scores),
        ),
        predictions=_of_predictions(by_parameters),
        departing_in_any_way=DepartureInAnyWay(
            campaigns=len(in_any_way),
            converged=_converged(in_any_way),
            predictions=_of_predictions(in_any_way),
        ),
    )


def coverage_by_class(classes: Sequence[str], scores: Array) -> dict[str, Coverage]:
    """Return the coverage of each class of parameters of which some has an interval."""
    columns = {kind: [each == kind for each in classes] for kind in sorted(set(classes))}
    return {
        kind: coverage(scores[:, of_kind])
        for kind, of_kind in columns.items()
        if np.isfinite(scores[:, of_kind]).any()
    }


def _converged(campaigns: Sequence[_Campaign]) -> float:
    """Return the share of campaigns whose fit converged."""
    return float(np.mean([each.found.fit.converged for each in campaigns]))


def _of_predictions(campaigns: Sequence[_Campaign]) -> Coverage:
    """Return the coverage of predicted components."""
    return coverage(np.array([each.predictions for each in campaigns]))


def _seen(robot: Robot, plan: TrackerOptions, seed: int) -> tuple[Observations, Start]:
    """Measure a robot; return the observations and the start of their calibration."""
    seen = observations_of(measure(robot, plan, seed))
    return seen, find_start(robot.arm, seen)


def _plan(case: CoverageCaseOptions, options: CoverageOptions) -> TrackerOptions:
    """Return how the campaigns of a case are measured: all poses fitted, no target stated."""
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
