"""Configurations that would show joint angles which no pose of the fit has seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.discovery.admissible import Room, draw_admissible
from pa10cal.discovery.blocked_cv.survey import Survey
from pa10cal.errors import DiscoveryError
from pa10cal.fit.angles_seen import WITHIN_RAD, AnglesSeen

Array = NDArray[np.float64]

_POOL = 2000
_TURN = 2.0 * np.pi


@dataclass(frozen=True)
class FillingPose:
    """One configuration to measure.

    Attributes:
        q_rad: (n,) joint positions [rad, or m of a sliding joint].
        load_N: external load.
        joints: joints, from 1, that it takes to an angle not seen so far.
    """

    q_rad: Array
    load_N: float
    joints: tuple[int, ...]


def fill(
    survey: Survey, seen: AnglesSeen, count: int, random_seed: int = 0, room: Room | None = None
) -> tuple[FillingPose, ...]:
    """Choose configurations that take joints to angles not seen, the most of them first.

    Out of a pool drawn at random, within limits and near the measured places. An angle once chosen
    counts as seen, so that each configuration after the first goes elsewhere.

    Args:
        survey: the campaign.
        seen: angles that its poses have seen.
        count: configurations wanted at most.
        random_seed: draws the pool.
        room: where arm and tool may go; where None, the usual one, and wherever they were measured.

    Returns:
        The configurations; none where all angles within reach were seen, or none is admissible.
    """
    if not count or all(_everywhere(seen, joint) for joint in range(len(seen.turns))):
        return ()
    rng = np.random.default_rng(random_seed)
    try:
        q_rad = draw_admissible(survey, _POOL, room or _room(survey), rng)
    except DiscoveryError:
        return ()
    turns = np.array(seen.turns)
    new = ~seen.each(q_rad) & turns
    place = np.floor(np.mod(q_rad, _TURN) / (2.0 * WITHIN_RAD)).astype(np.intp)
    load_N = float(survey.poses.states.load_N.min())
    chosen = []
    for _ in range(count):
        gains = new.sum(axis=1)
        best = int(np.argmax(gains))
        if not gains[best]:
            break
        joints = np.flatnonzero(new[best])
        chosen.append(FillingPose(q_rad[best], load_N, tuple(int(j) + 1 for j in joints)))
        new[:, joints] &= place[:, joints] != place[best, joints]
    return tuple(chosen)


def _room(survey: Survey) -> Room:
    """Return the usual room, and as low and as near to the column as poses were measured."""
    T_instr_base, usual = survey.baseline.T_instr_base, Room()
    p_base_m = (
        survey.poses.measured.T_instr_target[:, :3, 3] - T_instr_base[:3, 3]
    ) @ T_instr_base[:3, :3]
    return Room(
        floor_m=min(usual.floor_m, float(p_base_m[:, 2].min())),
        column_m=min(usual.column_m, float(np.hypot(*p_base_m[:, :2].T).min())),
    )


def _everywhere(seen: AnglesSeen, joint: int) -> bool:
    """Tell whether a joint that turns has seen its whole turn; sliding ones are not asked."""
    if not seen.turns[joint]:
        return True
    stretches = seen.intervals[joint]
    return len(stretches) == 1 and bool(np.ptp(stretches[0]) >= _TURN)
