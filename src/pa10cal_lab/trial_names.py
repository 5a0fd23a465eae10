"""The names in the verdict on a blind trial, compared with the effects that the trial hides.

A name is an id and a place. A finding has a name and alternatives; it lists a hidden effect if one
of them is the effect's name.

Words for hidden effects: one is *nameless* if it is outside the vocabulary. It is of the
*background* if it is one of the small nameless effects that most joints of measured robots have,
and that half of the trials of several effects hide besides (`HiddenEffect.outside`). A trial of the
kind `OUTSIDE` hides one nameless effect and nothing else.

A nameless error by a joint's angle cannot be named, but a map of that joint's error, or a line (a
map that is one wave), describes it rightly: these say where the error is and leave its cause open.
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
from pa10cal_lab.trial_records import HiddenEffect

#: Ids of a line, a single wave of `k` cycles a turn of the joint: of its own, or of its gear.
LINE = "periodic_error"
_LINES = (LINE, "gear_line")
#: Form of a formula that is a single wave.
_WAVE = "harmonic"
#: Ids of errors of a drive.
_SENSOR = "sensor_error"
_GEAR = "gear_error"
#: Difference of orders, in cycles a turn, below which they count as equal.
_SAME_ORDER = 0.5

#: Outcomes of a hidden effect other than the id that it was called. Something without a name is
#: found at its place, at another one, or at none in particular.
LISTED = "in the alternatives"
ELSEWHERE = "right id elsewhere"
RIGHT_PLACE = "no name, right place"
WRONG_PLACE = "no name, other place"
NO_PLACE = "no name, no place"
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
    is_listed_by = np.zeros((len(among), len(trial.effects)))
    for row, hidden in enumerate(among):
        is_listed_by[row] = [hidden.name in found.all_names for found in trial.effects]
    pairs = linear_sum_assignment(is_listed_by, maximize=True)
    return int(is_listed_by[pairs].sum())


def extra_count(trial: BlindTrial) -> int:
    """Return the number of findings that match no hidden effect."""
    return len(trial.effects) - matched_count(trial, trial.hidden)


def is_place_found(trial: BlindTrial, hidden: HiddenEffect) -> bool:
    """Return whether anything was found at the place of a hidden effect, whatever its name."""
    places = [name.of for found in without_springs(trial).effects for name in found.all_names]
    return hidden.of in (*places, *_nameless_places(trial))


def has_right_place(trial: BlindTrial) -> bool:
    """Return whether the place of a hidden effect was found and its cause left open.

    By something without a name, or by the map or line that a finding is named.
    """
    places = _nameless_places(trial)
    return any(hidden.of in places for hidden in trial.hidden) or any(
        _is_map_of_error(trial, found) for found in trial.effects
    )


def _nameless_places(trial: BlindTrial) -> tuple[str | None, ...]:
    """Return where the verdict says that something without a name sits; None: at no place."""
    return () if trial.verdict is None else trial.verdict.places


# Wrong names. Three rules, as studies differ in what a user is expected to trust:
#
# | rule | findings that count | wrong where |
# | --- | --- | --- |
# | `is_confidently_wrong` | sure ones, if the verdict is `named` | the name is not hidden |
# | `has_sure_wrong_name` | sure ones, whatever the verdict | the name is not hidden |
# | `has_finding_of_nothing` | all, whatever the verdict | no name that it lists is hidden |
#
# By the first alone, maps and lines that rightly describe a nameless error are not wrong.


def is_confidently_wrong(trial: BlindTrial, *words: str) -> bool:
    """Return whether the verdict is `named` with a sure name that is wrong, and no right map.

    Args:
        words: further verdicts whose names are trusted.
    """
    if trial.verdict is None or trial.verdict.word not in ("named", *words):
        return False
    return any(not _is_map_of_error(trial, found) for found in _sure_and_not_hidden(trial))


def has_sure_wrong_name(trial: BlindTrial) -> bool:
    """Return whether a sure name is not hidden, whatever the verdict."""
    return bool(_sure_and_not_hidden(trial))


def has_finding_of_nothing(trial: BlindTrial) -> bool:
    """Return whether a finding lists no hidden effect, whatever the verdict.

    Users read a list of effects as what the robot has.
    """
    hidden = {each.name for each in trial.hidden}
    return any(hidden.isdisjoint(found.all_names) for found in trial.effects)


def _sure_and_not_hidden(trial: BlindTrial) -> list[FoundEffect]:
    hidden = {each.name for each in trial.hidden}
    return [f for f in trial.effects if f.probability >= SURE and f.name not in hidden]


# Findings that need not be told: springs that the arm has, and its background.


def without_springs(trial: BlindTrial) -> BlindTrial:
    """Return the trial without findings of springs that the arm has."""
    springs = _true_springs(trial)
    return trial.with_effects(f for f in trial.effects if springs.isdisjoint(f.all_names))


def _true_springs(trial: BlindTrial) -> set[Name]:
    """Return the names of the springs that the arm has."""
    return {Name(SPRING, f"joint {joint}") for joint in trial.truth.flexible_joints}


def without_background(trial: BlindTrial) -> BlindTrial:
    """Return the trial without findings that describe the hidden background."""
    return trial.with_effects(
        found
        for found in trial.effects
        if not any(each.outside and _describes(found, each) for each in trial.hidden)
    )


def _describes(found: FoundEffect, hidden: HiddenEffect) -> bool:
    """Return whether a finding is named as a hidden effect may be: by its id, as a map or a line.

    A line has to have its cycles a turn.
    """
    kind = effect_class(hidden)
    if hidden.of != found.of:
        return False
    if found.id in _LINES and kind.by_angle:
        return _has_order(hidden, found)
    return found.id in (hidden.id, *kind.also_called) or (found.id == MAP and kind.by_angle)


# Maps and lines of nameless errors by a joint's angle.


def _is_map_of_error(trial: BlindTrial, found: FoundEffect) -> bool:
    """Return whether a finding is named a map or a line, of a joint with a nameless error by angle.

    A line has to have the cycles a turn of such an error.
    """
    errors = _errors_by_angle(trial, found.of)
    if found.id in _LINES:
        return any(_has_order(hidden, found) for hidden in errors)
    return found.id == MAP and bool(errors)


def _is_map_of_more_than_background(trial: BlindTrial, alternative: Name) -> bool:
    """Return whether an alternative is a map or a line of a joint with a nameless error by angle.

    The cycles of alternatives are not told, so any line may be meant. The background does not
    count: most joints have it, and any map among the alternatives would be right.
    """
    errors = _errors_by_angle(trial, alternative.of)
    return alternative.id in (MAP, LINE) and any(not hidden.outside for hidden in errors)


def _errors_by_angle(trial: BlindTrial, of: str) -> list[HiddenEffect]:
    """Return the hidden nameless errors by the angle of a joint, `joint 2`."""
    return [hidden for hidden in trial.hidden if hidden.of == of and effect_class(hidden).by_angle]


def _has_order(hidden: HiddenEffect, line: FoundEffect) -> bool:
    """Return whether one of the hidden waves has the cycles a turn that a line reports."""
    if "k" not in line.parameters:
        return False
    of_formula = effect_class(hidden).formula_numbers(hidden.parameters)[:1]
    orders = np.atleast_1d(np.array(hidden.parameters.get("orders", of_formula), float))
    return bool(np.any(np.abs(orders - line.parameters["k"].value) < _SAME_ORDER))


# Claimed probabilities, and whether the claims are true.


class Claim(NamedTuple):
    """A probability that a verdict states, and whether what it states is true."""

    # `name`, `alternative`, `none of these`, or `set`: that the smallest set of names holds what is
    # hidden
    of: str
    probability: float
    right: bool


def claims(trial: BlindTrial) -> Iterator[Claim]:
    """Yield the probabilities of each finding's name, of its alternatives, and of none."""
    true_names = _true_names(trial)
    for found in trial.effects:
        probabilities = {found.name: found.probability}
        probabilities |= {other.name: other.probability for other in found.alternatives}
        # The 95 % set may have members that are too improbable to be listed.
        names = {*probabilities, *(member.name for member in found.set95)}
        right = {name: name in true_names for name in names}
        right[found.name] |= _is_map_of_error(trial, found)
        for name in names - {found.name}:
            right[name] |= _is_map_of_more_than_background(trial, name)
        for name, probability in probabilities.items():
            of = "name" if name == found.name else "alternative"
            yield Claim(of, probability, right[name])
        none_is_right = not any(right.values())
        yield Claim("none of these", found.none_of_these, none_is_right)
        # `none of these` belongs to the set too, if it is probable enough.
        holds_none = none_is_right and found.none_of_these > 1.0 - SURE
        in_set = any(right[member.name] for member in found.set95)
        yield Claim("set", SURE, in_set or holds_none)


def _true_names(trial: BlindTrial) -> set[Name]:
    """Return the names of all that the arm has; of its background, also what it may be called."""
    names = {hidden.name for hidden in trial.hidden} | _true_springs(trial)
    for hidden in trial.hidden:
        if hidden.outside:
            names |= {Name(id, hidden.of) for id in effect_class(hidden).also_called}
    return names


# What each hidden effect was called.


def outcome(trial: BlindTrial, hidden: HiddenEffect) -> str:
    """Return what became of a hidden effect.

    Returns:
        The id that it was called: its own, or that of the first finding that lists no hidden
        effect. Else one of the outcomes above, such as LISTED. In trials of drives, a word of
        `drive_outcome`.
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
    # A finding that lists another hidden effect is no wrong name of this one.
    every = {each.name for each in trial.hidden}
    wrong_ids = [found.id for found in trial.effects if every.isdisjoint(found.all_names)]
    if wrong_ids:
        return ELSEWHERE if hidden.id in wrong_ids else wrong_ids[0]
    if trial.verdict.word == "unexplained":
        return _outcome_without_name(trial.verdict.places, hidden.of)
    return NOTHING if trial.is_testable(hidden) else NOT_TESTABLE


def _outcome_without_name(places: tuple[str | None, ...], of: str) -> str:
    """Return the outcome of an effect at a place, where something without a name sits at others."""
    if of in places:
        return RIGHT_PLACE
    return WRONG_PLACE if any(place is not None for place in places) else NO_PLACE


def drive_outcome(trial: BlindTrial, of: str) -> str:
    """Return the outcome for the drive of a joint, `joint 2`, by all that was found there.

    Returns:
        `right`: the causes named are those hidden; `ambiguous`: they share some with these;
        `wrong`: they share none; `no_cause`: a map alone; `missed`: nothing; or FAILED.
    """
    if trial.verdict is None:
        return FAILED
    drive = {_SENSOR, _GEAR}
    hidden = {each.id for each in trial.hidden if each.of == of}
    findings = [f for f in trial.effects if f.of == of and f.id in (*drive, MAP)]
    if not findings:
        return "missed"
    listed = {name for found in findings for name in found.all_names}
    causes = {name.id for name in listed if name.of == of} & drive
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

    A line that was named in place of a map is a formula, too. A line of a gear is one where it is
    right; else it is a wrong name, which counts elsewhere.
    """
    if trial.verdict is None:
        return False
    formulas = [Formula(p.form, p.of, p.numbers) for p in trial.verdict.proposed or ()]
    are_right = [any(is_right(hidden, each) for hidden in trial.hidden) for each in formulas]
    lines = [found for found in trial.effects if found.id in (_LINES if right else (LINE,))]
    are_right += [any(_is_right_line(hidden, line) for hidden in trial.hidden) for line in lines]
    return right in are_right


def _is_right_line(hidden: HiddenEffect, line: FoundEffect) -> bool:
    """Return whether a line has the place and the cycles a turn of hidden waves.

    Its cycles are estimated; those of a proposed formula are chosen among whole numbers.
    """
    is_wave = _WAVE in effect_class(hidden).forms or "orders" in hidden.parameters
    return is_wave and hidden.of == line.of and _has_order(hidden, line)


def hides_only_nameless(trial: BlindTrial) -> bool:
    """Return whether all that is hidden is outside the vocabulary, and something is."""
    return bool(trial.hidden) and not any(effect_class(each).named for each in trial.hidden)


def hides_only_named(trial: BlindTrial) -> bool:
    """Return whether all that is hidden is in the vocabulary, or nothing is hidden."""
    return all(effect_class(each).named for each in trial.hidden)
