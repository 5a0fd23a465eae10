"""Lag of measured orientations behind the motion of the arm.

A joint that stops short moves the end in position and orientation. A sensor of orientations that
lags behind the motion, or sways on its mount, turns the orientations alone. With joint positions as
commanded, orientations show both alike. The lag is therefore an unknown of every joint in
addition to model and effects, and errors of arrival are identified from positions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pa10cal.arrays import Array
from pa10cal.discovery.linear import by_joints
from pa10cal.discovery.rules import BLOCKS
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations
from pa10cal.results.discovery import Unexplained
from pa10cal.terms.effects.effect import CandidateContext, turning_joints


@dataclass(frozen=True, eq=False)
class AttitudeLag:
    """Rotation of orientations about each joint's axis, in proportion to the joint's last move."""

    joints: tuple[int, ...]  # the joints with a lag, from 1
    campaigns: int = 1  # campaigns of a group, each with lags of its own
    amounts: Array | None = None  # (campaigns * joints,) in units of `sizes`; None until fitted

    @property
    def sizes(self) -> Array:
        """Return the standard deviation expected of each amount [rad]."""
        return np.full(self.campaigns * len(self.joints), BLOCKS.lag_rad)

    def columns(self, at: FittedModel, poses: Observations) -> Array:
        """Return the derivative of the components by the amounts, (P, b, k)."""
        by_lag = by_joints(at, poses, self.joints)
        by_lag[:, poses.measured.position_columns] = 0.0
        move = poses.states.move_from_previous[:, [joint - 1 for joint in self.joints]]
        by_lag = by_lag * move[:, None, :] * BLOCKS.lag_rad
        campaign = poses.states.campaign
        if campaign is None:
            return np.asarray(by_lag)
        parts = [by_lag * (campaign == k)[:, None, None] for k in range(self.campaigns)]
        return np.concatenate(parts, axis=2)

    def shift(self, at: FittedModel, poses: Observations) -> Array:
        """Return the error that the fitted lag makes in the components, (P, b)."""
        assert self.amounts is not None
        return np.asarray(self.columns(at, poses) @ self.amounts)

    def unexplained(self, mean_error_mm: float) -> Unexplained:
        """Return the lag as an unexplained part of the error, with the remaining mean error."""
        assert self.amounts is not None
        lags_rad = np.abs(self.amounts * self.sizes).reshape(self.campaigns, -1).max(axis=0)
        joints = " and ".join(
            f"joint {joint} ({1e6 * lag_rad:.0f} µrad)"
            for joint, lag_rad in zip(self.joints, lags_rad.tolist(), strict=True)
            if lag_rad > BLOCKS.told_share * lags_rad.max()
        )
        why = (
            f"orientations go with the way that {joints} came, and positions do not: it is the "
            "reader of orientations or its mount that lags, and no joint that stops short"
        )
        return Unexplained(
            of="instrument", form="attitude_lag", shared_error_mm=mean_error_mm, why=why
        )


def attitude_lag(context: CandidateContext, poses: Observations) -> AttitudeLag | None:
    """Return the lag to be fitted; None where joints were read back or no orientations measured."""
    measured = poses.measured
    has_orientations = measured.components_seen.shape[1] > len(measured.position_columns)
    if not (context.commanded and has_orientations):
        return None
    return AttitudeLag(tuple(turning_joints(context)), max(len(context.campaigns), 1))
