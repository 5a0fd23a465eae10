"""What short forms are held against, where blocks of poses judged: rows about the last fit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.discovery.formulas.rows import Arena, Contest
from pa10cal.discovery.linear import by_targets, by_terms, possible_sizes
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_error_map import JointErrorMap
from pa10cal.terms.forms.form import Form
from pa10cal.terms.term import Term
from pa10cal.terms.weights import Weights

if TYPE_CHECKING:
    from pa10cal.discovery.blocked_cv.discover import VerdictByBlocks
    from pa10cal.observe.observations import Observations


def arena_by_blocks(
    verdict: VerdictByBlocks, held: Sequence[Effect], most_poses: int | None = None
) -> Arena:
    """Return what forms are held against in place of some effects.

    Maps that are not among these stay as they were fitted; all else is fitted with the forms.

    Args:
        verdict: on the campaign.
        held: effects of the model, and smooth unknown functions that it has not.
        most_poses: so many poses are enough, drawn from all; None for all.
    """
    extended, survey = verdict.extended, verdict.survey
    at, poses = extended.at, survey.poses
    count = len(poses)
    rows = np.arange(count)
    if most_poses is not None and count > most_poses:  # some of every block, whatever their order
        rows = np.sort(np.random.default_rng(0).permutation(count)[:most_poses])
    whiteners = extended.weights.whiteners(rows)
    chosen: Observations = poses.take(rows)
    every_row = whiteners.shape[0] * whiteners.shape[1]

    seen: slice | NDArray[np.intp] = slice(None)
    if chosen.measured.campaigns:  # each pose has the components of its own campaign alone
        seen = np.flatnonzero(chosen.measured.components_seen)

    def weighed(terms: Sequence[Term], points: Sequence[Array]) -> list[Array]:
        return [
            (whiteners @ each).reshape(every_row, each.shape[2])[seen]
            for each in by_terms(at, chosen, terms, points)
        ]

    values = {term: at.x[at.model.columns_of(term)] for term in at.model.terms}
    gone = set(held)
    fitted = [
        term for term in at.model.terms if not isinstance(term, JointErrorMap) and term not in gone
    ]
    own = weighed(fitted, [values[term] for term in fitted])
    targets = whiteners @ by_targets(at, chosen)
    data = -(whiteners @ survey.left_by(at)[rows][:, :, None]).ravel()[seen]
    remaining = verdict.remaining
    noise = float(data @ data) * min(1.0, (remaining.floor_mm / remaining.mean_mm) ** 2)
    for term, columns in zip(fitted, own, strict=True):
        if isinstance(term, Weights):  # expected about what is described, not about the fit
            data = data + columns @ values[term]
    sizes = possible_sizes(at.model, chosen.measured)
    of_own = [sizes[at.model.columns_of(term)] for term in fitted]
    own_columns = np.concatenate(
        [
            *(columns * size for columns, size in zip(own, of_own, strict=True)),
            targets.reshape(every_row, targets.shape[2])[seen] * sizes[len(at.x) :],
        ],
        axis=1,
    )
    points = [values.get(effect, effect.starts[0]) for effect in held]
    of_held = []
    for effect, x, columns in zip(held, points, weighed(held, points), strict=True):
        linear = columns[:, : effect.linear]
        data = data + linear @ x[: effect.linear]
        of_held.append(linear @ effect.prior_factor)

    def columns_of(forms: Sequence[Form]) -> list[Array]:
        starts = [form.starts[0] for form in forms]
        found = weighed(forms, starts)
        return [columns @ form.prior_factor for columns, form in zip(found, forms, strict=True)]

    components = whiteners.shape[1]
    return Arena(
        Contest(data, own_columns, np.repeat(survey.block[rows], components)[seen]),
        np.concatenate(of_held, axis=1) if of_held else None,
        columns_of,
        chosen.states,
        noise,
    )
