"""What short forms are held against, where repeats judged: rows about the end of the search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pa10cal.arrays import Array
from pa10cal.discovery.evidence.confirm import weighed_rows
from pa10cal.discovery.formulas.rows import Arena, Contest
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.forms.form import Form

if TYPE_CHECKING:
    from pa10cal.discovery.evidence.discover import VerdictByRepeats
    from pa10cal.discovery.evidence.search import EndOfSearch


#: Blocks of poses that are left out in turn.
_FOLDS = 9


def arena_by_repeats(verdict: VerdictByRepeats, held: Sequence[Effect]) -> Arena:
    """Return what forms are held against in place of some effects that the search ended with.

    Where there are none, rows are weighed by the noise of repeats alone: that is to be reached.

    Args:
        verdict: on the campaign.
        held: maps and smooth unknown functions.
    """
    found = _forgetful(verdict.judgement.found)
    if not held:
        found = replace(found, score=replace(found.score, pose_variance=0.0))
    problem = found.problem
    rows = weighed_rows(problem, found, ())
    numbers = [found.fit.effects.index(effect) for effect in held]
    columns = np.arange(rows.own.shape[1])
    of_held = np.concatenate([columns[:0], *(columns[rows.members[k]] for k in numbers)])
    _, pose = np.unique(problem.cells.pose, return_inverse=True)

    def columns_of(forms: Sequence[Form]) -> list[Array]:
        return list(weighed_rows(problem, found, tuple(forms)).family)

    return Arena(
        Contest(rows.data, np.delete(rows.own, of_held, axis=1), (pose % _FOLDS)[rows.cell]),
        rows.own[:, of_held] if held else None,
        columns_of,
        problem.cells.states,
        None,
    )


def _forgetful(found: EndOfSearch) -> EndOfSearch:
    """Return the end of a search whose model does not keep what each of many forms makes."""
    model = replace(found.fit.model, kept=None)
    return replace(found, fit=replace(found.fit, at=replace(found.fit.at, model=model)))
