"""Laws of sets of poses: updates are exact, an exchange never loses, small cases are solved."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pa10cal.numerics.exchange import Criterion, Information, Share, exchange, one_by_one

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


@settings(max_examples=40, deadline=None)
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


@settings(max_examples=25, deadline=None)
@given(share=st.floats(0.0, 1.0), poses=st.integers(1, 12), **CASES)
def test_an_exchange_never_lowers_the_criterion(share, poses, seed, rows, unknowns, spread):
    white = rows_of(seed, rows, unknowns + 2, spread)
    shares = [Share(1.0 - share, unknowns), Share(share, unknowns + 2)]
    start = np.random.default_rng(seed).choice(len(white), poses, replace=False)
    found = exchange(Criterion(white, shares), start)
    assert np.all(np.diff(found.values) > 0.0)
    assert len(set(found.chosen.tolist())) == poses
    direct = sum(each.weight * log_det(white, found.chosen, each.columns) for each in shares)
    assert found.values[-1] == pytest.approx(direct, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_a_set_that_can_be_searched_whole_is_nearly_the_best(seed):
    white = rows_of(seed, 2, 4, 10.0, count=10)
    best = max(log_det(white, chosen) for chosen in combinations(range(10), 4))
    criterion = Criterion(white, [Share(1.0, 4)])
    found = exchange(criterion, one_by_one(criterion, 4))
    assert found.values[-1] > best - 0.2


def test_columns_projected_out_have_the_quotient_of_two_determinants():
    white = rows_of(1, 3, 6, 10.0)
    flat = white[:5].reshape(-1, 6)
    whole = np.eye(6) + flat.T @ flat
    schur = whole[4:, 4:] - whole[4:, :4] @ np.linalg.solve(whole[:4, :4], whole[:4, 4:])
    criterion = Criterion(white, [Share(-1.0, 4), Share(1.0, 6)])
    criterion.restart(range(5))
    assert criterion.value == pytest.approx(np.linalg.slogdet(schur)[1])
