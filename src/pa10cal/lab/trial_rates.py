"""Shares of trials with their exact intervals, and how sure an effect of some size is found."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import binomtest

from pa10cal.arrays import Array
from pa10cal.lab.blind_trial import LINE, MAP, BlindTrial, cycles_of
from pa10cal.results.trials import Bar, FormulaScores, HiddenEffect, PowerCurve, Rate

LEVEL = 0.95
#: Seconds of the processor that judging a campaign may take.
_SECONDS = 15.0
#: Standard deviation expected of the slope of a power curve: none is steeper than a few of these
#: where all trials below some size fail and all above succeed.
_STEEP = 5.0


def rate(outcomes: Iterable[bool]) -> Rate:
    """Count outcomes."""
    flags = list(outcomes)
    if not flags:
        return Rate(count=0, of=0, low=0.0, high=1.0, share=None)
    interval = binomtest(sum(flags), len(flags)).proportion_ci(LEVEL, method="exact")
    count = sum(flags)
    return Rate(
        count=count,
        of=len(flags),
        low=float(interval.low),
        high=float(interval.high),
        share=count / len(flags),
    )


Outcomes = Callable[[BlindTrial], Iterable[bool]]


class Goal(NamedTuple):
    """A share of outcomes to reach, or not to exceed."""

    at_least: bool  # whether `limit` is to be reached
    limit: float
    outcomes: Outcomes  # of a trial; none where it does not count
    failing: str = ""  # what is said of a trial that counts against it

    def rate(self, trials: Iterable[BlindTrial]) -> Rate:
        """Return the share of some trials."""
        return rate(outcome for trial in trials for outcome in self.outcomes(trial))


#: A table of scores: goals by what is counted.
Table = Mapping[str, Goal]
at_least, at_most = partial(Goal, True), partial(Goal, False)


def of_trials(
    counts: Callable[[BlindTrial], object], outcome: Callable[[BlindTrial], bool]
) -> Outcomes:
    """Return one outcome of every trial that counts."""
    return lambda trial: [outcome(trial)] if counts(trial) else []


def bars_of(table: Table, trials: Sequence[BlindTrial]) -> tuple[Bar, ...]:
    """Return the shares of a table against those to reach."""
    return tuple(
        bar(what, goal.rate(trials), goal.at_least, goal.limit) for what, goal in table.items()
    )


def failings_of(table: Table, trial: BlindTrial) -> tuple[str, ...]:
    """Return the goals that a trial counts against, in their words."""
    missed = (
        goal.failing
        for goal in table.values()
        if goal.failing and any(outcome != goal.at_least for outcome in goal.outcomes(trial))
    )
    return tuple(dict.fromkeys(missed))


def bar(what: str, found: Rate, at_least: bool, limit: float) -> Bar:
    """Return a share with its interval against the one to reach, or not to exceed."""
    bare = figure(what, found.share, limit, found.of, at_least=at_least)
    return bare.model_copy(update={"low": found.low, "high": found.high, "share": True})


def figure(
    what: str, reached: float | None, limit: float, trials: int, *, at_least: bool = False
) -> Bar:
    """Return a figure, None where no trial shows it, against the one to reach."""
    met = None  # where no trial counts
    if reached is not None:
        met = reached >= limit if at_least else reached <= limit
    return Bar(
        what=what,
        at_least=at_least,
        limit=limit,
        reached=reached,
        low=None,
        high=None,
        trials=trials,
        share=False,
        met=met,
    )


def longest(trials: Sequence[BlindTrial]) -> Bar:
    """Return how long judging a campaign took at most."""
    seconds = [trial.verdict.seconds for trial in trials if trial.verdict is not None]
    what = "seconds of the processor to judge one campaign, longest"
    return figure(what, max(seconds, default=None), _SECONDS, len(seconds))


def power(size: Array, found: NDArray[np.bool_]) -> PowerCurve | None:
    """Fit a power curve; None where all trials, or none, were found.

    Args:
        size: (T,) positive.
        found: (T,).
    """
    if not len(size) or found.all() or not found.any():
        return None
    logarithm = np.log(size)
    middle = logarithm.mean()

    def misfit(x: Array) -> float:
        odds = x[0] + x[1] * (logarithm - middle)
        return float(np.sum(np.logaddexp(0.0, np.where(found, -odds, odds)))) + 0.5 * float(
            (x[1] / _STEEP) ** 2
        )

    best = minimize(misfit, np.array([0.0, 1.0]), bounds=[(None, None), (0.0, None)])
    centre, slope = float(best.x[0]), float(best.x[1])
    intercept = centre - slope * float(middle)

    def size_at(chance: float) -> float | None:
        if slope <= 0.0:
            return None
        found_at = float(np.exp((np.log(chance / (1.0 - chance)) - intercept) / slope))
        return found_at if size.min() <= found_at <= size.max() else None

    return PowerCurve(intercept=intercept, slope=slope, half=size_at(0.5), most=size_at(LEVEL))


# Formulas proposed in blind trials: the form that was hidden, of the same order and place?

Parameters = Mapping[str, object]
#: Forms that are right, with the numbers that they begin with.
_Forms = Callable[[Parameters], Sequence[tuple[str, tuple[float, ...]]]]


def _number(parameters: Parameters, name: str) -> float:
    return float(str(parameters[name]))


def _bow(parameters: Parameters) -> list[tuple[str, tuple[float, ...]]]:
    axes = (_number(parameters, "axis"), _number(parameters, "along"))
    return [("quadratic", axes), ("cubic", axes)]


def _teeth(parameters: Parameters) -> float:
    return float(np.rint(2.0 * np.pi / _number(parameters, "sector")))


#: By what is hidden outside the vocabulary, its formula in the forms that may be proposed.
_OUTSIDE: dict[str, _Forms] = {
    "third_harmonic": lambda _: [("harmonic", (3.0,))],
    "bowed_axis": _bow,
    "dress_pack": lambda _: [("pull", ())],
    "hysteresis": lambda _: [("arrival_by_torque", ())],
    "soft_by_angle": lambda known: [("torque_by_angle", (_number(known, "cycles"),))],
    "sawtooth": lambda known: [("sawtooth", (_teeth(known),))],
    "pedestal_tilt": lambda _: [("moment_cubed", ())],
}
#: Names of which a map may be found, and a formula proposed for that.
_NAMED: dict[str, _Forms] = {
    "encoder_eccentricity": lambda _: [("harmonic", (1.0,))],
    "encoder_ellipticity": lambda _: [("harmonic", (2.0,))],
}


class Formula(NamedTuple):
    """What counts of a formula that was proposed."""

    form: str  # which form
    of: str  # where it sits
    numbers: tuple[float, ...] = ()  # what fixes it: orders first


def is_right(hidden: HiddenEffect, formula: Formula) -> bool:
    """Return whether a formula is what is hidden: form, order and place."""
    forms = {**_OUTSIDE, **_NAMED}.get(hidden.id)
    if forms is None or formula.of != hidden.of:
        return False
    return any(
        formula.form == form and formula.numbers[: len(numbers)] == numbers
        for form, numbers in forms(hidden.parameters)
    )


def has_right(trial: BlindTrial) -> bool:
    """Return whether what is hidden was proposed."""
    return any(is_right(hidden, each) for hidden in trial.hidden for each in _proposed(trial))


def has_wrong(trial: BlindTrial) -> bool:
    """Return whether a formula was proposed that is not hidden."""
    return any(
        not any(is_right(hidden, each) for hidden in trial.hidden) for each in _proposed(trial)
    )


def score_formulas(trials: Sequence[BlindTrial]) -> FormulaScores:
    """Score the formulas proposed; a trial that failed has none."""
    outside = [trial for trial in trials if _is_outside(trial)]
    right, wrong, elsewhere = (goal.rate(trials) for goal in _FORMULAS.values())
    return FormulaScores(
        right=right,
        right_of_nameless=rate(has_right(t) for t in outside if _nameless(t)),
        wrong=wrong,
        elsewhere=elsewhere,
        by_id={
            name: rate(has_right(t) for t in outside if t.hidden[0].id == name)
            for name in sorted({t.hidden[0].id for t in outside})
        },
        bars=bars_of(_FORMULAS, trials),
    )


def _is_outside(trial: BlindTrial) -> bool:
    """Return whether all that a trial hides is outside the vocabulary."""
    return bool(trial.hidden) and all(hidden.id in _OUTSIDE for hidden in trial.hidden)


_FORMULAS = {
    "effect outside the vocabulary: its formula proposed, form and order": at_least(
        0.6, of_trials(_is_outside, has_right)
    ),
    "effect outside the vocabulary: another formula proposed": at_most(
        0.1, of_trials(_is_outside, has_wrong)
    ),
    "nothing outside the vocabulary: a formula proposed that is not hidden": at_most(
        0.02, of_trials(lambda trial: not _is_outside(trial), has_wrong)
    ),
}


def _proposed(trial: BlindTrial) -> tuple[Formula, ...]:
    """Return the formulas proposed, and the lines named in the place of maps."""
    if trial.verdict is None:
        return ()
    lines = (each for each in trial.verdict.effects if each.id == LINE)
    return (
        *(Formula(each.form, each.of, each.numbers) for each in trial.verdict.proposed or ()),
        *(Formula("harmonic", each.of, (cycles_of(each) or 0.0,)) for each in lines),
    )


def _nameless(trial: BlindTrial) -> bool:
    """Return whether a map, its line, or something without a name was found."""
    if trial.verdict is None:
        return False
    found = any(each.id in (MAP, LINE) for each in trial.verdict.effects)
    return found or bool(trial.verdict.places)
