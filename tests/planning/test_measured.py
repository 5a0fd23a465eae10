"""What a glance at a table of poses tells."""

import pandas as pd
import pytest

from pa10cal.planning.measured import has_held_out, has_repeats


@pytest.fixture
def table(tmp_path):
    def write(rows):
        frame = pd.DataFrame(rows, columns=["kind", "pose", "load_N"])
        frame.to_parquet(tmp_path / "poses.parquet")
        return tmp_path / "poses.parquet"

    return write


def test_poses_are_held_out_where_a_row_says_so(table):
    assert has_held_out(table([("grid", "P1", 0.0), ("holdout", "H1", 0.0)]))
    assert not has_held_out(table([("grid", "P1", 0.0), ("line_x", "LX1", 0.0)]))


@pytest.mark.parametrize(
    ("again", "repeated"),
    [
        (("grid", "P1", 0.0), True),
        (("grid", "P1", 22.0), False),
        (("grid", "P2", 0.0), False),
        (("holdout", "P1", 0.0), False),
    ],
)
def test_a_repeat_is_the_same_pose_at_the_same_load_to_be_fitted(table, again, repeated):
    rows = [("grid", "P1", 0.0), again, ("holdout", "H1", 0.0), ("holdout", "H1", 0.0)]
    assert has_repeats(table(rows)) is repeated
