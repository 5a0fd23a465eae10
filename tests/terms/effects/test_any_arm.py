"""The vocabulary on every arm that comes with the package, whatever is known of it."""

from dataclasses import replace

import numpy as np
import pytest

from made_up_poses import context_of, states_of
from pa10cal.arm.chain import Chain
from pa10cal.errors import CalibrationError
from pa10cal.files.arms import arm_names, load_arm
from pa10cal.terms.effects.joint import moved_along
from pa10cal.terms.effects.vocabulary import candidates


@pytest.mark.parametrize("name", arm_names())
def test_every_effect_moves_a_chain_that_there_is(name):
    arm = load_arm(name)
    chain, states = Chain.of(arm, bends=tuple(range(1, arm.n))), states_of(arm)
    found = candidates(context_of(arm))
    at_joints = {f"joint {joint}" for joint in range(1, arm.n + 1)}
    assert {f"joint {joint}" for joint in moved_along(arm)} <= at_joints
    assert at_joints == {effect.of for effect in found if effect.of.startswith("joint")}
    for effect in found:
        assert len(chain.columns(effect.coordinates)) == len(effect.coordinates)
        assert all(np.isfinite(parameter.plausible or 1.0) for parameter in effect.parameters)
        if effect.id == "transmission_error" and np.isnan(arm.gear_ratio).any():
            with pytest.raises(CalibrationError, match=r"gear ratio.*is not known"):
                effect.derivative(states, effect.starts[0])
            continue
        for start in effect.starts:
            assert np.isfinite(effect.derivative(states, start)).all()


def test_sizes_go_by_what_joints_carried_where_their_rating_is_not_known():
    arm = load_arm("ur10")
    carried_Nm = np.array([0.0, 100.0, 60.0, 8.0, 5.0, 1.0])
    unrated = replace(arm, torque_limit_Nm=np.full(6, np.nan))
    assert (
        context_of(arm, largest_tau_Nm=carried_Nm).rated_Nm.tolist() == arm.torque_limit_Nm.tolist()
    )
    sizes = context_of(unrated, largest_tau_Nm=carried_Nm).rated_Nm
    assert sizes.tolist() == [5, 100, 60, 8, 5, 5]
