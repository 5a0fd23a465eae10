"""Order of points with short moves between neighbours: nearest neighbour, improved by 2-opt.

The length of a move is the largest of its components (Chebyshev), as the time of a robot's move is
that of the joint that turns furthest.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.distance import cdist

from pa10cal.arrays import Array, Index

#: Improvements of a path, at most.
_MOST_ROUNDS = 50
#: A path must become shorter by more than this: less is rounding.
_SHORTER = 1e-9


def short_path(q: Array) -> Index:
    """Return an order of points (N, n) whose path is short.

    Nearest neighbour, from the best of all starts; then 2-opt: the stretch whose reversal shortens
    the path most is reversed, until none does. For robots: collisions between poses are ignored.
    """
    if len(q) < 3:
        return np.arange(len(q), dtype=np.intp)
    distance = cdist(q, q, metric="chebyshev")
    paths = [_nearest_neighbours(distance, start) for start in range(len(q))]
    path = min(paths, key=lambda order: float(distance[order[:-1], order[1:]].sum()))
    for _ in range(_MOST_ROUNDS):
        shorter = _best_reversal(distance, path)
        if shorter is None:
            break
        path = shorter
    return path


def path_length(q: Array) -> float:
    """Return the length of the path through points (N, n) in the order given."""
    return float(np.abs(np.diff(q, axis=0)).max(axis=1, initial=0.0).sum())


def _nearest_neighbours(distance: Array, start: int) -> Index:
    """Return the path from a start that goes to the nearest point not yet visited, (N,)."""
    unvisited = distance.copy()
    path = [start]
    for _ in range(len(distance) - 1):
        unvisited[:, path[-1]] = np.inf
        path.append(int(np.argmin(unvisited[path[-1]])))
    return np.array(path, dtype=np.intp)


def _best_reversal(distance: Array, path: Index) -> Index | None:
    """Return the path with one stretch reversed that shortens it most; None where none does."""
    count = len(path)
    # Row and column `count`, also index -1, are beyond the ends: moves to there have no length.
    between = np.zeros((count + 1, count + 1))
    between[:count, :count] = distance[np.ix_(path, path)]
    first, last = np.triu_indices(count, k=1)
    before = first - 1
    after = np.where(last + 1 < count, last + 1, -1)
    length = between[before, first] + between[last, after]
    reversed_length = between[before, last] + between[first, after]
    best = int(np.argmin(reversed_length - length))
    if reversed_length[best] >= length[best] - _SHORTER:
        return None
    shorter = path.copy()
    stretch = slice(first[best], last[best] + 1)
    shorter[stretch] = path[stretch][::-1]
    return shorter
