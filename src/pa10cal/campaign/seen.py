"""What an instrument saw of P poses, as plain arrays."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.state import PoseStates

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Rows = Index | NDArray[np.bool_] | slice


@dataclass(frozen=True)
class SeenPoses:
    """Position and attitude of one target in P poses.

    Attributes:
        T_instr_target: (P, 4, 4) target in the instrument's frame [m]: for balls that are touched
            the end-effector itself, by the balls' stated places.
        cov: (P, 6, 6) covariance of position [m] and of a small rotation [rad] applied on the
            left, both along the instrument's axes.
    """

    T_instr_target: Array
    cov: Array

    def take(self, rows: Rows) -> SeenPoses:
        """Return what was seen in some of the poses."""
        return SeenPoses(self.T_instr_target[rows], self.cov[rows])


@dataclass(frozen=True)
class SeenPoints:
    """Positions of B targets in P poses.

    Attributes:
        names: (B,) names of the targets.
        p_instr_m: (P, B, 3) positions in the instrument's frame, nan where a target was not seen.
        cov_m2: (P, B, 3, 3) their covariances, nan where a target was not seen.
        p_ee_stated_m: (B, 3) places of the targets in the end-effector frame as the campaign's
            description states them, or None where it does not state them all.
    """

    names: tuple[str, ...]
    p_instr_m: Array
    cov_m2: Array
    p_ee_stated_m: Array | None

    def take(self, rows: Rows) -> SeenPoints:
        """Return what was seen in some of the poses."""
        return SeenPoints(self.names, self.p_instr_m[rows], self.cov_m2[rows], self.p_ee_stated_m)


@dataclass(frozen=True)
class SeenDistances:
    """Distances of one target from a fixed point in P poses.

    Attributes:
        d_m: (P,) distances.
        u_m: (P,) their standard uncertainties.
    """

    d_m: Array
    u_m: Array

    def take(self, rows: Rows) -> SeenDistances:
        """Return what was seen in some of the poses."""
        return SeenDistances(self.d_m[rows], self.u_m[rows])


@dataclass(frozen=True)
class Sightings:
    """P poses and what the instrument saw in each, ordered by pose and load.

    Attributes:
        pose: (P,) labels; the same label is the same command.
        states: state of the arm in each pose.
        seen: what was seen, by the instrument's kind.
        repeats: (P,) readings averaged into each row.
    """

    pose: NDArray[np.str_]
    states: PoseStates
    seen: SeenPoses | SeenPoints | SeenDistances
    repeats: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.pose)

    def take(self, rows: Rows) -> Sightings:
        """Return some of the poses."""
        return Sightings(*(_some(getattr(self, field.name), rows) for field in fields(self)))


def _some(value: Any, rows: Rows) -> Any:
    """Return some rows of an array, or of what holds arrays."""
    return value[rows] if isinstance(value, np.ndarray) else value.take(rows)
