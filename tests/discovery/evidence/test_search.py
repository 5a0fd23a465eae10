"""Forward steps, backward looks, full refits: the right set comes out, and proxies go again."""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

from made_up_arm import ERROR_RATE, Missing, harmonic, measure
from pa10cal.discovery.evidence import search as searching
from pa10cal.discovery.evidence.fit import fit
from pa10cal.discovery.evidence.likelihood import Addition
from pa10cal.discovery.evidence.noise_model import NO_SHARED_ERROR
from pa10cal.discovery.evidence.search import evidence_about, less, refit, search
from pa10cal.discovery.proof import needed_nats
from pa10cal.terms.effects.effect import JointEffect
from pa10cal.terms.term import TermParameter


def names(effects):
    return [(effect.id, effect.of) for effect in effects]


@dataclass(frozen=True)
class Proxy(JointEffect):
    """Both waves in one: joints 2 and 3 err alike."""

    id: ClassVar[str] = "proxy"
    formula = "made up"

    @property
    def coordinates(self):
        return ("theta_2", "theta_3")

    @property
    def reported(self):
        return (TermParameter("A", "rad", 1e-5, plausible=3e-4),)

    def derivative(self, states, x):
        return np.sin(100.0 * states.q_rad[:, 1:3])[:, :, None]


@pytest.fixture(scope="module")
def two_waves():
    """A transmission error at joints 2 and 3, the second one weaker."""
    second, third = harmonic(2, 100.0, 2e-4, 0.5), harmonic(3, 100.0, 1.5e-4, 0.5)
    return measure(Missing(turn=lambda states: second(states) + third(states)))


def test_where_nothing_is_missing_nothing_is_found(null):
    found = null.found
    assert found.fit.effects == ()
    assert found.without == ()
    assert found.score.log_evidence == found.nothing.log_evidence
    # What is left is the noise: no pose is off by more than its readings.
    assert found.score.variances.pose < 0.05
    gains = found.evidence.additions((), list(range(len(found.family))))
    assert max(gain for gain, _ in gains) < needed_nats(len(found.family), ERROR_RATE)


@pytest.mark.slow
def test_two_effects_found_together_make_the_data_likelier_and_leave_less(two_waves):
    found = two_waves.found
    assert names(found.fit.effects) == [("transmission_error", f"joint {j}") for j in (2, 3)]
    gain_nats = found.score.log_evidence - found.nothing.log_evidence
    assert gain_nats > needed_nats(len(found.family), ERROR_RATE)
    residuals = found.fit.at.compared(found.problem.cells).residual[:, :3]
    start = two_waves.start.at.compared(two_waves.problem.cells).residual[:, :3]
    assert (residuals**2).sum() < 0.3**2 * (start**2).sum()


def test_a_proxy_that_came_first_is_dropped_when_the_right_effects_enter(two_waves):
    proxy = Proxy("joint 2")
    right = tuple(two_waves.effect("transmission_error", f"joint {j}") for j in (2, 3))
    family = (proxy, *right, two_waves.effect("encoder_eccentricity", "joint 1"))
    first = evidence_about(two_waves.problem, two_waves.start, family)
    gains = [gain for gain, _ in first.additions((), list(range(len(family))))]
    assert np.argmax(gains) == 0
    found = search(two_waves.problem, family, ERROR_RATE, two_waves.start)
    assert set(found.fit.effects) == set(right)


def test_a_proxy_found_before_is_dropped_when_the_right_effects_may_enter(two_waves):
    proxy = Proxy("joint 2")
    right = tuple(two_waves.effect("transmission_error", f"joint {j}") for j in (2, 3))
    alone = search(two_waves.problem, (proxy,), ERROR_RATE, two_waves.start)
    assert alone.fit.effects == (proxy,)
    assert alone.score.variances.pose > 1.0  # much is left
    evidence = evidence_about(alone.problem, alone.fit, (proxy, *right))
    scores = {
        members: max(
            evidence.score(tuple((k, size) for k in members)).log_evidence for size in range(3)
        )
        for members in ((0,), (0, 1), (0, 1, 2), (1, 2))
    }
    assert scores[0,] < scores[0, 1] < scores[1, 2]
    assert scores[0, 1, 2] - scores[1, 2] < needed_nats(3, ERROR_RATE)


@pytest.mark.parametrize("right_first", [True, False])
def test_of_sets_that_replace_each_other_the_likeliest_is_the_end(
    two_waves, monkeypatch, right_first
):
    right = tuple(two_waves.effect("transmission_error", f"joint {j}") for j in (2, 3))
    family = (Proxy("joint 2"), *right)
    sets = [((1, 1), (2, 1)), ((0, 1),)]
    in_turn = iter((sets if right_first else sets[::-1]) * 2)
    monkeypatch.setattr(searching, "_improve", lambda *_: next(in_turn))
    found = search(two_waves.problem, family, ERROR_RATE, two_waves.start)
    assert found.fit.effects == right


def test_evidence_that_is_not_a_number_ends_the_steps():
    class Nothing:
        def score(self, chosen):
            return SimpleNamespace(log_evidence=np.nan)

        def additions(self, chosen, open_to):
            return [Addition(np.nan, 0)] * len(open_to)

    same = np.eye(3, dtype=bool)
    assert searching._forward(Nothing(), same, ((0, 0),), set()) == ((0, 0),)


def test_a_family_of_none_or_one_is_searched_too(wave):
    nothing = search(wave.problem, (), ERROR_RATE, wave.start)
    assert nothing.fit.effects == ()
    effect = wave.effect("transmission_error", "joint 2")
    assert search(wave.problem, (effect,), ERROR_RATE, wave.start).fit.effects == (effect,)


def test_noise_is_worked_out_about_the_better_model(rubbing):
    friction = rubbing.effect("friction_torque", "joint 3")
    problem, found = refit(rubbing.problem, (friction,), (1,), NO_SHARED_ERROR, rubbing.start)
    assert problem.readings is not None
    assert found.at.values_of(friction) == pytest.approx([3.0], rel=0.01)
    # Friction of either sign in the torque of a spring is no scatter of repeats.
    np.testing.assert_allclose(problem.noise.torque_Nm, 0.05, rtol=0.25)
    again = fit(problem, (friction,), (1,), NO_SHARED_ERROR, found)
    np.testing.assert_allclose(again.x, found.x, rtol=1e-3, atol=1e-9)


def test_the_threshold_is_that_of_the_family():
    assert needed_nats(80, 0.01) == pytest.approx(np.log(8000.0))
    assert needed_nats(0, 1.0) == needed_nats(1, 1.0) == 0.0
    assert less((4, 5, 6), 1) == (4, 6)
