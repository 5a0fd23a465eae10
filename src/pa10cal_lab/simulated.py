"""Simulated robots for the estimator: their observations, and scores of estimates.

A campaign of the virtual cell reaches the estimator through its files, or in memory if there are
many. A score is (estimate - truth) / standard uncertainty.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.arm.chain import BASE, TOOL
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import Payload, PoseStates
from pa10cal.arrays import Array
from pa10cal.calibration.general.calibrate import GeneralCalibration
from pa10cal.calibration.general.unknowns import ChosenUnknowns
from pa10cal.campaign import read
from pa10cal.fit.loads import with_torques
from pa10cal.fit.logged_torques import without_torque_errors
from pa10cal.fit.problem import not_identifiable
from pa10cal.observe.kinds import instruments
from pa10cal.observe.observations import Observations
from pa10cal.observe.quantities import StatedByCampaign
from pa10cal.results.calibration import CalibratedParameter
from pa10cal.terms.joint_spring import JointSpring
from pa10cal_lab.cell.campaign import SimulatedCampaign, measure_campaign
from pa10cal_lab.cell.individual import draw_individual
from pa10cal_lab.cell.mechanism import GRAVITY_M_S2, Departures, Mechanism
from pa10cal_lab.cell.options import SimulateOptions, TrackerOptions
from pa10cal_lab.cell.robot import Robot
from pa10cal_lab.cell.write import write_campaign
from pa10cal_lab.trial_records import TrueParameter

_TEMPERATURE_C = 20.0
#: Noise of observations that count as exact.
_EXACT = {"position_mm": 1e-5, "attitude_rad": 1e-8, "unseen_share": 0.0}


def measure(robot: Robot, plan: TrackerOptions, random_seed: int) -> SimulatedCampaign:
    """Measure a robot with a tracker, nothing hidden; see `cell.campaign.measure_campaign`."""
    options = SimulateOptions(random_seed=random_seed, without_touches=plan)
    return measure_campaign("simulated", options, robot)


def as_read(made: SimulatedCampaign) -> read.Campaign:
    """Return a campaign as it is read from its files, without the errors that its log shows."""
    with tempfile.TemporaryDirectory() as folder:
        write_campaign(made, Path(folder) / "raw")
        found = read.read_campaign(Path(folder) / "raw")
    return replace(found, observations=without_torque_errors(found.observations, found.arm))


def observations_of(campaign: SimulatedCampaign) -> Observations:
    """Return the observations of a campaign without repeats."""
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
    stated = StatedByCampaign(1e-3 * description["instrument"]["uncertainty_mm"], targets_m)
    seen = kind.from_raw(columns, values, u, stated)
    return Observations.single(table["pose"].to_numpy(dtype=str), states, seen)


def exact_observations(
    individual: Robot, plan: TrackerOptions, poses: int, random_seed: int
) -> Observations:
    """Return observations of other poses of an individual, nearly without noise."""
    wanted = plan.model_copy(update={"poses": poses, **_EXACT})
    return observations_of(measure(individual, wanted, random_seed))


def payload_of_individual(individual: Robot) -> Payload | None:
    """Return the payload of an individual; None where the masses of its links are not known."""
    if individual.arm.mass_kg is None:
        return None
    payload = individual.mechanism.payload
    return Payload(payload.mass_kg, payload.com_m, payload.load_point_m, GRAVITY_M_S2)


def draw_by_unknowns(
    arm: Arm, plan: TrackerOptions, unknowns: ChosenUnknowns, rng: np.random.Generator
) -> Robot:
    """Draw an individual that deviates from nominal only by parameters of a model.

    Links deviate by the parameters' scales; base, targets and springs are drawn as for any
    individual. Coordinates of a target that the model does not estimate are zero, as the model
    assumes for one target whose position is not stated.

    Args:
        plan: of base, targets and springs.
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
        p_ee_m[unknowns.targets_kept] = targets.p_ee_m.ravel()[unknowns.targets_kept]
        targets = replace(targets, p_ee_m=p_ee_m.reshape(-1, 3))
    mechanism = Mechanism.of(arm, rows, free.mechanism.payload)
    return replace(
        free, mechanism=mechanism, departures=rows, targets=targets, T_ee_target=T_ee_target
    )


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

    The robot must deviate only by parameters of the model: others have no true values. Tilts that
    were left at zero are scored with the uncertainty that they would have.
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
    """Return the score of every identifiable parameter of a record that has a true value."""
    return {
        name: (parameter.value - truth[name].value) / parameter.std
        for name, parameter in parameters.items()
        if parameter.identifiable and parameter.std and name in truth
    }


def prediction_scores(general: GeneralCalibration, exact: Observations) -> Array:
    """Return the score of every component that the instrument would measure in other poses.

    Args:
        exact: observations of these poses, nearly without noise.
    """
    problem = general.problem
    x_model = problem.of_model(general.fit.x)
    states, _ = with_torques(problem.model, x_model, exact.states, general.payload)
    exact = exact.with_states(states).turned(general.start.R_ee_target)
    problem = replace(problem, observations=exact)
    rows = problem.rows(general.fit.x)
    spread = rows.jacobian @ general.fit.covariance
    std = np.sqrt(np.sum(spread * rows.jacobian, axis=2))
    return np.asarray((rows.residual / std)[problem.components_seen])


def class_of(name: str) -> str:
    """Return the class of a parameter: lengths, angles, base, tool, targets or springs."""
    return next(kind for start, kind in _CLASSES.items() if name.startswith(start))


def _true_values(general: GeneralCalibration, robot: Robot) -> dict[str, float]:
    """Return the true values of the parameters in which the model was solved."""
    problem, start = general.problem, general.start
    R, p_m = robot.T_instr_base[:3, :3], robot.T_instr_base[:3, 3]
    if not problem.observations.measured.directional:  # only the fixed point is determined
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
    """Return a pose (4, 4) as shifts along x, y, z and rotations about the moved x, y, z, (6,)."""
    turns = Rotation.from_matrix(T[:3, :3]).as_euler("XYZ")
    return np.concatenate([T[:3, 3], turns])
