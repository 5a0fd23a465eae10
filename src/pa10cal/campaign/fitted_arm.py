"""An arm fitted to its readings as they are read, by plain least squares: what it leaves.

It says how readings are off before a calibration can: by joints that were rounded, by an instrument
that is less certain along one of its axes.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from pa10cal.arm.chain import TOOL, Chain, end_pose_with_screws
from pa10cal.arm.statics import Payload, statics
from pa10cal.arrays import Array, Index, Mask, drawn
from pa10cal.numerics.least_squares import Linearised, descend
from pa10cal.observe.instrument import Instrument
from pa10cal.observe.observations import Observations

#: Poses that leave more than so many times the median square are gross errors (size).
_GROSS = 25.0
#: A log that leaves so many times what is stated is wrong (size).
_WRONG = 1e3
#: Poses to which an arm is fitted, at most (computing).
_MOST_POSES = 300
#: The fit ends where a step lowers the squares by a smaller part, which is less than a nat of the
#: likelihoods, or after so many steps (computing).
_SETTLED, _MOST_STEPS = 1e-4, 30
#: Singular values below this part of the largest are not determined (computing).
_NOT_DETERMINED = 1e-6


def once_each(readings: Observations) -> Index:
    """Return a reading of each position, of not too many: repeats share errors of their joints."""
    _, once = np.unique(readings.states.q_rad, axis=0, return_index=True)
    return np.sort(once)[drawn(len(once), _MOST_POSES)]


class Fitted(NamedTuple):
    """A point of the fit."""

    coordinates: Array  # (P, m) of the chain at the poses, with what springs turn
    targets_m: Array  # (t,) coordinates of the targets in the end-effector frame


class Compared(NamedTuple):
    """What a point predicts of P poses with b components, less what was measured."""

    residual: Array  # (P, b)
    columns: Array  # (P, b, k) derivative by the unknowns
    by_joints: Array  # (P, b, n) derivative by errors of the joints


class Left(NamedTuple):
    """What a fitted arm leaves of P poses with b components."""

    residual: Array  # (P, b) predicted less measured, zero where not seen
    whitened_squares: Array  # (P,) sums of squares in the noise of the fit
    taken: Array  # (P, b, r) A of the covariance A A^T that the fit took of the residual
    by_joints: Array  # (P, b, n) derivative by errors of the joints

    @property
    def is_of_a_wrong_log(self) -> bool:
        """Return whether so much is left that a log is wrong, as by a reversed joint."""
        limit = _WRONG**2 * self.residual.shape[1]
        return bool(np.median(self.whitened_squares) > limit)

    @property
    def usual(self) -> Mask:
        """Return which poses (P,) are no gross errors."""
        return np.asarray(self.whitened_squares <= _GROSS * np.median(self.whitened_squares))


@dataclass(frozen=True, eq=False)
class ArmFit:
    """A fit of links, springs, base, tool and targets to P poses.

    Its unknowns are errors of the m coordinates of the chain, turns of the n springs, and t
    coordinates of targets.
    """

    chain: Chain
    measured: Instrument
    T_instr_base: Array  # (4, 4) about; the chain has the motions of the base
    torque: Array  # (P, n) by which springs turn joints, at most 1
    whitening: Array  # (P, b, b) by which stated noise has unit covariance
    # points compared last: fits in several noises begin where the one before ended
    last_two: list[tuple[Fitted, Compared]] = field(default_factory=list)

    @classmethod
    def begun(
        cls, readings: Observations, chain: Chain, payload: Payload | None
    ) -> tuple[ArmFit, Fitted]:
        """Return the fit, and where it begins: the nominal arm, placed by the readings.

        Raises:
            CalibrationError: when the poses do not determine where base and targets are.
        """
        q_rad, measured = readings.states.q_rad, readings.measured
        located = measured.locate(chain.forward(q_rad), roughly=True)
        coordinates, targets_m = chain.coordinates(q_rad), np.zeros(0)
        if located.T_ee_target is not None:
            measured = measured.turned(located.T_ee_target[:3, :3])
            coordinates[:, chain.columns(TOOL[:3])] += located.T_ee_target[:3, 3]
        elif located.p_ee_targets_m is not None:
            targets_m = located.p_ee_targets_m.ravel()
        torque = _relative_torques(readings, chain, payload)
        whitening = np.linalg.inv(np.linalg.cholesky(measured.stated_covariance))
        fit = cls(chain, measured, located.T_instr_base, torque, whitening)
        return fit, Fitted(coordinates, targets_m)

    def compare(self, at: Fitted) -> Compared:
        """Return the comparison at a point, which no noise changes: the last two are kept."""
        for known, compared in self.last_two:
            if known is at:
                return compared
        end, R = end_pose_with_screws(self.chain, at.coordinates), self.T_instr_base[:3, :3]
        seen = self.measured.compare(self.T_instr_base @ end.T, at.targets_m)
        by_chain = seen.by_end @ np.concatenate([R @ end.screws[:, :3], R @ end.screws[:, 3:]], 1)
        by_joints = by_chain[:, :, self.chain.joint_columns]
        by_springs = self.chain.arm.coupling.moved_by_drives(by_joints) * self.torque[:, None]
        columns = np.concatenate([by_chain, by_springs, seen.by_targets], axis=2)
        compared = Compared(seen.residual, columns, by_joints)
        self.last_two[:] = [*self.last_two[-1:], (at, compared)]
        return compared

    def linearise(self, at: Fitted) -> Linearised:
        """Return the problem at a point, in stated noise."""
        residual, columns, _ = self.compare(at)
        return Linearised(
            (self.whitening @ columns).reshape(-1, columns.shape[2]),
            -(self.whitening @ residual[:, :, None]).ravel(),
        )

    def fitted(self, at: Fitted) -> tuple[Fitted, Left]:
        """Return the point at which the fit ends from another one, and what is left there."""
        at, there = descend(at, self.linearise, self.moved, _SETTLED, _MOST_STEPS)
        residual, columns, by_joints = self.compare(at)
        scale = np.sqrt(np.sum(there.by_step**2, axis=0))
        scale[scale == 0.0] = 1.0
        _, sizes, turned = np.linalg.svd(there.by_step / scale, full_matrices=False)
        known = sizes > _NOT_DETERMINED * sizes[0]
        root = turned[known].T / sizes[known] / scale[:, None]
        squares = np.sum(there.residual.reshape(residual.shape) ** 2, axis=1)
        return at, Left(residual, squares, columns @ root, by_joints)

    def weighted_by(self, covariance: Array) -> ArmFit:
        """Return the fit in another noise, of covariance (P, b, b)."""
        return replace(self, whitening=np.linalg.inv(np.linalg.cholesky(covariance)))

    def moved(self, at: Fitted, step: Array) -> Fitted:
        """Return the point after a step of the unknowns."""
        m, joints = at.coordinates.shape[1], self.chain.joint_columns
        by_chain, by_springs, by_targets = np.split(step, [m, m + len(joints)])
        coordinates = at.coordinates + by_chain
        coordinates[:, joints] += self.chain.arm.coupling.with_drives(self.torque * by_springs)
        return Fitted(coordinates, at.targets_m + by_targets)


def _relative_torques(readings: Observations, chain: Chain, payload: Payload | None) -> Array:
    """Return torques (P, n) by which springs turn joints, at most 1; 0 where they are not known."""
    states, arm = readings.states, chain.arm
    torque = states.tau_Nm
    logged = np.isfinite(torque).all()
    if payload is not None and payload.gravity_m_s2.any() and not logged:
        torque = statics(chain, chain.coordinates(states.q_rad), states.load_N, payload).joint_Nm
    torque = np.where(arm.prismatic, 0.0, np.nan_to_num(torque))
    return np.asarray(torque / np.maximum(np.abs(torque).max(axis=0), 1e-9))
