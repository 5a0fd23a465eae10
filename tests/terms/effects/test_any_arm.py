"""The vocabulary on every arm that comes with the package, whatever is known of it."""

from dataclasses import replace

import numpy as np
import pytest

from pa10cal.arm.chain import Chain
from pa10cal.arm.statics import ObservedTargets, PoseStates, StaticLoads
from pa10cal.errors import CalibrationError
from pa10cal.files.arms import arm_names, load_arm
from pa10cal.terms.effects.effect import CandidateContext, candidates

CARRIED_NM = 30.0


def context_of(arm, tau_span_Nm):
    return CandidateContext(
        arm=arm,
        flexible_joints=(2,),
        reference_temperature_C=21.0,
        tau_span_Nm=tau_span_Nm,
        T_instr_base=np.eye(4),
        p_instr_middle_m=np.array([0.4, 0.5, 0.6]),
        q_span_rad=np.tile([-1.5, 1.5], (arm.n, 1)),
        time_span_s=(100.0, 4e4),
        commanded=True,
    )


def states_of(arm, poses=5):
    rng = np.random.default_rng(3)
    return PoseStates(
        q_rad=rng.uniform(-1.5, 1.5, (poses, arm.n)),
        tau_Nm=rng.uniform(-CARRIED_NM, CARRIED_NM, (poses, arm.n)),
        arrival=rng.choice([-1.0, 1.0], (poses, arm.n)),
        load_N=np.zeros(poses),
        temperature_C=rng.uniform(19.0, 27.0, poses),
        time_s=np.sort(rng.uniform(100.0, 4e4, poses)),
        static_loads=StaticLoads(
            rng.normal(size=(poses, arm.n, 3)),
            rng.normal(size=(poses, 3)),
            rng.normal(size=(poses, arm.n)),
            np.tile([0.0, 0.0, -1.0], (poses, 1)),
            rng.normal(size=(poses, arm.n, 4 * arm.n + 3)),
            rng.normal(size=(poses, arm.n)),
        ),
        seen=ObservedTargets(rng.uniform(0.0, 0.9, (poses, 2, 3)), rng.normal(size=(poses, 6, 6))),
    )


@pytest.mark.parametrize("name", arm_names())
def test_every_effect_moves_a_chain_that_there_is(name):
    arm = load_arm(name)
    chain, states = Chain.of(arm, bends=tuple(range(1, arm.n))), states_of(arm)
    found = candidates(context_of(arm, np.full(arm.n, CARRIED_NM)))
    turning = {f"joint {joint}" for joint in np.flatnonzero(~arm.prismatic) + 1}
    assert turning == {effect.of for effect in found if effect.of.startswith("joint")}
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
    assert context_of(arm, carried_Nm).rated_Nm.tolist() == arm.torque_limit_Nm.tolist()
    assert context_of(unrated, carried_Nm).rated_Nm.tolist() == [5, 100, 60, 8, 5, 5]
