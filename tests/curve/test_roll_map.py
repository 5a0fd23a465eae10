"""Joint angles as a function of roll, against the frames carried link by link."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pa10cal.curve.angles import first_axes, joint_angles
from pa10cal.curve.roll import RollMap

SEEDS = st.integers(0, 2**32 - 1)
ORDERS = st.sampled_from(["zy", "yz"])


@given(seed=SEEDS, order=ORDERS, bend=st.sampled_from([1e-7, 0.5, 1.5, 3.1]), n=st.integers(1, 40))
@settings(max_examples=60, deadline=None)
def test_all_rolls_at_once_are_each_carried_along(random_directions, seed, order, bend, n):
    u = random_directions(seed, n, bend)
    chain = RollMap.of(u, order)
    rolls = np.random.default_rng(seed).uniform(0, 2 * np.pi, 4)
    a_rad, b_rad = chain.angles(rolls)
    for k, roll in enumerate(rolls):
        joints = joint_angles(u, first_axes(u, roll), order)
        # Where sharp bends forget the roll, rounding of it is forgotten too, but for a few rolls.
        np.testing.assert_allclose(np.sin(a_rad[k]), np.sin(joints.a_rad), atol=1e-6)
        np.testing.assert_allclose(np.sin(b_rad[k]), np.sin(joints.b_rad), atol=1e-6)


@given(seed=SEEDS, order=ORDERS, bend=st.sampled_from([0.5, 1.5, 2.5]))
@settings(max_examples=60, deadline=None)
def test_the_way_back_from_an_axis_gives_the_roll(random_directions, seed, order, bend):
    u = random_directions(seed, 6, bend)
    chain = RollMap.of(u, order)
    roll = np.random.default_rng(seed).uniform(0, 2 * np.pi)
    axes = joint_angles(u, first_axes(u, roll), order).axes
    carried = axes[:, :, 1 if order == "zy" else 2]
    plane = np.einsum("kia,ki->ka", chain.across, carried)
    found = chain.roll_of(np.arange(6), np.arctan2(plane[:, 1], plane[:, 0]))
    np.testing.assert_allclose(found, np.tile([np.cos(roll), np.sin(roll)], (6, 1)), atol=1e-6)


def test_a_bent_chain_forgets_the_roll_by_the_cosine_of_each_bend():
    """In a plane: the tangent of the angle from its normal shrinks by the cosine, link by link."""
    heading = 0.4 * np.arange(12)
    u = np.stack([np.cos(heading), np.sin(heading), np.zeros(12)], axis=1)
    joints = joint_angles(u, first_axes(u, 0.9))
    tilt = np.tan(np.arccos(joints.axes[:, 2, 2]))
    np.testing.assert_allclose(tilt, np.tan(0.9) * np.cos(0.4) ** np.arange(12), rtol=1e-9)
    singular = np.linalg.svd(RollMap.of(u).maps[-1])[1]
    assert singular[1] / singular[0] == pytest.approx(np.cos(0.4) ** 11)
