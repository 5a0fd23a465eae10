"""A few wild trials, judged by the commands: what was put in is told, and nothing else is."""

import pytest

from pa10cal.command_settings import ChainOptions
from pa10cal_lab.blind_trial import BlindTrial
from pa10cal_lab.blind_trials import try_trial
from pa10cal_lab.cell.trials import draw_trials
from pa10cal_lab.scores import scores_record

#: Kind, what is put in, bench and seed of campaigns that are quick to judge.
CAMPAIGNS = [
    ("right", "", "irb120-pose", 4),
    ("right", "", "ur10-pose", 5),
    ("stressed", "heavy_tails", "irb120-distance", 6),
    ("stressed", "gross_errors", "irb120-pose", 6),
    ("effect", "backlash", "irb120-pose", 4),
    ("effect", "encoder_eccentricity", "irb120-pose", 16),  # without repeats
    ("effect", "cmm_scale", "irb120-points", 3),  # one scale; targets not all seen: no pose
    ("fault", "labels_exchanged", "irb120-points", 5),
    ("fault", "one_reading_off", "irb120-points", 4),
    ("fault", "places_exchanged", "irb120-points", 5),
    ("fault", "held_out_reading_off", "irb120-pose", 4),
    ("fault", "joint_zero", "irb120-pose", 5),
    ("fault", "joint_zero", "irb120-pose", 2),  # a departure, as held-out poses confirm
    ("fault", "joint_sign", "irb120-points", 5),
    ("fault", "unit", "irb120-distance", 4),
    ("fault", "uncertainty_off", "irb120-pose", 5),
]


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "put_in", "bench", "seed"), CAMPAIGNS)
def test_a_campaign_gets_the_verdict_that_it_should(kind, put_in, bench, seed):
    (trial,) = draw_trials(kind, 1, seed, "wild", (bench,), only=put_in)
    verdict, truth = try_trial(trial, ChainOptions())
    scores = scores_record([BlindTrial(truth, verdict)])
    assert scores.per_trial[0].failings == (), verdict.word
