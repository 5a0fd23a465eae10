"""Settings of a curve that do not fit, or would do nothing, are refused with what is allowed."""

import re

import pytest

from pa10cal.errors import CurveError, SettingsError
from pa10cal.settings_reading import parse_section
from pa10cal_curve.curve import circle
from pa10cal_curve.gait import follow
from pa10cal_curve.options import CurveOptions

HELIX = {"shape": "helix", "radius_m": 0.2, "pitch_m": 0.4, "turns": 1.5}
WAVE = {"moves": "wave", "period_s": 2.0, "seconds": 1.0}
SOUND = {"curve": HELIX, "link_m": 0.1, "links": 5}


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"curve": {**HELIX, "turns": -1}}, "key curve.turns .*allowed: greater than 0; set"),
        ({"curve": {**HELIX, "radius_m": "x"}}, "key curve.radius_m .*allowed: a valid number"),
        (
            {"curve": {**HELIX, "shape": "helics"}},
            r"key curve.shape does not fit \(got 'helics'\); allowed: 'line', 'circle', 'helix', "
            "'serpenoid'; did you mean 'helix'",
        ),
        ({"curve": {"radius_m": 1.0}}, "missing key curve.shape"),
        ({"roll_deg": 50.0}, "allowed: roll: given, where roll_deg is stated"),
        ({"z_of_last": [1.0, 0.0, 0.0]}, "allowed: roll: of_last, where z_of_last is stated"),
        ({"through": "straight"}, "allowed: through for points alone"),
        ({"gait": {**WAVE, "moves": "roll", "move_deg": 5.0}}, "allowed: a wave or along, at"),
        ({"gait": {**WAVE, "move_deg": 5.0}, "roll": "given"}, "allowed: a wave or along"),
        ({"gait": {**WAVE, "period_s": None}}, "allowed: gait.speed_m_s with moves: along"),
        ({"gait": {**WAVE, "speed_m_s": 1.0}}, "allowed: gait.speed_m_s with moves: along"),
        ({"gait": {**WAVE, "moves": "along"}}, "allowed: gait.speed_m_s with moves: along"),
    ],
)
def test_what_does_not_fit_or_would_do_nothing_is_refused(changed, message):
    with pytest.raises(SettingsError, match=message):
        parse_section(CurveOptions, {**SOUND, **changed}, where="--settings")


@pytest.mark.parametrize(
    "changed",
    [
        {"roll": "given", "roll_deg": 50.0},
        {"roll": "of_last", "z_of_last": [1.0, 0.0, 0.0]},
        {"curve": None, "through": "straight"},
        {"gait": {**WAVE, "moves": "roll"}, "roll_deg": 50.0},
        {"gait": {**WAVE, "move_deg": 5.0}},
    ],
)
def test_settings_that_were_recorded_are_read_again(changed):
    options = parse_section(CurveOptions, {**SOUND, **changed}, where="--settings")
    again = parse_section(CurveOptions, options.model_dump(mode="json"), where="curve.json")
    assert again == options


def test_a_curve_that_stays_near_its_beginning_is_refused_with_the_reason():
    options = parse_section(CurveOptions, {"link_m": 2.5}, where="--settings")
    said = re.escape(
        "link_m: the curve stays within a link's length of where the links begin (got 2.5); "
        "allowed: less than 2 m or so, as far as it gets"
    )
    with pytest.raises(CurveError, match=said):
        follow([circle(1.0)], [0.0], options)
