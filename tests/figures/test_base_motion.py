"""The figure of the motion against targets on the base: drawn where there are any."""

import numpy as np
import pytest

from pa10cal.campaign.read import read_campaign
from pa10cal.campaign.table import write_pose_table
from pa10cal.datasets.campaign_folder import write_campaigns
from pa10cal.datasets.readers.faro_irb120 import read
from pa10cal.figures.campaign.base_motion import draw
from pa10cal.figures.options import PictureOptions
from pa10cal.figures.results import Results
from pa10cal.studies.irb120 import write_tables


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Results of a small made-up campaign, of which the table of poses alone is there."""
    place = tmp_path_factory.mktemp("watched")
    write_tables(place / "tables", place / "truth.json", 6, 120)
    (raw,) = write_campaigns(read(place / "tables", 0.2), place / "raw")
    campaign = read_campaign(raw)
    (place / "results/ingest").mkdir(parents=True)
    path = place / "results/ingest/poses.parquet"
    write_pose_table(path, campaign.observations, campaign.arm.prismatic, campaign.name)
    return Results.of(raw, place / "results", PictureOptions())


def test_shift_and_turn_are_drawn_with_their_bands(results):
    assert results.lacks("base_motion") is None
    figure = draw(results)
    shift, turn = figure.axes
    assert shift.get_ylabel() == "shift [mm]"
    drawn = [line.get_ydata() for line in shift.get_lines()]
    poses = results.poses()
    np.testing.assert_allclose(drawn[1], poses["motion_y_mm"])
    assert len(turn.collections) == 3
    assert "smoothed in time" in figure.texts[-1].get_text()
    assert "Synthetic data." in results.footer


def test_without_such_targets_it_is_left_out(results, tmp_path):
    table = results.poses().drop(columns=[c for c in results.poses() if "base" in c])
    results._read_once.clear()
    results._read_once[results.folder / "ingest/poses.parquet"] = table.drop(
        columns=[c for c in table if c.startswith("motion_")]
    )
    assert results.lacks("base_motion") == "no targets on the base were read"
