"""Displacements against products of 4 x 4 matrices, and turns against extended precision."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pa10cal.arm.chain import Chain
from pa10cal.montecarlo.plane import (
    DisplacementBlock,
    joint_screws,
    plan_displacement,
    series_is_exact,
    turns,
)

RESOLVER = np.radians(0.011)
CYCLES = 64


def worst_difference(arm, moved_by, sigma_rad, seed):
    """Largest difference [m] over a few positions, with draws up to six standard deviations.

    Args:
        moved_by: says how far turns move the flange, from the arm, its angles and the turns.
    """
    source = np.random.default_rng(seed)
    q_rad = source.uniform(-2.5, 2.5, (3, arm.n))
    plan = plan_displacement(joint_screws(Chain.of(arm), q_rad), sigma_rad)
    block = DisplacementBlock(plan, CYCLES)
    worst = 0.0
    for position, q in enumerate(q_rad):
        normals = np.clip(source.standard_normal((arm.n, CYCLES)), -6, 6)
        normals[:, 0] = 6 * np.sign(normals[:, 0])
        normals[:, 1] = 0
        block.normals[:] = normals
        block.displace(position)
        moved_m = moved_by(arm, q, sigma_rad * normals.T)
        distance = np.sqrt((moved_m**2).sum(axis=1)).astype(float)
        assert block.error_m[1] == 0
        worst = max(worst, np.abs(block.error_m - distance).max())
    return worst


def between(flange):
    """Say how far turns move the flange by where it is before and after."""
    return lambda arm, q_rad, dq_rad: (
        flange(arm, q_rad.astype(np.longdouble) + dq_rad) - flange(arm, q_rad[None])
    )


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
    assert worst_difference(arm, between(flange), sigma_rad, seed) < 1e-12


def test_exact_for_the_pa10(pa10, flange):
    assert worst_difference(pa10, between(flange), RESOLVER, 1) < 2e-13


@pytest.mark.parametrize("sigma_rad", [1e-6, 1e-3])
def test_small_displacements_lose_no_digits(pa10, moved, sigma_rad):
    assert worst_difference(pa10, moved, sigma_rad, 2) < 1e-12 * sigma_rad


def plan_of(arm):
    q_rad = np.random.default_rng(0).uniform(-2, 2, (4, arm.n))
    return plan_displacement(joint_screws(Chain.of(arm), q_rad), RESOLVER)


def test_outermost_joints_through_the_point_are_left_out(pa10, make_arm):
    assert plan_of(pa10).moving == 5
    on_axis = make_arm([(0.3, 0.2, 90), (0, 0.0, 90), (0.2, 0.0, 0)])
    assert plan_of(on_axis).moving == 2
    assert plan_of(make_arm([(0.3, 0.2, 0)])).products == ()


def test_axes_at_right_angles_take_fewer_products(make_arm):
    """Only one component of what the outer joint does is turned by the inner one."""
    at_right_angles = make_arm([(0.3, 0.1, 90), (0.2, 0.3, 90), (0.1, 0.2, 0)])
    oblique = make_arm([(0.3, 0.1, 50), (0.2, 0.3, 50), (0.1, 0.2, 0)])
    assert plan_of(at_right_angles).matrix.shape[2] < plan_of(oblique).matrix.shape[2]


@pytest.mark.parametrize("seed", range(8))
def test_parallel_joints_are_as_exact_as_others(pa10, flange, seed):
    """Joints 2 and 3 of the PA10 turn its forearm by the sum of their errors."""
    assert worst_difference(pa10, between(flange), RESOLVER, seed) < 1e-13


NORMALS = np.concatenate([np.linspace(-8, 8, 1601), [1e-9, -1e-9]])


def filled(sigma_rad, *, series):
    sine, versine = NORMALS.copy(), np.empty_like(NORMALS)
    turns(sine, versine, np.empty_like(NORMALS), sigma_rad, series=series)
    return sine, versine


@pytest.mark.parametrize("sigma_rad", [1e-6, np.radians(0.011), 2.5e-4, 1e-2, 0.3])
def test_exact_to_the_last_picometre_of_a_metre(sigma_rad):
    angle = sigma_rad * NORMALS.astype(np.longdouble)
    sine, versine = filled(sigma_rad, series=series_is_exact(sigma_rad))
    np.testing.assert_allclose(sine, np.sin(angle), rtol=1e-14, atol=3e-16)
    np.testing.assert_allclose(versine, 2 * np.sin(angle / 2) ** 2, rtol=1e-13, atol=1e-12)


def test_series_only_where_it_is_exact():
    assert series_is_exact(np.radians(0.011))
    assert series_is_exact(2.5e-4)
    assert not series_is_exact(np.radians(0.02))


def test_both_ways_agree():
    for one, other in zip(filled(1e-4, series=True), filled(1e-4, series=False), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-13, atol=2e-14)
