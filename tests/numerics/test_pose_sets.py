"""Laws of sets of poses: updates are exact, an exchange never loses, small cases are solved."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from drawn_examples import examples
from pa10cal.numerics.pose_sets import (
    Combined,
    Information,
    SeparationCriterion,
    exchange,
    greedy_order,
    path_length,
    short_path,
)

CASES = {
    "seed": st.integers(0, 2**32 - 1),
    "rows": st.sampled_from([1, 3, 6]),
    "unknowns": st.integers(1, 12),
    "spread": st.sampled_from([1.0, 1e2, 1e4]),
}


def rows_of(seed, rows, unknowns, spread, count=25):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(count, rows, unknowns)) * np.geomspace(1.0, spread, unknowns)


def log_det(white, chosen, columns=None):
    k = white.shape[2] if columns is None else columns
    flat = white[list(chosen)][..., :k].reshape(-1, k)
    return float(np.linalg.slogdet(np.eye(k) + flat.T @ flat)[1])


def weighted(white, shares):
    weights, columns = zip(*shares, strict=True)
    parts = [Information(white[..., :k]) for k in columns]
    return Combined(parts, lambda values: np.array(weights) @ values)


@examples(40)
@given(**CASES)
def test_updates_give_what_a_direct_computation_gives(seed, rows, unknowns, spread):
    white = rows_of(seed, rows, unknowns, spread)
    told = Information(white)
    held = [3, 7, 7, 20, 1]
    for pose in held:
        told.add(pose)
    told.remove(7)
    held.remove(7)
    assert told.log_det == pytest.approx(log_det(white, held), rel=1e-6, abs=1e-6)
    direct = [log_det(white, [*held, each]) - log_det(white, held) for each in range(len(white))]
    assert told.gains() == pytest.approx(direct, rel=1e-5, abs=1e-5)
    flat = white[held].reshape(-1, unknowns)
    covariance = np.linalg.inv(np.eye(unknowns) + flat.T @ flat)
    assert told.covariance == pytest.approx(covariance, rel=1e-4, abs=1e-8)


@examples(25)
@given(share=st.floats(0.0, 1.0), poses=st.integers(1, 12), **CASES)
@example(share=0.5, poses=2, seed=0, rows=1, unknowns=5, spread=10000.0)
def test_an_exchange_never_lowers_the_criterion(share, poses, seed, rows, unknowns, spread):
    white = rows_of(seed, rows, unknowns + 2, spread)
    shares = [(1.0 - share, unknowns), (share, unknowns + 2)]
    start = np.random.default_rng(seed).choice(len(white), poses, replace=False)
    found = exchange(weighted(white, shares), start)
    assert np.all(np.diff(found.values) > 0.0)
    assert len(set(found.chosen.tolist())) == poses
    direct = sum(weight * log_det(white, found.chosen, columns) for weight, columns in shares)
    assert found.values[-1] == pytest.approx(direct, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_a_set_that_can_be_searched_whole_is_nearly_the_best(seed):
    white = rows_of(seed, 2, 4, 10.0, count=10)
    best = max(log_det(white, chosen) for chosen in combinations(range(10), 4))
    criterion = Information(white)
    found = exchange(criterion, greedy_order(criterion, 4))
    assert found.values[-1] > best - 0.2


def test_no_candidate_is_chosen_twice_where_more_are_asked_for_than_are_there():
    criterion = Information(rows_of(1, 3, 4, 1.0, count=5))
    assert sorted(greedy_order(criterion, 9)) == [0, 1, 2, 3, 4]
    assert sorted(greedy_order(criterion, 9, among=[2, 4])) == [2, 4]


def test_columns_projected_out_have_the_quotient_of_two_determinants():
    white = rows_of(1, 3, 6, 10.0)
    flat = white[:5].reshape(-1, 6)
    whole = np.eye(6) + flat.T @ flat
    schur = whole[4:, 4:] - whole[4:, :4] @ np.linalg.solve(whole[:4, :4], whole[:4, 4:])
    criterion = weighted(white, [(-1.0, 4), (1.0, 6)])
    criterion.restart(range(5))
    assert criterion.value == pytest.approx(np.linalg.slogdet(schur)[1])


def separation_of(seed, size=1.0):
    """An effect of two contributions against five unknowns, in 20 rows and 7 poses of 3."""
    rng = np.random.default_rng(seed)
    known, white = rng.normal(size=(20, 7)), rng.normal(size=(7, 3, 7))
    for rows in (known, white):
        rows[..., 5:] *= size
    return known, white, SeparationCriterion(white, np.concatenate([known, np.eye(7)]), 2, 12)


def sum_of_squares(rows, effect):
    """What unknowns about zero, of unit size, cannot follow of an effect, by least squares."""
    k = rows.shape[1]
    rows = np.concatenate([rows, np.eye(k)])
    target = np.concatenate([effect, np.zeros((k, effect.shape[1]))])
    return np.sum((target - rows @ np.linalg.lstsq(rows, target, rcond=None)[0]) ** 2)


@given(seed=st.integers(0, 2**32 - 1))
@examples(30)
def test_separation_pose_by_pose_is_that_of_all_poses_at_once(seed):
    known, white, criterion = separation_of(seed)
    chosen = np.random.default_rng(seed).permutation(7)[:3]
    for pose in chosen:
        expected = criterion.value + criterion.gains()[pose]
        criterion.add(pose)
        assert criterion.value == pytest.approx(expected, rel=1e-9)
    rows = np.concatenate([known, white[chosen].reshape(-1, 7)])
    squares, components = sum_of_squares(rows[:, :5], rows[:, 5:]), 12 + 3 * 3
    direct = 0.5 * components * np.log1p(squares / components)
    assert criterion.value == pytest.approx(direct, rel=1e-9)
    criterion.remove(chosen[0])
    taken_back = criterion.value
    criterion.restart(chosen[1:])
    assert taken_back == pytest.approx(criterion.value, rel=1e-6)


def test_what_all_else_can_follow_everywhere_never_comes_apart():
    known, white, _ = separation_of(1)
    for rows in (known, white):
        rows[..., 5:] = 1e-3 * rows[..., :5].sum(axis=-1, keepdims=True)
    criterion = SeparationCriterion(white, np.concatenate([known, np.eye(7)]), 2, 12)
    criterion.restart(range(7))
    assert criterion.value < 1e-5


def test_a_small_sum_of_squares_costs_half_of_it_and_a_large_one_less():
    half = 0.5 * sum_of_squares(*np.split(separation_of(2)[0], [5], axis=1))
    small, large = (separation_of(2, size)[2].value / size**2 for size in (1e-3, 10.0))
    assert small == pytest.approx(half, rel=1e-4)
    assert large < 0.4 * half


def test_the_least_of_several_is_what_a_set_is_chosen_by():
    several = [separation_of(seed)[2] for seed in range(3)]
    least = Combined(several)
    found = exchange(least, greedy_order(least, 3))
    for each in several:
        each.restart(found.chosen)
    assert found.values[-1] == pytest.approx(min(each.value for each in several))
    assert np.all(np.diff(found.values) > 0.0)


def test_a_short_path_is_no_longer_than_the_order_given():
    for seed in range(5):
        q = np.random.default_rng(seed).normal(size=(30, 6))
        order = short_path(q)
        assert sorted(order) == list(range(30))
        assert path_length(q[order]) < 0.7 * path_length(q)
