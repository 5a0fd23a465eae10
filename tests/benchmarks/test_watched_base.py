"""Targets on the base give back what a drifting tracker costs."""

import numpy as np
import pytest
from benchmarks.watched_base import WALK_MM, campaign_of

import pa10cal
from mended import write_simulated


@pytest.mark.slow
def test_held_out_errors_and_intervals_are_nearly_those_of_a_tracker_that_stands_still():
    seeds = range(4)
    still, lost, watched = (
        [campaign_of(seed, base, walk_mm) for seed in seeds]
        for base, walk_mm in ((0, 0.0), (0, WALK_MM), (3, WALK_MM))
    )

    def held_out(found):
        return np.sqrt(np.mean([each.held_out_mm**2 for each in found]))

    def rms_score(found):
        return np.sqrt(np.mean(np.concatenate([each.scores for each in found]) ** 2))

    assert held_out(lost) > 2.0 * held_out(still)
    assert held_out(watched) < 1.2 * held_out(still)
    assert rms_score(watched) < 1.25
    assert rms_score(lost) > rms_score(watched)


@pytest.mark.slow
def test_a_base_that_drifts_with_its_targets_is_not_named_a_second_time(tmp_path):
    for base, named in ((0, True), (3, False)):
        asked = {
            "random_seed": 4,
            "robot": "irb120",
            "hidden_effects": [
                {"id": "base_drift", "of": "base", "parameters": {"rate": [6e-5, 4e-5, -5e-5]}}
            ],
            "without_touches": {
                "instrument": "points",
                "poses": 300,
                "base_targets": base,
                "position_mm": 0.02,
                "seconds_a_pose": 40.0,
            },
        }
        campaign = pa10cal.read_campaign(write_simulated(tmp_path / str(base), asked))
        verdict = pa10cal.discover(campaign, pa10cal.calibrate(campaign))
        assert [effect.id for effect in verdict.effects] == ["base_drift"] * named
        assert verdict.verdict == ("named" if named else "none")
