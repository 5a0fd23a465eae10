"""Sign flips over poses, and poses and loads left out, tell an effect from chance."""

from dataclasses import replace

import numpy as np
import pytest

from made_up_arm import forced, measure
from pa10cal.discovery.evidence.confirmation import confirm
from pa10cal.discovery.evidence.problem import prepare
from pa10cal.discovery.evidence.search import evidence_about
from pa10cal.discovery.rules import EVIDENCE


@pytest.fixture(scope="module")
def chance(null):
    """An effect taken for found where nothing is missing."""
    return forced(null, (null.effect("encoder_ellipticity", "joint 1"),), (1,))


def test_what_is_there_is_confirmed_every_way(wave):
    (found,) = confirm(wave.problem, wave.found)
    assert found.p_sign_flips_max_t == 1.0 / (1 + EVIDENCE.flips)
    assert found.lost_without_it_nats == pytest.approx(
        wave.found.score.log_evidence - wave.found.without[0].log_evidence
    )
    for left_out in (found.cross_validation_over_poses, found.cross_validation_over_loads):
        assert left_out.explained > 0.8
        assert left_out.z > 3.0


def test_what_is_chance_is_not(null, chance):
    (found,) = confirm(null.problem, chance)
    assert found.p_sign_flips_max_t > EVIDENCE.false_rate
    assert found.cross_validation_over_poses.explained < 0.1
    assert found.cross_validation_over_poses.z < 3.0
    assert found.cross_validation_over_loads.explained < 0.1


def test_what_fits_by_its_many_parameters_does_not_predict(null):
    (found,) = confirm(null.problem, forced(null, (null.effect("place_map", "instrument"),), (2,)))
    assert found.cross_validation_over_poses.explained < 0.0
    assert found.cross_validation_over_poses.z < 0.0


def test_the_larger_the_family_the_more_chance_makes_of_it(null, chance):
    (among_all,) = confirm(null.problem, chance)
    (alone,) = confirm(null.problem, replace(chance, family=chance.fit.effects))
    assert alone.p_sign_flips_max_t < 0.8 * among_all.p_sign_flips_max_t


def test_an_effect_is_confirmed_beside_another_that_is_not(wave):
    right = wave.effect("transmission_error", "joint 2")
    chance = wave.effect("encoder_ellipticity", "joint 1")
    for effects in ((right, chance), (chance, right)):
        found = dict(
            zip(effects, confirm(wave.problem, forced(wave, effects, (1, 1))), strict=True)
        )
        assert found[right].p_sign_flips_max_t == 1.0 / (1 + EVIDENCE.flips)
        assert found[right].cross_validation_over_poses.explained > 0.8
        assert found[chance].p_sign_flips_max_t > EVIDENCE.false_rate
        assert found[chance].cross_validation_over_poses.explained < 0.1
        assert found[right].lost_without_it_nats > 100.0 > 10.0 > found[chance].lost_without_it_nats


def test_friction_is_confirmed_by_the_torques_it_shows_in(rubbing):
    friction = rubbing.effect("friction_torque", "joint 3")
    (found,) = confirm(rubbing.problem, forced(rubbing, (friction,), (1,)))
    assert found.p_sign_flips_max_t == 1.0 / (1 + EVIDENCE.flips)
    assert found.cross_validation_over_poses.explained > 0.9


def test_one_load_leaves_none_to_leave_out(wave):
    readings = wave.readings.take(wave.readings.states.load_N == 0.0)
    problem = prepare(readings, wave.baseline, wave.setup)
    effect = wave.effect("transmission_error", "joint 2")
    (found,) = confirm(problem, forced(wave, (effect,), (1,), problem))
    assert found.cross_validation_over_loads is None
    assert found.cross_validation_over_poses.explained > 0.8


def test_nothing_found_is_nothing_to_confirm(null):
    assert confirm(null.problem, null.found) == ()


@pytest.fixture(scope="module")
def lawless():
    """Poses that are off for no reason, each alike in all its readings."""
    return measure(pose_m=3e-5, seed=5)


def test_flips_hold_where_poses_are_off_for_no_reason(lawless):
    evidence = evidence_about(lawless.problem, lawless.start, lawless.family)
    gains = evidence.additions((), list(range(len(lawless.family))))
    named = [k for k, effect in enumerate(lawless.family) if not effect.generic]
    best = max(named, key=lambda k: gains[k][0])
    assert gains[best][0] > 5.0  # the evidence alone makes more of it than of noise
    there = forced(lawless, (lawless.family[best],), (gains[best][1],))
    (found,) = confirm(lawless.problem, there)
    assert found.p_sign_flips_max_t > EVIDENCE.false_rate
    # Were its readings independent, chance would not do as much.
    cells = lawless.problem.cells
    each = np.array([f"{pose}-{k}" for k, pose in enumerate(cells.pose)])
    split = replace(lawless.problem, cells=replace(cells, pose=each))
    assert confirm(split, there)[0].p_sign_flips_max_t < found.p_sign_flips_max_t
