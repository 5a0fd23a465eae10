"""A search of a survey, again with what its residuals show."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import made_up_survey
from pa10cal.arm.description import weights_known
from pa10cal.arrays import rms
from pa10cal.discovery.blocked_cv import outcome
from pa10cal.discovery.blocked_cv.judge import Judged
from pa10cal.discovery.blocked_cv.linear_fit import held_out
from pa10cal.discovery.blocked_cv.survey import interleaved_blocks
from pa10cal.terms.effects.over_time import BaseDrift
from pa10cal.terms.effects.structure import AxisWobble


def test_a_wobble_at_a_link_that_does_not_bend_in_the_baseline_is_judged(monkeypatch):
    # Where nobody stated the weights, only the long links and those of effects bend.
    arm = made_up_survey.ARM
    assumed = replace(weights_known(arm), origin="assumed")
    monkeypatch.setattr(made_up_survey, "ARM", replace(arm, weights_known=assumed))
    survey = made_up_survey.observe(poses=110, held_out=0).survey
    assert 5 not in survey.baseline.model.chain.bends
    shown = iter([(AxisWobble("joint 6"),), ()])
    monkeypatch.setattr(outcome, "gear_lines", lambda *_: ())
    monkeypatch.setattr(outcome, "wobbles", lambda *_: next(shown))
    assert outcome.search_with_motion(survey).outcome.extended.effects == ()
    assert next(shown, None) is None  # others were sought beside it


@pytest.fixture(scope="module")
def plain():
    return outcome.search_survey(made_up_survey.observe(poses=110, held_out=0).survey)


def test_the_error_of_held_out_blocks_is_that_of_the_search_where_nothing_is_added(plain):
    again = held_out(plain.rows, plain.linear_fit)
    np.testing.assert_array_equal(again.block, plain.survey.block)
    np.testing.assert_allclose(again.errors_mm, plain.held_out.errors_mm, rtol=0.02, atol=1e-4)
    assert again.expected_over_noise == pytest.approx(plain.held_out.expected_over_noise, rel=0.01)


def test_with_a_drift_it_is_that_of_interleaved_blocks_by_the_model_that_has_it(plain):
    time_s = plain.survey.poses.states.time_s
    drift = BaseDrift("base", time_s.min(), time_s.max(), 6)
    found = outcome.with_effects_added(plain, [Judged(drift, None, ())])
    assert found.extended.effects == (drift,)
    np.testing.assert_array_equal(found.held_out.block, interleaved_blocks(len(time_s)))
    left_out = plain.interleaved_check.squares([drift]).rms_mm
    assert rms(found.held_out.errors_mm) == pytest.approx(left_out, rel=0.03)


@pytest.mark.parametrize(("poses", "sought"), [(99, False), (100, True)])
def test_what_moved_in_time_is_not_sought_in_few_poses(monkeypatch, poses, sought):
    class SoughtError(Exception):
        pass

    def motion(searched):
        raise SoughtError

    for name in ("_with_warm_ups", "_with_lines_and_wobbles"):
        monkeypatch.setattr(outcome, name, lambda given: given)
    monkeypatch.setattr(outcome, "_with_motion_shown", motion)
    survey = SimpleNamespace(poses=range(poses))
    if sought:
        with pytest.raises(SoughtError):
            outcome.search_with_motion(survey)
    else:
        assert outcome.search_with_motion(survey).in_time is outcome.NO_MOTION
