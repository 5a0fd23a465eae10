"""The state of the arm in each measured pose: all that a model may depend on."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PoseStates:
    """States of P poses of an arm with n joints.

    Attributes:
        q_rad: (P, n) motor-side joint positions after the gear ratio.
        tau_Nm: (P, n) joint torques that hold the arm.
        arrival: (P, n) direction in which each joint arrived: -1, 0 (did not move) or +1.
        load_N: (P,) external load.
        temperature_C: (P,) temperature.
        time_s: (P,) time of the reading.
    """

    q_rad: Array
    tau_Nm: Array
    arrival: Array
    load_N: Array
    temperature_C: Array
    time_s: Array

    def __len__(self) -> int:
        return len(self.q_rad)

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.q_rad.shape[1])

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_] | slice) -> PoseStates:
        """Return the states of some poses."""
        return PoseStates(*(getattr(self, field.name)[rows] for field in fields(self)))
