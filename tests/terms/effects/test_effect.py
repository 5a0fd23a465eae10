"""Laws that every effect keeps at every place."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pa10cal.arm.chain import Chain
from pa10cal.errors import CalibrationError
from pa10cal.options import Tolerances
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.joint_spring import JointSpring, baseline
from pa10cal.terms.model import DerivativeCache, Model
from pa10cal.terms.term import TermParameter, shows_torque, yields

#: Effects known to need the moments of the weights, or where the targets were.
BENT = {"link_bending", "link_torsion", "base_compliance", "slide_bending", "tool_sag"}
READ = {"cmm_scale", "cmm_squareness", "place_map", "scale"}


def amount(effect):
    """Some amount of the effect, within its bounds."""
    x = effect.starts[-1].copy()
    sizes = [parameter.plausible for parameter in effect.parameters[: effect.linear]]
    x[: effect.linear] += np.random.default_rng(1).uniform(0.5, 1.5, effect.linear) * sizes
    return x


def slopes(function, x, steps):
    """Central differences of a function of x (k,), stacked last."""
    return np.stack(
        [
            (function(x + step * unit) - function(x - step * unit)) / (2.0 * step)
            for step, unit in zip(steps, np.eye(len(x)), strict=True)
        ],
        axis=-1,
    )


def assert_close(found, expected, rtol=1e-6):
    """Equal column by column, to a part of the column's largest entry."""
    assert found.shape == expected.shape
    for column in range(found.shape[-1]):
        size = np.abs(expected[..., column]).max(initial=0.0)
        np.testing.assert_allclose(
            found[..., column], expected[..., column], rtol=0.0, atol=rtol * size
        )


def test_derivatives_equal_finite_differences(effect, states):
    x = amount(effect)
    steps = 1e-3 * np.abs(x)
    shift = slopes(lambda at: effect.shift(states, at), x, steps)
    assert effect.shift(states, x).shape == (len(states), len(effect.coordinates))
    assert_close(effect.derivative(states, x), shift)
    moves = np.any(shift)
    if shows_torque(effect):
        torque = slopes(lambda at: effect.torque_Nm(states, at), x, steps)
        assert effect.torque_Nm(states, x).shape == states.tau_Nm.shape
        assert_close(effect.torque_derivative(states, x), torque)
        moves = np.any(torque)
    assert moves
    if yields(effect):
        assert effect.coordinates == (f"theta_{effect.joint}",)

        def under(more_Nm):
            return effect.shift(replace(states, tau_Nm=states.tau_Nm + more_Nm[0]), x)[:, 0]

        assert_close(effect.by_torque(states, x)[:, None], slopes(under, np.zeros(1), [1e-4]))


def test_report_jacobian_equals_finite_differences(effect):
    x = amount(effect)
    report = effect.report(x)
    assert len(report.parameters) == len(report.values)
    assert_close(report.jacobian, slopes(lambda at: effect.report(at).values, x, 1e-5 * np.abs(x)))
    assert np.isfinite(effect.report(effect.starts[0]).jacobian).all()


def test_is_absent_at_its_starts_and_proportional_to_its_linear_parameters(effect, states):
    for start in effect.starts:
        assert not effect.shift(states, start).any()
        if shows_torque(effect):
            assert not effect.torque_Nm(states, start).any()
    once = amount(effect)
    twice = once * np.where(np.arange(len(once)) < effect.linear, 2.0, 1.0)
    np.testing.assert_allclose(
        effect.shift(states, twice), 2.0 * effect.shift(states, once), rtol=1e-12
    )
    if shows_torque(effect):
        np.testing.assert_allclose(
            effect.torque_Nm(states, twice), 2.0 * effect.torque_Nm(states, once), rtol=1e-12
        )


def test_starts_lie_within_the_bounds(effect):
    assert len({tuple(start) for start in effect.starts}) == len(effect.starts) > 0
    for start in effect.starts:
        assert len(start) == len(effect.parameters)
        for value, parameter in zip(start, effect.parameters, strict=True):
            assert parameter.lower is None or parameter.lower <= value
            assert parameter.upper is None or value <= parameter.upper


def test_expects_the_plausible_sizes(effect):
    factor = effect.prior_factor
    plausible = [parameter.plausible for parameter in effect.parameters[: effect.linear]]
    assert factor.shape == (effect.linear, effect.linear)
    covariance = factor @ factor.T
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), plausible, rtol=1e-5)
    correlation = covariance / np.outer(plausible, plausible)
    assert np.linalg.eigvalsh(correlation).min() > 1e-7


@pytest.mark.slow_but_one_in(9)
def test_a_whole_model_knows_its_derivative(effect, arm, states, at):
    """With the springs of the paper, and friction and gain at every joint."""
    plain = baseline(arm, (2, 3, 5), Tolerances())
    false = [
        at(name, f"joint {j}")
        for j in np.flatnonzero(~arm.prismatic) + 1
        for name in ("friction_torque", "torque_gain")
    ]
    chain = Chain.of(arm, bends=tuple(range(1, arm.n)))
    model = Model(chain, (*plain.terms, *false, effect))
    x = np.concatenate(
        [
            *(
                term.solved(2e4, 3e7) if isinstance(term, JointSpring) else term_zeros(term)
                for term in plain.terms
            ),
            *(0.3 * amount(term) for term in false),
            amount(effect),
        ]
    )
    found = model.predict_with_jacobian(states, x)
    np.testing.assert_allclose(found.T_base_ee, model.predict(states, x), atol=1e-15)
    known = len(plain.parameters)

    def moved(tail):
        T = model.predict(states, np.concatenate([x[:known], tail]))
        turn = Rotation.from_matrix(T[:, :3, :3] @ np.swapaxes(found.T_base_ee[:, :3, :3], 1, 2))
        return np.hstack([T[:, :3, 3], turn.as_rotvec()])

    tail = x[known:]
    assert_close(found.jacobian[:, :, known:], slopes(moved, tail, 1e-3 * np.abs(tail)), rtol=1e-5)
    names = [parameter.name for parameter in model.parameters]
    assert len(set(names)) == len(names) - (len(effect.parameters) if effect in false else 0)


def term_zeros(term):
    return np.zeros(len(term.parameters))


def test_says_what_it_misses(effect, states):
    x = amount(effect)
    bare = replace(states, static_loads=None, seen=None)
    if effect.id in BENT | READ or _refuses(effect, bare, x):
        with pytest.raises(CalibrationError, match=f"{effect.id} of {effect.of}"):
            effect.shift(bare, x)
    else:
        np.testing.assert_array_equal(effect.shift(bare, x), effect.shift(states, x))


def _refuses(effect, states, x):
    try:
        effect.shift(states, x)
    except CalibrationError:
        return True
    return False


# What is kept of an effect is what it would say anew, at whatever states.


def drawn(effect, rng):
    """Return parameters of an effect, of about its plausible sizes."""
    sizes = np.ones(len(effect.parameters))
    start = effect.starts[-1]
    start = np.where(start == 0.0, 1e-4 * sizes, start)
    return start * rng.uniform(0.5, 1.0, len(sizes))


def test_kept_derivatives_and_shifts_are_those_worked_out_anew(effect, states):
    rng, derivative_cache = np.random.default_rng(5), DerivativeCache()
    cooler = replace(states, temperature_C=states.temperature_C - 3.0)
    for at in (
        states,
        states,
        replace(states, tau_Nm=0.5 * states.tau_Nm),
        cooler,
        replace(cooler, q_rad=cooler.q_rad + 0.1),
        states.take(slice(0, 2)),
        states,
    ):
        x = drawn(effect, rng)
        np.testing.assert_array_equal(
            derivative_cache.derivative(effect, at, x), effect.derivative(at, x), strict=True
        )
        shift = effect.shift(at, x)
        np.testing.assert_allclose(
            derivative_cache.shift(effect, at, x), shift, rtol=1e-12, atol=1e-18
        )


def test_an_effect_of_another_model_is_the_same_but_for_the_range_it_was_sought_in(at, states):
    soft = at("soft_windup", "joint 2")
    assert soft.same_as(replace(soft, span_Nm=2.0 * soft.span_Nm, rated_Nm=3.0))
    # In a map of the torque the range scales the form: the same amounts are another function.
    for name in ("windup_map", "direction_map"):
        of_torque = at(name, "joint 2")
        other = replace(of_torque, span_Nm=2.0 * of_torque.span_Nm)
        x = amount(of_torque)
        assert not np.allclose(of_torque.shift(states, x), other.shift(states, x))
        assert not of_torque.same_as(other)
        assert of_torque.same_as(replace(of_torque))


def test_what_lengthens_links_turns_nothing(at, states):
    growth = at("thermal_growth", "arm")
    assert {name[:2] for name in growth.coordinates} == {"a_", "d_"}
    assert growth.rotations(states, amount(growth))[0].size == 0
    windup = at("windup_map", "joint 2")
    assert windup.rotations(states, amount(windup))[0].any()


class Faulty(Effect):
    """A class of effects with mistakes."""

    id = "faulty"
    sits = "arm"
    coordinates = ("theta_1", "theta_2", "theta_3")
    reported = (TermParameter("a", "rad", 1e-5), TermParameter("b", "rad", 1e-5, plausible=1e-4))

    def per_unit(self, states):
        return np.ones((len(states), len(self.reported), len(self.coordinates)))


def test_mistakes_of_a_class_are_refused(context, states):
    of_arm = Faulty("arm")
    with pytest.raises(ValueError, match=r"per_unit of faulty: shape \(\d+, 2, 3\) in place"):
        of_arm.derivative(states, np.zeros(2))
    with pytest.raises(ValueError, match="faulty of arm: a linear parameter has no plausible size"):
        of_arm.size(np.ones(2))

    class Elsewhere(Faulty):
        sits = "drivenjoint"

    with pytest.raises(ValueError, match=r"Elsewhere sits at none of .*'drivenjoint'"):
        Elsewhere.everywhere(context)

    @dataclass(frozen=True)
    class OfNoJoint(Faulty):
        rated_Nm: float

    with pytest.raises(ValueError, match="OfNoJoint has rated_Nm of a joint and sits at none"):
        OfNoJoint.everywhere(context)
