"""Effects hidden in made-up surveys, and what the search by blocks left out makes of them."""

from types import SimpleNamespace

import numpy as np
import pytest

from made_up_poses import at_joint
from made_up_survey import LOW_RAD, Hidden, observe
from pa10cal.discovery.blocked_cv import by_blocks
from pa10cal.discovery.proposals import with_proposals
from pa10cal.errors import DiscoveryError
from pa10cal.terms.effects.joint_error_map import JointErrorMap
from pa10cal.terms.joint_spring import is_spring


def names(discovery):
    return [(finding.effect.id, finding.effect.of) for finding in discovery.effects]


def test_where_nothing_is_hidden_nothing_is_named(nothing_hidden):
    found = nothing_hidden.discovery
    assert found.verdict == "none"
    assert found.effects == found.nameless == ()
    assert found.scorer.remaining.mean_mm == pytest.approx(found.scorer.remaining.floor_mm, rel=0.1)
    assert not found.scorer.remaining.over_floor
    before, after = found.holdout.before, found.holdout.after
    assert after.mean_mm == pytest.approx(before.mean_mm, rel=0.15)
    assert [step.effects for step in found.errors_by_name.steps] == [()]


@pytest.mark.slow
def test_an_error_of_one_joint_that_has_no_name_is_the_map_of_that_joint(mapped):
    found = mapped.discovery
    assert names(found) == [("joint_error_map", "joint 3")]
    assert found.verdict == "named"
    (finding,) = found.effects
    assert isinstance(finding.effect, JointErrorMap)
    assert finding.effect.knots > 12
    assert finding.proof.improved == finding.proof.blocks == 10
    assert finding.proof.z > 10.0
    assert finding.proof.rms_without_mm > 1.5 * finding.proof.rms_with_mm
    inside = found.holdout.record().inside
    assert inside.after.rms_mm < 1.3 * found.scorer.remaining.rms_mm
    assert inside.after.mean_mm < 0.7 * inside.before.mean_mm


@pytest.mark.slow
def test_the_map_is_the_error_hidden_within_its_uncertainty(mapped):
    (finding,) = mapped.discovery.effects
    knots_rad = 2.0 * np.pi * np.arange(finding.effect.knots) / finding.effect.knots
    knots_rad = np.where(knots_rad > np.pi, knots_rad - 2.0 * np.pi, knots_rad)
    waves = [(13, 8e-5, 0.3), (17, 6e-5, 1.0), (5, 5e-5, 2.0), (9, 5e-5, 0.0)]
    true_rad = sum(size * np.sin(order * knots_rad + at) for order, size, at in waves)
    seen = np.abs(knots_rad) < -LOW_RAD - 0.1
    off = (finding.x - true_rad)[seen]
    # Means, slopes and long waves over the angles seen are the offset's and the links' as well.
    std = np.sqrt(np.diag(finding.covariance))[seen]
    assert np.std(off) < 2e-5
    assert np.mean(np.abs(off) < 2.0 * std) > 0.9


def test_a_named_form_is_the_answer_where_it_does_as_well_as_the_map(eccentric):
    found = eccentric.discovery
    assert names(found) == [("encoder_eccentricity", "joint 2")]
    assert found.verdict == "named"
    (finding,) = found.effects
    std = np.sqrt(np.diag(finding.covariance))
    assert np.all(np.abs(finding.x - [1e-4, 0.7]) < 3.5 * std)
    assert std[0] < 1e-5
    assert found.holdout.after.mean_mm < 0.7 * found.holdout.before.mean_mm
    assert [len(step.effects) for step in found.errors_by_name.steps] == [0, 1]


@pytest.mark.slow
def test_what_turns_the_end_and_does_not_move_it_is_no_effect_of_a_joint(twisted):
    found = twisted.discovery
    assert found.effects == ()
    helping = [
        (entry.of, entry.positions_and_attitudes_agree)
        for entry in found.scorer.remaining.tried
        if entry.helps
    ]
    assert ("joint 5", False) in helping


@pytest.mark.slow
@pytest.mark.slow
def test_what_has_no_name_is_told_though_it_moves_poses_by_less_than_noise():
    def turn(motion):
        return at_joint(3, 3e-5 * motion.arrival[:, 2] * np.sin(motion.q_rad[:, 2]))

    found = observe(Hidden(turn=turn), poses=300).discovery
    assert not found.over_noise
    assert found.verdict == "unexplained"
    assert [(each.of, each.form) for each in found.unexplained] == [("joint 3", "direction_map")]
    (formula,) = with_proposals(found).proposed
    assert (formula.form.form, formula.form.numbers) == ("arrival_by_angle", (1.0,))


def test_noise_beyond_what_is_stated_is_unexplained_and_has_no_name():
    found = observe(Hidden(noise=3.0), poses=150, held_out=0).discovery
    assert found.verdict == "unexplained"
    assert found.effects == found.nameless == ()
    assert found.scorer.remaining.over_floor
    assert found.holdout is None


def test_not_testable_are_effects_of_what_was_not_logged(nothing_hidden):
    why = {
        (entry.effect.id, entry.effect.of): entry.why
        for entry in nothing_hidden.discovery.not_testable
    }
    assert why["friction_torque", "joint 2"] == "the torques were not logged"
    assert "joint_compliance" in {name for name, _ in why}
    assert not {"encoder_eccentricity", "joint_error_map"} & {name for name, _ in why}


def test_held_out_poses_beyond_the_angles_seen_are_told_apart(mapped):
    holdout = mapped.discovery.holdout
    record = holdout.record()
    counts = [found.after.configurations for found in (record.inside, record.outside) if found]
    assert sum(counts) == len(mapped.held_out) == holdout.after.configurations
    assert counts[0] == holdout.inside.sum()


def test_too_few_poses_are_refused():
    with pytest.raises(DiscoveryError, match="too few poses to judge effects by blocked"):
        _ = observe(poses=99).survey


@pytest.mark.parametrize(
    ("names", "rms_mm", "is_better"),
    [(1, 0.999, True), (1, 1.001, False), (3, 0.985, False), (3, 0.975, True)],
)
def test_a_set_with_more_names_has_to_predict_held_out_blocks_better_by_more(
    names, rms_mm, is_better
):
    """The same model fitted otherwise predicts them better by 1 % now and then."""

    def verdict(count, rms_mm):
        scorer = SimpleNamespace(remaining=SimpleNamespace(rms_mm=rms_mm))
        return SimpleNamespace(effects=(None,) * count, scorer=scorer)

    assert by_blocks._is_better(verdict(names, rms_mm), verdict(1, 1.0)) == is_better


@pytest.mark.slow
def test_a_spring_that_stands_for_an_eccentric_sensor_gives_way_to_it():
    """All joints are rigid, and the calibration has springs of what turns as gravity does."""
    size_rad, phase_rad = 1.5e-4, 1.6

    def turn(motion):
        return at_joint(2, size_rad * np.sin(motion.q_rad[:, 1] + phase_rad))

    surveyed = observe(Hidden(turn=turn, noise=3.0), 1, poses=130, held_out=0, springs=True)
    assert "joint 2" in {term.of for term in surveyed.baseline.model.terms if is_spring(term)}
    (finding,) = surveyed.discovery.effects
    assert (finding.id, finding.of) == ("encoder_eccentricity", "joint 2")
    std_rad = np.sqrt(finding.covariance[0, 0])
    assert abs(finding.x[0] - size_rad) < 3.0 * std_rad < 0.5 * size_rad
    extended = surveyed.discovery.extended.model
    assert "joint 2" not in {term.of for term in extended.terms if is_spring(term)}
