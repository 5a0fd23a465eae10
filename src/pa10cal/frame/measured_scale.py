"""The unit of what was measured: how far the nominal model moves for one measured unit.

The place of the target on the end-effector and that of the instrument are not known. They enter
linearly, by columns of the nominal model's position and orientation; what these columns do not
explain of the model's motion is proportional to what they do not explain of the measured one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pa10cal.arrays import Array
from pa10cal.frame.target_problem import NO_COLUMN
from pa10cal.rules import FRAMES


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
    if partial is None or partial.rms < FRAMES.least_motion_m:
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
    if partial is None or partial.rms < FRAMES.least_motion_m**2:
        return None
    square = partial.coefficients[0]
    return None if square <= 0.0 else float(np.sqrt(square))


class _Partial(NamedTuple):
    """A regression of values on some columns, both without what other columns explain."""

    coefficients: Array
    rms: float  # of the values without what the other columns explain


def _partial_regression(values: Array, columns: Array, others: Array) -> _Partial | None:
    """Return a partial regression; None where the columns do not explain nearly all of the rest."""
    together = np.column_stack([values, columns])
    together = together - others @ np.linalg.lstsq(others, together, rcond=NO_COLUMN)[0]
    rest, rest_columns = together[:, 0], together[:, 1:]
    solved = np.linalg.lstsq(rest_columns, rest, rcond=NO_COLUMN)[0]
    coefficients = np.asarray(solved, dtype=float)
    residual = rest - rest_columns @ coefficients
    if residual @ residual > (1.0 - FRAMES.explained_share) * (rest @ rest):
        return None
    return _Partial(coefficients, float(np.sqrt(np.mean(rest**2))))
