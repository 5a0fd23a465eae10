"""How far the nominal model moves for one measured length: the unit of what was measured.

Where the target is on the end-effector and where the instrument is are not known, and need not
be: both enter the measurement in ways that are linear in the nominal model's position and attitude,
and the remaining motion of the model is as large as the measured one, whatever they are.
"""

from __future__ import annotations

import numpy as np

from pa10cal.arrays import Array

#: Rows below which nothing is judged, and from which an unknown target can be allowed for too in
#: the equation of distances.
LEAST_ROWS = 8
ROWS_FOR_TARGET = 34
#: Part of the model's motion that the measurement must explain to be judged, and the motion's
#: least size [m].
EXPLAINED = 0.5
LEAST_MOTION_M = 0.02
#: Positions whose extent across their line is a smaller part of that along it determine no scale.
LEAST_BREADTH = 0.05


def scale_of_points(p_m: Array, T_base_ee: Array) -> float | None:
    """Return how far the nominal model moves for one unit that the target was measured to.

    Args:
        p_m: (N, 3) positions of one target, in what should be metres.
        T_base_ee: (N, 4, 4) the nominal model's end-effector for the same joint positions [m].

    Returns:
        The scale, or None where the rows do not determine it, such as positions along one line.
    """
    if len(p_m) < LEAST_ROWS:
        return None
    extent_m = np.linalg.svd(p_m - p_m.mean(axis=0), compute_uv=False)
    if extent_m[1] < LEAST_BREADTH * extent_m[0]:
        return None
    # x = S p + s - R u, linear in the general matrix S, in s and in the target's place u.
    of_S = np.kron((p_m - p_m.mean(axis=0))[:, None, :], np.eye(3)).reshape(-1, 9)
    others = np.concatenate([np.tile(np.eye(3), (len(p_m), 1, 1)), T_base_ee[:, :3, :3]], axis=2)
    found = _explained(T_base_ee[:, :3, 3].ravel(), of_S, others.reshape(-1, 6))
    if found is None or found[1] < LEAST_MOTION_M:
        return None
    # Of positions in one plane a third singular value is nought.
    return float(np.linalg.svd(found[0].reshape(3, 3), compute_uv=False)[1])


def scale_of_distances(d_m: Array, T_base_ee: Array) -> float | None:
    """Return how far the nominal model moves for one unit that the distance changed.

    Args:
        d_m: (N,) distances of one target from a fixed point, in what should be metres.
        T_base_ee: (N, 4, 4) the nominal model's end-effector for the same joint positions [m].

    Returns:
        The scale, or None where the rows do not determine it.
    """
    if len(d_m) < LEAST_ROWS:
        return None
    # |x|^2 = k^2 d^2 + 2 x.c - |c|^2 for a target at the origin, and with its products elsewhere.
    x, R = T_base_ee[:, :3, 3], T_base_ee[:, :3, :3]
    others = [x, np.ones((len(x), 1))]
    if len(d_m) >= ROWS_FOR_TARGET:
        others += [np.einsum("pji,pj->pi", R, x), R.reshape(-1, 9)]
    found = _explained((x**2).sum(axis=1), d_m[:, None] ** 2, np.hstack(others))
    if found is None or found[1] < LEAST_MOTION_M**2 or found[0][0] <= 0.0:
        return None
    return float(np.sqrt(found[0][0]))


def _explained(values: Array, by_these: Array, by_others: Array) -> tuple[Array, float] | None:
    """Return what explains that part of values which others leave, and that part's rms; or None."""
    together = np.column_stack([values, by_these])
    together = together - by_others @ np.linalg.lstsq(by_others, together, rcond=1e-9)[0]
    rest, columns = together[:, 0], together[:, 1:]
    solved = np.asarray(np.linalg.lstsq(columns, rest, rcond=1e-9)[0], dtype=float)
    remaining = rest - columns @ solved
    if remaining @ remaining > (1.0 - EXPLAINED) * (rest @ rest):
        return None
    return solved, float(np.sqrt(np.mean(rest**2)))
