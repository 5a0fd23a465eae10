"""Where arm and tool may go, and configurations drawn there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.room import Above, OffColumn, OffLinks, Postures, admissible
from pa10cal.arrays import Array
from pa10cal.discovery.preparation import MeasurementSetup, targets_m
from pa10cal.errors import DiscoveryError
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations

_DRAWN_AT_ONCE = 20_000
_MOST_DRAWS = 15


class Measured(Protocol):
    """A campaign whose candidate context is needed."""

    @property
    def baseline(self) -> FittedModel:
        """Return the calibrated model."""

    @property
    def setup(self) -> MeasurementSetup:
        """Return what is known besides the poses."""

    @property
    def cells(self) -> Observations:
        """Return the measured poses."""


@dataclass(frozen=True)
class Room:
    """Where arm and tool may go."""

    limit_margin: float = 0.05  # part of each joint's range kept clear at either end
    # the end stays in the box of the measured places, so many times as large ..
    volume_factor: float = 2.0
    least_margin_m: float = 0.3  # ... and at least so much larger on every side.
    # end and targets stay so far above the base's origin, along the base's z axis
    floor_m: float = 0.15
    column_m: float = 0.25  # end and targets stay so far off the base's axis
    clearance_m: float = 0.15  # targets stay so far off the line from joint to joint


def draw_admissible(problem: Measured, count: int, room: Room, rng: np.random.Generator) -> Array:
    """Draw configurations evenly in joint space, and keep those within the room.

    Whether links, rods and instrument collide otherwise is not looked at.

    Args:
        problem: gives arm, tool and measured places.
        count: N, how many are wanted.
        room: where arm and tool may go.
        rng: draws them.

    Returns:
        (N, n) joint angles [rad, or m of a prismatic joint].

    Raises:
        DiscoveryError: when none is found.
    """
    low, high = problem.baseline.model.chain.arm.limits_rad.T
    margin = room.limit_margin * (high - low)
    found: list[Array] = []
    for _ in range(_MOST_DRAWS):
        q_rad = rng.uniform(low + margin, high - margin, (_DRAWN_AT_ONCE, len(low)))
        found.append(q_rad[_is_admissible(problem, q_rad, room)])
        if sum(map(len, found)) >= count:
            break
    if not sum(map(len, found)):
        raise DiscoveryError(
            "no configuration keeps clear of floor, column and limits near the measured positions",
            where="configurations to measure next",
            value=f"none of {_MOST_DRAWS * _DRAWN_AT_ONCE}",
            allowed="at least one",
            remedy="allow more room",
        )
    return np.concatenate(found)[:count]


def _is_admissible(problem: Measured, q_rad: Array, room: Room) -> NDArray[np.bool_]:
    """Return which configurations (P, n) keep within the room, (P,), by the nominal chain."""
    at = Postures.of(
        problem.baseline.model.chain,
        q_rad,
        targets_m(problem.baseline, problem.setup).reshape(-1, 3),
    )
    T_instr_base = problem.baseline.T_instr_base
    p_instr_end = at.p_base_end @ T_instr_base[:3, :3].T + T_instr_base[:3, 3]
    low, high = _box(problem, room)
    within = np.all((p_instr_end > low) & (p_instr_end < high), axis=1)
    keeps, _ = admissible(
        at, [Above(room.floor_m), OffColumn(room.column_m), OffLinks(room.clearance_m)]
    )
    return np.asarray(within & keeps, dtype=np.bool_)


def _box(problem: Measured, room: Room) -> tuple[Array, Array]:
    """Return the corners (3,), (3,) of where the end may be, in the instrument's frame."""
    measured = measured_ends_m(problem)
    low, high = measured.min(axis=0), measured.max(axis=0)
    margin = np.maximum(0.5 * (room.volume_factor - 1.0) * (high - low), room.least_margin_m)
    return low - margin, high + margin


def measured_ends_m(problem: Measured) -> Array:
    """Return where the end was in the measured poses, (P, 3), in the instrument's frame."""
    cells, at = problem.cells, problem.baseline
    T_instr_ee = at.T_instr_base @ at.model.predict(cells.states, at.x)
    return cells.measured.end_poses(T_instr_ee)[:, :3, 3]
