"""Trials of axes that wobble hide one, of a size against the noise, and bearings hide none."""

import pytest
from benchmarks.axis_wobbles import drawn, moved_mm, not_geometry

from pa10cal.files.arms import load_arm


@pytest.mark.parametrize("number", [0, 1, 2])
def test_a_wobble_moves_the_tool_by_so_many_times_the_noise(number):
    trial = drawn("wobbles", number, 111)
    (hidden,) = trial.settings.hidden_effects
    assert hidden.id == "axis_wobble"
    arm, joint = load_arm(trial.settings.robot), int(hidden.of.removeprefix("joint "))
    moved = moved_mm(arm, joint, not_geometry(hidden.parameters))
    noise_mm = trial.settings.without_touches.position_mm
    assert moved / 3**0.5 / noise_mm == pytest.approx((1.5, 6.0, 3.0)[number])


def test_a_bearing_is_no_wobble():
    (hidden,) = drawn("bearings", 3, 511).settings.hidden_effects
    assert hidden.id == "soft_bearing"
