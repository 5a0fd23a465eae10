"""The unit of measured lengths, by how the nominal model moves.

Where the target is on the end-effector and where the instrument stands are not known, and need not
be: both show in the measurement in ways that are linear in the nominal model's position and
attitude, and what is left of the model's motion is as large as the measured one, whatever they are.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pa10cal.errors import RawDataError

Array = NDArray[np.float64]

#: Rows below which nothing is judged, and from which an unknown target can be allowed for too in
#: the equation of distances.
LEAST_ROWS = 8
ROWS_FOR_TARGET = 34
#: Part of the model's motion that the measurement must explain to be judged, and the motion's
#: least size.
EXPLAINED = 0.5
LEAST_MOTION_MM = 20.0
#: Scales that differ from one by more than this are of another unit.
SCALE_RATIO = 5.0
#: Positions whose extent across their line is a smaller part of that along it tell no scale.
LEAST_BREADTH = 0.05
UNITS = {1e-3: "micrometres", 10.0: "centimetres", 25.4: "inches", 1e3: "metres"}


def scale_of_points(p_mm: Array, T_base_ee: Array) -> float | None:
    """Return how many millimetres the nominal model moves for one that the target was seen to.

    Args:
        p_mm: (N, 3) positions of one target, in what should be millimetres.
        T_base_ee: (N, 4, 4) the nominal model's end-effector for the same joint positions [m].

    Returns:
        The scale, or None where the rows do not tell, such as positions along one line.
    """
    if len(p_mm) < LEAST_ROWS:
        return None
    extent_mm = np.linalg.svd(p_mm - p_mm.mean(axis=0), compute_uv=False)
    if extent_mm[1] < LEAST_BREADTH * extent_mm[0]:
        return None
    # x = S p + s - R u, linear in the general matrix S, in s and in the target's place u.
    of_S = np.kron((p_mm - p_mm.mean(axis=0))[:, None, :], np.eye(3)).reshape(-1, 9)
    others = np.concatenate([np.tile(np.eye(3), (len(p_mm), 1, 1)), T_base_ee[:, :3, :3]], axis=2)
    found = _explained(1e3 * T_base_ee[:, :3, 3].ravel(), of_S, others.reshape(-1, 6))
    if found is None or found[1] < LEAST_MOTION_MM:
        return None
    # Of positions in one plane a third singular value is nought.
    return float(np.linalg.svd(found[0].reshape(3, 3), compute_uv=False)[1])


def scale_of_distances(d_mm: Array, T_base_ee: Array) -> float | None:
    """Return how many millimetres the nominal model moves for one that the distance changed.

    Args:
        d_mm: (N,) distances of one target from a fixed point, in what should be millimetres.
        T_base_ee: (N, 4, 4) the nominal model's end-effector for the same joint positions [m].

    Returns:
        The scale, or None where the rows do not tell.
    """
    if len(d_mm) < LEAST_ROWS:
        return None
    # |x|^2 = k^2 d^2 + 2 x.c - |c|^2 for a target at the origin, and with its products elsewhere.
    x, R = 1e3 * T_base_ee[:, :3, 3], T_base_ee[:, :3, :3]
    others = [x, np.ones((len(x), 1))]
    if len(d_mm) >= ROWS_FOR_TARGET:
        others += [np.einsum("pji,pj->pi", R, x), R.reshape(-1, 9)]
    found = _explained((x**2).sum(axis=1), d_mm[:, None] ** 2, np.hstack(others))
    if found is None or found[1] < LEAST_MOTION_MM**2 or found[0][0] <= 0.0:
        return None
    return float(np.sqrt(found[0][0]))


def refuse_wrong_length_unit(scale: float | None, what: str, where: str) -> None:
    """Stop when measured lengths are in another unit than millimetres.

    Args:
        scale: from `scale_of_points` or `scale_of_distances`.
        what: `positions` or `distances`.
        where: file and columns, for the message.

    Raises:
        RawDataError: naming the scale, and the unit where it is likely.
    """
    if scale is None or 1.0 / SCALE_RATIO <= scale <= SCALE_RATIO:
        return
    unit = next((name for mm, name in UNITS.items() if 0.5 < scale / mm < 1.6), None)
    raise RawDataError(
        f"the {what} look like {unit}" if unit else f"the {what} do not fit the joint motion",
        where=where,
        value=f"one measured millimetre is {scale:.3g} mm of the nominal model's motion",
        allowed=f"{what} in millimetres",
        remedy="convert the columns to millimetres" if unit else "check the unit of these columns",
    )


def _explained(values: Array, by_these: Array, by_others: Array) -> tuple[Array, float] | None:
    """Return what explains that part of values which others leave, and that part's rms; or None."""
    together = np.column_stack([values, by_these])
    together = together - by_others @ np.linalg.lstsq(by_others, together, rcond=1e-9)[0]
    rest, columns = together[:, 0], together[:, 1:]
    solved = np.asarray(np.linalg.lstsq(columns, rest, rcond=1e-9)[0], dtype=float)
    left = rest - columns @ solved
    if left @ left > (1.0 - EXPLAINED) * (rest @ rest):
        return None
    return solved, float(np.sqrt(np.mean(rest**2)))
