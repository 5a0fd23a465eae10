"""Joint positions as raw files have them: columns, units, and rows that repeat one pose.

An axis is what the controller counts. It differs from the joint where joints are coupled.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from pa10cal.arm.description import Arm
from pa10cal.arrays import Array, Index, Mask
from pa10cal.campaign.raw_rows import RawRows

#: Resolutions of encoders that are told from a list of positions [counts a turn]: powers of two, as
#: programmed positions are in round parts of a degree; few parts of a turn are programmed, too.
_COUNTS, _FEWEST_COUNTS = 2.0 ** np.arange(17), 256.0
#: Part of a count by which each position may be off it: printed digits (computing).
_OFF_COUNT = 0.1
#: Fewest different positions by which a resolution is told (level).
_FEWEST_POSITIONS = 20
#: A group of neighbours that spans more than so many tolerances is parted by equal commands.
CHAIN = 3.0
#: Positions that differ by less have one command, however densely the poses lie [deg, mm].
SAME_COMMAND = 1e-4


def position_columns(prismatic: Mask) -> list[str]:
    """Return the raw columns of joint positions: q1_deg …, or q1_mm for a prismatic joint."""
    units = np.where(prismatic, "mm", "deg")
    return [f"q{joint}_{unit}" for joint, unit in enumerate(units, start=1)]


def in_radians(q: Array, prismatic: Mask) -> Array:
    """Return logged joint positions (N, n) in radians, of prismatic joints in metres."""
    return np.asarray(np.where(prismatic, 1e-3 * q, np.radians(q)))


def rounded_to_counts(q_deg: Array) -> float:
    """Return the counts a turn to which all positions (N,) were rounded; 0 for none.

    The fewest counts of which every position is a whole number.
    """
    positions = np.unique(q_deg)
    if len(positions) < _FEWEST_POSITIONS:
        return 0.0
    from_first = positions - positions[0]
    for counts in _COUNTS.tolist():
        moved = from_first * counts / 360.0
        if np.abs(moved - np.round(moved)).max() < _OFF_COUNT:
            return float(counts) if counts >= _FEWEST_COUNTS else 0.0
    return 0.0


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
        keys = pd.DataFrame({"pose": raw.text_of("pose"), "load": table[:, 1]}).iloc[order]
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


def connected_groups(first: Index, second: Index, count: int) -> Index:
    """Number the connected components (count,) of a graph with edges (first[k], second[k])."""
    graph = coo_array((np.ones(len(first), dtype=np.int8), (first, second)), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.intp)


def labels(number: Index) -> list[str]:
    """Return labels P00001 … of commands, which sort as text in the order of their numbers."""
    digits = max(5, len(str(number.max(initial=0) + 1)))
    return [f"P{k:0{digits}d}" for k in number + 1]
