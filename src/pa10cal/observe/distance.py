"""An instrument that measures the distance of one target from a fixed point.

The distance is that from the origin of the instrument's frame: the place of the fixed point is the
base frame's position, and its orientation does not matter. In the frame of another instrument the
fixed point stands elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from pa10cal.arrays import Array, Index, homogeneous
from pa10cal.frame.ranging import range_from_distances
from pa10cal.frame.rigid_fit import Located, scale_of_distances
from pa10cal.observe.instrument import MM, Instrument, LocatingMethod, group_means
from pa10cal.observe.quantities import (
    Comparison,
    Deviations,
    Misfit,
    RawColumns,
    Stated,
    Unusable,
    Words,
    by_end_and_targets,
    carried_targets,
)
from pa10cal.terms.term import TermParameter

_RAW = "d_mm"
_UNNAMED = "target"
#: Columns of the table of poses that hold a fixed point that is not the frame's origin.
_POINT = ("d_from_x_m", "d_from_y_m", "d_from_z_m")


@dataclass(frozen=True)
class Distance(Instrument):
    """Distances of one target from a fixed point in P poses."""

    d_m: Array  # (P,) distances
    u_m: Array  # (P,) their standard uncertainties
    name: str = _UNNAMED  # of the target
    # (3,) its place in the end-effector frame as the campaign's description states it; None where
    # it does not
    p_ee_stated_m: Array | None = None
    # (3,) the fixed point: the frame's origin, unless it was moved
    p_instr_point_m: Array = field(default_factory=lambda: np.zeros(3))

    component_kinds: ClassVar[tuple[tuple[str, slice], ...]] = (("distance", slice(0, 1)),)
    directional: ClassVar[bool] = False
    least_rows: ClassVar[int] = 24
    _of_all: ClassVar[tuple[str, ...]] = ("name", "p_ee_stated_m", "p_instr_point_m")
    kind: ClassVar[str] = "distance"
    locates_by: ClassVar[LocatingMethod] = "ranging"
    words: ClassVar[Words] = Words(
        "instrument that measures the distance of a target from a fixed point",
        "distance error",
        "Errors are of the measured distance; errors across the line of sight are not measured.",
        "Arrows lie along the line of sight; errors across it are not measured.",
    )

    @override
    def averaged(self, code: Index) -> Self:
        u_m = np.sqrt(group_means(self.u_m**2, code) / np.bincount(code))
        return replace(self, d_m=group_means(self.d_m, code), u_m=u_m)

    @override
    def ideal(self, T_instr_ee: Array, targets_m: Array) -> Self:
        p_instr_m, _ = carried_targets(T_instr_ee, targets_m)
        d_m = np.linalg.norm(p_instr_m[:, 0] - self.p_instr_point_m, axis=1)
        return replace(self, d_m=d_m, u_m=np.ones(len(d_m)))

    @classmethod
    @override
    def foreseen(cls, T_instr_ee: Array, stated: Stated) -> Distance:
        name, place_m = next(iter(stated.targets_m.items()))
        p_instr_m, _ = carried_targets(T_instr_ee, place_m)
        d_m = np.linalg.norm(p_instr_m[:, 0], axis=1)
        return Distance(d_m, np.full(len(d_m), stated.uncertainty_m), name, place_m)

    @override
    def in_frame(self, T: Array) -> Self:
        return replace(self, p_instr_point_m=T[:3, :3] @ self.p_instr_point_m + T[:3, 3])

    @property
    @override
    def target_names(self) -> tuple[str, ...]:
        return (self.name,)

    @property
    @override
    def target_parameters(self) -> tuple[TermParameter, ...]:
        return tuple(TermParameter(f"target_{axis}", "m", 1e-3) for axis in "xyz")

    @override
    def compare(self, T_instr_ee: Array, targets_m: Array) -> Comparison:
        p_instr_m, arms = carried_targets(T_instr_ee, targets_m)
        off_m, along = self._off_along(p_instr_m)
        by_end, by_targets = by_end_and_targets(T_instr_ee, arms)
        return Comparison(
            off_m[:, None],
            np.einsum("pi,pij->pj", along, by_end[:, 0])[:, None],
            np.einsum("pi,pij->pj", along, by_targets[:, 0])[:, None],
        )

    def _off_along(self, p_instr_m: Array) -> tuple[Array, Array]:
        """Return predicted (P, 1, 3) minus measured distances (P,), and lines of sight (P, 3)."""
        away_m = p_instr_m[:, 0] - self.p_instr_point_m
        distance_m = np.linalg.norm(away_m, axis=1)
        return distance_m - self.d_m, away_m / distance_m[:, None]

    @property
    @override
    def stated_covariance(self) -> Array:
        return (self.u_m**2)[:, None, None]

    @property
    @override
    def places_m(self) -> Array:
        return self.d_m[:, None, None]

    @override
    def locate(self, T_base_ee: Array) -> Located:
        """Find fixed point and target by ranging.

        Distances show no orientation of the instrument's frame: its axes are along those of the
        base.
        """
        found = range_from_distances(T_base_ee, self.d_m, self.p_ee_stated_m)
        return Located(
            T_instr_base=homogeneous(np.eye(3), self.p_instr_point_m - found.p_base_point_m),
            scatter_m=found.rms_m,
            poses=len(self),
            p_ee_targets_m=found.p_ee_target_m[None],
            held=found.held,
            stated=self.p_ee_stated_m is not None,
        )

    @override
    def scale(self, T_base_ee: Array) -> float | None:
        return scale_of_distances(self.d_m, T_base_ee)

    @override
    def misfit(self, T_base_ee: Array, used: Index, weights: Array) -> Misfit:
        found = range_from_distances(T_base_ee[used], self.d_m[used], weights=weights)
        off_m = np.abs(self.d_m - found.distances(T_base_ee))
        return Misfit(off_m[:, None], np.zeros(len(self)))

    @override
    def deviations(self, T_base_ee: Array, T_instr_base: Array, targets_m: Array) -> Deviations:
        off_m, along = self._off_along(carried_targets(T_instr_base @ T_base_ee, targets_m)[0])
        position_mm = 1e3 * (off_m[:, None] * along) @ T_instr_base[:3, :3]
        return Deviations(1e3 * np.abs(off_m), position_mm, None)

    @classmethod
    @override
    def from_columns(cls, columns: Mapping[str, Array], stated: Stated) -> Self:
        found = cls(MM * columns["d_mm"], MM * columns["d_u_mm"], *_stated_target(stated))
        if _POINT[0] not in columns:
            return found
        return replace(found, p_instr_point_m=np.array([columns[name][0] for name in _POINT]))

    @override
    def to_columns(self) -> dict[str, NDArray[Any]]:
        columns = {"d_mm": self.d_m / MM, "d_u_mm": self.u_m / MM}
        if self.p_instr_point_m.any():
            point = zip(_POINT, self.p_instr_point_m, strict=True)
            columns |= {name: np.full(len(self), place) for name, place in point}
        return columns

    @classmethod
    @override
    def raw_columns(cls, header: Sequence[str]) -> RawColumns:
        return RawColumns(((_RAW,),))

    @classmethod
    @override
    def unusable(cls, columns: RawColumns, values: Array) -> Iterable[Unusable]:
        off = values[:, 0] <= 0.0
        found = (f"{_RAW} = {value:g}" for value in values[off, 0])
        return (Unusable(off, "the distance is not above zero", found),)

    @classmethod
    @override
    def from_raw(cls, columns: RawColumns, values: Array, u: Array, stated: Stated) -> Distance:
        u_m = np.where(np.isnan(u[:, 0]), stated.uncertainty_m, MM * u[:, 0])
        return Distance(MM * values[:, 0], u_m, *_stated_target(stated))


def _stated_target(stated: Stated) -> tuple[str, Array | None]:
    """Return name and place of the one target that is stated; None for the place of another."""
    if len(stated.targets_m) != 1:
        return _UNNAMED, None
    return next(iter(stated.targets_m.items()))
