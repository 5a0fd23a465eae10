"""Held-out poses judged with a general model, whatever the instrument saw of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.description import Arm
from pa10cal.calibration.accuracy import summarise, summarise_by_load
from pa10cal.calibration.general.case import FittedModel
from pa10cal.calibration.records import by_load
from pa10cal.campaign.description import Campaign
from pa10cal.evaluation.tool_twist import constant_tool_twist
from pa10cal.fit.loads import with_torques
from pa10cal.observe.averages import average_repeats
from pa10cal.observe.observations import Observations
from pa10cal.results.accuracy import Accuracy
from pa10cal.results.calibration import GeneralCalibrationRecord
from pa10cal.results.evaluation import HeldOutModel, HeldOutRows, ToolTwist
from pa10cal.stages.general_record import read_general
from pa10cal.stages.measurement_setup import payload_of

Array = NDArray[np.float64]


def held_out_with_torques(every: Observations, campaign: Campaign, arm: Arm) -> Observations:
    """Return what was seen of the held-out poses, with torques as springs need them."""
    found = average_repeats(every.of_kind("holdout"))
    states, _ = with_torques(arm, found.states, payload_of(campaign, arm))
    return replace(found, states=states)


def general_models(
    record: GeneralCalibrationRecord, arm: Arm, path: Path
) -> dict[str, FittedModel]:
    """Return the models of a general calibration by the names under which they are evaluated."""
    models = {"uncalibrated": read_general(record, arm, path, "nominal")}
    if record.springs:
        models["geometry"] = read_general(record, arm, path, "geometry")
    return models | {"linear": read_general(record, arm, path)}


def judged_record(
    model: FittedModel, held_out: Observations, extrapolated: NDArray[np.bool_] | None = None
) -> HeldOutModel:
    """Return errors of one model over held-out poses, by load, by point and pose by pose.

    Args:
        model: the model; its terms find in the states what they need.
        held_out: P poses.
        extrapolated: (P,) which of them leave the joint angles that the model has learnt from;
            None where it has learnt nothing that stops there.
    """
    found = model.deviations(held_out)

    def errors(rows: NDArray[np.bool_] | None) -> Accuracy | None:
        return summarise(found.take(rows)) if rows is not None and rows.any() else None

    return HeldOutModel(
        **dict(summarise(found)),
        per_load=by_load(summarise_by_load(found, held_out.states.load_N)),
        per_point={
            str(label): summarise(found.take(held_out.pose == label)) for label in _points(held_out)
        },
        tool_twist=_twist(model, held_out),
        inside=errors(None if extrapolated is None else ~extrapolated),
        extrapolated=errors(extrapolated),
        rows=HeldOutRows(
            pose=held_out.pose,
            load_N=held_out.states.load_N,
            position_mm=found.position_mm,
            error_mm=found.distance_mm,
            rotation_deg=found.rotation_deg,
            extrapolated=extrapolated,
        ),
    )


#: More points than this are listed pose by pose only.
_MOST_POINTS = 500


def _points(held_out: Observations) -> NDArray[np.str_]:
    labels = np.unique(held_out.pose)
    return labels if len(labels) <= _MOST_POINTS else labels[:0]


def _twist(model: FittedModel, held_out: Observations) -> ToolTwist | None:
    R_instr_target = held_out.measured.R_instr_target
    if R_instr_target is None:
        return None
    T_base_ee = model.model.predict(held_out.states, model.x)
    R_measured = R_instr_target @ model.R_ee_target.T
    return constant_tool_twist(model.T_instr_base[:3, :3] @ T_base_ee[:, :3, :3], R_measured)
