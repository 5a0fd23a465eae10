"""Poses to measure next of campaigns without repeats: angles not seen, and rivals."""

from dataclasses import replace

import numpy as np
import pytest

from pa10cal.discovery.next_poses import poses_at_unseen_angles
from pa10cal.fit.angles_seen import AngleCoverage, angles_seen
from pa10cal.terms.effects.effect import candidates

TURN = 2.0 * np.pi


class TestFill:
    def test_suggested_poses_take_joints_to_angles_not_seen(self, nothing_hidden):
        survey = nothing_hidden.survey
        seen = angles_seen(survey.poses.states.q_rad, np.ones(6, dtype=bool))
        found = poses_at_unseen_angles(survey, seen, 5)
        assert len(found) == 5
        for pose in found:
            new = ~seen.each(pose.q_rad[None])[0]
            joints = np.flatnonzero(new) + 1
            assert pose.for_ == tuple(f"angle of joint {j} not seen" for j in joints)
        joints = [len(pose.for_) for pose in found]
        assert joints == sorted(joints, reverse=True)
        limits = survey.context.arm.limits_rad
        q_rad = np.array([pose.q_rad for pose in found])
        assert np.all((q_rad > limits[:, 0]) & (q_rad < limits[:, 1]))

    @pytest.mark.parametrize("count", [0, 3])
    def test_there_are_none_where_all_was_seen(self, nothing_hidden, count):
        whole = AngleCoverage((np.array([[0.0, TURN]]),) * 6, (True,) * 6)
        assert poses_at_unseen_angles(nothing_hidden.survey, whole, count) == ()


def test_what_is_ambiguous_among_poses_without_repeats_comes_apart_too(eccentric):
    verdict = eccentric.discovery
    (finding,) = verdict.findings
    (rival,) = (
        each
        for each in candidates(verdict.context)
        if (each.id, each.of) == ("gear_ratio_error", finding.of)
    )
    ambiguous = replace(verdict, findings=(replace(finding, alternatives=(rival,)),))
    found = ambiguous.next_poses(3)
    (separation,) = found.separations
    nats = [separation.before_nats, *(pose.separation_nats for pose in found.poses)]
    assert len(nats) == 4
    assert np.all(np.diff(nats) > 0.0)
    assert separation.after_nats == nats[-1]
    assert verdict.next_poses(3).separations is None
