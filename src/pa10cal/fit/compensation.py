"""Compensation: the positions to command so that a frame comes to wanted poses, with a status.

They are found by the fitted model (`fit.inverse_search`), or where it falls back to another by that
one. Each pose then gets a status: reached, beyond limits, near a singularity or out of reach, so
far as was found. Positions are those of the m axes that the controller counts, see `arm.coupling`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pa10cal.arm.chain import Chain, refuse_another_robot
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Mask
from pa10cal.errors import ModelError
from pa10cal.fit.fitted import Compensation, FallBack, Fitted
from pa10cal.fit.forward import Forward, T_base_away, T_flange_frame, pose_difference, predicted
from pa10cal.fit.inverse_search import InverseSearch, middle_of_range
from pa10cal.fit.loads import blocks
from pa10cal.fit.newton_search import reached, within_limits
from pa10cal.rules import COMMANDS, LISTS


def compensate(
    model: Fitted,
    T: Array,
    frame: str,
    given: PoseStates,
    seed: ArrayLike | None = None,
    T_flange_tcp: ArrayLike | None = None,
    controller: Arm | None = None,
) -> Compensation:
    """Find the joint positions that bring a frame to poses; see `FittedModel.compensate`.

    Args:
        T: (N, 4, 4) poses of the frame in the base frame [m].
        given: loads, arrivals, temperatures and times of the poses; its joint positions are unused.
        seed: (N, m) or (m,) joint positions, nan where there are none.
        T_flange_tcp: (4, 4) TCP that the controller holds; None for the frame as the model has it.
        controller: the arm that the controller computes with; None for that of the model.

    Raises:
        ModelError: when a matrix is not a valid pose, the frame is unknown, or a seed is of another
            arm.
        ArmError: when the controller computes with another robot.
    """
    _refuse_no_poses(T)
    if T_flange_tcp is None:
        tcp = T_flange_frame(model, frame)
    else:
        tcp = numbers(T_flange_tcp, "T_flange_tcp")
        _refuse_no_tcp(tcp)
    if controller is not None:
        refuse_another_robot(model.arm, controller, "controller")
    q, requested = _seeds(model, len(T), seed)
    other = np.zeros(len(T), dtype=bool)
    if len(T):
        q, other = _searched(model, T, frame, given, q, requested)
    branch = np.where(other, "other", "nearest")
    controller_arm = model.arm.controller_arm if controller is None else controller
    # In blocks, because a prediction takes some kilobytes a pose.
    parts = []
    for rows in blocks(len(T)):
        found = _with_status(model, T[rows], frame, given.take(rows), q[rows], branch[rows])
        T_send = np.full((len(rows), 4, 4), np.nan)
        if controller_arm is not None:
            # The controller takes its TCP off the pose it is sent, and computes the joints by the
            # inverse kinematics of its own arm: forward kinematics of q by that arm leads it to q.
            T_send = Chain.of(controller_arm).forward(model.arm.coupling.to_joints(q[rows])) @ tcp
        parts.append(replace(found, T_send=T_send, T_flange_tcp=tcp))
    return Compensation.joined(parts)


def _with_status(
    model: Fitted, T: Array, frame: str, given: PoseStates, q: Array, branch: NDArray[np.str_]
) -> Compensation:
    """Return joint positions (N, m) with their status, and their error at wanted poses T (N, 4, 4).

    `T_send` and `T_flange_tcp` are left to be filled in.
    """
    forward, arm = Forward.of(model, frame), model.arm
    given = replace(given, q_rad=arm.coupling.to_joints(q))
    prediction = predicted(model, given, frame)
    off = pose_difference(prediction.T, T)
    off_m, off_rad = np.linalg.norm(off[:, :3], axis=1), np.linalg.norm(off[:, 3:], axis=1)
    status = np.full(len(T), "ok", dtype="U14")
    lever = np.where(arm.axes_slide, arm.reach_m, 1.0)
    J = arm.coupling.by_axes(forward.by_joints(forward.states(given), terms=False)[1])
    singular_values = np.linalg.svd(J * lever / np.repeat([arm.reach_m, 1.0], 3)[:, None])[1]
    status[singular_values[:, -1] < COMMANDS.singular] = "near_singular"
    status[~within_limits(q, *arm.axis_limits_rad.T)] = "outside_limits"
    near = reached(arm, off_m, off_rad)
    if model.falls_back is not None:
        within_u = (1e3 * off_m < prediction.u_parameters_mm) & (off_rad < COMMANDS.near_rad)
        rows = np.flatnonzero(within_u & ~near)
        near[rows] = _at_step(model, model.falls_back, T[rows], frame, given.take(rows))
    status[~near] = "unreachable"
    return Compensation(
        q,
        status,
        branch,
        error_mm=1e3 * off_m,
        error_deg=np.degrees(off_rad),
        u_mm=prediction.u_mm,
        u_parameters_mm=prediction.u_parameters_mm,
        inside=prediction.inside,
        T_send=np.full((len(T), 4, 4), np.nan),
        T_flange_tcp=np.eye(4),
    )


def _at_step(model: Fitted, fall_back: FallBack, T: Array, frame: str, given: PoseStates) -> Mask:
    """Return which positions reach T by what a model falls back to, where the model itself holds.

    Where the model changes to the other, the prediction has a step, and no position may come
    nearer. The step is part of the uncertainty.
    """
    T_other = T_base_away(fall_back, model) @ predicted(fall_back.model, given, frame).T
    off = pose_difference(T_other, T)
    off_m, off_rad = np.linalg.norm(off[:, :3], axis=1), np.linalg.norm(off[:, 3:], axis=1)
    return fall_back.within.inside(given.q_rad) & reached(model.arm, off_m, off_rad)


def _searched(
    model: Fitted, T: Array, frame: str, given: PoseStates, seeds: Array, requested: Mask
) -> tuple[Array, Mask]:
    """Return joint positions (N, m), and which are on another branch than the nearest, or a jump.

    Where the model falls back to another, they are found by that one, from those found first.

    Args:
        seeds: (N, m) joint positions, nan where there are none; see `_seeds`.
        requested: (N,) for which rows they name a branch.
    """
    search = InverseSearch(Forward.of(model, frame), T, given)
    # A seed may count whole turns that the limits do not allow: the posture is the same.
    seeds = search.turned_near(seeds, seeds)
    if search.branches is None:
        q, other = search.along(seeds, requested)
    else:
        q, other = search.on_branches(seeds, requested)
    if model.falls_back is None:
        return q, other
    fall_back = model.falls_back
    outside = np.flatnonzero(~fall_back.within.inside(model.arm.coupling.to_joints(q)))
    if len(outside):
        T_in_its_base = np.linalg.inv(T_base_away(fall_back, model)) @ T[outside]
        # The branch found is to be kept, whether or not the user named one.
        kept = np.ones(len(outside), dtype=bool)
        q[outside], on_other_branch = _searched(
            fall_back.model, T_in_its_base, frame, given.take(outside), q[outside], kept
        )
        other[outside] |= on_other_branch
        other[:1] &= requested[:1]
    return q, other


def numbers(value: ArrayLike, name: str) -> Array:
    """Return an array of a request; refuse what is none, such as words or rows of unlike length."""
    try:
        return np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise ModelError(
            "not an array of numbers",
            where=name,
            value=str(value)[:60],
            allowed="numbers, in rows of equal length",
            remedy="give an array, or lists of equal length",
        ) from None


def _refuse_no_poses(T: Array) -> None:
    """Refuse wanted poses unless they are homogeneous transforms T (N, 4, 4)."""
    if T.ndim != 3 or T.shape[1:] != (4, 4):
        raise _no_pose("T", T.shape, "(N, 4, 4)")
    valid = _are_poses(T)
    if not valid.all():
        first = int(np.argmin(valid))
        raise _no_pose(f"T[{first}]", T[first].tolist(), "(N, 4, 4)")


def _refuse_no_tcp(T_flange_tcp: Array) -> None:
    """Refuse a TCP unless it is one homogeneous transform (4, 4)."""
    if T_flange_tcp.shape != (4, 4):
        raise _no_pose("T_flange_tcp", T_flange_tcp.shape, "(4, 4)")
    if not _are_poses(T_flange_tcp[None])[0]:
        raise _no_pose("T_flange_tcp", T_flange_tcp.tolist(), "(4, 4)")


def _are_poses(T: Array) -> Mask:
    """Return which matrices (N, 4, 4) are homogeneous transforms with proper rotations."""
    R = T[:, :3, :3]
    off_orthogonal = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2), initial=0.0)
    determinant = np.einsum("pi,pi->p", np.cross(R[:, :, 0], R[:, :, 1]), R[:, :, 2])
    off_last_row = np.abs(T[:, 3] - [0.0, 0.0, 0.0, 1.0]).max(axis=1)
    valid = np.isfinite(T).all(axis=(1, 2)) & (determinant > 0.0)
    valid &= off_orthogonal < LISTS.rotation_within
    valid &= off_last_row < LISTS.rotation_within
    return np.asarray(valid)


def _no_pose(where: str, value: object, shape: str) -> ModelError:
    """Return the refusal of what is no pose."""
    return ModelError(
        "not a pose",
        where=where,
        value=value,
        allowed=f"{shape}, a rotation and a position in metres each, the last row 0, 0, 0, 1",
        remedy="check the orientation: columns are the frame's axes, of length one, the "
        "position beside them; a matrix that is transposed has it in the last row",
    )


def _seeds(model: Fitted, count: int, seed: ArrayLike | None) -> tuple[Array, Mask]:
    """Return seeds (N, m) of `count` rows, and for which the user has named a branch by a seed.

    Rows without a seed, which are nan, follow the row before. The first row always has a seed: the
    middle of the range where the user gave none.
    """
    m = len(model.arm.axes_slide)
    given = np.full(m, np.nan) if seed is None else numbers(seed, "seed")
    if given.shape not in ((m,), (count, m)):
        raise ModelError(
            "seeds of another arm or of other poses",
            where="seed",
            value=given.shape,
            allowed=f"({m},) or ({count}, {m}) for {model.arm.name}",
            remedy="give one column a joint, in radians (metres for a joint that slides)",
        )
    in_part = ~np.isfinite(given).all(axis=-1) & ~np.isnan(given).all(axis=-1)
    if in_part.any():
        row = int(np.argmax(in_part))
        raise ModelError(
            "a seed of some joints only",
            where=f"seed[{row}]" if given.ndim == 2 else "seed",
            value=np.atleast_2d(given)[row].tolist(),
            allowed="finite positions of all joints, or nan for all",
            remedy="complete the seed, or leave it out",
        )
    seeds = given.copy() if given.ndim == 2 else np.full((count, m), np.nan)
    if given.ndim == 1:
        seeds[:1] = given
    requested = np.logical_or.accumulate(np.isfinite(seeds).all(axis=1))
    if count and not requested[0]:
        seeds[0] = middle_of_range(model)
    return seeds, requested
