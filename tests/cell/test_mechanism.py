"""The pinocchio model against products of matrices and point masses."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pa10cal.cell.built import Departures
from pa10cal.cell.mechanism import Mechanism, Strain

angles = st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6).map(np.array)
loads = st.sampled_from([0.0, 22.0, 90.0])
quick = settings(deadline=None, max_examples=40)


def with_departures(robot, seed):
    rng = np.random.default_rng(seed)
    return replace(robot, departures=Departures(*(rng.normal(0, 0.01, 6) for _ in range(5))))


def as_modified(robot):
    return replace(robot, arm=replace(robot.arm, convention="modified"))


def with_slides(robot):
    prismatic = np.array([False, False, True, False, False, True])
    return replace(robot, arm=replace(robot.arm, prismatic=prismatic))


def with_frames(robot):
    """Put the arm on a pillar that leans, a tool on its flange, and skew two of its rows."""
    leaning, tool = np.eye(4), np.eye(4)
    leaning[:3] = [[1.0, 0.0, 0.0, 0.3], [0.0, 0.6, -0.8, -0.1], [0.0, 0.8, 0.6, 0.5]]
    tool[:3] = [[0.0, 0.0, 1.0, 0.05], [1.0, 0.0, 0.0, 0.1], [0.0, 1.0, 0.0, 0.2]]
    beta_rad = np.array([0.0, 0.0, 0.3, 0.0, 0.0, -0.2])
    arm = replace(robot.arm, T_base_row1=leaning, T_row_n_ee=tool, beta_rad=beta_rad)
    return replace(robot, arm=arm)


VARIANTS = [
    lambda robot: robot,
    as_modified,
    with_slides,
    with_frames,
    lambda robot: with_frames(with_slides(as_modified(robot))),
]


@quick
@given(q=angles, seed=st.integers(0, 2**32), variant=st.sampled_from(VARIANTS))
def test_flange_is_the_product_of_the_rows(robot, plain, q, seed, variant):
    built = variant(with_departures(robot, seed))
    wanted = plain(built).flange(q)
    assert np.abs(Mechanism.of(built).T_base_ee(q) - wanted).max() < 1e-12


def test_nominal_arm_stands_straight_up_as_its_maker_says(robot):
    flange = Mechanism.nominal(robot).T_base_ee(np.zeros(6))
    assert flange[:3, 3] == pytest.approx([0.0, 0.0, 1.317], abs=1e-12)


@quick
@given(q=angles, load_N=loads, variant=st.sampled_from(VARIANTS))
def test_torques_are_the_slope_of_potential_energy(robot, plain, q, load_N, variant):
    built = variant(robot)
    other, mechanism, h = plain(built), Mechanism.of(built), 1e-5
    mechanism.hang(load_N)
    slope = [
        (other.energy(q + h * e, load_N) - other.energy(q - h * e, load_N)) / (2 * h)
        for e in np.eye(6)
    ]
    assert np.abs(mechanism.torques_Nm(q) - slope).max() < 1e-6


@quick
@given(q=angles, load_N=loads, seed=st.integers(0, 2**32), variant=st.sampled_from(VARIANTS))
def test_moments_are_those_of_the_weights_further_out(robot, plain, q, load_N, seed, variant):
    built = variant(with_departures(robot, seed))
    other, mechanism = plain(built), Mechanism.of(built)
    mechanism.hang(load_N)
    mechanism.torques_Nm(q)
    moments = mechanism.moments()
    assert np.abs(moments.base_Nm - other.moment(q, load_N, 0, np.zeros(3))).max() < 1e-10
    assert np.abs(moments.link_Nm[-1]).max() == 0.0
    for link, end in enumerate(other.ends(q)):
        wanted = other.moment(q, load_N, link + 1, end[:3, 3])
        assert np.abs(moments.link_Nm[link] - end[:3, :3].T @ wanted).max() < 1e-9


def test_a_new_weight_takes_the_place_of_the_former(robot):
    q = np.array([0.1, 0.4, 1.2, 0.2, 0.5, 0.3])
    mechanism, fresh = Mechanism.of(robot), Mechanism.of(robot)
    mechanism.hang(90.0)
    mechanism.hang(22.0)
    fresh.hang(22.0)
    assert np.array_equal(mechanism.torques_Nm(q), fresh.torques_Nm(q))


def test_a_strained_base_moves_the_whole_arm_and_gravity_stays(robot):
    q = np.array([0.1, 0.4, 1.2, 0.2, 0.5, 0.3])
    mechanism = Mechanism.of(robot)
    upright = mechanism.torques_Nm(q)
    flange = mechanism.T_base_ee(q)
    quarter = replace(
        Strain.none(6),
        base_turn_rad=np.array([0.0, np.pi, 0.0]),
        base_shift_m=np.array([0.1, 0.2, 0.3]),
    )
    mechanism.take_shape(quarter)
    moved = np.diag([-1.0, 1.0, -1.0, 1.0])
    moved[:3, 3] = [0.1, 0.2, 0.3]
    assert mechanism.T_base_ee(q) == pytest.approx(moved @ flange, abs=1e-12)
    assert mechanism.torques_Nm(q) == pytest.approx(-upright, abs=1e-9)
    mechanism.take_shape(Strain.none(6))
    assert np.array_equal(mechanism.T_base_ee(q), flange)


@pytest.mark.parametrize("link", range(6))
def test_a_strained_link_moves_what_follows_it(robot, plain, link):
    q = np.array([0.1, 0.4, 1.2, 0.2, 0.5, 0.3])
    shift, stretch = np.array([1e-3, -2e-3, 3e-3]), 0.01
    none = Strain.none(6)
    mechanism = Mechanism.of(robot)
    shifts, stretches = none.shift_m.copy(), none.stretch.copy()
    shifts[link] = shift
    mechanism.take_shape(replace(none, shift_m=shifts))
    before = plain(robot).frames(q)
    moved = mechanism.T_base_ee(q)[:3, 3] - before[-1][:3, 3]
    assert np.linalg.norm(moved) == pytest.approx(np.linalg.norm(shift), abs=1e-12)
    # The end turns about z against the row's frame, by the offset of the next row.
    assert moved @ before[link + 1][:3, 2] == pytest.approx(shift[2], abs=1e-12)

    stretches[link] = stretch
    mechanism.take_shape(replace(none, stretch=stretches))
    grown = mechanism.T_base_ee(q)[:3, 3] - before[-1][:3, 3]
    span = before[link + 1][:3, 3] - before[link][:3, 3]
    assert grown == pytest.approx(stretch * span, abs=1e-12)


def test_strains_add_up():
    one = replace(Strain.none(2), stretch=np.array([1.0, 2.0]), base_shift_m=np.ones(3))
    two = one + one
    assert two.stretch.tolist() == [2.0, 4.0]
    assert two.distance(one) == 2.0
    assert one.distance(one) == 0.0
