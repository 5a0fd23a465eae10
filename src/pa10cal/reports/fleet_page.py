"""The page of a fleet: the arms that need attention first, then every campaign."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from statistics import median

from pa10cal.reports.blocks import Callout, PageBlock, Paragraph, folded, grid
from pa10cal.reports.formatting import count, mm
from pa10cal.reports.pictures import fleet_drawing
from pa10cal.reports.render import Glance, PageSection, rendered
from pa10cal.reports.results_bundle import is_synthetic
from pa10cal.results.fleet import FleetCampaign, FleetRecord

#: Each kind of attention in words, in the order of urgency.
ATTENTION = {
    "no_result": "no result",
    "input": "check the data",
    "moved": "the arm has changed",
    "incomplete": "an effect is missing",
    "none": "none",
}
#: Campaigns without a result that a warning lists; of more only the first are shown.
_MOST_NAMES = 10


def fleet_page_text(fleet: FleetRecord) -> str:
    """Return the page as HTML, with everything in it that it needs."""
    urgent = [arm for arm in fleet.arms if arm.attention != "none"]
    counts: Counter[str] = Counter(arm.attention for arm in urgent)
    kinds = [f"{counts[kind]} {words}" for kind, words in ATTENTION.items() if counts[kind]]
    glances = [
        Glance("Arms", str(len(fleet.arms)), f"{count(len(fleet.campaigns), 'campaign')} of them."),
        Glance("Need attention", str(len(urgent)), f"{', '.join(kinds) or 'None of them'}."),
    ]
    attention: PageBlock = Paragraph("No arm needs attention.", lead=True)
    if urgent:
        rows = [(arm.arm, arm.last, ATTENTION[arm.attention], arm.why) for arm in urgent]
        attention = grid("The most urgent first", "arm | last campaign | attention | why", rows)
    sections = [PageSection("attention", "Arms that need attention", (attention,))]
    if fleet.by_accuracy:
        drawing = fleet_drawing(fleet.by_accuracy)
        sections.append(PageSection("errors", "Errors before and after", (drawing,)))
        before_mm, after_mm = (
            median(getattr(campaign.became, name) for campaign in fleet.by_accuracy)
            for name in ("before_mm", "after_mm")
        )
        glances.append(
            Glance(
                "Mean position error",
                f"{mm(before_mm)} → {mm(after_mm)} mm",
                "Median over the last campaigns of the arms, uncalibrated and with the final "
                "model.",
            )
        )
    blocks = tuple(block for block in _campaign_blocks(fleet.campaigns) if not block.empty)
    sections.append(PageSection("campaigns", "Every campaign", blocks))
    synthetic = any(is_synthetic(each.became.provenance or "") for each in fleet.campaigns)
    return rendered("Fleet", glances, sections, synthetic, heading="Fleet report")


def _campaign_blocks(campaigns: Sequence[FleetCampaign]) -> Iterator[PageBlock]:
    """Yield a warning of campaigns without a result, all campaigns, and those that differ."""
    lost = [campaign.campaign for campaign in campaigns if campaign.became.status != "done"]
    if lost:
        names = f"{', '.join(lost[:_MOST_NAMES])}{' …' * (len(lost) > _MOST_NAMES)}"
        yield Callout("warning", f"{count(len(lost), 'campaign')} gave no result: {names}.")
    table = grid(
        "Mean position errors",
        "campaign | arm | measured | grade | verdict | effects and faults | before [mm] | "
        "after [mm] | as the campaign before it",
        map(_campaign_row, campaigns),
    )
    yield folded(table, "The table, one row a campaign")
    yield grid(
        "Campaigns whose model differs from the one before it",
        "campaign | arm | what was found",
        (
            (campaign.campaign, campaign.arm, campaign.moved)
            for campaign in campaigns
            if campaign.moved and campaign.agrees is not True
        ),
    )


def _campaign_row(campaign: FleetCampaign) -> tuple[str | float | None, ...]:
    outcome = campaign.became
    return (
        campaign.campaign,
        campaign.arm,
        campaign.measured,
        outcome.grade or outcome.status,
        outcome.verdict,
        "; ".join(outcome.notes or ()) or None,
        outcome.before_mm,
        outcome.after_mm,
        {None: None, True: "agrees", False: "differs"}[campaign.agrees],
    )
