"""Which campaigns a fleet consists of: a table of them, or every folder that fits a pattern."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

from pa10cal.errors import ALLOWED, Pa10calError, SettingsError, fits_a_folder
from pa10cal.files.output import csv_text
from pa10cal.input_files import read_csv, reason
from pa10cal.results.calibration import UNRESERVED
from pa10cal.results.codec import read
from pa10cal.results.fleet import Attention, ChainRecord, FleetArm, FleetCampaign, FleetRecord

#: A table of campaigns larger than this is none [bytes].
_MOST_BYTES = 4 * 1024**2
_COLUMNS = ("campaign", "arm", "measured")


@dataclass(frozen=True)
class Listed:
    """One campaign of a fleet."""

    campaign: str  # name of its folder
    arm: str  # which arm was measured; without a statement every campaign is of an arm of its own
    # when, in letters that sort by time, such as 2026-03-31; empty where not stated
    measured: str = ""


def campaigns_of(asked: str, raw_dir: Path) -> tuple[Listed, ...]:
    """Return the campaigns of a fleet.

    Args:
        asked: a table (.csv) with the column `campaign` and, where known, `arm` and `measured`; or
            a pattern of folders in `raw_dir`, such as `*` or `2026-*`; or names with commas.
        raw_dir: folder of the campaigns.

    Raises:
        SettingsError: when there are none, the table cannot be read, or a name is not fit for a
            folder or stands twice.
    """
    if asked.endswith(".csv"):
        return _checked(_of_table(Path(asked)), asked)
    if "," in asked:
        return _checked([(asked, Listed(name, name)) for name in asked.split(",")], asked)
    pattern = asked.removeprefix(f"{raw_dir}/")
    if "/" in pattern or ".." in pattern:
        raise SettingsError(
            "no pattern of campaigns",
            where="campaigns",
            value=asked,
            allowed=f"a table (.csv), or names of folders of {raw_dir} with *, such as 2026-*",
            remedy="correct it, or set raw_dir",
        )
    names = sorted(path.parent.name for path in raw_dir.glob(f"{pattern}/campaign.yaml"))
    return _checked([(f"{raw_dir}/{name}", Listed(name, name)) for name in names], asked)


def in_order(listed: Iterable[Listed]) -> dict[str, list[Listed]]:
    """Return the campaigns of each arm in the order in which they were measured."""
    arms: dict[str, list[Listed]] = {}
    for each in listed:
        arms.setdefault(each.arm, []).append(each)
    return {arm: sorted(found, key=lambda each: each.measured) for arm, found in arms.items()}


def _of_table(path: Path) -> list[tuple[str, Listed]]:
    try:
        rows = [row for _, row in read_csv(path, _MOST_BYTES)]
    except (OSError, ValueError) as error:
        raise SettingsError(
            "the table of campaigns cannot be read",
            where=str(path),
            value=reason(error),
            allowed="UTF-8 text, columns divided by commas",
            remedy="check the path and the file",
        ) from None
    header = [word.strip() for word in rows[0]] if rows else []
    if "campaign" not in header or len(set(header)) < len(header):
        raise SettingsError(
            "the table of campaigns has no column campaign, or a column twice",
            where=f"{path}, line 1",
            value=", ".join(header),
            allowed=f"the column {_COLUMNS[0]} and, where known, {' and '.join(_COLUMNS[1:])}",
            remedy="name the columns in its first line",
        )
    found = []
    for number, row in enumerate(rows[1:], start=2):
        of = dict(zip(header, (word.strip() for word in row), strict=False))
        name = of.get("campaign", "")
        listed = Listed(name, of.get("arm") or name, of.get("measured", ""))
        found.append((f"{path}, row {number}", listed))
    return found


def _checked(found: list[tuple[str, Listed]], asked: str) -> tuple[Listed, ...]:
    if not found:
        raise SettingsError(
            "there are no campaigns",
            where="campaigns",
            value=asked,
            allowed="at least one campaign",
            remedy="list some in the table, or correct the pattern or raw_dir",
        )
    seen: dict[str, str] = {}
    for where, listed in found:
        if not fits_a_folder(listed.campaign):
            raise SettingsError(
                "no name of a campaign",
                where=where,
                value=listed.campaign,
                allowed=ALLOWED,
                remedy="rename its folder, or correct the table",
            )
        if listed.campaign in seen:
            raise SettingsError(
                "a campaign stands twice",
                where=where,
                value=listed.campaign,
                allowed=f"each campaign once; it stands in {seen[listed.campaign]} too",
                remedy="remove one of the two",
            )
        seen[listed.campaign] = where
    return tuple(listed for _, listed in found)


# The fleet as a table, one row a campaign.

HEADER = (
    *("arm", "campaign", "measured", "status", "grade", "verdict", "effects_and_faults"),
    *("before_mm", "after_mm", "over", "agrees_with_previous", "moved"),
    *("attention", "why"),
)


def fleet_csv(fleet: FleetRecord) -> str:
    """Return the table as CSV; `attention` stands in the row of an arm's last campaign."""
    last = {each.last: each for each in fleet.arms}
    rows: list[tuple[object, ...]] = []
    for each in fleet.campaigns:
        outcome, arm_status = each.became, last.get(each.campaign)
        cells = (
            *(each.arm, each.campaign, each.measured, outcome.status, outcome.grade),
            *(outcome.verdict, "; ".join(outcome.notes or ())),
            *(None if mm is None else f"{mm:.4f}" for mm in (outcome.before_mm, outcome.after_mm)),
            *(outcome.over, {None: None, True: "yes", False: "no"}[each.agrees]),
            each.moved,
            arm_status.attention if arm_status else None,
            arm_status.why if arm_status else outcome.message,
        )
        rows.append(cells)
    return csv_text(HEADER, rows)


# How every arm of a fleet stands after its last campaign, and which need attention first.

_URGENCY: tuple[Attention, ...] = get_args(Attention)
#: Verdicts that say that the data are not to be taken as they are, and that the model is whole.
_OF_THE_LOG = ("check_the_log",)
_WHOLE = ("none", "named", "not_sought")


def fleet_record(listed: Sequence[Listed], results_dir: Path) -> FleetRecord:
    """Return the fleet as its campaigns' results show it.

    Args:
        listed: its campaigns.
        results_dir: holds a folder of results for each.

    A campaign without a `chain.json` counts as one that the machine ended.

    Raises:
        RecordError: when one cannot be read.
    """
    of_campaign: dict[str, FleetCampaign] = {}
    arms = []
    for arm, of_arm in in_order(listed).items():
        before: tuple[str, Path] | None = None  # the last campaign with a model
        for each in of_arm:
            folder = results_dir / each.campaign
            outcome = _outcome(each.campaign, folder)
            agrees, line = None, None
            if outcome.status == "done":
                now = each.campaign, folder
                if before is not None:
                    agrees, line = _moved(before, now)
                before = now
            last = of_campaign[each.campaign] = FleetCampaign(
                arm=arm,
                campaign=each.campaign,
                measured=each.measured or None,
                became=outcome,
                agrees=agrees,
                moved=line,
            )
        attention, why = _attention(last)
        arms.append(
            FleetArm(
                arm=arm, campaigns=len(of_arm), last=last.campaign, attention=attention, why=why
            )
        )
    campaigns = tuple(of_campaign[each.campaign] for each in listed)
    words = [each.became.grade or each.became.status for each in campaigns]
    return FleetRecord(
        counts={word: words.count(word) for word in sorted(set(words))},
        arms=tuple(sorted(arms, key=lambda each: (_URGENCY.index(each.attention), each.arm))),
        campaigns=campaigns,
    )


def _outcome(campaign: str, folder: Path) -> ChainRecord:
    if (folder / ChainRecord.FILE).exists():
        return read(ChainRecord, folder / ChainRecord.FILE, within=folder)
    log = folder / "logs/chain.log"
    return ChainRecord(campaign=campaign, status="ended", message=f"it left no outcome; see {log}")


def forget_ended(listed: Iterable[Listed], results_dir: Path) -> None:
    """Remove the outcomes of campaigns that the machine ended, so that a run begins them anew."""
    for each in listed:
        path = results_dir / each.campaign / ChainRecord.FILE
        with suppress(OSError, ValueError, AttributeError):  # one that no run of ours has written
            if json.loads(path.read_bytes()).get("status") == "ended":
                path.unlink()


def _moved(before: tuple[str, Path], now: tuple[str, Path]) -> tuple[bool | None, str]:
    """Return whether two models of an arm agree, and the sentences that say so and what moved."""
    # Late: planning a run lists campaigns, and compares none.
    from pa10cal.evaluation.two_models import compare_models
    from pa10cal.fit.fitted_model import load_model

    try:
        models = load_model(before[1]), load_model(now[1])
        found = compare_models(*models, names=(before[0], now[0]))
    except Pa10calError as error:
        return None, str(error)
    moved = () if found.agree or found.what_moved is None else (found.what_moved.line,)
    return found.agree, "; ".join((*moved, found.line))


def _attention(last: FleetCampaign) -> tuple[Attention, str]:
    """Return whether a campaign asks for attention, and why."""
    outcome = last.became
    if outcome.status != "done":
        return "no_result", ": ".join(filter(None, (outcome.stage, outcome.message)))
    said = f"{outcome.grade}: {outcome.line}"
    if outcome.grade not in UNRESERVED:
        return "input", said
    notes = "; ".join(outcome.notes or ())
    if outcome.verdict in _OF_THE_LOG:
        return "input", notes or said
    if last.agrees is False:
        return "moved", str(last.moved)
    if outcome.verdict not in _WHOLE:
        return "incomplete", notes or said
    return "none", said
