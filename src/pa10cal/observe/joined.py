"""Campaigns of one robot, measured each in its own way, as what one instrument measured.

Components are those of every campaign, one after the other; in each pose those of its own campaign
are seen. All campaigns stand in one frame, that of the first (see `join`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, NoReturn, Self

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.statics import ObservedTargets, PoseStates
from pa10cal.arrays import Array, Index, Rows
from pa10cal.errors import CalibrationError
from pa10cal.frame.rigid_fit import Located
from pa10cal.observe.arrivals import with_arrivals
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import JointLog, Observations
from pa10cal.observe.quantities import Comparison, Deviations, Misfit, Start, Words
from pa10cal.rules import READINGS
from pa10cal.terms.of_campaign import of_campaign
from pa10cal.terms.term import TermParameter


@dataclass(frozen=True)
class _Place:
    """Where a campaign stands among poses, components and targets."""

    name: str  # of the campaign
    part: Instrument  # what was measured in it
    rows: Index  # (p,) its poses
    # its components `b`, the coordinates of its targets `t`, and those of its apparatus `a`
    at: Mapping[str, slice]


@dataclass(frozen=True)
class Joined(Instrument):
    """What was measured in P poses of several campaigns."""

    names: tuple[str, ...]  # (C,) names of the campaigns
    # (C,) what was measured in the poses of each, in the order in which they stand here
    parts: tuple[Instrument, ...]
    campaign: Index  # (P,) campaign of each pose
    # (C) orientation (3, 3) of the target of each campaign in that of the first, by name:
    # orientations here are turned to the first's
    targets: Mapping[str, Array] = field(default_factory=dict)

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
    def _places(self) -> tuple[_Place, ...]:
        places, ends = [], dict.fromkeys("bta", 0)
        for number, (name, part) in enumerate(self.campaigns):
            _, components, apparatus = part.by_stated_targets.shape
            lengths = {"b": components, "t": len(part.target_parameters), "a": apparatus}
            at = {axis: slice(ends[axis], ends[axis] + length) for axis, length in lengths.items()}
            ends = {axis: columns.stop for axis, columns in at.items()}
            places.append(_Place(name, part, np.flatnonzero(self.campaign == number), at))
        return tuple(places)

    @cached_property
    def _within(self) -> Index:
        """Return where each pose stands in its own campaign, (P,)."""
        within = np.zeros(len(self), dtype=np.intp)
        for place in self._places:
            within[place.rows] = np.arange(len(place.rows))
        return within

    @property
    def _shown(self) -> tuple[_Place, ...]:
        """Return the campaigns that have poses here."""
        return tuple(place for place in self._places if len(place.rows))

    def _scattered(
        self, of: Callable[[_Place], Any], *axes: tuple[str | int, ...], fill: float = 0.0
    ) -> list[Array]:
        """Return arrays with what each campaign has in its own poses and columns, else `fill`.

        Args:
            of: gives what a campaign has, an array (p, ...) or a record of one for each of `axes`.
            axes: of each array, after the poses: `b`, `t` or `a` of `_Place`; or how long the axis
                is at least, where it is as long as the longest of a campaign.
            fill: what stands elsewhere, and for an array that a campaign has not.
        """
        of_each = [of(place) for place in self._shown]
        parts = [[one] if isinstance(one, np.ndarray) else vars(one).values() for one in of_each]
        whole = []
        for names, *arrays in zip(axes, *parts, strict=True):
            there = [array for array in arrays if array is not None]
            lengths = [
                self._places[-1].at[axis].stop
                if isinstance(axis, str)
                else max([axis, *(array.shape[k] for array in there)])
                for k, axis in enumerate(names, start=1)
            ]
            whole.append(np.full((len(self), *lengths), fill))
            for p, array in zip(self._shown, arrays, strict=True):
                if array is not None:
                    own = zip(names, array.shape[1:], strict=True)
                    at: list[Any] = [
                        p.at[k] if isinstance(k, str) else slice(length) for k, length in own
                    ]
                    whole[-1][p.rows, *at] = array
        return whole

    def _blocks(self, of: Callable[[_Place], Array]) -> Array:
        """Return matrices (P, b, b) with those of each campaign, unit for those of others."""
        (blocks,) = self._scattered(of, ("b", "b"))
        (own,) = self._scattered(lambda p: np.ones((len(p.rows), _size(p.at["b"]))), ("b",))
        diagonal = np.arange(own.shape[1])
        blocks[:, diagonal, diagonal] += 1.0 - own
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
    def parts_seen(self) -> tuple[tuple[Index | slice, slice], ...]:
        return tuple((p.rows, p.at["b"]) for p in self._shown)

    @property
    def kinds(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(part.kind for part in self.parts))

    def take(self, rows: Rows) -> Self:
        campaign, within = self.campaign[rows], self._within[rows]
        parts = tuple(part.take(within[campaign == k]) for k, part in enumerate(self.parts))
        return replace(self, parts=parts, campaign=campaign)

    def averaged(self, code: Index) -> Self:
        campaign = self.campaign[np.unique(code, return_index=True)[1]]
        parts = []
        for place in self._places:
            own = np.unique(code[place.rows], return_inverse=True)[1]
            parts.append(place.part.averaged(own) if len(own) else place.part)
        return replace(self, parts=tuple(parts), campaign=campaign)

    def in_frame(self, T: Array) -> Self:
        return self._with(part.in_frame(T) for part in self.parts)

    def turned(self, R_ee_target: Array) -> Self:
        return self._with(part.turned(R_ee_target) for part in self.parts)

    def ideal(self, T_instr_ee: Array, targets_m: Array) -> Self:
        return self._with(
            p.part.ideal(T_instr_ee[p.rows], targets_m[p.at["t"]]) for p in self._places
        )

    @property
    def places_m(self) -> Array:
        return self._scattered(lambda p: p.part.places_m, (0, 3), fill=np.nan)[0]

    @property
    def counts(self) -> tuple[str, ...]:
        return tuple(f"{p.name}: {each}" for p in self._places for each in p.part.counts)

    @property
    def target_names(self) -> tuple[str, ...]:
        return tuple(
            of_campaign(target, name)
            for name, part in self.campaigns
            if part.target_parameters  # else they are no unknowns of a fit
            for target in part.target_names
        )

    @property
    def target_parameters(self) -> tuple[TermParameter, ...]:
        return tuple(
            replace(each, name=of_campaign(each.name, name))
            for name, part in self.campaigns
            for each in part.target_parameters
        )

    def compare(self, T_instr_ee: Array, targets_m: Array) -> Comparison:
        def of(p: _Place) -> Comparison:
            return p.part.compare(T_instr_ee[p.rows], targets_m[p.at["t"]])

        return Comparison(*self._scattered(of, ("b",), ("b", 6), ("b", "t")))

    def end_poses(self, T_instr_ee: Array) -> Array:
        return self._scattered(lambda p: p.part.end_poses(T_instr_ee[p.rows]), (4, 4))[0]

    def readout(self, T_instr_ee: Array, targets_m: Array) -> ObservedTargets:
        def of(p: _Place) -> ObservedTargets:
            return p.part.readout(T_instr_ee[p.rows], targets_m[p.at["t"]])

        p_instr_m, by_targets = self._scattered(of, (0, 3), (6, 0), fill=np.nan)
        p_instr_m = np.where(np.isnan(p_instr_m), p_instr_m[:, :1], p_instr_m)
        return ObservedTargets(p_instr_m, np.nan_to_num(by_targets))

    def axes_of_end(self, T_instr_ee: Array) -> Array:
        return self._blocks(lambda p: p.part.axes_of_end(T_instr_ee[p.rows]))

    @property
    def by_stated_targets(self) -> Array:
        return self._scattered(lambda p: p.part.by_stated_targets, ("b", "a"))[0]

    @cached_property
    def components_seen(self) -> NDArray[np.bool_]:
        """Return which components were measured in each pose, (P, b)."""
        seen = self._scattered(lambda p: p.part.components_seen.astype(float), ("b",))[0]
        return seen.astype(bool)

    @property
    def stated_covariance(self) -> Array:
        return self._blocks(lambda p: p.part.stated_covariance)

    @property
    def component_kinds(self) -> tuple[tuple[str, slice], ...]:
        return tuple(
            (of_campaign(kind, p.name), slice(first + at.start, first + at.stop))
            for p in self._shown
            for first in [p.at["b"].start]
            for kind, at in p.part.component_kinds
        )

    @property
    def position_columns(self) -> Index:
        columns = [p.at["b"].start + p.part.position_columns for p in self._places]
        return np.concatenate(columns).astype(np.intp)

    def locate(self, T_base_ee: Array, *, roughly: bool = False) -> Located:
        found = {p.name: p.part.locate(T_base_ee[p.rows], roughly=roughly) for p in self._shown}
        targets = {name: of.T_ee_target for name, of in found.items() if of.T_ee_target is not None}
        poses = [of.poses for of in found.values()]
        squares = [of.scatter_m**2 for of in found.values()]
        places_m = [of.p_ee_targets_m for of in found.values() if of.p_ee_targets_m is not None]
        return replace(
            found[self._leading.name],
            scatter_m=float(np.sqrt(np.average(squares, weights=poses))),
            poses=sum(poses),
            p_ee_targets_m=np.concatenate([np.zeros((0, 3)), *places_m]),
            T_ee_target_of=targets,
        )

    @property
    def _leading(self) -> _Place:
        """Return the first campaign whose instrument shows the orientation of the base."""
        return next((p for p in self._shown if p.part.directional), self._shown[0])

    def find_start(self, T_base_ee: Array) -> Start:
        starts = {p.name: p.part.find_start(T_base_ee[p.rows]) for p in self._shown}
        return replace(
            starts[self._leading.name],
            targets_m=np.concatenate([start.targets_m for start in starts.values()]),
            p_ee_targets_of_m={name: start.p_ee_target_m for name, start in starts.items()},
        )

    def scale(self, T_base_ee: Array) -> float | None:
        found = [p.part.scale(T_base_ee[p.rows]) for p in self._shown]
        known = [each for each in found if each is not None]
        return float(np.median(known)) if known else None

    def scaled(self, factor: float) -> Self:
        return self._with(part.scaled(factor) for part in self.parts)

    def misfit(self, T_base_ee: Array, used: Index, weights: Array) -> Misfit:
        def of(p: _Place) -> Misfit:
            here = self.campaign[used] == self.names.index(p.name)
            return p.part.misfit(T_base_ee[p.rows], self._within[used][here], weights[here])

        return Misfit(*self._scattered(of, (0,), (), fill=np.nan))

    @property
    def attitudes(self) -> Array | None:
        if any(part.attitudes is None for part in self.parts):
            return None
        return self._scattered(lambda p: p.part.attitudes, (3, 3))[0]

    def as_read(self, T_base_ee: Array, T_instr_base: Array, targets_off_m: Array) -> Array:
        def of(p: _Place) -> Array:
            return p.part.as_read(T_base_ee[p.rows], T_instr_base, targets_off_m[p.at["a"]])

        return self._scattered(of, (4, 4))[0]

    def deviations(self, T_base_ee: Array, T_instr_base: Array, targets_m: Array) -> Deviations:
        def of(p: _Place) -> Deviations:
            return p.part.deviations(T_base_ee[p.rows], T_instr_base, targets_m[p.at["t"]])

        distance, position, rotation = self._scattered(of, (), (3,), (3,))
        return Deviations(distance, position, None if self.attitudes is None else rotation)

    @property
    def spread_mm(self) -> float:
        squares = sum(len(p.rows) * p.part.spread_mm**2 for p in self._shown)
        return float(np.sqrt(squares / len(self)))

    @classmethod
    def _by_campaign(cls, *_: Any, **__: Any) -> NoReturn:
        """Refuse to be read or foreseen."""
        raise CalibrationError(
            "measurements are read and foreseen campaign by campaign",
            where="a group of campaigns",
            allowed="one campaign",
            remedy="do it for each campaign of the group",
        )

    foreseen = from_columns = raw_columns = from_raw = _by_campaign

    def to_columns(self) -> dict[str, NDArray[Any]]:
        columns: dict[str, NDArray[Any]] = {}
        for p in self._shown:
            for name, values in p.part.to_columns().items():
                whole = columns.setdefault(name, np.full(len(self), np.nan))
                whole[p.rows] = values
        return columns


def _size(columns: slice) -> int:
    return int(columns.stop - columns.start)


# Campaigns of one robot joined: measured in one frame, poses labelled, one after the other.

#: Between the name of a campaign and the label of a pose.
_OF_CAMPAIGN = "/"
#: One campaign begins so long after the one before it has ended [s]: clocks are their own
#: (computing).
_APART_S = 3600.0


@dataclass(frozen=True)
class Member:
    """A campaign of a group."""

    name: str
    observations: Observations  # single readings of all kinds, as its instrument measured them
    start: Start  # about where base, tool and targets are, as its instrument sees them


def join(members: Sequence[Member]) -> Observations[Joined]:
    """Join campaigns of one robot.

    Every campaign is moved to where its base stands with that of the first, and its target turned
    to the orientation of the first: then what its base and tool are off by is small, and an unknown
    of its own. Labels of the single readings get the name of their campaign.
    """
    first = members[0].start
    each: list[Observations] = []
    end_s = 0.0
    for member in members:
        every, own = member.observations, member.start
        if own is not first:
            measured = every.measured.in_frame(first.T_instr_base @ np.linalg.inv(own.T_instr_base))
            measured = measured.turned(first.R_ee_target.T @ own.R_ee_target)
            every = replace(every, measured=measured)
        every = with_arrivals(every)[0]
        # Times of all campaigns, each on its own clock, one after the other.
        time_s = every.states.time_s
        if each and len(time_s):
            time_s = time_s - time_s.min() + end_s + _APART_S
        end_s = time_s.max(initial=end_s)
        labels = np.char.add(member.name + _OF_CAMPAIGN, every.pose)
        each.append(replace(every, pose=labels, states=replace(every.states, time_s=time_s)))
    R_first = first.R_ee_target
    targets = {member.name: R_first.T @ member.start.R_ee_target for member in members}
    return joined(each, tuple(targets), targets)


def joined(
    each: Sequence[Observations],
    names: tuple[str, ...],
    targets: Mapping[str, Array] | None = None,
) -> Observations[Joined]:
    """Join single readings of campaigns in one frame, whose labels and times are apart.

    Targets are those of `Joined`, None where none was turned.
    """
    campaign = np.repeat(np.arange(len(each)), [len(every) for every in each])
    columns = ((every.pose, every.kind, every.repeat, every.readings) for every in each)
    pose, kind, repeat, readings = map(np.concatenate, zip(*columns, strict=True))
    fields = ("q_rad", "tau_Nm", "arrival", "load_N", "temperature_C", "time_s")
    arrays: dict[str, Any] = {
        name: np.concatenate([getattr(every.states, name) for every in each]) for name in fields
    }
    timed = None  # which poses have a time; None where all do
    if not all(every.states.tells_time for every in each):
        known = (every.states.timed for every in each)
        lengths = map(len, each)
        timed = np.concatenate(
            [np.ones(n, bool) if of is None else of for n, of in zip(lengths, known, strict=True)]
        )
    states = PoseStates(**arrays, campaign=campaign, timed=timed)
    measured = Joined(names, tuple(every.measured for every in each), campaign, targets or {})
    logs = [every.log for every in each if every.log is not None]
    log = None
    if len(logs) == len(each):  # else one does not say how joints were read
        parts = ((of.q_u, of.tau_u, of.samples) for of in logs)
        log = JointLog(*map(np.concatenate, zip(*parts, strict=True)))
    return Observations(pose, states, measured, kind, repeat, readings, log)
