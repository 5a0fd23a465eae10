"""A search of a survey, again with what its residuals show."""

from dataclasses import replace

import made_up_survey
from pa10cal.arm.description import weights_known
from pa10cal.discovery.blocked_cv import outcome
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
