"""Columns of all that depends on the pose, beside which something is sought in time."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from pa10cal.arrays import Array, Mask
from pa10cal.discovery import jacobians
from pa10cal.discovery.preparation import why_unknown
from pa10cal.discovery.rules import CANDIDATES
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations
from pa10cal.observe.time_order import (
    slow_joints,
)
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_error_map import is_error_map


def by_pose_and_time(
    at: FittedModel, poses: Observations, effects: Iterable[Effect], *, logged: bool, weights: bool
) -> tuple[Array, Array]:
    """Return columns (P, b, k) of what depends on the pose, and of effects of time.

    The former are the effects that can be predicted, and waves of the joints' errors where poses
    are read once. A change in time has to explain more than these.
    """
    known = [
        effect
        for effect in effects
        if not (is_error_map(effect) or (effect.generic and effect.depends_on))
        and why_unknown(effect, poses.states, logged=logged, weights=weights) is None
    ]
    shapes = [effect for effect in known for _ in effect.starts]
    starts = [start for effect in known for start in effect.starts]
    none = np.zeros((*poses.measured.components_seen.shape, 0))
    columns = [none, *jacobians.by_scaled_effects(at, poses, shapes, starts)]
    with_time = np.array([False, *(effect.depends_on is not None for effect in shapes)])
    with_time = np.repeat(with_time, [each.shape[2] for each in columns])
    every = np.concatenate(columns, axis=2)
    static, of_time = every[..., ~with_time], CANDIDATES.sizes_of_time * every[..., with_time]
    if len(np.unique(poses.pose)) == len(poses):
        waves = _waves(at, poses, slow_joints(poses.states))
        static = np.concatenate([static, waves], axis=2)
    return static, of_time


def _waves(at: FittedModel, poses: Observations, slow: Mask) -> Array:
    """Return columns (P, b, w) of waves of the error of every turning joint by its angle."""
    arm = at.arm
    joints = [joint for joint, slides in enumerate(arm.prismatic, start=1) if not slides]
    screws = jacobians.by_joints(at, poses, joints)
    q_rad = poses.states.q_rad[:, [joint - 1 for joint in joints]]
    columns = [np.zeros((*screws.shape[:2], 0))]
    for k, joint in enumerate(joints):
        angle = q_rad[:, k, None] * np.arange(1, CANDIDATES.waves[int(slow[joint - 1])] + 1)
        waves = np.concatenate([np.sin(angle), np.cos(angle)], axis=1)
        columns.append(screws[:, :, k, None] * waves[:, None])
    return np.asarray(CANDIDATES.wave_rad * np.concatenate(columns, axis=2))
