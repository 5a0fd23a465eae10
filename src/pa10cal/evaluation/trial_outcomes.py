"""What became of each hidden effect: the rows of the confusion matrix, and curves of power."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from pa10cal.evaluation.blind_trial import OUTSIDE, BlindTrial, Hidden
from pa10cal.evaluation.trial_rates import power, rate
from pa10cal.evaluation.trial_scores import LARGE, LIMIT
from pa10cal.results.trials import MovedBin, PowerStudy

LISTED = "in the alternatives"
ELSEWHERE = "right id elsewhere"
RIGHT_PLACE = "no name, right place"
WRONG_PLACE = "no name, other place"
NOTHING = "nothing found"
NOT_TESTABLE = "said to be not testable"
FAILED = "failed"

#: Edges of the bins in which shares are counted: of how far the residual moves, over the floor. Two
#: of them are where the residual is `LIMIT` and `LARGE` times the floor.
MOVED_EDGES = (
    *(0.0, 0.1, 0.2, 0.4),
    *(float(np.sqrt(ratio**2 - 1.0)) for ratio in (LIMIT, LARGE)),
    *(8.0, np.inf),
)
#: Less than this counts as this; keeps logarithms finite.
_LEAST_MOVED = 0.03


def outcome(trial: BlindTrial, hidden: Hidden) -> str:
    """Return what became of one hidden effect: an id of the vocabulary or one of the words here.

    Where findings match no hidden effect, the first of them counts.
    """
    verdict = trial.verdict
    if verdict is None:
        return FAILED
    if trial.names(hidden):
        return hidden.name.id
    if trial.lists(hidden):
        return LISTED
    if trial.kind == OUTSIDE and trial.has_right_place():
        return RIGHT_PLACE
    if verdict.effects:
        ids = [named.name.id for named in verdict.effects]
        return ELSEWHERE if hidden.name.id in ids else ids[0]
    if verdict.word == "unexplained":
        return RIGHT_PLACE if hidden.name.of in verdict.places else WRONG_PLACE
    return NOTHING if trial.is_testable(hidden) else NOT_TESTABLE


def confusion(trials: Sequence[BlindTrial]) -> dict[str, Counter[str]]:
    """Count the outcomes of each id, of trials that hide one effect."""
    counts: dict[str, Counter[str]] = {}
    for trial in trials:
        (hidden,) = trial.hidden
        counts.setdefault(hidden.name.id, Counter())[outcome(trial, hidden)] += 1
    return counts


def study_power(trials: Sequence[BlindTrial]) -> PowerStudy:
    """Fit power curves to trials that hide one effect and did not fail."""
    known = [(t, t.hidden[0]) for t in trials if t.verdict is not None]
    ids = sorted({hidden.name.id for _, hidden in known})
    moving = [(t, h) for t, h in known if t.moves_poses(h)]
    moved = np.array([t.moved_over_floor(h) or 0.0 for t, h in moving])
    listed = np.array([t.lists(h) for t, h in moving], dtype=bool)
    return PowerStudy(
        by_id={
            name: power(
                np.array([h.size for _, h in known if h.name.id == name]),
                np.array([t.lists(h) for t, h in known if h.name.id == name], dtype=bool),
            )
            for name in ids
        },
        by_moved=power(np.maximum(moved, _LEAST_MOVED), listed),
        bins=tuple(
            MovedBin(
                low=low,
                high=high if np.isfinite(high) else None,
                listed=rate(listed[(moved >= low) & (moved < high)].tolist()),
            )
            for low, high in pairwise(MOVED_EDGES)
        ),
    )
