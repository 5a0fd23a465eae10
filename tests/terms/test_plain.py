"""Terms to plain data and back: equal, and refused by name where that cannot be."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from made_up_poses import context_of
from pa10cal.errors import TermError
from pa10cal.files.arms import arm_names, load_arm
from pa10cal.options import Tolerances
from pa10cal.terms.effects.gear_line import GearLine
from pa10cal.terms.effects.joint_error_map import (
    BandPrior,
    FadingPrior,
    GearError,
    JointErrorMap,
    SensorError,
)
from pa10cal.terms.effects.vocabulary import candidates, every_effect
from pa10cal.terms.joint_spring import JointSpring
from pa10cal.terms.offsets import base_frame, link_departures
from pa10cal.terms.plain import term_from_plain, term_kinds, term_to_plain

numbers = st.floats(min_value=-1e6, max_value=1e6, allow_nan=False)
positive = st.floats(min_value=1e-6, max_value=1e6)
#: Before the name of an arm of which the first joint slides.
ON_RAIL = "on a rail: "


def contexts(robot, seed):
    rng, arm = np.random.default_rng(seed), load_arm(robot.removeprefix(ON_RAIL))
    if robot.startswith(ON_RAIL):
        arm = replace(arm, prismatic=arm.prismatic | (np.arange(arm.n) == 0))
    low = rng.uniform(-3.0, 0.0, arm.n)
    return context_of(
        arm,
        reference_temperature_C=float(rng.uniform(10.0, 30.0)),
        largest_tau_Nm=rng.uniform(0.1, 200.0, arm.n),
        p_instr_middle_m=rng.uniform(-3.0, 3.0, 3),
        q_span_rad=np.column_stack([low, low + rng.uniform(0.1, 3.0, arm.n)]),
        time_span_s=(0.0, float(rng.uniform(1.0, 1e5))),
    )


def there_and_back(term):
    """Go through the text of a file: numbers come back to the last digit."""
    return term_from_plain(json.loads(json.dumps(term_to_plain(term))), where="model.yaml: terms")


@settings(deadline=None)
@given(st.sampled_from([*arm_names(), f"{ON_RAIL}ur10"]), st.integers(0, 2**32 - 1))
def test_every_effect_at_every_place_comes_back_equal(robot, seed):
    for effect in candidates(contexts(robot, seed)):
        if robot != "pa10_6ce" and effect.id == "transmission_error":
            continue  # the gear ratio is not known there, and a nan is not equal to itself
        assert there_and_back(effect) == effect
        known = effect.report(effect.starts[0]).parameters
        assert effect.formula
        assert effect.generic or all(len(parameter.name) < 8 for parameter in known)


def test_the_whole_vocabulary_was_there():
    # The second is described without masses; a joint of the third slides, of the next the first,
    # of the last both.
    arms = "pa10_6ce", "irb120", "gx4_351s", f"{ON_RAIL}pa10_6ce", f"{ON_RAIL}gx4_351s"
    found = {effect.id for arm in arms for effect in candidates(contexts(arm, 1))}
    assert found == {kind.id for kind in every_effect() if kind.role_in_search != "proposed"}
    assert found <= set(term_kinds())


def test_lines_of_gears_come_back_equal_and_say_of_multiples_where_they_have_any():
    for line in (GearLine("joint 1", 40.0), GearLine("joint 1", 40.0, multiples=(2, 3))):
        assert there_and_back(line) == line
        assert ("multiples" in term_to_plain(line)["form"]) == bool(line.multiples)


@given(st.integers(1, 12), positive, st.booleans())
def test_springs_come_back_equal(joint, tau_ref_Nm, cubic):
    spring = JointSpring(joint, tau_ref_Nm, cubic)
    assert there_and_back(spring) == spring


@given(st.integers(4, 720), positive, positive)
def test_maps_of_their_own_smoothness_come_back_equal(knots, size_rad, half_order):
    effect = JointErrorMap("joint 3", knots, FadingPrior(size_rad, half_order))
    assert there_and_back(effect) == effect


@given(st.sampled_from([SensorError, GearError]), st.tuples(*[positive] * 7))
def test_bands_come_back_equal(kind, shape):
    effect = kind("joint 3", 216, BandPrior(*shape))
    assert there_and_back(effect) == effect


@pytest.mark.parametrize("robot", arm_names())
def test_departures_and_frames_come_back_equal(robot):
    links = link_departures(load_arm(robot), Tolerances(a_m=1e-3 / 3.0))
    for offsets in (links, base_frame(), links.only({"delta_a_2", "delta_theta_3"})):
        assert there_and_back(offsets) == offsets


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"id": "transmision_error"},
            "unknown term.*transmision_error.*did you mean 'transmission_error'",
        ),
        ({"id": None}, "unknown term"),
        ({"form": {"order": "many"}}, "transmission_error of joint 2: key order.*many"),
        ({"form": {"order": None}}, "transmission_error of joint 2: key order"),
        ({"form": None}, "transmission_error of joint 2: key order is missing"),
    ],
)
def test_what_cannot_be_a_term_is_refused_by_name(change, message):
    effect = next(
        e
        for e in candidates(contexts("pa10_6ce", 3))
        if e.of == "joint 2" and e.id == "transmission_error"
    )
    with pytest.raises(TermError, match=message):
        term_from_plain(term_to_plain(effect) | change, where="model.yaml")


def test_a_missing_key_is_named():
    content = term_to_plain(JointSpring(2, 60.0))
    del content["form"]["tau_ref_Nm"]
    with pytest.raises(
        TermError, match=r"model\.yaml: joint_spring of joint 2: key tau_ref_Nm is missing"
    ):
        term_from_plain(content, where="model.yaml")
    assert replace(JointSpring(2, 60.0), cubic=False) != JointSpring(2, 60.0)
