"""Where postures may be: boxes, lines through them, what faces the instrument."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drawn_examples import examples
from pa10cal.arm.chain import Chain
from pa10cal.arm.workspace import Box, PosturePoints, admissible, facing, in_sight, keep_out, within
from pa10cal.files.arms import load_arm

BOX = Box(np.array([-1.0, -0.5, 0.0]), np.array([1.0, 0.5, 2.0]))
PLACE = st.tuples(*[st.floats(-3.0, 3.0)] * 3).map(np.array)


@examples(200)
@given(start=PLACE, end=PLACE)
def test_a_line_meets_a_box_where_one_of_its_points_lies_in_it(start, end):
    along = np.linspace(0.0, 1.0, 2001)[:, None]
    inside = BOX.holds(start + along * (end - start))
    if inside.any():
        assert BOX.meets(start, end)
    grown = Box(BOX.low_m - 5e-3, BOX.high_m + 5e-3)
    if not grown.holds(start + along * (end - start)).any():
        assert not BOX.meets(start, end)


@pytest.mark.parametrize(
    ("start", "end", "meets"),
    [
        ((-2.0, 0.0, 1.0), (2.0, 0.0, 1.0), True),  # along an axis, through
        ((-2.0, 0.0, 3.0), (2.0, 0.0, 3.0), False),  # along an axis, above
        ((0.0, 0.0, 1.0), (0.0, 0.0, 1.0), True),  # a point inside
        ((2.0, 0.0, 1.0), (3.0, 0.0, 1.0), False),  # the line would, the stretch does not
    ],
)
def test_lines_along_the_faces_are_decided_too(start, end, meets):
    assert BOX.meets(np.array(start), np.array(end)) == meets


def test_an_arm_keeps_out_of_boxes_and_in_sight():
    arm = load_arm("ur10")
    low, high = arm.limits_rad.T
    q = np.random.default_rng(0).uniform(low, high, (2000, arm.n))
    at = PosturePoints.of(Chain.of(arm), q, np.array([[0.0, 0.0, 0.1], [0.05, 0.0, 0.1]]))
    wall = Box(np.array([0.4, -2.0, -2.0]), np.array([0.5, 2.0, 0.3]))
    instrument = np.array([3.0, 0.0, 0.2])
    looking = facing(instrument, np.array([0.0, 0.0, 1.0]), np.radians(60.0))
    constraints = [keep_out(wall), in_sight(instrument, (wall,)), looking]
    allowed, removed = admissible(at, constraints)
    assert allowed.sum() + sum(removed) == len(q)
    assert 0 < allowed.sum() < len(q)
    for tool, end in zip(at.p_base_targets[allowed], at.p_base_end[allowed], strict=True):
        sampled = np.linspace(0.0, 1.0, 500)[:, None]
        for target in tool:
            assert not wall.holds(instrument + sampled * (target - instrument)).any()
        assert not wall.holds(end)
    looks = at.T_base_ee[allowed, :3, 2]
    way = instrument - at.p_base_targets[allowed, 0]
    cosine = np.sum(looks * way, axis=1) / np.linalg.norm(way, axis=1)
    assert cosine.min() >= np.cos(np.radians(60.0)) - 1e-12


def test_the_first_target_is_what_stays_in_the_workspace():
    arm = load_arm("irb120")
    q = np.zeros((1, arm.n))
    flange = PosturePoints.of(Chain.of(arm), q, np.zeros((1, 3)))
    ahead = PosturePoints.of(Chain.of(arm), q, np.array([[0.0, 0.0, 0.2]]))
    p = flange.p_base_end[0]
    about = within(Box(p - 0.05, p + 0.05))
    assert about(flange).all()
    assert not about(ahead).any()
