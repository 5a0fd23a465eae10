"""campaign.yaml: every key of the contract, and clear refusals."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from pa10cal.campaign.description import read_description
from pa10cal.errors import Pa10calError


def test_reads_every_key_of_the_contract(raw_campaign):
    raw_campaign.description["holdout"] = {"every": 5}
    campaign = read_description(raw_campaign.write())
    assert campaign.robot == "pa10_6ce"
    assert campaign.ball_names == ("A", "B", "C")
    np.testing.assert_array_equal(campaign.p_ee_balls_mm[1], [-50.0, 80.0, 310.0])
    assert campaign.gravity_m_s2 == (0.0, 0.0, -9.80665)
    assert campaign.holdout.every == 5


def change(description, key, value):
    *path, last = key.split(".")
    for part in path:
        description = description[part]
    if value is None:
        del description[last]
    else:
        description[last] = value


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("schema", "pa10cal-campaign/2", r"campaign.yaml: schema: .*another schema.*campaign/1"),
        ("schema", None, r"schema: .*another schema"),
        ("robot", None, r"campaign.yaml: missing key robot"),
        ("tool.com_mm", None, r"missing key tool.com_mm"),
        ("colour", 1, r"unknown key colour.*allowed: .*holdout.*; remove it"),
        ("instrment", {}, r"unknown key instrment.*did you mean 'instrument'"),
        ("tool.mass", 2.4, r"unknown key tool.mass.*did you mean 'mass_kg'"),
        ("instrument.kind", "camera", r"instrument.kind.*touch_trigger_cmm"),
        ("instrument.kind", "points", r"files.poses: the key is missing.*kind is points"),
        ("instrument.kind", "distance", r"files.poses: the key is missing.*kind is distance"),
        ("instrument.kind", "pose", r"files.poses: the key is missing"),
        ("instrument.uncertainty_mm", "0,0121", r"instrument.uncertainty_mm .*'0,0121'"),
        ("instrument.uncertainty_mm", 0.0, r"instrument.uncertainty_mm .*greater than 0"),
        ("gravity_m_s2", [0, float("nan"), 0], r"gravity_m_s2.*finite"),
        ("ball_diameter_mm", None, r"ball_diameter_mm: the key is missing"),
        ("tool.balls_mm", {"A": [0, 0, 0], "B": [1, 1, 1]}, r"tool.balls_mm.*three balls"),
        (
            "tool.balls_mm",
            {"A": [0, 0, 300], "B": [50, 0, 300], "C": [100, 0, 300]},
            r"tool.balls_mm.*not collinear",
        ),
        ("files.cmm", None, r"files.cmm: the key is missing"),
        ("files.cmm", "elsewhere.csv", r"files.cmm: .*'elsewhere.csv'.*inside the campaign"),
        ("files.cmm", "../cmm.csv", r"files.cmm"),
        ("files.cmm", 300 * "é" + ".csv", r"files.cmm: .*inside the campaign"),
        ("holdout", {"every": 5, "last_fraction": 0.3}, r"holdout: .*one of them"),
        ("holdout", {"last_fraction": 1.3}, r"holdout.last_fraction .*less than 1"),
    ],
)
def test_refuses_what_it_cannot_use(raw_campaign, key, value, message):
    folder = raw_campaign.write()
    change(raw_campaign.description, key, value)
    (folder / "campaign.yaml").write_text(yaml.safe_dump(raw_campaign.description))
    with pytest.raises(Pa10calError, match=message):
        read_description(folder)


def test_a_misspelt_key_is_named_before_the_one_that_is_missing_for_it(raw_campaign):
    raw_campaign.description["provenence"] = raw_campaign.description.pop("provenance")
    with pytest.raises(Pa10calError, match=r"unknown key provenence.*did you mean 'provenance'"):
        read_description(raw_campaign.write())


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "there is no campaign.yaml.*a folder of raw files"),
        ("a: [1, 2", "cannot be read"),
        ("just text", "holds no keys"),
        ("", "holds no keys"),
    ],
)
def test_refuses_an_unreadable_file(tmp_path, content, message):
    if content is not None:
        (tmp_path / "campaign.yaml").write_text(content)
    with pytest.raises(Pa10calError, match=message) as refusal:
        read_description(tmp_path)
    assert "\n" not in str(refusal.value)
