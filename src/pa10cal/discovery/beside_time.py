"""How readings follow what goes with the pose, beside which something is sought in time."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from pa10cal.arrays import Array, Mask
from pa10cal.discovery import linear
from pa10cal.discovery.preparation import why_unknown
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations
from pa10cal.observe.order import slow_joints
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_error_map import JointErrorMap

#: Effects of time are expected to be so many plausible sizes large: theirs is what they explain.
_SIZES = 3.0
#: Waves of a joint's error a turn, and their size, that are taken out where poses are read once;
#: more of a joint that moves little from one pose to the next.
_WAVES = (8, 24)
_WAVE_RAD = 3e-4


def by_pose_and_time(
    at: FittedModel, poses: Observations, effects: Iterable[Effect], *, logged: bool, weights: bool
) -> tuple[Array, Array]:
    """Return how components follow what goes with the pose, (P, b, k), and effects of time."""
    known = [
        effect
        for effect in effects
        if not (isinstance(effect, JointErrorMap) or (effect.generic and effect.goes_with_time))
        and why_unknown(effect, poses.states, logged=logged, weights=weights) is None
    ]
    shapes = [effect for effect in known for _ in effect.starts]
    starts = [start for effect in known for start in effect.starts]
    none = np.zeros((*poses.measured.components_seen.shape, 0))
    columns = [none, *linear.by_effects(at, poses, shapes, starts)]
    with_time = np.array([False, *(effect.goes_with_time for effect in shapes)])
    with_time = np.repeat(with_time, [each.shape[2] for each in columns])
    every = np.concatenate(columns, axis=2)
    static, of_time = every[..., ~with_time], _SIZES * every[..., with_time]
    if len(np.unique(poses.pose)) == len(poses):
        waves = _waves(at, poses, slow_joints(poses.states))
        static = np.concatenate([static, waves], axis=2)
    return static, of_time


def _waves(at: FittedModel, poses: Observations, slow: Mask) -> Array:
    """Return waves of the error of every turning joint by its angle, (P, b, w)."""
    arm = at.model.chain.arm
    joints = [joint for joint, slides in enumerate(arm.prismatic, start=1) if not slides]
    screws = linear.by_joints(at, poses, joints)
    q_rad = poses.states.q_rad[:, [joint - 1 for joint in joints]]
    columns = [np.zeros((*screws.shape[:2], 0))]
    for k, joint in enumerate(joints):
        angle = q_rad[:, k, None] * np.arange(1, _WAVES[int(slow[joint - 1])] + 1)
        waves = np.concatenate([np.sin(angle), np.cos(angle)], axis=1)
        columns.append(screws[:, :, k, None] * waves[:, None])
    return np.asarray(_WAVE_RAD * np.concatenate(columns, axis=2))
