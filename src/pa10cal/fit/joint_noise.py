"""What joints that stand elsewhere do to readings, and what noise of logged torques adds to these.

Springs deflect by the torques as logged. Logged torques scatter about those of the weights by noise
of the log, which moves no arm, and by forces that nobody stated, by which the arm does move: the
readings show which.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from pa10cal.arm.chain import end_pose_with_screws
from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array
from pa10cal.fit.fitted import Fitted
from pa10cal.fit.logged_torques import torque_scatter_Nm
from pa10cal.numerics.covariances import whitener_of
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations
from pa10cal.rules import MASSES
from pa10cal.terms.term import yields

# Derivatives at a residual of zero, where the components of an orientation error equal its angles.


def ideal_by_joints(at: Fitted, poses: Observations) -> Array:
    """Return the derivative of components by the position of each joint, (P, b, n).

    Of poses that were measured exactly where the model predicts them.
    """
    chain = at.model.chain
    end = end_pose_with_screws(chain, at.model.chain_coordinates(poses.states, at.x))
    return np.asarray(ideal_by_end(at, poses, end.T) @ end.screws[:, :, chain.joint_columns])


def ideal_by_end(at: Fitted, poses: Observations, T_base_ee: Array) -> Array:
    """Return the derivative of components by velocities of the end along base axes, (P, b, 6).

    Of poses that were measured exactly where the end is, at T_base_ee (P, 4, 4).
    """
    T_instr_ee, measured = at.T_instr_base @ T_base_ee, poses.measured
    compared = measured.ideal(T_instr_ee, at.targets_m).compare(T_instr_ee, at.targets_m)
    return along_base(compared.by_end * measured.components_seen[..., None], at)


def along_base(by_end: Array, at: Fitted) -> Array:
    """Return a derivative (P, b, 6) by motions along the base's axes, from the instrument's."""
    R = at.T_instr_base[:3, :3]
    return np.concatenate([by_end[..., :3] @ R, by_end[..., 3:] @ R], axis=2)


@dataclass(frozen=True)
class TorqueNoise:
    """Noise of the logged torques of P poses."""

    cov: Array  # (P, b, b) what it adds to the covariance of the components
    torque_Nm: Array  # (n,) its standard deviation
    share: float  # part of the variance of the scatter that is noise; the rest is of forces


def torque_noise(
    at: Fitted, poses: Observations, payload: Payload | None, residual: Array, cov: Array
) -> TorqueNoise | None:
    """Return the noise of logged torques; None without springs or where no weights are known.

    It is their scatter about a fit by the torques of the weights; zero for a joint with too few
    poses. Residuals far below such noise show how much of it is any.

    Args:
        poses: P poses, as modelled.
        residual: (P, b) predicted less measured components, the springs carrying the logged
            torques.
        cov: (P, b, b) of the noise of readings.
    """
    springs = [term for term in at.model.terms if yields(term)]
    if payload is None or not springs:
        return None
    states = poses.states
    torque_Nm = torque_scatter_Nm(at, states, payload)
    turned_rad = np.zeros(states.q_rad.shape)
    for spring in springs:
        turned_rad[:, spring.joint - 1] += spring.by_torque(states, at.values_of(spring))
    by_drives = at.arm.coupling.moved_by_drives(ideal_by_joints(at, poses))
    moved = by_drives * (turned_rad * torque_Nm)[:, None, :]
    by_torques = moved @ np.swapaxes(moved, 1, 2)
    share = share_that_is_noise(residual, poses.measured, cov, by_torques)
    return TorqueNoise(share * by_torques, np.sqrt(share) * torque_Nm, share)


def share_that_is_noise(
    residual: Array, measured: Instrument, cov: Array, by_torques: Array
) -> float:
    """Return which share of a covariance (P, b, b) residuals bear out beside another, 0 to 1.

    It is 1 unless position errors are far smaller than both together make them.

    Args:
        residual: (P, b) predicted less measured components.
        measured: what was measured of these poses.
        cov: (P, b, b) of the noise that is certain.
        by_torques: (P, b, b) of what may be noise.
    """
    columns, seen = measured.position_columns, measured.components_seen
    of_both = np.diagonal(cov + by_torques, axis1=1, axis2=2)
    square, expected = (
        np.sum(each[:, columns], where=seen[:, columns]) for each in (residual**2, of_both)
    )
    if square > MASSES.forces_ratio**-2.0 * expected:
        return 1.0

    def misfit(root: float) -> float:
        whiten = whitener_of(cov + root**2 * by_torques)
        white = np.einsum("pij,pj->pi", whiten, np.where(seen, residual, 0.0))
        log_det = -2.0 * np.log(np.diagonal(whiten, axis1=1, axis2=2)).sum()
        return float(np.sum(white**2) + log_det)

    return float(minimize_scalar(misfit, bounds=(0.0, 1.0), method="bounded").x) ** 2
