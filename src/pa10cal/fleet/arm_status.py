"""The status of every arm of a fleet after its last campaign: as a record, and as a CSV table."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import get_args

from pa10cal.errors import Pa10calError, RecordError
from pa10cal.files.table_cells import csv_text
from pa10cal.fleet.campaigns import ListedCampaign, in_order
from pa10cal.results.calibration import UNRESERVED
from pa10cal.results.codec import read
from pa10cal.results.outcomes import Attention, ChainRecord, FleetArm, FleetCampaign, FleetRecord

#: Reasons why an arm needs attention, the most urgent first.
_BY_URGENCY: tuple[Attention, ...] = get_args(Attention)
#: Verdicts by which the data contain an error.
_FAULTY_DATA = ("check_the_log",)
#: Verdicts by which no effect is missing from the model.
_NOTHING_OPEN = ("none", "named", "not_sought")


def fleet_record(listed: Sequence[ListedCampaign], results_dir: Path) -> FleetRecord:
    """Return the outcome of every campaign and the status of every arm, from their results.

    A campaign without a `chain.json` counts as one that the machine ended, and one whose
    `chain.json` cannot be read as failed.

    Args:
        listed: campaigns of the fleet.
        results_dir: holds a folder of results for each.
    """
    by_name: dict[str, FleetCampaign] = {}
    arms = []
    for arm, campaigns_of_arm in in_order(listed).items():
        previous: Path | None = None  # results of the arm's last campaign with a sound model
        for campaign in campaigns_of_arm:
            folder = results_dir / campaign.campaign
            outcome = _outcome(campaign.campaign, folder)
            agrees, moved = None, None
            if outcome.status == "done":
                if previous is not None:
                    agrees, moved = _compared(previous, folder)
                if not _is_faulty(outcome):
                    previous = folder
            last = by_name[campaign.campaign] = FleetCampaign(
                arm=arm,
                campaign=campaign.campaign,
                measured=campaign.measured or None,
                became=outcome,
                agrees=agrees,
                moved=moved,
            )
        attention, why = _attention(last)
        arms.append(
            FleetArm(
                arm=arm,
                campaigns=len(campaigns_of_arm),
                last=last.campaign,
                attention=attention,
                why=why,
            )
        )
    campaigns = tuple(by_name[campaign.campaign] for campaign in listed)
    words = [campaign.became.grade or campaign.became.status for campaign in campaigns]
    return FleetRecord(
        counts={word: words.count(word) for word in sorted(set(words))},
        arms=tuple(sorted(arms, key=lambda arm: (_BY_URGENCY.index(arm.attention), arm.arm))),
        campaigns=campaigns,
    )


def _outcome(campaign: str, folder: Path) -> ChainRecord:
    """Return the `chain.json` of a campaign, or one that says why there is none."""
    if (folder / ChainRecord.FILE).exists():
        try:
            return read(ChainRecord, folder / ChainRecord.FILE, within=folder)
        except RecordError as error:  # the other campaigns keep their table
            return ChainRecord(campaign=campaign, status="fault", message=str(error))
    log = folder / "logs/chain.log"
    return ChainRecord(campaign=campaign, status="ended", message=f"it left no outcome; see {log}")


def forget_ended(listed: Iterable[ListedCampaign], results_dir: Path) -> None:
    """Remove the outcomes of campaigns that the machine ended: the next run repeats them."""
    for campaign in listed:
        path = results_dir / campaign.campaign / ChainRecord.FILE
        with suppress(OSError, ValueError, AttributeError):  # not a record of ours: it stays
            if json.loads(path.read_bytes()).get("status") == "ended":
                path.unlink()


def _compared(previous: Path, current: Path) -> tuple[bool | None, str]:
    """Compare the models in two folders of results of one arm.

    Returns:
        Whether they agree (None where they cannot be compared), and the sentences that say so and
        which parameters moved.
    """
    # Late: planning a run lists campaigns, and compares none.
    from pa10cal.evaluation.two_models import compare_models
    from pa10cal.fit.model_reading import load_model

    try:
        models = load_model(previous), load_model(current)
        comparison = compare_models(*models, names=(previous.name, current.name))
    except Pa10calError as error:
        return None, str(error)
    what = comparison.what_moved
    if what is None or (comparison.agree and not what.moved):
        return comparison.agree, comparison.line
    return comparison.agree, f"{what.line}; {comparison.line}"


def _attention(last: FleetCampaign) -> tuple[Attention, str]:
    """Return whether the last campaign of an arm needs attention, and a sentence that says why."""
    outcome = last.became
    if outcome.status != "done":
        return "no_result", ": ".join(filter(None, (outcome.stage, outcome.message)))
    grade = f"{outcome.grade}: {outcome.line}"
    notes = "; ".join(outcome.notes or ())
    if _is_faulty(outcome):
        return "input", grade if outcome.grade not in UNRESERVED else notes or grade
    if last.agrees is False:
        return "moved", str(last.moved)
    if outcome.verdict not in _NOTHING_OPEN:
        return "incomplete", notes or grade
    if last.agrees is None and last.moved:
        return "none", f"{grade}; not compared with the campaign before: {last.moved}"
    return "none", grade


def _is_faulty(outcome: ChainRecord) -> bool:
    """Return whether a model is of data with an error, or its fit did not converge."""
    return outcome.grade not in UNRESERVED or outcome.verdict in _FAULTY_DATA


def fleet_csv(fleet: FleetRecord) -> str:
    """Return the table, one row a campaign; `attention` is in the row of an arm's last campaign."""
    arm_by_last = {arm.last: arm for arm in fleet.arms}
    rows = [_row(campaign, arm_by_last.get(campaign.campaign)) for campaign in fleet.campaigns]
    return csv_text(rows[0], (row.values() for row in rows))


def _row(campaign: FleetCampaign, arm: FleetArm | None) -> dict[str, object]:
    """Return the cells of a campaign by column; with its arm where it is the arm's last."""
    outcome = campaign.became
    before_mm, after_mm = (
        None if error_mm is None else f"{error_mm:.4f}"
        for error_mm in (outcome.before_mm, outcome.after_mm)
    )
    return {
        "arm": campaign.arm,
        "campaign": campaign.campaign,
        "measured": campaign.measured,
        "status": outcome.status,
        "grade": outcome.grade,
        "verdict": outcome.verdict,
        "effects_and_faults": "; ".join(outcome.notes or ()),
        "before_mm": before_mm,
        "after_mm": after_mm,
        "over": outcome.over,
        "agrees_with_previous": {None: None, True: "yes", False: "no"}[campaign.agrees],
        "moved": campaign.moved,
        "attention": arm.attention if arm else None,
        "why": arm.why if arm else outcome.message,
    }
