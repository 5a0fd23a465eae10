"""Up to which order of a joint's angle the measured angles tell sines apart."""

from __future__ import annotations

from bisect import bisect_left

import numpy as np

from pa10cal.arrays import Array

#: Angles closer than this part of a cycle count as one.
_SAME_PHASE = 0.1


def highest_told(orders: Array, q_rad: Array) -> float:
    """Return the highest order (cycles a turn) up to which the angles tell all orders apart.

    A sine has two unknowns, and two orders differ over the arc that the joint moved where they are
    one cycle of it apart. So many orders up to a highest one can be told apart only where there are
    twice as many different angles, the mean being one unknown more; beyond that any error is a sum
    of such sines.

    Args:
        orders: (F,) ascending cycles a turn, of which one is returned; the first where not even
            that can be told.
        q_rad: (C,) angles measured.
    """
    angles = np.sort(q_rad / (2.0 * np.pi)).tolist()
    turns, highest = angles[-1] - angles[0], float(orders[0])
    for order in orders.tolist():
        if _different(angles, _SAME_PHASE / order) < 1 + 2 * int(turns * order):
            break
        highest = order
    return highest


def _different(angles: list[float], apart: float) -> int:
    """Return how many of ascending angles [turns] are so far apart."""
    count, at = 0, 0
    while at < len(angles):
        count, at = count + 1, bisect_left(angles, angles[at] + apart)
    return count
