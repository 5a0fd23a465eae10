"""An error of a whole number of cycles a turn of a joint, which the data have found."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from pa10cal.arrays import Array
from pa10cal.terms.effects.effect import CandidateContext
from pa10cal.terms.effects.encoder import JointHarmonic
from pa10cal.terms.term import Parameter, Report


@dataclass(frozen=True)
class PeriodicError(JointHarmonic):
    """A sin(k q_j + phi), k whole: in the place of a map that is this one line.

    It is not sought: k is found where a map of the joint does no better than one line
    (`discovery/formulas`). One and two cycles, and those of the gear, have names of their own.
    """

    order: float = 3.0  # k
    id: ClassVar[str] = "periodic_error"
    sought: ClassVar[bool] = False

    @classmethod
    def order_of(cls, context: CandidateContext, joint: int) -> float:
        """Return the first order without a name of its own."""
        del context, joint
        return cls.order

    def report(self, x: Array) -> Report:
        """Return amplitude and phase, and the order."""
        known = super().report(x)
        order = Parameter("k", "1", 1.0)
        return replace(
            known,
            parameters=(*known.parameters, order),
            values=np.append(known.values, self.order),
            jacobian=np.vstack([known.jacobian, np.zeros(2)]),
        )
