"""Calibration from a fitted model: base and tool anew, the rest as it was but for what moved.

After a crash too: ten poses, few things moved, or nearly all of them.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from calibrated import general
from changed_arm import Change, draw_changed, plan_of
from made_up_model import fitted_to
from pa10cal.calibration.general.as_model import fitted, with_discrepancy
from pa10cal.calibration.general.calibrate import find_start
from pa10cal.calibration.general.case import general_case
from pa10cal.calibration.general.other_campaign import calibrate_from
from pa10cal.calibration.general.prior import prior_of, refuse_unsound
from pa10cal.calibration.load_case import LoadCase
from pa10cal.calibration.options import CalibrationOptions
from pa10cal.discovery.discover import discover
from pa10cal.discovery.preparation import MeasurementSetup
from pa10cal.errors import CalibrationError
from pa10cal.files.arms import load_arm
from pa10cal.fit.moved import Misfit
from pa10cal.fit.problem import GaussianPrior, disagreement, gain_along, remaining_disagreement
from pa10cal.rules import MOVED
from pa10cal.terms.effects.arrivals import ArrivalError
from pa10cal.terms.effects.joint_error_map import JointErrorMap
from pa10cal.terms.effects.over_time import BaseDrift
from pa10cal.terms.model import Model
from pa10cal_lab.simulated import (
    exact_observations,
    measure,
    observations_of,
    payload_of_individual,
)

ARM = load_arm("ur10")


@pytest.fixture(scope="module", name="arms")
def _arms():
    return cache(arms)


def arms(kind, change, seed=3):
    """Return a model of an arm, readings of it after a change, payload, and exact readings."""
    plan = plan_of(kind, 120)
    before, after = draw_changed(ARM, plan, change, np.random.default_rng(seed))
    payload = payload_of_individual(before)
    model = fitted(general(ARM, observations_of(measure(before, plan, seed)), payload))
    again = observations_of(measure(after, plan, seed + 1))
    return model, again, payload, exact_observations(after, plan, 60, seed + 2)


def from_prior(model, seen, payload):
    return calibrate_from(prior_of(model, ARM, payload), ARM, seen, find_start(ARM, seen), payload)


def error_mm(calibration, exact):
    model = fitted(calibration)
    return float(np.sqrt(np.mean(model.deviations(model.as_modelled(exact)).distance_mm ** 2)))


@pytest.mark.slow_but_one_in(3)
@pytest.mark.parametrize("kind", ["pose", "points", "distance"])
def test_base_and_tool_are_found_anew_and_nothing_else_moved(arms, kind):
    model, seen, payload, exact = arms(kind, Change(place=True))
    found = from_prior(model, seen.take(slice(20)), payload)
    assert found.fit.converged
    assert found.prior.moved == ()
    assert found.prior.factor == 1.0
    assert error_mm(found, exact) < 0.08


def test_what_a_model_lacks_is_estimated_with_a_tool_of_which_the_prior_says_nothing(arms):
    model, seen, payload, _ = arms("pose", Change(place=True))
    poses = seen.take(slice(30))
    lacks = with_discrepancy(from_prior(model, poses, payload)).discrepancy
    assert np.all(lacks.error_at_mm(poses.states.q_rad) < 0.1)


@pytest.mark.slow_but_one_in(4)
@pytest.mark.parametrize("joint", [2, 3, 4, 5])
def test_the_joint_whose_zero_moved_is_found(arms, joint):
    moved = Change(place=True, zero_rad=((joint, 1.5e-3),))
    model, seen, payload, exact = arms("pose", moved)
    found = from_prior(model, seen.take(slice(20)), payload)
    (what,) = found.prior.moved
    assert (what.kind, what.of, what.unit) == ("joint_zero", f"joint {joint}", "rad")
    assert abs(what.by - 1.5e-3) < 4 * what.std
    assert f"the zero of joint {joint} moved by" in found.prior.line
    assert error_mm(found, exact) < 0.08


def of_one_target(seen, poses):
    """Return the first poses in which one target was seen, and nothing but that target."""
    some = seen.take(np.flatnonzero(np.isfinite(seen.measured.p_instr_m[:, 0, 0]))[:poses])
    first = some.measured
    return replace(
        some,
        measured=replace(
            first,
            names=first.names[:1],
            p_instr_m=first.p_instr_m[:, :1],
            cov_m2=first.cov_m2[:, :1],
            p_ee_stated_m=None,
        ),
    )


@pytest.mark.slow_but_one_in(6)
@pytest.mark.parametrize("poses", [6, 10])
@pytest.mark.parametrize("joint", [2, 3, 5])
def test_six_poses_of_one_target_find_the_one_zero_that_was_lost(arms, joint, poses):
    moved = Change(place=True, zero_rad=((joint, 3e-3),))
    model, seen, payload, _ = arms("points", moved)
    few = of_one_target(seen, poses)
    found = from_prior(model, few, payload)
    (what,) = found.prior.moved
    assert (what.kind, what.of) == ("joint_zero", f"joint {joint}")
    assert abs(what.by - 3e-3) < 4 * what.std
    # Where the target is in poses that were never read; base and tool alone leave 1.2 mm and more.
    rest = of_one_target(seen, 120)
    off_mm = fitted(found).deviations(fitted(found).as_modelled(rest)).distance_mm
    assert np.sqrt(np.mean(off_mm**2)) < 0.25


def test_more_than_few_poses_bear_is_told_and_the_arm_stays_as_it_was(arms):
    model, seen, payload, _ = arms("points", heavy_crash(0))
    found = from_prior(model, of_one_target(seen, 6), payload)
    assert "all joints, links and springs are anew" not in found.prior.line
    assert "which no few changes explain: measure" in found.prior.line
    assert len(found.prior.moved) <= 3


def test_few_poses_after_nothing_but_base_and_tool_name_nothing(arms):
    model, seen, payload, _ = arms("points", Change(place=True))
    found = from_prior(model, of_one_target(seen, 6), payload)
    assert found.prior.moved == ()
    assert found.prior.line.endswith("these poses show nothing in it that moved")


def test_a_softer_drive_is_found(arms):
    model, seen, payload, _ = arms("pose", Change(place=True, softer=((2, 0.6),)))
    found = from_prior(model, seen, payload)
    assert [(each.kind, each.of) for each in found.prior.moved] == [("stiffness", "joint 2")]
    assert found.prior.moved[0].by == pytest.approx(1 / 0.6 - 1, abs=0.2)


def test_a_prior_and_further_poses_are_as_good_as_all_poses_together(arms):
    _, seen, payload, _ = arms("pose", Change())
    first, second = seen.take(slice(0, 60)), seen.take(slice(60, 120))
    model, both = (fitted(general(ARM, poses, payload)) for poses in (first, seen))
    found = fitted(from_prior(model, second, payload))
    k = [name.name for name in both.model.parameters].index("delta_theta_3")
    at = [name.name for name in found.model.parameters].index("delta_theta_3")
    std = np.sqrt(both.covariance[k, k])
    assert found.x[at] == pytest.approx(both.x[k], abs=0.7 * std)
    assert np.sqrt(found.covariance[at, at]) == pytest.approx(std, rel=0.35)


def test_a_map_of_the_prior_stays_where_no_pose_was(arms):
    model, seen, payload, _ = arms("pose", Change())
    effect = JointErrorMap("joint 4")
    k = len(model.x) - 6
    knots = 1e-4 * np.sin(np.arange(effect.knots))
    covariance = np.zeros((len(model.covariance) + effect.knots,) * 2)
    at = np.r_[0:k, k + effect.knots : len(covariance)]
    covariance[np.ix_(at, at)] = model.covariance
    covariance[k : k + effect.knots, k : k + effect.knots] = 1e-12 * np.eye(effect.knots)
    with_map = replace(
        model,
        model=Model(model.model.chain, (*model.model.terms[:-1], effect, model.model.terms[-1])),
        x=np.concatenate([model.x[:k], knots, model.x[k:]]),
        covariance=covariance,
    )
    prior = prior_of(with_map, ARM, payload)
    assert effect in prior.terms
    found = fitted(from_prior(with_map, seen.take(slice(12)), payload))
    assert found.values_of(effect) == pytest.approx(knots, abs=1e-5)
    setup = MeasurementSetup(payload, np.zeros((0, 3)), 20.0)
    verdict = discover(seen, found, setup)
    assert verdict.verdict == "not_sought"
    assert "has maps of joints already" in verdict.why


def test_a_calibration_names_the_readings_of_its_priors(arms):
    model, seen, payload, _ = arms("pose", Change())
    about = fitted_to("july", readings=("of july",), readings_of_prior=("of june",))
    campaign = SimpleNamespace(
        name="august", provenance="", robot=ARM.name, payload=lambda _arm: payload, campaigns=()
    )
    options, prior = CalibrationOptions(), replace(model, fitted_to=about)
    case = LoadCase(campaign, ARM, seen.take(slice(20)), "combined", options, prior=prior)
    record, _ = general_case(case, find_start(ARM, seen))
    assert list(record.fitted_model["fitted_to"]["readings_of_prior"]) == ["of july", "of june"]


def test_what_is_a_campaigns_own_does_not_carry_over(arms):
    model, _, payload, _ = arms("pose", Change())
    own = BaseDrift("base", 0.0)
    stops = ArrivalError("joint 2", ("june", "july"))
    longer = replace(
        model,
        model=Model(model.model.chain, (*model.model.terms, own, stops)),
        x=np.concatenate([model.x, np.full(5, 1e-4)]),
        covariance=1e-10 * np.eye(len(model.x) + 11),
    )
    prior = prior_of(longer, ARM, payload)
    assert own not in prior.terms
    assert ArrivalError("joint 2") in prior.terms
    assert prior.expected.mean[-1] == 0.0
    assert np.sqrt(prior.expected.covariance[-1, -1]) == pytest.approx(1e-4)


def test_a_prior_of_another_arm_or_without_covariance_is_refused(arms):
    model, _, payload, _ = arms("pose", Change())
    with pytest.raises(CalibrationError, match="a model of another arm"):
        prior_of(model, load_arm("irb120"), payload)
    with pytest.raises(CalibrationError, match=r"a model of another arm.*got 'ur10'"):
        prior_of(model, replace(ARM, name="ur10-2"), payload)
    with pytest.raises(CalibrationError, match="covariance of the prior is not known"):
        prior_of(replace(model, covariance=None), ARM, payload)


@pytest.mark.parametrize("grade", ["suspect_input", "not_converged"])
def test_an_unsound_prior_is_refused_unless_forced(arms, grade):
    model, _, _, _ = arms("pose", Change())
    about = fitted_to("before", grade=grade, health="why")
    doubtful = replace(model, fitted_to=about)
    with pytest.raises(CalibrationError, match=f"graded {grade}"):
        refuse_unsound(doubtful)
    refuse_unsound(doubtful, force=True)


def test_too_few_poses_for_base_and_tool_are_refused(arms):
    model, seen, payload, _ = arms("pose", Change())
    with pytest.raises(CalibrationError, match="too few poses"):
        from_prior(model, seen.take(slice(1)), payload)


def test_the_gain_of_a_widening_is_that_of_the_likelihood():
    rng = np.random.default_rng(1)
    rows, noise = rng.normal(size=(9, 4)), 0.3
    root = 0.5 * rng.normal(size=(4, 4))
    expected = GaussianPrior(rng.normal(size=4), root @ root.T + 0.01 * np.eye(4))
    seen = rng.normal(size=9)
    information = expected.precision + rows.T @ rows / noise**2
    covariance = np.linalg.inv(information)
    x = covariance @ (expected.precision @ expected.mean + rows.T @ seen / noise**2)
    directions = rng.normal(size=(4, 2))

    def evidence(wider):
        of_rows = noise**2 * np.eye(9) + rows @ wider.covariance @ rows.T
        return multivariate_normal(rows @ expected.mean, of_rows).logpdf(seen)

    disagreed = disagreement(expected, x, covariance)
    gain, size = gain_along(disagreed, directions, (2.0,))
    assert size == 2.0
    rise = evidence(expected.widened(2.0 * directions)) - evidence(expected)
    assert gain == pytest.approx(rise, rel=1e-6)
    more = rng.normal(size=(4, 1))
    again, _ = gain_along(remaining_disagreement(disagreed, 2.0 * directions), more, (1.0,))
    both = expected.widened(2.0 * directions)
    assert again == pytest.approx(evidence(both.widened(more)) - evidence(both), rel=1e-5)


def test_the_evidence_of_few_readings_is_that_of_the_likelihood_over_sizes_and_noise():
    rng = np.random.default_rng(2)
    rows, known = rng.normal(size=(7, 3)), rng.uniform(0.0, 2.0, 7)
    misfit = Misfit(rng.normal(size=7), rows, known)
    directions = np.array([size * np.eye(3)[:, :2] for size in (1.0, 10.0)])
    levels, power = np.array(MOVED.louder), MOVED.louder_power
    likely = levels**-power / np.sum(levels**-power)

    def density(along):
        moves = rows @ along @ along.T @ rows.T
        each = [
            multivariate_normal(np.zeros(7), np.diag(level**2 + known) + moves).pdf(misfit.data)
            for level in levels
        ]
        return float(likely @ each)

    wanted = np.log(np.mean([density(along) for along in directions]))
    none = np.log(density(np.zeros((3, 1))))
    gained = misfit.evidence(directions) - misfit.evidence(np.zeros((1, 0, 0)))
    assert gained == pytest.approx(wanted - none, rel=1e-9)


def test_a_windup_that_a_fit_held_at_its_end_is_known_as_well_as_those_of_other_joints(arms):
    model, _, payload, _ = arms("pose", Change())
    names = [each.name for each in model.model.parameters]
    at, *others = [k for k, name in enumerate(names) if name.startswith("windup")]
    covariance = model.covariance.copy()
    covariance[at] = covariance[:, at] = 0.0
    prior = prior_of(replace(model, covariance=covariance), ARM, payload)
    usual = np.median(np.diag(covariance)[others])
    assert prior.expected.covariance[at, at] == pytest.approx(usual)


# Crashes.

#: A calibration from the prior may be worse than one without by so much, which is chance.
BY_CHANCE = 1.1


def crash(seed):
    """Draw one or two things that move: zeros of joints, a softer drive, a bent link."""
    rng = np.random.default_rng([17, seed])
    zeros = [(int(j), _zero(rng)) for j in rng.choice([2, 3, 4, 5], 2, replace=False)]
    softer = (int(rng.choice([2, 3])), float(rng.uniform(0.5, 0.8)))
    longer = (int(rng.choice([2, 3])), float(rng.choice([-1, 1]) * rng.uniform(3e-4, 1.5e-3)))
    what = {
        0: {"zero_rad": tuple(zeros[:1])},
        1: {"zero_rad": tuple(zeros)},
        2: {"softer": (softer,)},
        3: {"zero_rad": tuple(zeros[:1]), "softer": (softer,)},
        4: {"zero_rad": tuple(zeros[:1]), "longer_m": (longer,)},
    }
    return Change(place=True, **what[seed % 5])


def heavy_crash(seed):
    """Draw a crash that moves four zeros, both springs and two links."""
    rng = np.random.default_rng([18, seed])
    joints = rng.choice(np.arange(1, 7), 4, replace=False)
    return Change(
        place=True,
        zero_rad=tuple((int(joint), _zero(rng)) for joint in joints),
        softer=tuple((joint, float(rng.uniform(0.5, 0.9))) for joint in (2, 3)),
        longer_m=tuple((row, float(rng.normal(0.0, 1e-3))) for row in (2, 3)),
    )


def _zero(rng):
    return float(rng.choice([-1, 1]) * np.exp(rng.uniform(np.log(3e-4), np.log(2e-2))))


def after(change, seed):
    """Return the calibration of ten poses from the prior, and the rms errors [mm] with, without."""
    model, seen, payload, exact = arms(("pose", "points")[seed // 5 % 2], change, seed)
    ten = seen.take(np.arange(0, 120, 12))
    found, without = from_prior(model, ten, payload), general(ARM, ten, payload)
    return found, error_mm(found, exact), error_mm(without, exact)


@pytest.mark.slow
def test_a_prior_is_no_worse_than_none_and_its_intervals_hold():
    """60 crashes of one or two things: the bars are 2 % worse by more than chance, 92 % inside."""
    worse, inside = [], []
    for seed in range(60):
        change = crash(seed)
        found, with_prior, without = after(change, seed)
        worse.append(with_prior > BY_CHANCE * without)
        sign = np.sign(ARM.a_m)
        truth = {f"joint {joint}": angle for joint, angle in change.zero_rad}
        truth |= {f"stiffness {joint}": 1.0 / factor - 1.0 for joint, factor in change.softer}
        truth |= {f"delta_a_{row}": sign[row - 1] * by for row, by in change.longer_m}
        for each in found.prior.moved:
            name = each.of.replace("joint", "stiffness") if each.kind == "stiffness" else each.of
            inside.append(abs(each.by - truth.get(name, 0.0)) < 1.96 * each.std)
    assert np.mean(worse) <= 0.02
    assert np.mean(inside) >= 0.92
    assert len(inside) > 70


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=[pytest.mark.slow]) for seed in range(1, 20))]
)
def test_where_nearly_all_moved_the_arm_is_taken_as_new(seed):
    found, with_prior, without = after(heavy_crash(seed), seed)
    assert with_prior < 1.5 * without  # 20 times and more where only names are sought
    assert found.prior.moved
