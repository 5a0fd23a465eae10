"""The order in which to drive to poses: near the shortest way."""

from __future__ import annotations

import numpy as np
from scipy.spatial.distance import cdist

from pa10cal.arrays import Array, Index

_MOST_ROUNDS = 50
_SHORTER = 1e-9


def short_path(q: Array) -> Index:
    """Return poses (N, n) in an order in which the joints travel little.

    A move takes as long as the joint that turns furthest. The nearest pose not yet visited comes
    next, from the best of all starts; then stretches are turned round as long as that is shorter
    (2-opt). Whether arm or tool meets something between two poses is not looked at.
    """
    if len(q) < 3:
        return np.arange(len(q), dtype=np.intp)
    away = cdist(q, q, metric="chebyshev")
    starts = [_nearest_next(away, first) for first in range(len(q))]
    order = min(starts, key=lambda each: float(away[each[:-1], each[1:]].sum()))
    for _ in range(_MOST_ROUNDS):
        turned = _turned_round(away, order)
        if turned is None:
            break
        order = turned
    return order


def path_length(q: Array) -> float:
    """Return the sum over moves of the furthest that a joint turns, in the order given."""
    return float(np.abs(np.diff(q, axis=0)).max(axis=1, initial=0.0).sum())


def _nearest_next(away: Array, first: int) -> Index:
    left = away.copy()
    order = [first]
    for _ in range(len(away) - 1):
        left[:, order[-1]] = np.inf
        order.append(int(np.argmin(left[order[-1]])))
    return np.array(order, dtype=np.intp)


def _turned_round(away: Array, order: Index) -> Index | None:
    """Return the path with the one stretch turned round that makes it shortest; None: none does.

    An end of the path has no neighbour, so that a stretch up to it may be turned for free.
    """
    count = len(order)
    between = np.zeros((count + 1, count + 1))  # the last place is nowhere
    between[:count, :count] = away[np.ix_(order, order)]
    first, last = np.triu_indices(count, k=1)
    before, after = first - 1, np.where(last + 1 < count, last + 1, -1)
    now = between[before, first] + between[last, after]
    then = between[before, last] + between[first, after]
    best = int(np.argmin(then - now))
    if then[best] >= now[best] - _SHORTER:
        return None
    turned = order.copy()
    turned[first[best] : last[best] + 1] = order[first[best] : last[best] + 1][::-1]
    return turned
