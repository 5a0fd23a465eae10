"""The scatter of repeats, against numpy's own variance."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pa10cal.figures.repeats import PLACE_MM, GridScatter, incompleteness, scatter_by_load


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
    assert list(found) == ["0N", "44N"]
    for name, at in (("44N", 0), ("0N", 1)):
        assert found[name].largest_mm == pytest.approx(expected[at].max(), rel=1e-6)
        mean = expected[at].mean()
        assert found[name].mean_mm == pytest.approx(mean, rel=1e-6)
        assert found[name].mean_of_average_mm == pytest.approx(mean / repeats**0.5, rel=1e-6)


def after(case, mean_mm):
    """The calibration with this mean error after it at every load."""
    errors = {
        load: errors.model_copy(
            update={"after": errors.after.model_copy(update={"mean_mm": mean_mm})}
        )
        for load, errors in case.errors.items()
    }
    return case.model_copy(update={"errors": errors})


@pytest.mark.parametrize(("mean_mm", "times"), [(0.029, None), (0.2, "20 times")])
def test_a_model_is_incomplete_when_it_leaves_more_than_repeats_scatter(results, mean_mm, times):
    scatter = dict.fromkeys(("0N", "22N"), GridScatter(0.1, 0.03, 0.01))
    said = incompleteness(after(results.paper_calibration(), mean_mm), scatter)
    assert said is None if times is None else times in said


def test_nothing_is_said_of_a_model_without_repeats(results):
    assert incompleteness(after(results.paper_calibration(), 9.0), {}) is None


def test_nothing_is_known_without_repeats_or_without_grid_poses():
    p_mm = np.zeros((1, 3, 1, 3))
    assert scatter_by_load(poses(p_mm, [0])) == {}
    assert scatter_by_load(poses(np.zeros((1, 1, 4, 3)), [0], kind="holdout")) == {}
