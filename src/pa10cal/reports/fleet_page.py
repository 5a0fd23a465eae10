"""The page of a fleet: arms that need attention first, then every campaign."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from plotly import graph_objects as go

from pa10cal.reports.blocks import Block, Callout, Drawing, Folded, Paragraph, Section, grid
from pa10cal.reports.gathered import is_synthetic
from pa10cal.reports.looks import BLUE, ORANGE, new_figure
from pa10cal.reports.page import Glance, rendered
from pa10cal.reports.written import count, mm
from pa10cal.results.fleet import FleetArm, FleetCampaign, FleetRecord

#: What a reader is told of each kind of attention, in the order of urgency.
ATTENTION = {
    "no_result": "no result",
    "input": "check the data",
    "moved": "the arm has changed",
    "incomplete": "an effect is missing",
    "none": "none",
}
_ROW_PX, _LEAST_PX, _MOST_PX = 16, 300, 1600


def page_text(fleet: FleetRecord) -> str:
    """Return the page as HTML, everything in it that it needs."""
    sections = [Section("attention", "Arms that need attention", tuple(_first(fleet)))]
    if fleet.judged:
        sections.append(Section("errors", "Errors before and after", (_errors(fleet),)))
    sections.append(Section("campaigns", "Every campaign", tuple(_campaigns(fleet))))
    told = [each.became.provenance for each in fleet.campaigns if each.became.provenance]
    return rendered(
        "Fleet",
        list(_glances(fleet)),
        sections,
        synthetic=any(map(is_synthetic, told)),
        over="Fleet report",
    )


def _glances(fleet: FleetRecord) -> Iterator[Glance]:
    ill = [each for each in fleet.arms if each.attention != "none"]
    yield Glance(
        "Arms", str(len(fleet.arms)), f"{count(len(fleet.campaigns), 'campaign')} of them."
    )
    kinds = [f"{sum(e.attention == kind for e in ill)} {ATTENTION[kind]}" for kind in _kinds(ill)]
    yield Glance("Need attention", str(len(ill)), f"{', '.join(kinds) or 'None of them'}.")
    judged = fleet.judged
    if judged:
        before, after = (
            float(np.median([_error(each, name) for each in judged]))
            for name in ("before_mm", "after_mm")
        )
        yield Glance(
            "Mean position error",
            f"{mm(before)} → {mm(after)} mm",
            "Median over the last campaigns of the arms, uncalibrated and with the final model.",
        )


def _kinds(arms: list[FleetArm]) -> list[str]:
    there = {each.attention for each in arms}
    return [kind for kind in ATTENTION if kind in there]


def _first(fleet: FleetRecord) -> Iterator[Block]:
    ill = [each for each in fleet.arms if each.attention != "none"]
    if not ill:
        yield Paragraph("No arm needs attention.", lead=True)
        return
    yield grid(
        "The most urgent first",
        ("arm", "last campaign", "attention", "why"),
        [(each.arm, each.last, ATTENTION[each.attention], each.why) for each in ill],
    )


def _error(campaign: FleetCampaign, name: str) -> float:
    return float(getattr(campaign.became, name))


def _errors(fleet: FleetRecord) -> Drawing:
    judged = fleet.judged
    arms = [each.arm for each in judged]
    figure = new_figure(
        int(np.clip(_ROW_PX * len(arms) + 90, _LEAST_PX, _MOST_PX)),
        {"title": {"text": "mean position error [mm]"}, "type": "log"},
        {"type": "category", "title": {"text": "arm"}},
    )
    for name, told, color, symbol in (
        ("before_mm", "uncalibrated", ORANGE, "diamond"),
        ("after_mm", "final model", BLUE, "circle"),
    ):
        figure.add_trace(
            go.Scatter(
                x=[_error(each, name) for each in judged],
                y=arms,
                mode="markers",
                name=told,
                marker={"color": color, "symbol": symbol, "size": 7},
                hovertemplate="%{y}: %{x:.4f} mm<extra>" + told + "</extra>",
            )
        )
    return Drawing(
        figure,
        "Mean position error of every arm",
        "Last campaign of each arm, the most accurate below. Over held-out poses where a campaign "
        "has some, else over the poses fitted.",
        "fleet-errors",
    )


def _campaigns(fleet: FleetRecord) -> Iterator[Block]:
    lost = [each for each in fleet.campaigns if each.became.status != "done"]
    if lost:
        yield Callout(
            "warning",
            f"{count(len(lost), 'campaign')} gave no result: "
            + ", ".join(each.campaign for each in lost[:10])
            + (" …" if len(lost) > 10 else "")
            + ".",
        )
    header = (
        *("campaign", "arm", "measured", "grade", "verdict", "effects and faults"),
        *("before", "after", "as the campaign before it"),
    )
    yield Folded(
        "The table, one row a campaign",
        (grid("Mean position errors [mm]", header, map(_row, fleet.campaigns), (6, 7)),),
    )
    changed = [each for each in fleet.campaigns if each.moved and each.agrees is not True]
    if changed:
        yield grid(
            "Campaigns whose model differs from the one before it",
            ("campaign", "arm", "what was found"),
            [(each.campaign, each.arm, str(each.moved)) for each in changed],
        )


def _row(each: FleetCampaign) -> tuple[str, ...]:
    became = each.became
    agrees = {None: "–", True: "agrees", False: "differs"}[each.agrees]
    return (
        *(each.campaign, each.arm, each.measured or "–", became.grade or became.status),
        *(became.verdict or "–", "; ".join(became.notes or ()) or "–"),
        *(mm(became.before_mm), mm(became.after_mm), agrees),
    )
