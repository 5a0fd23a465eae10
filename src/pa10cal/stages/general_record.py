"""Where frames and targets are, from the record of the seed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pa10cal.errors import RecordError
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.quantities import Start
from pa10cal.results.seed import BaseFrameRecord

Array = NDArray[np.float64]


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
