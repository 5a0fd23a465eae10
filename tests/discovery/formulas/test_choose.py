"""The shortest formula that does as well: contests by hand, and campaigns that hide one."""

from dataclasses import replace

import numpy as np
import pytest

import made_up_survey
from made_up_arm import Missing, at_joint, measure
from made_up_poses import at_rest
from pa10cal.discovery.proposals import with_proposals
from pa10cal.discovery.short_forms import FormComparison, choose
from pa10cal.discovery.verdict_records import verdict_keys
from pa10cal.stages.discover import verdict_lines
from pa10cal.terms.forms.form import AngleForm


def test_blocks_are_predicted_from_the_others():
    rng = np.random.default_rng(1)
    block = np.repeat(np.arange(4), 25)
    own, columns = rng.normal(size=(100, 3)), rng.normal(size=(100, 2))
    data = own @ [1.0, 2.0, 3.0] + columns @ [1.0, -1.0] + 0.1 * rng.normal(size=100)
    comparison = FormComparison(data, own, block, None, None, None)
    bare, full = comparison.squares([columns[:, :0], columns])
    for k, kept in ((0, own), (2, np.column_stack([own, columns]))):
        for b in range(4):
            there = block != b
            normal = kept[there].T @ kept[there] + np.eye(kept.shape[1])
            x = np.linalg.solve(normal, kept[there].T @ data[there])
            left = data[~there] - kept[~there] @ x
            assert (full if k else bare)[b] == pytest.approx(left @ left)
    amounts, covariance = comparison.fitted(columns)
    np.testing.assert_allclose(amounts, [1.0, -1.0], atol=0.05)
    assert covariance.shape == (2, 2)


def made_up_comparison(values, poses=200, seed=5, held=None):
    """Return rows in which joint 1 stands at angles over a turn, and errs by some values."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-np.pi, np.pi, poses)
    of_joint = q[:, None]
    states = at_rest(of_joint, tau_Nm=of_joint, arrival=of_joint, time_s=np.arange(float(poses)))
    data = values(q) + rng.normal(size=poses)

    def columns_of(forms):
        return [100.0 * form.values(states) for form in forms]

    of_map = 30.0 * np.concatenate(columns_of([harmonic(k) for k in range(1, 7)]), 1) / 100.0
    held = of_map if held is None else held
    return FormComparison(
        data, np.ones((poses, 1)), np.arange(poses) % 10, held, columns_of, states
    )


def harmonic(order):
    return AngleForm("joint 1", "harmonic", (float(order),))


FORMS = tuple(harmonic(order) for order in range(1, 13))


def test_one_order_is_found_among_others():
    comparison = made_up_comparison(lambda q: 5.0 * np.sin(3.0 * q + 0.4))
    found = choose(comparison, FORMS, (), 0.01)
    assert found.form.numbers == (3.0,)
    assert found.record.orders == (3, 3)
    assert found.record.gain > 0.9


def test_many_orders_have_no_short_form():
    def rough(q):
        return sum(3.0 * np.sin(order * q + order) for order in (1, 2, 4, 6))

    assert choose(made_up_comparison(rough), FORMS, (), 0.01) is None


def in_one_large_block(comparison):
    """Return rows of which three quarters are one block: what it gains is most of the scatter."""
    rows = np.arange(len(comparison.data))
    return replace(comparison, block=np.maximum(rows - 150, 0) // 6)


def test_a_form_in_place_of_a_map_that_helps_may_gain_unevenly():
    for seed in (1, 2, 3):
        even = made_up_comparison(lambda q: 3.0 * np.sin(3.0 * q + 0.4), seed=seed)
        found = choose(in_one_large_block(even), FORMS, (), 0.01)
        assert found.form.numbers == (3.0,)


def test_a_right_form_may_do_worse_than_a_map_by_two_standard_errors():
    comparison = made_up_comparison(lambda q: 3.0 * np.sin(3.0 * q + 0.4), seed=19)
    assert choose(comparison, FORMS, (), 0.01).form.numbers == (3.0,)


def test_a_shorter_form_that_loses_a_seventh_is_none_that_does_as_well():
    def two(q):
        return 3.0 * np.sin(3.0 * q + 0.4) + 1.2 * np.sin(5.0 * q)

    for seed in (1, 2, 3):
        comparison = in_one_large_block(made_up_comparison(two, seed=seed))
        assert choose(comparison, FORMS, (), 0.01).form.form == "two_harmonics"


def test_nothing_is_made_of_noise():
    for seed in range(20):
        comparison = made_up_comparison(lambda q: 0.0 * q, seed=seed)
        assert choose(comparison, FORMS, (), 0.01) is None


def proposed(found):
    return with_proposals(found).proposed


def test_a_bow_of_the_instrument_comes_back_as_its_formula(bowed):
    found = bowed.discovery
    (formula,) = proposed(found)
    assert formula.form.form in ("quadratic", "cubic")
    assert formula.form.numbers == (0, 1)  # x reads wrong along y
    assert [each.id for each in formula.instead] == ["place_map"]
    record = formula.record
    assert record.of == "instrument"
    assert record.formula.startswith("reading of x += c")
    assert record.evidence.squared_error_with < 0.5 * record.evidence.squared_error_without


@pytest.mark.slow
def test_a_lag_that_goes_with_the_torque_comes_back_as_its_formula():
    lag = Missing(
        turn=lambda states: at_joint(2, 4e-6 * states.arrival[:, 1] * np.abs(states.tau_Nm[:, 1]))
    )
    found = measure(lag).discovery
    assert found.verdict == "unexplained"
    (formula,) = proposed(found)
    assert formula.form.formula == "theta_2 += h s_2 |tau_2|"
    (lag,) = formula.record.parameters.values()
    assert abs(lag.value - 4e-6) < 4.0 * lag.std
    assert found.proposed == ()  # the verdict it was made of stays as it was
    lines = verdict_lines(verdict_keys(with_proposals(found)))
    (line,) = (each for each in lines if "proposed" in each)
    assert line.startswith("  proposed for joint 2, no name: theta_2 += h s_2 |tau_2|, h = ")


def test_nothing_is_proposed_where_nothing_is_missing_or_all_has_a_name(null, wave, eccentric):
    for campaign in (null, wave, eccentric):
        assert proposed(campaign.discovery) == ()


@pytest.mark.slow
def test_two_names_over_part_of_a_turn_are_proposed_as_one_wave(monkeypatch):
    """Three cycles a turn, which a first and a second wave imitate over the angles seen."""

    def wave(motion):
        return made_up_survey.at_joint(3, 2e-4 * np.sin(3.0 * motion.q_rad[:, 2] + 1.8))

    monkeypatch.setattr(made_up_survey, "LOW_RAD", -1.4)
    monkeypatch.setattr(made_up_survey, "HIGH_RAD", 1.4)
    found = made_up_survey.observe(made_up_survey.Hidden(turn=wave), poses=200).discovery
    names = [(each.id, each.of) for each in found.effects]
    assert names == [("encoder_ellipticity", "joint 3"), ("encoder_eccentricity", "joint 3")]
    assert found.without_name == ()
    (formula,) = proposed(found)
    assert (formula.form.form, formula.form.numbers) == ("harmonic", (3.0,))


@pytest.mark.slow
def test_a_rough_map_has_no_short_form(mapped):
    found = mapped.discovery
    assert [each.id for each in found.effects] == ["joint_error_map"]
    assert proposed(found) == ()


@pytest.mark.slow
def test_a_sawtooth_seen_by_a_tracker_comes_back_as_its_formula():
    def saw(motion):
        turns = 10.0 * motion.q_rad[:, 2] / (2.0 * np.pi) - 0.3
        return made_up_survey.at_joint(3, 2e-4 * (2.0 * (turns - np.floor(turns)) - 1.0))

    found = made_up_survey.observe(made_up_survey.Hidden(turn=saw)).discovery
    (formula,) = proposed(found)
    assert (formula.form.form, formula.form.of) == ("sawtooth", "joint 3")
    assert formula.form.order == 10
    size, *_ = formula.record.parameters.values()
    assert size.value == pytest.approx(2e-4, rel=0.05)
