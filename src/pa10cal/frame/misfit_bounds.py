"""Lower bounds of the misfit of any base frame and targets, by linear least squares.

Where the rotations of base and target may be any 3x3 matrices, the problem of `target_problem` is
linear. Rotations are among these matrices, so the root mean square that the linear problem leaves
bounds the misfit of every base and target from below. Many candidates, such as orders and signs of
joints, are so rejected before one of them is fitted (`numerics.branch_and_bound`).
"""

from __future__ import annotations

import numpy as np

from pa10cal.arrays import Array
from pa10cal.frame.target_problem import (
    TargetProblem,
    position_equations,
    squared_distance_equations,
)
from pa10cal.rules import FRAMES

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
        turns *= FRAMES.lever_m / np.sqrt(2.0)
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
