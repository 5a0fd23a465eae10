"""Whether rows without times are of two sessions: of another place of base or instrument each.

Rows give an order also where times were not recorded, in which nothing is sought in time. Two
sessions that were put one after the other differ by a motion of the base between two rows. To the
search this may look like an error of a joint that moved over another range in either. So where an
error is left that has no name, a step of the base between two rows is compared with the same steps
in the order of each joint's angles, which errors of that joint would make as likely.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pa10cal.arrays import Array, Index
from pa10cal.discovery import jacobians
from pa10cal.discovery.tuning import SESSIONS
from pa10cal.fit.discrepancy import less_far_off
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.observe.observations import Observations
from pa10cal.observe.time_order import like_a_scan
from pa10cal.results.discovery import Unexplained

#: Begins the place of what two sessions leave unexplained.
_FROM = "the rows from pose"


@dataclass(frozen=True)
class _Step:
    """A motion of the base between two poses of an order."""

    first: int  # number in the order of the first pose after it
    gain: float  # of log evidence [nat]


def two_sessions(at: FittedModel, poses: Observations) -> Unexplained | None:
    """Return that rows from a pose on disagree with those before; None where they do not.

    Nor where times were recorded, in a group, or where most joints move slowly from row to row.

    Args:
        at: the model with the effects found.
        poses: P averaged and complete poses, to which it was fitted.
    """
    states = poses.states
    if states.tells_time or states.campaign is not None or like_a_scan(poses):
        return None
    steps = _Steps.of(at, poses)
    in_order = np.argsort(states.time_s, kind="stable")
    by_rows = steps.best(in_order)
    joints = (np.argsort(angles, kind="stable") for angles in states.q_rad.T)
    by_joints = max(steps.best(order).gain for order in joints)
    if by_rows.gain < SESSIONS.least_nats + max(by_joints, 0.0):
        return None
    pose = poses.pose[in_order[by_rows.first]]
    return Unexplained(
        of=f"{_FROM} {pose} on",
        form=None,
        shared_error_mm=None,
        why="these disagree with the rows before, as if the base or the instrument had stood "
        "elsewhere; two sessions? join them as a group, each a campaign of its own",
    )


def of_sessions(part: Unexplained) -> bool:
    """Return whether an unexplained part is that rows are of two sessions."""
    return part.of is not None and part.of.startswith(_FROM)


@dataclass(frozen=True, eq=False)
class _Steps:
    """Steps of the base beside all that a model has, about what it leaves."""

    by_base: Array  # (P, b, 6) whitened derivative by small motions of the base
    span: Array  # (P, b, k) orthonormal columns of the model's own unknowns
    left: Array  # (P, b) whitened residual, without these

    @classmethod
    def of(cls, at: FittedModel, poses: Observations) -> _Steps:
        """Return them at poses, each component over its stated uncertainty."""
        compared = at.compared(poses)
        root = np.sqrt(np.diagonal(poses.measured.stated_covariance, axis1=1, axis2=2))
        weight = less_far_off(poses.measured, compared.residual / root)[:, None] / root
        by_base = jacobians.by_base(at, poses)
        own = jacobians.by_scaled_terms(at, poses, at.model.terms)
        columns = np.concatenate([*own, compared.by_targets, by_base], axis=2) * weight[:, :, None]
        flat = columns.reshape(-1, columns.shape[2])
        size = np.linalg.norm(flat, axis=0)
        left, sizes, _ = np.linalg.svd(flat / np.where(size > 0.0, size, 1.0), full_matrices=False)
        span = left[:, sizes > SESSIONS.least_singular * sizes[0]]
        data = (compared.residual * weight).ravel()
        rest = data - span @ (span.T @ data)
        return cls(
            by_base=by_base * weight[:, :, None],
            span=span.reshape(*compared.residual.shape, -1),
            left=rest.reshape(compared.residual.shape),
        )

    def best(self, order: Index) -> _Step:
        """Return the step that gains most between two poses of an order (P,)."""
        count, least = len(order), SESSIONS.least_poses
        steps = [_Step(k, self._gain(order[k:])) for k in range(least, count - least + 1)]
        return max(steps, key=lambda step: step.gain, default=_Step(0, -np.inf))

    def _gain(self, after: Index) -> float:
        """Return the gain of log evidence by another base in some poses, by Schwarz's criterion."""
        moved = np.zeros_like(self.by_base)
        moved[after] = self.by_base[after]
        span = self.span.reshape(-1, self.span.shape[2])
        flat = moved.reshape(len(span), -1)
        flat = flat - span @ (span.T @ flat)
        data = self.left.ravel()
        explained = flat @ np.linalg.lstsq(flat, data, rcond=SESSIONS.least_singular)[0]
        readings = int(np.count_nonzero(data))
        before, then = float(data @ data), float(np.sum((data - explained) ** 2))
        ratio = before / max(then, np.finfo(float).tiny)
        # One more unknown is the place of the step.
        return 0.5 * readings * float(np.log(ratio)) - 0.5 * (flat.shape[1] + 1) * float(
            np.log(max(readings, 1))
        )
