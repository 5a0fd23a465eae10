import re
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from pa10cal.discovery.finding import Finding
from pa10cal.discovery.refitted_verdict import unfit
from pa10cal.files.arms import load_arm
from pa10cal.terms import effects
from pa10cal.terms.effects.effect import AtJoint, Effect
from pa10cal.terms.effects.joint import most_wound_up
from pa10cal.terms.effects.vocabulary import candidates, every_effect
from pa10cal.terms.statement_faults import FAULTS
from pa10cal.terms.term import shows_torque, yields
from pa10cal.terms.wording import clause_of, driver_of, noun_of

ARM = load_arm("pa10_6ce")
JOINTS = tuple(f"joint {joint}" for joint in range(1, 7))
#: Effects of the contract: where each may sit on the PA10 with springs at joints 2, 3 and 5. What
#: was added to the vocabulary since is held by the laws alone.
VOCABULARY = {
    "transmission_error": (JOINTS, ["A", "phi"]),
    "encoder_eccentricity": (JOINTS, ["A", "phi"]),
    "encoder_ellipticity": (JOINTS, ["A", "phi"]),
    "joint_error_map": (JOINTS, [f"knot_{k:02d}" for k in range(12)]),
    "gear_ratio_error": (JOINTS, ["eps"]),
    "backlash": (JOINTS, ["b"]),
    "friction_torque": (JOINTS, ["tau_c"]),
    "torque_gain": (JOINTS, ["g"]),
    "joint_compliance": (("joint 1", "joint 4", "joint 6"), ["K"]),
    "soft_windup": (JOINTS, ["A", "tau0"]),
    "joint_coupling": (("joint 3", "joint 5", "joint 6"), ["c"]),
    "wrist_coupling": (("wrist",), ["c"]),
    "link_bending": (("upper_arm", "forearm"), ["c"]),
    "link_torsion": (("forearm",), ["c"]),
    "base_compliance": (("base",), ["cx", "cy"]),
    "base_drift": (("base",), ["rate_x", "rate_y", "rate_z"]),
    "thermal_growth": (("arm",), ["alpha"]),
    "link_growth": (("upper_arm", "forearm"), ["alpha"]),
    "tool_sag": (("tool",), ["c"]),
    "cmm_scale": (("instrument",), ["s_x", "s_y", "s_z"]),
    "cmm_squareness": (("instrument",), ["xy"]),
}
UNNAMED = {
    "place_map": ("instrument",),
    "torque_map": JOINTS,
    "windup_map": JOINTS,
    "direction_map": JOINTS,
    "drift_map": ("base",),
}
#: Named effects whose parameters have a sign by physics: things give way, rub, lag and grow.
ONE_SIGN = {
    "backlash",
    "base_compliance",
    "friction_torque",
    "joint_compliance",
    "lateral_compliance",
    "link_bending",
    "link_growth",
    "link_torsion",
    "link_warm_up",
    "lost_motion",
    "slide_bending",
    "soft_windup",
    "thermal_growth",
    "tool_sag",
}
#: Those of either sign: amplitudes have a phase, errors of ratios, scales and reading any sign, a
#: controller stops short or beyond, and a base drifts any way.
EITHER_SIGN = {
    "along_move",
    "arrival_error",
    "axis_wobble",
    "balancer",
    "base_drift",
    "cmm_scale",
    "cmm_squareness",
    "depth_scale",
    "encoder_eccentricity",
    "encoder_ellipticity",
    "gear_error",
    "gear_line",
    "gear_ratio_error",
    "joint_coupling",
    "joint_error_map",
    "periodic_error",
    "range_constant",
    "scale",
    "move_settling",
    "sensor_error",
    "slide_error",
    "slide_positioning",
    "slide_scale",
    "torque_gain",
    "transmission_error",
    "warm_up",
    "wrist_coupling",
}
PAGE = Path(__file__).parents[3] / "docs/discovery-details.md"


def test_holds_the_vocabulary_and_its_rivals():
    named = {kind.id for kind in every_effect() if not kind.generic}
    assert named >= set(VOCABULARY)
    unnamed = [kind for kind in every_effect() if kind.generic]
    assert {kind.id for kind in unnamed if kind.role_in_search == "candidate"} == set(UNNAMED)
    assert {kind.id for kind in unnamed if kind.role_in_search == "proposed"} == {"arrival_map"}
    generic = [kind.generic for kind in every_effect()]
    assert generic == sorted(generic)


def test_every_effect_states_where_it_sits():
    assert not [kind.id for kind in every_effect() if not getattr(kind, "sits", "")]


def test_every_effect_sits_where_it_may_and_reports_what_readers_know(context):
    places = {name: places for name, (places, _) in VOCABULARY.items()} | UNNAMED
    found = candidates(context)
    assert {name: tuple(e.of for e in found if e.id == name) for name in places} == places
    for effect in found:
        if not effect.generic:
            names = [p.name for p in effect.report(effect.starts[0]).parameters]
            assert names == VOCABULARY.get(effect.id, (None, names))[1]


@pytest.mark.parametrize("kind", [*every_effect(), *FAULTS], ids=lambda kind: kind.id)
def test_every_name_says_what_the_effect_does_at_one_joint_and_at_several(kind):
    at_joints = issubclass(kind, AtJoint) and not kind.generic
    assert (kind.clauses is Effect.clauses) == kind.generic
    assert len(kind.clauses) == (2 if at_joints else 1)
    for many, at in ((False, "joint 2"), (True, "joints 2 and 3")):
        told = clause_of(kind.id, at, many=many)
        assert not re.search(r"[{}_]|[. ]$", told)
        assert at in told or not at_joints
        assert noun_of(kind.id, many=many)
        assert driver_of(kind.id, many=many)


@pytest.mark.parametrize(
    ("middle_m", "three_axes", "there"),
    [((0.3, 0.2, 1.2), False, True), ((2.0, 0.0, 0.5), False, False), ((0, 0, 1), True, False)],
)
def test_a_scale_in_depth_is_of_an_instrument_that_looks_at_the_arm(
    context, middle_m, three_axes, there
):
    seen = replace(context, three_axes=three_axes, p_instr_middle_m=np.array(middle_m))
    assert any(each.id == "depth_scale" for each in candidates(seen)) == there


@pytest.mark.parametrize(("three_axes", "named"), [(True, {"cmm_scale"}), (False, {"scale"})])
def test_a_scale_is_one_number_but_of_a_machine_with_three_axes(context, three_axes, named):
    known = {each.id for each in candidates(replace(context, three_axes=three_axes))}
    assert known & {"cmm_scale", "scale"} == named


def test_beams_have_a_constant_where_they_come_from_outside_of_the_arm(context):
    reach_m = context.arm.reach_m
    for three_axes, away_m, there in ((False, 2.0, True), (False, 0.5, False), (True, 2.0, False)):
        middle_m = np.array([0.0, away_m * reach_m, 0.0])
        known = candidates(replace(context, three_axes=three_axes, p_instr_middle_m=middle_m))
        assert any(each.id == "range_constant" for each in known) == there


@pytest.mark.slow
def test_every_effect_has_decided_its_sign_and_the_gate_holds_it(context):
    """A new class of the folder is in one of the two lists, and a wrong sign is no name."""
    named = {kind.id: kind for kind in every_effect() if not kind.generic}
    assert set(named) == ONE_SIGN | EITHER_SIGN
    assert not ONE_SIGN & EITHER_SIGN
    for kind in named.values():
        near = replace(context, commanded=True)
        far = replace(near, three_axes=False, p_instr_middle_m=np.array([0.0, 9.0, 0.0]))
        sliding = replace(near, arm=replace(context.arm, prismatic=np.arange(6) < 2))
        wide = replace(near, q_span_rad=np.tile([-2.0, 2.0], (6, 1)))
        effect = next(e for known in (near, far, sliding, wide) for e in kind.everywhere(known))
        assert effect.limits.positive == (effect.id in ONE_SIGN)
        plausible = np.array([each.plausible for each in effect.parameters[: effect.linear]])
        for k in range(effect.linear):
            for sign in (1.0, -1.0):
                x = np.concatenate([plausible, np.ones(len(effect.parameters) - effect.linear)])
                x[k] *= sign
                finding = Finding(effect, *_reported(effect, x), (), None)
                refused = any("not physical" in why for why in unfit(finding, _amounts(x)))
                assert refused == (sign < 0.0 and effect.id in ONE_SIGN), (effect.id, k, sign)


@pytest.mark.parametrize(
    ("alpha", "std", "refused"),
    [
        (1.2e-5, 1e-7, False),
        (7.5e-5, 1e-6, True),
        (7.5e-5, 4e-5, False),
        (2e-6, 1e-7, False),
        (2.9e-5, 2e-6, False),
    ],
)
def test_arms_grow_as_what_they_are_made_of(context, alpha, std, refused):
    (growth,) = (each for each in candidates(context) if each.id == "thermal_growth")
    amounts = _amounts(np.array([alpha]), np.array([[std**2]]))
    finding = Finding(growth, *_reported(growth, np.array([alpha])), (), None)
    assert any("light metal" in why for why in unfit(finding, amounts)) == refused


def _amounts(x, covariance=None):
    """Return a model that has these parameters alone."""
    return SimpleNamespace(
        arm=ARM,
        values_of=lambda _: x,
        model=SimpleNamespace(columns_of=lambda _: slice(0, len(x)), u_scale=0.0),
        covariance=covariance,
    )


@pytest.mark.parametrize(
    ("b", "std", "refused"),
    [(3e-4, 1e-5, False), (6e-3, 1e-4, False), (1.2e-2, 1e-4, True), (1.2e-2, 2e-3, False)],
)
def test_play_is_that_of_gears_and_not_some_times_what_is_usual(context, b, std, refused):
    lost = next(each for each in candidates(context) if each.id == "backlash")
    finding = Finding(lost, *_reported(lost, np.array([b])), (), None)
    reasons = list(unfit(finding, _amounts(np.array([b]), np.array([[std**2]]))))
    assert bool(reasons) == refused
    assert all("1 deg of play" in why for why in reasons)


@pytest.mark.parametrize(
    ("name", "of", "most_rad"),
    [
        ("joint_compliance", "joint 4", 0.05),
        ("soft_windup", "joint 2", 0.05),
        ("link_torsion", "forearm", 0.01),
        ("link_bending", "upper_arm", 0.01),
    ],
)
@pytest.mark.parametrize(("part", "std", "refused"), [(0.9, 0.0, 0), (1.1, 0.0, 1), (1.1, 0.2, 0)])
def test_nothing_gives_way_farther_than_arms_do(
    context, states, name, of, most_rad, part, std, refused
):
    (effect,) = (e for e in candidates(context) if (e.id, e.of) == (name, of))
    x = effect.starts[-1].copy()
    x[0] = 1e-9
    x[0] *= part * most_rad / np.abs(effect.rotations(states, x)[0]).max()
    model = _amounts(x, np.diag((std * x) ** 2))
    finding = Finding(effect, *_reported(effect, x), (), None)
    reasons = [why for why in unfit(finding, model, states) if "mrad" in why]
    assert len(reasons) == refused
    assert all(f"more than {1e3 * most_rad:.0f} mrad" in why for why in reasons)


@pytest.mark.parametrize(
    ("reach_m", "commanded", "most_rad"),
    [
        (1.8, False, 0.05),
        (1.0, False, 0.05),
        (0.5, False, 0.1),
        (0.1, False, 0.2),
        (1.8, True, 0.2),
    ],
)
def test_joints_of_short_arms_and_of_servos_give_way_farther(reach_m, commanded, most_rad):
    found, why = most_wound_up(reach_m, commanded=commanded)
    assert found == pytest.approx(most_rad)
    assert f"more than {1e3 * most_rad:.0f} mrad" in why


def _reported(effect, x):
    values = effect.report(x).values
    return values, np.eye(len(values))


def test_parameters_are_told_apart(context):
    names = [p.name for effect in candidates(context) for p in effect.parameters]
    assert len(names) == len(set(names)) > 200


def test_terms_are_what_the_model_takes_them_for(context):
    found = candidates(context)
    known = [effect for effect in found if effect.id in VOCABULARY.keys() | UNNAMED.keys()]
    assert {e.id for e in known if yields(e)} == {
        "direction_map",
        "joint_compliance",
        "soft_windup",
        "windup_map",
    }
    carried = {e.id: e.acts_on_joint for e in known if shows_torque(e)}
    assert carried == {"friction_torque": False, "torque_gain": False, "torque_map": True}


def test_where_nothing_can_show_nothing_is_tried(context):
    slides = np.array([False, False, False, False, True, False])
    found = candidates(
        replace(
            context,
            arm=replace(context.arm, prismatic=slides),
            largest_tau_Nm=np.array([50.0, 0.0, np.nan, 0.1, 5.0, 0.2]),
            q_span_rad=np.tile([0.3, 0.3], (6, 1)),
            time_span_s=(7.0, 7.0),
        )
    )
    # Where a joint slides its rack or screw may have another pitch, and nothing of a turn.
    assert {effect.id for effect in found if effect.of == "joint 5"} == {"gear_ratio_error"}
    assert [e.of for e in found if e.id == "soft_windup"] == ["joint 1", "joint 6"]
    assert [e.of for e in found if e.id == "windup_map"] == ["joint 1", "joint 6"]
    assert not {"wrist_coupling", "torque_map", "drift_map"} & {effect.id for effect in found}


@pytest.fixture
def fresh_family():
    every_effect.cache_clear()
    yield
    every_effect.cache_clear()
    sys.modules.pop(f"{effects.__name__}.third_harmonic", None)
    vars(effects).pop("third_harmonic", None)


@pytest.mark.usefixtures("fresh_family")
def test_the_class_in_the_docs_is_a_new_effect(tmp_path, monkeypatch, context):
    (text,) = re.findall(r"^```python\n(.*?)^```", PAGE.read_text("utf-8"), re.M | re.S)
    (tmp_path / "third_harmonic.py").write_text(text)
    before = {kind.id for kind in every_effect()}
    every_effect.cache_clear()
    monkeypatch.setattr(effects, "__path__", [*effects.__path__, str(tmp_path)])
    assert {kind.id for kind in every_effect()} == before | {"third_harmonic"}
    found = [e for e in candidates(context) if e.id == "third_harmonic"]
    assert [e.of for e in found] == list(JOINTS)
    assert found[1].parameters[0].name == "third_harmonic_2_s"
    assert found[1].formula == "theta_2 += s sin(3 q_2) + c cos(3 q_2)"
