"""Short forms: what they add, how they are reported, and which are tried where."""

from dataclasses import replace

import numpy as np
import pytest

from made_up_poses import context_of, states_of
from pa10cal.files.arms import load_arm
from pa10cal.terms.forms.catalogue import forms_at, further
from pa10cal.terms.forms.form import AngleForm, ReadingForm

POSES = 40


@pytest.fixture(scope="module")
def states():
    states = states_of(load_arm("pa10_6ce"), 3, POSES)
    q_rad = 4.0 / 3.0 * states.q_rad
    q_rad[:, 1] = np.random.default_rng(3).permutation(np.linspace(-3.0, 3.0, POSES))
    return replace(states, q_rad=q_rad, time_s=1e9 + states.time_s)


@pytest.fixture(scope="module")
def context(states):
    return context_of(
        load_arm("pa10_6ce"),
        largest_tau_Nm=np.abs(states.tau_Nm).max(0),
        q_span_rad=np.stack([states.q_rad.min(0), states.q_rad.max(0)], axis=-1),
        time_span_s=(float(states.time_s[0]), float(states.time_s[-1])),
    )


@pytest.fixture(scope="module")
def kinds(states, context):
    """Return one form of every kind that is tried anywhere."""
    forms = [
        form
        for place in ("joint 2", "base", "instrument")
        for form in forms_at(place, context, states)
    ]
    forms += further(forms, states)
    return list({(type(form), form.form): form for form in forms}.values())


def test_each_is_a_formula_with_its_parameters(kinds):
    assert len(kinds) > 30
    for form in kinds:
        text = form.formula
        assert "{" not in text
        assert "=" in text
        assert form.length >= len(form.parameters) >= 1
        for parameter in form.report(np.ones(len(form.parameters))).parameters:
            assert parameter.name in text, (text, parameter.name)


def test_each_moves_the_pose_or_the_torques_by_finite_amounts(kinds, states):
    for form in kinds:
        zero = np.zeros(len(form.parameters))
        if form.coordinates:
            found = form.derivative(states, zero)
            assert found.shape == (POSES, len(form.coordinates), len(zero))
        else:
            found = form.torque_derivative(states, zero)
            assert found.shape == (POSES, 6, len(zero))
            assert not np.delete(found, form.joint - 1, axis=1).any()
        assert np.isfinite(found).all(), form.formula
        assert found.any(), form.formula


def test_reported_parameters_have_exact_derivatives(kinds):
    for form in kinds:
        sizes = np.array([parameter.plausible for parameter in form.parameters])
        x = sizes * np.linspace(0.7, 1.3, len(sizes))
        report = form.report(x)
        for k, size in enumerate(sizes):
            step = 1e-6 * size * np.eye(len(sizes))[k]
            by_difference = (form.report(x + step).values - form.report(x - step).values) / (
                2e-6 * size
            )
            np.testing.assert_allclose(
                report.jacobian[:, k] * size, by_difference * size, rtol=1e-6, atol=1e-12
            )


def test_the_formula_is_what_the_form_adds(states):
    q, tau, s = states.q_rad[:, 1], states.tau_Nm[:, 1], states.arrival[:, 1]

    def added(form, numbers, x):
        return AngleForm("joint 2", form, numbers).shift(states, np.array(x))[:, 0]

    np.testing.assert_allclose(
        added("harmonic", (3.0,), [np.cos(0.4), np.sin(0.4)]), np.sin(3.0 * q + 0.4)
    )
    np.testing.assert_allclose(added("arrival_by_torque", (), [2.0]), 2.0 * s * np.abs(tau))
    np.testing.assert_allclose(added("torque_cubed", (), [2.0]), -2.0 * tau**3)
    turns = 15.0 * q / (2.0 * np.pi) - 0.3
    np.testing.assert_allclose(added("sawtooth", (15.0, 0.3), [1.0]), 2.0 * (turns % 1.0) - 1.0)
    orders = [AngleForm("joint 2", "harmonic", (k,)) for k in (3.0, 5.0)]
    *_, other = further(orders, states)
    np.testing.assert_allclose(
        other.shift(states, np.array([1.0, 0.0, 0.0, 2.0]))[:, 0],
        np.sin(3.0 * q) + 2.0 * np.cos(5.0 * q),
    )


def test_two_orders_are_tried_of_a_joint_seen_all_around(states):
    orders = [AngleForm("joint 2", "harmonic", (k,)) for k in (3.0, 5.0)]
    part = replace(states, q_rad=0.5 * states.q_rad)
    for seen, tried in ((states, True), (part, False)):
        kinds = {form.form for form in further(orders, seen)}
        assert kinds >= {"sawtooth", "square"}
        assert ("two_harmonics" in kinds) is tried


def test_formulas_are_written_as_a_reader_writes_them():
    assert AngleForm("joint 2", "harmonic", (1.0,)).formula == "theta_2 += A sin(q_2 + phi)"
    bow = ReadingForm("instrument", "cubic", (2.0, 1.0), (0.4, -0.1671, 0.6))
    assert bow.formula == "reading of z += c3 u^3 + c2 u^2 + c1 u, u = y + 0.1671 m"
    twist = ReadingForm("instrument", "product", (0, 1, 2), (0.4, 0.5, 0.6))
    assert twist.formula == "reading of x += c (y - 0.5 m) (z - 0.6 m)"


def test_a_parabola_without_curvature_is_reported_without_a_warning():
    flat = ReadingForm("instrument", "quadratic", (2.0, 2.0), (0.0, 0.0, 1.0))
    for x in ([0.0, 0.0], [0.0, 3e-3]):
        told = flat.report(np.array(x))
        assert np.isfinite(told.values).all()
        assert np.isfinite(told.jacobian).all()


def test_nothing_is_tried_that_was_not_logged_or_has_no_place(states, context):
    blind = replace(states, arrival=np.zeros_like(states.arrival), seen=None, static_loads=None)
    assert not any(form.form.startswith("arrival") for form in forms_at("joint 2", context, blind))
    assert forms_at("instrument", context, blind) == ()
    assert not any(form.form.startswith("moment") for form in forms_at("base", context, blind))
    assert forms_at("forearm", context, states) == ()


def test_forms_of_time_are_not_tried_where_the_order_gives_no_time(states, context):
    untimed = replace(states, timed=np.zeros(POSES, dtype=bool))
    in_time = {"settling", "wave_in_time"}
    for place in ("joint 2", "base"):
        assert in_time & {form.form for form in forms_at(place, context, states)}
        assert not in_time & {form.form for form in forms_at(place, context, untimed)}


def test_no_wave_is_tried_along_an_axis_on_which_nothing_was_measured(states, context):
    """An arm that moves its target in a plane."""
    p_m = states.seen.p_instr_targets_m.copy()
    p_m[..., 2] = 0.3
    flat = replace(states, seen=replace(states.seen, p_instr_targets_m=p_m))
    forms = forms_at("instrument", context, flat)
    assert any(form.form == "wave" for form in forms)
    assert all(
        np.isfinite(form.derivative(flat, np.zeros(len(form.parameters)))).all() for form in forms
    )
