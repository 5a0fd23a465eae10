"""What wild trials come to: crashes, false names, false comfort, faults told, effects found.

A campaign may be refused before it is calibrated; what stops discovery or evaluation afterwards is
counted as a crash, since a campaign that can be calibrated is not withheld.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

from pa10cal.evaluation.blind_trial import BlindTrial, words_of
from pa10cal.evaluation.trial_rates import bar, longest, rate, score_formulas
from pa10cal.evaluation.trial_scores import LIMIT
from pa10cal.results.record import Name
from pa10cal.results.trials import Bar, PutIn, WildScoresRecord, WildSubject, WildTrial

#: From here on, in units of the noise floor, something wrong must show.
ABOVE = 3.0
#: Held-out error with effects over that without, at most.
WORSE = 1.05
SUSPECT = "suspect_input"
CHECK = "check_the_log"
_NOTHING_WRONG = ("right", "stressed")
_PROVENANCE = (
    "synthetic: virtual cell; robots, poses, noise, stressors, faults and hidden effects drawn"
)
#: Faults whose place is a time, or a key that no verdict names.
_PLACED_BY_KIND = ("step_in_time", "payload")
_SAYS_MOST = 200
_SPRING = "joint_compliance"


def crashed(trial: BlindTrial) -> bool:
    """Return whether a command failed that should not."""
    return trial.verdict is None and not trial.refused


def has_fault(trial: BlindTrial) -> bool:
    """Return whether something in the log is wrong that somebody should be told of."""
    return any(not each.stressor or each.kinds for each in trial.put_in)


def matters(trial: BlindTrial, put_in: PutIn) -> bool:
    """Return whether what was put in is more than three times the noise.

    Where it cannot be measured, since the campaign was refused, it is.
    """
    if not put_in.measured:
        return bool(put_in.kinds) or not put_in.stressor
    over = trial.moved_over_floor(put_in)
    return trial.verdict is None or (over is not None and over >= ABOVE)


def is_told(trial: BlindTrial, put_in: PutIn) -> bool:
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
    true = {Name(_SPRING, f"joint {joint}") for joint in trial.truth.flexible_joints}
    effects = tuple(named for named in verdict.effects if not true & set(named.all_names))
    return replace(trial, said=verdict.model_copy(update={"effects": effects}))


def has_false_comfort(trial: BlindTrial) -> bool:
    """Return whether `none` is said where something of three times the noise is wrong, untold."""
    if trial.verdict is None or trial.verdict.word != "none":
        return False
    hidden = any((trial.moved_over_floor(each) or 0.0) >= ABOVE for each in trial.hidden)
    return hidden or any(matters(trial, each) and not is_told(trial, each) for each in trial.put_in)


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


def bars(trials: Sequence[BlindTrial]) -> tuple[Bar, ...]:
    """Return the figures to reach and those reached."""
    judged = [t for t in trials if t.verdict is not None]
    faulty = [t for t in trials if has_fault(t)]
    sound = [t for t in judged if not has_fault(t) and t.kind != "beyond"]
    right = [t for t in trials if t.kind in _NOTHING_WRONG and not any(map(_counts, t.put_in))]
    hiding = [t for t in trials if t.hidden and not any(map(_counts, t.put_in))]
    faults = [(t, each) for t in faulty for each in t.put_in if matters(t, each)]
    wrong = [t for t in judged if _is_wrong(t)]
    effects = [t for t in trials if t.kind == "effect"]
    testable = [t for t in effects if t.verdict is None or t.is_testable(t.hidden[0])]
    beyond = [t for t in judged if t.kind == "beyond"]
    return (
        bar("a crash, or discovery withheld", rate(map(crashed, trials)), 0.0, at_least=False),
        bar(
            "no fault in the log: a false name",
            rate(map(has_false_name, sound)),
            0.02,
            at_least=False,
        ),
        bar(
            "a fault in the log: a confident false name",
            rate(has_confident_false_name(t) for t in faulty),
            0.02,
            at_least=False,
        ),
        bar(
            "an effect outside the vocabulary: a confident false name",
            rate(map(has_confident_false_name, beyond)),
            0.02,
            at_least=False,
        ),
        bar(
            f"a fault above {ABOVE:g} times the noise: told by kind and place, refused or graded "
            f"{SUSPECT}",
            rate(is_told(t, each) for t, each in faults),
            0.95,
        ),
        bar(
            f"something wrong of {ABOVE:g} times the noise: none is said, and nothing told",
            rate(map(has_false_comfort, wrong)),
            0.02,
            at_least=False,
        ),
        bar(
            f"held out worse by more than {100 * (WORSE - 1):.0f} %",
            rate(map(is_worse, judged)),
            0.0,
            at_least=False,
        ),
        bar(
            "one effect of plausible size among stressors, testable: named or among alternatives",
            rate(t.lists(t.hidden[0]) for t in testable),
            0.9,
        ),
        bar(
            f"of these, a residual {LIMIT:g} times the floor or more: named or among alternatives",
            rate(t.lists(t.hidden[0]) for t in testable if _is_large(t)),
            0.9,
        ),
        bar(
            f"right data: refused, {CHECK} or {SUSPECT}",
            rate(map(is_accused, right)),
            0.02,
            at_least=False,
        ),
        bar(
            f"an effect and no fault in the log: refused, {CHECK} or {SUSPECT}",
            rate(map(is_accused, hiding)),
            0.02,
            at_least=False,
        ),
        longest(trials),
    )


def scores_record(trials: Sequence[BlindTrial]) -> WildScoresRecord:
    """Return what many wild trials come to."""
    found = gathered(trials, _PROVENANCE, bars(trials), _subjects, _subject, failings)
    return found.model_copy(update={"proposed": score_formulas(trials)})


def gathered(
    trials: Sequence[BlindTrial],
    provenance: str,
    reached: tuple[Bar, ...],
    subjects_of: Callable[[BlindTrial], tuple[str, ...]],
    subject: Callable[[str, str, Sequence[BlindTrial]], WildSubject],
    failings_of: Callable[[BlindTrial], tuple[str, ...]],
) -> WildScoresRecord:
    """Return the record of many trials, by what each was about and what counts against it."""
    about = sorted({(t.kind, name) for t in trials for name in subjects_of(t)})
    return WildScoresRecord(
        provenance=provenance,
        trials=len(trials),
        bars=reached,
        subjects=tuple(
            subject(kind, name, [t for t in trials if t.kind == kind and name in subjects_of(t)])
            for kind, name in about
        ),
        per_trial=tuple(trial_row(trial, failings_of(trial)) for trial in trials),
    )


def failings(trial: BlindTrial) -> tuple[str, ...]:
    """Return the bars that a trial counts against."""
    testable = trial.kind == "effect" and trial.verdict and trial.is_testable(trial.hidden[0])
    right = trial.kind != "fault" and not any(map(_counts, trial.put_in))
    sound = not has_fault(trial) and trial.kind != "beyond"
    tests = {
        "crash": crashed(trial),
        "false name": sound and has_false_name(trial),
        "confident false name": not sound and has_confident_false_name(trial),
        "not told": any(matters(trial, e) and not is_told(trial, e) for e in trial.put_in),
        "false comfort": has_false_comfort(trial),
        "worse held out": is_worse(trial),
        "not found": bool(testable) and not trial.lists(trial.hidden[0]),
        "accused": right and is_accused(trial),
    }
    return tuple(name for name, true in tests.items() if true)


def _counts(put_in: PutIn) -> bool:
    """Return whether a stressor is one that may well be told."""
    return bool(put_in.kinds) or put_in.measured


def _is_wrong(trial: BlindTrial) -> bool:
    hidden = any((trial.moved_over_floor(each) or 0.0) >= ABOVE for each in trial.hidden)
    return hidden or any(matters(trial, each) for each in trial.put_in)


def _is_large(trial: BlindTrial) -> bool:
    """Return whether a hidden effect is above the limit of detection in the poses, as trials go."""
    (hidden,) = trial.hidden
    if trial.verdict is None or not trial.moves_poses(hidden):
        return True
    return (trial.ratio(hidden) or 0.0) >= LIMIT


def _subjects(trial: BlindTrial) -> tuple[str, ...]:
    if trial.kind in ("effect", "beyond"):
        return tuple(hidden.id for hidden in trial.hidden)
    return tuple(each.id for each in trial.put_in) or ("nothing",)


def _subject(kind: str, name: str, trials: Sequence[BlindTrial]) -> WildSubject:
    faults = [(t, e) for t in trials for e in t.put_in if matters(t, e)]
    wrong = has_false_name if kind in ("effect", *_NOTHING_WRONG) else has_confident_false_name
    return counted(
        kind,
        name,
        trials,
        false_names=sum(map(wrong, trials)),
        above_noise=len(faults),
        told=sum(is_told(t, each) for t, each in faults),
        found=sum(t.lists(h) for t in trials for h in t.hidden),
        false_comfort=sum(map(has_false_comfort, trials)),
    )


def counted(kind: str, name: str, trials: Sequence[BlindTrial], **own: int) -> WildSubject:
    """Return the counts of trials that put in the same; `own` are those of their kind."""
    return WildSubject(
        **own,
        kind=kind,
        id=name,
        trials=len(trials),
        crashed=sum(map(crashed, trials)),
        refused=sum(t.refused for t in trials),
        worse=sum(map(is_worse, trials)),
        unexplained=sum(t.verdict is not None and t.verdict.word == "unexplained" for t in trials),
        suspected=sum(map(is_accused, trials)),
    )


def trial_row(trial: BlindTrial, counts_against: tuple[str, ...]) -> WildTrial:
    """Return a trial, what was said of it, and the bars that it counts against."""
    return WildTrial(
        campaign=trial.truth.campaign,
        kind=trial.kind,
        bench=trial.truth.layout,
        put_in=(
            *(f"{h.id} of {h.of}" for h in trial.hidden),
            *(f"{each.id} at {', '.join(each.where)}" for each in trial.put_in),
        ),
        said=_said(trial)[:_SAYS_MOST],
        failings=counts_against,
        seconds=None if trial.verdict is None else trial.verdict.seconds,
    )


def _said(trial: BlindTrial) -> str:
    verdict = trial.verdict
    if verdict is None:
        return f"{'refused' if trial.refused else 'crashed'}: {trial.failed}"
    faults = (f"{fault.kind} of {fault.where}" for fault in verdict.faults)
    return "; ".join([f"{verdict.word}, {verdict.grade}", *map(words_of, verdict.effects), *faults])


def _same_place(put_in: Iterable[str], told: str) -> bool:
    """Return whether one of the places stands in the words of a fault."""
    return any(
        re.search(rf"(?<![\w.]){re.escape(place)}(?![\w.])", told) is not None for place in put_in
    )
