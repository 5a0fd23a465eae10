"""Formulas against what was hidden: right of form, order and place, or not."""

import numpy as np
import pytest

import made_up_trials
from pa10cal.lab.blind_trial import OUTSIDE_FORMS, Formula, is_right
from pa10cal.lab.cell.effects.vocabulary import nameless
from pa10cal.results.record import Name


def hidden(name, of, **parameters):
    return made_up_trials.hidden(Name(name, of), **parameters)


def trial(kind, what, *proposed, failed=False, effects=()):
    said = made_up_trials.verdict(
        *effects,
        word="unexplained",
        places=("joint 2",) if not effects else (),
        proposed=[(each.form, each.of, *each.numbers) for each in proposed],
    )
    return made_up_trials.trial(kind, what, None if failed else said, springs=())


OUTSIDE = "effect outside the vocabulary"
NAMELESS = f"{OUTSIDE}, found without a name: its formula proposed"
THIRD = hidden("third_harmonic", "joint 2", A=1e-4, phi=0.3)
RIGHT = Formula("harmonic", "joint 2", (3.0,))


@pytest.mark.parametrize(
    ("what", "formula", "right"),
    [
        (THIRD, RIGHT, True),
        (THIRD, Formula("harmonic", "joint 2", (4.0,)), False),
        (THIRD, Formula("harmonic", "joint 3", (3.0,)), False),
        (THIRD, Formula("sawtooth", "joint 2", (3.0, 0.1)), False),
        (
            hidden("bowed_axis", "instrument", axis=0, along=2, sag=1.0),
            Formula("cubic", "instrument", (0, 2)),
            True,
        ),
        (
            hidden("bowed_axis", "instrument", axis=0, along=2, sag=1.0),
            Formula("quadratic", "instrument", (2, 0)),
            False,
        ),
        (
            hidden("sawtooth", "joint 1", sector=float(np.radians(24.0))),
            Formula("sawtooth", "joint 1", (15.0, 0.02)),
            True,
        ),
        (
            hidden("soft_by_angle", "joint 4", cycles=2.0),
            Formula("torque_by_angle", "joint 4", (1.0,)),
            False,
        ),
        (hidden("dress_pack", "joint 4"), Formula("pull", "joint 4"), True),
        (hidden("hysteresis", "joint 4"), Formula("arrival_by_torque_squared", "joint 4"), False),
        (hidden("pedestal_tilt", "base"), Formula("moment_cubed", "base"), True),
        (hidden("backlash", "joint 4"), Formula("harmonic", "joint 4", (3.0,)), False),
    ],
)
def test_form_order_and_place_must_be_those_hidden(what, formula, right):
    assert is_right(what, formula) is right


def test_shares_are_of_what_no_name_covers_and_of_the_rest():
    found = made_up_trials.figures(
        [
            trial("outside", (THIRD,), RIGHT),
            trial("outside", (THIRD,), Formula("harmonic", "joint 2", (2.0,))),
            trial("outside", (THIRD,)),
            trial("outside", (THIRD,), failed=True),
            trial("null", ()),
            trial("single", (hidden("backlash", "joint 2"),), RIGHT),
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


def test_a_map_counts_as_something_without_a_name():
    of_map = made_up_trials.named(Name("joint_error_map", "joint 2"))
    found = made_up_trials.figures([trial("outside", (THIRD,), RIGHT, effects=(of_map,))])
    assert found[NAMELESS].trials == 1


def test_every_effect_that_no_name_covers_has_its_formula():
    assert set(OUTSIDE_FORMS) == set(nameless())
