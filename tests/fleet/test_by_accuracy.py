"""The order of the arms of a fleet: the most accurate first, by its last campaign."""

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


RECORD = fleet(
    campaign("a-1", "a", 0.3),
    campaign("a-2", "a", 0.2),
    campaign("b-1", "b", 0.1),
    campaign("c-1", "c", None),
)


def test_the_last_campaigns_of_arms_stand_in_order_of_their_error():
    assert [each.campaign for each in RECORD.by_accuracy] == ["b-1", "a-2"]
