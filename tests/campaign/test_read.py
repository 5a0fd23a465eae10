"""A campaign as it is read: what it holds, and what it says of itself."""

from __future__ import annotations

from pa10cal.campaign.read import read_campaign
from pa10cal.options import IngestOptions
from spoiling import delete


def test_readings_are_parted_by_what_they_are_for(raw_campaign):
    campaign = read_campaign(str(raw_campaign.write()))
    assert campaign.name == campaign.description.name
    assert campaign.arm.name == "pa10_6ce"
    assert len(campaign.observations) == 34
    assert set(campaign.calibration.kind) == {"grid"}
    assert set(campaign.held_out.kind) == {"holdout"}
    assert [set(line.kind) for line in campaign.lines] == [{"line_x"}, {"line_y"}]
    parts = (campaign.calibration, campaign.held_out, *campaign.lines)
    assert sum(len(part) for part in parts) == 34
    assert list(campaign.calibration.pose) == sorted(campaign.calibration.pose)


def test_it_says_what_was_read(raw_campaign):
    delete(raw_campaign.cmm, "P03", "22", "1", "B")
    campaign = read_campaign(raw_campaign.write(), IngestOptions(max_quarantined_fraction=0.5))
    assert campaign.summary.startswith("made-up: 33 configurations; 99 balls; ")
    assert f"{len(campaign.quarantined)} rows quarantined" in campaign.summary
    assert campaign.summary in repr(campaign)
    page = campaign._repr_html_()
    for words in ("made-up", "touch_trigger_cmm", "held out", "straight moves"):
        assert words in page
    for line in campaign.lines:
        assert f"{len(line)} readings of {len(set(line.pose))} poses" in page
