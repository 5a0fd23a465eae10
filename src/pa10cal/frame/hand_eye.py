"""Base frame and target on the end-effector, as an instrument measured them.

Robot-world and hand-eye calibration (A X = Y B): with the nominal model's T_base_ee of every pose
these solve T_instr_target = T_instr_base T_base_ee T_ee_target for the two constant frames; from
distances they solve d = |T_base_ee p_ee - p_base_point| for target and fixed point. Fits start in
closed form (`target_problem`) and are refined by Gauss-Newton steps. Directions of the target that
cannot be separated from the base frame (its height, where all orientations differ by turns about
one axis) are held as stated, and named.

Throughout, T_base_ee is the modelled end-effector (P, 4, 4) [m], and weights (P,) are those of the
squared residuals of the poses, None for equal ones.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array, homogeneous, nearest_rotation
from pa10cal.errors import CalibrationError
from pa10cal.frame.point_fits import by_small_motion, fit_rigid, fit_rigid_weighted
from pa10cal.frame.target_problem import (
    TargetProblem,
    free_turns,
    mean_turn,
    points_by_distances,
    turn_by_orientations,
    turns_by_positions,
)
from pa10cal.numerics.least_squares import (
    DESCENT_STEPS,
    NOT_REPRODUCED,
    SMALL_GAIN,
    Linearised,
    Split,
    axis_text,
    descend,
    split_identified,
)
from pa10cal.rules import FRAMES

#: The null space depends a little on the solution, so it is found again there (computing).
_PASSES = 2
#: Relative change of the cost at which a rough fit has converged (computing).
_ROUGHLY = 1e-4
#: Steps after which starts are compared, how many of them go on, and by how many steps (computing).
_FIRST_STEPS, _MOST_STARTS, _MORE_STEPS = 5, 2, 25
#: A start turned by less than this from the end of another start is not followed [rad] (computing).
_SAME_RAD = 0.5
#: Part of a direction of motion of unit length that counts as zero (computing).
_NO_MOTION = 1e-6
#: Smallest distance that is divided by [m] (computing).
_TINY_M = np.finfo(float).tiny


@dataclass(frozen=True)
class Located:
    """Base frame and targets, found with the nominal arm."""

    T_instr_base: Array  # (4, 4) base in the instrument's frame [m]
    scatter_m: float  # root mean square of the residuals, positions or distances
    poses: int  # number of poses that were fitted
    # (3,) standard uncertainty of the direction of each axis of the base, per direction across it,
    # for independent residuals; None where the instrument measures distances alone
    axis_u_rad: Array | None = None
    # root mean square angle between measured and modelled orientations; None where none is measured
    scatter_rad: float | None = None
    # (4, 4) the one target whose orientation is measured; None where it is the end-effector itself,
    # or there is none
    T_ee_target: Array | None = None
    # (B, 3) places of targets, in the order of their names
    p_ee_targets_m: Array | None = None
    # (4, 4) `T_ee_target` of each campaign of a group, by its name
    T_ee_target_of: Mapping[str, Array] = field(default_factory=dict)
    lever_m: float = FRAMES.lever_m  # at which orientations count as positions
    # directions of the targets that the poses do not identify, held as stated
    held: tuple[str, ...] | None = None
    # whether the places of the targets are stated; None where it does not matter
    stated: bool | None = None

    @property
    def misfit_m(self) -> float:
        """Return the rms misfit, orientations by the lengths that they make at `lever_m`."""
        return float(np.hypot(self.scatter_m, self.lever_m * (self.scatter_rad or 0.0)))

    @property
    def T_ee_targets(self) -> Array:
        """Return the targets in the end-effector frame, (B, 4, 4) [m], without turns if unknown."""
        if self.T_ee_target is not None:
            return self.T_ee_target[None]
        places_m = np.zeros((0, 3)) if self.p_ee_targets_m is None else self.p_ee_targets_m
        return homogeneous(np.eye(3), places_m)

    def targets(self, T_base_ee: Array) -> Array:
        """Return the targets in the instrument's frame, (P, B, 4, 4) [m]."""
        return np.asarray(self.T_instr_base @ T_base_ee[:, None] @ self.T_ee_targets)


@dataclass(frozen=True)
class Guess:
    """Values of the unknowns: base frame and targets."""

    R_instr_base: Array  # (3, 3)
    p_instr_base_m: Array  # (3,)
    p_ee_m: Array  # (B, 3) places of the targets
    R_ee_target: Array  # (3, 3) orientation of the target, where one was measured


class _Refined(NamedTuple):
    """A refined guess."""

    guess: Guess
    problem: Linearised  # linearised there
    split: Split  # which steps of the targets the poses identify


def first_guess(problem: TargetProblem, R_instr_base: Array, R_ee_target: Array) -> Guess:
    """Return a guess with these rotations: targets as stated, the origin by the mean residual."""
    origins_m = problem.p_instr_m - problem.in_base(problem.p_ee_stated_m) @ R_instr_base.T
    p_instr_base_m = np.average(origins_m, axis=0, weights=problem.root_weight**2)
    return Guess(R_instr_base, p_instr_base_m, problem.p_ee_stated_m, R_ee_target)


def refined(
    problem: TargetProblem,
    guess: Guess,
    *,
    roughly: bool = False,
    most_steps: int = DESCENT_STEPS,
) -> _Refined:
    """Refine a guess; directions of the targets that the poses do not identify are held.

    Args:
        roughly: whether to stop when it is clear which of several guesses has the lowest cost.
        most_steps: bound on the steps of a descent.
    """
    all_identified = False
    for _ in range(1 if roughly else _PASSES):
        start, at_start, base = guess, _linearise(problem, guess), problem.base_unknowns
        split = split_identified(at_start.by_step[:, base:], at_start.by_step[:, :base])
        if all_identified and not split.unidentified.size:
            break
        all_identified = not split.unidentified.size
        guess, linearised = descend(
            start,
            partial(_linearise_free, problem, split.identified, (start, at_start)),
            partial(_moved, base=base, free=split.identified),
            _ROUGHLY if roughly else SMALL_GAIN,
            most_steps,
        )
    return _Refined(guess, linearised, split)


def _moved(guess: Guess, step: Array, *, base: int, free: Array) -> Guess:
    """Return a guess after a step: shift and turn of the base along its axes, then the targets.

    Args:
        base: number of unknowns of the base, the first ones.
        free: (t, f) directions of the targets in which they move: places of all, then the turn.
    """
    of_targets, places = free @ step[base:], guess.p_ee_m.size
    R_instr_base, R_ee_target = guess.R_instr_base, guess.R_ee_target
    turns = np.concatenate([step[3:base], of_targets[places:]]).reshape(-1, 3)
    if len(turns):
        rotations = Rotation.from_rotvec(turns).as_matrix()
        R_instr_base = R_instr_base @ rotations[0]
        if len(of_targets) > places:
            R_ee_target = rotations[1] @ R_ee_target
    return Guess(
        R_instr_base,
        guess.p_instr_base_m + guess.R_instr_base @ step[:3],
        guess.p_ee_m + of_targets[:places].reshape(-1, 3),
        R_ee_target,
    )


def _residuals(problem: TargetProblem, guess: Guess, p_base_m: Array) -> tuple[Array, Array]:
    """Return residuals in the base frame: seen less modelled positions (K, 3) and turns (P, 3).

    Of distances the residuals are (K, 1).

    Args:
        p_base_m: (K, 3) modelled positions of the targets in the base frame.
    """
    R = guess.R_instr_base
    residuals_m = (problem.p_instr_m - guess.p_instr_base_m) @ R - p_base_m
    if problem.d_m is not None:
        residuals_m = (problem.d_m - np.linalg.norm(residuals_m, axis=1))[:, None]
    if problem.R_instr_target is None:
        return residuals_m, np.zeros((0, 3))
    modelled = problem.R_base @ guess.R_ee_target
    differences = R.T @ problem.R_instr_target @ np.swapaxes(modelled, 1, 2)
    return residuals_m, Rotation.from_matrix(differences, assume_valid=True).as_rotvec()


def _linearise_free(
    problem: TargetProblem, free: Array, known: tuple[Guess, Linearised], guess: Guess
) -> Linearised:
    """Return the weighted problem, linear in the step of `_moved`.

    Args:
        free: (t, f) directions of the targets in which they move.
        known: a guess, and the problem there with all directions.
    """
    at, here = known
    if guess is not at:
        here = _linearise(problem, guess)
    base, count = problem.base_unknowns, free.shape[1]
    by_step = here.by_step[:, : base + count].copy()
    by_step[:, base:] = here.by_step[:, base:] @ free
    return Linearised(by_step, here.residual)


def _linearise(problem: TargetProblem, guess: Guess) -> Linearised:
    """Return the weighted problem, linear in steps of the base and of the targets in any direction.

    The derivative of a squared angle by a small turn is exact also where the angle is not small.
    """
    p_base_m = problem.in_base(guess.p_ee_m)
    residuals_m, residuals_rad = _residuals(problem, guess, p_base_m)
    residual = [problem.root_weight[:, None] * residuals_m]
    rows, places, orientations = len(residuals_m), problem.p_ee_stated_m.size, problem.orientations
    if problem.d_m is None:
        by_step = np.zeros((3 * (rows + orientations), 6 + places + (3 if orientations else 0)))
        of_places = by_step[: 3 * rows].reshape(rows, 3, -1)
        of_places[:, :, :6] = by_small_motion(p_base_m)
        of_places[:, :, 6 : 6 + places] = problem.by_places
        of_places *= problem.root_weight[:, None, None]
    else:
        line_m = guess.p_instr_base_m + p_base_m  # from the fixed point to the target
        unit = line_m / np.maximum(np.linalg.norm(line_m, axis=1), _TINY_M)[:, None]
        by_target = (unit[:, None] @ problem.by_places)[:, 0]
        by_step = problem.root_weight[:, None] * np.hstack([unit, by_target])
    if orientations:
        root = problem.lever_m * np.sqrt(problem.weights)
        of_turns = by_step[3 * rows :].reshape(orientations, 3, -1)
        of_turns[:, :, 3:6] = root[:, None, None] * np.eye(3)
        of_turns[:, :, -3:] = root[:, None, None] * problem.R_base
        residual.append(root[:, None] * residuals_rad)
    return Linearised(by_step, np.concatenate(residual).ravel())


def seed_from_nominal(p_instr_m: Array, p_base_m: Array) -> Located:
    """Fit the base frame to measured positions (P, 3), by those of the nominal model.

    For campaigns without straight moves.

    Args:
        p_base_m: (P, 3) positions of the nominal model in the base frame.

    Raises:
        CalibrationError: with fewer than three poses, or when the positions lie on one line.
    """
    count = len(p_instr_m)
    if count < 3:
        raise CalibrationError(
            "too few poses to fit a base frame to",
            where="unloaded poses",
            value=count,
            allowed="at least 3",
            remedy="measure more unloaded grid poses, or straight moves",
        )
    fit = fit_rigid(p_base_m, p_instr_m)
    variance = float(fit.rms) ** 2 * count / (3 * count - 6)
    # The covariance scales with the variance; a floor keeps it invertible when the fit is exact.
    scale = max(variance, np.finfo(float).tiny ** 0.5)
    points = np.broadcast_to(scale * np.eye(3), (1, count, 3, 3))
    of_turn = fit_rigid_weighted(p_base_m, p_instr_m[None], points).covariance[0, 3:, 3:]
    axes = fit.T[:3, :3]
    about_axis = np.einsum("ik,ij,jk->k", axes, of_turn, axes)
    across = (np.trace(of_turn) - about_axis) / 2.0
    return Located(fit.T, float(fit.rms), count, np.sqrt(across))


def hand_eye_from_poses(
    T_base_ee: Array,
    T_instr_target: Array,
    weights: Array | None = None,
    *,
    roughly: bool = False,
) -> Located:
    """Solve T_instr_target (P, 4, 4) = T_instr_base T_base_ee T_ee_target for the frames.

    Rotations start from the orientations in closed form (exact for exact data with turns about more
    than one axis), from the positions alone, and from a target that is not turned; the best of all
    refined starts is returned. Directions of the target that the poses do not identify stay at the
    end-effector.

    Args:
        roughly: whether the scatter to a part in a million is enough.

    Raises:
        CalibrationError: with fewer than three poses.
    """
    p_instr_m, R_instr = T_instr_target[:, None, :3, 3], T_instr_target[:, :3, :3]
    problem = TargetProblem.of(T_base_ee, p_instr_m, np.zeros((1, 3)), weights, R_instr)
    few = problem.thinned
    R_instr_target = np.asarray(few.R_instr_target)
    turns = [
        turn_by_orientations(few, R_instr_target),
        mean_turn(few.weights, R_instr_target @ np.swapaxes(few.R_base, 1, 2)),
        *turns_by_positions(few),
    ]
    starts = []
    for R_instr_base in turns:
        of_target = np.swapaxes(R_instr_base @ few.R_base, 1, 2) @ R_instr_target
        starts.append(first_guess(few, R_instr_base, mean_turn(few.weights, of_target)))
    starts.append(first_guess(few, turns[1], np.eye(3)))
    return _best(problem, starts, ["the target"], roughly)


def target_on_base(T_instr_base: Array, T_base_ee: Array, T_instr_target: Array) -> Array:
    """Return the mean T_ee_target (4, 4) of poses (P, 4, 4), with a known base frame."""
    T_ee_targets = np.linalg.inv(T_instr_base @ T_base_ee) @ T_instr_target
    T_ee_target = T_ee_targets.mean(axis=0)
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

    Rotations start from the positions in closed form, and from a rigid fit of the targets at their
    stated places; the better of the refined starts is returned. About a line on which all positions
    lie, as those of two touched points, the base is turned anyhow, which changes no arm.

    Args:
        p_instr_m: (P, B, 3) measured positions [m], nan where a target was not seen.
        p_ee_stated_m: (B, 3) value where the poses do not identify a position; None for the
            origin of the end-effector.
        names: (B,) names of the targets, for the directions that are held.
        roughly: whether the scatter to a part in a million is enough.

    Raises:
        CalibrationError: with fewer than three poses, or when a target was never seen.
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
    few = problem.thinned
    turns = turns_by_positions(few)
    found = _best(problem, [first_guess(few, turn, np.eye(3)) for turn in turns], named, roughly)
    free = free_turns(problem) @ found.T_instr_base[:3, :3]
    if not len(free) or found.axis_u_rad is None:
        return found
    # Any angle is as likely as another about these axes, which turn the others with them.
    about = np.sum(free**2, axis=0)
    across = (about.sum() - about) * np.pi**2 / 6.0
    held = tuple(f"the base about {axis_text(axis)}" for axis in free)
    u_rad = np.hypot(found.axis_u_rad, np.sqrt(across))
    return replace(found, axis_u_rad=u_rad, held=(*(found.held or ()), *held))


def ranging(
    T_base_ee: Array,
    d_m: Array,
    p_ee_stated_m: Array | None = None,
    weights: Array | None = None,
    *,
    roughly: bool = False,
) -> Located:
    """Solve d = |T_base_ee p_ee - p_base| for the target p_ee and the fixed point p_base.

    The best of the refined starts of `points_by_distances` is returned.

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
        for point_m, target_m in points_by_distances(problem.thinned)
    ]
    return _best(problem, starts, ["the target"], roughly)


def _best(
    problem: TargetProblem, starts: Sequence[Guess], names: list[str], roughly: bool
) -> Located:
    """Return the best of all refined starts; a sample of the poses decides which is best."""
    few, directional = problem.thinned, problem.d_m is None
    ends: list[_Refined] = []
    for start in starts:
        if not (directional and any(_leads_to(start, end.guess) for end in ends)):
            ends.append(refined(few, start, roughly=True, most_steps=_FIRST_STEPS))
    ends = sorted(ends, key=lambda end: end.problem.cost)[:_MOST_STARTS]
    if len(ends) > 1 or few is not problem or roughly:  # else the last refinement does this as well
        ends = [refined(few, end.guess, roughly=True, most_steps=_MORE_STEPS) for end in ends]
    guess, linearised, split = min(ends, key=lambda end: end.problem.cost)
    if split.unidentified.size:
        guess = replace(guess, p_ee_m=problem.p_ee_stated_m)
    if split.unidentified.size or few is not problem or not roughly:
        guess, linearised, split = refined(problem, guess, roughly=roughly)
    if not directional:
        _refuse_unidentified_point(_linearise(problem, guess).by_step[:, :3])
    orientations = problem.orientations
    residuals_m, residuals_rad = _residuals(problem, guess, problem.in_base(guess.p_ee_m))
    by_step = linearised.by_step
    dof = max(len(linearised.residual) - by_step.shape[1], 1)
    of_turn = np.linalg.pinv(by_step.T @ by_step)[3:6, 3:6] * linearised.cost / dof
    # The direction of an axis varies by turns about the other two.
    across = (np.trace(of_turn) - np.diag(of_turn)) / 2.0
    return Located(
        T_instr_base=homogeneous(guess.R_instr_base, guess.p_instr_base_m),
        scatter_m=_rms(residuals_m, problem.root_weight**2),
        poses=len(problem.weights),
        axis_u_rad=np.sqrt(np.maximum(across, 0.0)) if directional else None,
        scatter_rad=_rms(residuals_rad, problem.weights) if orientations else None,
        T_ee_target=homogeneous(guess.R_ee_target, guess.p_ee_m[0]) if orientations else None,
        p_ee_targets_m=None if orientations else guess.p_ee_m,
        lever_m=problem.lever_m,
        held=tuple(_direction_text(direction, names) for direction in split.unidentified.T),
    )


def _leads_to(start: Guess, guess: Guess) -> bool:
    """Return whether the rotations of a start are near those of a guess, refined from another."""
    ends = np.array([guess.R_instr_base, guess.R_ee_target])
    starts = np.array([start.R_instr_base, start.R_ee_target])
    # The trace of the rotation between them is 1 + 2 cos(angle).
    traces = np.sum(ends * starts, axis=(1, 2))
    return bool(traces.min() > 1.0 + 2.0 * np.cos(_SAME_RAD))


def _refuse_unidentified_point(by_point: Array) -> None:
    """Refuse poses whose directions to the fixed point, (P, 3), are nearly in one plane."""
    _, size, directions = np.linalg.svd(by_point, full_matrices=False)
    if size[2] > NOT_REPRODUCED * size[0]:
        return
    open_along = f"along {axis_text(directions[2])} of the base"
    raise CalibrationError(
        "the distances do not identify the fixed point",
        where="poses for the fixed point",
        value=open_along,
        allowed="poses that surround the fixed point's direction on all sides",
        remedy="measure poses further apart along that direction",
    )


def _rms(residuals: Array, weights: Array) -> float:
    return float(np.sqrt(np.average((residuals**2).sum(axis=1), weights=weights)))


def _direction_text(direction: Array, names: Sequence[str]) -> str:
    """Return in words a direction of the targets: places (3 B), then a turn if one is measured."""
    places, turn = direction[: 3 * len(names)].reshape(-1, 3), direction[3 * len(names) :]
    parts = []
    if len(names) > 1 and np.abs(places - places[0]).max() < _NO_MOTION:
        parts.append(f"all targets along {axis_text(places[0])}")
    else:
        parts += [
            f"{name} along {axis_text(place)}"
            for name, place in zip(names, places, strict=True)
            if np.linalg.norm(place) > _NO_MOTION
        ]
    if len(turn) and np.linalg.norm(turn) > _NO_MOTION:
        parts.append(f"{names[0]} about {axis_text(turn)}")
    return " with ".join(parts)
