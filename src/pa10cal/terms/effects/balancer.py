"""What helps a joint against gravity, or what it carries beyond the description of the weights."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from pa10cal.arm.description import weights_known
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.terms.effects.effect import CandidateContext, JointEffect
from pa10cal.terms.term import JointTorqueOnly, TermParameter

#: Plausible torque of a balancer, as part of the weights' that goes with the joint's angle; and of
#: it the part out of gravity's phase, as of pins 11 degrees off, and that of twice the angle.
_SHARE, _ACROSS, _TWICE = 0.3, 0.2, 0.3
#: Torque of the weights from which on a joint as well has a balancer as a false sensor [N m].
_BALANCED_NM = 1e3


@dataclass(frozen=True)
class Balancer(JointTorqueOnly, JointEffect):
    """A torque that goes with the joint's angle and moves the arm through the joint's spring.

    A counterweight or a spring of constant rate and no free length puts a sine of the angle on the
    joint, as gravity does on a link; a gas spring or cylinder between two pins also a part of twice
    the angle. The mass or the centre of the joint's own link stated wrongly puts the same sine
    there. It is possible at the first joint that lifts the arm: of this the torque of its own link
    goes with its angle alone, and there balancers are. Logged torques are less by it already.
    """

    # sine and cosine part of the torque that the described weights put there [N m]
    weights_Nm: tuple[float, float]
    id = "balancer"
    sits = "driven joint"
    nouns = ("balancer or weight", "balancers or weights")
    clauses = (
        "a torque acts on {at} that its description lacks: a balancer, counterweight or gas "
        "spring, or its link weighs other than stated",
        "torques act on {at} that their description lacks: balancers, counterweights or gas "
        "springs, or their links weigh other than stated",
    )
    words = (
        "tau_{0.joint} += s_1 sin q_{0.joint} + c_1 cos q_{0.joint} + s_2 sin 2 q_{0.joint} + "
        "c_2 cos 2 q_{0.joint}"
    )
    advice = "; state what the description lacks, or log torques"
    role_in_search = "substitute"
    amounts_stand_alone = False
    acts_on_joint = False  # calculated torques do not have it
    of_calculated: ClassVar[bool] = True

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...] | None:
        """Return the torque of the weights at the first joint that lifts the arm."""
        if context.torques != "masses" or weights_known(context.arm).origin != "stated":
            return None
        if context.lifts is None or context.lifts[0] != joint:
            return None
        return (context.lifts[1:],)

    @property
    def prior_odds(self) -> float:
        """Return the odds against a sensor or gear that errs: small arms have no balancers."""
        return min(1.0, float(np.hypot(*self.weights_Nm)) / _BALANCED_NM)

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        """Return sine and cosine of the angle and of twice the angle [N m]."""
        sizes_Nm = np.linalg.norm(self.prior_factor, axis=1).tolist()
        scale_Nm = 1e-2 * max(sizes_Nm)
        return tuple(
            TermParameter(name, "N m", scale_Nm, plausible=size_Nm)
            for name, size_Nm in zip(("s_1", "c_1", "s_2", "c_2"), sizes_Nm, strict=True)
        )

    @property
    def prior_factor(self) -> Array:
        """Return the factor of the prior covariance: mostly in gravity's phase, see `_ACROSS`."""
        sine, cosine = _SHARE * np.array(self.weights_Nm)
        twice = _TWICE * np.hypot(sine, cosine)
        factor = np.diag([0.0, 0.0, twice, twice])
        factor[:2, :2] = [[sine, -_ACROSS * cosine], [cosine, _ACROSS * sine]]
        return factor

    def per_unit(self, states: PoseStates) -> Array:
        """Return what the calculated torque has too much of by each parameter, (P, 4)."""
        q_rad = states.q_rad[:, self.joint - 1]
        return -np.stack(
            [np.sin(q_rad), np.cos(q_rad), np.sin(2.0 * q_rad), np.cos(2.0 * q_rad)], axis=-1
        )
