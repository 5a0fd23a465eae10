"""What effects take away of the error beyond noise, in shares and in words."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pa10cal.discovery.explained import (
    ErrorsOfModels,
    explained_by,
    explained_errors,
    interval_of_share,
)
from pa10cal.discovery.finding import Finding
from pa10cal.discovery.proof import ComplianceProof
from pa10cal.results.discovery import ExplainedEffect
from pa10cal.results.record import EffectName
from pa10cal.terms import wording
from pa10cal.terms.effects.joint import GearRatioError, JointCompliance

NOISE_MM = 0.1


def errors(rms_mm, count=50):
    """Return errors of some poses with a given root mean square."""
    drawn = np.random.default_rng(3).uniform(0.2, 1.0, count)
    return drawn * rms_mm / np.sqrt(np.mean(drawn**2))


def taking(ids, of, before_mm, after_mm, **more):
    """Return an effect by what is left without it and with it."""
    return ExplainedEffect(
        ids=ids, of=of, share=0.0, before_mm=before_mm, after_mm=after_mm, **more
    )


def chain(*steps, start_mm=0.5):
    """Return effects that join one after the other: ids, place, what they leave."""
    left, effects = start_mm, []
    for ids, of, after_mm, *more in steps:
        elsewhere = tuple(EffectName(id=id_, of=at) for id_, at in more)
        effects.append(taking(ids, of, left, after_mm, elsewhere=elsewhere))
        left = after_mm
    return explained_by(effects, start_mm, NOISE_MM)


@pytest.mark.parametrize(
    ("steps", "share", "shares"),
    [
        # Of the variance beyond noise, the largest first.
        (
            ((("backlash",), "joint 1", 0.4), (("gear_error",), "joint 2", 0.2)),
            (0.25 - 0.04) / 0.24,
            [(0.16 - 0.04) / 0.24, (0.25 - 0.16) / 0.24],
        ),
        # Below the noise nothing is left to explain; no share is above one.
        (((("backlash",), "joint 1", 0.05),), 1.0, [1.0]),
        # What makes held-out poses worse takes nothing away.
        (((("backlash",), "joint 1", 0.6),), 0.0, [0.0]),
        (
            ((("backlash",), "joint 1", 0.55), (("gear_error",), "joint 2", 0.3)),
            (0.25 - 0.09) / 0.24,
            [(0.25 - 0.09) / 0.24, 0.0],
        ),
    ],
)
def test_shares_are_of_the_variance_beyond_noise_and_sum_to_the_whole(steps, share, shares):
    found = chain(*steps)
    assert found.share == pytest.approx(share)
    assert [each.share for each in found.of] == pytest.approx(shares)
    assert found.without_a_name == pytest.approx(1.0 - share)
    (_, of, after_mm), largest = steps[-1], found.of[0]
    assert (largest.of, largest.after_mm, found.after_mm) == (of, after_mm, after_mm)


def test_no_more_than_noise_is_nothing_to_explain():
    assert explained_by((), 1.1 * NOISE_MM, NOISE_MM) is None
    assert chain((("backlash",), "joint 1", 0.09), start_mm=0.095) is None
    found = explained_by((), 0.5, NOISE_MM)
    assert (found.share, found.of, found.without_a_name) == (0.0, (), 1.0)
    assert wording.headline(found) == "none of the error beyond noise is explained"
    assert wording.sentences(found) == ()


SENSOR_OR_GEAR = ("sensor_error", "gear_error")


@pytest.mark.parametrize(
    ("steps", "headline", "sentences"),
    [
        (
            (
                (("sensor_error",), "joint 5", 0.3),
                (SENSOR_OR_GEAR, "joint 1", 0.2),
                (("sensor_error",), "joint 3", 0.15),
                (SENSOR_OR_GEAR, "joint 6", 0.12),
            ),
            "98 % of the error beyond noise is explained: sensors of joints 3 and 5; "
            "sensor or gear of joints 1 and 6",
            (
                "The position sensors of joints 3 and 5 err with their angles: 0.45 mm becomes",
                "The position sensors of joints 1 and 6 err with their angles, or the gears of "
                "joints 1 and 6 are uneven: 0.27 mm becomes",
            ),
        ),
        (
            ((("third_harmonic",), "joint 2", 0.2, ("cmm_scale", "instrument")),),
            "explained: third harmonic of joint 2 or cmm scale of the instrument",
            (
                "There is third harmonic of joint 2, or the scales of the instrument's axes are "
                "off: 0.50 mm becomes",
            ),
        ),
        (
            ((("tool_sag",), "tool", 0.2),),
            "explained: tool sag",
            ("The tool sags under its weight: 0.50 mm becomes 0.20 mm.",),
        ),
        (
            ((("link_bending",), "upper_arm", 0.2),),
            "explained: link bending of the upper arm",
            ("The upper arm bends",),
        ),
    ],
)
def test_effects_are_told_in_words_those_of_one_kind_together(steps, headline, sentences):
    found = chain(*steps)
    assert wording.headline(found).endswith(headline)
    for said, begins in zip(wording.sentences(found), sentences, strict=True):
        assert said.startswith(begins)


def test_what_leaves_the_error_as_it_is_written_is_in_the_record_alone():
    steps = (("gear_error",), "joint 1", 0.26), (("backlash",), "joint 2", 0.2599)
    found = chain(*steps)
    assert [each.of for each in found.of] == ["joint 1", "joint 2"]
    assert wording.headline(found).endswith("explained: gear of joint 1")
    assert wording.sentences(found) == ("The gear of joint 1 is uneven: 0.50 mm becomes 0.26 mm.",)
    alone = chain(steps[1], start_mm=0.26)  # a headline without any name would say nothing
    assert wording.headline(alone).endswith("backlash of joint 2")


def test_springs_of_the_calibration_join_before_the_effects():
    springs = [
        taking(("joint_compliance",), f"joint {joint}", b, a, weights="assumed")
        for joint, b, a in ((2, 0.36, 0.25), (3, 0.25, 0.17))
    ]
    found = explained_by(springs, 0.36, 0.05)
    (told,) = wording.sentences(found)
    assert told == (
        "Joints 2 and 3 give way under the arm's weight (stiffness relative to assumed weights): "
        "0.36 mm becomes 0.17 mm."
    )
    assert [each.weights for each in found.of] == ["assumed", "assumed"]


@pytest.mark.parametrize(("calibrated_mm", "all_rigid_mm"), [(0.3, 0.6), (0.9, 0.6)])
def test_before_is_the_model_without_springs_and_without_effects(calibrated_mm, all_rigid_mm):
    # With joints rigid the effects stay in the model, so what they leave may be less than before.
    proof = ComplianceProof.model_construct(
        weights="logged", without_each_mm=errors(0.4), all_rigid_each_mm=errors(all_rigid_mm)
    )
    spring, eccentric = (
        Finding(effect, np.ones(1), np.eye(1), (), proof)
        for effect in (JointCompliance("joint 2", 10.0), GearRatioError("joint 3"))
    )
    found = explained_errors(
        ErrorsOfModels(
            over="held-out poses",
            pose=np.arange(50).astype(str),
            noise_mm=NOISE_MM,
            calibrated_mm=errors(calibrated_mm),
            named_mm=errors(0.12),
            exported_mm=errors(0.12),
            without_mm={eccentric: errors(0.25)},
        ),
        [spring],
        None,
    )
    assert found.before_mm == pytest.approx(max(calibrated_mm, all_rigid_mm))
    assert found.after_mm == pytest.approx(0.12)
    assert found.share + found.without_a_name == pytest.approx(1.0)
    assert found.interval95[0] <= found.share <= found.interval95[1]
    assert wording.interval_text(found).startswith("Over other poses like the held-out poses the ")
    assert {each.of for each in found.of} == {"joint 2", "joint 3"}


@pytest.mark.parametrize(("poses", "left_mm"), [(20, 0.15), (45, 0.3), (45, 0.1)])
def test_the_interval_of_the_share_holds_that_of_all_poses(poses, left_mm):
    """Errors of noise, and of a model before and after, over few poses drawn from many."""
    rng, noise_mm = np.random.default_rng(5), 0.1

    def drawn(count):
        noise = rng.normal(0.0, noise_mm / np.sqrt(3.0), (count, 3))
        lacks = rng.normal(0.0, 1.0 / np.sqrt(3.0), (2, count, 3))
        before, after = noise + 0.5 * lacks[0] + left_mm * lacks[1], noise + left_mm * lacks[1]
        return np.linalg.norm(before, axis=1), np.linalg.norm(after, axis=1)

    before, after = drawn(100_000)
    share = 1.0 - (np.mean(after**2) - noise_mm**2) / (np.mean(before**2) - noise_mm**2)
    labels = np.arange(poses).astype(str)
    found = np.array([interval_of_share(*drawn(poses), labels, noise_mm) for _ in range(400)])
    inside = np.mean((found[:, 0] <= share) & (share <= found[:, 1]))
    assert 0.9 < inside < 0.99
    # poses of two loads each, and alike, say no more than half as many
    twice = [np.repeat(each, 2) for each in drawn(poses)]
    alone = interval_of_share(twice[0][::2], twice[1][::2], labels, noise_mm)
    assert interval_of_share(*twice, np.repeat(labels, 2), noise_mm) == pytest.approx(alone)
    assert interval_of_share(*twice, np.full(2 * poses, "A"), noise_mm) is None


@pytest.mark.parametrize(
    ("share", "said"),
    [(0, "0 %"), (0.001, "less than 1 %"), (0.97, "97 %"), (0.996, "more than 99 %"), (1, "100 %")],
)
def test_all_and_nothing_are_not_claimed_by_rounding(share, said):
    assert wording.percent(share) == said


@pytest.mark.slow
def test_a_verdict_says_what_its_effects_take_away(eccentric):
    found = eccentric.discovery.explained
    (each,) = found.of
    assert (each.ids[0], each.of) == ("encoder_eccentricity", "joint 2")
    assert found.over == "held-out poses"
    held_out = eccentric.discovery.holdout
    assert (found.before_mm, found.after_mm) == pytest.approx(
        (held_out.before.rms_mm, held_out.after.rms_mm)
    )
    assert found.share > 0.8
    assert each.share == pytest.approx(found.share)
    fitted = replace(eccentric.discovery, holdout=None).explained
    assert fitted.over == "fitted poses"
    assert fitted.after_mm == pytest.approx(eccentric.discovery.train.after.rms_mm)


def test_where_all_held_out_poses_are_suspected_those_fitted_show_it(eccentric):
    verdict, held_out = eccentric.discovery, eccentric.discovery.holdout
    suspected = np.ones(len(held_out.poses), dtype=bool)
    prepared = replace(verdict.prepared, suspected=suspected)
    found, fitted = replace(verdict, prepared=prepared), replace(verdict, holdout=None)
    assert found.explained == fitted.explained


@pytest.mark.slow
def test_where_nothing_is_missing_nothing_is_explained(nothing_hidden):
    assert nothing_hidden.discovery.explained is None


def told(*effects):
    """Return the headline of effects that join one after the other."""
    return wording.headline(explained_by(effects, 0.5, NOISE_MM))


def test_what_is_likelier_than_the_name_that_was_found_is_told_before_it():
    found = taking(
        ("backlash", "gear_ratio_error"), "joint 6", 0.5, 0.2, probability=0.03,
        elsewhere=(EffectName(id="joint_compliance", of="joint 2"),),
        others_probability=(0.1, 0.58),
    )  # fmt: skip
    told = wording.headline(explained_by([found], 0.5, NOISE_MM))
    springs, gear, lost = (
        wording.noun_of(each) for each in ("joint_compliance", "gear_ratio_error", "backlash")
    )
    assert told.endswith(
        f": {springs} of joint 2 or {gear} of joint 6 or {lost} of joint 6 ({springs} 0.58)"
    )
    (said,) = wording.sentences(explained_by([found], 0.5, NOISE_MM))
    first = wording.clause_of("joint_compliance", "joint 2")
    assert said.startswith(f"It may be that {first} (0.58), or that ")

    # As likely as the others, the name that was found stays the first.
    equal = found.model_copy(update={"probability": 0.58})
    told = wording.headline(explained_by([equal], 0.5, NOISE_MM))
    assert f": {lost} or {gear} of joint 6" in told


def test_a_name_that_is_not_all_but_certain_is_told_with_its_probability():
    sure = taking(("backlash",), "joint 2", 0.5, 0.2, probability=0.96)
    assert "(" not in told(sure)
    alone = taking(("backlash",), "joint 2", 0.5, 0.2, probability=0.831)
    assert told(alone).endswith("of joint 2 (0.83)")
    both = taking(("tool_sag",), "tool", 0.5, 0.2, probability=0.58, elsewhere=(
        EffectName(id="joint_compliance", of="joint 4"),
    ))  # fmt: skip
    assert told(both).endswith("of joint 4 (tool sag 0.58)")


def test_joints_that_are_told_together_have_the_range_of_their_probabilities():
    effects = [
        taking(("backlash",), f"joint {joint}", 0.5 - 0.1 * joint, 0.4 - 0.1 * joint, probability=p)
        for joint, p in ((1, 0.82), (2, 0.68))
    ]
    assert told(*effects).endswith("of joints 1 and 2 (0.68 to 0.82)")


def test_a_sentence_is_as_sure_as_its_name():
    def lost(joint, probability, *others):
        ids = ("backlash", *(id_ for id_, _ in others))
        return taking(
            ids, f"joint {joint}", 0.4, 0.2, probability=probability,
            others_probability=tuple(p for _, p in others),
        )  # fmt: skip

    found = explained_by([lost(2, 0.97), lost(3, 0.85), lost(4, 0.02)], 0.5, NOISE_MM)
    begins = (
        "Joint 2 has lost motion: ",
        "It may be that joint 3 has lost motion (0.85): ",
        "At joint 4 something without a name depends on the direction of arrival (backlash 0.02): ",
    )
    for said, start in zip(wording.sentences(found), begins, strict=True):
        assert said.startswith(start)
    assert wording.headline(found).endswith(
        "is predicted: backlash of joint 2; backlash of joint 3 (0.85); something without a name "
        "of joint 4, by the direction of arrival (backlash 0.02)"
    )
    # A rival that is likelier than none of them names it.
    found = explained_by([lost(4, 0.02, ("gear_ratio_error", 0.6))], 0.5, NOISE_MM)
    (said,) = wording.sentences(found)
    assert said.startswith(
        "It may be that the gear ratio of joint 4 is off (0.60), or that joint 4 has lost motion "
        "(0.02): "
    )


@pytest.mark.parametrize(
    ("joints", "mostly"),
    [
        ({"1": 0.2, "2": 0.2, "3": 0.2, "4": 0.2, "5": 0.2}, ""),
        ({"1": 0.1, "3": 0.5, "4": 0.4}, ", mostly by joints 3 and 4"),
        ({"1": 1.0}, ", mostly by joint 1"),
    ],
)
def test_joints_are_told_where_few_carry_most(joints, mostly):
    field = taking(("field",), "without a name, predicted", 0.5, 0.2, joints=joints)
    (said,) = wording.sentences(explained_by([field], 0.5, NOISE_MM))
    assert said == f"What has no name is predicted{mostly}: 0.50 mm becomes 0.20 mm."
