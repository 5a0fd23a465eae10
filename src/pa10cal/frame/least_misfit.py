"""What no base and no targets get below: by linear problems that hold the true ones.

Many candidates are told apart so before one of them is fitted (`hand_eye`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from pa10cal.arrays import Array
from pa10cal.frame.hand_eye import distance_products
from pa10cal.frame.rigid_fit import LEVER_M

#: Part by which what is left at least may be off by rounding.
SURELY = 1.001


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
    pose, target = np.nonzero(np.isfinite(p_instr_m[..., 0]))
    count, rows = p_instr_m.shape[1], np.arange(len(pose))
    columns = np.zeros((len(pose), 3, 12 + 3 * count))
    seen_m, R = p_instr_m[pose, target], T_base_ee[pose, :3, :3]
    for axis in range(3):
        columns[:, axis, axis:9:3] = seen_m - seen_m.mean(axis=0)
        columns[:, axis, 9 + axis] = 1.0
    for axis in range(3):
        columns[rows, :, 12 + 3 * target + axis] = -R[:, :, axis]
    values = T_base_ee[pose, :3, 3].ravel()
    columns = columns.reshape(len(values), -1)
    if R_instr_target is not None:
        turns = np.zeros((len(T_base_ee), 3, 3, 21 + 3 * count))  # S R_instr_target = R_base X
        for axis, across in np.ndindex(3, 3):
            turns[:, axis, across, axis:9:3] = R_instr_target[:, :, across]
            turns[:, axis, across, 12 + 3 * count + across :: 3] = -T_base_ee[:, axis, :3]
        turns *= LEVER_M / np.sqrt(2.0)
        columns = np.vstack([np.pad(columns, ((0, 0), (0, 9))), turns.reshape(-1, turns.shape[3])])
        values = np.concatenate([values, np.zeros(9 * len(T_base_ee))])
    return float(np.sqrt(_left(columns, values) / len(rows)))


def least_misfit_of_distances(T_base_ee: Array, d_m: Array) -> float:
    """Return what is left at least [m] of distances (P,), by the squares of `distance_products`."""
    columns, square = distance_products(T_base_ee[:, :3, 3], T_base_ee[:, :3, :3], d_m)
    off_m2, root = np.sqrt(_left(columns, square) / len(d_m)), np.sqrt(len(d_m))
    # |d^2 - m^2| is at most e (2 d + e) of an error e, none of which exceeds the root of all.
    far_m = float(d_m.max())
    return float((np.sqrt(far_m**2 + root * off_m2) - far_m) / root)


def _left(columns: Array, values: Array) -> float:
    """Return the sum of squares that a linear problem leaves."""
    normal = columns.T @ columns
    normal.flat[:: len(normal) + 1] += 1e-12 * np.trace(normal)
    solved = np.linalg.solve(normal, columns.T @ values)
    return float(np.sum((values - columns @ solved) ** 2))
