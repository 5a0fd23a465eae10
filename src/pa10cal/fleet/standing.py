"""How every arm of a fleet stands after its last campaign, and which need attention first."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import get_args

from pa10cal.errors import Pa10calError
from pa10cal.evaluation.two_models import compare_models
from pa10cal.fit.model_file import load_model
from pa10cal.fleet.campaigns import Listed, in_order
from pa10cal.results.codec import read
from pa10cal.results.fleet import Attention, ChainRecord, FleetArm, FleetCampaign, FleetRecord
from pa10cal.results.health import UNRESERVED

_URGENCY: tuple[Attention, ...] = get_args(Attention)
#: Verdicts that say that the data are not to be taken as they are, and that the model is whole.
_OF_THE_LOG = ("check_the_log",)
_WHOLE = ("none", "named", "not_sought")


def fleet_record(listed: Sequence[Listed], results_dir: Path) -> FleetRecord:
    """Return the fleet as its campaigns' results show it.

    Args:
        listed: its campaigns.
        results_dir: holds a folder of results for each.

    Raises:
        RecordError: when a campaign has no `chain.json`.
    """
    found = {
        each.campaign: read(ChainRecord, results_dir / each.campaign / ChainRecord.FILE)
        for each in listed
    }
    campaigns: dict[str, FleetCampaign] = {}
    arms = []
    for arm, of_arm in in_order(listed).items():
        compared = _compared(of_arm, found, results_dir)
        campaigns |= {each.campaign: each for each in compared}
        arms.append(_standing(arm, compared))
    words = [each.grade or each.status for each in found.values()]
    return FleetRecord(
        counts={word: words.count(word) for word in sorted(set(words))},
        arms=tuple(sorted(arms, key=lambda each: (_URGENCY.index(each.attention), each.arm))),
        campaigns=tuple(campaigns[each.campaign] for each in listed),
    )


def _compared(
    of_arm: Iterable[Listed], found: dict[str, ChainRecord], results_dir: Path
) -> list[FleetCampaign]:
    """Return the campaigns of an arm, each compared with the one before that has a model."""
    models: list[tuple[str, Path]] = []
    compared = []
    for each in of_arm:
        record, agrees, line = found[each.campaign], None, None
        if record.status == "done":
            models.append((each.campaign, results_dir / each.campaign / "model/model.yaml"))
            if len(models) > 1:
                agrees, line = _moved(*models[-2:])
        compared.append(
            FleetCampaign(
                arm=each.arm,
                campaign=each.campaign,
                measured=each.measured or None,
                became=record,
                agrees=agrees,
                moved=line,
            )
        )
    return compared


def _moved(before: tuple[str, Path], now: tuple[str, Path]) -> tuple[bool | None, str]:
    """Return whether two models of an arm agree, and the sentences that say so and what moved."""
    try:
        models = load_model(before[1]), load_model(now[1])
        found = compare_models(*models, names=(before[0], now[0]))
    except Pa10calError as error:
        return None, str(error)
    moved = () if found.agree or found.what_moved is None else (found.what_moved.line,)
    return found.agree, "; ".join((*moved, found.line))


def _standing(arm: str, campaigns: Sequence[FleetCampaign]) -> FleetArm:
    """Return how an arm stands after its last campaign."""
    last = campaigns[-1]
    attention, why = _attention(last)
    return FleetArm(
        arm=arm, campaigns=len(campaigns), last=last.campaign, attention=attention, why=why
    )


def _attention(last: FleetCampaign) -> tuple[Attention, str]:
    """Return whether a campaign asks for attention, and why."""
    became = last.became
    if became.status != "done":
        return "no_result", f"{became.stage}: {became.message}"
    said = f"{became.grade}: {became.line}"
    if became.grade not in UNRESERVED:
        return "input", said
    notes = "; ".join(became.notes or ())
    if became.verdict in _OF_THE_LOG:
        return "input", notes or said
    if last.agrees is False:
        return "moved", str(last.moved)
    if became.verdict not in _WHOLE:
        return "incomplete", notes or said
    return "none", said
