from dataclasses import replace

import numpy as np
import pytest

from made_up_model import fitted
from made_up_parameters import solved_parameters
from made_up_poses import states_of
from pa10cal.errors import CalibrationError
from pa10cal.files.arms import load_arm
from pa10cal.options import Tolerances
from pa10cal.terms.effects.gear_line import GearLine
from pa10cal.terms.joint_spring import (
    JointSpring,
    baseline,
    nominal,
    reported_name,
    stiffness_by_solved,
)
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import base_frame, link_departures
from pa10cal.terms.weights import Weights
from pa10cal.terms.wrapped import fixed

TERMS = {
    "link departures": (link_departures(load_arm("pa10_6ce"), Tolerances()), None),
    "base frame": (base_frame(), None),
    "cubic spring": (JointSpring(3, 70.0), JointSpring(3, 70.0).solved(1.3e4, 1.5e7)),
    "linear spring": (
        JointSpring(5, 8.0, cubic=False),
        JointSpring(5, 8.0, cubic=False).solved(2.5e3, 0.0),
    ),
    "line of a gear": (
        GearLine("joint 2", 15.0, multiples=(2, 3)),
        np.array([1e-4, -5e-5, 3e-5, 2e-5, 1e-5, -4e-5, 15.1]),
    ),
}


def some_states():
    tau_Nm = np.random.default_rng(3).uniform(-80, 80, (4, 6))
    return states_of(load_arm("pa10_6ce"), poses=4, tau_Nm=tau_Nm)


@pytest.mark.parametrize("name", TERMS)
def test_derivative_and_report_equal_finite_differences(name):
    term, x = TERMS[name]
    k = len(term.parameters)
    x = np.random.default_rng(0).normal(scale=1e-3, size=k) if x is None else x
    states = some_states()
    derivative, report = term.derivative(states, x), term.report(x)
    assert term.shift(states, x).shape[1:] == (len(term.coordinates),)
    for column in range(k):
        step = np.zeros(k)
        step[column] = 1e-5 * max(abs(x[column]), 1e-6)
        difference = (term.shift(states, x + step) - term.shift(states, x - step)) / (
            2 * step[column]
        )
        np.testing.assert_allclose(
            difference, np.broadcast_to(derivative[:, :, column], difference.shape), rtol=1e-6
        )
        slope = (term.report(x + step).values - term.report(x - step).values) / (2 * step[column])
        np.testing.assert_allclose(slope, report.jacobian[:, column], rtol=1e-6, atol=1e-12)


def test_paper_has_24_link_parameters_and_6_stiffness_coefficients():
    model = baseline(load_arm("pa10_6ce"), (2, 3, 5), Tolerances())
    names = [parameter.name for parameter in model.parameters]
    assert len(names) == 30
    assert sum(name.startswith("delta_") for name in names) == 24
    assert "delta_beta_2" in names
    assert "delta_d_2" not in names  # Hayati: beta in place of d
    assert len(nominal(load_arm("pa10_6ce")).parameters) == 0


@pytest.mark.parametrize("cubic", [True, False])
def test_reported_parameters_lead_back_to_solved_ones(cubic):
    model = baseline(load_arm("pa10_6ce"), (2, 3, 5), Tolerances(), cubic=cubic)
    rng = np.random.default_rng(5)
    x = model.scale * rng.uniform(1, 50, len(model.parameters))
    for tau_ref in (None, np.full(6, 50.0)):
        # Whatever the reference torque, the same stiffness predicts the same poses.
        other = baseline(
            load_arm("pa10_6ce"), (2, 3, 5), Tolerances(), cubic=cubic, tau_ref_Nm=tau_ref
        )
        report = model.report(x)
        named = {p.name: v for p, v in zip(report.parameters, report.values, strict=True)}
        states = some_states()
        np.testing.assert_allclose(
            other.predict(states, solved_parameters(other, named)),
            model.predict(states, x),
            atol=1e-13,
        )
    report = model.report(x)
    named = {p.name: v for p, v in zip(report.parameters, report.values, strict=True)}
    np.testing.assert_allclose(solved_parameters(model, named), x, rtol=1e-12)


def test_a_flexible_joint_must_exist():
    with pytest.raises(CalibrationError, match=r"flexible_joints.*7.*1 to 6"):
        baseline(load_arm("pa10_6ce"), (2, 7), Tolerances())


def test_solved_springs_correlate_as_their_stiffness_does():
    names = ["delta_a_1", "windup_3", "cubic_share_3", "windup_10"]
    x = np.array([1e-4, 2e-3, 0.2, 1e-3])
    by_solved = stiffness_by_solved(("link", "windup", "cubic", "windup"), x)
    step = 1e-6 * x
    for column in range(4):
        moved = [x.copy(), x.copy()]
        moved[0][column] -= step[column]
        moved[1][column] += step[column]
        low, high = (
            np.concatenate(
                [
                    at[:1],
                    JointSpring(3, 1.0).report(at[1:3]).values,
                    JointSpring(10, 1.0, cubic=False).report(at[3:]).values[:1],
                ]
            )
            for at in moved
        )
        expected = (high - low) / (2.0 * step[column])
        np.testing.assert_allclose(by_solved[:, column], expected, rtol=1e-6, atol=1e-3)
    reported = ["delta_a_1", "K_lin_3", "K_cub_3", "K_lin_10"]
    assert [reported_name(name) for name in names] == reported


@pytest.mark.parametrize("robot", ["ur10", "pa10_6ce"])
def test_terms_at_fixed_parameters_predict_as_they_do_free(robot):
    model = fitted(robot, 4)
    weights = Weights(model.arm.n, (4, 9, 14), (0.5, 0.1, 0.1))
    terms = (*model.model.terms, weights)
    x = np.concatenate([model.x, [0.8, -0.1, 0.2]])
    states = states_of(model.arm)
    by_targets = np.random.default_rng(2).normal(size=(len(states), 9, 9))
    states = replace(states, seen=replace(states.seen, places_by_targets=by_targets))
    free = Model(model.model.chain, terms)
    known = Model(free.chain, tuple(fixed(t, x[free.columns_of(t)]) for t in terms))
    none = np.zeros(0)
    assert free.distortion_m(states, x).any()
    np.testing.assert_array_equal(known.predict(states, none), free.predict(states, x))
    np.testing.assert_array_equal(known.torque_Nm(states, none), free.torque_Nm(states, x))
    np.testing.assert_allclose(known.distortion_m(states, none), free.distortion_m(states, x))
    for term, same in zip(terms, known.terms, strict=True):
        for trait in ("bends", "yields", "shows_torque", "holds", "depends_on", "error_of"):
            assert getattr(same, trait) == getattr(term, trait), (term.id, trait)
