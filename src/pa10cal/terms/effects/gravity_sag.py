"""What gravity may do to an arm whose masses are not known: a rival without a name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import BASE, TOOL, Chain
from pa10cal.arm.state import PoseStates
from pa10cal.arm.statics import torque_by_mass
from pa10cal.errors import CalibrationError
from pa10cal.terms.effects.effect import CandidateContext, JointEffect, turning_joints
from pa10cal.terms.term import Parameter

Array = NDArray[np.float64]

#: Sag to be expected of a joint, root mean square over postures [rad].
_PLAUSIBLE_RAD = 3e-4
#: Lengths about which centres of mass lie off the origin of their link [m].
_CENTRE_M = 0.2
#: Postures at which the base parameters of a joint's moment are found.
_POSTURES = 300
#: Parts of the moment smaller than this, of the largest, are none.
_LEAST_PART = 3e-3


@dataclass(frozen=True)
class GravitySag(JointEffect):
    """A joint gives way to the moment of weights that are not known.

    The moment is linear in mass and first moment of the links beyond the joint. Over all postures
    few combinations of them matter, the base parameters of the joint's gravity: each is a factor
    here [rad], compliance and weights in one.

    Attributes:
        combinations: (k, 4 n) of mass and first moment of every link, for each base parameter, in
            units that make its part of the sag as large as is to be expected [kg, kg m].
    """

    combinations: tuple[tuple[float, ...], ...]
    id: ClassVar[str] = "gravity_sag"
    generic: ClassVar[bool] = True
    advice: ClassVar[str] = "; it sags with gravity: describe the masses of the arm"

    @property
    def formula(self) -> str:
        """Return the form in words a reader can type."""
        return f"theta_{self.joint} += k factors times the base parameters of gravity's moment"

    @classmethod
    def everywhere(cls, context: CandidateContext) -> tuple[Self, ...]:
        """Return it at every joint that turns and carries weight, of an arm without masses."""
        arm, gravity_m_s2 = context.arm, context.gravity_m_s2
        if arm.mass_kg is not None or gravity_m_s2 is None:
            return ()
        chain = Chain.of(arm)
        low, high = context.q_span_rad.T
        q_rad = np.random.default_rng(0).uniform(low, high, (_POSTURES, arm.n))
        coordinates = chain.coordinates(q_rad)
        coordinates[:, chain.columns(BASE + TOOL)] = 0.0
        moments = torque_by_mass(chain, coordinates, gravity_m_s2)
        size = np.tile([1.0, _CENTRE_M, _CENTRE_M, _CENTRE_M], arm.n)
        found = []
        for joint in turning_joints(context):
            columns = moments[:, joint - 1] * size
            columns -= columns.mean(axis=0)
            _, values, axes = np.linalg.svd(columns / np.sqrt(_POSTURES), full_matrices=False)
            if values[0] < 1e-6:  # its axis stays upright: no weight turns it
                continue
            kept = values > _LEAST_PART * values[0]
            scaled = _PLAUSIBLE_RAD / float(np.linalg.norm(values)) * axes[kept] * size
            found.append(cls(f"joint {joint}", tuple(map(tuple, scaled.tolist()))))
        return tuple(found)

    @property
    def reported(self) -> tuple[Parameter, ...]:
        """Return the factor of each base parameter."""
        return tuple(
            Parameter(f"part_{k}", "1", 0.1, plausible=1.0)
            for k in range(1, len(self.combinations) + 1)
        )

    def derivative(self, states: PoseStates, x: Array) -> Array:
        """Return the moment of each base parameter, (P, 1, k)."""
        del x
        if states.torque_by_mass is None:
            raise CalibrationError(
                "the direction of gravity is not known",
                where=f"{self.id} of {self.of}",
                allowed="gravity_m_s2 in campaign.yaml",
                remedy="state it",
            )
        moments = states.torque_by_mass[:, self.joint - 1] @ np.array(self.combinations).T
        return np.asarray(moments)[:, None, :]
