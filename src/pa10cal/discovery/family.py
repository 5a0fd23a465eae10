"""What a campaign can show of an effect: settled before residuals are looked at."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from pa10cal.arm.state import PoseStates
from pa10cal.errors import CalibrationError
from pa10cal.terms.effects.effect import CandidateContext, Effect
from pa10cal.terms.effects.family import candidates
from pa10cal.terms.faults.family import fault_candidates
from pa10cal.terms.faults.log_fault import LogFault
from pa10cal.terms.term import Term, shows_torque

#: Part of an effect that must remain after the model's own parameters took what they can.
LEAST_SHARE = 0.02
#: An effect of its largest plausible size must come to this many standard deviations in all.
LEAST_SIGNAL = 4.0
#: The largest plausible size, in the usual one.
_LARGEST = 10.0


def sought(context: CandidateContext, held: Iterable[Term] = ()) -> tuple[Effect, ...]:
    """Return what is sought: effects and faults of the log, wherever each may sit."""
    held = tuple(held)
    return (*candidates(context, held), *fault_candidates(context, held))


def is_fault(effect: Effect) -> bool:
    """Return whether something sought is a fault of the log, and no effect."""
    return isinstance(effect, LogFault)


def effects_in(family: Iterable[Effect]) -> int:
    """Return how many effects there are: faults do not make it harder to name one."""
    return sum(not is_fault(effect) for effect in family)


def why_unknown(effect: Effect, states: PoseStates, *, logged: bool, weights: bool) -> str | None:
    """Return why an effect cannot be predicted from what was logged; None where it can.

    Args:
        effect: which, and where.
        states: of complete poses.
        logged: whether torques were logged.
        weights: whether the torques of the weights are known.
    """
    calculated = getattr(effect, "of_calculated", False)
    if shows_torque(effect) and not (logged or calculated):
        return "the torques were not logged"
    start = effect.starts[0]
    try:
        columns = [effect.derivative(states, start) for start in effect.starts]
    except CalibrationError as error:
        return error.what
    if not all(np.all(np.isfinite(values)) for values in columns):
        return "what it depends on was not logged"
    if shows_torque(effect):
        if not (weights or calculated):
            return "the torques of the weights are not known"
        if not np.all(np.isfinite(effect.torque_derivative(states, start))):
            return "what it depends on was not logged"
    return None


def why_hidden(share: float, signal: float) -> str | None:
    """Return why poses cannot show an effect that moves something; None where they can.

    Args:
        share: part of it that remains after the model's own parameters took what they can.
        signal: what remains of its usual size, in standard deviations.
    """
    if share < LEAST_SHARE:
        return f"{100 * share:.1f} % remains beside the model's own parameters"
    if signal * _LARGEST < LEAST_SIGNAL:
        return "ten times its plausible size would not rise above the noise"
    return None
