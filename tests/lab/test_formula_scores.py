"""Formulas that are proposed for what no name covers: right of form, order and place, or not."""

import numpy as np
import pytest

import made_up_trials
from made_up_trials import figures, hidden, named, trial, verdict
from pa10cal.results.record import Name
from pa10cal_lab import trial_names
from pa10cal_lab.cell.effects.vocabulary import nameless
from pa10cal_lab.trial_names import Formula, is_right

OUTSIDE = "effect outside the vocabulary"
NAMELESS = f"{OUTSIDE}, found without a name: its formula proposed"
HIDDEN_THIRD = hidden(Name("third_harmonic", "joint 2"), A=1e-4, phi=0.3)
RIGHT = Formula("harmonic", "joint 2", (3.0,))


def formulas(kind, what, *proposed, failed=False, effects=()):
    said = made_up_trials.verdict(
        *effects,
        word="unexplained",
        places=("joint 2",) if not effects else (),
        proposed=[(each.form, each.of, *each.numbers) for each in proposed],
    )
    return made_up_trials.trial(kind, what, None if failed else said, springs=())


@pytest.mark.parametrize(
    ("what", "formula", "right"),
    [
        (HIDDEN_THIRD, RIGHT, True),
        (HIDDEN_THIRD, Formula("harmonic", "joint 2", (4.0,)), False),
        (HIDDEN_THIRD, Formula("harmonic", "joint 3", (3.0,)), False),
        (HIDDEN_THIRD, Formula("sawtooth", "joint 2", (3.0, 0.1)), False),
        (
            hidden(Name("bowed_axis", "instrument"), axis=0, along=2, sag=1.0),
            Formula("cubic", "instrument", (0, 2)),
            True,
        ),
        (
            hidden(Name("bowed_axis", "instrument"), axis=0, along=2, sag=1.0),
            Formula("quadratic", "instrument", (2, 0)),
            False,
        ),
        (
            hidden(Name("sawtooth", "joint 1"), sector=float(np.radians(24.0))),
            Formula("sawtooth", "joint 1", (15.0, 0.02)),
            True,
        ),
        (
            hidden(Name("soft_by_angle", "joint 4"), cycles=2.0),
            Formula("torque_by_angle", "joint 4", (1.0,)),
            False,
        ),
        (hidden(Name("dress_pack", "joint 4")), Formula("pull", "joint 4"), True),
        (
            hidden(Name("hysteresis", "joint 4")),
            Formula("arrival_by_torque_squared", "joint 4"),
            False,
        ),
        (hidden(Name("pedestal_tilt", "base")), Formula("moment_cubed", "base"), True),
        (hidden(Name("backlash", "joint 4")), Formula("harmonic", "joint 4", (3.0,)), False),
    ],
)
def test_form_order_and_place_must_be_those_hidden(what, formula, right):
    assert is_right(what, formula) is right


def test_shares_are_of_what_no_name_covers_and_of_the_rest():
    found = figures(
        [
            formulas("outside", (HIDDEN_THIRD,), RIGHT),
            formulas("outside", (HIDDEN_THIRD,), Formula("harmonic", "joint 2", (2.0,))),
            formulas("outside", (HIDDEN_THIRD,)),
            formulas("outside", (HIDDEN_THIRD,), failed=True),
            formulas("null", ()),
            formulas("single", (hidden(Name("backlash", "joint 2")),), RIGHT),
        ]
    )
    for what, count, of, met in (
        (f"{OUTSIDE}: its formula proposed, form and order", 1, 4, False),
        (f"{OUTSIDE}: another formula proposed", 1, 4, False),
        ("nothing outside the vocabulary: a formula proposed that is not hidden", 1, 2, False),
        (NAMELESS, 1, 3, None),
        (f"{OUTSIDE}: its formula proposed | third_harmonic", 1, 4, None),
    ):
        assert (found[what].count, found[what].trials, found[what].met) == (count, of, met), what


@pytest.mark.parametrize(
    ("what", "cycles", "right"),
    [
        (HIDDEN_THIRD, 3.02, True),
        (HIDDEN_THIRD, 7.0, False),
        (HIDDEN_THIRD, None, False),
        (hidden(Name("small_waves", "joint 2"), outside=True, orders=[0.4, 61.0]), 61.0, True),
        (hidden(Name("small_waves", "joint 2"), outside=True, orders=[0.4, 61.0]), None, False),
        (hidden(Name("backlash", "joint 2")), 3.0, False),
    ],
)
def test_a_line_is_a_right_formula_by_its_cycles(what, cycles, right):
    estimates = {} if cycles is None else {"k": (cycles, 0.1)}
    case = trial("mixed", (what,), verdict(named(Name("periodic_error", "joint 2"), **estimates)))
    assert trial_names.proposes(case, right=right)
    assert not trial_names.proposes(case, right=not right)


@pytest.mark.parametrize(("cycles", "right"), [(3.02, True), (7.0, False)])
def test_a_line_of_a_gear_is_a_right_formula_or_none(cycles, right):
    line = named(Name("gear_line", "joint 2"), k=(cycles, 0.1))
    case = trial("outside", (HIDDEN_THIRD,), verdict(line))
    assert trial_names.proposes(case, right=True) is right
    assert not trial_names.proposes(case, right=False)


def test_a_trial_with_anything_nameless_is_none_with_nothing_outside():
    waves = hidden(Name("small_waves", "joint 2"), outside=True, orders=[2.4])
    backlash = hidden(Name("backlash", "joint 3"))
    for what, nameless_alone, named_alone in (
        ((waves,), True, False),
        ((waves, backlash), False, False),
        ((backlash,), False, True),
        ((), False, True),
    ):
        case = trial("mixed", what, verdict())
        assert trial_names.hides_only_nameless(case) == nameless_alone
        assert trial_names.hides_only_named(case) == named_alone


def test_a_map_counts_as_something_without_a_name():
    of_map = named(Name("joint_error_map", "joint 2"))
    found = figures([formulas("outside", (HIDDEN_THIRD,), RIGHT, effects=(of_map,))])
    assert found[NAMELESS].trials == 1


def test_every_effect_that_no_name_covers_has_its_formula():
    assert all(each.forms for each in nameless().values())
