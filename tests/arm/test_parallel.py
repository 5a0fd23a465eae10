"""Which rows take Hayati's beta, and that those rows say all a row has to say."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drawn_examples import examples
from pa10cal.arm.chain import BASE, TOOL, Chain, end_pose_with_screws, frames
from pa10cal.arm.description import NEARLY_PARALLEL_RAD, neighbouring_axes, with_hayati_rows
from pa10cal.files.arms import arm_names, load_arm
from pa10cal.options import Tolerances
from pa10cal.terms.offsets import link_departures

TILT = st.sampled_from([0.0, 1e-7, 0.02, np.pi - 0.02, np.pi, -0.3, np.pi / 2])


@pytest.mark.parametrize(
    ("name", "rows"),
    [
        ("pa10_6ce", [2]),
        ("ur10", [2, 3]),
        ("irb120", [2]),
        ("iiwa14", []),
        ("gx4_351s", [1, 2, 3]),
    ],
)
def test_rows_between_parallel_axes_take_beta(name, rows):
    arm = load_arm(name)
    assert (np.flatnonzero(arm.hayati) + 1).tolist() == rows
    assert [axes.row for axes in neighbouring_axes(arm) if axes.parallel] == rows


@examples(60)
@given(
    seed=st.integers(0, 10_000),
    convention=st.sampled_from(["standard", "modified"]),
    alpha=st.lists(TILT, min_size=4, max_size=4),
    beta=st.lists(st.sampled_from([0.0, 0.0, 0.01, 0.2]), min_size=4, max_size=4),
)
def test_angles_are_those_between_the_axes_of_the_chain(random_arm, seed, convention, alpha, beta):
    arm = random_arm(seed, 4, convention)
    arm = replace(arm, alpha_rad=np.array(alpha), beta_rad=np.array(beta))
    chain = Chain.of(arm)
    z = frames(chain, chain.nominal[None]).T_base_joints[:, 0, :3, 2]
    for axes in neighbouring_axes(arm):
        first, second = (z[joint - 1] for joint in axes.joints)
        across, along = np.linalg.norm(np.cross(first, second)), abs(first @ second)
        assert axes.angle_rad == pytest.approx(np.arctan2(across, along), abs=1e-12)


def rank_of(arm):
    """Return the rank of the poses' derivative by all link parameters, base and tool."""
    chain = Chain.of(arm)
    rng = np.random.default_rng(5)
    low, high = arm.limits_rad.T
    q = rng.uniform(np.maximum(low, -2.5), np.minimum(high, 2.5), (60, arm.n))
    names = (*link_departures(arm, Tolerances()).coordinates, *BASE, *TOOL)
    screws = end_pose_with_screws(chain, chain.coordinates(q)).screws[:, :, chain.columns(names)]
    by_names = screws.reshape(-1, len(names))
    return int(np.linalg.matrix_rank(by_names / np.linalg.norm(by_names, axis=0), tol=1e-9))


@pytest.mark.parametrize("name", arm_names())
def test_the_parameters_are_complete(name):
    # An arm of turning and sliding joints has 4 and 2 parameters each, and 6 of its two ends.
    arm = load_arm(name)
    slides = int(arm.prismatic.sum())
    assert rank_of(arm) == 4 * (arm.n - slides) + 2 * slides + 6


def modified(arm):
    """Return the arm in modified rows: alpha and a of a row belong to the one before."""
    moved = {
        name: np.concatenate([[0.0], getattr(arm, name)[:-1]]) for name in ("alpha_rad", "a_m")
    }
    return with_hayati_rows(replace(arm, convention="modified", **moved))


@pytest.mark.parametrize("name", ["ur10", "gx4_351s"])
def test_the_same_arm_in_modified_rows_is_as_complete(name):
    standard, arm = load_arm(name), modified(load_arm(name))
    q = np.random.default_rng(1).uniform(-1, 1, (5, arm.n))
    np.testing.assert_allclose(Chain.of(arm).forward(q), Chain.of(standard).forward(q), atol=1e-15)
    assert arm.hayati[1:].tolist() == standard.hayati[:-1].tolist()
    assert rank_of(arm) == rank_of(standard)


@pytest.mark.parametrize("of", [load_arm, lambda name: modified(load_arm(name))])
def test_without_beta_a_tilt_of_parallel_axes_is_lost(of):
    arm = of("ur10")
    assert rank_of(arm) == 30
    assert rank_of(replace(arm, hayati=np.zeros(6, bool))) == 28


@examples(30)
@given(angle=st.floats(0.0, np.pi / 2), sign=st.sampled_from([1.0, -1.0]), turn=st.booleans())
def test_the_threshold_is_the_one_stated(random_arm, angle, sign, turn):
    alpha = np.array([sign * angle + np.pi * turn, 0.7])
    arm = replace(random_arm(1, 2), alpha_rad=alpha)
    if abs(angle - NEARLY_PARALLEL_RAD) > 1e-9:
        assert with_hayati_rows(arm).hayati.tolist() == [angle < NEARLY_PARALLEL_RAD, False]
