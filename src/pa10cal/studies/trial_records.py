"""Verdicts on blind trials and their truths: two files of JSON lines, one line a trial."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

from pa10cal.errors import RecordError
from pa10cal.evaluation.blind_trial import (
    BlindTrial,
    Disturbed,
    Formula,
    Hidden,
    Name,
    Named,
    Told,
    Verdict,
)
from pa10cal.results.codec import read_lines
from pa10cal.results.record import CampaignRecord, EffectName
from pa10cal.results.trials import (
    FailedTrialRecord,
    JudgedTrialRecord,
    TrialTruthRecord,
    TrialVerdictRecord,
)

#: Fault and effect that are motions in the course of time, and the words of one without a name.
IN_TIME, DRIFT = "step_in_time", "base_drift"
_OF_MOTION = re.compile(r"\b(moved|wander|drift|crept|creep)", re.I)

_R = TypeVar("_R", bound=CampaignRecord)


def read_trials(verdicts: Sequence[Path], truths: Sequence[Path]) -> list[BlindTrial]:
    """Join verdicts and truths by the name of the trial, in the order of the truths.

    Raises:
        RecordError: when a file cannot be read, or a trial has not one of each.
    """
    # Reading makes one of its kinds, none of which is abstract.
    records = _by_name(TrialVerdictRecord, verdicts)  # type: ignore[type-abstract]
    hidden = _by_name(TrialTruthRecord, truths)
    if odd := sorted(set(records) ^ set(hidden)):
        raise RecordError(
            "a trial has a verdict or a truth, but not both",
            where=", ".join(map(str, (*verdicts, *truths))),
            value=odd[0],
            allowed="verdicts and truths of the same trials",
            remedy="give all files that pa10cal blind_trials wrote",
        )
    return [joined(records[name], truth) for name, truth in hidden.items()]


def _by_name(kind: type[_R], paths: Sequence[Path]) -> dict[str, _R]:
    records: dict[str, _R] = {}
    for path in paths:
        for number, record in enumerate(read_lines(kind, path), start=1):
            if record.campaign in records:
                raise RecordError(
                    "a trial occurs twice",
                    where=f"{path}:{number}",
                    value=record.campaign,
                    allowed=f"one line of schema {kind.SCHEMA} a trial",
                    remedy="run pa10cal blind_trials again",
                )
            records[record.campaign] = record
    return records


def joined(record: TrialVerdictRecord, truth: TrialTruthRecord) -> BlindTrial:
    """Return a trial of what was said of it and what is true."""
    return BlindTrial(
        campaign=truth.campaign,
        kind=truth.kind,
        layout=truth.layout,
        path=truth.path,
        measured=truth.measured,
        flexible_joints=truth.flexible_joints,
        hidden=tuple(
            Hidden(_name(effect), effect.size, effect.parameters, effect.moved_mm, effect.apart_mm)
            for effect in truth.hidden_effects
        ),
        seconds_twin=truth.seconds_twin,
        verdict=_verdict(record) if isinstance(record, JudgedTrialRecord) else None,
        failed=record.failed if isinstance(record, FailedTrialRecord) else None,
        refused=isinstance(record, FailedTrialRecord) and record.refused,
        put_in=tuple(
            Disturbed(each.id, each.where, each.stressor, each.kinds, each.measured, each.moved_mm)
            for each in truth.put_in
        ),
        noise_mm=truth.noise_mm,
    )


def _verdict(record: JudgedTrialRecord) -> Verdict:
    held_out = record.gap.holdout
    return Verdict(
        word=record.verdict,
        effects=tuple(
            Named(
                _name(effect),
                tuple(_name(rival) for rival in effect.alternatives),
                {name: (entry.value, entry.std) for name, entry in effect.parameters.items()},
            )
            for effect in record.effects
        ),
        places=_places(record),
        not_testable=frozenset(
            _name(effect)
            for effect in (*record.not_testable, *(record.below_detection_limit or ()))
        ),
        indistinguishable=tuple(frozenset(map(_name, group)) for group in record.indistinguishable),
        springs=record.springs,
        noise_floor_mm=record.gap.noise_floor_mm,
        held_out_after_mm=None if held_out is None else held_out.after.mean_mm,
        seconds=record.seconds,
        seconds_simulating=record.seconds_simulating,
        held_out_before_mm=None if held_out is None else held_out.before.mean_mm,
        told=Told(
            faults=tuple((fault.kind, fault.where) for fault in record.faults),
            grade="" if record.health is None else record.health.grade,
            left_out=frozenset(() if record.health is None else record.health.left_out),
            motions=_motions(record),
        ),
        proposed=tuple(Formula(each.form, each.of, each.numbers) for each in record.proposed or ()),
    )


def _places(record: JudgedTrialRecord) -> tuple[str | None, ...]:
    """Return the places of unnamed effects; those of maps follow from the verdict's effects."""
    if record.verdict != "unexplained" or record.unexplained is None:
        return ()
    return tuple(place.of for place in record.unexplained.all)


def _motions(record: JudgedTrialRecord) -> tuple[str, ...]:
    """Return what a verdict says of motions in the course of time, with a name or without."""
    unexplained = () if record.unexplained is None else record.unexplained.all
    return (
        *(fault.what for fault in record.faults if fault.kind == IN_TIME),
        *(each.why for each in unexplained if _OF_MOTION.search(each.why)),
        *(
            " or ".join(f"{name.id} of {name.of}" for name in (effect, *effect.alternatives))
            for effect in record.effects
            if effect.id == DRIFT
        ),
    )


def _name(effect: EffectName) -> Name:
    return Name(effect.id, effect.of)
