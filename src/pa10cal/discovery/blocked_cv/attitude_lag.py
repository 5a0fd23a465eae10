"""Attitudes that go with the way a joint came, where positions do not.

A joint that stops short takes the whole end with it. A reader of attitudes may lag behind the
motion by itself, or sway on its mount, and leaves positions where they are. Where joints are those
commanded both look alike in attitudes, so what attitudes alone say of arrivals counts for nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pa10cal.arrays import Array
from pa10cal.discovery.finding import Unexplained
from pa10cal.discovery.linear import by_joints
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations
from pa10cal.terms.effects.effect import CandidateContext, turning_joints

#: What attitudes are expected to lag by [rad].
_LAG_RAD = 1e-4
#: Joints are told whose way counts for this part of the largest.
_TOLD = 0.5


@dataclass(frozen=True, eq=False)
class AttitudeLag:
    """By how much attitudes turn with the way that each joint came."""

    joints: tuple[int, ...]  # which, from 1
    campaigns: int = 1  # how many a group has, each with lags of its own; 1 of a single campaign
    amounts: Array | None = None  # (campaigns * joints,) in `sizes`; None until they are found

    @property
    def sizes(self) -> Array:
        """Return the size expected of each amount [rad]."""
        return np.full(self.campaigns * len(self.joints), _LAG_RAD)

    def columns(self, at: FittedModel, poses: Observations) -> Array:
        """Return how components follow the amounts, (P, b, k)."""
        turned = by_joints(at, poses, self.joints)
        turned[:, poses.measured.position_columns] = 0.0
        came = poses.states.since_before[:, [joint - 1 for joint in self.joints]]
        turned = turned * came[:, None, :] * _LAG_RAD
        campaign = poses.states.campaign
        if campaign is None:
            return np.asarray(turned)
        parts = [turned * (campaign == k)[:, None, None] for k in range(self.campaigns)]
        return np.concatenate(parts, axis=2)

    def shift(self, at: FittedModel, poses: Observations) -> Array:
        """Return what attitudes are off by, in the components of poses, (P, b)."""
        assert self.amounts is not None
        return np.asarray(self.columns(at, poses) @ self.amounts)

    def unexplained(self, left_mm: float) -> Unexplained:
        """Return it as a part of what is unexplained, beside the mean error that is left."""
        assert self.amounts is not None
        lags_rad = np.abs(self.amounts * self.sizes).reshape(self.campaigns, -1).max(axis=0)
        said = " and ".join(
            f"joint {joint} ({1e6 * lag_rad:.0f} µrad)"
            for joint, lag_rad in zip(self.joints, lags_rad.tolist(), strict=True)
            if lag_rad > _TOLD * lags_rad.max()
        )
        why = (
            f"attitudes go with the way that {said} came, and positions do not: it is the reader "
            "of attitudes or its mount that lags, and no joint that stops short"
        )
        return Unexplained("instrument", "attitude_lag", left_mm, why)


def attitude_lag(context: CandidateContext, poses: Observations) -> AttitudeLag | None:
    """Return the lag that attitudes may have; None where joints were read, or there are none."""
    measured = poses.measured
    attitudes = measured.components_seen.shape[1] > len(measured.position_columns)
    if not (context.commanded and attitudes):
        return None
    return AttitudeLag(tuple(turning_joints(context)), max(len(context.campaigns), 1))
