"""Measured poses as plain arrays, the form in which calibration takes them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.state import PoseStates

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PoseObservations:
    """P measured poses of the end-effector.

    Attributes:
        pose: (P,) labels; the same label is the same command.
        states: state of the arm in each pose.
        T_instr_ee: (P, 4, 4) measured end-effector in the instrument's frame [m].
        cov_ee: (P, 6, 6) covariance of position [m] and of a small rotation [rad] applied on the
            left, both along the instrument's axes.
        by_apparatus: (P, 6, a) derivative of the measured pose (position, small left rotation) by
            the a coordinates of the targets' places on the apparatus [m], which are wrong alike in
            every pose; a = 0 where the instrument measures the pose itself.
        repeats: (P,) readings averaged into each row.
    """

    pose: NDArray[np.str_]
    states: PoseStates
    T_instr_ee: Array
    cov_ee: Array
    by_apparatus: Array
    repeats: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.pose)

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_] | slice) -> PoseObservations:
        """Return some of the poses."""
        return PoseObservations(
            self.pose[rows],
            self.states.take(rows),
            self.T_instr_ee[rows],
            self.cov_ee[rows],
            self.by_apparatus[rows],
            self.repeats[rows],
        )
