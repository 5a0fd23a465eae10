"""Every effect at every place of the PA10, some of it on a rail, and poses in which all show."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from made_up_poses import context_of, states_of
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import PoseStates
from pa10cal.files.arms import load_arm
from pa10cal.terms.effects.context import CandidateContext
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.structure import AxisWobble
from pa10cal.terms.effects.vocabulary import candidates
from pa10cal.terms.effects.warm_up import warm_ups

ARM = load_arm("pa10_6ce")
SLIDES = np.array([True, False, False, False, False, True])
SLIDING = replace(ARM, name="sliding", prismatic=SLIDES)
#: Effects of joints that slide.
OF_SLIDES = ("slide_bending", "slide_error", "slide_positioning")


def some_states() -> PoseStates:
    rng = np.random.default_rng(20080427)
    tau_Nm = rng.uniform(-0.6, 0.6, (6, ARM.n)) * ARM.torque_limit_Nm
    return states_of(ARM, 20080427, 6, tau_Nm=tau_Nm)


def some_surroundings(arm: Arm = ARM) -> CandidateContext:
    states = some_states()
    return context_of(
        arm,
        flexible_joints=(2, 3, 5),
        largest_tau_Nm=np.abs(states.tau_Nm).max(0),
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
        slides = candidates(some_surroundings(SLIDING))
        found += tuple(each for each in slides if each.id in OF_SLIDES)
        turning = replace(some_surroundings(), q_span_rad=np.tile([-2.0, 2.0], (ARM.n, 1)))
        found += (*AxisWobble.everywhere(turning), *warm_ups(turning))
        metafunc.parametrize("effect", found, ids=[f"{each.id} of {each.of}" for each in found])


@pytest.fixture
def arm(request) -> Arm:
    """Return the arm that the effect is of."""
    parameters = request.node.callspec.params if hasattr(request.node, "callspec") else {}
    effect = parameters.get("effect")
    return SLIDING if effect is not None and effect.id in OF_SLIDES else ARM


@pytest.fixture
def context(arm) -> CandidateContext:
    return some_surroundings(arm)


@pytest.fixture
def states() -> PoseStates:
    return some_states()


@pytest.fixture
def at(arm) -> Places:
    return Places(candidates(some_surroundings(arm)))


@pytest.fixture
def at_slides() -> Places:
    return Places(candidates(some_surroundings(SLIDING)))
