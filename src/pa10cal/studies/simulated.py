"""Individuals of the virtual cell and what an instrument sees of them, as the estimator takes it.

A campaign goes from the cell to the estimator through its files, or in memory where many do.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from pa10cal.arm.description import Arm
from pa10cal.arm.statics import Payload, PoseStates
from pa10cal.calibration.campaign import calibration_record
from pa10cal.calibration.general.problem import Unknowns
from pa10cal.calibration.load_case import COMBINED
from pa10cal.calibration.options import takes_general_model
from pa10cal.campaign import read
from pa10cal.cell.campaign import Campaign, measure_campaign
from pa10cal.cell.individual import draw_individual, robot_from_departures
from pa10cal.cell.options import SimulateOptions, TrackerOptions
from pa10cal.cell.robot import GRAVITY_M_S2, Robot
from pa10cal.cell.write import write_campaign
from pa10cal.evaluation.known_truth import KnownTruth
from pa10cal.evaluation.options import ChainOptions
from pa10cal.observe.kinds import instruments
from pa10cal.observe.observations import Observations
from pa10cal.observe.quantities import Stated
from pa10cal.observe.seed import locate_base
from pa10cal.results.calibration import CalibrationRecord

_TEMPERATURE_C = 20.0
#: Noise so far below any instrument's that what is seen counts as exact.
_EXACT = {"position_mm": 1e-5, "attitude_rad": 1e-8, "unseen_share": 0.0}


def measured(robot: Robot, plan: TrackerOptions, random_seed: int) -> Campaign:
    """Measure a robot with a tracker, nothing hidden; see `cell.campaign.measure_campaign`."""
    options = SimulateOptions(random_seed=random_seed, without_touches=plan)
    return measure_campaign("simulated", options, robot)


def as_read(made: Campaign) -> read.Campaign:
    """Return a campaign as it is read from its files."""
    with tempfile.TemporaryDirectory() as folder:
        write_campaign(made, Path(folder) / "raw")
        return read.read_campaign(Path(folder) / "raw")


def record_of(
    campaign: read.Campaign, options: ChainOptions, load: str = COMBINED
) -> CalibrationRecord:
    """Locate base and targets of a campaign, and calibrate a load case; no check of the input.

    Args:
        campaign: as it was read.
        options: sections base_frame and calibration; effects to calibrate with are not heeded.
        load: `combined` for all loads together, or a load such as `44N`.

    Raises:
        CalibrationError: when it is not enough to calibrate with.
    """
    said, every, settings = campaign.description, campaign.observations, options.calibration
    seed = locate_base(
        every, campaign.arm, options.base_frame, campaign.folder, said.name, said.provenance
    )
    general = takes_general_model(settings.model, from_touches=said.from_touches)
    return calibration_record(said, campaign.arm, every, seed, load, settings, general=general)


def observations_of(campaign: Campaign) -> Observations:
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
    """Return other poses of an individual, seen all but exactly.

    Args:
        individual: the arm as it is.
        plan: of its campaign.
        poses: how many.
        random_seed: draws them.
    """
    wanted = plan.model_copy(update={"poses": poses, **_EXACT})
    return observations_of(measured(individual, wanted, random_seed))


def payload_of_individual(individual: Robot) -> Payload | None:
    """Return what an individual carries; None where the masses of its links are not known."""
    if individual.arm.mass_kg is None:
        return None
    payload = individual.mechanism.payload
    return Payload(payload.mass_kg, payload.com_m, payload.load_point_m, GRAVITY_M_S2)


def draw_by_unknowns(
    arm: Arm, plan: TrackerOptions, unknowns: Unknowns, rng: np.random.Generator
) -> tuple[Robot, KnownTruth]:
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
    if instruments()[plan.instrument].measures_pose:
        sought = set(unknowns.frame_names)
        held = [f"tool_{axis}" not in sought for axis in "xyz"]
        T_ee_target[:3, 3][held] = 0.0
    else:
        p_ee_m = np.zeros(targets.p_ee_m.size)
        p_ee_m[unknowns.places] = targets.p_ee_m.ravel()[unknowns.places]
        targets = replace(targets, p_ee_m=p_ee_m.reshape(-1, 3))
    individual = robot_from_departures(
        arm,
        departures,
        plan=plan,
        springs=free.springs,
        T_instr_base=free.T_instr_base,
        targets=targets,
    )
    individual = replace(individual, T_ee_target=T_ee_target)
    return individual, truth_of(individual, departures)


def truth_of(individual: Robot, departures: Mapping[str, float]) -> KnownTruth:
    """Return what an individual hides, its links departing by the parameters named."""
    return KnownTruth(
        departures,
        individual.T_instr_base,
        individual.T_ee_target,
        individual.targets.p_ee_m,
        individual.springs.k_lin,
    )
