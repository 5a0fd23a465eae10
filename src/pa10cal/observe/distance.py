"""An instrument that measures the distance of one target from a fixed point.

The distance is that from the origin of the instrument's frame: the place of the fixed point is the
base frame's position, and its attitude does not matter.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from pa10cal.frame.ranging import range_from_distances
from pa10cal.observe.instrument import (
    MM,
    Array,
    Comparison,
    Deviations,
    Index,
    Instrument,
    Start,
    Stated,
    Words,
    group_means,
)
from pa10cal.observe.targets import by_end_and_targets, carried_targets


@dataclass(frozen=True)
class Distance(Instrument):
    """Distances of one target from a fixed point in P poses.

    Attributes:
        d_m: (P,) distances.
        u_m: (P,) their standard uncertainties.
    """

    d_m: Array
    u_m: Array

    determines_attitude: ClassVar[bool] = False
    kind: ClassVar[str] = "distance"
    words: ClassVar[Words] = Words(
        "distance error",
        "Errors are of the distance measured: what is across the line of sight does not show.",
        "Arrows lie along the line of sight: what is across it does not show.",
    )

    def __len__(self) -> int:
        return len(self.d_m)

    @override
    def averaged(self, code: Index) -> Self:
        """Average readings of each group."""
        u_m = np.sqrt(group_means(self.u_m**2, code) / np.bincount(code))
        return replace(self, d_m=group_means(self.d_m, code), u_m=u_m)

    @override
    def ideal(self, T_instr_ee: Array, targets_m: Array) -> Self:
        """Return what it would measure of poses (P, 4, 4) without error."""
        p_instr_m, _ = carried_targets(T_instr_ee, targets_m)
        d_m = np.linalg.norm(p_instr_m[:, 0], axis=1)
        return replace(self, d_m=d_m, u_m=np.ones(len(d_m)))

    @property
    @override
    def target_names(self) -> tuple[str, ...]:
        """Return the one target, which has no name."""
        return ("",)

    @override
    def compare(self, T_instr_ee: Array, targets_m: Array) -> Comparison:
        """Compare predicted with measured distances."""
        p_instr_m, arms = carried_targets(T_instr_ee, targets_m)
        by_end, by_targets = by_end_and_targets(T_instr_ee, arms)
        distance = np.linalg.norm(p_instr_m[:, 0], axis=1)
        along = p_instr_m[:, 0] / distance[:, None]
        return Comparison(
            (distance - self.d_m)[:, None],
            np.einsum("pi,pij->pj", along, by_end[:, 0])[:, None],
            np.einsum("pi,pij->pj", along, by_targets[:, 0])[:, None],
        )

    @property
    @override
    def components_seen(self) -> NDArray[np.bool_]:
        """Return that the distance was measured in each pose, (P, 1)."""
        return np.ones((len(self), 1), dtype=bool)

    @property
    @override
    def stated_covariance(self) -> Array:
        """Return the stated variance, (P, 1, 1)."""
        return (self.u_m**2)[:, None, None]

    @property
    @override
    def component_kinds(self) -> tuple[tuple[str, slice], ...]:
        """Distances."""
        return (("distance", slice(0, 1)),)

    @override
    def find_start(self, T_base_ee: Array) -> Start:
        """Find fixed point and target by ranging; the base's attitude stays that of the base."""
        ranged = range_from_distances(T_base_ee, self.d_m)
        T_instr_base = np.eye(4)
        T_instr_base[:3, 3] = -ranged.p_base_point_m
        return Start(T_instr_base, np.zeros(3), np.eye(3), ranged.p_ee_target_m)

    @override
    def deviations(self, T_base_ee: Array, T_instr_base: Array, targets_m: Array) -> Deviations:
        """Compare predicted with measured distances; the vector is along the line of sight."""
        T_instr_ee = T_instr_base @ T_base_ee
        p_instr_m, _ = carried_targets(T_instr_ee, targets_m)
        distance = np.linalg.norm(p_instr_m[:, 0], axis=1)
        off_m, along = distance - self.d_m, p_instr_m[:, 0] / distance[:, None]
        position_mm = 1e3 * (off_m[:, None] * along) @ T_instr_base[:3, :3]
        return Deviations(1e3 * np.abs(off_m), position_mm, None)

    @property
    @override
    def spread_mm(self) -> float:
        """Return how far the distances spread about their middle, rms."""
        return 1e3 * float(np.std(self.d_m))

    @classmethod
    @override
    def from_columns(cls, columns: Mapping[str, Array], stated: Stated) -> Self:
        """Read P poses from columns (P,) of the table of poses."""
        return cls(MM * columns["d_mm"], MM * columns["d_u_mm"])
