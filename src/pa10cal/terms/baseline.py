"""The paper's model: link departures and a spring on each flexible joint."""

from __future__ import annotations

import numpy as np

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arm.tolerances import Tolerances
from pa10cal.arrays import Array
from pa10cal.errors import CalibrationError
from pa10cal.terms.joint_spring import JointSpring
from pa10cal.terms.model import Model
from pa10cal.terms.offsets import link_departures

#: Torque at which springs are stated of joints whose rated torque is not known.
_UNRATED_NM = 100.0


def baseline(
    arm: Arm,
    flexible_joints: tuple[int, ...],
    tolerances: Tolerances,
    *,
    cubic: bool = True,
    tau_ref_Nm: Array | None = None,
) -> Model:
    """Build the paper's model of an arm (Section II.C, Table I).

    Args:
        arm: the nominal arm.
        flexible_joints: joints 1 … n with a spring; the others are rigid.
        tolerances: manufacturing tolerances of the link parameters.
        cubic: whether the springs have a cubic coefficient.
        tau_ref_Nm: (n,) torques at which the springs' solved parameters are stated, best the
            largest in the data; the rated torques where None, or a
            common size where those are not known. The model is the same.

    Raises:
        CalibrationError: when a flexible joint is not one of the arm's that turn.
    """
    for joint in flexible_joints:
        there = 1 <= joint <= arm.n
        if not there or arm.prismatic[joint - 1]:
            raise CalibrationError(
                "the joint is prismatic, and springs are torsional" if there else "no such joint",
                where="calibration.flexible_joints",
                value=joint,
                allowed=f"1 to {arm.n}, and a joint that turns",
                remedy="correct the list",
            )
    tau_Nm = arm.rated_Nm(np.full(arm.n, _UNRATED_NM)) if tau_ref_Nm is None else tau_ref_Nm
    springs = tuple(
        JointSpring(joint, float(tau_Nm[joint - 1]), cubic)
        for joint in sorted(set(flexible_joints))
    )
    return Model(Chain.of(arm), (link_departures(arm, tolerances), *springs))


def nominal(arm: Arm) -> Model:
    """Build the nominal rigid model, without any parameter."""
    return Model(Chain.of(arm), ())
