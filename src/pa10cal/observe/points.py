"""Instruments that measure positions of targets, or the distance of one from a fixed point.

Then what the distances between targets of one rigid tool say of their readings.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import MEDIAN_TO_SIGMA, Array, Index, Mask, homogeneous
from pa10cal.frame import point_fits
from pa10cal.frame.hand_eye import Located, hand_eye_from_points, ranging
from pa10cal.frame.target_problem import (
    distance_misfit_bound_m,
    scale_of_distances,
    scale_of_points,
    target_misfit_bound_m,
)
from pa10cal.observe.base_targets import BaseTargets
from pa10cal.observe.instrument import Instrument, LocatingMethod, group_means
from pa10cal.observe.quantities import (
    AXES,
    MM,
    Comparison,
    Deviations,
    Misfit,
    RawColumns,
    StatedByCampaign,
    Unusable,
    Words,
    by_end_and_targets,
    carried_targets,
    columns_of_covariance,
    columns_of_places,
    columns_of_shared,
    covariance_of,
    places_of,
    shared_covariance_of,
)
from pa10cal.rules import READINGS, SCATTER
from pa10cal.terms.term import TermParameter

#: Columns of the table of poses: a target's position and covariance.
_PLACE = re.compile(r"ball(\w+)_x_mm")
_OF_PLACE = "ball{}_c{{}}{{}}_mm2"
#: Factors of the components of a position from mm to m (unit).
_SCALE = np.full(3, MM)
#: Raw column of a coordinate: a target may have any name but `u`, which marks an uncertainty.
_COORDINATE = re.compile(r"(?!u_)([A-Za-z0-9]+)_[xyz]_mm")


@dataclass(frozen=True)
class Points(Instrument):
    """Positions of B targets in P poses."""

    names: tuple[str, ...]  # (B,) names of the targets
    # (P, B, 3) positions in the instrument's frame, nan where a target was not seen
    p_instr_m: Array
    cov_m2: Array  # (P, B, 3, 3) their covariances, nan where a target was not seen
    # (B, 3) stated positions of the targets in the end-effector frame; None where some are not
    p_ee_stated_m: Array | None
    # (P, 6, 6) covariance of a shift [m] and a turn [rad] about the instrument's origin, common to
    # all targets of a pose: uncertainty of a motion that targets on the base showed, and that of
    # stated joint positions. None for an instrument and for joints that are assumed to be right
    motion_cov: Array | None = None

    kind: ClassVar[str] = "points"
    locates_by: ClassVar[LocatingMethod] = "hand_eye_points"
    words: ClassVar[Words] = Words(
        "instrument that measures positions of targets",
        "position error",
        "The error of a pose is the root mean square over the targets observed in it.",
        "Arrows: mean over the targets observed in a pose.",
    )
    several_targets: ClassVar[bool] = True
    sees_base: ClassVar[bool] = True
    least_rows: ClassVar[int] = READINGS.point_rows
    _of_all: ClassVar[tuple[str, ...]] = ("names", "p_ee_stated_m")

    def averaged(self, code: Index) -> Self:
        seen = np.isfinite(self.p_instr_m[..., 0])
        share = group_means(seen.astype(float), code)
        share[share == 0.0] = np.nan  # not seen in any reading
        readings = share * np.bincount(code)[:, None]
        p_instr_m = group_means(np.where(seen[..., None], self.p_instr_m, 0.0), code)
        cov_m2 = group_means(np.where(seen[..., None, None], self.cov_m2, 0.0), code)
        return replace(
            self,
            p_instr_m=p_instr_m / share[..., None],
            cov_m2=cov_m2 / (share * readings)[..., None, None],
            # Readings at nearly the same time, or of the same joint positions, have the same error,
            # so that their mean has it too.
            motion_cov=None if self.motion_cov is None else group_means(self.motion_cov, code),
        )

    @property
    def noise_axes(self) -> Index:
        return np.tile(np.arange(3), len(self.names))

    def with_noise_along_axes(self, u_place_m: Array | None, u_turn_rad: Array | None) -> Self:
        if u_place_m is None:
            return self
        cov_m2 = np.where(
            np.isnan(self.cov_m2), np.nan, np.eye(3) * (u_place_m**2)[:, None, None, :]
        )
        return replace(self, cov_m2=cov_m2)

    def less_certain(self, times: Array) -> Self:
        of_target = times.reshape(self.p_instr_m.shape)[..., :1, None]
        return replace(self, cov_m2=self.cov_m2 * of_target)

    def ideal(self, T_instr_ee: Array, targets_m: Array) -> Self:
        p_instr_m, _ = carried_targets(T_instr_ee, targets_m)
        unit = np.broadcast_to(np.eye(3), (*p_instr_m.shape[:2], 3, 3))
        return replace(self, p_instr_m=p_instr_m, cov_m2=unit, motion_cov=None)

    @classmethod
    def foreseen(cls, T_instr_ee: Array, stated: StatedByCampaign) -> Points:
        names = tuple(stated.targets_m)
        places_m = np.array([stated.targets_m[name] for name in names])
        p_instr_m, _ = carried_targets(T_instr_ee, places_m.ravel())
        cov_m2 = stated.uncertainty_m**2 * np.eye(3)
        return Points(names, p_instr_m, np.broadcast_to(cov_m2, (*p_instr_m.shape, 3)), places_m)

    def in_frame(self, T: Array) -> Self:
        R = T[:3, :3]
        along = np.block([[R, point_fits.cross_matrix(T[:3, 3]) @ R], [np.zeros((3, 3)), R]])
        return replace(
            self,
            p_instr_m=self.p_instr_m @ R.T + T[:3, 3],
            cov_m2=R @ self.cov_m2 @ R.T,
            motion_cov=None if self.motion_cov is None else along @ self.motion_cov @ along.T,
        )

    def steadied(self, base: BaseTargets) -> Self:
        T = np.linalg.inv(base.T_moved)
        p_instr_m = np.einsum("pij,pbj->pbi", T[:, :3, :3], self.p_instr_m) + T[:, None, :3, 3]
        return replace(self, p_instr_m=p_instr_m, motion_cov=base.cov_at_origin)

    def with_end_uncertain(self, motion_cov: Array, places_m: Array) -> Self:
        before = 0.0 if self.motion_cov is None else self.motion_cov
        return replace(self, motion_cov=before + motion_cov)

    def in_order(self, order: Sequence[int]) -> Self:
        at = list(order)
        return replace(self, p_instr_m=self.p_instr_m[:, at], cov_m2=self.cov_m2[:, at])

    @property
    def target_names(self) -> tuple[str, ...]:
        return self.names

    @property
    def places_stated(self) -> bool:
        return self.p_ee_stated_m is not None

    def compare(self, T_instr_ee: Array, targets_m: Array) -> Comparison:
        p_instr_m, levers_m = carried_targets(T_instr_ee, targets_m)
        residual = p_instr_m - self.p_instr_m
        by_end, by_targets = by_end_and_targets(T_instr_ee, levers_m)
        missing = np.isnan(residual)
        for part in (residual, by_end, by_targets):
            part[missing] = 0.0
        rows = (len(self), residual.shape[1] * 3)
        return Comparison(
            residual.reshape(rows), by_end.reshape(*rows, 6), by_targets.reshape(*rows, rows[1])
        )

    @cached_property
    def stated_covariance(self) -> Array:
        count, targets = self.p_instr_m.shape[:2]
        cov = np.zeros((count, targets, 3, targets, 3))
        for b in range(targets):
            cov[:, b, :, b] = np.where(
                np.isnan(self.p_instr_m[:, b, :1, None]), np.eye(3), self.cov_m2[:, b]
            )
        own = cov.reshape(count, 3 * targets, 3 * targets)
        if self.motion_cov is None:
            return own
        by_motion = point_fits.by_small_motion(np.nan_to_num(self.p_instr_m))
        along = (by_motion * np.isfinite(self.p_instr_m)[..., None]).reshape(count, -1, 6)
        return np.asarray(own + along @ self.motion_cov @ along.swapaxes(1, 2))

    @property
    def component_kinds(self) -> tuple[tuple[str, slice], ...]:
        return (("position", slice(0, 3 * len(self.names))),)

    @property
    def places_m(self) -> Array:
        return self.p_instr_m

    @property
    def counts(self) -> tuple[str, ...]:
        seen = np.isfinite(self.p_instr_m[..., 0])
        return (f"targets {', '.join(self.names)} seen {seen.sum()} times of {seen.size}",)

    def locate(self, T_base_ee: Array, *, roughly: bool = False) -> Located:
        located = hand_eye_from_points(
            T_base_ee, self.p_instr_m, self.p_ee_stated_m, names=self.names, roughly=roughly
        )
        return replace(located, stated=self.p_ee_stated_m is not None)

    def least_misfit_m(self, T_base_ee: Array) -> float:
        return target_misfit_bound_m(T_base_ee, self.p_instr_m)

    def scale(self, T_base_ee: Array) -> float | None:
        seen = np.isfinite(self.p_instr_m[..., 0])
        most_seen = int(seen.sum(axis=0).argmax())
        rows = seen[:, most_seen]
        return scale_of_points(self.p_instr_m[rows, most_seen], T_base_ee[rows])

    def scaled(self, factor: float) -> Self:
        return replace(self, p_instr_m=factor * self.p_instr_m)

    def misfit(self, T_base_ee: Array, used: Index, weights: Array) -> Misfit:
        located = hand_eye_from_points(
            T_base_ee[used], self.p_instr_m[used], weights=weights, roughly=True
        )
        off_m = self.p_instr_m - located.targets(T_base_ee)[..., :3, 3]
        return Misfit(np.linalg.norm(off_m, axis=2), np.zeros(len(self)))

    def deviations(self, T_base_ee: Array, T_instr_base: Array, targets_m: Array) -> Deviations:
        T_instr_ee = T_instr_base @ T_base_ee
        residual = self.compare(T_instr_ee, targets_m).residual
        off_mm = 1e3 * residual.reshape(len(residual), -1, 3)
        seen_count = np.isfinite(self.p_instr_m[..., 0]).sum(axis=1)
        return Deviations(
            np.sqrt(np.sum(off_mm**2, axis=(1, 2)) / seen_count),
            (off_mm.sum(axis=1) / seen_count[:, None]) @ T_instr_base[:3, :3],
            None,
        )

    @classmethod
    def from_columns(cls, columns: Mapping[str, Array], stated: StatedByCampaign) -> Self:
        names = tuple(match[1] for match in map(_PLACE.fullmatch, columns) if match)
        cov_m2 = [covariance_of(columns, _OF_PLACE.format(name), AXES, _SCALE) for name in names]
        return cls(
            names,
            places_of(columns, [f"ball{name}" for name in names]),
            np.stack(cov_m2, axis=1),
            stated.places_m(names),
            shared_covariance_of(columns),
        )

    def to_columns(self) -> dict[str, NDArray[Any]]:
        columns: dict[str, NDArray[Any]] = {}
        for b, name in enumerate(self.names):
            columns |= columns_of_places([f"ball{name}"], self.p_instr_m[:, [b]])
            columns |= columns_of_covariance(
                self.cov_m2[:, b], _OF_PLACE.format(name), AXES, _SCALE
            )
            columns[f"ball{name}_touches"] = np.zeros(len(self), dtype=np.int64)
        return columns | columns_of_shared(self.motion_cov)

    @classmethod
    def raw_columns(cls, header: Sequence[str]) -> RawColumns:
        """Return three columns for each target, T2 before T10, in whatever order of the file.

        A file without any lacks those of a target `T1`.
        """
        matches = (_COORDINATE.fullmatch(name) for name in header)
        names = sorted({match.group(1) for match in matches if match}, key=_by_number) or ["T1"]
        targets = tuple(tuple(f"{name}_{axis}_mm" for axis in AXES) for name in names)
        return RawColumns(targets, may_be_blank=True)

    @classmethod
    def unusable(cls, columns: RawColumns, values: Array) -> Iterable[Unusable]:
        blank = np.isnan(values).reshape(len(values), len(columns.targets), 3).sum(axis=2)
        partly_blank = (blank > 0) & (blank < 3)
        incomplete, unseen = partly_blank.any(axis=1), (blank == 3).all(axis=1)
        partly = (", ".join(columns.targets[b]) for b in partly_blank[incomplete].argmax(axis=1))
        return (
            Unusable(incomplete, "a target with some of its coordinates only", tuple(partly)),
            Unusable(unseen, "no target was observed", ("",) * int(unseen.sum())),
        )

    @classmethod
    def raw_notes(cls, columns: RawColumns, stated: StatedByCampaign) -> tuple[str, ...]:
        names = _names(columns)
        unstated = sorted(set(names) - set(stated.targets_m))
        absent = sorted(set(stated.targets_m) - set(names))
        notes = []
        if absent:
            notes.append(f"no columns of {', '.join(absent)}, which tool.balls_mm places")
        if unstated and stated.targets_m:
            notes.append(
                f"tool.balls_mm does not place {', '.join(unstated)}: all targets count as unplaced"
            )
        return tuple(notes)

    @classmethod
    def from_raw(
        cls, columns: RawColumns, values: Array, u: Array, stated: StatedByCampaign
    ) -> Points:
        names = _names(columns)
        p_m = MM * values.reshape(len(values), len(names), 3)
        u_m = np.where(np.isnan(u), stated.uncertainty_m, MM * u).reshape(p_m.shape)
        u_m[np.isnan(p_m)] = np.nan
        return Points(names, p_m, u_m[..., None] ** 2 * np.eye(3), stated.places_m(names))


def _by_number(name: str) -> list[str | int]:
    """Return a key that sorts names with numbers by these."""
    return [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", name)]


def _names(columns: RawColumns) -> tuple[str, ...]:
    """Return the names of the targets of raw columns."""
    return tuple(target[0].removesuffix("_x_mm") for target in columns.targets)


_RAW = "d_mm"
_UNNAMED = "target"
#: Columns of the table of poses that hold a fixed point that is not the frame's origin.
_POINT = ("d_from_x_m", "d_from_y_m", "d_from_z_m")


@dataclass(frozen=True)
class Distance(Instrument):
    """Distances of one target from a fixed point in P poses: |p_instr_target - p_instr_point|.

    The fixed point is the origin of the instrument's frame, whose orientation does not matter,
    unless the measurements were moved to another frame. Residuals, errors and derivatives are along
    the line of sight only.
    """

    d_m: Array  # (P,) distances
    u_m: Array  # (P,) their standard uncertainties
    name: str = _UNNAMED  # of the target
    p_ee_stated_m: Array | None = None  # (3,) its stated position in the end-effector frame
    # (3,) the fixed point: the frame's origin, unless it was moved
    p_instr_point_m: Array = field(default_factory=lambda: np.zeros(3))

    component_kinds: ClassVar[tuple[tuple[str, slice], ...]] = (("distance", slice(0, 1)),)
    directional: ClassVar[bool] = False
    least_rows: ClassVar[int] = READINGS.distance_rows
    _of_all: ClassVar[tuple[str, ...]] = ("name", "p_ee_stated_m", "p_instr_point_m")
    kind: ClassVar[str] = "distance"
    locates_by: ClassVar[LocatingMethod] = "ranging"
    words: ClassVar[Words] = Words(
        "instrument that measures the distance of a target from a fixed point",
        "distance error",
        "Errors are of the measured distance; errors across the line of sight are not measured.",
        "Arrows lie along the line of sight; errors across it are not measured.",
    )

    def averaged(self, code: Index) -> Self:
        u_m = np.sqrt(group_means(self.u_m**2, code) / np.bincount(code))
        return replace(self, d_m=group_means(self.d_m, code), u_m=u_m)

    def less_certain(self, times: Array) -> Self:
        return replace(self, u_m=self.u_m * np.sqrt(times[:, 0]))

    def ideal(self, T_instr_ee: Array, targets_m: Array) -> Self:
        p_instr_m, _ = carried_targets(T_instr_ee, targets_m)
        d_m = np.linalg.norm(p_instr_m[:, 0] - self.p_instr_point_m, axis=1)
        return replace(self, d_m=d_m, u_m=np.ones(len(d_m)))

    @classmethod
    def foreseen(cls, T_instr_ee: Array, stated: StatedByCampaign) -> Distance:
        name, place_m = next(iter(stated.targets_m.items()))
        p_instr_m, _ = carried_targets(T_instr_ee, place_m)
        d_m = np.linalg.norm(p_instr_m[:, 0], axis=1)
        return Distance(d_m, np.full(len(d_m), stated.uncertainty_m), name, place_m)

    def with_end_uncertain(self, motion_cov: Array, places_m: Array) -> Self:
        away_m = places_m[:, 0] - self.p_instr_point_m
        along = away_m / np.linalg.norm(away_m, axis=1, keepdims=True)
        by_motion = (along[:, None] @ point_fits.by_small_motion(places_m[:, 0]))[:, 0]
        variance = np.einsum("pi,pij,pj->p", by_motion, motion_cov, by_motion)
        return replace(self, u_m=np.sqrt(self.u_m**2 + variance))

    def in_frame(self, T: Array) -> Self:
        return replace(self, p_instr_point_m=T[:3, :3] @ self.p_instr_point_m + T[:3, 3])

    @property
    def target_names(self) -> tuple[str, ...]:
        return (self.name,)

    @property
    def target_parameters(self) -> tuple[TermParameter, ...]:
        return tuple(TermParameter(f"target_{axis}", "m", 1e-3) for axis in "xyz")

    @property
    def places_stated(self) -> bool:
        return self.p_ee_stated_m is not None

    def compare(self, T_instr_ee: Array, targets_m: Array) -> Comparison:
        p_instr_m, levers_m = carried_targets(T_instr_ee, targets_m)
        off_m, along = self._residual_and_sight(p_instr_m)
        by_end, by_targets = by_end_and_targets(T_instr_ee, levers_m)
        return Comparison(
            off_m[:, None],
            np.einsum("pi,pij->pj", along, by_end[:, 0])[:, None],
            np.einsum("pi,pij->pj", along, by_targets[:, 0])[:, None],
        )

    def _residual_and_sight(self, p_instr_m: Array) -> tuple[Array, Array]:
        """Return predicted (P, 1, 3) minus measured distances (P,), and lines of sight (P, 3)."""
        away_m = p_instr_m[:, 0] - self.p_instr_point_m
        distance_m = np.linalg.norm(away_m, axis=1)
        return distance_m - self.d_m, away_m / distance_m[:, None]

    @property
    def stated_covariance(self) -> Array:
        return (self.u_m**2)[:, None, None]

    @property
    def places_m(self) -> Array:
        return self.d_m[:, None, None]

    def locate(self, T_base_ee: Array, *, roughly: bool = False) -> Located:
        """Find fixed point and target by ranging.

        Distances show no orientation of the instrument's frame: its axes are along those of the
        base.
        """
        found = ranging(T_base_ee, self.d_m, self.p_ee_stated_m, roughly=roughly)
        T_instr_base = homogeneous(np.eye(3), self.p_instr_point_m + found.T_instr_base[:3, 3])
        return replace(found, T_instr_base=T_instr_base, stated=self.p_ee_stated_m is not None)

    def least_misfit_m(self, T_base_ee: Array) -> float:
        return distance_misfit_bound_m(T_base_ee, self.d_m)

    def scale(self, T_base_ee: Array) -> float | None:
        return scale_of_distances(self.d_m, T_base_ee)

    def scaled(self, factor: float) -> Self:
        return replace(self, d_m=factor * self.d_m)

    def misfit(self, T_base_ee: Array, used: Index, weights: Array) -> Misfit:
        found = ranging(T_base_ee[used], self.d_m[used], weights=weights, roughly=True)
        modelled_m = np.linalg.norm(found.targets(T_base_ee)[..., :3, 3], axis=2)
        return Misfit(np.abs(self.d_m[:, None] - modelled_m), np.zeros(len(self)))

    def deviations(self, T_base_ee: Array, T_instr_base: Array, targets_m: Array) -> Deviations:
        off_m, along = self._residual_and_sight(
            carried_targets(T_instr_base @ T_base_ee, targets_m)[0]
        )
        position_mm = 1e3 * (off_m[:, None] * along) @ T_instr_base[:3, :3]
        return Deviations(1e3 * np.abs(off_m), position_mm, None)

    @classmethod
    def from_columns(cls, columns: Mapping[str, Array], stated: StatedByCampaign) -> Self:
        found = cls(MM * columns["d_mm"], MM * columns["d_u_mm"], *_stated_target(stated))
        if _POINT[0] not in columns:
            return found
        return replace(found, p_instr_point_m=np.array([columns[name][0] for name in _POINT]))

    def to_columns(self) -> dict[str, NDArray[Any]]:
        columns = {"d_mm": self.d_m / MM, "d_u_mm": self.u_m / MM}
        if self.p_instr_point_m.any():
            point = zip(_POINT, self.p_instr_point_m, strict=True)
            columns |= {name: np.full(len(self), place) for name, place in point}
        return columns

    @classmethod
    def raw_columns(cls, header: Sequence[str]) -> RawColumns:
        return RawColumns(((_RAW,),))

    @classmethod
    def unusable(cls, columns: RawColumns, values: Array) -> Iterable[Unusable]:
        off = values[:, 0] <= 0.0
        found = (f"{_RAW} = {value:g}" for value in values[off, 0])
        return (Unusable(off, "the distance is not above zero", tuple(found)),)

    @classmethod
    def from_raw(
        cls, columns: RawColumns, values: Array, u: Array, stated: StatedByCampaign
    ) -> Distance:
        u_m = np.where(np.isnan(u[:, 0]), stated.uncertainty_m, MM * u[:, 0])
        return Distance(MM * values[:, 0], u_m, *_stated_target(stated))


def _stated_target(stated: StatedByCampaign) -> tuple[str, Array | None]:
    """Return name and position of the target, if exactly one is stated; else no position."""
    if len(stated.targets_m) != 1:
        return _UNNAMED, None
    return next(iter(stated.targets_m.items()))


# Targets of one rigid tool: what the distances between them say of the readings.


def distances_between(places_m: Array) -> dict[tuple[int, int], Array]:
    """Return the distances (P,) of every two targets at places (P, B, 3), nan where not seen.

    None where distances from the instrument, (P, B, 1), are all that was measured.
    """
    if places_m.shape[2] != 3:
        return {}
    return {
        (a, b): np.linalg.norm(places_m[:, a] - places_m[:, b], axis=1)
        for a, b in combinations(range(places_m.shape[1]), 2)
    }


def keep_their_distances(measured: Instrument) -> Mask:
    """Return in which of P poses the distances between targets are as in all poses, (P,).

    Readings of such poses are correct, however far they are from a model. False where fewer than
    two targets were seen, and of targets that were computed from one pose.
    """
    distances = distances_between(measured.places_m)
    if not distances or scatter_of_computed_m(measured) is not None:
        return np.zeros(len(measured.places_m), dtype=bool)
    off_m, sigma_m = _off_and_scatter(distances.values())
    seen = np.isfinite(off_m)
    same = np.where(seen, off_m, 0.0) <= SCATTER.same_distance * sigma_m
    return np.asarray(same.all(axis=0) & seen.any(axis=0))


def scatter_of_computed_m(measured: Instrument) -> float | None:
    """Return by how much distances between targets scatter that were computed from one pose.

    None of targets that were read one by one, whose distances scatter as readings do.
    """
    distances = distances_between(measured.places_m)
    apart = [d_m for d_m in distances.values() if (d_m > 0.0).any()]
    if not apart:
        return None
    _, sigma_m = _off_and_scatter(apart)
    variance = np.diagonal(measured.stated_covariance, axis1=1, axis2=2)
    u_m = float(np.sqrt(np.median(variance[measured.components_seen])))
    largest_m = float(sigma_m.max(initial=0.0))
    return largest_m if largest_m < SCATTER.computed_distance * u_m else None


def _off_and_scatter(distances_m: Iterable[Array]) -> tuple[Array, Array]:
    """Return by how much D distances (P,) are off their medians, (D, P), and scatter, (D, 1).

    Of those that were seen at all.
    """
    distance_m = np.stack([*distances_m])
    distance_m = distance_m[np.isfinite(distance_m).any(axis=1)]
    off_m = np.abs(distance_m - np.nanmedian(distance_m, axis=1, keepdims=True))
    return off_m, MEDIAN_TO_SIGMA * np.nanmedian(off_m, axis=1, keepdims=True)
