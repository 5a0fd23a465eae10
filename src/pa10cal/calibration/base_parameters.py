"""The base frame in the paper's parameters: origin and body-fixed rotations of the instrument."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array
from pa10cal.frame.pose_error import cross_matrix
from pa10cal.terms.term import Parameter, Report

PARAMETERS = (
    Parameter("base_p_cmm_x", "m", 1e-3),
    Parameter("base_p_cmm_y", "m", 1e-3),
    Parameter("base_p_cmm_z", "m", 1e-3),
    Parameter("gamma_x", "rad", 1e-3),
    Parameter("gamma_y", "rad", 1e-3),
    Parameter("gamma_z", "rad", 1e-3),
)


def report_base(T_instr_base: Array) -> Report:
    """Return the six parameters Psi of paper equation (4).

    The origin of the instrument's frame in the base frame, and the rotations about body-fixed x, y
    and z that turn the base axes into the instrument's.

    Returns:
        Values, with the Jacobian by translation along the instrument's axes and a small right
        rotation of T_instr_base.
    """
    R_base_cmm = T_instr_base[:3, :3].T
    origin = -R_base_cmm @ T_instr_base[:3, 3]
    gamma = Rotation.from_matrix(R_base_cmm).as_euler("XYZ")
    first = Rotation.from_euler("x", gamma[0]).as_matrix()
    second = first @ Rotation.from_euler("y", gamma[1]).as_matrix()
    rates = np.stack([np.array([1.0, 0.0, 0.0]), first[:, 1], second[:, 2]], axis=1)
    jacobian = np.zeros((6, 6))
    jacobian[:3, :3] = -R_base_cmm
    jacobian[:3, 3:] = cross_matrix(origin)
    jacobian[3:, 3:] = -np.linalg.pinv(rates)  # singular where body-fixed y turns by 90 degrees
    return Report(PARAMETERS, np.concatenate([origin, gamma]), jacobian)
