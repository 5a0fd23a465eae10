"""Campaigns of one robot, measured each in its own way, as what one instrument measured.

Components are those of every campaign, one after the other; in each pose those of its own campaign
are seen. All campaigns stand in one frame, that of the first (see `observe.group`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, NoReturn, Self

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from pa10cal.arm.statics import ObservedTargets, PoseStates
from pa10cal.arrays import Array, Index
from pa10cal.errors import CalibrationError
from pa10cal.frame.rigid_fit import Located
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import JointLog, Observations
from pa10cal.observe.order import with_arrivals
from pa10cal.observe.quantities import (
    Comparison,
    Deviations,
    Misfit,
    Rows,
    Start,
    Words,
)
from pa10cal.terms.of_campaign import of_campaign
from pa10cal.terms.term import Parameter


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
    least_rows: ClassVar[int] = 24

    def __len__(self) -> int:
        return len(self.campaign)

    @cached_property
    def _places(self) -> tuple[_Place, ...]:
        places, before = [], dict.fromkeys("bta", 0)
        for number, (name, part) in enumerate(self.campaigns):
            own = (
                part.components_seen.shape[1],
                len(part.target_parameters),
                part.by_stated_targets.shape[2],
            )
            at = {
                axis: slice(first, first + count)
                for (axis, first), count in zip(before.items(), own, strict=True)
            }
            before = {axis: columns.stop for axis, columns in at.items()}
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

    def _with(self, parts: Sequence[Instrument]) -> Self:
        return replace(self, parts=tuple(parts))

    def _scattered(
        self,
        of: Callable[[_Place], Iterable[Array]],
        *axes: tuple[str | int, ...],
        fill: float = 0.0,
    ) -> list[Array]:
        """Return arrays with what each campaign has in its own poses and columns, else `fill`.

        Args:
            of: gives what a campaign has, one array (p, ...) for each of those returned.
            axes: of each array, after the poses: `b`, `t` or `a` of `_Place`; or how long the axis
                is at least, where it is as long as the longest of a campaign.
            fill: what stands elsewhere.
        """
        whole = []
        for names, *parts in zip(axes, *map(of, self._shown), strict=True):
            lengths = [
                self._places[-1].at[axis].stop
                if isinstance(axis, str)
                else max([axis, *(part.shape[k] for part in parts)])
                for k, axis in enumerate(names, start=1)
            ]
            whole.append(np.full((len(self), *lengths), fill))
            for p, part in zip(self._shown, parts, strict=True):
                own = zip(names, part.shape[1:], strict=True)
                at: list[Any] = [
                    p.at[axis] if isinstance(axis, str) else slice(length) for axis, length in own
                ]
                whole[-1][p.rows, *at] = part
        return whole

    @property
    @override
    def campaigns(self) -> tuple[tuple[str, Instrument], ...]:
        return tuple(zip(self.names, self.parts, strict=True))

    @property
    @override
    def R_first_target_of(self) -> Mapping[str, Array]:
        return self.targets

    @property
    @override
    def parts_seen(self) -> tuple[tuple[Index | slice, slice], ...]:
        return tuple((p.rows, p.at["b"]) for p in self._shown)

    @property
    @override
    def kinds(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(part.kind for part in self.parts))

    @override
    def take(self, rows: Rows) -> Self:
        campaign, within = self.campaign[rows], self._within[rows]
        parts = tuple(part.take(within[campaign == k]) for k, part in enumerate(self.parts))
        return replace(self, parts=parts, campaign=campaign)

    @override
    def averaged(self, code: Index) -> Self:
        campaign = self.campaign[np.unique(code, return_index=True)[1]]
        parts = []
        for place in self._places:
            own = np.unique(code[place.rows], return_inverse=True)[1]
            parts.append(place.part.averaged(own) if len(own) else place.part)
        return replace(self, parts=tuple(parts), campaign=campaign)

    @override
    def moved(self, T: Array) -> Self:
        return self._with([part.moved(T) for part in self.parts])

    @override
    def turned(self, R_ee_target: Array) -> Self:
        return self._with([part.turned(R_ee_target) for part in self.parts])

    @override
    def ideal(self, T_instr_ee: Array, targets_m: Array) -> Self:
        return self._with(
            [p.part.ideal(T_instr_ee[p.rows], targets_m[p.at["t"]]) for p in self._places]
        )

    @property
    @override
    def places_m(self) -> Array:
        return self._scattered(lambda p: (p.part.places_m,), (0, 3), fill=np.nan)[0]

    @property
    @override
    def counts(self) -> tuple[str, ...]:
        return tuple(f"{p.name}: {each}" for p in self._places for each in p.part.counts)

    @property
    @override
    def target_names(self) -> tuple[str, ...]:
        return tuple(
            of_campaign(target, name) for name, part in self.campaigns for target in _targets(part)
        )

    @property
    @override
    def target_parameters(self) -> tuple[Parameter, ...]:
        return tuple(
            replace(each, name=of_campaign(each.name, name))
            for name, part in self.campaigns
            for each in part.target_parameters
        )

    @override
    def compare(self, T_instr_ee: Array, targets_m: Array) -> Comparison:
        def of(p: _Place) -> Iterable[Array]:
            found = p.part.compare(T_instr_ee[p.rows], targets_m[p.at["t"]])
            return found.residual, found.by_end, found.by_targets

        return Comparison(*self._scattered(of, ("b",), ("b", 6), ("b", "t")))

    @override
    def end_poses(self, T_instr_ee: Array) -> Array:
        return self._scattered(lambda p: (p.part.end_poses(T_instr_ee[p.rows]),), (4, 4))[0]

    @override
    def readout(self, T_instr_ee: Array, targets_m: Array) -> ObservedTargets:
        def of(p: _Place) -> Iterable[Array]:
            found = p.part.readout(T_instr_ee[p.rows], targets_m[p.at["t"]])
            return found.p_instr_targets_m, found.pose_by_targets

        p_instr_m, by_targets = self._scattered(of, (0, 3), (6, 0), fill=np.nan)
        p_instr_m = np.where(np.isnan(p_instr_m), p_instr_m[:, :1], p_instr_m)
        return ObservedTargets(p_instr_m, np.nan_to_num(by_targets))

    @override
    def axes_of_end(self, T_instr_ee: Array) -> Array:
        return self._blocks(lambda p: p.part.axes_of_end(T_instr_ee[p.rows]))

    @property
    @override
    def by_stated_targets(self) -> Array:
        return self._scattered(lambda p: (p.part.by_stated_targets,), ("b", "a"))[0]

    @cached_property
    def components_seen(self) -> NDArray[np.bool_]:
        """Return which components were measured in each pose, (P, b)."""
        return self._scattered(lambda p: (p.part.components_seen.astype(float),), ("b",))[0].astype(
            bool
        )

    @property
    @override
    def stated_covariance(self) -> Array:
        return self._blocks(lambda p: p.part.stated_covariance)

    def _blocks(self, of: Callable[[_Place], Array]) -> Array:
        """Return matrices (P, b, b) with those of each campaign, unit for those of others."""

        def with_columns(p: _Place) -> Iterable[Array]:
            block = of(p)
            return block, np.ones(block.shape[:2])

        blocks, own = self._scattered(with_columns, ("b", "b"), ("b",))
        diagonal = np.arange(own.shape[1])
        blocks[:, diagonal, diagonal] += 1.0 - own
        return blocks

    @property
    @override
    def component_kinds(self) -> tuple[tuple[str, slice], ...]:
        return tuple(
            (of_campaign(kind, p.name), slice(first + at.start, first + at.stop))
            for p in self._shown
            for first in [p.at["b"].start]
            for kind, at in p.part.component_kinds
        )

    @property
    @override
    def position_columns(self) -> Index:
        columns = [p.at["b"].start + p.part.position_columns for p in self._places]
        return np.concatenate(columns).astype(np.intp)

    @override
    def locate(self, T_base_ee: Array) -> Located:
        found = {p.name: p.part.locate(T_base_ee[p.rows]) for p in self._shown}
        first = self._leading.name
        squares = sum(each.poses * each.scatter_m**2 for each in found.values())
        poses = sum(each.poses for each in found.values())
        targets_m = [e.p_ee_targets_m for e in found.values() if e.p_ee_targets_m is not None]
        return replace(
            found[first],
            scatter_m=float(np.sqrt(squares / poses)),
            poses=poses,
            p_ee_targets_m=np.concatenate([np.zeros((0, 3)), *targets_m]),
            T_ee_target_of={
                name: each.T_ee_target
                for name, each in found.items()
                if each.T_ee_target is not None
            },
        )

    @property
    def _leading(self) -> _Place:
        """Return the first campaign whose instrument shows the orientation of the base."""
        return next((p for p in self._shown if p.part.directional), self._shown[0])

    @override
    def find_start(self, T_base_ee: Array) -> Start:
        starts = {p.name: p.part.find_start(T_base_ee[p.rows]) for p in self._shown}
        return replace(
            starts[self._leading.name],
            targets_m=np.concatenate([start.targets_m for start in starts.values()]),
            p_ee_targets_of_m={name: start.p_ee_target_m for name, start in starts.items()},
        )

    @override
    def scale(self, T_base_ee: Array) -> float | None:
        found = [p.part.scale(T_base_ee[p.rows]) for p in self._shown]
        known = [each for each in found if each is not None]
        return float(np.median(known)) if known else None

    @override
    def misfit(self, T_base_ee: Array, used: Index, weights: Array) -> Misfit:
        def of(p: _Place) -> Iterable[Array]:
            here = self.campaign[used] == self.names.index(p.name)
            found = p.part.misfit(T_base_ee[p.rows], self._within[used][here], weights[here])
            return found.length_m, found.turn_rad

        return Misfit(*self._scattered(of, (0,), (), fill=np.nan))

    @property
    @override
    def attitudes(self) -> Array | None:
        if any(part.attitudes is None for part in self.parts):
            return None
        return self._scattered(lambda p: (np.asarray(p.part.attitudes),), (3, 3))[0]

    @override
    def as_read(self, T_base_ee: Array, T_instr_base: Array, targets_off_m: Array) -> Array:
        def of(p: _Place) -> Iterable[Array]:
            yield p.part.as_read(T_base_ee[p.rows], T_instr_base, targets_off_m[p.at["a"]])

        return self._scattered(of, (4, 4))[0]

    @override
    def deviations(self, T_base_ee: Array, T_instr_base: Array, targets_m: Array) -> Deviations:
        def of(p: _Place) -> Iterable[Array]:
            found = p.part.deviations(T_base_ee[p.rows], T_instr_base, targets_m[p.at["t"]])
            rotation = (
                np.zeros((len(p.rows), 3)) if found.rotation_deg is None else found.rotation_deg
            )
            return found.distance_mm, found.position_mm, rotation

        distance, position, rotation = self._scattered(of, (), (3,), (3,))
        return Deviations(distance, position, None if self.attitudes is None else rotation)

    @property
    @override
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

    @override
    def to_columns(self) -> dict[str, NDArray[Any]]:
        columns: dict[str, NDArray[Any]] = {}
        for p in self._shown:
            for name, values in p.part.to_columns().items():
                whole = columns.setdefault(name, np.full(len(self), np.nan))
                whole[p.rows] = values
        return columns


def _targets(part: Instrument) -> tuple[str, ...]:
    """Return the names of targets that are unknowns of a fit."""
    return part.target_names if part.target_parameters else ()


# Campaigns of one robot joined: measured in one frame, poses labelled, one after the other.

#: Between the name of a campaign and the label of a pose.
_OF_CAMPAIGN = "/"
#: One campaign begins so long after the one before it has ended [s]: clocks are their own.
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
    of its own.

    Args:
        members: the campaigns; the first gives the frame.

    Returns:
        Single readings of all, labels with the name of their campaign.
    """
    frames = members[0].start
    each = []
    for member in members:
        placed = with_arrivals(_placed(member.observations, member.start, frames))[0]
        labels = np.char.add(member.name + _OF_CAMPAIGN, placed.pose)
        each.append(replace(placed, pose=labels))
    times_s = _one_after_the_other([every.states.time_s for every in each])
    each = [
        every.with_states(replace(every.states, time_s=time_s))
        for every, time_s in zip(each, times_s, strict=True)
    ]
    R_first = frames.R_ee_target
    targets = {member.name: R_first.T @ member.start.R_ee_target for member in members}
    return joined(each, tuple(targets), targets)


def joined(
    each: Sequence[Observations],
    names: tuple[str, ...],
    targets: Mapping[str, Array] | None = None,
) -> Observations[Joined]:
    """Join campaigns that stand in one frame, and whose labels and times are apart.

    Args:
        each: single readings of every campaign.
        targets: see `Joined`; None where no target was turned.
    """
    campaign = np.repeat(np.arange(len(each)), [len(every) for every in each])
    columns = ((every.pose, every.kind, every.repeat, every.readings) for every in each)
    pose, kind, repeat, readings = map(np.concatenate, zip(*columns, strict=True))
    states = _states([every.states for every in each], campaign)
    measured = Joined(names, tuple(every.measured for every in each), campaign, targets or {})
    log = _log([every.log for every in each])
    return Observations(pose, states, measured, kind, repeat, readings, log)


def _placed(every: Observations, own: Start, first: Start) -> Observations[Instrument]:
    """Return readings with base and target where those of the first campaign are."""
    if own is first:
        return every
    measured = every.measured.moved(first.T_instr_base @ np.linalg.inv(own.T_instr_base))
    return replace(every, measured=measured.turned(first.R_ee_target.T @ own.R_ee_target))


def _one_after_the_other(times_s: Sequence[Array]) -> list[Array]:
    """Return the times of all campaigns, each on its own clock, one after the other."""
    shifted, end_s = [times_s[0]], times_s[0].max(initial=0.0)
    for time_s in times_s[1:]:
        begins_s = time_s.min(initial=np.inf)
        shifted.append(time_s - begins_s + end_s + _APART_S if len(time_s) else time_s)
        end_s = shifted[-1].max(initial=end_s)
    return shifted


def _states(each: Sequence[PoseStates], campaign: Index) -> PoseStates:
    names = ("q_rad", "tau_Nm", "arrival", "load_N", "temperature_C", "time_s")
    arrays: dict[str, Any] = {
        name: np.concatenate([getattr(states, name) for states in each]) for name in names
    }
    timed = None  # which poses have a time; None where all do
    if not all(states.tells_time for states in each):
        known = [np.ones(len(s), dtype=bool) if s.timed is None else s.timed for s in each]
        timed = np.concatenate(known)
    return PoseStates(**arrays, campaign=campaign, timed=timed)


def _log(logs: Sequence[JointLog | None]) -> JointLog | None:
    """Return how joints were read in all campaigns; None where one does not say."""
    known = [log for log in logs if log is not None]
    if len(known) < len(logs):
        return None
    every = ((log.q_u, log.tau_u, log.samples) for log in known)
    return JointLog(*map(np.concatenate, zip(*every, strict=True)))
