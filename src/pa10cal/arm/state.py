"""The state of the arm in each measured pose: all that a model may depend on."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array

Rows = NDArray[np.intp] | NDArray[np.bool_] | slice


@dataclass(frozen=True)
class StaticLoads:
    """What weights bend the structure with in P poses; see `arm.statics`."""

    # (P, n, 3) moment that each link carries at its far end, where the next joint turns, along the
    # axes of that end (zero for the last link)
    link_Nm: Array
    base_Nm: Array  # (P, 3) overturning moment about the base's origin, along base axes
    joint_Nm: Array  # (P, n) torques with which the joints hold links, apparatus and load
    down_ee: Array  # (P, 3) direction of gravity along the end-effector's axes, a unit vector
    # (P, n, 4 n + 3) derivative of `joint_Nm` by the mass of every link, which sits at its centre,
    # and by its first moment about that; by the mass of the apparatus; and by two small turns of
    # gravity
    by_weights: Array
    by_load: Array  # (P, n) derivative of `joint_Nm` by the external load [N m/N]


@dataclass(frozen=True)
class ObservedTargets:
    """How P measured poses were read from B targets of the instrument."""

    p_instr_targets_m: Array  # (P, B, 3) places of the targets in the instrument's frame
    # (P, 6, 3 B) derivative of the pose (position, small rotation, along the end-effector's axes)
    # by what the instrument reads too much of each target's place
    pose_by_targets: Array


@dataclass(frozen=True)
class PoseStates:
    """States of P poses of an arm with n joints."""

    # (P, n) motor-side joint positions after the gear ratio; metres where a joint slides
    q_rad: Array
    tau_Nm: Array  # (P, n) joint torques that hold the arm
    arrival: Array  # (P, n) direction in which each joint arrived: -1, 0 (did not move) or +1
    load_N: Array  # (P,) external load
    temperature_C: Array  # (P,) temperature
    time_s: Array  # (P,) time of the reading
    # what weights bend the structure with, where it was computed
    static_loads: StaticLoads | None = None
    # how the pose was read from the instrument's targets, where it was computed
    seen: ObservedTargets | None = None
    # (P,) which campaign of a group each pose is of, from 0; None where there is one, or where no
    # campaign is meant: then what belongs to a campaign is that of the first
    campaign: NDArray[np.intp] | None = None
    # (P, n) direction in which each joint moved from the pose before: -1, 0 (it stayed) or +1;
    # None where `arrival` says so
    moved: Array | None = None
    # (P,) whether `time_s` tells time; where it does not, as where times were not recorded or the
    # order goes with a joint or a load, it gives an order alone. None where all do.
    timed: NDArray[np.bool_] | None = None

    def __len__(self) -> int:
        return len(self.q_rad)

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.q_rad.shape[1])

    @property
    def since_before(self) -> Array:
        """Direction in which each joint moved from the pose before, 0 where it stayed, (P, n)."""
        return self.arrival if self.moved is None else self.moved

    @property
    def tells_time(self) -> bool:
        """Whether what goes with time can be told from these poses."""
        return self.timed is None or bool(self.timed.all())

    def take(self, rows: Rows) -> PoseStates:
        """Return the states of some poses."""
        return PoseStates(*(_rows(getattr(self, field.name), rows) for field in fields(self)))


def _rows(
    value: Array | NDArray[np.intp] | NDArray[np.bool_] | StaticLoads | ObservedTargets | None,
    rows: Rows,
) -> Any:
    """Return some rows of an array, or of every array of a group of them."""
    if isinstance(value, StaticLoads | ObservedTargets):
        return type(value)(*(getattr(value, field.name)[rows] for field in fields(value)))
    return None if value is None else value[rows]
