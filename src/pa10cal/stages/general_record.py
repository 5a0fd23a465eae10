"""Fits of the general model, built again from the record of a calibration."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import Payload
from pa10cal.arm.tolerances import Tolerances
from pa10cal.calibration.general.case import FittedModel
from pa10cal.calibration.general.unknowns import tool_frame
from pa10cal.errors import RecordError
from pa10cal.fit.loads import with_torques
from pa10cal.observe.instrument import Instrument, Start
from pa10cal.observe.observations import Observations
from pa10cal.observe.pose import Pose
from pa10cal.results.calibration import GeneralCalibrationRecord, GeneralFit
from pa10cal.results.seed import BaseFrameRecord
from pa10cal.terms.joint_spring import JointSpring
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import link_departures
from pa10cal.terms.term import Term

Array = NDArray[np.float64]
#: The fits of a record: links, springs and frames; without springs; frames alone.
Which = Literal["full", "geometry", "nominal"]


def read_start(seed: BaseFrameRecord, measured: Instrument, path: Path) -> Start:
    """Return where frames and targets are, from `seed/base_frame.json`.

    Args:
        seed: what it holds.
        measured: by which instrument, which decides what of it counts.
        path: where it was read from, for the message.

    Raises:
        RecordError: when it lacks a target.
    """
    stated = seed.p_ee_targets_m or {}
    missing = [name for name in measured.target_names if name not in stated]
    if missing:
        raise RecordError(
            f"the record lacks target {missing[0]}",
            where=f"{path}: p_ee_targets_m",
            value=list(stated),
            allowed="a place for every target",
            remedy="run pa10cal seed again",
        )
    T_ee_target = np.eye(4) if seed.T_ee_target is None else seed.T_ee_target
    targets_m = np.concatenate([np.zeros(0), *(stated[name] for name in measured.target_names)])
    return Start(seed.T_instr_base, T_ee_target[:3, 3], T_ee_target[:3, :3], targets_m)


def read_general(
    record: GeneralCalibrationRecord, arm: Arm, path: Path, which: Which = "full"
) -> FittedModel:
    """Return a fit of a general model's record.

    Args:
        record: what `calibration/<load>.json` holds.
        arm: the nominal arm.
        path: where it was read from, for the message.
        which: links, springs and frames; without springs; frames alone.

    Raises:
        RecordError: when it lacks what the model needs.
    """
    solved = _fit(record, which).solved
    try:
        links = link_departures(arm, Tolerances()).only(solved.links)
        springs = tuple(
            JointSpring(spring.joint, spring.tau_ref_Nm, cubic=False) for spring in solved.springs
        )
        tool = tool_frame().only(solved.tool)
        terms: tuple[Term, ...] = (links, *springs, tool)
        if len(solved.x) != sum(len(term.parameters) for term in terms):
            raise ValueError("x does not fit the parameters")
    except (KeyError, ValueError) as error:
        raise RecordError(
            "the record lacks what its model needs",
            where=str(path),
            value=str(error),
            allowed="the solved parameters of a general model",
            remedy="run pa10cal calibrate again",
        ) from None
    T_instr_base = _fit(record, which).T_instr_base
    model = Model(Chain.of(arm), terms)
    return FittedModel(model, solved.x, T_instr_base, solved.R_ee_target, solved.places_m)


def _fit(record: GeneralCalibrationRecord, which: Which) -> GeneralFit:
    return {"full": record, "geometry": record.geometry, "nominal": record.nominal}[which]


def as_modelled(
    poses: Observations[Pose], model: FittedModel, payload: Payload | None
) -> Observations[Pose]:
    """Return measured poses as the general model predicts them.

    Attitudes are those of the end-effector in place of the target's; torques that were not logged
    are those of the masses described.
    """
    states, _ = with_torques(model.model.chain.arm, poses.states, payload)
    return poses.turned(model.R_ee_target).with_states(states)
