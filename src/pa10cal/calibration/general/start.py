"""Frames and targets from which a fit starts, by the nominal arm."""

from __future__ import annotations

import numpy as np

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.errors import RecordError
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations
from pa10cal.observe.quantities import Start
from pa10cal.results.seed import BaseFrameRecord


def find_start(arm: Arm, observations: Observations) -> Start:
    """Find frames and targets by the nominal arm, from any place of instrument and target.

    Raises:
        CalibrationError: when the poses do not determine them.
    """
    T_base_ee = Chain.of(arm).forward(observations.states.q_rad)
    return observations.measured.find_start(T_base_ee)


def start_of(seed: BaseFrameRecord, measured: Instrument) -> Start:
    """Return where frames and targets are, from `seed/base_frame.json`.

    Args:
        seed: what it holds.
        measured: by which instrument.

    Raises:
        RecordError: when it lacks a target.
    """
    stated, target_names = seed.p_ee_targets_m or {}, measured.target_names
    missing = [name for name in target_names if name not in stated]
    if missing:
        raise RecordError(
            f"the record lacks target {missing[0]}",
            where=f"{seed.FILE}: p_ee_targets_m",
            value=list(stated),
            allowed="a position for every target",
            remedy="run pa10cal seed again",
        )
    T_ee_target = np.eye(4) if seed.T_ee_target is None else seed.T_ee_target
    targets_m = np.concatenate([np.zeros(0), *(stated[name] for name in target_names)])
    tools_m = {name: T[:3, 3] for name, T in (seed.T_ee_target_of or {}).items()}
    return Start(seed.T_instr_base, T_ee_target[:3, 3], T_ee_target[:3, :3], targets_m, tools_m)
