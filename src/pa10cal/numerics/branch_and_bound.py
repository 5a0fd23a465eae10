"""The best of many candidates by branch and bound: lower bounds save most of the fits.

A fit of a candidate is expensive; a lower bound of its misfit is cheap. Candidates are visited by
rising lower bound. As soon as a lower bound exceeds the best misfit so far, neither this candidate
nor any later one can be better, and the search ends. The result is the same as if all candidates
were fitted.

A lower bound usually comes from a relaxed problem, such as a linear one: `frame.target_problem`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

#: Rounding errors may make a lower bound larger than the misfit by this factor (computing).
ROUNDING_SLACK = 1.001


class BestCandidate(NamedTuple):
    """The candidate with the smallest misfit."""

    misfit: float
    number: int  # position among the candidates, from 0


def may_be_within(lower_bound: float, limit: float) -> bool:
    """Return whether a misfit with this lower bound may be at most `limit`.

    Rounding may have made the bound a little larger than the misfit, which is allowed for. Both are
    in the same unit; false means that a fit of the candidate cannot help.
    """
    return lower_bound <= ROUNDING_SLACK * limit


def best_candidate(
    lower_bounds: Sequence[float], misfit_of: Callable[[int], float], limit: float
) -> BestCandidate | None:
    """Return the candidate with the smallest misfit; of several such the first.

    Args:
        lower_bounds: lower bound of the misfit of every candidate, in the unit of the misfits.
        misfit_of: fits the candidate of this number, and returns its misfit.
        limit: the largest misfit that counts.

    Returns:
        The best candidate; None where no misfit is within the limit.
    """
    best: BestCandidate | None = None
    for number in np.argsort(lower_bounds, kind="stable").tolist():
        threshold = limit if best is None else best.misfit
        if lower_bounds[number] > ROUNDING_SLACK * threshold:
            break
        candidate = BestCandidate(misfit_of(number), number)
        # Of equal misfits the lower number is the smaller tuple.
        if candidate.misfit <= limit and (best is None or candidate < best):
            best = candidate
    return best
