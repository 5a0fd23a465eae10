"""Rows taken in one pose after the other tell as much as all at once."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pa10cal.discovery.next_poses.contest import Outlook


def start(rng, k=5, m=2, pool=7, b=3):
    present, effect = rng.normal(size=(20, k)), rng.normal(size=(20, m))
    adjustable, ahead = 3.0 * rng.normal(size=(pool, b, k)), rng.normal(size=(pool, b, m))
    return present, effect, adjustable, ahead


def left_over(rows, target):
    """Least squares with every unknown about zero, of unit size."""
    k = rows.shape[1]
    rows = np.concatenate([rows, np.eye(k)])
    target = np.concatenate([target, np.zeros((k, target.shape[1]))])
    return np.sum((target - rows @ np.linalg.lstsq(rows, target, rcond=None)[0]) ** 2)


@given(seed=st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=30)
def test_one_after_the_other_is_all_at_once(seed):
    rng = np.random.default_rng(seed)
    present, effect, adjustable, ahead = start(rng)
    outlook = Outlook.of(present, effect, adjustable, ahead, poses=4)
    chosen = rng.permutation(7)[:3]
    for pose in chosen:
        foreseen = outlook.nats_with()[pose]
        outlook = outlook.after(pose)
        assert outlook.nats == pytest.approx(foreseen, rel=1e-9)
    energy = left_over(
        np.concatenate([present, *adjustable[chosen]]), np.concatenate([effect, *ahead[chosen]])
    )
    assert outlook.energy == pytest.approx(energy, rel=1e-9)
    assert outlook.components == 4 * 3 + 3 * 3


def test_what_the_rest_can_follow_everywhere_is_never_told_from_it():
    present, _, adjustable, _ = start(np.random.default_rng(1))
    mixed = 1e-3 * np.ones((5, 1))
    outlook = Outlook.of(present, present @ mixed, adjustable, adjustable @ mixed, poses=4)
    for pose in range(7):
        outlook = outlook.after(pose)
    assert outlook.nats < 1e-5


def test_a_small_sum_of_squares_costs_half_of_it_and_a_large_one_less():
    present, effect, adjustable, ahead = start(np.random.default_rng(2))
    small, large = (
        Outlook.of(present, size * effect, adjustable, size * ahead, poses=4) for size in (1e-3, 10)
    )
    assert small.nats == pytest.approx(0.5 * small.energy, rel=1e-4)
    assert large.nats < 0.2 * large.energy
    assert large.energy == pytest.approx(1e8 * small.energy)
