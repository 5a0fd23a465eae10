"""A fixed point and a target on the end-effector from the distances between them.

With the nominal model's T_base_ee of every pose, d = |T_base_ee p_ee - p_base|: three unknowns for
the target, three for the point. The base frame itself does not show.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from pa10cal.arrays import Array, taken
from pa10cal.errors import CalibrationError
from pa10cal.numerics.least_squares import (
    OPEN,
    Linearised,
    Split,
    axis_text,
    descend,
    split_identified,
)

LEAST_POSES = 4
#: Unknowns of the equation that is linear in products of target and point.
PRODUCTS = 16
#: Starts put the target this far from its stated place, either way along each axis.
ASIDE_M = 0.2
#: Poses that choose between starts.
MOST_POSES = 300
#: The null space depends a little on the solution, so it is found again there.
PASSES = 2


@dataclass(frozen=True)
class Ranging:
    """The fixed point and the target."""

    p_base_point_m: Array  # (3,) fixed point in the base frame
    p_ee_target_m: Array  # (3,) target in the end-effector frame
    rms_m: float  # root mean square of measured less modelled distances
    held: tuple[str, ...]  # directions of the target that the poses do not identify, held as stated

    def distances(self, T_base_ee: Array) -> Array:
        """Return the distances (P,) of the target from the fixed point [m]."""
        place = T_base_ee[:, :3, :3] @ self.p_ee_target_m + T_base_ee[:, :3, 3]
        return np.asarray(np.sqrt(((place - self.p_base_point_m) ** 2).sum(axis=1)))


def range_from_distances(
    T_base_ee: Array,
    d_m: Array,
    p_ee_stated_m: Array | None = None,
    weights: Array | None = None,
) -> Ranging:
    """Solve d = |T_base_ee p_ee - p_base| for the target p_ee and the fixed point p_base.

    Squared, the equation is linear in target, point, their products and squares, which gives a
    start from anywhere where there are poses enough. For targets at and about the stated place a
    linearised sphere gives the point, and its mirror image in the plane that the poses are nearest
    to. All starts are refined by Gauss-Newton steps, and the best is returned.

    Args:
        T_base_ee: (P, 4, 4) modelled end-effector [m].
        d_m: (P,) measured distances [m].
        p_ee_stated_m: (3,) value where the poses do not identify the target; None for the
            origin of the end-effector.
        weights: (P,) weights of the squared residuals; None for equal ones.

    Raises:
        CalibrationError: with fewer than four poses, or when these leave the fixed point open.
    """
    if len(d_m) < LEAST_POSES:
        raise CalibrationError(
            "too few distances to find the fixed point",
            where="poses for the fixed point",
            value=len(d_m),
            allowed=f"at least {LEAST_POSES}",
            remedy="measure more poses",
        )
    stated_m = np.zeros(3) if p_ee_stated_m is None else p_ee_stated_m
    root = np.sqrt(np.ones(len(d_m)) if weights is None else weights)
    problem = _Problem(T_base_ee[:, :3, 3], T_base_ee[:, :3, :3], d_m, root, stated_m)
    few = problem.thinned()
    start, *_ = min((_refined(few, each) for each in _starts(few)), key=lambda found: found[1].cost)
    at, _, split = _refined(problem, start)
    _refuse_open(problem, at)
    residuals_m = d_m - np.linalg.norm(problem.from_point(*at), axis=1)
    return Ranging(
        p_base_point_m=at[0],
        p_ee_target_m=at[1],
        rms_m=float(np.sqrt(np.average(residuals_m**2, weights=root**2))),
        held=tuple(
            f"the target along {axis_text(direction)}" for direction in split.unidentified.T
        ),
    )


@dataclass(frozen=True)
class _Problem:
    """Distances (P,) seen, with the square roots of their weights, and the modelled poses."""

    p_base_ee_m: Array
    R_base: Array
    d_m: Array
    root: Array
    p_ee_stated_m: Array

    def thinned(self) -> _Problem:
        """Return the problem of few poses, drawn at random, always the same."""
        drawn = np.random.default_rng(0).permutation(len(self.d_m))[:MOST_POSES]
        return taken(self, np.sort(drawn), "p_ee_stated_m")

    def from_point(self, p_base_m: Array, p_ee_m: Array) -> Array:
        """Return the way (P, 3) from the fixed point to the target, along base axes."""
        return np.asarray(self.p_base_ee_m + self.R_base @ p_ee_m - p_base_m)


#: A fixed point (3,) in the base frame, and a target (3,) in that of the end-effector.
_Places = tuple[Array, Array]


def _starts(problem: _Problem) -> list[_Places]:
    """Return fixed points and targets to start from."""
    aside = ASIDE_M * np.vstack([np.zeros(3), np.eye(3), -np.eye(3)])
    starts = []
    for p_ee_m in problem.p_ee_stated_m + aside:
        place = problem.p_base_ee_m + problem.R_base @ p_ee_m
        mean = place.mean(axis=0)
        off = place - mean
        # |off|^2 - d^2 = 2 off c + (a constant), c from the mean.
        sphere = np.hstack([2.0 * off, np.ones((len(off), 1))])
        square = (off**2).sum(axis=1) - problem.d_m**2
        c = _solved(problem.root[:, None] * sphere, problem.root * square)[:3]
        across = np.linalg.svd(off)[2][2]
        starts += [(mean + c, p_ee_m), (mean + c - 2.0 * (c @ across) * across, p_ee_m)]
    if len(problem.d_m) >= PRODUCTS:
        starts.append(_by_products(problem))
    return starts


def _by_products(problem: _Problem) -> _Places:
    """Solve d^2 - |x|^2 = 2 x.R u - 2 x.c - 2 c.R u + (|u|^2 + |c|^2) for target u and point c."""
    x, R = problem.p_base_ee_m, problem.R_base
    turned = np.einsum("pji,pj->pi", R, x)
    ones = np.ones((len(x), 1))
    columns = np.hstack([2.0 * turned, -2.0 * x, -2.0 * R.reshape(-1, 9), ones])
    square = problem.d_m**2 - (x**2).sum(axis=1)
    solved = _solved(problem.root[:, None] * columns, problem.root * square)
    return solved[3:6], solved[:3]


def _refined(problem: _Problem, at: _Places) -> tuple[_Places, Linearised, Split]:
    """Refine a start; what of the target the fixed point can mimic is held as stated."""
    for _ in range(PASSES):
        whole = _linearise(problem, at, free=np.eye(3)).by_step
        split = split_identified(whole[:, 3:], whole[:, :3])
        onto = split.identified @ np.linalg.pinv(split.identified)
        at = (at[0], problem.p_ee_stated_m + onto @ (at[1] - problem.p_ee_stated_m))
        free = split.identified
        at, here = descend(at, partial(_linearise, problem, free=free), partial(_moved, free=free))
    return at, here, split


def _moved(at: _Places, step: Array, *, free: Array) -> _Places:
    return at[0] + step[:3], at[1] + free @ step[3:]


def _linearise(problem: _Problem, at: _Places, *, free: Array) -> Linearised:
    way = problem.from_point(*at)
    length = np.maximum(np.linalg.norm(way, axis=1), np.finfo(float).tiny)
    unit = way / length[:, None]
    by_target = np.einsum("pi,pij->pj", unit, problem.R_base) @ free
    by_step = problem.root[:, None] * np.hstack([-unit, by_target])
    return Linearised(by_step, problem.root * (problem.d_m - length))


def _refuse_open(problem: _Problem, at: _Places) -> None:
    """Refuse poses from which the fixed point is seen in directions of a plane or a line."""
    by_point = _linearise(problem, at, free=np.eye(3)).by_step[:, :3]
    _, size, directions = np.linalg.svd(by_point, full_matrices=False)
    if size[2] > OPEN * size[0]:
        return
    raise CalibrationError(
        "the distances do not identify the fixed point",
        where="poses for the fixed point",
        value=f"along {axis_text(directions[2])} of the base",
        allowed="poses that surround the fixed point's direction on all sides",
        remedy="measure poses further apart along that direction",
    )


def _solved(columns: Array, values: Array) -> Array:
    return np.asarray(np.linalg.lstsq(columns, values, rcond=1e-9)[0], dtype=np.float64)
