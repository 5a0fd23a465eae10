"""Tests of what moved, sought in few readings."""

from dataclasses import replace

import numpy as np

from pa10cal.fit.moved import EFFECT, JOINT_ZERO, Hypothesis, Misfit, smallest_set
from pa10cal.rules import MOVED

KNOWN = 1e-6


def zero(joint: int, count: int) -> Hypothesis:
    """Return that the zero of a joint moved, of so many."""
    directions = np.zeros((count, 1))
    directions[joint - 1] = 1.0
    return Hypothesis(JOINT_ZERO, f"joint {joint}", np.array([joint - 1]), directions, MOVED.sizes)


def misfit(moved: list[float], repeats: int) -> Misfit:
    """Return readings of each joint by itself, moved by so many standard deviations."""
    rows = np.tile(np.eye(len(moved)), (repeats, 1))
    return Misfit(rows @ np.array(moved), rows, np.full(len(rows), KNOWN))


def test_an_arm_of_joint_zeros_alone_is_searched():
    possible = [zero(joint, 3) for joint in (1, 2, 3)]
    (part,) = smallest_set(misfit([0.0, 40.0, 0.0], repeats=4), possible)
    assert part.name == (JOINT_ZERO, "joint 2")
    assert part.gain > 10.0


def test_nothing_is_found_where_nothing_moved():
    assert smallest_set(misfit([0.0, 0.0, 0.0], repeats=4), [zero(j, 3) for j in (1, 2, 3)]) == ()


def test_a_set_may_hold_all_that_is_possible():
    effect = replace(zero(2, 2), kind=EFFECT, of="backlash of joint 2", sizes=(40.0,))
    parts = smallest_set(misfit([40.0, -40.0], repeats=6), [zero(1, 2), effect])
    assert [part.name for part in parts] == [
        (JOINT_ZERO, "joint 1"),
        (EFFECT, "backlash of joint 2"),
    ]
