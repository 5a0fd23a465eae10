"""One arm before and after something happened to it: a crash, a new tool, another cell."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.arm.chain import BASE, TOOL, end_pose
from pa10cal_lab.cell.individual import draw_individual
from pa10cal_lab.cell.options import TrackerOptions

#: Base and tool are mounted anew about as well as they were.
_SHIFT_M, _TURN_RAD = 2e-3, 2e-3


@dataclass(frozen=True)
class Change:
    """What happened to an arm."""

    place: bool = False  # whether base and tool are mounted anew
    zero_rad: tuple[tuple[int, float], ...] = ()  # by joint, from 1: how far its zero moved
    softer: tuple[tuple[int, float], ...] = ()  # by joint: factor of its stiffness
    longer_m: tuple[tuple[int, float], ...] = ()  # by row: how much further the next joint is away


def plan_of(kind, poses):
    """Return how an instrument measures an arm with two springs, whose targets nobody states."""
    return TrackerOptions(
        instrument=kind,
        poses=poses,
        holdout_share=0.0,
        flexible_joints=(2, 3),
        hardening=False,
        states_targets=False,
    )


def draw_changed(arm, plan, change, rng):
    """Draw an individual, and the same after a change.

    Args:
        arm: its description.
        plan: of its campaigns: how it departs, its springs, its tool.
        change: what happens to it.
        rng: draws it, and where base and tool come to stand.
    """
    before = draw_individual(arm, plan, rng)
    return before, _after(before, change, rng)


def _after(robot, change, rng):
    placements = robot.mechanism.placements.copy()
    for joint, angle_rad in change.zero_rad:
        placements[joint - 1, :3, :3] @= Rotation.from_rotvec([0.0, 0.0, angle_rad]).as_matrix()
    for row, length_m in change.longer_m:
        way = placements[row, :3, 3]
        placements[row, :3, 3] += length_m * way / np.linalg.norm(way)
    k_lin = robot.springs.k_lin.copy()
    for joint, factor in change.softer:
        k_lin[joint - 1] *= factor
    changed = replace(
        robot,
        mechanism=replace(robot.mechanism, placements=placements),
        springs=replace(robot.springs, k_lin=k_lin),
    )
    if not change.place:
        return changed
    return replace(
        changed,
        T_instr_base=robot.T_instr_base @ _mounted(rng),
        T_ee_target=robot.T_ee_target @ _mounted(rng),
        targets=replace(robot.targets, p_ee_m=rng.normal(robot.targets.p_ee_m, _SHIFT_M)),
    )


def _mounted(rng):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(rng.normal(0.0, _TURN_RAD, 3)).as_matrix()
    T[:3, 3] = rng.normal(0.0, _SHIFT_M, 3)
    return T


# Chains whose coordinates are all a little off.


def departed(chain, seed=1):
    found = chain.nominal + np.random.default_rng(seed).normal(0, 2e-3, len(chain.nominal))
    found[chain.columns(BASE + TOOL)] = 0.0
    return found


def expected(chain, coordinates, q):
    at = np.tile(coordinates, (len(q), 1))
    at[:, chain.joint_columns] += q
    return end_pose(chain, at)
