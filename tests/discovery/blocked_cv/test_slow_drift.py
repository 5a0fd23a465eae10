"""A base that moves slowly while a campaign lasts, by too little to be a wander."""

from dataclasses import replace

import numpy as np
import pytest

from made_up_survey import POSITION_M, observe
from pa10cal.discovery.blocked_cv.by_blocks import discover_by_blocks
from pa10cal.discovery.blocked_cv.interleaved_check import SquaresByBlock, slow_drift
from pa10cal.discovery.preparation import Prepared
from pa10cal.fit.fitted_model import model_from_plain, model_to_plain

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
    assert finding.proof.rms_with_mm < finding.proof.rms_without_mm
    states = drifted.scorer.survey.poses.states
    part = (states.time_s - states.time_s[0]) / np.ptp(states.time_s)
    moved_m = finding.effect.shift(states, drifted.extended.of(finding.effect))
    up_m = moved_m @ drifted.baseline.T_instr_base[2, :3]
    expected_m = 2.0 * POSITION_M * course(part)
    off_m = up_m - up_m.mean() - expected_m + expected_m.mean()
    assert np.sqrt(np.mean(off_m**2)) < 0.25 * POSITION_M


@pytest.mark.slow
def test_it_is_held_where_nothing_is_known_of_it(drifted):
    (finding,) = drifted.effects
    states, x = drifted.scorer.survey.poses.states, drifted.extended.of(finding.effect)
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
