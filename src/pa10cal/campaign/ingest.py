"""A campaign's folder to measured configurations, whatever the instrument."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pa10cal.arm.description import Arm
from pa10cal.campaign.description import DESCRIPTION_FILE, Campaign, Holdout
from pa10cal.campaign.measured import Ingested, MeasuredPoses
from pa10cal.campaign.options import IngestOptions
from pa10cal.campaign.poses import poses_from_touches
from pa10cal.campaign.tracked import poses_from_tracker
from pa10cal.errors import RawDataError


def ingest_campaign(
    campaign: Campaign, arm: Arm, folder: Path, settings: IngestOptions
) -> Ingested:
    """Read a campaign: rows of its files to configurations, held-out poses marked.

    Args:
        campaign: its description.
        arm: the nominal arm it names.
        folder: its folder.
        settings: the `ingest` section.

    Raises:
        RawDataError: when a file, or too much of it, cannot be used, when there is no `grid` row,
            or when the arm has sliding joints and its log gives degrees.
    """
    touched = campaign.instrument.kind == "touch_trigger_cmm"
    if touched and arm.prismatic.any():
        raise RawDataError(
            "the arm has sliding joints",
            where=f"{folder / DESCRIPTION_FILE}: robot",
            value=arm.name,
            allowed="turning joints, as the resolver log gives positions in degrees",
            remedy="give the poses in files.poses, with a column in millimetres for each of them",
        )
    read = poses_from_touches if touched else poses_from_tracker
    ingested = read(campaign, arm, folder, settings)
    poses = ingested.poses
    if campaign.holdout is not None:
        poses = hold_out(poses, campaign.holdout, f"{folder / DESCRIPTION_FILE}: holdout")
    kinds = set(poses.kind)
    if "grid" not in kinds:
        raise RawDataError(
            "there is no usable grid row to calibrate with",
            where=str(folder),
            value=", ".join(sorted(kinds)),
            allowed="rows of kind grid",
            remedy="check the column kind",
        )
    lines = () if campaign.instrument.kind in ("points", "distance") else ("line_x", "line_y")
    missing = [kind for kind in (*lines, "holdout") if kind not in kinds]
    notes = (*ingested.notes, *(f"no {kind} rows" for kind in missing))
    return replace(ingested, poses=poses, left_out=tuple(sorted(ingested.left_out)), notes=notes)


def hold_out(poses: MeasuredPoses, rule: Holdout, where: str) -> MeasuredPoses:
    """Mark grid poses as held out: the last of them in time, or every so-manieth.

    All loads and repeats of a pose go together, as they are the same command.

    Args:
        poses: configurations in order of time.
        rule: which poses.
        where: file and key, for the message.

    Raises:
        RawDataError: when rows already say that they are held out.
    """
    if "holdout" in poses.kind:
        raise RawDataError(
            "held-out poses are stated both here and in the rows",
            where=where,
            allowed="one of the two",
            remedy="remove the key, or the kind holdout from the rows",
        )
    grid = poses.kind == "grid"
    labels = pd.unique(pd.Series(poses.pose[grid]))
    if rule.every is not None:
        chosen = labels[rule.every - 1 :: rule.every]
    else:
        chosen = labels[len(labels) - round((rule.last_fraction or 0.0) * len(labels)) :]
    kind = poses.kind.astype("U7")
    kind[grid & np.isin(poses.pose, np.asarray(chosen, dtype=str))] = "holdout"
    return replace(poses, kind=kind)


def repeatability_mm(poses: MeasuredPoses) -> dict[float, float]:
    """Return, for each load, the mean standard deviation of what was measured in one grid pose.

    The deviation is that of the distance from the mean of the repeats (paper, Section III), of the
    end-effector, of each target, or of the measured distance; loads without repeats are not in it.
    """
    rows = poses.take(poses.kind == "grid")
    places_mm = _places_mm(rows)
    targets, axes = places_mm.shape[1:]
    table = pd.DataFrame(places_mm.reshape(-1, axes))
    target = np.tile(np.arange(targets), len(rows))
    keys = [np.repeat(rows.load_N, targets), np.repeat(rows.pose, targets), target]
    groups = table[table[0].notna()].groupby([key[table[0].notna()] for key in keys])
    repeated = groups.size().to_numpy() > 1
    square: NDArray[np.float64] = groups.var().sum(axis=1).to_numpy()[repeated]
    load = groups.size().index.get_level_values(0).to_numpy()[repeated]
    return {float(at): float(np.sqrt(square[load == at]).mean()) for at in np.unique(load)}


def _places_mm(poses: MeasuredPoses) -> NDArray[np.float64]:
    """Return what was measured of B places, (C, B, 3), or of a distance, (C, 1, 1)."""
    if poses.d_mm is not None:
        return poses.d_mm[:, None, None]
    if poses.T_instr_ee_mm is not None:
        return poses.T_instr_ee_mm[:, None, :3, 3]
    return poses.p_instr_balls_mm
