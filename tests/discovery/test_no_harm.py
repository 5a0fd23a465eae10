"""No harm: where held-out poses come out worse, the model falls back; names are contradicted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pa10cal.discovery.gap import ErrorsByName, PairedErrors
from pa10cal.discovery.no_harm import harmless
from pa10cal.fit.model_reading import load_model
from pa10cal.fit.validity import nothing_seen, span_visited
from pa10cal.terms.effects.joint import TorqueGain


def with_errors(found, factor, beyond):
    """Return a verdict whose held-out poses have other errors after, some beyond the fit's angles.

    Args:
        found: the verdict.
        factor: of the errors before, in the poses beyond; elsewhere errors after stay as they are.
        beyond: how many poses; their joint 3 is moved past all that the fit has seen.
    """
    gap = found.holdout
    states = gap.poses.states
    q_rad = states.q_rad.copy()
    rows = np.arange(len(q_rad)) < beyond
    q_rad[rows, 2] += 4.0
    poses = gap.poses.with_states(replace(states, q_rad=q_rad))
    before = gap.found_before
    worse = replace(before, distance_mm=factor * before.distance_mm)
    after = gap.found_after.replaced_where(rows, worse)
    held_out = PairedErrors(poses, before, after, gap.noise_floor_mm)
    return replace(found, holdout=held_out), rows


@pytest.mark.slow
def test_without_held_out_poses_or_harm_a_verdict_passes_as_it_is(mapped, nothing_hidden):
    for found in (replace(mapped.discovery, holdout=None), nothing_hidden.discovery):
        assert harmless(found) is found
    assert harmless(mapped.discovery) is mapped.discovery


def test_without_held_out_poses_the_poses_fitted_must_come_out_no_worse(eccentric):
    found = replace(eccentric.discovery, holdout=None)
    before = found.train.found_before
    worse = replace(before, distance_mm=1.08 * before.distance_mm)
    after = harmless(replace(found, train=replace(found.train, found_after=worse)))
    assert after.holds_nowhere
    assert "the poses fitted come out worse" in after.falls_back.why
    assert after.train.after.rms_mm == after.train.before.rms_mm
    better = replace(before, distance_mm=0.9 * before.distance_mm)
    good = replace(found, train=replace(found.train, found_after=better))
    assert harmless(good) is good


def test_a_map_that_harms_beyond_what_was_visited_is_left_out_there(mapped, tmp_path):
    found, rows = with_errors(mapped.discovery, 1.2, 30)
    after = harmless(found)
    assert [each.id for each in after.effects] == ["joint_error_map"]
    assert "beyond the joint positions of the fit" in after.falls_back.why
    gap = after.holdout
    np.testing.assert_array_equal(
        gap.found_after.distance_mm[rows], gap.found_before.distance_mm[rows]
    )
    np.testing.assert_array_equal(
        gap.found_after.distance_mm[~rows], mapped.discovery.holdout.found_after.distance_mm[~rows]
    )
    assert gap.after.rms_mm < gap.before.rms_mm
    # The model that is taken away does the same, and comes back from its file as it went.
    after.model.save(tmp_path / "model.yaml")
    q_rad = gap.poses.states.q_rad
    here, plain, away = (each.predict(q_rad) for each in (after.model, found.model, found.baseline))
    again = load_model(tmp_path / "model.yaml").predict(q_rad)
    np.testing.assert_allclose(again.T, here.T, atol=1e-12)
    np.testing.assert_allclose(again.u_mm, here.u_mm)
    np.testing.assert_array_equal(here.T[~rows], plain.T[~rows])
    np.testing.assert_allclose(
        (after.model.T_instr_base @ here.T)[rows], (found.baseline.T_instr_base @ away.T)[rows]
    )
    moved_mm = 1e3 * np.linalg.norm(here.T[rows, :3, 3] - plain.T[rows, :3, 3], axis=1)
    np.testing.assert_allclose(here.u_mm[rows], np.hypot(plain.u_mm[rows], moved_mm))
    assert not here.inside[rows].any()


@pytest.mark.parametrize(
    "campaign", [pytest.param("mapped", marks=pytest.mark.slow), "nothing_hidden"]
)
def test_a_model_that_harms_everywhere_is_the_calibrated_one(request, campaign):
    found = request.getfixturevalue(campaign).discovery
    worse = replace(
        found.holdout.found_before, distance_mm=1.1 * found.holdout.found_before.distance_mm
    )
    gap = found.holdout
    harming = PairedErrors(gap.poses, gap.found_before, worse, gap.noise_floor_mm)
    after = harmless(replace(found, holdout=harming))
    assert after.holdout.after == after.holdout.before
    assert after.train.after == after.train.before
    assert "everywhere" in after.falls_back.why
    assert not any(len(stretches) for stretches in after.falls_back.within.intervals)


@pytest.mark.parametrize(("factor", "contradicted"), [(1.02, False), (30.0, True)])
def test_a_name_is_contradicted_by_errors_beyond_its_uncertainty(eccentric, factor, contradicted):
    found, _ = with_errors(eccentric.discovery, factor, 40)
    after = harmless(found)
    assert (after.effects == ()) == contradicted
    reasons = [place.why for place in after.unexplained]
    assert any("held-out poses contradict it" in why for why in reasons) == contradicted


@pytest.mark.parametrize(("noises", "contradicted"), [(1.6, False), (6.0, True)])
def test_one_pose_in_a_gap_of_the_fit_contradicts_a_name_by_more_than_chance(
    eccentric, noises, contradicted
):
    """An error of 1.6 times the noise is of one pose in twenty, whatever the model."""
    found, rows = with_errors(eccentric.discovery, 1.0, 1)
    gap = found.holdout
    noise_mm = np.full(len(rows), gap.noise_rms_mm)
    before = replace(gap.found_before, distance_mm=noise_mm)
    after = replace(gap.found_after, distance_mm=noises * noise_mm)
    held_out = replace(
        gap,
        found_before=gap.found_before.replaced_where(rows, before),
        found_after=gap.found_after.replaced_where(rows, after),
    )
    judged = harmless(replace(found, holdout=held_out))
    assert (judged.effects == ()) == contradicted
    assert judged.falls_back is None


@pytest.mark.parametrize(
    ("factor", "of_log", "left"),
    [
        (0.5, False, 1),
        (1.0, False, 2),
        (2.0, False, 2),
        (0.5, True, 2),  # held-out poses are predicted under the torques as logged
    ],
)
def test_a_name_without_which_held_out_poses_do_better_goes(
    monkeypatch, eccentric, factor, of_log, left
):
    """Of two names, where without the second errors are those with it times a factor."""
    found = eccentric.discovery
    (first,) = found.findings
    effect = TorqueGain("joint 5") if of_log else replace(first.effect, of="joint 5")
    second = replace(first, effect=effect, alternatives=(), rivals=())
    after = found.holdout.found_after
    without = {
        first.effect: replace(after, distance_mm=2.0 * after.distance_mm),
        second.effect: replace(after, distance_mm=factor * after.distance_mm),
    }
    monkeypatch.setattr(type(found), "errors_by_name", ErrorsByName((), {}, without))
    done = harmless(replace(found, findings=(first, second)))
    assert len(done.findings) == left
    assert first.effect in {each.effect for each in done.findings}
    why = [place.why for place in done.unexplained if "do better without it" in place.why]
    assert len(why) == 2 - left


def as_group(monkeypatch, found, of_second, factor):
    """Return a verdict as of a group of two, the second predicted worse by a factor.

    Args:
        of_second: tells which poses are of the second campaign, by their joint positions (P, n).
    """

    def campaigns(gap):
        second = of_second(gap.poses.states.q_rad)
        return {"first": ~second, "second": second}

    monkeypatch.setattr(PairedErrors, "campaigns", property(campaigns))

    def worse(gap):
        after = replace(gap.found_before, distance_mm=factor * gap.found_before.distance_mm)
        second = of_second(gap.poses.states.q_rad)
        return replace(gap, found_after=gap.found_after.replaced_where(second, after))

    return found.with_gaps(worse)


def test_a_campaign_of_a_group_that_effects_harm_keeps_its_calibrated_model(monkeypatch, mapped):
    middle = np.median(mapped.discovery.train.poses.states.q_rad[:, 1])
    found = as_group(monkeypatch, mapped.discovery, lambda q: q[:, 1] > middle + 0.3, 1.1)
    after = harmless(found)
    assert [each.effect for each in after.effects] == [each.effect for each in found.effects]
    assert "of campaign second are predicted worse" in after.falls_back.why
    assert "beyond the joint positions of the other campaigns" in after.falls_back.why
    record = after.holdout.record()
    first, second = record.per_campaign["first"], record.per_campaign["second"]
    assert second.after.rms_mm == pytest.approx(second.before.rms_mm, rel=0.02)
    assert first.after.rms_mm == pytest.approx(
        found.holdout.record().per_campaign["first"].after.rms_mm, rel=0.1
    )


def test_an_effect_that_harms_a_campaign_in_the_same_positions_goes(monkeypatch, mapped):
    found = as_group(monkeypatch, mapped.discovery, lambda q: np.round(1e4 * q[:, 1]) % 2 > 0, 1.1)
    after = harmless(found)
    assert after.effects == ()
    assert any("held-out poses of campaign second" in place.why for place in after.unexplained)


def test_a_campaign_that_is_worse_by_chance_is_not_harmed(monkeypatch, mapped):
    found = as_group(monkeypatch, mapped.discovery, lambda q: np.round(1e4 * q[:, 1]) % 2 > 0, 1.01)
    assert harmless(found).effects == found.effects


@pytest.mark.parametrize(("one_in", "left"), [(2, 0), (32, 1)])
def test_few_poses_that_the_others_pull_are_not_harmed(monkeypatch, eccentric, one_in, left):
    """Fitted 3 % worse, alike in all poses of a campaign, and held out worse by chance."""
    found = as_group(
        monkeypatch, eccentric.discovery, lambda q: np.round(1e4 * q[:, 1]) % one_in < 1, 1.03
    )
    gap = found.holdout
    second = np.flatnonzero(gap.campaigns["second"])
    uneven = np.ones(len(gap.poses))
    uneven[second[::2]], uneven[second[1::2]] = 1.5, 0.6
    after = replace(gap.found_before, distance_mm=uneven * gap.found_before.distance_mm)
    after = gap.found_after.replaced_where(gap.campaigns["second"], after)
    done = harmless(replace(found, holdout=replace(gap, found_after=after)))
    assert len(done.effects) == left


def test_positions_visited_bridge_usual_gaps_only():
    rng = np.random.default_rng(1)
    q_rad = np.column_stack(
        [rng.uniform(-1.0, 1.0, 300), np.r_[np.zeros(150), np.ones(150)] + rng.uniform(0, 0.1, 300)]
    )
    visited = span_visited(q_rad)
    assert [len(stretches) for stretches in visited.intervals] == [1, 2]
    assert visited.inside(q_rad).all()
    assert not visited.inside(np.array([[0.0, 0.5], [1.2, 0.05]])).any()
    assert not nothing_seen(2).inside(q_rad).any()
