"""A base that moves slowly while a campaign lasts, by too little to be a wander."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from made_up_model import fitted, postures
from made_up_poses import context_of
from made_up_survey import POSITION_M, observe
from pa10cal.arm.statics import PoseStates
from pa10cal.discovery.against_drift import grows_instead, reasons_against_drift
from pa10cal.discovery.blocked_cv import outcome
from pa10cal.discovery.blocked_cv.by_blocks import discover_by_blocks
from pa10cal.discovery.blocked_cv.interleaved_check import (
    SquaresByBlock,
    slow_drift,
    steady_courses,
)
from pa10cal.discovery.jacobians import by_base, by_terms
from pa10cal.discovery.preparation import MeasurementSetup, Prepared, why_unknown
from pa10cal.discovery.target_wander import TargetWander, in_words, target_wander, wander_instead_of
from pa10cal.fit.model_reading import model_from_plain
from pa10cal.fit.model_writing import model_to_plain
from pa10cal.observe.observations import Observations
from pa10cal.observe.points import Points
from pa10cal.options import Tolerances
from pa10cal.terms.effects.over_time import BaseDrift, ThermalGrowth
from pa10cal.terms.effects.readings import RangeConstant
from pa10cal.terms.offsets import link_departures

POSES = 400


def course(part):
    """From 0 to 1 in the first half of a campaign, then nothing."""
    return 0.5 - 0.5 * np.cos(np.pi * np.minimum(2.0 * part, 1.0))


def judged(along_m):
    """A campaign whose readings, in order of time, are shifted by a course."""
    surveyed = observe(poses=POSES, held_out=10)
    readings = surveyed.readings
    readings = readings.take(np.argsort(readings.states.time_s))
    T = readings.measured.T_instr_target.copy()
    T[:, :3, 3] += np.outer(course(np.linspace(0.0, 1.0, len(readings))), along_m)
    readings = readings.with_measured(T_instr_target=T)
    given = Prepared(readings, None, surveyed.baseline, surveyed.setup, "masses", False)
    return discover_by_blocks(given)


@pytest.fixture(scope="module")
def drifted():
    return judged([0.0, 0.0, 2.0 * POSITION_M])


@pytest.mark.slow
def test_nothing_moves_where_nothing_moved():
    assert judged([0.0, 0.0, 0.0]).effects == ()


@pytest.mark.slow
def test_a_slow_drift_is_found_with_its_course(drifted):
    (finding,) = drifted.effects
    assert (finding.id, finding.of, finding.effect.waves) == ("base_drift", "base", 6)
    assert drifted.scorer.survey.wander is None
    assert finding.proof.gain > 5.0 * finding.proof.gain_std
    assert drifted.verdict == "named"
    remaining = drifted.scorer.remaining
    assert remaining.rms_mm == pytest.approx(finding.proof.rms_with_mm, rel=0.03)
    assert remaining.mean_mm < 1.05 * remaining.expected_mm
    assert finding.proof.rms_with_mm < finding.proof.rms_without_mm
    states = drifted.scorer.survey.poses.states
    part = (states.time_s - states.time_s[0]) / np.ptp(states.time_s)
    moved_m = finding.effect.shift(states, drifted.extended.at.values_of(finding.effect))
    up_m = moved_m @ drifted.baseline.T_instr_base[2, :3]
    expected_m = 2.0 * POSITION_M * course(part)
    off_m = up_m - up_m.mean() - expected_m + expected_m.mean()
    assert np.sqrt(np.mean(off_m**2)) < 0.25 * POSITION_M


@pytest.mark.slow
def test_it_is_held_where_nothing_is_known_of_it(drifted):
    (finding,) = drifted.effects
    states, x = drifted.scorer.survey.poses.states, drifted.extended.at.values_of(finding.effect)
    ends = finding.effect.shift(states, x)[[0, -1]]
    beyond = replace(states.take(np.array([0, -1])), time_s=np.array([-1e6, 1e6]))
    np.testing.assert_allclose(finding.effect.shift(beyond, x), ends, atol=1e-12)


@pytest.mark.slow
def test_its_model_is_saved_and_restored(drifted):
    back = model_from_plain(model_to_plain(drifted.model), where="model.yaml")
    assert back.model.terms == drifted.model.model.terms


def test_a_constant_drift_is_no_alternative_of_a_slow_one(nothing_hidden):
    class AllAlike:
        """A check by which anything helps, and all as much."""

        def squares(self, effects=(), *, lag=True):
            return SquaresByBlock(np.full((2, 10), 1.0 if effects else 2.0), 0.1)

        def gains_a_share(self, before, after):
            return True

    (judged,) = slow_drift(nothing_hidden.discovery.scorer.survey, AllAlike(), ())
    assert judged.effect.waves > 0
    assert judged.effect.id not in {each.id for each in judged.alternatives}


# What is in proportion to time or temperature, in the place of a slow drift.


SECONDS = 1500.0


def drifting(along_m):
    """A short campaign whose readings are shifted in proportion to time."""
    surveyed = observe(poses=150, held_out=10)
    readings = surveyed.readings
    readings = readings.take(np.argsort(readings.states.time_s))
    part = np.linspace(0.0, 1.0, len(readings))
    states = replace(readings.states, time_s=SECONDS * part)
    T = readings.measured.T_instr_target.copy()
    T[:, :3, 3] += np.outer(part, along_m)
    readings = replace(readings, states=states).with_measured(T_instr_target=T)
    given = Prepared(readings, None, surveyed.baseline, surveyed.setup, "masses", False)
    return discover_by_blocks(given)


@pytest.mark.slow
@pytest.mark.parametrize("over_noise", [5.0, 40.0])  # 0.24 and 1.9 mm/h
def test_a_base_that_drifts_steadily_and_fast_is_named_and_does_not_wander(over_noise):
    along_m = over_noise * POSITION_M * np.array([1.0, -0.6, 0.4])
    found = drifting(along_m)
    (finding,) = found.effects
    assert (finding.id, finding.effect.waves) == ("base_drift", 0)
    assert not found.unexplained
    rate_m_h = found.extended.at.values_of(finding.effect)
    expected_m_h = along_m @ found.baseline.T_instr_base[:3, :3] * 3600.0 / SECONDS
    np.testing.assert_allclose(rate_m_h, expected_m_h, rtol=0.0, atol=0.15 * max(abs(expected_m_h)))
    back = model_from_plain(model_to_plain(found.model), where="model.yaml")
    assert back.model.terms == found.model.model.terms


class SquaresOf:
    """A check in which effects leave given squares, by their name; others leave those of none."""

    def __init__(self, squares):
        self._squares = squares

    def squares(self, effects=(), *, lag=True):
        names = [(each.id, getattr(each, "waves", 0) > 0) for each in effects]
        left = self._squares.get(names[0], 2.0) if names else 2.0
        return SquaresByBlock(np.full((2, 10), left), 0.1)

    def gains_a_share(self, before, after):
        return after.total.sum() < before.total.sum()


@pytest.mark.parametrize(
    ("squares", "names"),
    [
        ({("base_drift", True): 1.0, ("base_drift", False): 1.2}, []),
        ({("base_drift", True): 1.0, ("base_drift", False): 1.0}, ["base_drift"]),
        ({("base_drift", True): 1.9, ("base_drift", False): 1.8}, ["base_drift"]),
        ({("base_drift", True): 1.5, ("thermal_growth", False): 1.2}, ["thermal_growth"]),
        ({}, []),
    ],
)
def test_a_steady_drift_stands_for_a_slow_one_where_it_predicts_no_worse(
    nothing_hidden, squares, names
):
    survey = nothing_hidden.discovery.scorer.survey
    steady = steady_courses(survey, SquaresOf(squares), (), moves=False)
    assert [each.id for each in steady] == names
    # A drift may be larger than found.
    again = steady_courses(survey, SquaresOf(squares), steady, moves=False)
    assert [each.id for each in again] == [name for name in names if name == "base_drift"]


def test_a_steady_drift_that_was_found_need_not_help_again_where_a_motion_takes_it_up(
    nothing_hidden,
):
    survey = nothing_hidden.discovery.scorer.survey
    drift = BaseDrift("base", float(survey.poses.states.time_s.min()))
    (steady,) = steady_courses(survey, SquaresOf({}), (drift,), moves=True)
    assert steady.id == "base_drift"
    assert steady_courses(survey, SquaresOf({}), (drift,), moves=False) == ()
    worse = SquaresOf({("base_drift", True): 1.0})  # with waves it is better
    assert steady_courses(survey, worse, (drift,), moves=True) == ()


@pytest.mark.parametrize(("hours", "plausible_m_h"), [(0.1, 1e-3), (10.0, 3e-5)])
def test_a_steady_drift_of_a_short_campaign_may_be_as_large_as_a_slow_one(hours, plausible_m_h):
    drift = BaseDrift.over(np.array([5.0, 5.0 + 3600.0 * hours]))
    assert [each.plausible for each in drift.parameters] == pytest.approx(3 * [plausible_m_h])
    assert (drift.plausible_m_h is None) == (hours > 5.0)


# Readings of single targets that wander, each by itself.

TARGETS_M = np.array([[0.05, 0.01, 0.06], [-0.04, 0.05, 0.08], [0.0, -0.06, 0.1]])
SECONDS_A_POSE, NOISE_M = 20.0, 5e-5


def wander_of(single=0.0, common=0.0, **given):
    """Return how targets wander; see `wandering`."""
    return target_wander(*wandering(single, common, **given))


def wandering(single=0.0, common=0.0, *, targets=3, from_pose_to_pose=0.9, seed=1, drift=()):
    """Return a model, readings at random poses, and their white noise with what lasts longer.

    Both sizes, of errors of single targets and of a shift of all, are over that of the noise.
    """
    rng, count = np.random.default_rng(seed), 200
    at = fitted("ur10", 1, lambda arm: (link_departures(arm, Tolerances()), *drift))
    at = replace(at, targets_m=TARGETS_M[:targets].ravel())

    def lasting(*size):
        new = rng.standard_normal((count, *size))
        for k in range(1, count):
            new[k] = from_pose_to_pose * new[k - 1] + np.sqrt(1 - from_pose_to_pose**2) * new[k]
        return NOISE_M * new

    residual = NOISE_M * rng.standard_normal((count, targets, 3))
    residual += single * lasting(targets, 3) + common * lasting(1, 3)
    arm = at.model.chain.arm
    zero, zeros = np.zeros(count), np.zeros((count, arm.n))
    states = PoseStates(
        q_rad=postures(arm, seed, count),
        load_N=zero,
        tau_Nm=zeros,
        arrival=zeros,
        temperature_C=zero,
        time_s=SECONDS_A_POSE * np.arange(count),
    )
    cov_m2 = np.broadcast_to(NOISE_M**2 * np.eye(3), (count, targets, 3, 3))
    names = tuple(f"T{k + 1}" for k in range(targets))
    read = Points(names, np.ones((count, targets, 3)), cov_m2, None)
    poses = Observations.single(np.array([f"P{k}" for k in range(count)]), states, read)
    shuffled = rng.permutation(count)
    return at, poses.take(shuffled), residual.reshape(count, -1)[shuffled]


@pytest.mark.parametrize("targets", [2, 3])
def test_readings_that_wander_singly_are_told_by_how_much_and_how_long(targets):
    found = wander_of(single=1.0, targets=targets)
    assert found.rms_mm == pytest.approx(1e3 * np.sqrt(3.0) * NOISE_M, rel=0.3)
    assert 0.4 < found.lasting_s / (SECONDS_A_POSE / -np.log(0.9)) < 2.5
    assert "each by itself for about" in in_words(found)
    assert in_words(None) is None


@pytest.mark.parametrize("seed", range(5))
def test_noise_and_motions_of_all_targets_are_no_such_wander(seed):
    assert wander_of(seed=seed) is None
    assert wander_of(common=1.0, seed=seed) is None
    assert wander_of(single=0.5, common=1.5, seed=seed) is None


def test_a_single_target_does_not_show_whether_it_moves_alone():
    assert wander_of(single=1.0, targets=1) is None


@pytest.mark.parametrize(("single", "named"), [(2.0, False), (0.2, True)])
def test_a_drift_that_single_targets_wander_by_is_not_named(single, named):
    drift = BaseDrift("base", 0.0)
    at, poses, residual = wandering(single, drift=(drift,), from_pose_to_pose=0.98)
    x = at.x.copy()
    x[at.model.columns_of(drift)] = 2e-4 * np.array([1.0, 0.5, -0.3])  # [m/h], in 1.1 h
    at = replace(at, x=x)
    assert (wander_instead_of(drift, at, poses, residual) is None) == named


@pytest.mark.parametrize("grows", [True, False])
def test_a_drift_in_whose_place_the_arm_grew_is_not_named(grows):
    """Where the temperature was not logged, and the arm grows in proportion to time."""
    drift = BaseDrift("base", 0.0)
    at, poses, residual = wandering(drift=(drift,))
    (growth,) = ThermalGrowth.everywhere(context_of(at.model.chain.arm))
    hours = poses.states.time_s / 3600.0
    warm = replace(poses.states, temperature_C=growth.reference_temperature_C + 10.0 * hours)
    moved = by_terms(at, poses.with_states(warm), [growth], [np.zeros(1)])[0][:, :, 0] * 2e-5
    if not grows:
        moved = by_base(at, poses)[:, :, :3] @ [2e-4, 1e-4, -5e-5] * hours[:, None]
    unlogged = replace(poses.states, temperature_C=np.full(len(poses), np.nan))
    T_instr_ee = at.T_instr_base @ at.model.predict_with_jacobian(poses.states, at.x).T_base_ee
    predicted_m = poses.measured.ideal(T_instr_ee, at.targets_m).p_instr_m
    poses = poses.with_measured(p_instr_m=predicted_m + (moved - residual).reshape(-1, 3, 3))
    assert grows_instead(drift, growth, at, poses.with_states(unlogged)) == grows
    assert not grows_instead(drift, growth, at, poses)
    assert why_unknown(growth, poses.states, logged=False, weights=False) is None
    but_one = replace(poses.states, temperature_C=unlogged.temperature_C.copy())
    but_one.temperature_C[1:] = 300.0
    why = f"what it depends on was not logged in 1 of {len(poses)} rows"
    assert why_unknown(growth, but_one, logged=False, weights=False) == why
    assert grows_instead(drift, growth, at, poses.with_states(but_one)) == grows


@pytest.mark.slow
def test_where_readings_wander_singly_no_drift_is_named(monkeypatch):
    monkeypatch.setattr(outcome, "target_wander", lambda *_: TargetWander(0.05, 240.0))
    found = judged([0.0, 0.0, 2.0 * POSITION_M])
    assert found.effects == ()
    assert "by 0.05 mm" in found.readings_wander
    assert "for about 4 min" in found.readings_wander


def test_a_drift_is_judged_beside_an_error_of_the_readings():
    """Which needs to know where targets were seen; readings did not say so, and it was a crash."""
    drift, constant = BaseDrift("base", 0.0), RangeConstant("instrument")
    at, poses, noise_m = wandering(drift=(drift, constant))
    calibrated = at.only(*(term for term in at.model.terms if term not in (drift, constant)))
    T_instr_ee = at.T_instr_base @ calibrated.model.predict(poses.states, calibrated.x)
    ideal_m = poses.measured.ideal(T_instr_ee, at.targets_m).p_instr_m
    poses = poses.with_measured(p_instr_m=ideal_m + noise_m.reshape(-1, 3, 3))
    poses = poses.with_states(replace(poses.states, temperature_C=np.full(len(poses), np.nan)))
    setup = MeasurementSetup(None, TARGETS_M, reference_temperature_C=20.0)
    found = SimpleNamespace(
        prepared=Prepared(poses, None, calibrated, setup, "none", False),
        model=at,
        context=context_of(at.model.chain.arm),
    )
    finding = SimpleNamespace(id=drift.id, effect=drift)
    for reason in reasons_against_drift(found, finding):
        assert "an arm that grows" in reason  # of a drift that is none, it explains as much
