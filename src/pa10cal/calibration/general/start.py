"""Frames and targets from which a fit starts, by the nominal arm."""

from __future__ import annotations

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.observe.observations import Observations
from pa10cal.observe.quantities import Start


def find_start(arm: Arm, observations: Observations) -> Start:
    """Find frames and targets by the nominal arm, from any place of instrument and target.

    Raises:
        CalibrationError: when the poses do not determine them.
    """
    T_base_ee = Chain.of(arm).forward(observations.states.q_rad)
    return observations.measured.find_start(T_base_ee)
