"""Displacements of a block against products of 4 x 4 matrices, for arms of many kinds."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pa10cal.arm.chain import Chain
from pa10cal.montecarlo.block import DisplacementBlock
from pa10cal.montecarlo.displacement import joint_motion, plan_displacement

RESOLVER = np.radians(0.011)
CYCLES = 64


def worst_difference(arm, flange, sigma_rad, seed):
    """Largest difference [m] over a few positions, with draws up to six standard deviations."""
    source = np.random.default_rng(seed)
    q_rad = source.uniform(-2.5, 2.5, (3, arm.n))
    plan = plan_displacement(joint_motion(Chain.of(arm), q_rad), sigma_rad)
    block = DisplacementBlock(plan, CYCLES)
    worst = 0.0
    for position, q in enumerate(q_rad):
        normals = np.clip(source.standard_normal((arm.n, CYCLES)), -6, 6)
        normals[:, 0] = 6 * np.sign(normals[:, 0])
        normals[:, 1] = 0
        block.normals[:] = normals
        block.displace(position)
        q = q.astype(np.longdouble)
        moved = flange(arm, q + sigma_rad * normals.T) - flange(arm, q[None])
        distance = np.sqrt((moved**2).sum(axis=1)).astype(float)
        assert block.error_m[1] == 0
        np.testing.assert_allclose(block.squared_m2, block.error_m**2, rtol=1e-14)
        worst = max(worst, np.abs(block.error_m - distance).max())
    return worst


LENGTH = st.sampled_from([0.0, 0.08, 0.45, -0.3])
TWIST = st.sampled_from([0.0, 0.0, 90.0, -90.0, 180.0, 33.0, -71.5])


@settings(max_examples=60, deadline=None)
@given(
    rows=st.lists(st.tuples(LENGTH, LENGTH, TWIST), min_size=1, max_size=7),
    convention=st.sampled_from(["standard", "modified"]),
    sigma_rad=st.sampled_from([1e-6, RESOLVER, 5e-3]),
    seed=st.integers(0, 10**6),
)
def test_exact_for_any_arm(make_arm, flange, rows, convention, sigma_rad, seed):
    arm = make_arm(rows, convention)
    assert worst_difference(arm, flange, sigma_rad, seed) < 1e-12


def test_exact_for_the_pa10(pa10, flange):
    assert worst_difference(pa10, flange, RESOLVER, 1) < 2e-13


@pytest.mark.skipif(
    np.finfo(np.longdouble).eps > 1e-18, reason="needs more digits than doubles have"
)
@pytest.mark.parametrize("sigma_rad", [1e-6, 1e-3])
def test_small_displacements_lose_no_digits(pa10, flange, sigma_rad):
    assert worst_difference(pa10, flange, sigma_rad, 2) < 1e-12 * sigma_rad


def groups_of(arm):
    q_rad = np.random.default_rng(0).uniform(-2, 2, (4, arm.n))
    return plan_displacement(joint_motion(Chain.of(arm), q_rad), RESOLVER).groups


def test_parallel_joints_are_merged_and_still_ones_left_out(pa10, make_arm):
    assert groups_of(pa10) == ((0,), (1, 2), (3,), (4,))
    scara = make_arm([(0.3, 0.4, 0), (0, 0.3, 0), (0, 0.2, 0), (0, 0.1, 0)])
    assert groups_of(scara) == ((0,), (1, 2, 3))
    turned_over = make_arm([(0.3, 0.1, 90), (0, 0.3, 180), (0, 0.2, 90), (0.1, 0.1, 0)])
    assert groups_of(turned_over) == ((0,), (1,), (2,), (3,))
    on_axis = make_arm([(0.3, 0.2, 90), (0, 0.0, 90), (0.2, 0.0, 0)])
    assert groups_of(on_axis) == ((0,), (1,))
    one = make_arm([(0.3, 0.2, 0)])
    assert groups_of(one) == ((0,),)
