"""Base frame and target on the end-effector from what an instrument saw: closed form, then refined.

Robot-world and hand-eye calibration (A X = Y B): with the nominal model's T_base_ee of every pose
these solve T_instr_target = T_instr_base T_base_ee T_ee_target for the two constant frames; from
distances they solve d = |T_base_ee p_ee - p_base_point| for target and fixed point. What of the
target's place the base frame can mimic (its height, where all orientations differ by turns about
one axis) is held as stated and named.

Throughout, T_base_ee is the modelled end-effector (P, 4, 4) [m], and weights (P,) are those of the
squared residuals of the poses, None for equal ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array, homogeneous, nearest_rotation
from pa10cal.errors import CalibrationError
from pa10cal.frame.rigid_fit import Located, by_small_motion
from pa10cal.frame.target_problem import (
    TargetProblem,
    mean_turn,
    points_by_distances,
    turn_by_orientations,
    turns_by_positions,
)
from pa10cal.numerics import least_squares
from pa10cal.rules import FRAMES

#: The null space depends a little on the solution, so it is found again there (computing).
PASSES = 2
#: Part of the cost that makes no difference between two starts (computing).
_ROUGHLY = 1e-4
#: Steps after which starts are compared, how many of them go on, and by how many steps (computing).
_FIRST_STEPS, _MOST_STARTS, _MORE_STEPS = 5, 2, 25


@dataclass(frozen=True)
class Guess:
    """Base frame, places of the targets, and orientation of the one whose orientation was seen."""

    R_instr_base: Array
    p_instr_base_m: Array
    p_ee_m: Array
    R_ee_target: Array


def first_guess(problem: TargetProblem, R_instr_base: Array, R_ee_target: Array) -> Guess:
    """Return a guess from rotations of base and target: targets as stated, origin by the mean."""
    origins_m = problem.p_instr_m - problem.in_base(problem.p_ee_stated_m) @ R_instr_base.T
    p_instr_base_m = np.average(origins_m, axis=0, weights=problem.root_weight**2)
    return Guess(R_instr_base, p_instr_base_m, problem.p_ee_stated_m, R_ee_target)


def refined(
    problem: TargetProblem,
    guess: Guess,
    *,
    roughly: bool = False,
    most_steps: int = least_squares.MAX_ITERATIONS,
) -> tuple[Guess, least_squares.Linearised, least_squares.Split]:
    """Refine a guess, holding what of the targets the base can mimic.

    Args:
        roughly: whether to stop where it is clear which of several guesses leads lowest.
        most_steps: bound on the steps of a descent.

    Returns:
        The solution, the problem there, and which steps of the targets (places of all, then the
        orientation where one was seen) the poses identify.
    """
    all_moved = False
    for _ in range(1 if roughly else PASSES):
        whole, own = _linearise(problem, guess).by_step, problem.of_base
        split = least_squares.split_identified(whole[:, own:], whole[:, :own])
        if all_moved and not split.unidentified.size:
            break
        all_moved = not split.unidentified.size
        guess, at = least_squares.descend(
            guess,
            partial(_linearise, problem, free=split.identified),
            partial(_moved, own=own, free=split.identified),
            _ROUGHLY if roughly else least_squares.COST_TOLERANCE,
            most_steps,
        )
    return guess, at, split


def _moved(guess: Guess, step: Array, *, own: int, free: Array) -> Guess:
    """Move origin and turn of the base, along its axes, then the targets."""
    of_targets, places = free @ step[own:], guess.p_ee_m.size
    R_instr_base, R_ee_target = guess.R_instr_base, guess.R_ee_target
    turns = np.concatenate([step[3:own], of_targets[places:]]).reshape(-1, 3)
    if len(turns):
        turned = Rotation.from_rotvec(turns).as_matrix()
        R_instr_base = R_instr_base @ turned[0]
        if len(of_targets) > places:
            R_ee_target = turned[1] @ R_ee_target
    return Guess(
        R_instr_base,
        guess.p_instr_base_m + guess.R_instr_base @ step[:3],
        guess.p_ee_m + of_targets[:places].reshape(-1, 3),
        R_ee_target,
    )


def _residuals(problem: TargetProblem, guess: Guess, p_base_m: Array) -> tuple[Array, Array]:
    """Return seen less modelled positions (K, 3), or distances (K, 1), and turns (P, 3)."""
    R = guess.R_instr_base
    off_m = (problem.p_instr_m - guess.p_instr_base_m) @ R - p_base_m
    if problem.d_m is not None:
        off_m = (problem.d_m - np.linalg.norm(off_m, axis=1))[:, None]
    if problem.R_instr_target is None:
        return off_m, np.zeros((0, 3))
    modelled = problem.R_base @ guess.R_ee_target
    return off_m, Rotation.from_matrix(
        R.T @ problem.R_instr_target @ np.swapaxes(modelled, 1, 2), assume_valid=True
    ).as_rotvec()


def _linearise(
    problem: TargetProblem, guess: Guess, *, free: Array | None = None
) -> least_squares.Linearised:
    """Return the problem in the step of `_moved`; with all of the targets where none is named.

    The derivative of a squared angle by a small turn is exact also where the angle is not small.
    """
    p_base_m = problem.in_base(guess.p_ee_m)
    off_m, off_rad = _residuals(problem, guess, p_base_m)
    residual = [problem.root_weight[:, None] * off_m]
    rows, places, orientations = len(off_m), problem.p_ee_stated_m.size, problem.orientations
    if problem.d_m is None:
        by_step = np.zeros((3 * (rows + orientations), 6 + places + (3 if orientations else 0)))
        of_places = by_step[: 3 * rows].reshape(rows, 3, -1)
        of_places[:, :, :6] = by_small_motion(p_base_m)
        of_places[:, :, 6 : 6 + places] = problem.by_places
        of_places *= problem.root_weight[:, None, None]
    else:
        way_m = guess.p_instr_base_m + p_base_m
        unit = way_m / np.maximum(np.linalg.norm(way_m, axis=1), _NOWHERE_M)[:, None]
        by_target = (unit[:, None] @ problem.by_places)[:, 0]
        by_step = problem.root_weight[:, None] * np.hstack([unit, by_target])
    if orientations:
        root = FRAMES.lever_m * np.sqrt(problem.weights)
        of_turns = by_step[3 * rows :].reshape(orientations, 3, -1)
        of_turns[:, :, 3:6] = root[:, None, None] * np.eye(3)
        of_turns[:, :, -3:] = root[:, None, None] * problem.R_base
        residual.append(root[:, None] * off_rad)
    if free is not None:
        own, count = problem.of_base, free.shape[1]
        by_step[:, own : own + count] = by_step[:, own:] @ free
        by_step = by_step[:, : own + count]
    return least_squares.Linearised(by_step, np.concatenate(residual).ravel())


#: A start turned by less than this from where another led, leads there too [rad] (computing).
_SAME_RAD = 0.5
_NOWHERE_M = np.finfo(float).tiny


def hand_eye_from_poses(
    T_base_ee: Array,
    T_instr_target: Array,
    weights: Array | None = None,
    *,
    roughly: bool = False,
) -> Located:
    """Solve T_instr_target (P, 4, 4) = T_instr_base T_base_ee T_ee_target for the frames.

    Rotations start from the dominant singular vectors of the sum of Kronecker products of measured
    and modelled orientations (exact for exact data with turns about more than one axis), from the
    positions alone, and from a target that is not turned; all starts are refined together with the
    translations by Gauss-Newton steps, and the best is returned. What the poses do not identify of
    the target stays at the end-effector.

    Args:
        roughly: whether the scatter to a part in a million is enough.

    Raises:
        CalibrationError: with fewer than three poses.
    """
    p_instr_m, R_instr = T_instr_target[:, None, :3, 3], T_instr_target[:, :3, :3]
    problem = TargetProblem.of(T_base_ee, p_instr_m, np.zeros((1, 3)), weights, R_instr)
    few = problem.thinned()
    R_instr_target = np.asarray(few.R_instr_target)
    turns = [
        turn_by_orientations(few, R_instr_target),
        mean_turn(few.weights, R_instr_target @ _transposed(few.R_base)),
        *turns_by_positions(few),
    ]
    starts = []
    for R_instr_base in turns:
        of_target = _transposed(R_instr_base @ few.R_base) @ R_instr_target
        starts.append(first_guess(few, R_instr_base, mean_turn(few.weights, of_target)))
    starts.append(first_guess(few, turns[1], np.eye(3)))
    return _best(problem, starts, ["the target"], roughly)


def target_on_base(T_instr_base: Array, T_base_ee: Array, T_instr_target: Array) -> Array:
    """Return the mean T_ee_target (4, 4) of poses (P, 4, 4), with a base frame that is known."""
    each = np.linalg.inv(T_instr_base @ T_base_ee) @ T_instr_target
    T_ee_target = each.mean(axis=0)
    T_ee_target[:3, :3] = nearest_rotation(T_ee_target[:3, :3])
    return np.asarray(T_ee_target)


def hand_eye_from_points(
    T_base_ee: Array,
    p_instr_m: Array,
    p_ee_stated_m: Array | None = None,
    weights: Array | None = None,
    names: Sequence[str] | None = None,
    *,
    roughly: bool = False,
) -> Located:
    """Solve p_instr = T_instr_base (T_base_ee p_ee) for the base frame and the places of B targets.

    Carried into the base frame the equations are linear in a general matrix in the place of the
    base's rotation; its nearest rotation starts the Gauss-Newton steps from any base and any
    places. A rigid fit of the stated places is another start; the best is returned.

    Args:
        p_instr_m: (P, B, 3) measured positions [m], nan where a target was not seen.
        p_ee_stated_m: (B, 3) value where the poses do not identify a position; None for the
            origin of the end-effector.
        names: (B,) names of the targets, for what is held.
        roughly: whether the scatter to a part in a million is enough.

    Raises:
        CalibrationError: with fewer than three poses, when a target was never seen, or when the
            positions lie on one line, so that the base may turn about it.
    """
    targets = p_instr_m.shape[1]
    named = [f"target {name}" for name in names or range(1, targets + 1)]
    times = np.isfinite(p_instr_m[..., 0]).sum(axis=0)
    unseen = [name for name, seen in zip(named, times, strict=True) if not seen]
    if unseen:
        raise CalibrationError(
            f"{unseen[0]} was not observed in any pose",
            where="poses for the base frame",
            allowed="targets observed in some of the poses",
            remedy="remove this target, or measure it",
        )
    p_ee_m = np.zeros((targets, 3)) if p_ee_stated_m is None else p_ee_stated_m
    problem = TargetProblem.of(T_base_ee, p_instr_m, p_ee_m, weights)
    few = problem.thinned()
    turns = turns_by_positions(few)
    if not turns:
        raise CalibrationError(
            "the positions are collinear or coincide, so the turn of the base about them is free",
            where="poses for the base frame",
            allowed="poses whose positions span a plane",
            remedy="measure poses further apart across the line",
        )
    return _best(problem, [first_guess(few, turn, np.eye(3)) for turn in turns], named, roughly)


def ranging(
    T_base_ee: Array,
    d_m: Array,
    p_ee_stated_m: Array | None = None,
    weights: Array | None = None,
    *,
    roughly: bool = False,
) -> Located:
    """Solve d = |T_base_ee p_ee - p_base| for the target p_ee and the fixed point p_base.

    Squared, the equation is linear in target, point, their products and squares, which gives a
    start from anywhere where there are poses enough. For targets at and about the stated place a
    linearised sphere gives the point, and its mirror image in the plane that the poses are nearest
    to. All starts are refined by Gauss-Newton steps, and the best is returned.

    Args:
        d_m: (P,) measured distances [m].
        p_ee_stated_m: (3,) value where the poses do not identify the target; None for the
            origin of the end-effector.
        roughly: whether the scatter to a part in a million is enough.

    Returns:
        The base in a frame about the fixed point, along its own axes.

    Raises:
        CalibrationError: with fewer than four poses, or when these leave the fixed point open.
    """
    p_ee_m = np.zeros((1, 3)) if p_ee_stated_m is None else p_ee_stated_m[None]
    origin = np.zeros((len(d_m), 1, 3))
    problem = TargetProblem.of(T_base_ee, origin, p_ee_m, weights, d_m=d_m)
    starts = [
        Guess(np.eye(3), -point_m, target_m[None], np.eye(3))
        for point_m, target_m in points_by_distances(problem.thinned())
    ]
    return _best(problem, starts, ["the target"], roughly)


def _best(
    problem: TargetProblem, starts: Sequence[Guess], names: list[str], roughly: bool
) -> Located:
    """Return the best of all refined starts; some of the poses decide which is best."""
    few, directional = problem.thinned(), problem.d_m is None
    ends: list[tuple[Guess, least_squares.Linearised, least_squares.Split]] = []
    for start in starts:
        if not (directional and any(_leads_to(start, guess) for guess, _, _ in ends)):
            ends.append(refined(few, start, roughly=True, most_steps=_FIRST_STEPS))
    ahead = sorted(ends, key=lambda end: end[1].cost)[:_MOST_STARTS]
    ends = [refined(few, guess, roughly=True, most_steps=_MORE_STEPS) for guess, _, _ in ahead]
    guess, at, split = min(ends, key=lambda end: end[1].cost)
    if split.unidentified.size:
        guess = replace(guess, p_ee_m=problem.p_ee_stated_m)
    if split.unidentified.size or few is not problem or not roughly:
        guess, at, split = refined(problem, guess, roughly=roughly)
    if not directional:
        _refuse_open_point(_linearise(problem, guess).by_step[:, :3])
    orientations = problem.orientations
    residuals_m, residuals_rad = _residuals(problem, guess, problem.in_base(guess.p_ee_m))
    spare = max(len(at.residual) - at.by_step.shape[1], 1)
    covariance = np.linalg.pinv(at.by_step.T @ at.by_step)[3:6, 3:6] * at.cost / spare
    across = (np.trace(covariance) - np.diag(covariance)) / 2.0
    return Located(
        T_instr_base=homogeneous(guess.R_instr_base, guess.p_instr_base_m),
        scatter_m=_rms(residuals_m, problem.root_weight**2),
        poses=len(problem.weights),
        axis_u_rad=np.sqrt(across) if directional else None,
        scatter_rad=_rms(residuals_rad, problem.weights) if orientations else None,
        T_ee_target=homogeneous(guess.R_ee_target, guess.p_ee_m[0]) if orientations else None,
        p_ee_targets_m=None if orientations else guess.p_ee_m,
        held=tuple(_said(direction, names) for direction in split.unidentified.T),
    )


def _leads_to(start: Guess, guess: Guess) -> bool:
    """Return whether base and target of a start are turned nearly as where another led."""
    ends, own = (np.array([at.R_instr_base, at.R_ee_target]) for at in (guess, start))
    # The trace of a rotation's matrix is 1 + 2 cos(angle).
    traces = np.sum(ends * own, axis=(1, 2))
    return bool(traces.min() > 1.0 + 2.0 * np.cos(_SAME_RAD))


def _refuse_open_point(by_point: Array) -> None:
    """Refuse poses from which the fixed point is seen in directions of a plane or a line."""
    _, size, directions = np.linalg.svd(by_point, full_matrices=False)
    if size[2] > least_squares.OPEN * size[0]:
        return
    open_along = f"along {least_squares.axis_text(directions[2])} of the base"
    raise CalibrationError(
        "the distances do not identify the fixed point",
        where="poses for the fixed point",
        value=open_along,
        allowed="poses that surround the fixed point's direction on all sides",
        remedy="measure poses further apart along that direction",
    )


def _transposed(matrices: Array) -> Array:
    return np.swapaxes(matrices, -1, -2)


def _rms(residuals: Array, weights: Array) -> float:
    return float(np.sqrt(np.average((residuals**2).sum(axis=1), weights=weights)))


#: Part of a direction of motion of unit length that is none (computing).
_NO_MOTION = 1e-6


def _said(direction: Array, names: Sequence[str]) -> str:
    """Describe a direction of the targets: all positions (3 B), then any orientation."""
    places, turn = direction[: 3 * len(names)].reshape(-1, 3), direction[3 * len(names) :]
    parts = []
    if len(names) > 1 and np.abs(places - places[0]).max() < _NO_MOTION:
        parts.append(f"all targets along {least_squares.axis_text(places[0])}")
    else:
        moved = np.linalg.norm(places, axis=1) > _NO_MOTION
        named = zip(names, places, strict=True)
        parts += [
            f"{k} along {least_squares.axis_text(p)}"
            for (k, p), far in zip(named, moved, strict=True)
            if far
        ]
    if len(turn) and np.linalg.norm(turn) > _NO_MOTION:
        parts.append(f"{names[0]} about {least_squares.axis_text(turn)}")
    return " with ".join(parts)
