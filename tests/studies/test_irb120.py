"""The made-up IRB 120: in the layout of the tables, synthetic in so many words, read to the end."""

import numpy as np
import pytest

from pa10cal.campaign.read import read_campaign
from pa10cal.datasets.campaign_folder import write_campaigns
from pa10cal.datasets.readers.faro_irb120 import FILES, read
from pa10cal.studies.irb120 import write_tables

POSES = 150


@pytest.fixture(scope="module")
def tables(tmp_path_factory):
    """The folder of the tables, the truth beside it."""
    folder = tmp_path_factory.mktemp("irb") / "tables"
    write_tables(folder, folder.with_suffix(".json"), 5, POSES)
    return folder


def test_it_is_in_the_layout_and_the_truth_is_apart(tables):
    names = {path.name for path in tables.iterdir()}
    assert names == {*FILES, "base_1.txt", "base_2.txt", "base_3.txt", "provenance.txt"}
    assert np.loadtxt(tables / "joints.txt").shape == (POSES, 6)
    assert np.genfromtxt(tables / "reflector_2.txt").shape == (POSES, 3)
    assert tables.with_suffix(".json").is_file()


def test_the_same_seed_gives_the_same_bytes(tables, tmp_path):
    write_tables(tmp_path / "again", tmp_path / "truth.json", 5, POSES)
    for path in tables.iterdir():
        assert (tmp_path / "again" / path.name).read_bytes() == path.read_bytes()


def test_it_is_read_as_synthetic_with_the_motion_taken_out(tables, tmp_path):
    (imported,) = read(tables, 0.2)
    assert imported.provenance.startswith("Synthetic: made up")
    (place,) = write_campaigns((imported,), tmp_path / "raw")
    campaign = read_campaign(place)
    base = campaign.observations.base
    assert base.names == ("base1", "base2", "base3")
    assert base.found.form == "walk"
    assert 0.01 < 1e3 * np.abs(base.motion[:, :3]).max() < 0.3
    assert len(campaign.held_out) == round(0.3 * POSES)
    assert campaign.observations.measured.target_names == ("T1", "T2", "T3")
