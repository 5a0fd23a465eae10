"""Small couplings in simulated arms are named with c; large ones of a log with what to set."""

import numpy as np
import pytest
from benchmarks.couplings import large, quills, small


@pytest.mark.slow
@pytest.mark.parametrize("number", [0, 1, 2, 3, 4, 9])
def test_a_small_coupling_is_named_with_its_size_and_none_where_there_is_none(tmp_path, number):
    holds, line = small(tmp_path / "arm", number, np.random.default_rng([1, number]))
    wanted = ("none",) if number in (4, 9) else ("hidden", "named", "predicted")
    assert holds == wanted, line


@pytest.mark.slow
@pytest.mark.parametrize("number", range(4))
def test_joints_logged_together_are_told_with_what_to_set(tmp_path, number):
    holds, line = large(tmp_path / "arm", number, np.random.default_rng([1, number]))
    assert holds == ("logged together", "named"), line


@pytest.mark.slow
@pytest.mark.parametrize("number", range(2))
def test_a_quill_that_rises_by_millimetres_is_named(tmp_path, number):
    holds, line = quills(tmp_path / "arm", number, np.random.default_rng([1, number]))
    assert holds == ("hidden", "named", "predicted"), line
