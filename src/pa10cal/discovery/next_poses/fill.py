"""Configurations that would show joint angles which no pose of the fit has seen."""

from __future__ import annotations

import numpy as np

from pa10cal.discovery.next_poses.room import (
    Measured,
    NextPose,
    Room,
    draw_admissible,
    measured_ends_m,
)
from pa10cal.errors import DiscoveryError
from pa10cal.fit.angles_seen import WITHIN_RAD, AnglesSeen

_POOL = 2000
_TURN = 2.0 * np.pi


def fill(
    measured: Measured, seen: AnglesSeen, count: int, random_seed: int = 0, room: Room | None = None
) -> tuple[NextPose, ...]:
    """Choose configurations that take joints to angles not seen, the most of them first.

    Out of a pool drawn at random, within limits and near the measured places. An angle once chosen
    counts as seen, so that each configuration after the first goes elsewhere.

    Args:
        measured: the campaign.
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
        q_rad = draw_admissible(measured, _POOL, room or _room(measured), rng)
    except DiscoveryError:
        return ()
    turns = np.array(seen.turns)
    new = ~seen.each(q_rad) & turns
    place = np.floor(np.mod(q_rad, _TURN) / (2.0 * WITHIN_RAD)).astype(np.intp)
    load_N = float(measured.cells.states.load_N.min())
    chosen = []
    for _ in range(count):
        gains = new.sum(axis=1)
        best = int(np.argmax(gains))
        if not gains[best]:
            break
        joints = np.flatnonzero(new[best])
        purposes = tuple(f"angle of joint {joint + 1} not seen" for joint in joints)
        chosen.append(NextPose(q_rad[best], load_N, purposes))
        new[:, joints] &= place[:, joints] != place[best, joints]
    return tuple(chosen)


def _room(measured: Measured) -> Room:
    """Return the usual room, and as low and as near to the column as poses were measured."""
    T_instr_base, usual = measured.baseline.T_instr_base, Room()
    p_base_m = (measured_ends_m(measured) - T_instr_base[:3, 3]) @ T_instr_base[:3, :3]
    return Room(
        floor_m=min(usual.floor_m, float(p_base_m[:, 2].min())),
        column_m=min(usual.column_m, float(np.hypot(*p_base_m[:, :2].T).min())),
    )


def _everywhere(seen: AnglesSeen, joint: int) -> bool:
    """Return whether a revolute joint has seen its whole turn; prismatic ones do not count."""
    if not seen.turns[joint]:
        return True
    stretches = seen.intervals[joint]
    return len(stretches) == 1 and bool(np.ptp(stretches[0]) >= _TURN)
