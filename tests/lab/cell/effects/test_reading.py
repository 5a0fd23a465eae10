"""Sensors and gears that err, and where their motors stop."""

import numpy as np
import pytest

from pa10cal.errors import SettingsError
from pa10cal_lab.cell.effects.effect import JointState, Site
from pa10cal_lab.cell.effects.vocabulary import all_effects, make_effects, nameless, vocabulary
from pa10cal_lab.cell.options import HiddenEffectOptions

RNG = np.random.default_rng(8)
Q = RNG.uniform(-3.0, 3.0, (40, 6))
S = RNG.choice([-1.0, 0.0, 1.0], (40, 6))
MOTION = JointState(Q, S, np.full(6, np.nan))
RIPPLE = {"ratio": 101.0, "cogs": [4, 20], "ripple": [2e-5, 1e-5], "ripple_phi": [0.3, -1.0]}
ERROR = {"orders": [6, 11], "A": [2e-4, 1e-4], "phi": [0.1, 2.0]}


def by_angle(q):
    return 2e-4 * np.sin(6 * q + 0.1) + 1e-4 * np.sin(11 * q + 2.0)


def ripple(motor, s):
    off = 2e-5 * np.sin(404 * motor + 0.3) + 1e-5 * np.sin(2020 * motor - 1.0)
    return np.where(s == 0.0, 0.0, off)


FORMS = [
    ("motor_ripple", RIPPLE, ripple),
    ("gear_error", {**RIPPLE, **ERROR}, lambda q, s: by_angle(q) + ripple(q, s)),
    ("sensor_error", {**RIPPLE, **ERROR}, lambda q, s: by_angle(q) + ripple(q + by_angle(q), s)),
]


@pytest.mark.parametrize(("name", "parameters", "form"), FORMS)
def test_turns_its_joint_by_its_form(name, parameters, form):
    turn = all_effects()[name](**parameters).at("joint 3").added(MOTION)
    assert turn[:, 2] == pytest.approx(form(Q[:, 2], S[:, 2]), abs=1e-16)
    assert np.abs(np.delete(turn, 2, axis=1)).max() == 0.0


def test_no_trial_but_those_of_their_own_study_draws_them():
    own = {"motor_ripple", "sensor_error", "gear_error"}
    assert own <= set(all_effects())
    assert not own & {*vocabulary(), *nameless()}


@pytest.mark.parametrize("name", ["motor_ripple", "sensor_error", "gear_error"])
def test_usual_sizes_make_an_effect(robot, name):
    drawn = all_effects()[name].at_size(Site("joint 2"), 1.0, np.random.default_rng(3))
    (effect,) = make_effects([HiddenEffectOptions(id=name, of="joint 2", parameters=drawn)], robot)
    rms_rad = effect.added(MOTION)[:, 1].std()
    assert 2e-5 < rms_rad < 1e-4 if name == "motor_ripple" else 1.5e-4 < rms_rad < 4e-4


@pytest.mark.parametrize("short", ["ripple", "ripple_phi", "A", "phi"])
def test_lists_are_as_long_as_what_they_belong_to(robot, short):
    parameters = {**RIPPLE, **ERROR, short: [0.1]}
    with pytest.raises(SettingsError, match=f"{short}.*as many as"):
        make_effects(
            [HiddenEffectOptions(id="gear_error", of="joint 2", parameters=parameters)], robot
        )
