"""Readings of the same joint positions are repeats of one pose."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from pa10cal.arrays import Array

#: Commands whose joints differ by less are one command [rad].
SAME_COMMAND_RAD = 1e-6


def same_commands(q_rad: Array) -> NDArray[np.intp]:
    """Number the commands (N,) from 0 in the order in which they first appear."""
    count = len(q_rad)
    pairs = cKDTree(q_rad).query_pairs(SAME_COMMAND_RAD, p=np.inf, output_type="ndarray")
    ones = np.ones(len(pairs), dtype=np.int8)
    graph = coo_array((ones, (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    group = connected_components(graph, directed=False)[1]
    return np.asarray(pd.factorize(group)[0], dtype=np.intp)


def labels(number: NDArray[np.intp]) -> list[str]:
    """Return labels of commands, which sort as text in the order of their numbers."""
    digits = max(5, len(str(number.max(initial=0) + 1)))
    return [f"P{k:0{digits}d}" for k in number + 1]
