"""What trials of unstated masses and of sorted rows come to; see `cell.measured_trials`.

The truth itself says how far a hidden effect moves the readings once the geometry is fitted again,
and what noise does: a calibrated model may hold springs, and follow.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

from pa10cal.evaluation.blind_trial import SORTED, SPRING, UNSTATED, BlindTrial, words_of
from pa10cal.evaluation.trial_rates import bar, longest, rate
from pa10cal.evaluation.trial_scores import LIMIT
from pa10cal.evaluation.wild_scores import WORSE, counted, gathered, is_accused, is_worse
from pa10cal.results.trials import (
    Bar,
    HiddenEffect,
    JudgedTrialRecord,
    WildScoresRecord,
    WildSubject,
)

_PROVENANCE = (
    "synthetic: virtual cell; arms, their lengths, weights and springs, poses, noise and hidden "
    "effects drawn"
)
FOUND, WRONG, NULLS, ACCUSED = 0.9, 0.02, 0.02, 0.02
#: Words of a motion that offer another reading of it: rows that go with a joint, a rail or a load.
_RIVAL = re.compile(r"\bjoint \d|\brail\b|\bload\b|\border of (the )?rows\b", re.I)
#: Fault and effect that are motions in the course of time, and the words of one without a name.
_IN_TIME, _DRIFT = "step_in_time", "base_drift"
_OF_MOTION = re.compile(r"\b(moved|wander|drift|crept|creep)", re.I)
_Counts = Callable[[BlindTrial, HiddenEffect], bool]


def has_no_verdict(trial: BlindTrial) -> bool:
    """Return whether a campaign that is fit to be judged was not."""
    return trial.verdict is None


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


def _motions(verdict: JudgedTrialRecord) -> tuple[str, ...]:
    """Return what a verdict says of motions in the course of time, with a name or without."""
    unexplained = () if verdict.unexplained is None else verdict.unexplained.all
    return (
        *(fault.what for fault in verdict.faults if fault.kind == _IN_TIME),
        *(each.why for each in unexplained if _OF_MOTION.search(each.why)),
        *(words_of(effect) for effect in verdict.effects if effect.id == _DRIFT),
    )


def leaves_much(trial: BlindTrial, hidden: HiddenEffect) -> bool:
    """Return whether the residual with an effect is 1.5 times that of noise alone, or more."""
    return (trial.ratio(hidden) or 0.0) >= LIMIT


def leaves_much_apart(trial: BlindTrial, hidden: HiddenEffect) -> bool:
    """Return the same once the sizes of all else that is hidden are fitted, too."""
    return (trial.ratio(hidden, apart=True) or 0.0) >= LIMIT


def bars(trials: Sequence[BlindTrial]) -> tuple[Bar, ...]:
    """Return the figures to reach and those reached."""
    return (*_of_unstated(trials), *_of_sorted(trials), *_of_both(trials))


def scores_record(trials: Sequence[BlindTrial]) -> WildScoresRecord:
    """Return what many such trials come to."""
    return gathered(trials, _PROVENANCE, bars(trials), _subjects, _subject, failings)


def failings(trial: BlindTrial) -> tuple[str, ...]:
    """Return the bars that a trial counts against."""
    unstated, verdict = trial.kind == UNSTATED, trial.verdict
    large = [each for each in trial.hidden if unstated and leaves_much(trial, each)]
    missed = [each for each in large if not trial.lists(each)]
    tests = {
        "no verdict": has_no_verdict(trial),
        "spring not found": any(each.id == SPRING for each in missed),
        "other effect not found": any(each.id != SPRING for each in missed),
        "wrong name": unstated and bool(trial.hidden) and has_wrong_name(trial),
        "nothing hidden, a name": not trial.hidden
        and verdict is not None
        and has_wrong_name(trial),
        "motion as a fact": bool(motions_as_facts(trial)) and not unstated,
        "accused": is_accused(trial),
        "worse held out": is_worse(trial),
    }
    return tuple(name for name, true in tests.items() if true)


def _of_unstated(trials: Sequence[BlindTrial]) -> tuple[Bar, ...]:
    unstated = [trial for trial in trials if trial.kind == UNSTATED]
    if not unstated:
        return ()
    hiding = [trial for trial in unstated if trial.hidden]

    def found(what: str, counts: _Counts) -> Bar:
        pairs = [(t, each) for t in hiding for each in t.hidden if counts(t, each)]
        return bar(f"{what}: named or listed", rate(t.lists(h) for t, h in pairs), FOUND)

    return (
        found(
            f"springs that leave {LIMIT:g} times the noise",
            lambda t, h: h.id == SPRING and leaves_much(t, h),
        ),
        found(
            "of these, that nothing else hidden can replace",
            lambda t, h: h.id == SPRING and leaves_much(t, h) and leaves_much_apart(t, h),
        ),
        found(
            f"one other effect that leaves {LIMIT:g} times the noise",
            lambda t, h: h.id != SPRING and leaves_much(t, h),
        ),
        bar(
            "springs or an effect: a wrong confident name",
            rate(map(has_wrong_name, hiding)),
            WRONG,
            at_least=False,
        ),
        _named_nulls("no masses stated, nothing hidden: a name", unstated),
    )


def _of_sorted(trials: Sequence[BlindTrial]) -> tuple[Bar, ...]:
    rows = [trial for trial in trials if trial.kind == SORTED]
    if not rows:
        return ()
    told = rate(bool(motions_as_facts(trial)) for trial in rows)
    return (
        bar("rows sorted: a motion told as a fact", told, 0.0, at_least=False),
        _named_nulls("rows sorted, nothing hidden: a name", rows),
    )


def _of_both(trials: Sequence[BlindTrial]) -> tuple[Bar, ...]:
    return (
        bar("no verdict", rate(map(has_no_verdict, trials)), 0.0, at_least=False),
        bar(
            "refused, check_the_log or suspect_input",
            rate(map(is_accused, trials)),
            ACCUSED,
            at_least=False,
        ),
        bar(
            f"held out worse by more than {100 * (WORSE - 1):.0f} %",
            rate(map(is_worse, trials)),
            0.0,
            at_least=False,
        ),
        longest(trials),
    )


def _named_nulls(what: str, trials: Sequence[BlindTrial]) -> Bar:
    nulls = [trial for trial in trials if not trial.hidden]
    return bar(what, rate(map(has_wrong_name, nulls)), NULLS, at_least=False)


def _subjects(trial: BlindTrial) -> tuple[str, ...]:
    return tuple(dict.fromkeys(each.id for each in trial.hidden)) or ("nothing",)


def _subject(kind: str, name: str, trials: Sequence[BlindTrial]) -> WildSubject:
    mine = [(t, each) for t in trials for each in t.hidden if each.id == name]
    large = [(t, each) for t, each in mine if leaves_much(t, each)]
    return counted(
        kind,
        name,
        trials,
        false_names=sum(map(has_wrong_name, trials)),
        above_noise=len(large),
        told=sum(t.lists(each) for t, each in large),
        found=sum(t.lists(each) for t, each in mine),
        false_comfort=sum(
            t.verdict is not None
            and t.verdict.word == "none"
            and any(leaves_much(t, each) for each in t.hidden)
            for t in trials
        ),
    )
