"""Zeros of joints that moved during a campaign: readings as they would be since the last step.

The arm as it is after the campaign is that of the readings after the last step. Those before tell
of it as well once their joint positions are corrected; what the correction is uncertain by, the
model is uncertain by, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from pa10cal.arrays import Array, Mask
from pa10cal.discovery import jacobians
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.numerics.covariances import whitener_of
from pa10cal.observe.observations import Observations
from pa10cal.results.discovery import MovedZero


@dataclass(frozen=True, eq=False)
class MovedZeros:
    """Steps in the zeros of joints, each at a time of its own."""

    joints: tuple[int, ...]  # (k,) from 1; a joint may have several
    times_s: tuple[float, ...]  # (k,) of the steps
    # (k, 2) of the last reading surely before each and of the first surely after it
    between_s: Array
    moved: Array  # (k,) by how much [rad, m]
    covariance: Array  # (k, k) of these

    @classmethod
    def of_record(cls, steps: Sequence[MovedZero]) -> Self:
        """Return them as they were written, without their covariance."""
        return cls(
            joints=tuple(step.joint for step in steps),
            times_s=tuple(step.at_s for step in steps),
            between_s=np.array([(step.before_s, step.after_s) for step in steps]),
            moved=np.array([step.moved for step in steps]),
            covariance=np.zeros((len(steps), len(steps))),
        )

    @property
    def record(self) -> tuple[MovedZero, ...]:
        """Return them as they are written."""
        steps = zip(
            self.joints, self.times_s, self.between_s.tolist(), self.moved.tolist(), strict=True
        )
        return tuple(
            MovedZero(joint=joint, at_s=at_s, before_s=before_s, after_s=after_s, moved=moved)
            for joint, at_s, (before_s, after_s), moved in steps
        )

    def corrected(self, observations: Observations) -> Observations:
        """Return readings with the joint positions that they would have since the last step."""
        states = observations.states
        q_rad = states.q_rad.copy()
        for joint, time_s, moved in zip(
            self.joints, self.times_s, self.moved.tolist(), strict=True
        ):
            q_rad[states.time_s <= time_s, joint - 1] -= moved
        return observations.with_states(replace(states, q_rad=q_rad))

    def of_unknown_side(self, readings: Observations) -> Mask:
        """Return which of P readings may be before or after a step, (P,): they judge no model."""
        time_s = readings.states.time_s[:, None]
        before_s, after_s = self.between_s.T
        return np.asarray(np.any((time_s > before_s) & (time_s < after_s), axis=1))

    def covariance_of_fit(self, at: FittedModel, poses: Observations, known: Array) -> Array:
        """Return the covariance (k, k) that the fit has by them, beside what it has by noise.

        Args:
            at: the model that was fitted to corrected readings.
            poses: these, complete.
            known: (k, k) the covariance of its unknowns by noise.
        """
        white = whitener_of(poses.measured.stated_covariance)
        before = poses.states.time_s[:, None] <= np.array(self.times_s)
        by_moved = -jacobians.by_joints(at, poses, self.joints) * before[:, None, :]
        by_unknowns = jacobians.residual_and_jacobian(at, poses)[1]
        # Along directions of unit uncertainty the precision is 1, of which readings give as much as
        # they show of a direction, and priors the rest. That of noise other than stated is as
        # much smaller as the direction shows that readings determine most.
        scale, turned = np.linalg.eigh(known)
        along = turned * np.sqrt(np.maximum(scale, 0.0))
        rows = (white @ (by_unknowns @ along)).reshape(-1, len(known))
        wanted = (white @ by_moved).reshape(len(rows), -1)
        taken = -along @ (rows.T @ wanted) / np.linalg.norm(rows, 2) ** 2
        return np.asarray(taken @ self.covariance @ taken.T)
