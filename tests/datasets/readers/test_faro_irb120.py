"""The layout of joints and three reflectors as text tables, on a made-up folder."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from made_up_datasets import ROWS, edit, write_irb120
from pa10cal.campaign.read import read_campaign
from pa10cal.datasets.campaign_folder import write_campaigns
from pa10cal.datasets.readers.faro_irb120 import FILES, read
from pa10cal.errors import RawDataError

PLACES = [f"T{k}_{axis}_mm" for k in (1, 2, 3) for axis in "xyz"]


@pytest.fixture
def folder(tmp_path):
    return write_irb120(tmp_path / "irb")


def test_rows_of_the_four_tables_come_together(folder):
    (campaign,) = read(folder, 0.2)
    q_deg = np.loadtxt(folder / "joints.txt")
    np.testing.assert_allclose(campaign.poses[[f"q{j}_deg" for j in range(1, 7)]], q_deg)
    p_mm = np.hstack([np.genfromtxt(folder / name) for name in FILES[1:]])
    np.testing.assert_array_equal(campaign.poses[PLACES], p_mm)
    assert np.isnan(p_mm[3:5, 3:6]).all()
    assert campaign.poses[PLACES].isna().sum(axis=None) == 6
    assert campaign.notes == ("10 configurations, 2 places not seen",)
    assert campaign.left_out == ()
    assert (campaign.robot, campaign.instrument) == ("irb120", "points")
    assert "assumed" in campaign.provenance


def test_the_contracts_reader_takes_it(folder, tmp_path):
    (place,) = write_campaigns(read(folder, 0.2), tmp_path / "raw")
    found = read_campaign(place)
    assert found.description.instrument.kind == "points"
    assert found.description.ball_names == ()
    assert found.quarantined == ()
    assert Counter(found.observations.kind.tolist()) == {"grid": 7, "holdout": 3}


def test_a_reflector_seen_in_part_is_not_seen(folder):
    edit(folder / "reflector_1.txt", 2, 1, "-", separator=None)
    (campaign,) = read(folder, 0.2)
    assert campaign.poses.loc[1, ["T1_x_mm", "T1_y_mm", "T1_z_mm"]].isna().all()
    assert campaign.notes == ("10 configurations, 3 places not seen",)


def test_rows_that_cannot_be_used_are_listed(folder):
    edit(folder / "joints.txt", 7, 0, "?", separator=None)
    for k in (1, 3):
        for column in range(3):
            edit(folder / f"reflector_{k}.txt", 4, column, "nan", separator=None)
    (campaign,) = read(folder, 0.2)
    assert [(row.file, row.line, row.reason) for row in campaign.left_out] == [
        ("joints.txt", 7, "not a finite number"),
        ("reflector_1.txt", 4, "no reflector was observed"),
    ]
    assert len(campaign.poses) == ROWS - 2
    assert 3.0 not in set(campaign.poses["time_s"])
    q_deg = np.genfromtxt(folder / "joints.txt")
    kept = [k for k in range(ROWS) if k not in (3, 6)]
    np.testing.assert_allclose(campaign.poses["q2_deg"], q_deg[kept, 1])


def test_tables_of_different_lengths_are_refused(folder):
    path = folder / "reflector_3.txt"
    path.write_text("\n".join(path.read_text().splitlines()[:-1]))
    with pytest.raises(RawDataError, match=r"different numbers of rows .*reflector_3\.txt 9"):
        read(folder, 0.2)


def test_too_many_unreadable_rows_are_refused(folder):
    for line in (2, 3, 4):
        edit(folder / "joints.txt", line, 2, "x", separator=None)
    with pytest.raises(RawDataError, match=r"joints\.txt:2: 3 of 10 rows would be quarantined"):
        read(folder, 0.2)


def test_decimal_commas_are_refused(folder):
    path = folder / "joints.txt"
    path.write_text(path.read_text().replace(".", ","))
    with pytest.raises(RawDataError, match=r"joints\.txt:1: decimal commas where decimal points"):
        read(folder, 0.2)


def test_reflectors_on_the_base_and_whose_data_they_are_may_be_there(folder):
    (plain,) = read(folder, 0.2)
    assert "the tables do not say" in plain.provenance
    places = np.loadtxt(folder / "joints.txt")[:, :3] * 0.0 + [1.0, 2.0, 3.0]
    places[4] = np.nan
    for k in (1, 2):
        np.savetxt(folder / f"base_{k}.txt", places + k, fmt="%.3f")
    (folder / "provenance.txt").write_text("Measured in our\nlaboratory.\n")
    (campaign,) = read(folder, 0.2)
    assert campaign.provenance.startswith("Measured in our laboratory. Places of three")
    assert campaign.files == (*FILES, "base_1.txt", "base_2.txt")
    np.testing.assert_allclose(campaign.poses["base2_y_mm"].to_numpy()[:4], 4.0)
    assert np.isnan(campaign.poses["base1_x_mm"].to_numpy()[4])
    assert campaign.notes == plain.notes
