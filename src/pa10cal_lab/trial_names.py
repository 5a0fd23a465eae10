"""The names in the verdict on a blind trial, compared with the effects that the trial hides.

A finding has a name and alternatives. It lists a hidden effect if either is the effect's name: its
id, and the place where it sits. A map of a joint's error, or a line of it, may also rightly
describe an error by the joint's angle that has no name.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from pa10cal.results.discovery import FoundEffect
from pa10cal.results.number_text import SURE
from pa10cal.results.record import Name
from pa10cal_lab.blind_trial import DRIVES, MAP, OUTSIDE, SPRING, BlindTrial, effect_class
from pa10cal_lab.cell.effects.vocabulary import nameless
from pa10cal_lab.trial_records import HiddenEffect

#: Ids of a line: a map that is a single wave of `k` cycles a turn of the joint, or of its gear.
LINE = "periodic_error"
_LINES = (LINE, "gear_line")
#: Ids of errors of a drive.
_SENSOR = "sensor_error"
_GEAR = "gear_error"
#: Difference of orders, in cycles a turn, below which they count as equal.
_SAME_ORDER = 0.5

#: Outcomes of a hidden effect other than the id that it was called.
LISTED = "in the alternatives"
ELSEWHERE = "right id elsewhere"
RIGHT_PLACE = "no name, right place"
WRONG_PLACE = "no name, other place"
NOTHING = "nothing found"
NOT_TESTABLE = "said to be not testable"
FAILED = "failed"


# Hidden effects that the verdict lists, and findings that match none.


def is_named(trial: BlindTrial, hidden: HiddenEffect) -> bool:
    """Return whether the verdict names an effect at its place."""
    return any(found.name == hidden.name for found in trial.effects)


def is_listed(trial: BlindTrial, hidden: HiddenEffect) -> bool:
    """Return whether an effect is among those named and their alternatives."""
    return any(hidden.name in found.all_names for found in trial.effects)


def alternative_count(trial: BlindTrial, hidden: HiddenEffect) -> int | None:
    """Return the number of other names listed with an effect; None where it is not listed."""
    counts = [len(found.alternatives) for found in trial.effects if hidden.name in found.all_names]
    return min(counts, default=None)


def matched_count(trial: BlindTrial, among: Sequence[HiddenEffect]) -> int:
    """Return the largest number of hidden effects that can be paired with findings."""
    lists = np.zeros((len(among), len(trial.effects)))
    for row, hidden in enumerate(among):
        lists[row] = [hidden.name in found.all_names for found in trial.effects]
    return int(lists[linear_sum_assignment(lists, maximize=True)].sum())


def extra_count(trial: BlindTrial) -> int:
    """Return the number of findings that match no hidden effect."""
    return len(trial.effects) - matched_count(trial, trial.hidden)


def is_place_found(trial: BlindTrial, hidden: HiddenEffect) -> bool:
    """Return whether anything was found at the place of a hidden effect, whatever its name."""
    places = [name.of for found in without_springs(trial).effects for name in found.all_names]
    return hidden.of in (*places, *_nameless_places(trial))


def has_right_place(trial: BlindTrial) -> bool:
    """Return whether something without a name was found at the place of a hidden effect."""
    places = _nameless_places(trial)
    return any(hidden.of in places for hidden in trial.hidden) or any(
        _describes_error_by_angle(trial, found.name, found) for found in trial.effects
    )


def _nameless_places(trial: BlindTrial) -> tuple[str | None, ...]:
    return () if trial.verdict is None else trial.verdict.places


# Wrong names.


def is_confidently_wrong(trial: BlindTrial, *words: str) -> bool:
    """Return whether the verdict is `named` with a sure name that is not hidden.

    A map at a joint whose error depends on its angle does not count: it leaves the cause open.

    Args:
        words: further verdicts whose names are trusted.
    """
    if trial.verdict is None or trial.verdict.word not in ("named", *words):
        return False
    right = {hidden.name for hidden in trial.hidden}
    return any(
        found.probability >= SURE
        and found.name not in right
        and not _describes_error_by_angle(trial, found.name, found)
        for found in trial.effects
    )


def has_wrong_name(trial: BlindTrial) -> bool:
    """Return whether a finding has no hidden effect among its name and alternatives.

    The word of the verdict does not matter: users read a list of effects as what the robot has.
    """
    hidden = {each.name for each in trial.hidden}
    return any(hidden.isdisjoint(found.all_names) for found in trial.effects)


def has_wrong_name_alone(trial: BlindTrial) -> bool:
    """Return whether a sure name is not hidden, whatever the word of the verdict."""
    hidden = {each.name for each in trial.hidden}
    return any(found.probability >= SURE and found.name not in hidden for found in trial.effects)


def without_springs(trial: BlindTrial) -> BlindTrial:
    """Return the trial without findings of springs that the arm has."""
    springs = _true_springs(trial)
    return trial.with_effects(f for f in trial.effects if springs.isdisjoint(f.all_names))


def without_background(trial: BlindTrial) -> BlindTrial:
    """Return the trial without findings that describe the hidden background."""
    return trial.with_effects(f for f in trial.effects if not _describes_background(trial, f))


def _true_springs(trial: BlindTrial) -> set[Name]:
    """Return the names of the springs that the arm has."""
    return {Name(SPRING, f"joint {joint}") for joint in trial.truth.flexible_joints}


def _describes_background(trial: BlindTrial, found: FoundEffect) -> bool:
    """Return whether a finding names an effect of the background, or is a map of its error."""
    for hidden in trial.hidden:
        if not hidden.outside or hidden.of != found.of:
            continue
        kind = effect_class(hidden)
        if found.id in _LINES and kind.by_angle:
            if _has_order(hidden, found):
                return True
        elif found.id in (hidden.id, *kind.also_called) or (found.id == MAP and kind.by_angle):
            return True
    return False


def _describes_error_by_angle(trial: BlindTrial, name: Name, found: FoundEffect) -> bool:
    """Return whether a map or a line rightly describes a hidden error by a joint's angle.

    Errors of the background (`outside`) make a map or a line right as the name only, not as an
    alternative. The line that is named needs the right cycles a turn.

    Args:
        name: the name, or an alternative, of the finding.
    """
    here = [
        hidden for hidden in trial.hidden if hidden.of == name.of and effect_class(hidden).by_angle
    ]
    if name == found.name and name.id in _LINES:
        return any(_has_order(hidden, found) for hidden in here)
    return name.id in (MAP, LINE) and any(
        name == found.name or not hidden.outside for hidden in here
    )


def _has_order(hidden: HiddenEffect, found: FoundEffect) -> bool:
    """Return whether one of the hidden waves has the cycles a turn that a finding reports."""
    of_formula = effect_class(hidden).formula_numbers(hidden.parameters)[:1]
    orders = np.atleast_1d(np.array(hidden.parameters.get("orders", of_formula), float))
    return bool(np.any(np.abs(orders - _cycles(found)) < _SAME_ORDER))


def _cycles(found: FoundEffect) -> float:
    """Return the cycles a turn that a finding reports; 0 where it reports none."""
    return found.parameters["k"].value if "k" in found.parameters else 0.0


# Claimed probabilities, and whether the claims are true.


class Claim(NamedTuple):
    """A probability that a verdict states, and whether what it states is true."""

    of: str  # `name`, `alternative`, `none of these`, or `set`: that the smallest set holds it
    probability: float
    right: bool


def claims(trial: BlindTrial) -> Iterator[Claim]:
    """Yield the probabilities of each finding's name, of its alternatives, and of none."""
    true = {hidden.name for hidden in trial.hidden} | _true_springs(trial)
    for hidden in trial.hidden:
        if hidden.outside:
            true |= {Name(id, hidden.of) for id in effect_class(hidden).also_called}
    for found in trial.effects:
        probabilities = {found.name: found.probability}
        probabilities |= {other.name: other.probability for other in found.alternatives}
        # The 95 % set may have members that are too improbable to be listed.
        names = {*probabilities, *(member.name for member in found.set95)}
        right = {
            name: name in true or _describes_error_by_angle(trial, name, found) for name in names
        }
        for name, probability in probabilities.items():
            of = "name" if name == found.name else "alternative"
            yield Claim(of, probability, right[name])
        none_is_right = not any(right.values())
        yield Claim("none of these", found.none_of_these, none_is_right)
        # `none of these` belongs to the set too, if it is probable enough.
        holds_none = none_is_right and found.none_of_these > 1.0 - SURE
        in_set = any(right[member.name] for member in found.set95)
        yield Claim("set", SURE, in_set or holds_none)


# What each hidden effect was called.


def outcome(trial: BlindTrial, hidden: HiddenEffect) -> str:
    """Return the outcome of a hidden effect: an id of the vocabulary, or a word such as LISTED.

    Where findings match no hidden effect, the id of the first is returned.
    """
    if trial.truth.measured == DRIVES:
        return drive_outcome(trial, hidden.of)
    if trial.verdict is None:
        return FAILED
    if is_named(trial, hidden):
        return hidden.id
    if is_listed(trial, hidden):
        return LISTED
    if trial.kind == OUTSIDE and has_right_place(trial):
        return RIGHT_PLACE
    if trial.effects:
        ids = [found.id for found in trial.effects]
        return ELSEWHERE if hidden.id in ids else ids[0]
    if trial.verdict.word == "unexplained":
        return RIGHT_PLACE if hidden.of in trial.verdict.places else WRONG_PLACE
    return NOTHING if trial.is_testable(hidden) else NOT_TESTABLE


def drive_outcome(trial: BlindTrial, of: str) -> str:
    """Return the outcome for the drive of a joint, `joint 2`; see `JudgedEffect.outcome`."""
    if trial.verdict is None:
        return FAILED
    drive = {_SENSOR, _GEAR}
    hidden = {each.id for each in trial.hidden if each.of == of}
    found = next((f for f in trial.effects if f.of == of and f.id in (*drive, MAP)), None)
    if found is None:
        return "missed"
    causes = {name.id for name in found.all_names if name.of == of} & drive
    if not causes:
        return "no_cause"
    if causes == hidden:
        return "right"
    return "ambiguous" if hidden & causes else "wrong"


# Proposed formulas: whether they have the hidden form, order and place.


class Formula(NamedTuple):
    """A proposed formula without its amplitudes."""

    form: str
    of: str  # its place
    numbers: tuple[float, ...] = ()  # constants of the form, orders first


def is_right(hidden: HiddenEffect, formula: Formula) -> bool:
    """Return whether a formula has the form, orders and place of a hidden effect."""
    kind = effect_class(hidden)
    if formula.form not in kind.forms or formula.of != hidden.of:
        return False
    numbers = kind.formula_numbers(hidden.parameters)
    return formula.numbers[: len(numbers)] == numbers


def proposes(trial: BlindTrial, *, right: bool) -> bool:
    """Return whether a right formula was proposed; with `right=False`, a wrong one.

    A line that was named in place of a map is a formula, too.
    """
    if trial.verdict is None:
        return False
    formulas = [Formula(p.form, p.of, p.numbers) for p in trial.verdict.proposed or ()]
    lines = (found for found in trial.effects if found.id == LINE)
    formulas += [Formula("harmonic", line.of, (_cycles(line),)) for line in lines]
    return any(
        any(is_right(hidden, formula) for hidden in trial.hidden) == right for formula in formulas
    )


def is_outside(trial: BlindTrial) -> bool:
    """Return whether all hidden effects are outside the vocabulary."""
    return bool(trial.hidden) and all(hidden.id in nameless() for hidden in trial.hidden)
