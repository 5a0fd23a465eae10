"""Several campaigns of one robot as one instrument, whatever instrument measured each.

Components, targets and apparatus are those of all campaigns, one after the other; in each pose only
those of its own campaign are measured. All are in the frame of the first campaign (see `join`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, NoReturn, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.statics import ObservedTargets, PoseStates
from pa10cal.arrays import Array, Index, Rows
from pa10cal.errors import CalibrationError
from pa10cal.frame.hand_eye import Located
from pa10cal.observe.arrivals import with_arrivals
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import JointLog, Observations
from pa10cal.observe.quantities import Comparison, Deviations, Misfit, Start, Words
from pa10cal.rules import READINGS
from pa10cal.terms.term import TermParameter
from pa10cal.terms.wrapped import of_campaign

Part = TypeVar("Part")
#: Separates the name of a campaign from the label of a pose.
_OF_CAMPAIGN = "/"
#: Gap between the times of two campaigns [s], whose clocks are independent (computing).
_APART_S = 3600.0


@dataclass(frozen=True)
class _Share:
    """The share of one campaign in the poses, components and targets of all."""

    name: str  # of the campaign
    part: Instrument  # its measurements
    rows: Index  # (p,) its poses
    # its columns among all components `b`, coordinates of targets `t` and those of apparatus `a`
    columns: Mapping[str, slice]

    def own(self, T: Array, targets_m: Array) -> tuple[Array, Array]:
        """Return those of all poses (P, 4, 4) and targets (t,) that belong to the campaign."""
        own_m = targets_m[..., self.columns["t"]]
        return T[self.rows], own_m if own_m.ndim == 1 else own_m[self.rows]


@dataclass(frozen=True)
class Joined(Instrument):
    """Measurements of P poses of several campaigns."""

    names: tuple[str, ...]  # (C,) names of the campaigns
    parts: tuple[Instrument, ...]  # (C,) measurements of each, its poses in the order of all
    campaign: Index  # (P,) campaign of each pose
    # by name, orientation (3, 3) of each campaign's target in that of the first, to which measured
    # orientations were turned
    targets: Mapping[str, Array] = field(default_factory=dict)
    # by name, where each campaign's instrument stands (3,) in the frame of all
    instruments_m: Mapping[str, Array] = field(default_factory=dict)

    kind: ClassVar[str] = ""
    words: ClassVar[Words] = Words(
        "several instruments, each in a campaign of its own",
        "position error",
        "The error of a pose is that of its own instrument.",
        "Arrows: of the target of the pose's own instrument.",
    )
    least_rows: ClassVar[int] = READINGS.distance_rows

    def __len__(self) -> int:
        return len(self.campaign)

    @cached_property
    def _shares(self) -> tuple[_Share, ...]:
        shares, ends = [], dict.fromkeys("bta", 0)
        for number, (name, part) in enumerate(self.campaigns):
            _, components, apparatus = part.by_stated_targets.shape
            lengths = {"b": components, "t": len(part.target_parameters), "a": apparatus}
            columns = {axis: slice(ends[axis], ends[axis] + lengths[axis]) for axis in lengths}
            ends = {axis: of_axis.stop for axis, of_axis in columns.items()}
            shares.append(_Share(name, part, np.flatnonzero(self.campaign == number), columns))
        return tuple(shares)

    @cached_property
    def _row_in_part(self) -> Index:
        """Return the row of each pose in the measurements of its own campaign, (P,)."""
        row_in_part = np.zeros(len(self), dtype=np.intp)
        for share in self._shares:
            row_in_part[share.rows] = np.arange(len(share.rows))
        return row_in_part

    @property
    def _shown(self) -> tuple[_Share, ...]:
        """Return the shares of the campaigns that have poses here."""
        return tuple(share for share in self._shares if len(share.rows))

    def _by_name(self, of: Callable[[_Share], Part]) -> dict[str, Part]:
        """Return what a function returns for each campaign that has poses here, by its name."""
        return {share.name: of(share) for share in self._shown}

    def _gathered(
        self, of: Callable[[_Share], Array | None], *axes: str | int, fill: float = 0.0
    ) -> Array:
        """Return an array (P, ...) with that of each campaign in its own poses and columns.

        Args:
            of: returns the array (p, ...) of a campaign; None where it has none.
            axes: of the array after the poses: `b`, `t` or `a` of `_Share`; or a least length, if
                the axis is as long as the longest of a campaign.
            fill: value in all other places.
        """
        arrays = [(share, of(share)) for share in self._shown]
        lengths = [
            self._shares[-1].columns[axis].stop
            if isinstance(axis, str)
            else max([axis, *(array.shape[k] for _, array in arrays if array is not None)])
            for k, axis in enumerate(axes, start=1)
        ]
        gathered = np.full((len(self), *lengths), fill)
        for share, array in arrays:
            if array is not None:
                at: list[Any] = [
                    share.columns[axis] if isinstance(axis, str) else slice(length)
                    for axis, length in zip(axes, array.shape[1:], strict=True)
                ]
                gathered[share.rows, *at] = array
        return gathered

    def _blocks(self, of: Callable[[_Share], Array]) -> Array:
        """Return matrices (P, b, b): that of the pose's campaign, and a unit matrix for others."""
        blocks = self._gathered(of, "b", "b")
        measured = np.zeros(blocks.shape[:2])
        for share in self._shown:
            measured[share.rows, share.columns["b"]] = 1.0
        diagonal = np.arange(blocks.shape[1])
        blocks[:, diagonal, diagonal] += 1.0 - measured
        return blocks

    def _with(self, parts: Iterable[Instrument]) -> Self:
        return replace(self, parts=tuple(parts))

    @property
    def campaigns(self) -> tuple[tuple[str, Instrument], ...]:
        return tuple(zip(self.names, self.parts, strict=True))

    @property
    def R_first_target_of(self) -> Mapping[str, Array]:
        return self.targets

    @property
    def p_first_instr_of(self) -> Mapping[str, Array]:
        return self.instruments_m

    @property
    def directional(self) -> bool:  # type: ignore[override]  # as its campaigns are
        return any(part.directional for part in self.parts)

    @property
    def parts_seen(self) -> tuple[tuple[Index | slice, slice], ...]:
        return tuple((share.rows, share.columns["b"]) for share in self._shown)

    @property
    def kinds(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(part.kind for part in self.parts))

    def take(self, rows: Rows) -> Self:
        campaign, of_part = self.campaign[rows], self._row_in_part[rows]
        parts = tuple(part.take(of_part[campaign == k]) for k, part in enumerate(self.parts))
        return replace(self, parts=parts, campaign=campaign)

    def averaged(self, code: Index) -> Self:
        campaign = self.campaign[np.unique(code, return_index=True)[1]]
        parts = []
        for share in self._shares:
            of_part = np.unique(code[share.rows], return_inverse=True)[1]
            parts.append(share.part.averaged(of_part) if len(of_part) else share.part)
        return replace(self, parts=tuple(parts), campaign=campaign)

    def in_frame(self, T: Array) -> Self:
        moved = self._with(part.in_frame(T) for part in self.parts)
        stand_m = {name: T[:3, :3] @ p_m + T[:3, 3] for name, p_m in self.instruments_m.items()}
        return replace(moved, instruments_m=stand_m)

    def turned(self, R_ee_target: Array) -> Self:
        return self._with(part.turned(R_ee_target) for part in self.parts)

    def ideal(self, T_instr_ee: Array, targets_m: Array) -> Self:
        return self._with(
            share.part.ideal(*share.own(T_instr_ee, targets_m)) for share in self._shares
        )

    @property
    def places_m(self) -> Array:
        return self._gathered(lambda share: share.part.places_m, 0, 3, fill=np.nan)

    @property
    def counts(self) -> tuple[str, ...]:
        return tuple(
            f"{share.name}: {text}" for share in self._shares for text in share.part.counts
        )

    @property
    def target_names(self) -> tuple[str, ...]:
        return tuple(
            of_campaign(target, name)
            for name, part in self.campaigns
            if part.target_parameters  # else a fit does not estimate them
            for target in part.target_names
        )

    @property
    def places_stated(self) -> bool:
        return all(part.places_stated for part in self.parts)

    @property
    def target_parameters(self) -> tuple[TermParameter, ...]:
        return tuple(
            replace(parameter, name=of_campaign(parameter.name, name))
            for name, part in self.campaigns
            for parameter in part.target_parameters
        )

    def in_order(self, order: Sequence[int]) -> Self:
        """Return the measurements with other labels, which stay within each campaign."""
        parts, first = [], 0
        for part in self.parts:
            count = len(part.target_names) if part.target_parameters else 0
            own = [target - first for target in order[first : first + count]]
            parts.append(part.in_order(own) if own else part)
            first += count
        return self._with(parts)

    def compare(self, T_instr_ee: Array, targets_m: Array) -> Comparison:
        parts = self._by_name(lambda share: share.part.compare(*share.own(T_instr_ee, targets_m)))
        return Comparison(
            self._gathered(lambda share: parts[share.name].residual, "b"),
            self._gathered(lambda share: parts[share.name].by_end, "b", 6),
            self._gathered(lambda share: parts[share.name].by_targets, "b", "t"),
        )

    def end_poses(self, T_instr_ee: Array) -> Array:
        return self._gathered(lambda share: share.part.end_poses(T_instr_ee[share.rows]), 4, 4)

    def readout(self, T_instr_ee: Array, targets_m: Array) -> ObservedTargets:
        parts = self._by_name(lambda share: share.part.readout(*share.own(T_instr_ee, targets_m)))
        p_instr_m = self._gathered(
            lambda share: parts[share.name].p_instr_targets_m, 0, 3, fill=np.nan
        )
        by_targets = self._gathered(lambda share: parts[share.name].pose_by_targets, 6, 0)
        # Poses of campaigns with fewer targets repeat their first, whose derivative is zero.
        p_instr_m = np.where(np.isnan(p_instr_m), p_instr_m[:, :1], p_instr_m)
        by_places = self._gathered(
            lambda share: parts[share.name].places_by_targets, "t", by_targets.shape[2]
        )
        return ObservedTargets(p_instr_m, np.nan_to_num(by_targets), np.nan_to_num(by_places))

    def axes_of_end(self, T_instr_ee: Array) -> Array:
        return self._blocks(lambda share: share.part.axes_of_end(T_instr_ee[share.rows]))

    @property
    def by_stated_targets(self) -> Array:
        return self._gathered(lambda share: share.part.by_stated_targets, "b", "a")

    @cached_property
    def components_seen(self) -> NDArray[np.bool_]:
        """Return which components were measured in each pose, (P, b)."""
        seen = self._gathered(lambda share: share.part.components_seen.astype(float), "b")
        return seen.astype(bool)

    @property
    def stated_covariance(self) -> Array:
        return self._blocks(lambda share: share.part.stated_covariance)

    @property
    def component_kinds(self) -> tuple[tuple[str, slice], ...]:
        kinds = []
        for share in self._shown:
            first = share.columns["b"].start
            for kind, columns in share.part.component_kinds:
                of_all = slice(first + columns.start, first + columns.stop)
                kinds.append((of_campaign(kind, share.name), of_all))
        return tuple(kinds)

    @property
    def position_columns(self) -> Index:
        columns = [share.columns["b"].start + share.part.position_columns for share in self._shares]
        return np.concatenate(columns).astype(np.intp)

    def locate(self, T_base_ee: Array, *, roughly: bool = False) -> Located:
        located = self._by_name(
            lambda share: share.part.locate(T_base_ee[share.rows], roughly=roughly)
        )
        parts = located.values()
        poses = [part.poses for part in parts]
        squares = [part.scatter_m**2 for part in parts]
        places_m = [part.p_ee_targets_m for part in parts if part.p_ee_targets_m is not None]
        return replace(
            located[self._leading.name],
            scatter_m=float(np.sqrt(np.average(squares, weights=poses))),
            poses=sum(poses),
            p_ee_targets_m=np.concatenate([np.zeros((0, 3)), *places_m]),
            T_ee_target_of={
                name: part.T_ee_target
                for name, part in located.items()
                if part.T_ee_target is not None
            },
        )

    @property
    def _leading(self) -> _Share:
        """Return the first campaign that determines the orientation of the base, or the first."""
        return next((share for share in self._shown if share.part.directional), self._shown[0])

    def find_start(self, T_base_ee: Array) -> Start:
        starts = self._by_name(lambda share: share.part.find_start(T_base_ee[share.rows]))
        return replace(
            starts[self._leading.name],
            targets_m=np.concatenate([start.targets_m for start in starts.values()]),
            p_ee_target_by_campaign_m={name: start.p_ee_target_m for name, start in starts.items()},
        )

    def scale(self, T_base_ee: Array) -> float | None:
        scales = [share.part.scale(T_base_ee[share.rows]) for share in self._shown]
        known = [scale for scale in scales if scale is not None]
        return float(np.median(known)) if known else None

    def scaled(self, factor: float) -> Self:
        return self._with(part.scaled(factor) for part in self.parts)

    def misfit(self, T_base_ee: Array, used: Index, weights: Array) -> Misfit:
        def misfit(share: _Share) -> Misfit:
            here = self.campaign[used] == self.names.index(share.name)
            of_part = self._row_in_part[used][here]
            return share.part.misfit(T_base_ee[share.rows], of_part, weights[here])

        parts = self._by_name(misfit)
        return Misfit(
            self._gathered(lambda share: parts[share.name].length_m, 0, fill=np.nan),
            self._gathered(lambda share: parts[share.name].turn_rad, fill=np.nan),
        )

    @property
    def attitudes(self) -> Array | None:
        if any(part.attitudes is None for part in self.parts):
            return None
        return self._gathered(lambda share: share.part.attitudes, 3, 3)

    def as_read(self, T_base_ee: Array, T_instr_base: Array, targets_off_m: Array) -> Array:
        def of(share: _Share) -> Array:
            off_m = targets_off_m[share.columns["a"]]
            return share.part.as_read(T_base_ee[share.rows], T_instr_base, off_m)

        return self._gathered(of, 4, 4)

    def deviations(self, T_base_ee: Array, T_instr_base: Array, targets_m: Array) -> Deviations:
        def deviations(share: _Share) -> Deviations:
            T_base_own, own_targets_m = share.own(T_base_ee, targets_m)
            return share.part.deviations(T_base_own, T_instr_base, own_targets_m)

        parts = self._by_name(deviations)
        rotation = None
        if self.attitudes is not None:
            rotation = self._gathered(lambda share: parts[share.name].rotation_deg, 3)
        return Deviations(
            self._gathered(lambda share: parts[share.name].distance_mm),
            self._gathered(lambda share: parts[share.name].position_mm, 3),
            rotation,
        )

    @property
    def spread_mm(self) -> float:
        squares = sum(len(share.rows) * share.part.spread_mm**2 for share in self._shown)
        return float(np.sqrt(squares / len(self)))

    @classmethod
    def _refuse(cls, *_: Any, **__: Any) -> NoReturn:
        """Refuse to read or foresee measurements of a group."""
        raise CalibrationError(
            "measurements are read and foreseen campaign by campaign",
            where="a group of campaigns",
            allowed="one campaign",
            remedy="do it for each campaign of the group",
        )

    foreseen = from_columns = raw_columns = from_raw = _refuse

    def to_columns(self) -> dict[str, NDArray[Any]]:
        columns: dict[str, NDArray[Any]] = {}
        for share in self._shown:
            for name, values in share.part.to_columns().items():
                column = columns.setdefault(name, np.full(len(self), np.nan))
                column[share.rows] = values
        return columns


@dataclass(frozen=True)
class GroupCampaign:
    """A campaign of a group."""

    name: str
    observations: Observations  # single readings of all kinds, in its instrument's frame
    start: Start  # approximate base, tool and targets, in the same frame


def join(campaigns: Sequence[GroupCampaign]) -> Observations[Joined]:
    """Join campaigns of one robot.

    Every campaign is moved so that its base coincides with that of the first, and its orientations
    are turned to the target of the first: the remaining deviations of its base and tool are small,
    and unknowns of its own. Labels of poses get the name of their campaign; campaigns follow each
    other in time.
    """
    first = campaigns[0].start
    parts: list[Observations] = []
    instruments_m = {}
    end_s = 0.0
    for each in campaigns:
        part, start = each.observations, each.start
        T_first_own = first.T_instr_base @ np.linalg.inv(start.T_instr_base)
        instruments_m[each.name] = T_first_own[:3, 3]
        if start is not first:
            measured = part.measured.in_frame(T_first_own)
            measured = measured.turned(first.R_ee_target.T @ start.R_ee_target)
            part = replace(part, measured=measured)
        part = with_arrivals(part)[0]
        time_s = part.states.time_s
        if parts and len(time_s):
            time_s = time_s - time_s.min() + end_s + _APART_S
        end_s = time_s.max(initial=end_s)
        labels = np.char.add(each.name + _OF_CAMPAIGN, part.pose)
        parts.append(replace(part, pose=labels, states=replace(part.states, time_s=time_s)))
    R_first = first.R_ee_target
    targets = {each.name: R_first.T @ each.start.R_ee_target for each in campaigns}
    return concatenated(parts, tuple(targets), targets, instruments_m)


def concatenated(
    parts: Sequence[Observations],
    names: tuple[str, ...],
    targets: Mapping[str, Array] | None = None,
    instruments_m: Mapping[str, Array] | None = None,
) -> Observations[Joined]:
    """Return the single readings of campaigns one after the other.

    Args:
        parts: those of each, in one frame, with labels and times that no other has.
        names: of the campaigns.
        targets: see `Joined`; None where no orientations were turned.
        instruments_m: see `Joined`; None where it is not known where they stand.
    """
    campaign = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    fields = ("q_rad", "tau_Nm", "arrival", "load_N", "temperature_C", "time_s")
    arrays: dict[str, Any] = {
        name: np.concatenate([getattr(part.states, name) for part in parts]) for name in fields
    }
    timed = None
    if not all(part.states.tells_time for part in parts):
        timed = np.concatenate(
            [np.broadcast_to(part.states.tells_time, len(part)) for part in parts]
        )
    logs = [part.log for part in parts if part.log is not None]
    log = JointLog.joined(logs) if len(logs) == len(parts) else None
    return Observations(
        pose=np.concatenate([part.pose for part in parts]),
        states=PoseStates(**arrays, campaign=campaign, timed=timed),
        measured=Joined(
            names,
            tuple(part.measured for part in parts),
            campaign,
            targets or {},
            instruments_m or {},
        ),
        kind=np.concatenate([part.kind for part in parts]),
        repeat=np.concatenate([part.repeat for part in parts]),
        readings=np.concatenate([part.readings for part in parts]),
        log=log,
    )
