"""The picture of a fleet: every arm of which errors are known, and what the others ask for."""

import pytest
from matplotlib.figure import Figure

from pa10cal.figures.over_campaigns import write_fleet
from pa10cal.results.fleet import ChainRecord, FleetArm, FleetCampaign, FleetRecord


def campaign(name, arm, after_mm, provenance="synthetic: a simulated cell"):
    status = "refused" if after_mm is None else "done"
    before_mm = None if after_mm is None else 1.0
    became = ChainRecord(
        campaign=name,
        status=status,
        provenance=provenance,
        before_mm=before_mm,
        after_mm=after_mm,
    )
    return FleetCampaign(arm=arm, campaign=name, became=became)


def fleet(*campaigns):
    arms = {each.arm: each for each in campaigns}  # the last of each
    return FleetRecord(
        counts={"good": len(campaigns)},
        arms=tuple(
            FleetArm(
                arm=arm,
                campaigns=1,
                last=last.campaign,
                attention="none" if last.became.after_mm else "no_result",
                why="as it is",
            )
            for arm, last in arms.items()
        ),
        campaigns=campaigns,
    )


@pytest.fixture
def drawn(monkeypatch):
    """Every text of the figures that are written."""
    texts = []
    save = Figure.savefig

    def noted(self, *args, **options):
        texts.append([each.get_text() for each in self.texts] + [self.get_suptitle()])
        return save(self, *args, **options)

    monkeypatch.setattr(Figure, "savefig", noted)
    return texts


RECORD = fleet(
    campaign("a-1", "a", 0.3),
    campaign("a-2", "a", 0.2),
    campaign("b-1", "b", 0.1),
    campaign("c-1", "c", None),
)


def test_the_last_campaigns_of_arms_stand_in_order_of_their_error():
    assert [each.campaign for each in RECORD.judged] == ["b-1", "a-2"]


def test_what_is_left_out_and_what_is_synthetic_is_said(tmp_path, drawn):
    write_fleet(RECORD, tmp_path, "fleet", 60)
    assert {path.suffix for path in tmp_path.iterdir()} == {".png", ".svg", ".pdf"}
    (said, *_) = drawn
    assert said[-1] == "3 arms in 4 campaigns, synthetic data"
    assert "without 1 of which no error is known" in " ".join(said)


def test_a_fleet_without_a_result_is_drawn(tmp_path):
    write_fleet(fleet(campaign("c-1", "c", None)), tmp_path, "fleet", 60)
    assert (tmp_path / "fleet.png").stat().st_size > 1000
