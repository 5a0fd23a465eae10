"""Every effect at every place of the PA10, and poses in which all of them show."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from pa10cal.arm.statics import ObservedTargets, PoseStates, StaticLoads
from pa10cal.files.arms import load_arm
from pa10cal.terms.effects.effect import CandidateContext, Effect, candidates

POSES, TARGETS = 6, 3


def some_states() -> PoseStates:
    rng = np.random.default_rng(20080427)
    arm = load_arm("pa10_6ce")
    down = rng.normal(size=(POSES, 3))
    return PoseStates(
        q_rad=rng.uniform(-1.5, 1.5, (POSES, arm.n)),
        tau_Nm=rng.uniform(-0.6, 0.6, (POSES, arm.n)) * arm.torque_limit_Nm,
        arrival=rng.choice([-1.0, 1.0], (POSES, arm.n)),
        load_N=rng.choice([0.0, 44.0], POSES),
        temperature_C=rng.uniform(19.0, 27.0, POSES),
        time_s=np.sort(rng.uniform(100.0, 4e4, POSES)),
        static_loads=StaticLoads(
            link_Nm=rng.uniform(-60.0, 60.0, (POSES, arm.n, 3)),
            base_Nm=rng.uniform(-100.0, 100.0, (POSES, 3)),
            joint_Nm=rng.uniform(-60.0, 60.0, (POSES, arm.n)),
            down_ee=down / np.linalg.norm(down, axis=1, keepdims=True),
            by_weights=rng.normal(size=(POSES, arm.n, 4 * arm.n + 3)),
            by_load=rng.normal(size=(POSES, arm.n)),
        ),
        seen=ObservedTargets(
            p_instr_targets_m=rng.uniform(0.0, 0.9, (POSES, TARGETS, 3)),
            pose_by_targets=rng.normal(size=(POSES, 6, 3 * TARGETS)),
        ),
    )


def some_surroundings() -> CandidateContext:
    states = some_states()
    return CandidateContext(
        arm=load_arm("pa10_6ce"),
        flexible_joints=(2, 3, 5),
        reference_temperature_C=21.0,
        tau_span_Nm=np.abs(states.tau_Nm).max(0),
        T_instr_base=np.eye(4),
        p_instr_middle_m=np.array([0.4, 0.5, 0.6]),
        q_span_rad=np.stack([states.q_rad.min(0), states.q_rad.max(0)], axis=-1),
        time_span_s=(100.0, 4e4),
        commanded=True,
    )


@dataclass
class Places:
    """Effects by id and place."""

    effects: tuple[Effect, ...]

    def __call__(self, name: str, of: str) -> Effect:
        (found,) = [effect for effect in self.effects if (effect.id, effect.of) == (name, of)]
        return found


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "effect" in metafunc.fixturenames:
        found = candidates(some_surroundings())
        metafunc.parametrize("effect", found, ids=[f"{each.id} of {each.of}" for each in found])


@pytest.fixture
def arm():
    return load_arm("pa10_6ce")


@pytest.fixture
def context() -> CandidateContext:
    return some_surroundings()


@pytest.fixture
def states() -> PoseStates:
    return some_states()


@pytest.fixture
def at() -> Places:
    return Places(candidates(some_surroundings()))
