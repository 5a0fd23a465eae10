"""Configurations that were quarantined because they are wrong, as findings for who judges the rest.

A row that cannot be read is no finding: it is missing. One that can be read and cannot be true is:
it says that something went wrong there.
"""

from __future__ import annotations

from collections.abc import Iterable

from pa10cal.campaign.findings import InputFinding
from pa10cal.campaign.labels import EXCHANGED, NOT_RIGID
from pa10cal.campaign.quarantine import Quarantined
from pa10cal.campaign.screens import OFF_MODEL, OFF_REPEATS, OTHER_COMMAND, OUT_OF_REACH

#: Reasons for which a reading is wrong, and not merely of no use.
_WRONG = (OFF_REPEATS, OFF_MODEL, NOT_RIGID, OUT_OF_REACH, OTHER_COMMAND)


def wrong_rows(rows: Iterable[Quarantined]) -> tuple[InputFinding, ...]:
    """Return the configurations that were quarantined because they are wrong, each once."""
    found: dict[tuple[str, str], InputFinding] = {}
    for row in sorted(rows):
        exchanged = row.reason.startswith(EXCHANGED)
        if not exchanged and row.reason not in _WRONG:
            continue
        where = f"{row.file}: {row.place or f'line {row.line}'}"
        if exchanged:
            labels = row.reason.removeprefix(EXCHANGED).removeprefix(": ") or row.value
            finding = InputFinding(
                kind="target_label",
                where=where,
                what=f"the labels of {labels} seem exchanged there; its rows are quarantined",
                remedy="correct the labels of this configuration",
            )
        else:
            finding = InputFinding(
                kind="outlier",
                where=where,
                what=f"{row.reason}; its rows are quarantined",
                remedy="look at the raw reading, and measure it again or leave it out",
            )
        found.setdefault((where, finding.kind), finding)
    return tuple(found.values())
