"""Noise of single readings, as every search for effects has it.

It is found from repeats (`repeats`), or from poses that are nearly the same (`near_poses`), or is
what the instrument states; to the last the noise of logged torques is added.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import minimize_scalar

from pa10cal.arm.statics import Payload
from pa10cal.arrays import Array
from pa10cal.discovery.jacobians import ideal_by_joints
from pa10cal.discovery.rules import NAMES, NOISE
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.logged_torques import torque_scatter_Nm
from pa10cal.numerics.covariances import whitener_of
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations
from pa10cal.terms.term import yields


@dataclass(frozen=True)
class Noise:
    """Noise of single readings."""

    # (P, b, b) covariance of each reading's components: of a pose position [m] and small rotation
    # [rad], along the instrument's axes
    cov: Array
    differences: int  # pairs of readings behind it; 0 where it is what the instrument states
    components_compared: int = 0  # of all pairs of repeats: those that both readings have
    # (n,) standard deviation of each joint's position; empty where not attributed to sources
    joint_rad: Array = field(default_factory=lambda: np.zeros(0))
    instrument: float = 1.0  # factor on the instrument's stated standard uncertainty
    # (n,) standard deviation of a reading's torques; nan where none is logged, zero where none
    # scatters, as in a log that was calculated
    torque_Nm: Array = field(default_factory=lambda: np.zeros(0))
    # share of the variance of logged torques about those of the weights that is noise; the rest is
    # of forces that nobody stated
    torque_share: float = 1.0
    # how far apart the poses of pairs that are no repeats may be [rad; m of a prismatic joint]
    within: float = NOISE.same_pose

    @property
    def origin(self) -> str:
        """Return the source of noise that was not found from repeats, in words."""
        if not self.differences:
            scatter = " and the scatter of logged torques" * bool(np.any(self.torque_Nm > 0.0))
            return f"the instrument's stated uncertainty{scatter}: repeats do not show the noise"
        carried_on = "" if self.within == NOISE.same_pose else ", carried on to the same pose"
        return (
            f"{self.differences} pairs of poses closer than {1e3 * self.within:g} mrad in every "
            f"joint{carried_on}"
        )


def with_torque_noise(
    noise: Noise, residual: Array, at: FittedModel, poses: Observations, payload: Payload | None
) -> Noise:
    """Return stated noise plus what the noise of logged torques adds to it through the springs.

    Noise found from pairs of readings includes it already. The noise of torques is their scatter
    about a fit by the torques of the weights; zero for a joint with too few poses. Where forces act
    that nobody stated, the log scatters by these, and the arm moves by them: residuals far below
    such noise show how much of it is any.

    Args:
        residual: (P, b) predicted less measured components, the springs carrying the logged
            torques.
        poses: P complete poses.
        payload: None where the masses are not known.
    """
    springs = [term for term in at.model.terms if yields(term)]
    if noise.differences or payload is None or not springs:
        return noise
    states = poses.states
    torque_Nm = torque_scatter_Nm(at, states, payload, NOISE.torques_a_weight)
    turned_rad = np.zeros(states.q_rad.shape)
    for spring in springs:
        turned_rad[:, spring.joint - 1] += spring.by_torque(states, at.values_of(spring))
    by_drives = at.arm.coupling.moved_by_drives(ideal_by_joints(at, poses))
    moved = by_drives * (turned_rad * torque_Nm)[:, None, :]
    by_torques = moved @ np.swapaxes(moved, 1, 2)
    share = share_that_is_noise(residual, poses.measured, noise.cov, by_torques)
    cov, torque_Nm = noise.cov + share * by_torques, np.sqrt(share) * torque_Nm
    return replace(noise, cov=cov, torque_Nm=torque_Nm, torque_share=share)


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
    if square > NAMES.agree_ratio**-2.0 * expected:
        return 1.0

    def misfit(root: float) -> float:
        whiten = whitener_of(cov + root**2 * by_torques)
        white = np.einsum("pij,pj->pi", whiten, np.where(seen, residual, 0.0))
        log_det = -2.0 * np.log(np.diagonal(whiten, axis1=1, axis2=2)).sum()
        return float(np.sum(white**2) + log_det)

    return float(minimize_scalar(misfit, bounds=(0.0, 1.0), method="bounded").x) ** 2
