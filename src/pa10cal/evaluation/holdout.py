"""Models judged on held-out points and loads (paper, Section II.E and Fig. 6)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.calibration.accuracy import (
    Accuracy,
    deviations,
    summarise,
    summarise_by_load,
)
from pa10cal.evaluation.tool_twist import ToolTwist, constant_tool_twist
from pa10cal.observe.instrument import Deviations
from pa10cal.observe.observations import Observations
from pa10cal.observe.pose import Pose

Array = NDArray[np.float64]


@dataclass(frozen=True)
class HeldOut:
    """One model on the held-out configurations.

    Attributes:
        overall: over all of them.
        by_load: for every load.
        by_point: for every point, over its loads.
        found: deviations, configuration by configuration.
        tool_twist: what a constant twist of the tool would explain of the orientation error.
    """

    overall: Accuracy
    by_load: dict[float, Accuracy]
    by_point: dict[str, Accuracy]
    found: Deviations
    tool_twist: ToolTwist


def judge(T_base_ee: Array, T_instr_base: Array, observations: Observations[Pose]) -> HeldOut:
    """Judge predictions T_base_ee (P, 4, 4) on held-out configurations."""
    found = deviations(T_base_ee, T_instr_base, observations)
    R_predicted = T_instr_base[:3, :3] @ T_base_ee[:, :3, :3]
    return HeldOut(
        overall=summarise(found),
        by_load=summarise_by_load(found, observations.states.load_N),
        by_point={
            str(label): summarise(found, observations.pose == label)
            for label in np.unique(observations.pose)
        },
        found=found,
        tool_twist=constant_tool_twist(
            R_predicted, observations.measured.T_instr_target[:, :3, :3]
        ),
    )
