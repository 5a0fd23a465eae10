"""Laws of the joint angles, and the chain as an arm of this project."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from drawn_examples import examples
from made_up_curves import gentle_spline
from pa10cal.arm.chain import Chain, frames
from pa10cal.arm.description import neighbouring_axes
from pa10cal.arrays import homogeneous
from pa10cal.errors import ArmError, CurveError
from pa10cal_curve.angles import (
    arm_on_first_link,
    arm_posture,
    chain_arm,
    chain_points,
    first_axes,
    joint_angles,
)
from pa10cal_curve.curve import circle, line
from pa10cal_curve.points import lay_points

SEEDS = st.integers(0, 2**32 - 1)
ROLLS = st.floats(-np.pi, np.pi)
ORDERS = st.sampled_from(["zy", "yz"])
BENDS = st.sampled_from([1e-9, 0.3, 1.5, 3.1])
EXAMPLES = examples(60)


def angles_at(directions, roll_rad=0.0, order="zy"):
    return joint_angles(directions, first_axes(directions, roll_rad), order)


def points_of(directions):
    return np.vstack([np.zeros(3), np.cumsum(directions, axis=0)])


@given(seed=SEEDS, roll=ROLLS, order=ORDERS, bend=BENDS)
@EXAMPLES
def test_forward_kinematics_returns_the_points(random_directions, seed, roll, order, bend):
    u = random_directions(seed, 40, bend)
    axes = first_axes(u, roll)
    joints = joint_angles(u, axes, order)
    back = chain_points(joints.a_rad, joints.b_rad, order, axes, np.zeros(3), 1.0)
    np.testing.assert_allclose(back, points_of(u), atol=40 * 1e-13)
    lifted = joints.b_rad if order == "zy" else joints.a_rad
    assert (np.abs(lifted) <= np.pi / 2).all()


@given(seed=SEEDS, roll=ROLLS, order=ORDERS, bend=BENDS)
@EXAMPLES
def test_the_frames_are_those_of_the_turns(random_directions, seed, roll, order, bend):
    u = random_directions(seed, 10, bend)
    joints = angles_at(u, roll, order)
    about_z = Rotation.from_euler("z", joints.a_rad[:, None]).as_matrix()
    about_y = Rotation.from_euler("y", joints.b_rad[:, None]).as_matrix()
    turns = about_z @ about_y if order == "zy" else about_y @ about_z
    np.testing.assert_allclose(joints.axes[:-1] @ turns, joints.axes[1:], atol=1e-13)
    np.testing.assert_allclose(np.linalg.det(joints.axes), 1.0, atol=1e-13)


def test_forward_kinematics_of_a_thousand_links_on_a_spline():
    points = lay_points(gentle_spline(np.random.default_rng(1)), 1.05e-3, most=1000)
    assert points.n == 1000
    axes = first_axes(points.directions, 0.4)
    joints = joint_angles(points.directions, axes)
    back = chain_points(joints.a_rad, joints.b_rad, "zy", axes, points.p_m[0], points.link_m)
    assert np.linalg.norm(back - points.p_m, axis=1).max() <= 1e-11 * 1000 * points.link_m


@given(seed=SEEDS, roll=ROLLS, order=ORDERS, bend=BENDS)
@EXAMPLES
def test_half_a_turn_of_roll_flips_all_signs(random_directions, seed, roll, order, bend):
    u = random_directions(seed, 20, bend)
    one, other = angles_at(u, roll, order), angles_at(u, roll + np.pi, order)
    for first, second in ((one.a_rad, other.a_rad), (one.b_rad, other.b_rad)):
        np.testing.assert_allclose(np.exp(1j * (first + second)), 1.0, atol=1e-9)  # pi is -pi


@given(roll=ROLLS, order=ORDERS, seed=SEEDS)
@EXAMPLES
def test_a_straight_line_has_no_angles(roll, order, seed):
    along = np.random.default_rng(seed).normal(size=3)
    u = np.tile(along / np.linalg.norm(along), (12, 1))
    joints = angles_at(u, roll, order)
    np.testing.assert_allclose(joints.a_rad, 0.0, atol=1e-15)
    np.testing.assert_allclose(joints.b_rad, 0.0, atol=1e-15)
    laid = lay_points(line(1.0), 0.1).directions
    assert not angles_at(laid, roll, order).a_rad.any()


@given(seed=SEEDS, order=ORDERS)
@EXAMPLES
def test_a_curve_in_a_plane_turns_one_axis_only(seed, order):
    random = np.random.default_rng(seed)
    heading = np.cumsum(random.uniform(-0.5, 0.5, 20))
    turn = Rotation.random(rng=random)
    u = turn.apply(np.stack([np.cos(heading), np.sin(heading), np.zeros(20)], axis=1))
    bends = np.diff(heading) * np.sign(np.diff(heading)[0])
    flat, upright = angles_at(u, 0.0, order), angles_at(u, np.pi / 2, order)
    np.testing.assert_allclose(flat.a_rad, bends, atol=1e-12)
    np.testing.assert_allclose(flat.b_rad, 0.0, atol=1e-12)
    np.testing.assert_allclose(upright.b_rad, bends, atol=1e-12)
    np.testing.assert_allclose(upright.a_rad, 0.0, atol=1e-11)


@given(kappa_l=st.floats(0.01, 1.3))
@EXAMPLES
def test_on_a_circle_every_joint_turns_alike(kappa_l):
    joints = angles_at(lay_points(circle(1.0, 6.0), kappa_l, most=40).directions)
    np.testing.assert_allclose(joints.a_rad, 2.0 * np.arcsin(kappa_l / 2.0), rtol=1e-9)


@given(seed=SEEDS, roll=ROLLS, bend=st.sampled_from([0.3, 1.4]))
@EXAMPLES
def test_reversed_a_chain_turns_back_in_the_other_order(random_directions, seed, roll, bend):
    """From the other end F R_z(pi) is a link's frame, and R_z(a) R_y(b) becomes R_y(b) R_z(-a)."""
    u = random_directions(seed, 15, bend)
    joints = angles_at(u, roll)
    half_turn = np.diag([-1.0, -1.0, 1.0])
    back = joint_angles(-u[::-1], joints.axes[-1] @ half_turn, "yz")
    np.testing.assert_allclose(back.a_rad, -joints.a_rad[::-1], atol=1e-10)
    np.testing.assert_allclose(back.b_rad, joints.b_rad[::-1], atol=1e-10)
    np.testing.assert_allclose(back.axes[::-1], joints.axes @ half_turn, atol=1e-10)


@given(seed=SEEDS, roll=ROLLS, order=ORDERS, bend=st.sampled_from([0.3, 1.4]))
@EXAMPLES
def test_a_rigid_motion_changes_no_angle(random_directions, seed, roll, order, bend):
    u = random_directions(seed, 15, bend)
    turn = Rotation.random(rng=np.random.default_rng(seed))
    still, moved = angles_at(u, roll, order), angles_at(turn.apply(u), roll, order)
    np.testing.assert_allclose(moved.a_rad, still.a_rad, atol=1e-8)
    np.testing.assert_allclose(moved.b_rad, still.b_rad, atol=1e-8)


@pytest.mark.parametrize("order", ["zy", "yz"])
def test_a_right_angle_of_the_second_turn_keeps_the_first(order):
    bend = 0.3
    first = np.array([np.cos(bend), np.sin(bend), 0.0])  # in the plane of the first turn of `zy`
    u = np.array([[1.0, 0, 0], first, [0, 0, 1.0], [1.0, 0, 0]])
    if order == "yz":
        u = u[:, [0, 2, 1]]
    axes = np.eye(3)
    joints = joint_angles(u, axes, order)
    assert joints.open.tolist() == [False, True, False]
    turned = joints.a_rad if order == "zy" else joints.b_rad
    lifted = joints.b_rad if order == "zy" else joints.a_rad
    assert turned[1] == turned[0] != 0.0
    assert abs(lifted[1]) == pytest.approx(np.pi / 2)
    back = chain_points(joints.a_rad, joints.b_rad, order, axes, np.zeros(3), 1.0)
    np.testing.assert_allclose(back, points_of(u), atol=1e-15)
    at_once = joint_angles(u[1:], np.column_stack([u[1], np.cross(u[2], u[1]), u[2]]), order)
    if order == "zy":
        assert at_once.open[0]
        assert at_once.a_rad[0] == 0.0


@given(seed=SEEDS, near=st.floats(1e-15, 1e-6), order=ORDERS)
@EXAMPLES
def test_near_a_right_angle_forward_kinematics_still_returns_the_points(
    random_directions, seed, near, order
):
    u = random_directions(seed, 8, 1.0)
    axes = first_axes(u, 0.3)
    before = joint_angles(u, axes, order).axes[-1]
    pole = before[:, 2 if order == "zy" else 1] + near * before[:, 0]
    u = np.vstack([u, pole / np.linalg.norm(pole), random_directions(seed + 1, 5, 1.0)])
    joints = joint_angles(u, axes, order)
    back = chain_points(joints.a_rad, joints.b_rad, order, axes, np.zeros(3), 1.0)
    np.testing.assert_allclose(back, points_of(u), atol=1e-12)


@given(seed=SEEDS, roll=ROLLS, bend=BENDS)
@EXAMPLES
def test_roll_is_counted_from_the_axis_given(random_directions, seed, roll, bend):
    u = random_directions(seed, 5, bend)
    z = np.random.default_rng(seed + 1).normal(size=3)
    at_zero = first_axes(u, 0.0, z)
    assume(np.linalg.norm(np.cross(z, u[0])) > 1e-3)
    assert at_zero[:, 2] @ z == pytest.approx(np.linalg.norm(np.cross(u[0], z)))
    turned = Rotation.from_rotvec(roll * u[0]).apply(at_zero.T).T
    np.testing.assert_allclose(first_axes(u, roll, z), turned, atol=1e-14)


def test_no_links_have_no_frame():
    with pytest.raises(CurveError, match="links: there is no link to turn"):
        first_axes(np.zeros((0, 3)), 0.0)


# The chain as an arm of this project.


LINKS, LINK_M = 6, 0.15


@given(seed=st.integers(0, 2**32 - 1))
@examples(25)
def test_the_arms_forward_kinematics_returns_the_points(seed):
    random = np.random.default_rng(seed)
    points = lay_points(gentle_spline(random), LINK_M, LINKS)
    T_base = homogeneous(Rotation.random(rng=random).as_matrix(), points.p_m[0])
    q_rad = arm_posture(points.p_m, T_base, LINK_M)
    chain = Chain.of(chain_arm("chain_6", LINKS, LINK_M, np.pi))
    along = frames(chain, chain.coordinates(q_rad[None]))
    laid = T_base @ along.T_base_rows[1::2, 0]
    np.testing.assert_allclose(laid[:, :3, 3], points.p_m[1:], atol=1e-12)
    np.testing.assert_allclose(laid[:, :3, 0], points.directions, atol=1e-12)


def test_straight_at_zero_and_without_parallel_neighbours():
    arm = chain_arm("chain_6", LINKS, LINK_M, 1.5)
    assert arm.n == 2 * LINKS
    T_straight = np.eye(4)
    T_straight[0, 3] = LINKS * LINK_M
    found = Chain.of(arm).forward(np.zeros((1, 12)))[0]
    np.testing.assert_allclose(found, T_straight, atol=1e-15)
    assert not any(axes.parallel for axes in neighbouring_axes(arm))
    assert (arm.limits_rad == [-1.5, 1.5]).all()


@given(seed=st.integers(0, 2**32 - 1), order=st.sampled_from(["zy", "yz"]))
@examples(25)
def test_an_arm_on_its_first_link_moves_by_the_angles_between_links(seed, order):
    random = np.random.default_rng(seed)
    points = lay_points(gentle_spline(random), LINK_M, LINKS)
    first = first_axes(points.directions, random.uniform(0.0, 6.0))
    joints = joint_angles(points.directions, first, order)
    limits_rad = np.array([[-1.0, 1.1], [-1.2, 1.3]])
    arm = arm_on_first_link("chain", LINKS, LINK_M, limits_rad, order)
    assert arm.n == 2 * (LINKS - 1)
    of_turn = limits_rad if order == "zy" else limits_rad[::-1]
    np.testing.assert_array_equal(arm.limits_rad[:2], of_turn)
    turns = joints.turns_rad if order == "zy" else joints.turns_rad[::-1]
    T_base = homogeneous(first, points.p_m[0])
    T_end = T_base @ Chain.of(arm).forward(turns.T.reshape(1, -1))[0]
    np.testing.assert_allclose(T_end[:3, 3], points.p_m[-1], atol=1e-12)
    np.testing.assert_allclose(T_end[:3, :3], joints.axes[-1], atol=1e-12)
    assert not any(axes.parallel for axes in neighbouring_axes(arm))


def test_points_that_are_no_shape_of_it_are_refused():
    points = lay_points(gentle_spline(np.random.default_rng(1)), LINK_M, LINKS)
    T_base = np.eye(4)
    T_base[:3, 3] = points.p_m[0]
    with pytest.raises(CurveError, match=r"points do not fit the arm \(got '0.05 m off'\)"):
        arm_posture(points.p_m, T_base, 0.2)
    with pytest.raises(CurveError, match="points do not fit the arm"):
        arm_posture(points.p_m + 1e-3, T_base, LINK_M)


def test_an_arm_needs_a_link_of_an_arms_length():
    with pytest.raises(CurveError, match="links: there is no link"):
        chain_arm("none", 0, LINK_M, 1.5)
    with pytest.raises(ArmError, match="longer than 100 m"):
        chain_arm("long", 2, 101.0, 1.5)
