"""The figure of the motion against targets on the base: drawn where there are any."""

import numpy as np

from pa10cal.figures.campaign.residuals import draw_base_motion


def test_shift_and_turn_are_drawn_with_their_bands(watched):
    assert watched.lacks("base_motion") is None
    figure = draw_base_motion(watched)
    shift, turn = figure.axes
    assert shift.get_ylabel() == "shift [mm]"
    drawn = [line.get_ydata() for line in shift.get_lines()]
    poses = watched.poses()
    np.testing.assert_allclose(drawn[1], poses["motion_y_mm"])
    assert len(turn.collections) == 3
    assert "smoothed in time" in figure.texts[-1].get_text()
    assert "Synthetic data." in watched.footer


def test_without_such_targets_it_is_left_out(watched):
    table = watched.poses().drop(columns=[c for c in watched.poses() if "base" in c])
    watched._read_once.clear()
    watched._read_once[watched.folder / "ingest/poses.parquet"] = table.drop(
        columns=[c for c in table if c.startswith("motion_")]
    )
    assert watched.lacks("base_motion") == "no targets on the base were read"
