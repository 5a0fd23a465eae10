"""What wild trials come to: crashes, false names, false comfort, faults told, effects found.

A campaign may be refused before it is calibrated; what stops discovery or evaluation afterwards is
counted as a crash, since a campaign that can be calibrated is not withheld.

Trials of unstated masses and of sorted rows (`cell.measured_trials`) have a table of their own. Of
these the truth itself says how far a hidden effect moves the readings once the geometry is fitted
again, and what noise does: a calibrated model may hold springs, and follow.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace

from pa10cal.lab.blind_trial import SORTED, SPRING, UNSTATED, BlindTrial
from pa10cal.lab.trial_rates import (
    Outcomes,
    at_least,
    at_most,
    bars_of,
    failings_of,
    longest,
    of_trials,
    score_formulas,
)
from pa10cal.lab.trial_scores import LIMIT
from pa10cal.results import trials as results
from pa10cal.results.record import Name

#: From here on, in units of the noise floor, something wrong must show.
ABOVE = 3.0
#: Held-out error with effects over that without, at most.
WORSE = 1.05
SUSPECT = "suspect_input"
CHECK = "check_the_log"
_MEASURED = (UNSTATED, SORTED)
_NOTHING_WRONG = ("right", "stressed")
_PROVENANCE = (
    "synthetic: virtual cell; robots, poses, noise, stressors, faults and hidden effects drawn"
)
_PROVENANCE_MEASURED = (
    "synthetic: virtual cell; arms, their lengths, weights and springs, poses, noise and hidden "
    "effects drawn"
)
#: Faults whose place is a time, or a key that no verdict names.
_PLACED_BY_KIND = ("step_in_time", "payload")
_SAYS_MOST = 200
#: Words of a motion that offer another reading of it: rows that go with a joint, a rail or a load.
_RIVAL = re.compile(r"\bjoint \d|\brail\b|\bload\b|\border of (the )?rows\b", re.I)
#: Fault and effect that are motions in the course of time, and the words of one without a name.
_IN_TIME, _DRIFT = "step_in_time", "base_drift"
_OF_MOTION = re.compile(r"\b(moved|wander|drift|crept|creep)", re.I)

# Questions to a trial.


def crashed(trial: BlindTrial) -> bool:
    """Return whether a command failed that should not."""
    return trial.verdict is None and not trial.refused


def has_fault(trial: BlindTrial) -> bool:
    """Return whether something in the log is wrong that somebody should be told of."""
    return any(not each.stressor or each.kinds for each in trial.put_in)


def matters(trial: BlindTrial, put_in: results.PutIn) -> bool:
    """Return whether what was put in is more than three times the noise.

    Where it cannot be measured, since the campaign was refused, it is.
    """
    if not put_in.measured:
        return bool(put_in.kinds) or not put_in.stressor
    over = trial.moved_over_floor(put_in)
    return trial.verdict is None or (over is not None and over >= ABOVE)


def is_told(trial: BlindTrial, put_in: results.PutIn) -> bool:
    """Return whether a fault is told, by kind and place, or the campaign refused or suspected."""
    if trial.verdict is None:
        return trial.refused
    if trial.verdict.grade == SUSPECT:
        return True
    if "outlier" in put_in.kinds or "label" in put_in.kinds:
        left_out = [place in trial.verdict.left_out for place in put_in.where]
        if left_out and all(left_out):
            return True
    return any(
        fault.kind in put_in.kinds
        and (fault.kind in _PLACED_BY_KIND or _same_place(put_in.where, fault.where))
        for fault in trial.verdict.faults
    )


def has_false_name(trial: BlindTrial) -> bool:
    """Return whether a finding matches nothing hidden, nor any of its alternatives."""
    return trial.verdict is not None and _without_springs(trial).extra() > 0


def has_confident_false_name(trial: BlindTrial) -> bool:
    """Return whether a name stands alone that is not hidden, in a verdict that trusts its names."""
    return _without_springs(trial).is_confidently_wrong(CHECK)


def _without_springs(trial: BlindTrial) -> BlindTrial:
    """Return a trial without findings of springs that the arm has and the calibration did not."""
    verdict = trial.verdict
    if verdict is None:
        return trial
    true = {Name(SPRING, f"joint {joint}") for joint in trial.truth.flexible_joints}
    effects = tuple(named for named in verdict.effects if not true & set(named.all_names))
    return replace(trial, said=verdict.model_copy(update={"effects": effects}))


def has_false_comfort(trial: BlindTrial) -> bool:
    """Return whether `none` is said where something of three times the noise is wrong, untold."""
    if trial.verdict is None or trial.verdict.word != "none":
        return False
    untold = any(matters(trial, each) and not is_told(trial, each) for each in trial.put_in)
    return untold or _hides_much(trial)


def _has_measured_false_comfort(trial: BlindTrial) -> bool:
    """Return whether `none` is said where a hidden effect leaves much."""
    says_none = trial.verdict is not None and trial.verdict.word == "none"
    return says_none and any(leaves_much(trial, each) for each in trial.hidden)


def is_worse(trial: BlindTrial) -> bool:
    """Return whether held-out poses are predicted worse with what was found."""
    verdict = trial.verdict
    if verdict is None or verdict.gap.holdout is None:
        return False
    return verdict.gap.holdout.after.mean_mm > WORSE * verdict.gap.holdout.before.mean_mm


def is_accused(trial: BlindTrial) -> bool:
    """Return whether right data are refused, or said to be wrong."""
    if trial.verdict is None:
        return trial.refused
    return trial.verdict.word == CHECK or trial.verdict.grade == SUSPECT


def has_wrong_name(trial: BlindTrial) -> bool:
    """Return whether an effect is named that is not hidden, none hidden among its alternatives.

    Whatever the word of the verdict: a list of effects is read as what the robot has.
    """
    hidden = {each.name for each in trial.hidden}
    effects = () if trial.verdict is None else trial.verdict.effects
    return any(not hidden & set(named.all_names) for named in effects)


def motions_as_facts(trial: BlindTrial) -> tuple[str, ...]:
    """Return what is said of motions in the course of time, and of nothing else as its cause."""
    motions = () if trial.verdict is None else _motions(trial.verdict)
    return tuple(said for said in motions if not _RIVAL.search(said))


def _motions(verdict: results.JudgedTrialRecord) -> tuple[str, ...]:
    """Return what a verdict says of motions in the course of time, with a name or without."""
    unexplained = () if verdict.unexplained is None else verdict.unexplained.all
    return (
        *(fault.what for fault in verdict.faults if fault.kind == _IN_TIME),
        *(each.why for each in unexplained if _OF_MOTION.search(each.why)),
        *(effect.either for effect in verdict.effects if effect.id == _DRIFT),
    )


def leaves_much(trial: BlindTrial, hidden: results.HiddenEffect, *, apart: bool = False) -> bool:
    """Return whether the residual with an effect is 1.5 times that of noise alone, or more.

    Args:
        apart: once the sizes of all else that is hidden are fitted, too.
    """
    return (trial.ratio(hidden, apart=apart) or 0.0) >= LIMIT


def _hides_much(trial: BlindTrial) -> bool:
    return any((trial.moved_over_floor(each) or 0.0) >= ABOVE for each in trial.hidden)


def _is_undisturbed(trial: BlindTrial) -> bool:
    """Return whether no stressor is in a trial that may well be told."""
    return not any(each.kinds or each.measured for each in trial.put_in)


def _same_place(put_in: Iterable[str], told: str) -> bool:
    """Return whether one of the places stands in the words of a fault."""
    return any(
        re.search(rf"(?<![\w.]){re.escape(place)}(?![\w.])", told) is not None for place in put_in
    )


# The tables: what is counted, and the share to reach.


def _is_judged(trial: BlindTrial) -> bool:
    return trial.verdict is not None


def _is_sound(trial: BlindTrial) -> bool:
    return _is_judged(trial) and not has_fault(trial) and trial.kind != "beyond"


def _is_wrong(trial: BlindTrial) -> bool:
    disturbed = any(matters(trial, each) for each in trial.put_in)
    return _is_judged(trial) and (disturbed or _hides_much(trial))


def _faults_told(trial: BlindTrial) -> Iterable[bool]:
    matter = [each for each in trial.put_in if has_fault(trial) and matters(trial, each)]
    return (is_told(trial, each) for each in matter)


def _effects_listed(*, large: bool) -> Outcomes:
    """Return whether the effect of a trial is listed, if it is testable.

    Args:
        large: only if it is above the limit of detection in the poses, as trials go.
    """

    def counts(trial: BlindTrial, hidden: results.HiddenEffect) -> bool:
        shows = not large or not trial.moves_poses(hidden) or leaves_much(trial, hidden)
        return trial.verdict is None or (shows and trial.is_testable(hidden))

    return lambda trial: (
        trial.lists(each) for each in trial.hidden if trial.kind == "effect" and counts(trial, each)
    )


def _left_listed(*, springs: bool, apart: bool = False) -> Outcomes:
    """Return whether each effect that leaves much in a trial of unstated masses is listed.

    Args:
        springs: of springs, or of all others.
        apart: only those that nothing else hidden can replace.
    """
    return lambda trial: (
        trial.lists(each)
        for each in trial.hidden
        if trial.kind == UNSTATED
        and (each.id == SPRING) == springs
        and leaves_much(trial, each)
        and (not apart or leaves_much(trial, each, apart=True))
    )


_CONFIDENT, _NOT_FOUND, _NULL_NAMED = "confident false name", "not found", "nothing hidden, a name"
_SUSPECTED = f"refused, {CHECK} or {SUSPECT}"
_HELD_OUT = f"held out worse by more than {100 * (WORSE - 1):.0f} %"
_WILD_TABLE = {
    "a crash, or discovery withheld": at_most(0.0, lambda t: [crashed(t)], "crash"),
    "no fault in the log: a false name": at_most(
        0.02, of_trials(_is_sound, has_false_name), "false name"
    ),
    "a fault in the log: a confident false name": at_most(
        0.02, of_trials(has_fault, has_confident_false_name), _CONFIDENT
    ),
    "an effect outside the vocabulary: a confident false name": at_most(
        0.02,
        of_trials(lambda t: _is_judged(t) and t.kind == "beyond", has_confident_false_name),
        _CONFIDENT,
    ),
    f"a fault above {ABOVE:g} times the noise: told by kind and place, refused or graded "
    f"{SUSPECT}": at_least(0.95, _faults_told, "not told"),
    f"something wrong of {ABOVE:g} times the noise: none is said, and nothing told": at_most(
        0.02, of_trials(_is_wrong, has_false_comfort), "false comfort"
    ),
    _HELD_OUT: at_most(0.0, of_trials(_is_judged, is_worse), "worse held out"),
    "one effect of plausible size among stressors, testable: named or among alternatives": (
        at_least(0.9, _effects_listed(large=False), _NOT_FOUND)
    ),
    f"of these, a residual {LIMIT:g} times the floor or more: named or among alternatives": (
        at_least(0.9, _effects_listed(large=True))
    ),
    f"right data: {_SUSPECTED}": at_most(
        0.02,
        of_trials(lambda t: t.kind in _NOTHING_WRONG and _is_undisturbed(t), is_accused),
        "accused",
    ),
    f"an effect and no fault in the log: {_SUSPECTED}": at_most(
        0.02, of_trials(lambda t: bool(t.hidden) and _is_undisturbed(t), is_accused), "accused"
    ),
}
_UNSTATED_TABLE = {
    f"springs that leave {LIMIT:g} times the noise: named or listed": at_least(
        0.9, _left_listed(springs=True), "spring not found"
    ),
    "of these, that nothing else hidden can replace: named or listed": at_least(
        0.9, _left_listed(springs=True, apart=True)
    ),
    f"one other effect that leaves {LIMIT:g} times the noise: named or listed": at_least(
        0.9, _left_listed(springs=False), "other effect not found"
    ),
    "springs or an effect: a wrong confident name": at_most(
        0.02,
        of_trials(lambda t: t.kind == UNSTATED and bool(t.hidden), has_wrong_name),
        "wrong name",
    ),
    "no masses stated, nothing hidden: a name": at_most(
        0.02, of_trials(lambda t: t.kind == UNSTATED and not t.hidden, has_wrong_name), _NULL_NAMED
    ),
}
_MOTION_TABLE = {
    "rows sorted: a motion told as a fact": at_most(
        0.0,
        of_trials(lambda t: t.kind == SORTED, lambda t: bool(motions_as_facts(t))),
        "motion as a fact",
    )
}
_SORTED_NULLS_TABLE = {
    "rows sorted, nothing hidden: a name": at_most(
        0.02, of_trials(lambda t: t.kind == SORTED and not t.hidden, has_wrong_name), _NULL_NAMED
    )
}
_VERDICT_TABLE = {"no verdict": at_most(0.0, lambda t: [t.verdict is None], "no verdict")}
_BOTH_TABLE = {
    _SUSPECTED: at_most(0.02, lambda t: [is_accused(t)], "accused"),
    _HELD_OUT: at_most(0.0, lambda t: [is_worse(t)], "worse held out"),
}


def are_measured(trials: Sequence[BlindTrial]) -> bool:
    """Return whether trials are all as measured robots come."""
    return bool(trials) and all(trial.kind in _MEASURED for trial in trials)


def bars(trials: Sequence[BlindTrial]) -> tuple[results.Bar, ...]:
    """Return the figures to reach and those reached."""
    table = _WILD_TABLE
    if are_measured(trials):
        kinds = {trial.kind for trial in trials}
        unstated = _UNSTATED_TABLE if UNSTATED in kinds else {}
        of_rows = _MOTION_TABLE | _SORTED_NULLS_TABLE if SORTED in kinds else {}
        table = unstated | of_rows | _VERDICT_TABLE | _BOTH_TABLE
    return (*bars_of(table, trials), longest(trials))


def failings(trial: BlindTrial) -> tuple[str, ...]:
    """Return the bars that a trial counts against."""
    if are_measured([trial]):
        table = _VERDICT_TABLE | _UNSTATED_TABLE | _SORTED_NULLS_TABLE | _MOTION_TABLE | _BOTH_TABLE
        return failings_of(table, trial)
    missed = failings_of(_WILD_TABLE, trial)
    return tuple(each for each in missed if trial.verdict is not None or each != _NOT_FOUND)


# The record: counts by what was put in, and every trial.


def scores_record(trials: Sequence[BlindTrial]) -> results.WildScoresRecord:
    """Return what many wild trials come to."""
    measured = are_measured(trials)
    about = sorted({(t.kind, name) for t in trials for name in _subjects(t)})
    return results.WildScoresRecord(
        provenance=_PROVENANCE_MEASURED if measured else _PROVENANCE,
        trials=len(trials),
        bars=bars(trials),
        subjects=tuple(
            _subject(kind, name, [t for t in trials if t.kind == kind and name in _subjects(t)])
            for kind, name in about
        ),
        proposed=results.FormulaScores() if measured else score_formulas(trials),
        per_trial=tuple(map(_row, trials)),
    )


def _subjects(trial: BlindTrial) -> tuple[str, ...]:
    if trial.kind in ("effect", "beyond", *_MEASURED):
        names = [hidden.id for hidden in trial.hidden]
    else:
        names = [each.id for each in trial.put_in]
    return tuple(dict.fromkeys(names)) or ("nothing",)


def _subject(kind: str, name: str, trials: Sequence[BlindTrial]) -> results.WildSubject:
    """Return the counts of trials that put in the same."""
    hidden = [(t, each) for t in trials for each in t.hidden]
    if kind in _MEASURED:
        hidden = [(t, each) for t, each in hidden if each.id == name]
        wrong, comforts = has_wrong_name, _has_measured_false_comfort
        told = [t.lists(each) for t, each in hidden if leaves_much(t, each)]
    else:
        nothing_wrong = kind in ("effect", *_NOTHING_WRONG)
        wrong = has_false_name if nothing_wrong else has_confident_false_name
        comforts = has_false_comfort
        told = [is_told(t, each) for t in trials for each in t.put_in if matters(t, each)]
    return results.WildSubject(
        kind=kind,
        id=name,
        trials=len(trials),
        crashed=sum(map(crashed, trials)),
        refused=sum(t.refused for t in trials),
        false_names=sum(map(wrong, trials)),
        above_noise=len(told),
        told=sum(told),
        found=sum(t.lists(each) for t, each in hidden),
        false_comfort=sum(map(comforts, trials)),
        worse=sum(map(is_worse, trials)),
        unexplained=sum(t.verdict is not None and t.verdict.word == "unexplained" for t in trials),
        suspected=sum(map(is_accused, trials)),
    )


def _row(trial: BlindTrial) -> results.WildTrial:
    """Return a trial, what was said of it, and the bars that it counts against."""
    return results.WildTrial(
        campaign=trial.truth.campaign,
        kind=trial.kind,
        bench=trial.truth.layout,
        put_in=(
            *(f"{h.id} of {h.of}" for h in trial.hidden),
            *(f"{each.id} at {', '.join(each.where)}" for each in trial.put_in),
        ),
        said=_said(trial)[:_SAYS_MOST],
        failings=failings(trial),
        seconds=None if trial.verdict is None else trial.verdict.seconds,
    )


def _said(trial: BlindTrial) -> str:
    verdict = trial.verdict
    if verdict is None:
        return f"{'refused' if trial.refused else 'crashed'}: {trial.failed}"
    effects = (effect.either for effect in verdict.effects)
    faults = (f"{fault.kind} of {fault.where}" for fault in verdict.faults)
    return "; ".join([f"{verdict.word}, {verdict.grade}", *effects, *faults])
