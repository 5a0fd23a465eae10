"""The IRB 120 as published: joints, three reflectors and three on the base, on a made-up folder."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from made_up_datasets import IRB120, ROWS, edit, write_irb120
from pa10cal.campaign.read import read_campaign
from pa10cal.datasets.importing import write_campaigns
from pa10cal.datasets.readers import dataset_named
from pa10cal.errors import RawDataError

PLACES = [f"{name}{k}_{axis}_mm" for name in ("T", "base") for k in (1, 2, 3) for axis in "xyz"]

read, FILES = dataset_named("faro-irb120").read, dataset_named("faro-irb120").files


@pytest.fixture
def folder(tmp_path):
    return write_irb120(tmp_path / "irb")


def test_rows_of_the_seven_tables_come_together_and_zeros_were_not_seen(folder):
    (campaign,) = read(folder, 0.2)
    q_deg, *places = (np.loadtxt(folder / name) for name in FILES)
    np.testing.assert_array_equal(campaign.readings[[f"q{j}_deg" for j in range(1, 7)]], q_deg)
    p_mm = np.hstack(places)
    assert (p_mm == 0.0).sum() == 9
    p_mm[p_mm == 0.0] = np.nan
    np.testing.assert_array_equal(campaign.readings[PLACES], p_mm)
    assert np.isnan(p_mm[3:5, 3:6]).all()
    assert np.isnan(p_mm[6, 15:]).all()
    assert campaign.readings["base2_y_mm"].eq(1002.0).all()
    assert campaign.notes == (
        "10 configurations, 2 places not seen at the flange and 1 on the base",
    )
    assert campaign.left_out == ()
    assert (campaign.robot, campaign.instrument) == ("irb120", "points")
    assert "assumed" in campaign.provenance
    assert "No licence is stated by the owner" in campaign.provenance


def test_the_contracts_reader_takes_it_with_the_targets_on_the_base(folder, tmp_path):
    (place,) = write_campaigns(read(folder, 0.2), tmp_path / "raw")
    found = read_campaign(place)
    assert found.description.instrument.kind == "points"
    assert found.description.ball_names == ()
    assert found.quarantined == ()
    assert Counter(found.observations.kind.tolist()) == {"grid": 7, "holdout": 3}
    assert found.observations.measured.target_names == ("T1", "T2", "T3")
    assert any("targets on the base are seen" in note for note in found.notes)


def test_one_zero_is_a_coordinate(folder):
    edit(folder / IRB120 / "measured_SMR_1.txt", 2, 1, "0.0", separator=None)
    (campaign,) = read(folder, 0.2)
    assert campaign.readings.loc[1, "T1_y_mm"] == 0.0
    assert campaign.notes[0].startswith("10 configurations, 2 places")


def test_rows_that_cannot_be_used_are_listed(folder):
    edit(folder / IRB120 / "measured_joints.txt", 7, 0, "?", separator=None)
    for k in (1, 3):
        for column in range(3):
            path = folder / IRB120 / f"measured_SMR_{k}.txt"
            edit(path, 4, column, "0.0", separator=None)
    (campaign,) = read(folder, 0.2)
    assert [(row.file, row.line, row.reason) for row in campaign.left_out] == [
        (f"{IRB120}/measured_joints.txt", 7, "not a finite number"),
        (f"{IRB120}/measured_SMR_1.txt", 4, "no reflector was observed"),
    ]
    assert len(campaign.readings) == ROWS - 2
    q_deg = np.genfromtxt(folder / FILES[0])
    kept = [k for k in range(ROWS) if k not in (3, 6)]
    np.testing.assert_allclose(campaign.readings["q2_deg"], q_deg[kept, 1])


def test_tables_of_different_lengths_are_refused(folder):
    path = folder / IRB120 / "measured_SMR_3.txt"
    path.write_text("\n".join(path.read_text().splitlines()[:-1]))
    with pytest.raises(RawDataError, match=r"different numbers of rows .*measured_SMR_3\.txt 9"):
        read(folder, 0.2)


def test_too_many_unreadable_rows_are_refused(folder):
    for line in (2, 3, 4):
        edit(folder / IRB120 / "measured_joints.txt", line, 2, "x", separator=None)
    with pytest.raises(RawDataError, match=r"joints\.txt:2: q3_deg: 3 of 10 rows would be"):
        read(folder, 0.2)


def test_decimal_commas_are_refused(folder):
    path = folder / IRB120 / "measured_joints.txt"
    path.write_text(path.read_text().replace(".", ","))
    with pytest.raises(RawDataError, match=r"joints\.txt:1: decimal commas where decimal points"):
        read(folder, 0.2)
