"""Commanded joints that all stop a little short, and orientations that lag by themselves."""

from dataclasses import replace

import numpy as np
import pytest

from made_up_survey import ATTITUDE_RAD, POSITION_M, Hidden, observe
from pa10cal.discovery.blocked_cv.by_blocks import discover_by_blocks
from pa10cal.discovery.preparation import Prepared
from pa10cal.terms.effects.arrivals import ArrivalError

#: By what each joint stops beyond its command [rad]; those of the wrist move the target little.
SHORT_RAD = -np.array([1.2, 1.1, 1.8, 0.0, 0.0, 0.0]) * POSITION_M
#: Scatter of where joints come to stand: what no model explains, and three times as large [rad].
STOPS_RAD = 3.0 * POSITION_M
POSES = 1200


def judged(hidden, commanded=True):
    surveyed = observe(hidden, poses=POSES, held_out=60)
    setup = replace(surveyed.setup, commanded=commanded)
    held_out = surveyed.held_out
    given = Prepared(surveyed.readings, held_out, surveyed.baseline, setup, "masses", False)
    return discover_by_blocks(given)


def short(came):
    stops = np.random.default_rng(3).normal(0.0, STOPS_RAD, came.arrival.shape)
    return SHORT_RAD * came.arrival + stops * [1, 1, 1, 0, 0, 0]


def lags(came, axes):
    """Orientations turn about joint 5 with the way it came."""
    return 2.0 * ATTITUDE_RAD * came.arrival[:, 4, None] * axes[:, :, 4]


@pytest.fixture(scope="module")
def stopped():
    return judged(Hidden(turn=short, twist=lags))


def found_rad(verdict):
    """What each joint stops by, of those that are named, with its standard uncertainty."""
    extended = verdict.extended
    at = {each.effect: extended.columns_of(each.effect) for each in verdict.effects}
    return {
        effect.joint: (extended.x[at].item(), np.sqrt(extended.covariance[at, at]).item())
        for effect, at in at.items()
        if isinstance(effect, ArrivalError)
    }


@pytest.mark.slow
def test_every_joint_that_stops_short_is_named_with_its_amount(stopped):
    found = found_rad(stopped)
    assert set(found) == {1, 2, 3}
    for joint, (amount_rad, std_rad) in found.items():
        assert abs(amount_rad - SHORT_RAD[joint - 1]) < 4.0 * std_rad
        assert std_rad < 0.5 * abs(SHORT_RAD[joint - 1])
    assert stopped.holdout.after.rms_mm < stopped.holdout.before.rms_mm


@pytest.mark.slow
def test_attitudes_that_lag_are_told_apart_from_joints(stopped):
    (place,) = (each for each in stopped.unexplained if each.form == "attitude_lag")
    assert place.of == "instrument"
    assert "the way that joint 5 (" in place.why
    lag = stopped.scorer.survey.lag
    np.testing.assert_allclose(lag.amounts * lag.sizes, [0, 0, 0, 0, 2e-4, 0], atol=4e-5)


@pytest.mark.slow
def test_nothing_is_named_where_every_joint_arrives():
    quiet = judged(Hidden())
    assert quiet.effects == ()
    assert quiet.unexplained == ()
    assert quiet.scorer.survey.lag is None


@pytest.mark.slow
def test_angles_that_were_read_back_hide_no_arrival():
    read = judged(Hidden(turn=short), commanded=False)
    assert found_rad(read) == {}
    assert read.scorer.survey.lag is None
