"""Every effect at every place of the PA10, and poses in which all of them show."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from made_up_poses import context_of, states_of
from pa10cal.arm.statics import PoseStates
from pa10cal.files.arms import load_arm
from pa10cal.terms.effects.effect import CandidateContext, Effect, candidates

ARM = load_arm("pa10_6ce")


def some_states() -> PoseStates:
    rng = np.random.default_rng(20080427)
    tau_Nm = rng.uniform(-0.6, 0.6, (6, ARM.n)) * ARM.torque_limit_Nm
    return states_of(ARM, 20080427, 6, tau_Nm=tau_Nm)


def some_surroundings() -> CandidateContext:
    states = some_states()
    return context_of(
        ARM,
        flexible_joints=(2, 3, 5),
        tau_span_Nm=np.abs(states.tau_Nm).max(0),
        q_span_rad=np.stack([states.q_rad.min(0), states.q_rad.max(0)], axis=-1),
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
    return ARM


@pytest.fixture
def context() -> CandidateContext:
    return some_surroundings()


@pytest.fixture
def states() -> PoseStates:
    return some_states()


@pytest.fixture
def at() -> Places:
    return Places(candidates(some_surroundings()))
