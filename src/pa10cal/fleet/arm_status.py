"""The status of every arm of a fleet after its last campaign: as a record, and as a CSV table."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple, get_args

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
#: Verdicts that leave nothing to be named: none is missing, or was named, or was not sought.
_NOTHING_OPEN = ("none", "named", "not_sought")
#: Columns of the table.
_COLUMNS = (
    "arm",
    "campaign",
    "measured",
    "status",
    "grade",
    "verdict",
    "effects_and_faults",
    "before_mm",
    "after_mm",
    "over",
    "agrees_with_previous",
    "moved",
    "attention",
    "why",
)


def fleet_record(listed: Sequence[ListedCampaign], results_dir: Path) -> FleetRecord:
    """Return the outcome of every campaign and the status of every arm, from their results.

    A campaign without a `chain.json` counts as one that the machine ended, and one whose
    `chain.json` cannot be read, or is of another campaign, as failed.

    Args:
        listed: campaigns of the fleet.
        results_dir: holds a folder of results for each.
    """
    by_name: dict[str, FleetCampaign] = {}
    arms = []
    for arm, campaigns_of_arm in in_order(listed).items():
        judged = _in_turn(campaigns_of_arm, results_dir)
        by_name |= {each.campaign.campaign: each.campaign for each in judged}
        attention, why = _attention(judged[-1])
        arms.append(
            FleetArm(
                arm=arm,
                campaigns=len(judged),
                last=judged[-1].campaign.campaign,
                attention=attention,
                why=why,
            )
        )
    campaigns = tuple(by_name[each.campaign] for each in listed)
    words = [each.became.grade or each.became.status for each in campaigns]
    return FleetRecord(
        counts={word: words.count(word) for word in sorted(set(words))},
        arms=tuple(sorted(arms, key=lambda arm: (_BY_URGENCY.index(arm.attention), arm.arm))),
        campaigns=campaigns,
    )


class _Comparison(NamedTuple):
    """How the model of a campaign compares with that of the arm's last sound campaign before it."""

    agrees: bool | None = None  # None where they were not or cannot be compared
    # the sentences that say so and what moved, or why they cannot be compared; None without any
    said: str | None = None
    arm_moved: bool = False  # whether a part of the arm is known to have moved in between


class _Judged(NamedTuple):
    """A campaign of an arm, beside the sound one before it."""

    campaign: FleetCampaign
    arm_moved: bool  # whether a part of the arm is known to have moved since the one before


def _in_turn(campaigns_of_arm: Iterable[ListedCampaign], results_dir: Path) -> list[_Judged]:
    """Return the campaigns of an arm, each compared with the last sound one before it."""
    judged = []
    last_sound: Path | None = None  # results of the last campaign whose data are not in doubt
    for listed in campaigns_of_arm:
        folder = results_dir / listed.campaign
        outcome = _outcome(listed.campaign, folder)
        comparison = _Comparison()
        if outcome.status == "done":
            if last_sound is not None:
                comparison = _compared(last_sound, folder)
            if not _is_faulty(outcome):
                last_sound = folder
        campaign = FleetCampaign(
            arm=listed.arm,
            campaign=listed.campaign,
            measured=listed.measured or None,
            became=outcome,
            agrees=comparison.agrees,
            moved=comparison.said,
        )
        judged.append(_Judged(campaign, comparison.arm_moved))
    return judged


def _outcome(campaign: str, folder: Path) -> ChainRecord:
    """Return the `chain.json` of a campaign, or one that says why there is none."""
    if (folder / ChainRecord.FILE).exists():
        try:
            return read(ChainRecord, folder / ChainRecord.FILE, campaign, within=folder)
        except RecordError as error:  # the other campaigns keep their table
            return ChainRecord(campaign=campaign, status="fault", message=str(error))
    log = folder / "logs/chain.log"
    return ChainRecord(campaign=campaign, status="ended", message=f"it left no outcome; see {log}")


def forget_ended(listed: Iterable[ListedCampaign], results_dir: Path) -> None:
    """Remove the outcomes of campaigns that the machine ended: the next run repeats them."""
    for each in listed:
        folder = results_dir / each.campaign
        with suppress(OSError, RecordError):  # not a record of ours: it stays
            if read(ChainRecord, folder / ChainRecord.FILE, within=folder).status == "ended":
                (folder / ChainRecord.FILE).unlink()


def _compared(previous: Path, current: Path) -> _Comparison:
    """Compare the models in two folders of results of one arm."""
    # Late: planning a run lists campaigns, and compares none.
    from pa10cal.evaluation.two_models import compare_models
    from pa10cal.evaluation.what_moved import NOTHING_OF_ARM
    from pa10cal.fit.model_reading import load_model

    try:
        models = load_model(previous), load_model(current)
        comparison = compare_models(*models, names=(previous.name, current.name))
    except Pa10calError as error:
        return _Comparison(said=str(error))
    what = comparison.what_moved
    if what is None or (comparison.agree and not what.moved):
        return _Comparison(comparison.agree, comparison.line)
    said = f"{what.line}; {comparison.line}"
    return _Comparison(comparison.agree, said, what.verdict not in NOTHING_OF_ARM)


def _attention(last: _Judged) -> tuple[Attention, str]:
    """Return whether the last campaign of an arm needs attention, and a sentence that says why."""
    campaign, outcome = last.campaign, last.campaign.became
    if outcome.status != "done" or outcome.grade is None:
        return "no_result", _why_no_result(outcome)
    grade = f"{outcome.grade}: {outcome.line}"
    notes = "; ".join(outcome.notes or ())
    if _is_faulty(outcome):
        return "input", grade if outcome.grade not in UNRESERVED else notes or grade
    # What moved may be known where too few angles were seen in both to compare the flanges.
    if campaign.agrees is False or (campaign.agrees is None and last.arm_moved):
        return "moved", str(campaign.moved)
    if outcome.verdict not in _NOTHING_OPEN or _lacks_what_nobody_named(outcome):
        return "incomplete", notes or grade
    if campaign.agrees is None and campaign.moved:
        return "none", f"{grade}; not compared with the campaign before: {campaign.moved}"
    return "none", grade


def _lacks_what_nobody_named(outcome: ChainRecord) -> bool:
    """Return whether a model is incomplete, and no effect was named that completes it."""
    return outcome.grade == "incomplete" and outcome.verdict != "named"


def _why_no_result(outcome: ChainRecord) -> str:
    """Return in a sentence why a campaign gave no model, the stage first."""
    said = outcome.message or f"{outcome.status}, without a grade"
    return f"{outcome.stage}: {said}" if outcome.stage else said


def _is_faulty(outcome: ChainRecord) -> bool:
    """Return whether a model is of data with an error, or its fit did not converge."""
    return outcome.grade not in UNRESERVED or outcome.verdict in _FAULTY_DATA


def fleet_csv(fleet: FleetRecord) -> str:
    """Return the table, one row a campaign; `attention` is in the row of an arm's last campaign."""
    arm_by_last = {arm.last: arm for arm in fleet.arms}
    rows = [_row(campaign, arm_by_last.get(campaign.campaign)) for campaign in fleet.campaigns]
    return csv_text(_COLUMNS, ([row[column] for column in _COLUMNS] for row in rows))


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
        "why": arm.why if arm else _why_no_result(outcome) if outcome.status != "done" else None,
    }
