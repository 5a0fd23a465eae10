import numpy as np
import pytest

from pa10cal.lab.simulated import coverage, coverage_by_parameter


def test_normal_scores_are_covered_as_promised():
    found = coverage(np.random.default_rng(0).standard_normal((400, 10)))
    assert found.inside == pytest.approx(0.95, abs=0.01)
    assert found.inside_interval95[0] < 0.95 < found.inside_interval95[1]
    assert found.rms == pytest.approx(1.0, abs=0.03)


def test_scores_of_one_campaign_count_as_one():
    """Ten copies of a score are no more evidence than one."""
    one = np.random.default_rng(1).standard_normal((50, 1))
    alone, copied = coverage(one), coverage(np.repeat(one, 10, axis=1))
    assert alone.inside_interval95 == pytest.approx(copied.inside_interval95)


def test_a_score_that_is_not_there_counts_neither_way():
    scores = np.random.default_rng(2).standard_normal((60, 4))
    scores[::3, 1] = np.nan
    found, second = coverage(scores), coverage_by_parameter("abcd", scores)["b"]
    there = np.delete(scores[:, 1], np.arange(0, 60, 3))
    assert second.inside == pytest.approx(np.mean(np.abs(there) < 1.96))
    assert second.rms == pytest.approx(np.sqrt(np.mean(there**2)))
    assert np.isfinite([found.inside, *found.inside_interval95, found.rms]).all()
