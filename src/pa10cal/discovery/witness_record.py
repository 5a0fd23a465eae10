"""What is known of the cause of a map, as a record."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

from pa10cal.discovery.blocked_cv.discover import VerdictByBlocks
from pa10cal.results.witness import Agreement, JointWitness, MotorRipple
from pa10cal.terms.effects.joint_error_map import JointErrorMap

if TYPE_CHECKING:
    from pa10cal.discovery.verdict import Verdict
    from pa10cal.terms.effects.effect import Effect


def witness_of(effect: Effect, found: Verdict[object]) -> JointWitness | None:
    """Return what says whose error an error by a joint's angle is; None where nothing does."""
    if not (isinstance(found, VerdictByBlocks) and isinstance(effect, JointErrorMap)):
        return None
    for each in found.causes:
        if each.joint == effect.joint and (each.witness or each.agreement):
            return JointWitness(
                ripple=None if each.witness is None else _ripple(asdict(each.witness)),
                agreement=None if each.agreement is None else Agreement(**asdict(each.agreement)),
            )
    return None


def ripple_words(witness: JointWitness) -> str:
    """Return what the ripple says in words that follow others; nothing where there is none."""
    ripple = witness.ripple
    if ripple is None:
        return ""
    low, high = ripple.interval95
    return (
        f"; its motor followed {ripple.alpha:.2f} of it ({low:.2f} to {high:.2f}), by lines at "
        f"{', '.join(map(str, ripple.orders))} times {ripple.ratio:g}"
    )


def _ripple(told: dict[str, object]) -> MotorRipple:
    """Return a witness as a record; the joint is that of the effect."""
    return MotorRipple(**{name: value for name, value in told.items() if name != "joint"})
