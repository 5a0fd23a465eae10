"""Held-out poses judged with a general model, whatever the instrument saw of them."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pa10cal.arm.description import Arm
from pa10cal.calibration.general.case import FittedModel
from pa10cal.calibration.general.deviation import (
    SeenDeviations,
    accuracy_by_load,
    accuracy_seen,
)
from pa10cal.campaign.description import Campaign
from pa10cal.campaign.seen import SeenPoses, Sightings
from pa10cal.campaign.sightings import sightings
from pa10cal.evaluation.tool_twist import constant_tool_twist
from pa10cal.fit.loads import with_torques
from pa10cal.stages.general_record import read_general
from pa10cal.stages.measurement_setup import payload_of

Array = NDArray[np.float64]


def held_out_with_torques(table: pd.DataFrame, campaign: Campaign, arm: Arm) -> Sightings:
    """Return what was seen of the held-out poses, with torques as springs need them."""
    found = sightings(table, campaign, "holdout")
    states, _ = with_torques(arm, found.states, payload_of(campaign, arm))
    return replace(found, states=states)


def general_models(record: dict[str, Any], arm: Arm, path: Path) -> dict[str, FittedModel]:
    """Return the models of a general calibration by the names under which they are evaluated."""
    models = {"uncalibrated": read_general(record, arm, path, "nominal")}
    if record["springs"]:
        models["geometry"] = read_general(record, arm, path, "geometry")
    return models | {"linear": read_general(record, arm, path)}


def judged_record(
    model: FittedModel, held_out: Sightings, extrapolated: NDArray[np.bool_] | None = None
) -> dict[str, Any]:
    """Return errors of one model over held-out poses, by load, by point and pose by pose.

    Args:
        model: the model; its terms find in the states what they need.
        held_out: P poses.
        extrapolated: (P,) which of them leave the joint angles that the model has learnt from;
            None where it has learnt nothing that stops there.
    """
    found = model.deviations(held_out)
    record = {
        **asdict(accuracy_seen(found)),
        "per_load": {
            f"{load:g}N": asdict(accuracy)
            for load, accuracy in accuracy_by_load(found, held_out.states.load_N).items()
        },
        "per_point": {
            str(label): asdict(accuracy_seen(found.take(held_out.pose == label)))
            for label in _points(held_out)
        },
        "tool_twist": _twist(model, held_out),
        "rows": _rows(found, held_out, extrapolated),
    }
    if extrapolated is not None:
        for name, rows in (("inside", ~extrapolated), ("extrapolated", extrapolated)):
            record[name] = asdict(accuracy_seen(found.take(rows))) if rows.any() else None
    return record


#: More points than this are listed pose by pose only.
_MOST_POINTS = 500


def _points(held_out: Sightings) -> NDArray[np.str_]:
    labels = np.unique(held_out.pose)
    return labels if len(labels) <= _MOST_POINTS else labels[:0]


def _twist(model: FittedModel, held_out: Sightings) -> dict[str, Any] | None:
    seen = held_out.seen
    if not isinstance(seen, SeenPoses):
        return None
    T_base_ee = model.model.predict(held_out.states, model.x)
    R_measured = seen.T_instr_target[:, :3, :3] @ model.R_ee_target.T
    twist = constant_tool_twist(model.T_instr_base[:3, :3] @ T_base_ee[:, :3, :3], R_measured)
    return {**asdict(twist), "rotation_deg": twist.rotation_deg.tolist()}


def _rows(
    found: SeenDeviations, held_out: Sightings, extrapolated: NDArray[np.bool_] | None
) -> list[dict[str, Any]]:
    turned = found.rotation_deg
    return [
        {
            "pose": str(held_out.pose[k]),
            "load_N": float(held_out.states.load_N[k]),
            "position_mm": found.vector_mm[k].tolist(),
            "error_mm": float(found.distance_mm[k]),
            "rotation_deg": None if turned is None else turned[k].tolist(),
            "extrapolated": None if extrapolated is None else bool(extrapolated[k]),
        }
        for k in range(len(held_out))
    ]
