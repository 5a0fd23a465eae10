"""The family of candidates of a survey, and what its poses can show of each.

All of it is settled before residuals are looked at.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.state import PoseStates
from pa10cal.discovery.blocked_cv.candidate import Candidate, map_candidates
from pa10cal.discovery.blocked_cv.products import Products
from pa10cal.discovery.blocked_cv.rows import Rows, ShapedEffect
from pa10cal.discovery.blocked_cv.selection import Columns, solve
from pa10cal.discovery.blocked_cv.survey import Survey
from pa10cal.discovery.family import why_hidden, why_unknown
from pa10cal.discovery.verdict import NotTestable
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.family import candidates
from pa10cal.terms.effects.joint_error_map import JointErrorMap

Array = NDArray[np.float64]
Index = NDArray[np.intp]


def computable(survey: Survey) -> tuple[tuple[ShapedEffect, ...], tuple[NotTestable, ...]]:
    """Return effects that can be computed with what is known of the poses, and the others.

    Each effect at each of its shapes; maps are not among them.
    """
    shaped: list[ShapedEffect] = []
    refused = []
    for effect in candidates(survey.context, survey.baseline.model.terms):
        if isinstance(effect, JointErrorMap):
            continue
        logged = survey.torques_logged
        why = why_unknown(effect, survey.poses.states, logged=logged, weights=True)
        if why is None:
            shaped += [ShapedEffect(effect, shape) for shape in range(len(effect.starts))]
        else:
            refused.append(NotTestable(effect, why, by_these_poses=False))
    return tuple(shaped), tuple(refused)


def family(rows: Rows, products: Products) -> tuple[tuple[Candidate, ...], tuple[NotTestable, ...]]:
    """Return the candidates that these poses can show, and the effects that they cannot."""
    total = products.summed().gram
    own = rows.own
    shown, refused = [], {}
    named = [
        Candidate(shaped, Columns(at, np.ones(len(at))))
        for shaped, at in zip(rows.shaped, rows.of_shaped(), strict=True)
    ]
    for candidate in (*named, *map_candidates(rows)):
        why = _hidden(rows, total, own, candidate)
        if why is None:
            shown.append(candidate)
        else:
            refused[candidate.name] = NotTestable(_plain(candidate.effect), why)
    names = {candidate.name for candidate in shown}
    return tuple(shown), tuple(found for name, found in refused.items() if name not in names)


def _hidden(rows: Rows, gram: Array, own: Index, candidate: Candidate) -> str | None:
    """Return why the poses cannot show a candidate, None where they can."""
    at, sizes = candidate.columns.at, candidate.columns.sizes
    across = gram[np.ix_(own, at)] * sizes
    whole = gram[np.ix_(at, at)] * np.outer(sizes, sizes)
    if not np.trace(whole) > 0.0:
        return _why_silent(rows.survey.poses.states, candidate.shaped)
    followed = solve(gram[np.ix_(own, own)], across, np.eye(len(own)))
    left = whole - across.T @ followed
    share = float(np.sqrt(max(np.trace(left), 0.0) / np.trace(whole)))
    signal = float(np.sqrt(max(np.linalg.eigvalsh(left)[-1], 0.0)))
    return why_hidden(share, signal)


def _why_silent(states: PoseStates, shaped: ShapedEffect) -> str:
    """Return why an effect moves nothing at all in these poses."""
    arrived = replace(states, arrival=np.ones_like(states.arrival))
    if np.any(shaped.effect.derivative(arrived, shaped.start)):
        return "the direction of arrival is not known"
    return "the poses do not exercise it"


def _plain(effect: Effect) -> Effect:
    """Return the map of a joint in its usual form, whatever its spacing; others as they are."""
    return JointErrorMap(effect.of) if isinstance(effect, JointErrorMap) else effect
