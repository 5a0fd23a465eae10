"""From a set of effects to a verdict: names before maps, rivals beside names, what is left over."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from made_up_arm import ERROR_RATE, Missing, forced, harmonic, measure
from made_up_poses import at_rest, measured_poses
from pa10cal.discovery.evidence import judge as judging
from pa10cal.discovery.evidence.judge import (
    judge,
    noise_floor_mm,
    noise_floor_of_mm,
    shared_error_mm,
)
from pa10cal.discovery.evidence.search import search
from pa10cal.discovery.verdict import word_of
from pa10cal.fit.position_errors import mean_norm
from pa10cal.terms.effects.joint_error_map import JointErrorMap


def word(judged):
    return word_of(judged.findings, judged.unexplained)


def name(effect):
    return effect.id, effect.of


@pytest.fixture(scope="module")
def eccentric():
    """One cycle a turn at joint 2, over half a turn: ellipse, ratio and map do nearly as well."""
    return measure(Missing(turn=harmonic(2, 1.0, 1.5e-4, 2.0)))


@pytest.fixture(scope="module")
def eccentric_judged(eccentric):
    return judge(eccentric.found, 0.0)


def test_rivals_that_do_as_well_stand_beside_the_name(eccentric_judged):
    judged = eccentric_judged
    assert word(judged) == "ambiguous"
    (finding,) = judged.findings
    listed = {name(finding.effect), *map(name, finding.alternatives)}
    assert ("encoder_eccentricity", "joint 2") in listed
    assert {of for _, of in listed} == {"joint 2"}
    assert finding.effect not in finding.alternatives
    assert not any(effect.generic for effect in finding.alternatives)


def test_a_name_takes_the_place_of_a_map_that_is_no_better(eccentric):
    shape = eccentric.effect(JointErrorMap.id, "joint 2")
    alone = search(eccentric.problem, (shape,), ERROR_RATE, eccentric.start)
    assert alone.fit.effects == (shape,)
    assert judge(alone, 0.0).findings[0].effect == shape  # no name in that family
    two = (shape, eccentric.effect("encoder_eccentricity", "joint 2"))
    (finding,) = judge(forced(eccentric, (shape,), (1,), family=two), 0.0).findings
    assert name(finding.effect) == ("encoder_eccentricity", "joint 2")


def test_the_map_of_another_joint_is_no_imitation(eccentric, monkeypatch):
    """Odds of 55 to 1 for the name: enough over the map of its own joint, and of no other."""
    names = ("encoder_eccentricity", "joint 2"), (JointErrorMap.id, "joint 2")
    member, own = (eccentric.effect(*each) for each in names)
    other = eccentric.effect(JointErrorMap.id, "joint 3")
    found = forced(eccentric, (member,), (1,), family=(member, own, other))
    near = replace(found.score, log_evidence=found.score.log_evidence - 4.0)
    refits = [SimpleNamespace(effect=each, score=near) for each in (own, other)]
    monkeypatch.setattr(judging, "_refitted", lambda _, effect, linear: refits if linear else [])
    (finding,) = judge(found, 0.0).findings
    assert finding.alternatives == (other,)


def test_what_sits_nowhere_is_unexplained_all_the_same():
    at_random = np.random.default_rng(3).standard_normal((1000, 6))

    def turn(states):
        # Joints stop elsewhere in every pose, for no reason; alike in its readings.
        _, pose = np.unique(np.round(states.q_rad[:, 0], 3), return_inverse=True)
        return 1e-4 * at_random[pose]

    lost = measure(Missing(turn=turn))
    names = ("gear_ratio_error", "encoder_eccentricity", "backlash")
    family = tuple(effect for effect in lost.family if effect.id in names)
    judged = judge(search(lost.problem, family, ERROR_RATE, lost.start), 0.0)
    assert word(judged) == "unexplained"
    assert judged.findings == ()
    (place,) = judged.unexplained
    assert (place.of, place.form) == (None, None)
    assert place.shared_error_mm > 2.0 * noise_floor_mm(lost.problem)


def test_what_chance_does_as_well_is_no_finding(null):
    chance = null.effect("encoder_ellipticity", "joint 1")
    judged = judge(forced(null, (chance,), (1,)), 0.0)
    assert judged.ended.fit.effects == (chance,)
    assert (word(judged), judged.findings) == ("none", ())


class TestFloor:
    @pytest.mark.parametrize("sigma", [1.0, 2.5])
    def test_the_mean_length_of_alike_components(self, sigma):
        covariance = np.tile(sigma**2 * np.eye(3), (2, 1, 1))
        expected = sigma * np.sqrt(8.0 / np.pi)
        np.testing.assert_allclose(mean_norm(covariance), expected, rtol=0.02)

    def test_the_mean_length_along_one_line(self):
        direction = np.array([0.6, 0.0, 0.8])
        covariance = 4.0 * np.outer(direction, direction)[None]
        assert mean_norm(covariance)[0] == pytest.approx(2.0 * np.sqrt(2.0 / np.pi), rel=0.04)

    def test_is_the_noise_of_poses_averaged_over_repeats_and_directions(self, null):
        # Four readings of a pose and load.
        expected = 1e3 * mean_norm(null.problem.noise.cov[:, :3, :3] / 4.0).mean()
        assert noise_floor_mm(null.problem) == pytest.approx(expected, rel=1e-6)

    def test_a_pose_that_is_read_often_counts_once(self):
        """Eleven poses, of which one was read 80 times, and the others twice."""
        rows = np.repeat(np.arange(11), [2] * 10 + [80])
        poses = measured_poses(
            [f"P{k:02}" for k in rows],
            at_rest(np.zeros((len(rows), 6))),
            np.tile(np.eye(4), (len(rows), 1, 1)),
            np.zeros((len(rows), 6, 6)),
        )
        cov = np.tile(1e-10 * np.eye(6), (len(rows), 1, 1))
        problem = SimpleNamespace(readings=poses, noise=SimpleNamespace(cov=cov))
        of_one_mm = 1e3 * mean_norm(cov[:1, :3, :3])[0]
        expected_mm = of_one_mm * (10 / np.sqrt(2.0) + 1 / np.sqrt(80.0)) / 11
        assert noise_floor_mm(problem) == pytest.approx(expected_mm)
        assert noise_floor_of_mm(problem, np.bincount(rows)) == pytest.approx(expected_mm)

    def test_a_shared_variance_is_told_in_millimetres(self, null):
        one = shared_error_mm(null.problem, 1.0)
        position = null.problem.noise.cov[:, :3, :3]
        expected = 1e3 * np.sqrt(np.trace(position, axis1=1, axis2=2).mean())
        assert one == pytest.approx(expected)
        assert shared_error_mm(null.problem, 9.0) == pytest.approx(3.0 * one)
