"""A campaign without touches as its folder under the raw-data contract, and its truth elsewhere."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.cell.campaign import REFERENCE_TEMPERATURE_C
from pa10cal.cell.mechanism import GRAVITY_M_S2
from pa10cal.cell.reading import MM_DECIMALS, position_columns
from pa10cal.cell.sighted import SeenPose, SeenTargets, SightedCampaign
from pa10cal.cell.truth import TRUTH_SCHEMA
from pa10cal.cell.write import (
    CAMPAIGN_SCHEMA,
    DECIMALS,
    claim_folder,
    write_description,
    write_table,
)
from pa10cal.files.output import write_json

Array = NDArray[np.float64]

POSES_FILE = "poses.csv"
PROVENANCE = (
    "synthetic: written by this project's own virtual cell, not measured on a robot; "
    "how the robot departs from its description is not told here"
)
_QUATERNION = ("qw", "qx", "qy", "qz")
#: What was seen is written finer than it can be measured, so that nothing is lost on the way.
_SEEN_DECIMALS = {"x_mm": 6, "y_mm": 6, "z_mm": 6, "d_mm": 6, **dict.fromkeys(_QUATERNION, 9)}


def write_sighted(
    campaign: SightedCampaign, folder: Path, name: str, truth: Path | None = None
) -> None:
    """Write a campaign's folder and, where it is asked for, its truth elsewhere.

    Args:
        campaign: what to write.
        folder: the campaign's folder; files of a former campaign in it are replaced.
        name: of the campaign.
        truth: the file for what is hidden; None for none.

    Raises:
        SimulationError: when the truth would lie inside the folder, or when the folder holds
            anything that is not a campaign's.
    """
    claim_folder(folder, truth, (POSES_FILE,))
    if truth is not None:
        write_json(truth, sighted_truth_record(campaign, name))
    write_table(sighted_table(campaign), folder / POSES_FILE, {**_SEEN_DECIMALS, **DECIMALS})
    write_description(_description(campaign, name), folder)


def sighted_table(campaign: SightedCampaign) -> pd.DataFrame:
    """Return the table `files.poses` of the raw-data contract; nan where a target was not seen."""
    columns: dict[str, Any] = {
        "time_s": campaign.time_s,
        "kind": campaign.kind,
        "pose": campaign.pose,
        "load_N": campaign.load_N,
        "repeat": campaign.repeat,
        **position_columns(campaign.truth.individual.arm, campaign.q),
    }
    if campaign.tau_Nm is not None:
        columns |= {f"tau{joint}_Nm": tau for joint, tau in enumerate(campaign.tau_Nm.T, start=1)}
    return pd.DataFrame(columns | _seen_columns(campaign))


def sighted_truth_record(campaign: SightedCampaign, name: str) -> dict[str, Any]:
    """Return all that `campaign` hides, with units, ready for JSON."""
    individual = campaign.truth.individual
    linkage, targets = individual.linkage, individual.targets
    springs = np.flatnonzero(linkage.springs.flexible).tolist()
    return {
        "schema": TRUTH_SCHEMA,
        "campaign": name,
        "robot": individual.arm.name,
        "random_seed": campaign.random_seed,
        "T_instr_base_m": individual.T_instr_base.tolist(),
        "joint_placements_m": linkage.placements.tolist(),
        "T_last_joint_ee_m": linkage.T_last_ee.tolist(),
        "T_ee_target_m": individual.T_ee_target.tolist(),
        "targets_m": dict(zip(targets.names, targets.p_ee_m.tolist(), strict=True)),
        "springs": {
            f"joint {joint + 1}": {
                "K_lin_Nm_rad": float(linkage.springs.k_lin[joint]),
                "K_cub_Nm_rad3": float(linkage.springs.k_cub[joint]),
            }
            for joint in springs
        },
        "settings": campaign.plan.model_dump(mode="json"),
        "q_motor_rad_or_m": campaign.truth.q_motor.tolist(),
    }


def _description(campaign: SightedCampaign, name: str) -> dict[str, Any]:
    """Return the content of campaign.yaml, as in the raw-data contract."""
    plan, individual = campaign.plan, campaign.truth.individual
    payload, targets = individual.linkage.payload, individual.targets
    stated_mm = (1e3 * targets.p_ee_stated_m).round(MM_DECIMALS).tolist()
    states = plan.states_targets and plan.instrument != "pose"
    return {
        "schema": CAMPAIGN_SCHEMA,
        "name": name,
        "robot": individual.arm.name,
        "provenance": PROVENANCE,
        "instrument": {"kind": plan.instrument, "uncertainty_mm": plan.position_mm},
        "tool": {
            "mass_kg": payload.mass_kg,
            "com_mm": (1e3 * payload.com_m).round(MM_DECIMALS).tolist(),
            "load_point_mm": (1e3 * payload.load_point_m).round(MM_DECIMALS).tolist(),
            **({"balls_mm": dict(zip(targets.names, stated_mm, strict=True))} if states else {}),
        },
        "gravity_m_s2": GRAVITY_M_S2.tolist(),
        "reference_temperature_C": REFERENCE_TEMPERATURE_C,
        "files": {"poses": POSES_FILE},
    }


def _seen_columns(campaign: SightedCampaign) -> dict[str, Array]:
    """Return what the instrument saw, each with its standard uncertainty beside it."""
    seen, plan = campaign.seen, campaign.plan
    if isinstance(seen, SeenPose):
        places = dict(
            zip(("x_mm", "y_mm", "z_mm"), 1e3 * seen.T_instr_target[:, :3, 3].T, strict=True)
        )
        rotation = Rotation.from_matrix(seen.T_instr_target[:, :3, :3])
        quaternion = rotation.as_quat(canonical=True, scalar_first=True)
        # Half a turn's uncertainty in every component is that turn's about every axis.
        attitude = dict(zip(_QUATERNION, quaternion.T, strict=True))
        return _with_u(places, plan.position_mm) | _with_u(attitude, 0.5 * plan.attitude_rad)
    if isinstance(seen, SeenTargets):
        names = campaign.truth.individual.targets.names
        places = {
            f"{name}_{axis}_mm": 1e3 * seen.p_instr_m[:, b, k]
            for b, name in enumerate(names)
            for k, axis in enumerate("xyz")
        }
        return _with_u(places, plan.position_mm)
    return _with_u({"d_mm": 1e3 * seen.d_m}, plan.position_mm)


def _with_u(columns: dict[str, Array], u: float) -> dict[str, Array]:
    return columns | {f"u_{name}": np.full(len(values), u) for name, values in columns.items()}
