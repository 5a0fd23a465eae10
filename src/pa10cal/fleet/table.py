"""The fleet as a table, one row a campaign."""

from __future__ import annotations

import csv
import io

from pa10cal.files.cells import csv_cell
from pa10cal.results.fleet import FleetRecord

HEADER = (
    *("arm", "campaign", "measured", "status", "grade", "verdict", "effects_and_faults"),
    *("before_mm", "after_mm", "over", "agrees_with_previous", "moved"),
    *("attention", "why"),
)


def fleet_csv(fleet: FleetRecord) -> str:
    """Return the table as CSV; `attention` stands in the row of an arm's last campaign."""
    last = {each.last: each for each in fleet.arms}
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(HEADER)
    for each in fleet.campaigns:
        became, standing = each.became, last.get(each.campaign)
        cells = (
            *(each.arm, each.campaign, each.measured, became.status, became.grade),
            *(became.verdict, "; ".join(became.notes or ())),
            *(_mm(became.before_mm), _mm(became.after_mm), became.over, _yes(each.agrees)),
            each.moved,
            standing.attention if standing else None,
            standing.why if standing else became.message,
        )
        rows.writerow(["" if cell is None else csv_cell(cell) for cell in cells])
    return text.getvalue()


def _mm(error_mm: float | None) -> str | None:
    return None if error_mm is None else f"{error_mm:.4f}"


def _yes(agrees: bool | None) -> str | None:
    return None if agrees is None else ("yes" if agrees else "no")
