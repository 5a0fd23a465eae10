"""A campaign's folder under the raw-data contract, and the file of its truth elsewhere."""

from __future__ import annotations

import gzip
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from pa10cal.arm.description import Arm
from pa10cal.errors import SimulationError, fits_a_folder
from pa10cal.files.arms import arm_names, arm_text, load_arm
from pa10cal.files.output import is_partial, whole_file, write_text, writing_into
from pa10cal.files.table_cells import csv_text
from pa10cal.results.codec import write
from pa10cal_lab.cell.campaign import REFERENCE_TEMPERATURE_C, SimulatedCampaign
from pa10cal_lab.cell.disturbances import disturb
from pa10cal_lab.cell.mechanism import GRAVITY_M_S2
from pa10cal_lab.cell.raw_log import RawLog
from pa10cal_lab.cell.robot import Robot
from pa10cal_lab.trial_records import (
    TrueDisturbance,
    TrueEffect,
    TrueParameter,
    TrueTool,
    TruthRecord,
)

#: Where the disturbances of a campaign are, one entry each in the order of the settings: poses,
#: joints, loads or keys.
Places = tuple[tuple[str, ...], ...]

CAMPAIGN_SCHEMA = "pa10cal-campaign/1"
DESCRIPTION_FILE = "campaign.yaml"
PROVENANCE = (
    "synthetic: written by this project's own virtual cell, not measured on a robot; "
    "what effects it hides, if any, is not told here"
)


def write_campaign(campaign: SimulatedCampaign, folder: Path, truth: Path | None = None) -> Places:
    """Write a campaign's folder and, where requested, its truth elsewhere.

    An arm that is not shipped is described in the folder. The campaign's description comes last,
    so that a folder with a description is whole.

    Args:
        folder: the campaign's folder; files of the same names are replaced, any other is refused.
        truth: the file for what is hidden; None for none.

    Returns:
        Where each disturbance of the settings was put.

    Raises:
        SimulationError: when the truth would lie inside the folder, when a file stands where the
            folder or a folder where a file is to be, when the folder holds anything that is not of
            this campaign, or when the arm's name is none of a file beside the campaign's.
        OutputError: when a file cannot be written; where it is that of the truth, a former campaign
            in the folder stays whole.
    """
    instrument, settings = campaign.instrument, campaign.settings
    log = RawLog.of(campaign_description(campaign), campaign.tables, campaign.truth.robot.arm)
    places = disturb(log, settings.disturbances, settings.random_seed)
    arm = log.arm
    described = {} if _is_shipped(arm) else {f"{arm.name}.yaml": arm_text(arm)}
    if described and not fits_a_folder(arm.name):
        raise SimulationError(
            "the name of the arm is none of a file",
            where="robot",
            value=arm.name,
            allowed="a name without folders",
            remedy="give the arm another name",
        )
    if any(name.casefold() == DESCRIPTION_FILE for name in described):
        raise SimulationError(
            "the campaign's own description has the file that the name of the arm asks for",
            where="robot",
            value=arm.name,
            allowed=f"an arm whose description is not {DESCRIPTION_FILE}",
            remedy="give the arm another name",
        )
    _check_folder(folder, truth, [*instrument.files.values(), *described])
    if truth is not None:
        write(truth_record(campaign, places), truth)
    with writing_into(folder, "the campaign", "give another folder, or let it be written to"):
        (folder / DESCRIPTION_FILE).unlink(missing_ok=True)
    for key, name in instrument.files.items():
        write_table(log.tables[key], folder / name, instrument.decimals)
    for name, text in described.items():
        write_text(folder / name, text)
    text = yaml.safe_dump(log.description, sort_keys=False, default_flow_style=None, width=90)
    write_text(folder / DESCRIPTION_FILE, text)
    return places


def campaign_description(campaign: SimulatedCampaign) -> dict[str, Any]:
    """Return the content of campaign.yaml, as in the raw-data contract."""
    robot = campaign.truth.robot
    return {
        "schema": CAMPAIGN_SCHEMA,
        "name": campaign.name,
        "robot": robot.arm.name,
        "provenance": PROVENANCE,
        **campaign.instrument.description(robot),
        "gravity_m_s2": GRAVITY_M_S2.tolist(),
        "reference_temperature_C": REFERENCE_TEMPERATURE_C,
        "files": dict(campaign.instrument.files),
    }


def truth_record(campaign: SimulatedCampaign, places: Places) -> TruthRecord:
    """Return all that a campaign hides; no estimate reads it.

    Args:
        places: where each disturbance of its settings was put, one entry each.
    """
    truth, settings = campaign.truth, campaign.settings
    robot, mechanism = truth.robot, truth.robot.mechanism
    payload, targets, poses = mechanism.payload, robot.targets, truth.poses
    return TruthRecord(
        campaign=campaign.name,
        robot=robot.arm.name,
        random_seed=settings.random_seed,
        kcub_reading=robot.springs.source,
        parameters=_parameters(robot),
        T_instr_base_m=robot.T_instr_base,
        joint_placements_m=mechanism.placements,
        T_last_joint_ee_m=mechanism.T_last_ee,
        T_ee_target_m=robot.T_ee_target,
        mass_kg=mechanism.mass_kg,
        com_in_joint_frame_m=mechanism.com_m,
        tool=TrueTool(
            mass_kg=payload.mass_kg,
            com_m=payload.com_m,
            load_point_m=payload.load_point_m,
            targets_m=dict(zip(targets.names, targets.p_ee_m, strict=True)),
        ),
        hidden_effects=tuple(
            TrueEffect(id=effect.id, of=effect.of, parameters=effect.model_dump(mode="json"))
            for effect in truth.effects
        ),
        disturbances=tuple(
            TrueDisturbance(id=entry.id, where=where)
            for entry, where in zip(settings.disturbances, places, strict=True)
        ),
        settings=settings.model_dump(mode="json"),
        poses_rad_or_m={}
        if poses is None
        else {field.name: getattr(poses, field.name) for field in fields(poses)},
        q_motor_rad_or_m=truth.q_motor,
    )


def write_table(table: pd.DataFrame, path: Path, decimals: Mapping[str, int]) -> None:
    """Write a CSV, gzipped if its name says so, whose bytes depend on the table alone.

    Args:
        table: what to write; nan leaves a cell empty.
        decimals: how many a column has, by the end of its name; others are written as they are.
    """
    columns = [_as_text(table[name], decimals) for name in table.columns]
    content = csv_text(table.columns, zip(*columns, strict=True)).encode()
    if path.suffix == ".gz":
        packed = BytesIO()
        with gzip.GzipFile(
            filename="", mode="wb", fileobj=packed, compresslevel=6, mtime=0
        ) as file:
            file.write(content)
        content = packed.getvalue()
    with whole_file(path) as beside:
        beside.write_bytes(content)


def _parameters(robot: Robot) -> dict[str, TrueParameter]:
    """Return departures and springs by name; a row has no beta or no d, as its maker says.

    A robot whose axes depart in any way has no departures of rows.
    """
    parameters: dict[str, TrueParameter] = {}
    for name, value in {} if robot.departures is None else robot.departures.by_name.items():
        _, kind, row = name.split("_")
        if kind != ("d" if robot.arm.hayati[int(row) - 1] else "beta"):
            unit = "m" if kind in ("a", "d") else "rad"
            parameters[name] = TrueParameter(value=value, unit=unit)
    for joint in np.flatnonzero(robot.springs.flexible).tolist():
        k_lin, k_cub = float(robot.springs.k_lin[joint]), float(robot.springs.k_cub[joint])
        parameters[f"K_lin_{joint + 1}"] = TrueParameter(value=k_lin, unit="N m/rad")
        parameters[f"K_cub_{joint + 1}"] = TrueParameter(value=k_cub, unit="N m/rad^3")
    return parameters


def _is_shipped(arm: Arm) -> bool:
    """Return whether an arm is a shipped one; one from a file may differ from that of its name."""
    return arm.name in arm_names() and arm_text(arm) == arm_text(load_arm(arm.name))


def _check_folder(folder: Path, truth: Path | None, files: Sequence[str]) -> None:
    """Make sure that a campaign may be written."""
    if truth is not None and truth.resolve().is_relative_to(folder.resolve()):
        raise SimulationError(
            "the truth must not lie in the campaign's folder",
            where="--truth",
            value=str(truth),
            allowed="a path outside the campaign's folder",
            remedy="name another place",
        )
    standing = next(place for place in (folder, *folder.parents) if os.path.lexists(place))
    if not standing.is_dir():
        raise SimulationError(
            "something other than a folder is there",
            where="--out",
            value=str(standing),
            allowed="a new folder, or one of a campaign",
            remedy="name another folder",
        )
    own = {DESCRIPTION_FILE, *files}
    # What a killed run left half-written goes as files are written anew.
    entries = [entry for entry in folder.glob("*") if not is_partial(entry)]
    foreign = sorted(entry.name for entry in entries if entry.name not in own or entry.is_dir())
    if foreign:
        raise SimulationError(
            "the folder holds something that is not of this campaign",
            where="--out",
            value=", ".join(foreign),
            allowed=f"a new folder, or one with the files {', '.join(sorted(own))} only",
            remedy="name another folder or move the files away",
        )


def _as_text(column: pd.Series[Any], decimals: Mapping[str, int]) -> list[str]:
    """Return the cells of a column; one without a value, as nan or None, is empty."""
    as_text = _form_of(column, decimals)
    empty = column.isna().tolist()
    return ["" if no else as_text(value) for value, no in zip(column.tolist(), empty, strict=True)]


def _form_of(column: pd.Series[Any], decimals: Mapping[str, int]) -> Callable[[Any], str]:
    """Return how values of a column are written: with decimals, in full as a float, or as text."""
    places = next(
        (count for end, count in decimals.items() if str(column.name).endswith(end)), None
    )
    if places is not None:
        minus_zero = f"-{0.0:.{places}f}"

        def with_decimals(value: float) -> str:
            text = f"{value:.{places}f}"
            return text.removeprefix("-") if text == minus_zero else text

        return with_decimals
    if column.dtype.kind == "f":  # a load, whole newtons as a rule
        return lambda value: repr(value + 0.0).removesuffix(".0")
    return str
