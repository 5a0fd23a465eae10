"""The whole fit with effects, against dense least squares."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag

from made_up_survey import Hidden, at_joint, observe
from pa10cal.discovery.blocked_cv.by_campaign import parameters_alone
from pa10cal.discovery.blocked_cv.other_baselines import with_tilts_shown
from pa10cal.discovery.blocked_cv.refit import PartialFits, known_before, one_step, refit
from pa10cal.discovery.given import calibrate_with_effects
from pa10cal.discovery.model_with_effects import moved_base, with_unknowns
from pa10cal.discovery.pose_scatter import unweighted
from pa10cal.numerics.least_squares import Equations, minimise
from pa10cal.options import Tolerances
from pa10cal.terms.effects.joint import EncoderEccentricity, JointCompliance, SoftWindup
from pa10cal.terms.effects.joint_error_map import FadingPrior, JointErrorMap
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import link_departures

FINE = JointErrorMap("joint 3", 24, FadingPrior(1e-4, 6.0))
DISK = EncoderEccentricity("joint 2", 1.0)


@pytest.fixture(scope="module")
def hidden():
    def turn(states):
        q = states.q_rad
        return at_joint(2, 1e-3 * np.sin(q[:, 1])) + at_joint(3, 2e-4 * np.sin(4.0 * q[:, 2]))

    return observe(Hidden(turn=turn), poses=200, held_out=0)


@pytest.fixture(scope="module")
def found(hidden):
    weights = unweighted(hidden.readings.measured)
    return refit(hidden.survey, (DISK, FINE), (np.zeros(2), np.zeros(24)), weights)


def test_it_comes_to_rest_at_the_truth(hidden, found):
    assert found.converged
    x = found.x[found.columns_of(DISK)]
    std = np.sqrt(np.diag(found.covariance)[found.columns_of(DISK)])
    assert np.all(np.abs(x - [1e-3, 0.0]) < 4.0 * std)
    knots_rad = 2.0 * np.pi * np.arange(24) / 24
    off = found.x[found.columns_of(FINE)] - 2e-4 * np.sin(4.0 * knots_rad)
    inside = np.abs(np.mod(knots_rad + np.pi, 2.0 * np.pi) - np.pi) < 2.0
    assert np.std(off[inside]) < 2e-5
    left = found.at.compared(hidden.survey.poses).residual
    assert np.std(left[:, :3]) == pytest.approx(2e-5, rel=0.1)


def test_an_amount_that_poses_show_is_not_pulled_toward_the_size_expected_of_it():
    def turn(states):
        return at_joint(2, 6e-3 * np.sin(states.q_rad[:, 1]))

    hidden = observe(Hidden(turn=turn, noise=30.0), poses=110, held_out=0)
    weights = unweighted(hidden.readings.measured)
    found = refit(hidden.survey, (DISK,), (np.zeros(2),), weights)
    columns = found.columns_of(DISK)
    std = np.sqrt(np.diag(found.covariance)[columns])
    assert std[0] > 0.3 * DISK.parameters[0].plausible
    assert np.all(np.abs(found.x[columns] - [6e-3, 0.0]) < 3.0 * std)
    # once found, the same size is expected where effects are taken out and put back
    again = PartialFits(hidden.survey, found).model_with((DISK,))
    np.testing.assert_allclose(again.values_of(DISK), found.x[columns], atol=0.1 * std[0])


def test_nothing_near_fits_better(hidden, found):
    survey = hidden.survey
    whiten = found.weights.whiteners(np.arange(len(survey.poses)))

    def cost(x):
        left = with_unknowns(found.at, x).compared(survey.poses).residual
        return float(np.sum((whiten @ left[:, :, None]) ** 2))

    here = cost(found.x)
    rng = np.random.default_rng(8)
    root = np.linalg.cholesky(found.covariance + 1e-20 * np.eye(len(found.x)))
    for _ in range(5):
        assert cost(found.x + root @ rng.standard_normal(len(found.x))) > here - 1.0


def test_a_model_with_some_effects_has_all_but_maps_fitted_again(hidden, found):
    poses, partial = hidden.survey.poses, PartialFits(hidden.survey, found)

    def rms_m(model):
        return float(np.std(model.compared(poses).residual[:, :3]))

    assert rms_m(partial.model_with((DISK, FINE))) == pytest.approx(rms_m(found.fitted()), rel=1e-3)
    taken_out = found.x.copy()
    taken_out[found.columns_of(DISK)] = 0.0
    alone = partial.model_with((FINE,))
    assert np.all(alone.values_of(DISK) == 0.0)
    assert rms_m(found.fitted()) < rms_m(alone) < 0.9 * rms_m(with_unknowns(found.at, taken_out))
    assert np.array_equal(alone.values_of(FINE), found.at.values_of(FINE))


def test_a_parameter_stays_within_its_physical_range(hidden):
    spring = JointCompliance("joint 4", 56.0)
    weights = unweighted(hidden.readings.measured)
    found = refit(hidden.survey, (DISK, spring), (np.zeros(2), np.zeros(1)), weights)
    assert found.x[found.columns_of(spring)][0] >= 0.0


def test_the_shape_of_an_effect_of_no_amount_is_no_unknown(hidden):
    windup = SoftWindup("joint 4", 56.0, 5.0)
    weights = unweighted(hidden.readings.measured)
    found = refit(hidden.survey, (DISK, windup), (np.zeros(2), np.array([0.0, 2.0])), weights)
    assert np.all(np.isfinite(found.covariance))


def test_by_some_poses_a_parameter_stays_within_its_physical_range(hidden):
    spring, windup = JointCompliance("joint 4", 56.0), SoftWindup("joint 5", 56.0, 5.0)
    effects, starts = (spring, windup), (np.array([1e-6]), np.array([1e-5, 2.0]))
    found = refit(hidden.survey, effects, starts, unweighted(hidden.readings.measured))
    alone = one_step(hidden.survey, found, np.arange(40, 80))
    lower_Nm, upper_Nm = windup.parameters[1].lower, windup.parameters[1].upper
    at = [found.columns_of(each) for each in effects]
    assert alone.x[at[0]][0] >= 0.0
    assert lower_Nm <= alone.x[at[1]][1] <= upper_Nm
    for effect, columns in zip(effects, at, strict=True):
        of_it = parameters_alone(effect, alone, columns, 0.0).values()
        assert [each.std is None for each in of_it] == alone.at_end[columns].tolist()
    assert alone.at_end[at[1]][1]


def test_an_unknown_that_is_held_is_not_counted_as_determined():
    # known four times better than expected, no better, and held
    known = first_step(np.diag([16.0, 1.0, 5.0]), np.array([False, False, True]))
    variances, count = known_before(known, np.eye(3), [slice(0, 3)])
    np.testing.assert_allclose(variances, [1 / 16, 1.0, 0.0])
    assert count == pytest.approx(15 / 16)


def test_what_a_step_knows_is_the_same_without_its_factor():
    rng = np.random.default_rng(2)
    rows, related = rng.standard_normal((20, 7)), [slice(0, 3), slice(3, 6), slice(6, 7)]
    own = [rng.standard_normal((part.stop - part.start,) * 2) for part in related]
    prior = block_diag(*(each @ each.T for each in own))
    held = np.arange(7) == 4
    taken = first_step(rows.T @ rows + prior, held)
    assert taken.factor is not None
    variances, count = known_before(taken, prior, related)
    dense, dense_count = known_before(replace(taken, factor=None), prior, related)
    np.testing.assert_allclose(variances, dense, rtol=1e-12)
    assert count == pytest.approx(dense_count, rel=1e-12)
    rest = np.ix_(~held, ~held)
    by_rows = np.linalg.solve((rows.T @ rows + prior)[rest], (rows.T @ rows)[rest])
    assert count == pytest.approx(np.trace(by_rows))


def first_step(normal, held):
    """Return the first step of a linear problem, by its normal equations."""
    taken = []

    def equations(x):
        right = normal @ x - 1.0
        return Equations(float(x @ (normal @ x) - 2.0 * x.sum()) + 10.0, right, normal)

    minimise(
        np.zeros(len(held)),
        equations,
        lambda x, step: x + step,
        lambda _, step: not taken.append(step),
        most_steps=1,
        held=lambda x, gradient: held,
    )
    return taken[0]


def test_a_moved_base_is_the_base_times_a_small_motion():
    T = moved_base(np.eye(4), np.array([1.0, 2.0, 3.0, 0.0, 0.0, np.pi / 2]))
    np.testing.assert_allclose(T[:3, 3], [1.0, 2.0, 3.0])
    np.testing.assert_allclose(T[:3, 0], [0.0, 1.0, 0.0], atol=1e-15)


def test_tilts_that_a_missing_effect_hid_are_back_where_a_fit_with_it_shows_them():
    def turn(states):
        return at_joint(2, 0.02 * np.sin(states.q_rad[:, 1]))

    hidden = observe(Hidden(turn=turn), poses=150, held_out=0)
    weights, tilts = unweighted(hidden.readings.measured), {"delta_beta_2", "delta_beta_3"}
    before = {each.name for each in hidden.baseline.model.parameters}
    assert before.isdisjoint(tilts)
    assert with_tilts_shown(hidden.survey, refit(hidden.survey, (), (), weights)) is None
    fit = refit(hidden.survey, (DISK,), (np.zeros(2),), weights)
    tilted = with_tilts_shown(hidden.survey, fit)
    assert {each.name for each in tilted.model.parameters} == before | tilts
    both = calibrate_with_effects(hidden.readings, hidden.baseline, hidden.setup, (DISK,))
    assert tilts < {each.name for each in both.model.model.parameters}
    left = both.model.compared(both.poses).residual
    assert np.std(left[:, :3]) == pytest.approx(2e-5, rel=0.1)


def with_redundant_parameters(survey):
    """Return a survey whose baseline has parameters of links that its instrument does not show."""
    own = survey.baseline
    links = next(term for term in own.model.terms if term.of == "links")
    known = {each.name for each in links.parameters}
    more = known | {"delta_a_6", "delta_theta_6"}
    wider = link_departures(own.arm, Tolerances()).only(more)
    terms = tuple(wider if term is links else term for term in own.model.terms)
    by_name = dict(zip((each.name for each in own.model.parameters), own.x, strict=True))
    model = Model(own.model.chain, terms)
    x = np.array([by_name.get(each.name, 0.0) for each in model.parameters])
    return replace(survey, baseline=replace(own, model=model, x=x, covariance=None))


def test_tilts_are_added_to_parameters_that_the_instrument_does_not_show():
    def turn(states):
        return at_joint(2, 0.02 * np.sin(states.q_rad[:, 1]))

    hidden = observe(Hidden(turn=turn), poses=150, held_out=0)
    survey = with_redundant_parameters(hidden.survey)
    fit = refit(survey, (DISK,), (np.zeros(2),), unweighted(hidden.readings.measured))
    tilted = with_tilts_shown(survey, fit)
    before = {each.name for each in survey.baseline.model.parameters}
    assert len(before) > len(hidden.baseline.model.parameters)
    assert {each.name for each in tilted.model.parameters} == before | {
        "delta_beta_2",
        "delta_beta_3",
    }


def test_tilts_stay_at_zero_where_no_fit_shows_them(hidden, found):
    assert with_tilts_shown(hidden.survey, found) is None
