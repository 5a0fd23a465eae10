"""Targets on an arm as linear problems: where a fit starts, and what is left at least.

Carried into the base frame, base and target are linear unknowns where their rotations may be any
matrices: the nearest rotations start a fit (`hand_eye`), and no base and no target leaves less than
any matrices do, so many candidates are told apart before one of them is fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pa10cal.arrays import Array, Index, drawn, nearest_rotation, taken
from pa10cal.errors import CalibrationError
from pa10cal.frame.rigid_fit import NO_COLUMN
from pa10cal.numerics import least_squares
from pa10cal.rules import FRAMES

#: Poses that are needed to fit a base frame, and distances to find a fixed point.
_NEEDED_POSES = (FRAMES.base_poses, "poses to fit a base frame to", "base frame")
_NEEDED_DISTANCES = (FRAMES.point_distances, "distances to find the fixed point", "fixed point")
#: Poses, and distances, that choose between starts (computing).
_MOST_POSES, _MOST_DISTANCES = 100, 300


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
        return taken(self, drawn(len(self.weights), most), "p_ee_stated_m")

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


# Where a fit starts, in closed form.


def turns_by_positions(problem: TargetProblem) -> list[Array]:
    """Return rotations of the base to start from, by positions; none if they span no plane."""
    columns, x_base_m = _by_positions(problem)
    root, off = columns[:, 0, 9:10], columns[:, 0, :9:3]
    spread = np.linalg.svd(off, compute_uv=False)
    if spread[1] <= max(
        least_squares.OPEN * spread[0], FRAMES.least_spread_m * np.linalg.norm(root)
    ):
        return []
    stated = problem.in_base(problem.p_ee_stated_m)
    stated = root * (stated - np.average(stated, axis=0, weights=root[:, 0] ** 2))
    solved = _solved(columns.reshape(x_base_m.size, -1), x_base_m.ravel())
    # The nine go by columns of S, the inverse of the base's rotation.
    by_equations = solved[:9].reshape(3, 3)
    return [nearest_rotation(by_equations), nearest_rotation(off.T @ stated)]


def _by_positions(problem: TargetProblem) -> tuple[Array, Array]:
    """Return equations of positions, weighed: their columns (K, 3, 12 + 3 B), and values (K, 3).

    x = S (p - mean) + s - R_base p_ee is linear in S (nine, by columns), s and the places.
    """
    root = problem.root_weight[:, None]
    off = root * (
        problem.p_instr_m - np.average(problem.p_instr_m, axis=0, weights=root[:, 0] ** 2)
    )
    columns = np.zeros((len(off), 3, 9 + 3 + problem.p_ee_stated_m.size))
    for row in range(3):
        columns[:, row, row:9:3] = off
        columns[:, row, 9 + row] = root[:, 0]
    columns[:, :, 12:] = -root[..., None] * problem.by_places
    return columns, root * problem.p_base_m[problem.seen[0]]


#: Starts put the target of distances this far from its stated place, either way along each axis
#: (computing).
_ASIDE_M = 0.2
#: Unknowns of the equation that is linear in products of target and point (computing).
_PRODUCTS = 16


def points_by_distances(problem: TargetProblem) -> list[tuple[Array, Array]]:
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
        columns, square = _by_products(x, R, d_m)
        solved = _solved(root[:, None] * columns, root * square)
        starts.append((solved[3:6], solved[:3]))
    return starts


def _by_products(x: Array, R: Array, d_m: Array) -> tuple[Array, Array]:
    """Return the equations (P, 16) of u, c, the products of their parts, and their squares.

    d^2 - |x|^2 = 2 x.R u - 2 x.c - 2 c.R u + (|u|^2 + |c|^2) for target u and point c.
    """
    turned, ones = np.einsum("pji,pj->pi", R, x), np.ones((len(x), 1))
    columns = np.hstack([2.0 * turned, -2.0 * x, -2.0 * R.reshape(-1, 9), ones])
    return columns, d_m**2 - (x**2).sum(axis=1)


def _solved(columns: Array, values: Array) -> Array:
    return np.asarray(np.linalg.lstsq(columns, values, rcond=NO_COLUMN)[0], dtype=np.float64)


def turn_by_orientations(problem: TargetProblem, R_instr_target: Array) -> Array:
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


def mean_turn(weights: Array, turns: Array) -> Array:
    """Return the chordal mean of rotations (P, 3, 3)."""
    return nearest_rotation(np.tensordot(weights, turns, axes=1))


# What is left at least.

#: Part by which what is left at least may be off by rounding; and part of the trace of its normal
#: equations that keeps them regular (computing).
SURELY, _REGULAR = 1.001, 1e-12


def first_of_least(
    least: Sequence[float], fitted: Callable[[int], float], most: float
) -> tuple[float, int] | None:
    """Return the least misfit of candidates, at most so much, and the first that has it.

    Of each it is known what is left at `least`; those are `fitted` that may have less than the best
    so far. None where none has so little.
    """
    best: tuple[float, int] | None = None
    for k in np.argsort(least, kind="stable").tolist():
        if least[k] > SURELY * (most if best is None else best[0]):
            break
        misfit = fitted(k)
        if misfit <= most and (best is None or (misfit, k) < best):
            best = misfit, k
    return best


def least_misfit_of_targets(
    T_base_ee: Array, p_instr_m: Array, R_instr_target: Array | None = None
) -> float:
    """Return what is left at least [m] of targets (P, B, 3), and of orientations (P, 3, 3).

    Carried into the base frame all is linear in the rotations of base and target, which may here be
    any matrices; a turn is at least the difference of the matrices over the root of two.
    """
    p_m, R = T_base_ee[:, :3, 3], T_base_ee[:, :3, :3]
    nowhere, alike = np.zeros((p_instr_m.shape[1], 3)), np.ones(len(p_m))
    columns, values = _by_positions(TargetProblem(p_m, R, p_instr_m, None, alike, nowhere))
    rows, unknowns = len(columns), columns.shape[2]
    columns, values = columns.reshape(values.size, unknowns), values.ravel()
    if R_instr_target is not None:
        turns = np.zeros((len(p_m), 3, 3, unknowns + 9))  # S R_instr_target = R_base X
        for axis, across in np.ndindex(3, 3):
            turns[:, axis, across, axis:9:3] = R_instr_target[:, :, across]
            turns[:, axis, across, unknowns + across :: 3] = -R[:, axis]
        turns *= FRAMES.lever_m / np.sqrt(2.0)
        columns = np.vstack([np.pad(columns, ((0, 0), (0, 9))), turns.reshape(-1, unknowns + 9)])
        values = np.concatenate([values, np.zeros(9 * len(p_m))])
    return float(np.sqrt(_left(columns, values) / rows))


def least_misfit_of_distances(T_base_ee: Array, d_m: Array) -> float:
    """Return what is left at least [m] of distances (P,), by the squares of `_by_products`."""
    columns, square = _by_products(T_base_ee[:, :3, 3], T_base_ee[:, :3, :3], d_m)
    off_m2, root = np.sqrt(_left(columns, square) / len(d_m)), np.sqrt(len(d_m))
    # |d^2 - m^2| is at most e (2 d + e) of an error e, none of which exceeds the root of all.
    far_m = float(d_m.max())
    return float((np.sqrt(far_m**2 + root * off_m2) - far_m) / root)


def _left(columns: Array, values: Array) -> float:
    """Return the sum of squares that a linear problem leaves."""
    normal = columns.T @ columns
    normal.flat[:: len(normal) + 1] += _REGULAR * np.trace(normal)
    solved = np.linalg.solve(normal, columns.T @ values)
    return float(np.sum((values - columns @ solved) ** 2))
