"""Base frame and targets as linear least squares: design matrices, and closed-form starts of a fit.

Targets at p_ee on the end-effector are measured at p_instr, with p_base and R_base the modelled
pose of the end-effector:

    S p_instr + s = p_base + R_base p_ee,    S = R_instr_base',    s = -S p_instr_base.

With S relaxed to any 3x3 matrix this is linear in S, s and p_ee. The rotation nearest to the
solution starts the non-linear fit (`hand_eye`), and what the relaxed problem leaves is a lower
bound of the misfit of every fit. Relaxed equations also show the unit of what was measured (both
below). A row is one target seen in one pose, K in all.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from pa10cal.arrays import Array, Index, drawn, nearest_rotation, take_rows
from pa10cal.errors import CalibrationError
from pa10cal.numerics.least_squares import NOT_REPRODUCED
from pa10cal.rules import FRAMES

#: Singular values below this part of the largest are zero (computing).
_NO_COLUMN = 1e-9
#: Poses that are needed to fit a base frame, and distances to find a fixed point.
_NEEDED_POSES = (FRAMES.base_poses, "poses to fit a base frame to", "base frame")
_NEEDED_DISTANCES = (FRAMES.point_distances, "distances to find the fixed point", "fixed point")
#: Poses, and distances, by which starts are compared (computing).
_MOST_POSES, _MOST_DISTANCES = 100, 300
#: Offset from its stated place, either way along each axis, at which the target of distances is
#: tried [m] (computing).
_TARGET_OFFSET_M = 0.2
#: Unknowns of the squared distances, see `squared_distance_equations` (computing).
_SQUARED_UNKNOWNS = 16


@dataclass(frozen=True)
class TargetProblem:
    """Measurements of B targets in P poses.

    They are positions, with or without orientations, or else distances of one target from the
    instrument (`d_m`). Of distances the unknowns are the target and the fixed point from which they
    were measured: the measured position is then zero, and the base is not turned.
    """

    p_base_m: Array  # (P, 3) modelled positions of the end-effector
    R_base: Array  # (P, 3, 3) modelled orientations
    p_instr_targets_m: Array  # (P, B, 3) measured positions, nan where a target was not seen
    R_instr_target: Array | None  # (P, 3, 3) measured orientations, where there are any
    weights: Array  # (P,) weights of the poses
    p_ee_stated_m: Array  # (B, 3) stated places of the targets
    d_m: Array | None = None  # (P,) distances [m], where these alone were measured

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
        """Return the problem of poses (P, 4, 4); see the attributes. No weights: all are equal.

        Raises:
            CalibrationError: with fewer than three poses, or fewer than four distances.
        """
        poses = int(np.count_nonzero(np.isfinite(p_instr_m[..., 0]).any(axis=1)))
        needed, what, frame = _NEEDED_POSES if d_m is None else _NEEDED_DISTANCES
        if poses < needed:
            raise CalibrationError(
                f"too few {what}",
                where=f"poses for the {frame}",
                value=poses,
                allowed=f"at least {needed}",
                remedy="measure more poses",
            )
        weights = np.ones(len(T_base_ee)) if weights is None else weights
        p_m, R = T_base_ee[:, :3, 3], T_base_ee[:, :3, :3]
        return cls(p_m, R, p_instr_m, R_instr_target, weights, p_ee_stated_m, d_m)

    @property
    def lever_m(self) -> float:
        """Return how far from the target an error of orientation counts as one of position."""
        return min(FRAMES.lever_m, FRAMES.most_reaches * _extent_m(self.p_base_m))

    @property
    def base_unknowns(self) -> int:
        """Return the number of unknowns of the base: distances do not depend on its rotation."""
        return 6 if self.d_m is None else 3

    @property
    def orientations(self) -> int:
        """Return how many orientations were measured."""
        return 0 if self.R_instr_target is None else len(self.R_instr_target)

    @cached_property
    def thinned(self) -> TargetProblem:
        """Return the problem of a random sample of the poses, always the same; itself if few."""
        most = _MOST_POSES if self.d_m is None else _MOST_DISTANCES
        if len(self.weights) <= most:
            return self
        return take_rows(self, drawn(len(self.weights), most), "p_ee_stated_m")

    @cached_property
    def seen(self) -> tuple[Index, Index]:
        """Return the pose and the target of every row, (K,) each."""
        pose, target = np.nonzero(np.isfinite(self.p_instr_targets_m[..., 0]))
        return pose, target

    @cached_property
    def p_instr_m(self) -> Array:
        """Return the measured position of every row, (K, 3)."""
        return np.asarray(self.p_instr_targets_m[self.seen])

    @cached_property
    def root_weight(self) -> Array:
        """Return the square root of the weight of every row, (K,)."""
        return np.sqrt(self.weights[self.seen[0]])

    @cached_property
    def weighted_offsets_m(self) -> Array:
        """Return the measured positions about their weighted mean, times `root_weight`, (K, 3)."""
        root = self.root_weight[:, None]
        mean_m = np.average(self.p_instr_m, axis=0, weights=root[:, 0] ** 2)
        return np.asarray(root * (self.p_instr_m - mean_m))

    @cached_property
    def _p_rows_m(self) -> Array:
        """Return the modelled position of the end-effector of every row, (K, 3)."""
        return self.p_base_m[self.seen[0]]

    def in_base(self, p_ee_m: Array) -> Array:
        """Return the modelled positions (K, 3) in the base frame of targets at p_ee_m (B, 3)."""
        carried = self.by_places.reshape(-1, p_ee_m.size) @ p_ee_m.ravel()
        return np.asarray(self._p_rows_m + carried.reshape(-1, 3))

    @cached_property
    def by_places(self) -> Array:
        """Return the derivative (K, 3, 3 B) of these positions by the targets' places."""
        pose, target = self.seen
        by_places = np.zeros((len(target), 3, self.p_ee_stated_m.size))
        rows, columns = np.arange(len(target))[:, None, None], 3 * target[:, None, None]
        by_places[rows, np.arange(3)[:, None], columns + np.arange(3)] = self.R_base[pose]
        return by_places


def turns_by_positions(problem: TargetProblem) -> list[Array]:
    """Return rotations R_instr_base to start from, by positions.

    One is from the relaxed problem, one from a rigid fit of the targets at their stated places,
    which says nothing where the positions are on a line: the turn about it is then any.
    """
    root, offsets = problem.root_weight[:, None], problem.weighted_offsets_m
    design, values = position_equations(problem)
    unknowns = _least_squares(design.reshape(values.size, -1), values.ravel())
    # The first nine are the columns of S; as rows of a matrix they make S', the base's rotation.
    by_equations = nearest_rotation(unknowns[:9].reshape(3, 3))
    if len(free_turns(problem)):
        return [by_equations]
    stated = problem.in_base(problem.p_ee_stated_m)
    stated = root * (stated - np.average(stated, axis=0, weights=root[:, 0] ** 2))
    return [by_equations, nearest_rotation(offsets.T @ stated)]


def free_turns(problem: TargetProblem) -> Array:
    """Return the axes (k, 3) in the instrument's frame about which positions leave turns free.

    None if they span a plane, that of a line, or all three if they are in one place.
    """
    _, size, axes = np.linalg.svd(problem.weighted_offsets_m, full_matrices=False)
    least = FRAMES.least_spread_m * np.linalg.norm(problem.root_weight)
    if size[1] > max(NOT_REPRODUCED * size[0], least):
        return np.zeros((0, 3))
    return np.asarray(axes if size[0] <= least else axes[:1])


def position_equations(problem: TargetProblem) -> tuple[Array, Array]:
    """Return the weighted design matrix (K, 3, 12 + 3 B) of positions, and the values (K, 3).

    Unknowns are the nine of S by columns, the three of s, and the places p_ee of the targets:
    p_base = S (p_instr - mean) + s - R_base p_ee.
    """
    root = problem.root_weight[:, None]
    design = np.zeros((len(root), 3, 9 + 3 + problem.p_ee_stated_m.size))
    for axis in range(3):
        design[:, axis, axis:9:3] = problem.weighted_offsets_m
        design[:, axis, 9 + axis] = root[:, 0]
    design[:, :, 12:] = -root[..., None] * problem.by_places
    return design, root * problem.p_base_m[problem.seen[0]]


def points_by_distances(problem: TargetProblem) -> list[tuple[Array, Array]]:
    """Return fixed points and targets, (3,) each, to start from.

    For a target at a given place the squared distances are linear in the fixed point. Poses near a
    plane hardly tell it from its mirror image in that plane, so both are starts. With poses enough
    target and point also follow together from `squared_distance_equations`.
    """
    d_m = np.asarray(problem.d_m)
    p_base_m, R_base, root = problem.p_base_m, problem.R_base, problem.root_weight
    starts = []
    directions = np.vstack([np.zeros(3), np.eye(3), -np.eye(3)])
    for p_ee_m in problem.p_ee_stated_m + _TARGET_OFFSET_M * directions:
        target_m = p_base_m + R_base @ p_ee_m
        mean_m = target_m.mean(axis=0)
        offsets_m = target_m - mean_m
        # |offset|^2 - d^2 = 2 offset.c + a constant, with the fixed point at mean + c.
        design = np.hstack([2.0 * offsets_m, np.ones((len(offsets_m), 1))])
        values = (offsets_m**2).sum(axis=1) - d_m**2
        c = _least_squares(root[:, None] * design, root * values)[:3]
        normal = np.linalg.svd(offsets_m, full_matrices=False)[2][2]  # of the plane nearest to them
        starts.append((mean_m + c, p_ee_m))
        starts.append((mean_m + c - 2.0 * (c @ normal) * normal, p_ee_m))
    if len(d_m) >= _SQUARED_UNKNOWNS:
        design, values = squared_distance_equations(p_base_m, R_base, d_m)
        unknowns = _least_squares(root[:, None] * design, root * values)
        starts.append((unknowns[3:6], unknowns[:3]))
    return starts


def squared_distance_equations(p_base_m: Array, R_base: Array, d_m: Array) -> tuple[Array, Array]:
    """Return the design matrix (P, 16) of squared distances, and the values (P,) [m^2].

    With u the target on the end-effector and c the fixed point in the base frame
    d^2 - |p_base|^2 = 2 p_base.(R_base u) - 2 p_base.c - 2 c.(R_base u) + |u|^2 + |c|^2
    is linear in u, c, the nine products of their components and the sum of squares.
    """
    p_ee_base_m = np.einsum("pji,pj->pi", R_base, p_base_m)  # along the end-effector's axes
    ones = np.ones((len(p_base_m), 1))
    design = np.hstack([2.0 * p_ee_base_m, -2.0 * p_base_m, -2.0 * R_base.reshape(-1, 9), ones])
    return design, d_m**2 - (p_base_m**2).sum(axis=1)


def _least_squares(design: Array, values: Array) -> Array:
    return np.asarray(np.linalg.lstsq(design, values, rcond=_NO_COLUMN)[0], dtype=np.float64)


def turn_by_orientations(problem: TargetProblem, R_instr_target: Array) -> Array:
    """Return R_instr_base by orientations R_instr_target (P, 3, 3) alone.

    With X = R_ee_target every pose has R_instr_target X' = R_instr_base R_base. So the weighted sum
    of the Kronecker products R_base (x) R_instr_target maps vec(X') to vec(R_instr_base) times the
    sum of weights, and no vector further: vec(R_instr_base) belongs to its largest singular value.
    """
    weighted = problem.weights[:, None, None] * problem.R_base
    summed = np.einsum("pij,pkl->ikjl", weighted, R_instr_target).reshape(9, 9)
    dominant = np.asarray(np.linalg.svd(summed)[0][:, 0], dtype=float)
    matrix = dominant.reshape(3, 3).T  # vec goes by columns
    # A singular vector has either sign; a rotation has a positive determinant.
    return nearest_rotation(matrix if np.linalg.det(matrix) > 0.0 else -matrix)


def mean_turn(weights: Array, turns: Array) -> Array:
    """Return the chordal mean of rotations (P, 3, 3)."""
    return nearest_rotation(np.tensordot(weights, turns, axes=1))


# Lower bounds of the misfit of any base frame and targets, by linear least squares.
#
# Where the rotations of base and target may be any 3x3 matrices, the problem is linear. Rotations
# are among these matrices, so the root mean square that the linear problem leaves bounds the misfit
# of every base and target from below. Many candidates, such as orders and signs of joints, are so
# rejected before one of them is fitted (`numerics.least_squares`).

#: Part of the trace of the normal equations that is added to their diagonal, to keep them regular
#: (computing).
_RIDGE = 1e-12


def target_misfit_bound_m(
    T_base_ee: Array, p_instr_m: Array, R_instr_target: Array | None = None
) -> float:
    """Return a lower bound of the misfit [m] of targets (P, B, 3), and orientations (P, 3, 3).

    Orientations obey S R_instr_target = R_base X, with X any matrix in the place of the target's
    rotation. The angle between two rotations is at least the Frobenius norm of their difference
    over the square root of 2; as a length it counts with the lever of `Located.misfit_m`.
    """
    p_base_m, R_base = T_base_ee[:, :3, 3], T_base_ee[:, :3, :3]
    places_m, weights = np.zeros((p_instr_m.shape[1], 3)), np.ones(len(p_base_m))
    problem = TargetProblem(p_base_m, R_base, p_instr_m, None, weights, places_m)
    design, values = position_equations(problem)
    rows, _, unknowns = design.shape
    design, values = design.reshape(values.size, unknowns), values.ravel()
    if R_instr_target is not None:
        turns = np.zeros((len(p_base_m), 3, 3, unknowns + 9))  # the unknowns of X come last
        for axis, column in np.ndindex(3, 3):
            turns[:, axis, column, axis:9:3] = R_instr_target[:, :, column]
            turns[:, axis, column, unknowns + column :: 3] = -R_base[:, axis]
        turns *= problem.lever_m / np.sqrt(2.0)
        design = np.vstack([np.pad(design, ((0, 0), (0, 9))), turns.reshape(-1, unknowns + 9)])
        values = np.concatenate([values, np.zeros(9 * len(p_base_m))])
    return float(np.sqrt(_residual_squares(design, values) / rows))


def distance_misfit_bound_m(T_base_ee: Array, d_m: Array) -> float:
    """Return a lower bound of the rms misfit [m] of distances (P,), by their squares.

    Let the distances err by e, with root mean square rms. Their squares err by |e| (2 d + |e|) at
    most, and |e| <= sqrt(P) rms; so the squares have an rms of at most rms (2 d_max + sqrt(P) rms).
    The linear problem bounds that rms from below; solved for rms it gives the bound.
    """
    design, values = squared_distance_equations(T_base_ee[:, :3, 3], T_base_ee[:, :3, :3], d_m)
    rms_m2, root_P = np.sqrt(_residual_squares(design, values) / len(d_m)), np.sqrt(len(d_m))
    d_max_m = float(d_m.max())
    return float((np.sqrt(d_max_m**2 + root_P * rms_m2) - d_max_m) / root_P)


def _residual_squares(design: Array, values: Array) -> float:
    """Return the sum of squared residuals of a linear problem.

    Normal equations, with a ridge, are faster here than `lstsq`; any solution of them is as good.
    """
    normal = design.T @ design
    normal.flat[:: len(normal) + 1] += _RIDGE * np.trace(normal)
    solution = np.linalg.solve(normal, design.T @ values)
    return float(np.sum((values - design @ solution) ** 2))


# The unit of what was measured: how far the nominal model moves for one measured unit.
#
# The place of the target on the end-effector and that of the instrument are not known. They enter
# linearly, by columns of the nominal model's position and orientation; what these columns do not
# explain of the model's motion is proportional to what they do not explain of the measured one.


def scale_of_points(p_m: Array, T_base_ee: Array) -> float | None:
    """Return the motion of the nominal model [m] for a unit of measured positions (N, 3).

    It is 1 where positions are in metres, as the model's poses (N, 4, 4) are. None where the rows
    do not determine the scale, such as positions along one line.
    """
    if len(p_m) < FRAMES.scale_rows:
        return None
    extent_m = np.linalg.svd(p_m - p_m.mean(axis=0), compute_uv=False)
    if extent_m[1] < FRAMES.least_breadth * extent_m[0]:
        return None
    # x = S p + s - R u, linear in the general matrix S, in s and in the target's place u.
    of_S = np.kron((p_m - p_m.mean(axis=0))[:, None, :], np.eye(3)).reshape(-1, 9)
    others = np.concatenate([np.tile(np.eye(3), (len(p_m), 1, 1)), T_base_ee[:, :3, :3]], axis=2)
    partial = _partial_regression(T_base_ee[:, :3, 3].ravel(), of_S, others.reshape(-1, 6))
    if partial is None or partial.rms < FRAMES.least_motion_share * _extent_m(T_base_ee[:, :3, 3]):
        return None
    # The second singular value: of positions in one plane the third one is zero.
    return float(np.linalg.svd(partial.coefficients.reshape(3, 3), compute_uv=False)[1])


def scale_of_distances(d_m: Array, T_base_ee: Array) -> float | None:
    """Return the motion of the nominal model [m] for a unit of measured distances (N,).

    See `scale_of_points`; the distances are those of one target from a fixed point.
    """
    if len(d_m) < FRAMES.scale_rows:
        return None
    # |x|^2 = k^2 d^2 + 2 x.c - |c|^2 for a target at the origin, and with its products elsewhere.
    x, R = T_base_ee[:, :3, 3], T_base_ee[:, :3, :3]
    others = [x, np.ones((len(x), 1))]
    if len(d_m) >= FRAMES.rows_for_target:
        others += [np.einsum("pji,pj->pi", R, x), R.reshape(-1, 9)]
    partial = _partial_regression((x**2).sum(axis=1), d_m[:, None] ** 2, np.hstack(others))
    if partial is None or partial.rms < (FRAMES.least_motion_share * _extent_m(x)) ** 2:
        return None
    square = partial.coefficients[0]
    return None if square <= 0.0 else float(np.sqrt(square))


def _extent_m(p_base_m: Array) -> float:
    """Return how far an arm reaches at places (N, 3), root mean square."""
    return float(np.sqrt(np.mean(np.sum(p_base_m**2, axis=1))))


class _Partial(NamedTuple):
    """A regression of values on some columns, both without what other columns explain."""

    coefficients: Array
    rms: float  # of the values without what the other columns explain


def _partial_regression(values: Array, columns: Array, others: Array) -> _Partial | None:
    """Return a partial regression; None where the columns do not explain nearly all of the rest."""
    together = np.column_stack([values, columns])
    together = together - others @ np.linalg.lstsq(others, together, rcond=_NO_COLUMN)[0]
    rest, rest_columns = together[:, 0], together[:, 1:]
    solved = np.linalg.lstsq(rest_columns, rest, rcond=_NO_COLUMN)[0]
    coefficients = np.asarray(solved, dtype=float)
    residual = rest - rest_columns @ coefficients
    if residual @ residual > (1.0 - FRAMES.explained_share) * (rest @ rest):
        return None
    return _Partial(coefficients, float(np.sqrt(np.mean(rest**2))))
