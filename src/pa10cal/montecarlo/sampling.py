"""Drawing joint errors, and the length of the flange's displacement for each draw.

Every position has a random stream of its own and is worked through in blocks small enough for the
processor's cache; nothing is allocated between blocks. So the numbers do not depend on the order of
the positions, nor on how they are shared among jobs or threads. The block's length belongs to the
definition of the draws and is therefore a constant.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.montecarlo.displacement import DisplacementBlock, DisplacementPlan

Counts = NDArray[np.int64]

#: Cycles a block: long enough to hide the cost of a call, short enough for the cache and for BLAS
#: to keep each product on one thread.
BLOCK_CYCLES = 6250

#: Called with positions done and positions in all.
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class ErrorSums:
    """Sums over the first cycles of P positions, at several counts of cycles."""

    cycles: Counts  # (C,) counts of cycles, increasing; the last is all of them
    error_m: Array  # (P, C) sum of the errors of the first cycles
    squared_m2: Array  # (P, C) sum of their squares


def stream(random_seed: int, plane_mm: int, position: int | None) -> np.random.Generator:
    """Return the generator of one position's draws, or, for None, of the positions themselves."""
    key = (plane_mm % 2**32, 0 if position is None else position + 1)
    seed = np.random.SeedSequence(random_seed % 2**64, spawn_key=key)
    return np.random.Generator(np.random.SFC64(seed))


def sample_errors(
    plan: DisplacementPlan,
    streams: Sequence[np.random.Generator],
    counts: Counts,
    progress: Progress = lambda _done, _all: None,
) -> ErrorSums:
    """Draw the joint errors of every cycle at every position and sum the position errors.

    Args:
        plan: the displacement at P positions.
        streams: P fresh generators, one a position.
        counts: (C,) increasing counts of cycles at which the sums are kept; the last is the
            number of cycles at each position.
        progress: called before the first and after every position.
    """
    cycles = int(counts[-1])
    starts = np.arange(0, cycles, BLOCK_CYCLES)
    cuts = np.unique(np.concatenate([starts, counts[:-1]]))
    sums = np.empty((2, len(streams), len(cuts)))
    blocks = {
        length: DisplacementBlock(plan, length)
        for length in {min(BLOCK_CYCLES, cycles - int(start)) for start in starts}
    }
    ones = np.ones(BLOCK_CYCLES)
    work = []
    for start in starts:
        block = blocks[min(BLOCK_CYCLES, cycles - int(start))]
        inside = cuts[(cuts >= start) & (cuts < start + BLOCK_CYCLES)]
        bounds = [*(inside - start), len(block.error_m)]
        parts = [
            (block.error_m[first:last], ones[: last - first])
            for first, last in itertools.pairwise(bounds)
        ]
        work.append((block, parts))
    progress(0, len(streams))
    for position, source in enumerate(streams):
        drawn = []
        for block, parts in work:
            source.standard_normal(out=block.normals)
            block.displace(position)
            drawn += [(error_m.dot(one), error_m.dot(error_m)) for error_m, one in parts]
        sums[:, position] = np.transpose(drawn)
        progress(position + 1, len(streams))
    ends = np.searchsorted(np.append(cuts[1:], cycles), counts)
    error_m, squared_m2 = np.cumsum(sums, axis=2)[:, :, ends]
    return ErrorSums(cycles=counts, error_m=error_m, squared_m2=squared_m2)
