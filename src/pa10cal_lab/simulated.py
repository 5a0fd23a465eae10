"""Individuals of the virtual cell, what an instrument sees of them, and how estimates score.

A campaign goes from the cell to the estimator through its files, or in memory where many do.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import ndtri, stdtrit

from pa10cal.arm.chain import BASE, TOOL
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import Payload, PoseStates
from pa10cal.arrays import Array
from pa10cal.calibration.calibrate import calibrate
from pa10cal.calibration.general.calibrate import GeneralCalibration, calibrate_general, find_start
from pa10cal.calibration.general.unknowns import ChosenUnknowns, choose_unknowns
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.calibration.paper import parameter_records
from pa10cal.campaign import read
from pa10cal.files.arms import load_arm
from pa10cal.files.output import csv_text
from pa10cal.fit.identifiability import not_identifiable
from pa10cal.fit.loads import with_torques
from pa10cal.observe.kinds import instruments
from pa10cal.observe.observations import Observations, average_repeats, poses_of
from pa10cal.observe.quantities import Start, Stated
from pa10cal.results.calibration import CalibratedParameter
from pa10cal.terms.joint_spring import JointSpring, baseline
from pa10cal_lab import coverage_records as results
from pa10cal_lab.cell.campaign import SimulatedCampaign, measure_campaign, simulate_campaign
from pa10cal_lab.cell.individual import draw_individual
from pa10cal_lab.cell.options import SimulateOptions, TrackerOptions
from pa10cal_lab.cell.robot import GRAVITY_M_S2, Departures, Mechanism, Robot
from pa10cal_lab.cell.write import truth_record, write_campaign
from pa10cal_lab.options import CoverageCaseOptions, CoverageOptions
from pa10cal_lab.trial_records import TrueParameter

_TEMPERATURE_C = 20.0
#: Noise so far below any instrument's that what is seen counts as exact.
_EXACT = {"position_mm": 1e-5, "attitude_rad": 1e-8, "unseen_share": 0.0}


def measure(robot: Robot, plan: TrackerOptions, random_seed: int) -> SimulatedCampaign:
    """Measure a robot with a tracker, nothing hidden; see `cell.campaign.measure_campaign`."""
    options = SimulateOptions(random_seed=random_seed, without_touches=plan)
    return measure_campaign("simulated", options, robot)


def as_read(made: SimulatedCampaign) -> read.Campaign:
    """Return a campaign as it is read from its files."""
    with tempfile.TemporaryDirectory() as folder:
        write_campaign(made, Path(folder) / "raw")
        return read.read_campaign(Path(folder) / "raw")


def observations_of(campaign: SimulatedCampaign) -> Observations:
    """Return what the estimator takes of a campaign in which nothing is repeated."""
    table, arm = campaign.tables["poses"], campaign.truth.robot.arm
    q = np.column_stack(
        [
            1e-3 * table[f"q{joint}_mm"] if slides else np.radians(table[f"q{joint}_deg"])
            for joint, slides in enumerate(arm.prismatic, start=1)
        ]
    )
    tau_Nm = table.filter(regex=r"^tau\d+_Nm$").to_numpy(dtype=float)
    states = PoseStates(
        q_rad=q,
        tau_Nm=tau_Nm if tau_Nm.size else np.full_like(q, np.nan),
        arrival=np.zeros_like(q),
        load_N=table["load_N"].to_numpy(dtype=float),
        temperature_C=np.full(len(table), _TEMPERATURE_C),
        time_s=table["time_s"].to_numpy(dtype=float),
    )
    kind = instruments()[campaign.instrument.kind]
    columns = kind.raw_columns(list(table.columns))
    values, u = (
        table[[f"{prefix}{name}" for name in columns.names]].to_numpy(dtype=float)
        for prefix in ("", "u_")
    )
    description = campaign.instrument.description(campaign.truth.robot)
    targets_m = {
        name: 1e-3 * np.array(p) for name, p in description["tool"].get("balls_mm", {}).items()
    }
    stated = Stated(1e-3 * description["instrument"]["uncertainty_mm"], targets_m)
    seen = kind.from_raw(columns, values, u, stated)
    return Observations.single(table["pose"].to_numpy(dtype=str), states, seen)


def exact_observations(
    individual: Robot, plan: TrackerOptions, poses: int, random_seed: int
) -> Observations:
    """Return other poses of an individual, seen all but exactly."""
    wanted = plan.model_copy(update={"poses": poses, **_EXACT})
    return observations_of(measure(individual, wanted, random_seed))


def payload_of_individual(individual: Robot) -> Payload | None:
    """Return what an individual carries; None where the masses of its links are not known."""
    if individual.arm.mass_kg is None:
        return None
    payload = individual.mechanism.payload
    return Payload(payload.mass_kg, payload.com_m, payload.load_point_m, GRAVITY_M_S2)


def draw_by_unknowns(
    arm: Arm, plan: TrackerOptions, unknowns: ChosenUnknowns, rng: np.random.Generator
) -> Robot:
    """Draw an individual that departs by no parameter but those that a model holds.

    Links depart by the parameters' scales; base, targets and springs are drawn as those of any
    individual. Coordinates of a target that the model does not seek are zero, where it holds them
    for want of a statement; of several targets it would hold their mean.

    Args:
        plan: gives base, targets and springs.
    """
    links = unknowns.links.parameters
    rows = Departures.named(
        arm.n, {link.name: float(rng.normal(0.0, link.scale)) for link in links}
    )
    free = draw_individual(arm, plan, rng)
    T_ee_target, targets = free.T_ee_target.copy(), free.targets
    if instruments()[plan.instrument].measures_pose:
        sought = {each.name for frame in unknowns.frames for each in frame.parameters}
        held = [f"tool_{axis}" not in sought for axis in "xyz"]
        T_ee_target[:3, 3][held] = 0.0
    else:
        p_ee_m = np.zeros(targets.p_ee_m.size)
        p_ee_m[unknowns.places] = targets.p_ee_m.ravel()[unknowns.places]
        targets = replace(targets, p_ee_m=p_ee_m.reshape(-1, 3))
    mechanism = Mechanism.of(arm, rows, free.mechanism.payload)
    return replace(
        free, mechanism=mechanism, departures=rows, targets=targets, T_ee_target=T_ee_target
    )


# General models held against a truth that is known.
#
# A score is (estimate - truth) / standard uncertainty. A parameter that another repeats has no
# truth of its own: where the truth departs only by parameters that the model holds, every parameter
# has. Where it departs in any way, the model still owes its predictions.

_CLASSES = {
    "delta_a_": "lengths",
    "delta_d_": "lengths",
    "delta_": "angles",
    "base_": "base",
    "tool_": "tool",
    "target_": "targets",
    "windup_": "springs",
}


def parameter_scores(general: GeneralCalibration, robot: Robot) -> dict[str, float]:
    """Return the score of every parameter that has an interval.

    Tilts left at zero count with the uncertainty that they would have had.
    """
    fit, problem = general.fit, general.problem
    values = _true_values(general, robot)
    without = not_identifiable(fit.identifiability, problem.parameters)
    std = np.sqrt(np.diag(fit.covariance))
    scores = {
        parameter.name: float((fit.x[k] - values.get(parameter.name, 0.0)) / std[k])
        for k, parameter in enumerate(problem.parameters)
        if not fit.at_bound[k] and parameter.name not in without
    }
    for name, each in general.settled.items():
        if each.std:
            scores[name] = -values.get(name, 0.0) / each.std
    return scores


def reported_scores(
    parameters: Mapping[str, CalibratedParameter], truth: Mapping[str, TrueParameter]
) -> dict[str, float]:
    """Return the score of every parameter of a record that the poses identify and the truth has."""
    return {
        name: (found.value - truth[name].value) / found.std
        for name, found in parameters.items()
        if found.identifiable and found.std and name in truth
    }


def prediction_scores(general: GeneralCalibration, exact: Observations) -> Array:
    """Return the scores of what the instrument would see in other poses, one by one.

    Args:
        exact: poses seen without error.
    """
    problem = general.problem
    x_model = problem.of_model(general.fit.x)
    states, _ = with_torques(problem.model, x_model, exact.states, general.payload)
    exact = exact.with_states(states).turned(general.start.R_ee_target)
    problem = replace(problem, observations=exact)
    rows = problem.rows(general.fit.x)
    spread = rows.jacobian @ general.fit.covariance
    std = np.sqrt(np.sum(spread * rows.jacobian, axis=2))
    scores: Array = (rows.residual / std)[problem.components_seen]
    return scores


def class_of(name: str) -> str:
    """Return the class of a parameter: lengths, angles, base, tool, targets or springs."""
    return next(kind for start, kind in _CLASSES.items() if name.startswith(start))


def _true_values(general: GeneralCalibration, robot: Robot) -> dict[str, float]:
    """Return the truth in the coordinates in which the model was solved."""
    problem, start = general.problem, general.start
    R, p_m = robot.T_instr_base[:3, :3], robot.T_instr_base[:3, 3]
    if not problem.observations.measured.directional:  # only where the fixed point is
        base = np.concatenate([R.T @ p_m - problem.T_instr_base[:3, 3], np.zeros(3)])
    else:
        base = _motions(np.linalg.inv(problem.T_instr_base) @ robot.T_instr_base)
    T_ee_tool = robot.T_ee_target.copy()
    T_ee_tool[:3, :3] = T_ee_tool[:3, :3] @ start.R_ee_target.T
    names = [name.replace(".", "_") for name in (*BASE, *TOOL)]
    values = {} if robot.departures is None else robot.departures.by_name
    values |= dict(zip(names, [*base, *_motions(T_ee_tool)], strict=True))
    places = problem.observations.measured.target_parameters
    if places:
        p_ee_m = robot.targets.p_ee_m.ravel()
        values |= {parameter.name: float(p) for parameter, p in zip(places, p_ee_m, strict=True)}
    for term in problem.model.terms:
        if isinstance(term, JointSpring):
            stiffness = float(robot.springs.k_lin[term.joint - 1])
            values[term.parameters[0].name] = term.tau_ref_Nm / stiffness
    return values


def _motions(T: Array) -> Array:
    """Return shifts along x, y, z and turns about the moved x, y, z that come to a pose (4, 4)."""
    turns = Rotation.from_matrix(T[:3, :3]).as_euler("XYZ")
    return np.concatenate([T[:3, 3], turns])


# Do intervals hold what they promise: scores of many campaigns whose truth is known.

LEVEL = 0.95


def coverage(scores: Array) -> results.Coverage:
    """Summarise scores (campaigns, parameters): (estimate - truth) / standard uncertainty.

    A parameter without an interval in some campaign has nan there. Of the interval of the share,
    campaigns are independent, and the parameters of one campaign are not.
    """
    shares = np.nanmean(_held(scores), axis=1)
    count = len(shares)
    half = (
        float(stdtrit(count - 1, 0.975) * shares.std(ddof=1) / np.sqrt(count)) if count > 1 else 1.0
    )
    inside = float(shares.mean())
    return results.Coverage(
        inside=inside,
        inside_interval95=(max(0.0, inside - half), min(1.0, inside + half)),
        rms=float(np.sqrt(np.nanmean(scores**2))),
    )


def coverage_by_parameter(
    names: Sequence[str], scores: Array
) -> dict[str, results.ParameterCoverage]:
    """Summarise the scores (campaigns, parameters) of each parameter."""
    inside = np.nanmean(_held(scores), axis=0).tolist()
    rms = np.sqrt(np.nanmean(scores**2, axis=0)).tolist()
    return {
        name: results.ParameterCoverage(inside=inside[k], rms=rms[k])
        for k, name in enumerate(names)
    }


def _held(scores: Array) -> Array:
    """Return 1 where the interval holds the truth, 0 where it does not, nan without one."""
    inside = np.abs(scores) <= ndtri(0.5 + LEVEL / 2.0)
    return np.where(np.isfinite(scores), inside, np.nan)


# Do 95 % intervals hold the truth of simulated campaigns in 95 % of cases?
#
# The paper's robot, touched, is calibrated with the paper's model. Each other case is an arm under
# an instrument, calibrated with the general model, twice over: arms that depart by the model's own
# parameters show whether parameters lie in their intervals, and predictions in theirs; arms that
# depart in any way have no true parameters, and show it by predictions alone. The truth is looked
# at after the estimate is made, and nowhere else.

PROVENANCE = "synthetic: virtual cell, no hidden effect"
_PAPERS = "pa10_6ce, touched balls, paper's model"
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
    for asked in options.cases:  # a name that does not exist is refused before any work
        load_arm(asked.robot)
    paper = _papers_model(options, calibration)
    say(_line(_PAPERS, {"parameters": paper}))
    cases = []
    for asked in options.cases:
        case = _general_model(asked, options, calibration)
        shares = {"parameters": case.parameters, "predictions": case.predictions}
        say(_line(case.case, shares | {"of any arm": case.departing_in_any_way.predictions}))
        cases.append(case)
    return results.CoverageRecord(
        provenance=PROVENANCE,
        settings=options.model_dump(mode="json"),
        paper=paper,
        cases=tuple(cases),
    )


def coverage_table(record: results.CoverageRecord) -> str:
    """Return the same in brief, as CSV: one line for each class of parameters of a case."""
    shares: list[tuple[str, str, results.Coverage]] = [(_PAPERS, "all parameters", record.paper)]
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
    return csv_text(header, rows)


def _line(title: str, shares: dict[str, results.Coverage]) -> str:
    shown = (f"{what} {100 * s.inside:.1f} % ({s.rms:.2f})" for what, s in shares.items())
    return f"{title}: {', '.join(shown)} inside (rms score)"


def _papers_model(
    options: CoverageOptions, calibration: CalibrationOptions
) -> results.PaperCoverage:
    """Score every identifiable parameter of the paper's robot, campaign by campaign."""
    seeds = range(options.random_seed, options.random_seed + options.campaigns)
    scores = [_touched_scores(seed, calibration) for seed in seeds]
    names = [name for name in scores[0] if all(name in row for row in scores)]
    table = np.array([[row[name] for name in names] for row in scores])
    return results.PaperCoverage(
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

    unknowns: ChosenUnknowns  # parameters sought and left out, and names of all that were scored
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
    classes = [class_of(name) for name in own.names]
    return results.CoverageCase(
        case=title + (", springs" if case.flexible_joints else ""),
        **case.model_dump(mode="json"),
        campaigns=len(own.converged),
        converged=float(own.converged.mean()),
        unknowns=len(own.names),
        redundant={each.name: each.replaced_by for each in own.unknowns.redundant},
        parameters=results.ClassCoverage(
            **dict(coverage(own.parameters)),
            by_class={
                kind: coverage(own.parameters[:, [each == kind for each in classes]])
                for kind in sorted(set(classes))
            },
            by_parameter=coverage_by_parameter(own.names, own.parameters),
        ),
        predictions=coverage(own.predictions),
        departing_in_any_way=results.FreeDeparture(
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
    """Measure a robot, and return what a calibration starts from."""
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
