"""What has no name and is predicted: beside the names, and none of them."""

from dataclasses import replace

import numpy as np
import pytest

from pa10cal.commands.models import notes_on
from pa10cal.discovery.discover import with_predicted
from pa10cal.discovery.field import field_of
from pa10cal.discovery.gap import fallen_back
from pa10cal.discovery.nameless import nameless_effects
from pa10cal.discovery.verdict_records import verdict_keys
from pa10cal.fit.fitted import FallBack
from pa10cal.fit.model_reading import load_model
from pa10cal.fit.validity import nothing_seen, span_visited
from pa10cal.terms.wording import headline, sentences


@pytest.fixture(scope="module", autouse=True)
def fields_fitted_once():
    """Fit the field of a model and poses once: most tests change only what is said of them."""
    known = {}

    def once(model, poses, nameless=()):
        key = id(poses), model.model.terms, model.x.tobytes(), tuple(nameless)
        if key not in known:
            known[key] = poses, field_of(model, poses, nameless)  # poses are kept with their id
        return known[key][1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pa10cal.discovery.discover.field_of", once)
        yield


def test_where_nothing_is_left_nothing_is_predicted(nothing_hidden, wave):
    for measured in (nothing_hidden, wave):
        found = measured.discovery
        assert with_predicted(found) is found


@pytest.mark.slow
def test_what_two_joints_do_together_is_predicted_and_is_no_name(entangled):
    found = entangled.discovery
    beside = with_predicted(found)
    assert beside.predicted is not None
    assert beside.effects == found.effects
    assert beside.verdict == found.verdict == "unexplained"
    assert beside.train.after.rms_mm < 0.8 * found.train.after.rms_mm
    assert beside.predicted.by_names.train is found.train
    *_, field = beside.model.model.terms
    assert field.id == "field"
    k = len(beside.model.x)
    assert beside.model.covariance.shape == (k + 6, k + 6)
    explained = beside.explained
    (entry,) = (each for each in explained.of if each.joints is not None)
    assert (entry.ids, entry.of) == (("field",), "without a name, predicted")
    assert sum(each.share for each in explained.of) == pytest.approx(explained.share)
    assert sum(entry.joints.values()) == pytest.approx(1.0, abs=0.1)
    assert "is predicted: " in headline(explained)
    assert any("has no name is predicted" in said for said in sentences(explained))
    assert verdict_keys(beside).gap.train.after == beside.train.after


@pytest.mark.slow
def test_lost_motion_in_some_angles_is_predicted_by_the_side_of_arrival_there(worn):
    found = worn.discovery
    beside = with_predicted(found)
    squares = np.array([each.holdout.after.rms_mm for each in (found, beside)]) ** 2
    of_noise = found.noise_floor_mm**2
    assert squares[1] - of_noise < 0.2 * (squares[0] - of_noise)
    (together,) = (term for term in beside.model.model.terms if term.id == "nameless")
    assert [each.of for each in together.terms if each.id == "arrival_map"] == ["joint 3"]


def test_by_arrival_at_each_angle_are_joints_alone_whose_arrivals_were_found(wave):
    found = wave.discovery
    context, states, held = found.context, found.states, found.model.model.terms

    def of(**arriving):
        effects = nameless_effects(context, states, held, logged=False, **arriving)
        return [each.of for each in effects if each.id == "arrival_map"]

    assert of() == []
    assert of(arriving={2, 5}) == ["joint 2", "joint 5"]


def test_nothing_is_predicted_where_the_log_is_to_be_checked_or_the_base_moved(entangled):
    found = entangled.discovery
    moved = replace(found.train, without_motion=found.train)
    still = replace(found, train=moved)
    assert with_predicted(still) is still


@pytest.mark.slow
def test_the_written_model_is_the_one_that_is_judged(entangled):
    beside = with_predicted(entangled.discovery)
    poses = beside.train.poses
    by_model = poses.measured.deviations(
        beside.model.as_read(poses), beside.model.T_instr_base, beside.model.targets_m
    )
    np.testing.assert_allclose(by_model.distance_mm, beside.train.found_after.distance_mm)


@pytest.fixture(scope="module")
def limited(entangled):
    """What was found, left to the calibrated model beyond the joint positions of some poses."""
    found = entangled.discovery
    within = span_visited(found.train.poses.states.q_rad[:20])
    left = found.with_gaps(lambda gap: fallen_back(gap, ~within.inside(gap.poses.states.q_rad)))
    return replace(left, falls_back=FallBack(within, found.baseline, "held-out poses say so"))


def test_limits_of_effects_go_where_poses_beyond_them_are_predicted_no_worse(entangled, limited):
    beside, without = with_predicted(limited), with_predicted(entangled.discovery)
    assert beside.falls_back is None
    assert beside.holdout.after == without.holdout.after
    assert beside.by_names.holdout.after == without.by_names.holdout.after


def test_limits_of_effects_stay_where_poses_beyond_them_are_predicted_worse(limited):
    before = limited.holdout.found_before
    right = replace(before, distance_mm=1e-3 * before.distance_mm)
    harmed = replace(limited, holdout=replace(limited.holdout, found_before=right))
    beside = with_predicted(harmed)
    assert beside.predicted is not None
    assert beside.falls_back is harmed.falls_back
    outside = ~harmed.falls_back.within.inside(harmed.holdout.poses.states.q_rad)
    assert outside.any()
    left_mm = beside.holdout.found_after.distance_mm
    np.testing.assert_array_equal(left_mm[outside], right.distance_mm[outside])


def test_where_held_out_poses_come_out_worse_by_it_nothing_is_predicted(entangled):
    found = entangled.discovery
    without = found.holdout.found_after
    right = replace(without, distance_mm=1e-3 * without.distance_mm)
    harmed = replace(found, holdout=replace(found.holdout, found_after=right))
    assert with_predicted(harmed) is harmed


def test_where_effects_hold_nowhere_it_stands_beside_the_calibrated_model(entangled, tmp_path):
    found = entangled.discovery
    nowhere = FallBack(nothing_seen(found.baseline.arm.n), found.baseline, "held-out poses say so")
    left = found.with_gaps(lambda gap: replace(gap, found_after=gap.found_before))
    beside = with_predicted(replace(left, falls_back=nowhere))
    assert beside.predicted is not None
    assert beside.train.after.rms_mm < 0.8 * beside.train.before.rms_mm
    assert beside.model.model.terms == found.model.model.terms
    *_, field = beside.model.falls_back.model.model.terms
    assert field.id == "field"
    assert beside.falls_back.why.endswith(", with what has no name predicted beside it")
    assert notes_on(beside.model).endswith(", with what has no name predicted beside it")
    path = tmp_path / "model.yaml"
    beside.model.save(path)
    poses = beside.train.poses
    for model in (beside.model, load_model(path)):
        left_mm = model.deviations(poses).distance_mm
        np.testing.assert_allclose(left_mm, beside.train.found_after.distance_mm, atol=1e-9)
