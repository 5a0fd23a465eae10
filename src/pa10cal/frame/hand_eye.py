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
from functools import cached_property, partial

import numpy as np
from scipy.spatial.transform import Rotation

from pa10cal.arrays import Array, Index, homogeneous, nearest_rotation, taken
from pa10cal.errors import CalibrationError
from pa10cal.frame.rigid_fit import LEVER_M, Located, by_small_motion
from pa10cal.numerics import least_squares

#: Poses that are needed to fit a base frame, and distances to find a fixed point.
_NEEDED_POSES = (3, "poses to fit a base frame to", "base frame")
_NEEDED_DISTANCES = (4, "distances to find the fixed point", "fixed point")
#: Poses, and distances, that choose between starts.
_MOST_POSES, _MOST_DISTANCES = 100, 300
#: The null space depends a little on the solution, so it is found again there.
PASSES = 2
#: Part of the cost that makes no difference between two starts.
_ROUGHLY = 1e-4
#: Steps after which starts are compared, how many of them go on, and by how many steps.
_FIRST_STEPS, _MOST_STARTS, _MORE_STEPS = 5, 2, 25


@dataclass(frozen=True)
class TargetProblem:
    """What was seen of B targets in P poses; K of these were seen."""

    p_base_m: Array  # (P, 3) modelled positions of the end-effector
    R_base: Array  # (P, 3, 3) modelled orientations
    p_instr_targets_m: Array  # (P, B, 3) measured positions, nan where a target was not seen
    R_instr_target: Array | None  # (P, 3, 3) measured orientations, where there are any
    weights: Array  # (P,) weights of the poses
    p_ee_stated_m: Array  # (B, 3) stated places of the targets
    # (P,) distances of the one target from the instrument's origin, where these alone were
    # measured: positions are that origin then, and the base is not turned
    d_m: Array | None = None

    @classmethod
    def of(
        cls,
        T_base_ee: Array,
        p_instr_m: Array,
        p_ee_stated_m: Array,
        weights: Array | None,
        R_instr_target: Array | None = None,
        d_m: Array | None = None,
    ) -> TargetProblem:
        """Gather what was seen; see the attributes. None weighs all poses alike.

        Raises:
            CalibrationError: with fewer than three poses.
        """
        poses = int(np.count_nonzero(np.isfinite(p_instr_m[..., 0]).any(axis=1)))
        least, what, place = _NEEDED_POSES if d_m is None else _NEEDED_DISTANCES
        if poses < least:
            raise CalibrationError(
                f"too few {what}",
                where=f"poses for the {place}",
                value=poses,
                allowed=f"at least {least}",
                remedy="measure more poses",
            )
        weights = np.ones(len(T_base_ee)) if weights is None else weights
        p_m, R = T_base_ee[:, :3, 3], T_base_ee[:, :3, :3]
        return cls(p_m, R, p_instr_m, R_instr_target, weights, p_ee_stated_m, d_m)

    @property
    def of_base(self) -> int:
        """Return how many unknowns the base has: distances show no turn of it."""
        return 6 if self.d_m is None else 3

    @property
    def orientations(self) -> int:
        """Return how many orientations were measured."""
        return 0 if self.R_instr_target is None else len(self.R_instr_target)

    def thinned(self) -> TargetProblem:
        """Return the problem of few poses, drawn at random, always the same; itself if few."""
        most = _MOST_POSES if self.d_m is None else _MOST_DISTANCES
        if len(self.weights) <= most:
            return self
        # Drawn, not every n-th: what was seen may alternate.
        drawn = np.random.default_rng(0).permutation(len(self.weights))[:most]
        return taken(self, np.sort(drawn), "p_ee_stated_m")

    @cached_property
    def seen(self) -> tuple[Index, Index]:
        """Return pose and target of every row, (K,) each."""
        pose, target = np.nonzero(np.isfinite(self.p_instr_targets_m[..., 0]))
        return pose, target

    @cached_property
    def p_instr_m(self) -> Array:
        """Return the measured positions, (K, 3)."""
        return np.asarray(self.p_instr_targets_m[self.seen])

    @cached_property
    def root_weight(self) -> Array:
        """Square root of the weight of every row, (K,)."""
        return np.sqrt(self.weights[self.seen[0]])

    @cached_property
    def _p_rows_m(self) -> Array:
        """Modelled position of the end-effector of every row, (K, 3)."""
        return self.p_base_m[self.seen[0]]

    def in_base(self, p_ee_m: Array) -> Array:
        """Return the modelled places (K, 3) of the targets in the base frame."""
        carried = self.by_places.reshape(-1, p_ee_m.size) @ p_ee_m.ravel()
        return np.asarray(self._p_rows_m + carried.reshape(-1, 3))

    @cached_property
    def by_places(self) -> Array:
        """Return the derivative (K, 3, 3 B) of those places by the targets' places."""
        pose, target = self.seen
        by_places = np.zeros((len(target), 3, self.p_ee_stated_m.size))
        rows, columns = np.arange(len(target))[:, None, None], 3 * target[:, None, None]
        by_places[rows, np.arange(3)[:, None], columns + np.arange(3)] = self.R_base[pose]
        return by_places


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
        root = LEVER_M * np.sqrt(problem.weights)
        of_turns = by_step[3 * rows :].reshape(orientations, 3, -1)
        of_turns[:, :, 3:6] = root[:, None, None] * np.eye(3)
        of_turns[:, :, -3:] = root[:, None, None] * problem.R_base
        residual.append(root[:, None] * off_rad)
    if free is not None:
        own, count = problem.of_base, free.shape[1]
        by_step[:, own : own + count] = by_step[:, own:] @ free
        by_step = by_step[:, : own + count]
    return least_squares.Linearised(by_step, np.concatenate(residual).ravel())


#: A start turned by less than this from where another led, leads there too [rad].
_SAME_RAD = 0.5
#: Root mean square spread across a line that positions must have to determine a rotation.
LEAST_SPREAD_M = 1e-3
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
        _by_kronecker(few, R_instr_target),
        _mean_turn(few.weights, R_instr_target @ _transposed(few.R_base)),
        *_by_positions(few),
    ]
    starts = []
    for R_instr_base in turns:
        of_target = _transposed(R_instr_base @ few.R_base) @ R_instr_target
        starts.append(first_guess(few, R_instr_base, _mean_turn(few.weights, of_target)))
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
    turns = _by_positions(few)
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
        for point_m, target_m in _by_distances(problem.thinned())
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


def _by_positions(problem: TargetProblem) -> list[Array]:
    """Return rotations of the base to start from, by positions; none if they span no plane."""
    root = problem.root_weight[:, None]
    mean = np.average(problem.p_instr_m, axis=0, weights=root[:, 0] ** 2)
    off = root * (problem.p_instr_m - mean)
    spread = np.linalg.svd(off, compute_uv=False)
    if spread[1] <= max(least_squares.OPEN * spread[0], LEAST_SPREAD_M * np.linalg.norm(root)):
        return []
    stated = problem.in_base(problem.p_ee_stated_m)
    stated = root * (stated - np.average(stated, axis=0, weights=root[:, 0] ** 2))
    # x = S (p - mean) + s - R_base p_ee, linear in S (nine), s and the places.
    by_unknowns = np.zeros((len(off), 3, 12 + problem.p_ee_stated_m.size))
    for row in range(3):
        by_unknowns[:, row, row:9:3] = off
        by_unknowns[:, row, 9 + row] = root[:, 0]
    by_unknowns[:, :, 12:] = -root[..., None] * problem.by_places
    x_base_m = (root * problem.p_base_m[problem.seen[0]]).ravel()
    solved = _solved(by_unknowns.reshape(len(x_base_m), -1), x_base_m)
    # The nine go by columns of S, the inverse of the base's rotation.
    by_equations = solved[:9].reshape(3, 3)
    return [nearest_rotation(by_equations), nearest_rotation(off.T @ stated)]


#: Starts put the target of distances this far from its stated place, either way along each axis.
_ASIDE_M = 0.2
#: Unknowns of the equation that is linear in products of target and point.
_PRODUCTS = 16


def _by_distances(problem: TargetProblem) -> list[tuple[Array, Array]]:
    """Return fixed points and targets, (3,) each, to start from."""
    d_m = np.asarray(problem.d_m)
    x, R, root = problem.p_base_m, problem.R_base, problem.root_weight
    starts, aside = [], np.vstack([np.zeros(3), np.eye(3), -np.eye(3)])
    for p_ee_m in problem.p_ee_stated_m + _ASIDE_M * aside:
        place = x + R @ p_ee_m
        mean = place.mean(axis=0)
        off = place - mean
        # |off|^2 - d^2 = 2 off c + (a constant), c from the mean.
        sphere = np.hstack([2.0 * off, np.ones((len(off), 1))])
        square = (off**2).sum(axis=1) - d_m**2
        c = _solved(root[:, None] * sphere, root * square)[:3]
        across = np.linalg.svd(off)[2][2]
        starts += [(mean + c, p_ee_m), (mean + c - 2.0 * (c @ across) * across, p_ee_m)]
    if len(d_m) >= _PRODUCTS:
        columns, square = distance_products(x, R, d_m)
        solved = _solved(root[:, None] * columns, root * square)
        starts.append((solved[3:6], solved[:3]))
    return starts


def distance_products(x: Array, R: Array, d_m: Array) -> tuple[Array, Array]:
    """Return the equations (P, 16) of u, c, the products of their parts, and their squares.

    d^2 - |x|^2 = 2 x.R u - 2 x.c - 2 c.R u + (|u|^2 + |c|^2) for target u and point c.
    """
    turned, ones = np.einsum("pji,pj->pi", R, x), np.ones((len(x), 1))
    columns = np.hstack([2.0 * turned, -2.0 * x, -2.0 * R.reshape(-1, 9), ones])
    return columns, d_m**2 - (x**2).sum(axis=1)


def _solved(columns: Array, values: Array) -> Array:
    return np.asarray(np.linalg.lstsq(columns, values, rcond=1e-9)[0], dtype=np.float64)


def _by_kronecker(problem: TargetProblem, R_instr_target: Array) -> Array:
    """Return the rotation of the base by orientations alone.

    With X the target's rotation R_instr_target X' = R_instr_base R_base, so that the sum of R_base
    (x) R_instr_target carries X' to as many times R_instr_base as there are poses, and nothing
    further.
    """
    weighted = problem.weights[:, None, None] * problem.R_base
    summed = np.einsum("pij,pkl->ikjl", weighted, R_instr_target).reshape(9, 9)
    first = np.asarray(np.linalg.svd(summed)[0][:, 0], dtype=float)
    dominant = first.reshape(3, 3).T  # by columns
    return nearest_rotation(dominant if np.linalg.det(dominant) > 0.0 else -dominant)


def _mean_turn(weights: Array, turns: Array) -> Array:
    """Return the chordal mean of rotations (P, 3, 3)."""
    return nearest_rotation(np.tensordot(weights, turns, axes=1))


def _transposed(matrices: Array) -> Array:
    return np.swapaxes(matrices, -1, -2)


def _rms(residuals: Array, weights: Array) -> float:
    return float(np.sqrt(np.average((residuals**2).sum(axis=1), weights=weights)))


def _said(direction: Array, names: Sequence[str]) -> str:
    """Describe a direction of the targets: all positions (3 B), then any orientation."""
    places, turn = direction[: 3 * len(names)].reshape(-1, 3), direction[3 * len(names) :]
    parts = []
    if len(names) > 1 and np.abs(places - places[0]).max() < 1e-6:
        parts.append(f"all targets along {least_squares.axis_text(places[0])}")
    else:
        moved = np.linalg.norm(places, axis=1) > 1e-6
        named = zip(names, places, strict=True)
        parts += [
            f"{k} along {least_squares.axis_text(p)}"
            for (k, p), far in zip(named, moved, strict=True)
            if far
        ]
    if len(turn) and np.linalg.norm(turn) > 1e-6:
        parts.append(f"{names[0]} about {least_squares.axis_text(turn)}")
    return " with ".join(parts)
