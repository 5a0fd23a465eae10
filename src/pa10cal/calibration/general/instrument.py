"""What an instrument compares: predicted with seen, and the derivative of the difference.

The chain ends at the end-effector frame. Where the target sits on it is part of the model: for an
instrument that gives poses six small motions of the tool, for one that gives positions or distances
the place of every target. A distance is that from the origin of the instrument's frame, so the
place of the fixed point is the base frame's position, and its attitude does not matter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.calibration.pose_error import cross_matrix, pose_error
from pa10cal.campaign.seen import SeenDistances, SeenPoints, SeenPoses
from pa10cal.terms.term import Parameter

Array = NDArray[np.float64]
Seen = SeenPoses | SeenPoints | SeenDistances


@dataclass(frozen=True)
class Comparison:
    """Predicted less seen in P poses, b components each; zero rows where nothing was seen.

    Attributes:
        residual: (P, b) [m], and chord of the attitude [rad] where it is seen.
        by_end: (P, b, 6) derivative by velocity and angular velocity of the end of the chain, along
            the instrument's axes.
        by_place: (P, b, t) derivative by the places of targets (t = 0 where the tool is of the
            chain).
    """

    residual: Array
    by_end: Array
    by_place: Array


def place_parameters(seen: Seen) -> tuple[Parameter, ...]:
    """Return the coordinates of targets in the end-effector frame that are unknowns of the fit."""
    return tuple(
        Parameter(f"target_{name}_{axis}".replace("__", "_"), "m", 1e-3)
        for name in _targets(seen)
        for axis in "xyz"
    )


def compare(T_instr_ee: Array, places_m: Array, seen: Seen) -> Comparison:
    """Compare predicted poses of the end of the chain with what was seen.

    Args:
        T_instr_ee: (P, 4, 4) end of the chain in the instrument's frame [m].
        places_m: (t,) places of the targets in the end-effector frame, as `place_parameters`.
        seen: what was seen.
    """
    count = len(T_instr_ee)
    if isinstance(seen, SeenPoses):
        error = pose_error(T_instr_ee, seen.T_instr_target)
        by_end = np.zeros((count, 6, 6))
        by_end[:, :3, :3] = np.eye(3)
        by_end[:, 3:, 3:] = error.by_rotation
        residual = np.concatenate([error.position_m, error.chord], axis=1)
        return Comparison(residual, by_end, np.zeros((count, 6, 0)))
    p_ee_m = places_m.reshape(-1, 3)
    arms = np.einsum("pij,bj->pbi", T_instr_ee[:, :3, :3], p_ee_m)
    p_instr_m = T_instr_ee[:, None, :3, 3] + arms
    targets = len(p_ee_m)
    by_end = np.zeros((count, targets, 3, 6))
    by_end[..., :3] = np.eye(3)
    by_end[..., 3:] = -cross_matrix(arms)
    by_place = np.zeros((count, targets, 3, targets, 3))
    for b in range(targets):
        by_place[:, b, :, b] = T_instr_ee[:, :3, :3]
    by_places = by_place.reshape(count, targets, 3, 3 * targets)
    if isinstance(seen, SeenPoints):
        residual = p_instr_m - seen.p_instr_m
        missing = np.isnan(residual)
        for part in (residual, by_end, by_places):
            part[missing] = 0.0
        rows = (count, 3 * targets)
        return Comparison(
            residual.reshape(rows), by_end.reshape(*rows, 6), by_places.reshape(*rows, 3 * targets)
        )
    distance = np.linalg.norm(p_instr_m[:, 0], axis=1)
    along = p_instr_m[:, 0] / distance[:, None]
    return Comparison(
        (distance - seen.d_m)[:, None],
        np.einsum("pi,pij->pj", along, by_end[:, 0])[:, None],
        np.einsum("pi,pij->pj", along, by_places[:, 0])[:, None],
    )


def ideal(T_instr_ee: Array, places_m: Array, like: Seen) -> Seen:
    """Return what the instrument would see of these poses without error, all targets in sight."""
    count = len(T_instr_ee)
    if isinstance(like, SeenPoses):
        return SeenPoses(T_instr_ee, np.broadcast_to(np.eye(6), (count, 6, 6)))
    arms = np.einsum("pij,bj->pbi", T_instr_ee[:, :3, :3], places_m.reshape(-1, 3))
    p_instr_m = T_instr_ee[:, None, :3, 3] + arms
    if isinstance(like, SeenPoints):
        unit = np.broadcast_to(np.eye(3), (*p_instr_m.shape[:2], 3, 3))
        return SeenPoints(like.names, p_instr_m, unit, like.p_ee_stated_m)
    return SeenDistances(np.linalg.norm(p_instr_m[:, 0], axis=1), np.ones(count))


def stated_covariance(seen: Seen) -> Array:
    """Return the covariance (P, b, b) that the instrument states; unit where nothing was seen."""
    if isinstance(seen, SeenPoses):
        return seen.cov
    if isinstance(seen, SeenDistances):
        return (seen.u_m**2)[:, None, None]
    count, targets = seen.p_instr_m.shape[:2]
    cov = np.zeros((count, targets, 3, targets, 3))
    for b in range(targets):
        cov[:, b, :, b] = np.where(
            np.isnan(seen.p_instr_m[:, b, :1, None]), np.eye(3), seen.cov_m2[:, b]
        )
    return cov.reshape(count, 3 * targets, 3 * targets)


def components_seen(seen: Seen) -> NDArray[np.bool_]:
    """Return which of the b components were seen in each pose, (P, b)."""
    if isinstance(seen, SeenPoses):
        return np.ones((len(seen.T_instr_target), 6), dtype=bool)
    if isinstance(seen, SeenDistances):
        return np.ones((len(seen.d_m), 1), dtype=bool)
    return np.isfinite(seen.p_instr_m).reshape(len(seen.p_instr_m), -1)


def kinds(seen: Seen) -> tuple[tuple[str, slice], ...]:
    """Return the kinds of components that have a scatter of their own, and where they stand."""
    if isinstance(seen, SeenPoses):
        return (("position", slice(0, 3)), ("attitude", slice(3, 6)))
    if isinstance(seen, SeenDistances):
        return (("distance", slice(0, 1)),)
    return (("position", slice(0, 3 * len(seen.names))),)


def _targets(seen: Seen) -> tuple[str, ...]:
    if isinstance(seen, SeenPoses):
        return ()
    return seen.names if isinstance(seen, SeenPoints) else ("",)
