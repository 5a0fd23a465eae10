"""Individuals of the virtual cell and what an instrument sees of them, as the estimator takes it.

A campaign goes from the cell to the estimator in memory, as it would through its files.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.description import Arm
from pa10cal.arm.state import PoseStates
from pa10cal.arm.statics import Payload
from pa10cal.calibration.general.unknowns import Unknowns
from pa10cal.cell.individual_arm import (
    IndividualArm,
    draw_individual,
    individual_from_departures,
)
from pa10cal.cell.mechanism import GRAVITY_M_S2
from pa10cal.cell.sighted import SeenPose, SeenTargets, SightedCampaign, measure_individual
from pa10cal.evaluation.known_truth import KnownTruth
from pa10cal.fit.loads import with_torques
from pa10cal.observe.distance import Distance
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations
from pa10cal.observe.points import Points
from pa10cal.observe.pose import Pose
from pa10cal.settings import SightedPlan

Array = NDArray[np.float64]

_TEMPERATURE_C = 20.0
#: Noise so far below any instrument's that what is seen counts as exact.
_EXACT = {"position_mm": 1e-5, "attitude_rad": 1e-8, "unseen_share": 0.0}


def observations_of(campaign: SightedCampaign) -> Observations:
    """Return what the estimator takes of a campaign in which nothing is repeated."""
    count, plan = len(campaign), campaign.plan
    u_m = 1e-3 * plan.position_mm
    measured: Instrument
    if isinstance(campaign.seen, SeenPose):
        variances = np.repeat([u_m**2, plan.attitude_rad**2], 3)
        measured = Pose.of(campaign.seen.T_instr_target, np.tile(np.diag(variances), (count, 1, 1)))
    elif isinstance(campaign.seen, SeenTargets):
        targets, p_instr_m = campaign.truth.individual.targets, campaign.seen.p_instr_m
        cov_m2 = np.where(np.isnan(p_instr_m[..., None]), np.nan, u_m**2 * np.eye(3))
        stated_m = targets.p_ee_stated_m if plan.states_targets else None
        measured = Points(targets.names, p_instr_m, cov_m2, stated_m)
    else:
        measured = Distance(campaign.seen.d_m, np.full(count, u_m))
    states = PoseStates(
        q_rad=campaign.q,
        tau_Nm=np.full_like(campaign.q, np.nan) if campaign.tau_Nm is None else campaign.tau_Nm,
        arrival=np.zeros_like(campaign.q),
        load_N=campaign.load_N,
        temperature_C=np.full(count, _TEMPERATURE_C),
        time_s=campaign.time_s,
    )
    return Observations.single(campaign.pose, states, measured)


def exact_observations(
    individual: IndividualArm, plan: SightedPlan, poses: int, random_seed: int
) -> Observations:
    """Return other poses of an individual, seen all but exactly, with torques where it has masses.

    Args:
        individual: the arm as it is.
        plan: of its campaign.
        poses: how many.
        random_seed: draws them.
    """
    wanted = plan.model_copy(update={"poses": poses, **_EXACT})
    found = observations_of(measure_individual(individual, wanted, random_seed))
    states, _ = with_torques(individual.arm, found.states, payload_of_individual(individual))
    return replace(found, states=states)


def payload_of_individual(individual: IndividualArm) -> Payload | None:
    """Return what an individual carries; None where the masses of its links are not known."""
    if individual.arm.mass_kg is None:
        return None
    payload = individual.linkage.payload
    return Payload(payload.mass_kg, payload.com_m, payload.load_point_m, GRAVITY_M_S2)


def draw_by_unknowns(
    arm: Arm, plan: SightedPlan, unknowns: Unknowns, rng: np.random.Generator
) -> tuple[IndividualArm, KnownTruth]:
    """Draw an individual that departs by no parameter but those that a model holds.

    Links depart by the parameters' scales; base, targets and springs are drawn as those of any
    individual. Coordinates of a target that the model does not seek are zero, where it holds them
    for want of a statement; of several targets it would hold their mean.

    Args:
        arm: its description.
        plan: gives base, targets and springs.
        unknowns: of the model.
        rng: draws it.
    """
    links = unknowns.links.parameters
    departures = {link.name: float(rng.normal(0.0, link.scale)) for link in links}
    free = draw_individual(arm, plan, rng)
    T_ee_target, targets = free.T_ee_target.copy(), free.targets
    if plan.instrument == "pose":
        sought = {parameter.name for parameter in unknowns.tool.parameters}
        held = [f"tool_{axis}" not in sought for axis in "xyz"]
        T_ee_target[:3, 3][held] = 0.0
    else:
        p_ee_m = np.zeros(targets.p_ee_m.size)
        p_ee_m[unknowns.places] = targets.p_ee_m.ravel()[unknowns.places]
        targets = replace(targets, p_ee_m=p_ee_m.reshape(-1, 3))
    individual = individual_from_departures(
        arm,
        departures,
        plan=plan,
        springs=free.linkage.springs,
        T_instr_base=free.T_instr_base,
        targets=targets,
    )
    individual = replace(individual, T_ee_target=T_ee_target)
    return individual, truth_of(individual, departures)


def truth_of(individual: IndividualArm, departures: Mapping[str, float]) -> KnownTruth:
    """Return what an individual hides, its links departing by the parameters named."""
    return KnownTruth(
        departures,
        individual.T_instr_base,
        individual.T_ee_target,
        individual.targets.p_ee_m,
        individual.linkage.springs.k_lin,
    )
