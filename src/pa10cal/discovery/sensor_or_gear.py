"""Whose error a joint's error by its angle is: its sensor's, or its gear's.

Both turn the joint by the same periodic function of its angle, so poses alone cannot say. The
motor's own ripple can (`motor_ripple`): it goes with the angle at which the motor stands.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from pa10cal.results import maps
from pa10cal.results.maps import MotorRipple

Cause = Literal["sensor", "gear"]

#: Share of the error that the motor must surely follow, or surely not, for a cause to be named: an
#: interval that ends here still holds "all of it" or "nothing of it", within the error of the map.
_NEARLY_ALL = 0.7
_HARDLY_ANY = 0.3
#: Log-likelihood by which the motor's ripple must prefer one cause over the other, in nats.
LEAST_NATS = 4.0
#: Correlation of campaigns or turns from which they agree, and how many arcs it takes.
LEAST_CORRELATION = 0.8
LEAST_ARCS = 15


class Witness(MotorRipple):
    """What the motor's ripple of one joint says.

    The residual of the joint has lines a cos(N n p) + b sin(N n p) in p = q + alpha e(q) +
    beta tau, with e the joint's error (true less commanded angle).
    """

    @property
    def excludes_gear(self) -> bool:
        """Whether the motor surely followed the error."""
        return self.interval95[0] > 0.0 and self.gain_nats > LEAST_NATS

    @property
    def excludes_sensor(self) -> bool:
        """Whether the motor surely did not follow the whole error."""
        return self.interval95[1] < 1.0 and self.gain_over_one_nats > LEAST_NATS

    @property
    def likely(self) -> Cause | None:
        """Return whose error most of it is; None where the ripple does not decide.

        Where the motor followed a part of the error, both err, and the ripple has decided that.
        """
        if self.excludes_gear and self.excludes_sensor:
            return "sensor" if self.alpha > 0.5 else "gear"
        return self.cause

    @property
    def cause(self) -> Cause | None:
        """Return whose error it is; None where the ripple does not decide, or where both err."""
        low, high = self.interval95
        if self.excludes_gear and not self.excludes_sensor and high > _NEARLY_ALL:
            return "sensor"
        if self.excludes_sensor and not self.excludes_gear and low < _HARDLY_ANY:
            return "gear"
        return None


class Agreement(maps.Agreement):
    """How well campaigns, or turns of a joint, agree on its error where both were."""

    @property
    def holds(self) -> bool:
        """Whether the error is the joint's own, and not that of a campaign or of a turn."""
        return self.arcs >= LEAST_ARCS and self.correlation >= LEAST_CORRELATION


@dataclass(frozen=True)
class JointCause:
    """Whose error a joint's error by its angle is, and what says so."""

    joint: int  # which, from 1
    witness: Witness | None  # the motor's ripple; None where it shows none
    # of campaigns or turns; None where no angle was seen in two of them
    agreement: Agreement | None

    @property
    def cause(self) -> Cause | None:
        """Return whose error it is; None where it cannot be said."""
        if self.witness is None or self.agreement is None or not self.agreement.holds:
            return None
        return self.witness.cause
