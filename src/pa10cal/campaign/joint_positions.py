"""Joint positions as raw files have them: columns, units, encoder counts, rows that repeat a pose.

An axis is what the controller counts. It differs from the joint where joints are coupled.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pandas as pd
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import loads_as_named
from pa10cal.arrays import Array, Index, Mask, spread
from pa10cal.campaign.bounds import BEYOND_LIMITS
from pa10cal.campaign.dwells import PAUSE
from pa10cal.campaign.nominal_fit import placed_by_points
from pa10cal.campaign.raw_rows import RawRows
from pa10cal.observe.observations import Observations
from pa10cal.rules import READINGS

#: A group of neighbours that spans more than so many tolerances is parted by equal commands.
CHAIN = 3.0
#: Positions that differ by less have one command, however densely the poses lie [deg, mm].
SAME_COMMAND = 1e-4
#: Of neighbouring rows without a pause between them at most this part is equal, and pauses are this
#: part of the time and so many, at least.
_EQUAL, _IN_PAUSES, _PAUSES = 0.01, 0.1, 5
#: Part of the pauses over which no joint moves further than between rows beside, at least.
_HELD = 0.9
#: Rows made in one pause, at most.
_MOST_ROWS = 500


def position_columns(prismatic: Mask) -> list[str]:
    """Return the raw columns of joint positions: q1_deg …, or q1_mm for a prismatic joint."""
    units = np.where(prismatic, "mm", "deg")
    return [f"q{joint}_{unit}" for joint, unit in enumerate(units, start=1)]


def in_radians(q: Array, prismatic: Mask) -> Array:
    """Return logged joint positions (N, n) in radians, of prismatic joints in metres."""
    return np.asarray(np.where(prismatic, 1e-3 * q, np.radians(q)))


def as_joints(logged: Array, arm: Arm) -> Array:
    """Return joint positions (N, n) [deg, mm] for positions of the axes (N, m) [deg, mm]."""
    if arm.coupling.none:
        return logged
    q = arm.coupling.to_joints(in_radians(logged, arm.axes_slide))
    return np.where(arm.prismatic, 1e3 * q, np.degrees(q))


def as_logged(q: Array, arm: Arm) -> Array:
    """Return positions of the axes (N, m) [deg, mm] for joint positions (N, n) [deg, mm]."""
    if arm.coupling.none:
        return q
    axes = arm.coupling.to_axes(in_radians(q, arm.prismatic))
    return np.where(arm.axes_slide, 1e3 * axes, np.degrees(axes))


def with_labels(raw: RawRows, q: Sequence[str], same_deg: float) -> RawRows:
    """Return rows with labels of poses and repeats, made from joint positions where they lack them.

    Rows with equal joint positions (within `same_deg`) are of one pose; its rows under one load are
    its repeats. Both are numbered in order of time.
    """
    if {"pose", "repeat"} <= set(raw.columns):
        return raw
    table = raw.numbers_of(["time_s", "load_N", *q])
    order = np.argsort(table[:, 0], kind="stable")
    if "pose" not in raw.columns:
        raw.columns["pose"] = np.empty(len(order), dtype=object)
        raw.columns["pose"][order] = labels(same_commands(table[order, 2:], same_deg))
    if "repeat" not in raw.columns:
        keys = pd.DataFrame(
            {"pose": raw.text_of("pose"), "load": loads_as_named(table[:, 1])}
        ).iloc[order]
        counted = keys.groupby(["pose", "load"], sort=False).cumcount().to_numpy() + 1.0
        raw.columns["repeat"] = np.empty(len(order))
        raw.columns["repeat"][order] = counted
    return raw


def same_commands(q: Array, tolerance: float) -> Index:
    """Number the commands (N,) of joint positions q (N, n) [deg, mm], in order of appearance.

    Read-back scatters, so positions within the tolerance of each other have one command, and groups
    are joined by such neighbours. Where a group spans more than `CHAIN` tolerances, poses lie so
    densely that a chain of neighbours joins them; only equal positions have one command there.
    """

    def neighbour_groups(q: Array, within: float) -> Index:
        pairs = cKDTree(q).query_pairs(within, p=np.inf, output_type="ndarray")
        return connected_groups(pairs[:, 0], pairs[:, 1], len(q))

    group = neighbour_groups(q, tolerance)
    of_group = pd.DataFrame(q).groupby(group)
    extent = (of_group.max() - of_group.min()).max(axis=1)
    dense = np.isin(group, extent.index[extent > CHAIN * tolerance])
    if dense.any():
        group[dense] = group.max() + 1 + neighbour_groups(q[dense], min(SAME_COMMAND, tolerance))
    return np.asarray(pd.factorize(group)[0], dtype=np.intp)


def places_of(every: Observations, prismatic: Mask, tolerance: float) -> Index:
    """Number the places (N,) of readings; one place has one label, or joint positions that agree.

    They agree within a tolerance [deg; mm of a joint that slides], `repeat_tolerance_deg`.
    """
    q = every.states.q_rad
    by_joints = same_commands(np.where(prismatic, 1e3 * q, np.degrees(q)), tolerance)
    by_label = pd.factorize(pd.Series(every.pose))[0]
    label_count = int(by_label.max(initial=-1)) + 1
    count = label_count + int(by_joints.max(initial=-1)) + 1
    # A reading joins its label with its joint positions.
    return connected_groups(by_label, label_count + by_joints, count)[by_label]


def repeats_among(places: Index, load_N: Array) -> int:
    """Return how many readings are at the place (N,) and under the load (N,) of an earlier one."""
    return len(places) - len(np.unique(np.column_stack([places, load_N]), axis=0))


def label_warnings(every: Observations, places: Index) -> list[str]:
    """Return a warning of calibration readings at one place (N,) under labels of their own.

    Readings of one pose are repeats by their label. Without any repeats the noise is not known.
    """
    grid = every.kind == "grid"
    labels = pd.factorize(pd.Series(every.pose[grid]))[0]
    repeats, by_place = (
        repeats_among(each, every.states.load_N[grid]) for each in (labels, places[grid])
    )
    if not repeats < READINGS.least_dof <= by_place:
        return []
    return [
        f"{by_place} calibration readings are at joint positions and under a load of earlier ones, "
        f"and {repeats} are repeats by their labels: the others do not show the noise; give the "
        "readings of one pose one label"
    ]


def connected_groups(first: Index, second: Index, count: int) -> Index:
    """Number the connected components (count,) of a graph with edges (first[k], second[k])."""
    graph = coo_array((np.ones(len(first), dtype=np.int8), (first, second)), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.intp)


def labels(number: Index) -> list[str]:
    """Return labels P00001 … of commands, which sort as text in the order of their numbers."""
    digits = max(5, len(str(number.max(initial=0) + 1)))
    return [f"P{k:0{digits}d}" for k in number + 1]


# Encoder counts: how many a turn, where zero is, and in which direction each joint counts.

#: Whole numbers beyond this are counts, not degrees without decimals.
LARGEST_DEG = 400.0
#: Counts a turn of usual encoders: servos, powers of two, and parts of a degree.
_POWERS = tuple(2.0**k for k in range(8, 25))
_USUAL_COUNTS = (4096.0, 1024.0, *_POWERS, 3600.0, 36e3, 36e4, 1e4, 4e4, 1e5, 1e6)
#: Counts a turn, and count at zero, of servos that move less than a turn: 1024 counts over 300 deg,
#: 1000 over 240, pulses of 500 to 2500 us over 180 or over 270.
_OF_A_PART = ((1228.8, 512.0), (1500.0, 500.0), (4000.0, 1500.0), (2e3 / 0.75, 1500.0))
#: The nominal arm agrees if its misfit is at most this part of the spread of the places.
_FITS = 0.05
#: Rows by which scales are compared; part of them that must lie within the joints' limits.
_COMPARED, _WITHIN = 60, 0.9
#: Any other scale must leave so many times the misfit.
_CLEARER = 2.0


@dataclass(frozen=True)
class CountScale:
    """How counts are read as angles."""

    per_turn: float  # counts a turn of the joint
    zero: float  # count at which the joint is at zero
    signs: tuple[int, ...]  # (n,) direction of each joint
    misfit_m: float = np.inf  # median misfit of the nominal arm so; infinite where none was tried

    def degrees(self, counts: Array) -> Array:
        """Return angles of counts (N, n)."""
        return np.asarray(self.signs) * (counts - self.zero) * (360.0 / self.per_turn)


def looks_like_counts(values: Array) -> bool:
    """Return whether positions (N, n) of joints that turn are counts: whole numbers, and large."""
    known = values[np.isfinite(values)]
    return bool(
        len(known) and (known == np.round(known)).all() and np.abs(known).max() > LARGEST_DEG
    )


def scale_of_counts(counts: Array, arm: Arm | None, p_m: Array | None) -> CountScale:
    """Return the scale of counts (N, n) of an arm whose joints all turn.

    It is the scale with which the nominal arm agrees best with positions p_m (N, 3) of a target,
    each joint in its best direction, if that is clearly better than any other. Without positions,
    or where none is, it is the smallest power of two above all counts, with zero in its middle
    where no count is negative.
    """
    below = np.nanmax(np.abs(counts))
    assumed = next(power for power in (*_POWERS, np.inf) if power > below)
    zero = assumed / 2.0 if np.nanmin(counts) >= 0.0 else 0.0
    fallback = CountScale(assumed, zero, (1,) * counts.shape[1])
    if arm is None or p_m is None or not np.isfinite(assumed):
        return fallback
    known = np.flatnonzero(np.isfinite(np.column_stack([counts, p_m])).all(axis=1))
    if not len(known):
        return fallback
    some = known[spread(len(known), _COMPARED)]
    tried = sorted(_scales_tried(counts[some], arm, p_m[some]), key=lambda scale: scale.misfit_m)
    if not tried:
        return fallback
    others = [scale.misfit_m for scale in tried if scale.per_turn != tried[0].per_turn]
    spread_m = float(np.linalg.norm(np.std(p_m[some], axis=0)))
    clear = tried[0].misfit_m < min(min(others, default=np.inf) / _CLEARER, _FITS * spread_m)
    return tried[0] if clear else fallback


def _scales_tried(counts: Array, arm: Arm, p_m: Array) -> Iterator[CountScale]:
    """Yield scales with which the counts lie within the limits of the joints."""
    limits_deg = np.degrees(arm.axis_limits_rad) + BEYOND_LIMITS["deg"] * np.array([-1.0, 1.0])

    def within(scale: CountScale) -> bool:
        q_deg = scale.degrees(counts)
        inside = (q_deg >= limits_deg[:, 0]) & (q_deg <= limits_deg[:, 1])
        return bool(inside.all(axis=1).mean() >= _WITHIN)

    whole = product(dict.fromkeys(_USUAL_COUNTS), (0.5, 0.0))
    for per_turn, zero in (*((turn, part * turn) for turn, part in whole), *_OF_A_PART):
        scale = CountScale(per_turn, zero, (1,) * len(limits_deg))
        if not within(scale):
            continue
        scale = _fitted(scale, counts, arm, p_m)
        for _ in limits_deg:
            turned = [
                _fitted(_reversed(scale, k), counts, arm, p_m) for k in range(len(limits_deg))
            ]
            better = min(turned, key=lambda other: other.misfit_m)
            if not within(better) or better.misfit_m >= scale.misfit_m / 1.2:
                break
            scale = better
        yield scale


def _reversed(scale: CountScale, joint: int) -> CountScale:
    signs = tuple(-sign if k == joint else sign for k, sign in enumerate(scale.signs))
    return CountScale(scale.per_turn, scale.zero, signs)


def _fitted(scale: CountScale, counts: Array, arm: Arm, p_m: Array) -> CountScale:
    """Return a scale with the misfit of the nominal arm."""
    q_rad = arm.coupling.to_joints(np.radians(scale.degrees(counts)))
    T_base_ee = Chain.of(arm).forward(q_rad)
    located = placed_by_points(T_base_ee, p_m[:, None], roughly=True)
    if located is None:
        return scale
    off_m = np.linalg.norm(p_m - located.targets(T_base_ee)[:, 0, :3, 3], axis=1)
    return CountScale(scale.per_turn, scale.zero, scale.signs, float(np.median(off_m)))


def held_between_changes(logged: RawRows, q: Sequence[str]) -> RawRows:
    """Return a log of joints, columns `q`, with its last row repeated where none was written.

    A controller that writes a row only where a joint changed has none while the arm stands. Such a
    log has hardly two equal rows after each other, and long pauses over which the arm hardly
    moved. Rows are in order of time. Any other log is returned as it is.
    """
    time_s, steps_s = logged["time_s"], np.diff(logged["time_s"])
    if not (steps_s > 0.0).any():
        return logged
    usual_s = float(np.median(steps_s[steps_s > 0.0]))
    travel = np.abs(np.diff(logged.numbers_of(q), axis=0)).max(axis=1)
    pause = steps_s > PAUSE * usual_s
    beside = travel[~pause]
    if pause.sum() < _PAUSES or steps_s[pause].sum() < _IN_PAUSES * steps_s.sum():
        return logged
    held = pause & (travel <= np.median(beside))
    if held.sum() < _HELD * pause.sum() or np.mean(beside == 0.0) > _EQUAL:
        return logged
    count = np.ones(len(time_s), dtype=np.intp)
    count[:-1][held] = np.clip(np.round(steps_s[held] / usual_s), 2, _MOST_ROWS).astype(np.intp)
    rows = np.repeat(np.arange(len(time_s)), count)
    part = (np.arange(len(rows)) - np.repeat(np.cumsum(count) - count, count)) / count[rows]
    full = logged.at(rows)
    note = (
        f"{logged.file} has rows only where a joint changed: where the next is late "
        f"({held.sum()} times), the last one holds until then"
    )
    later_s = part * np.append(steps_s, 0.0)[rows]
    return replace(
        full.with_columns({"time_s": full["time_s"] + later_s}), notes=(*logged.notes, note)
    )
