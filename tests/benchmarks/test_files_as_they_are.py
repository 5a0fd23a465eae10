"""Files with one mistake: its factor, unit or joints are told, or the file is read rightly."""

import numpy as np
import pytest
from benchmarks.files_as_they_are import joints, lengths, wrapped


@pytest.mark.slow
@pytest.mark.parametrize("number", [3, 5, 0])
def test_a_factor_or_a_unit_of_all_lengths_is_told(tmp_path, number):
    right, line = lengths(tmp_path / "file", number, np.random.default_rng([1, number]))
    assert right, line


@pytest.mark.slow
@pytest.mark.parametrize("number", [1, 4, 8])
def test_exchanged_joints_are_told_and_turns_taken_out(tmp_path, number):
    right, line = joints(tmp_path / "file", number, np.random.default_rng([1, number]))
    assert right, line


@pytest.mark.parametrize("way", ["0 to 360", "-180 to 180", "turns away", "turns a row"])
def test_other_turns_are_the_same_places_of_the_arm(way):
    rng = np.random.default_rng(3)
    q_deg = rng.uniform(-170.0, 170.0, (20, 2))
    turns = (wrapped(q_deg, way, rng) - q_deg) / 360.0
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-9)
    assert (np.ptp(np.round(turns), axis=0).max() == 0.0) == (way in ("-180 to 180", "turns away"))
