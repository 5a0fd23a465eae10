"""The scatter of repeats, against numpy's own variance."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pa10cal.figures.campaign.paper_figures import PLACE_MM, scatter_by_load


def poses(p_mm, loads, kind="grid"):
    """Poses of shape (loads, configurations, repeats, 3), in any order of loads."""
    count, configurations, repeats = p_mm.shape[:3]
    each = configurations * repeats
    labels = np.tile(np.repeat([f"P{k}" for k in range(configurations)], repeats), count)
    table = pd.DataFrame(p_mm.reshape(-1, 3), columns=list(PLACE_MM))
    return table.assign(
        kind=kind,
        pose=labels,
        load_N=np.repeat(np.array(loads, dtype=float), each),
        repeat=np.tile(np.arange(repeats), count * configurations),
    )


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**31), st.integers(1, 4), st.integers(2, 5))
def test_is_the_standard_deviation_of_the_distance(seed, configurations, repeats):
    p_mm = np.random.default_rng(seed).normal(500.0, 0.02, (2, configurations, repeats, 3))
    found = scatter_by_load(poses(p_mm, [44, 0]))
    expected = np.sqrt(p_mm.var(axis=2, ddof=1).sum(axis=2))
    assert list(found.index) == ["0N", "44N"]
    for name, at in (("44N", 0), ("0N", 1)):
        assert found.loc[name, "largest"] == pytest.approx(expected[at].max(), rel=1e-6)
        assert found.loc[name, "mean"] == pytest.approx(expected[at].mean(), rel=1e-6)


def test_nothing_is_known_without_repeats_or_without_grid_poses():
    p_mm = np.zeros((1, 3, 1, 3))
    assert scatter_by_load(poses(p_mm, [0])).empty
    assert scatter_by_load(poses(np.zeros((1, 1, 4, 3)), [0], kind="holdout")).empty
