"""Axes that wobble as their joints turn, beside everything that may give way.

A bearing that is softer about one axis than about another tilts under weights that turn with the
joint, nearly as a wobble does. So the tilts of every joint's axis are tested beside all that may
give way, integrated out with large prior sizes: bearings about any axes, links, base and tool,
under the weights as described and, where nobody stated these, by each weight. A wobble that is
significant then is not caused by weights, and joins the candidates of the search.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np

from pa10cal.arm.description import weights_known
from pa10cal.arm.statics import Payload, PoseStates
from pa10cal.arrays import Array
from pa10cal.discovery import linear
from pa10cal.discovery.linear import WhitenedPoses
from pa10cal.discovery.rules import LINES, PROBABILITIES, WOBBLES
from pa10cal.discovery.together import heavier
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.uncertain_weights import weight_sizes
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.observations import Observations
from pa10cal.terms.effects.effect import CandidateContext, Effect, every_effect, static_loads_in
from pa10cal.terms.effects.structure import AxisWobble, LateralCompliance


@dataclass(frozen=True)
class _SoftAnyWay(LateralCompliance):
    """A bearing that tilts about each of its two axes under the moments about both."""

    names = ("C_xx", "C_xy", "C_yx", "C_yy")

    def per_unit(self, states: PoseStates) -> Array:
        moment_Nm = static_loads_in(states, self).link_Nm[:, self.joint - 2, :2]
        return np.asarray(np.einsum("pk,ij->pijk", moment_Nm, np.eye(2)).reshape(-1, 2, 4))


def wobbles(
    rows: WhitenedPoses,
    context: CandidateContext,
    payload: Payload | None,
    error_rate: float,
    known: Collection[str],
) -> tuple[AxisWobble, ...]:
    """Return the wobble that is significant in a model's residual, and clearly the best; or none.

    Args:
        rows: the poses about the model.
        context: where effects may sit.
        payload: what the arm carries; None where no weight is known.
        error_rate: probability allowed of finding a wobble where there is none.
        known: places of wobbles that were tried.
    """
    rows = rows.at_most(LINES.most_poses)
    there = {*known, *(term.of for term in rows.at.model.terms if term.id == AxisWobble.id)}
    tried = [wobble for wobble in AxisWobble.everywhere(context) if wobble.of not in there]
    if not tried:
        return ()
    at, poses, whiten = rows.at.with_bends(range(1, rows.at.arm.n)), rows.poses, rows.whitener
    own = [
        *linear.by_own_terms(at, poses, at.model.terms, whiten),
        whiten @ linear.by_targets(at, poses),
        *_giving_way(at, poses, whiten, context, payload),
    ]
    starts = [wobble.starts[0] for wobble in tried]
    tilts = linear.by_effects(at, poses, tried, starts, whiten)
    gains = _gains(np.concatenate(own, axis=2), tilts, rows.data)
    best, *others = np.argsort(-gains).tolist()
    needed = float(np.log(len(tried) / error_rate))
    ambiguous = bool(others) and gains[others[0]] > gains[best] - WOBBLES.better_nats
    return () if gains[best] < needed or ambiguous else (tried[best],)


def _giving_way(
    at: FittedModel,
    poses: Observations,
    whiten: Array,
    context: CandidateContext,
    payload: Payload | None,
) -> Iterator[Array]:
    """Yield whitened columns of everything compliant but springs, scaled to large sizes."""
    if payload is None or poses.states.static_loads is None:
        return
    kinds = [kind for kind in every_effect() if kind.bends and kind is not LateralCompliance]
    soft: list[Effect] = [effect for kind in kinds for effect in kind.everywhere(context)]
    soft += _SoftAnyWay.everywhere(context)
    starts = [effect.starts[0] for effect in soft]

    def columns(posed: Observations) -> Array:
        found = linear.by_effects(at, posed, soft, starts, whiten)
        return WOBBLES.sizes * np.concatenate(found, axis=2)

    described = columns(poses)
    yield described
    if weights_known(at.arm).assumed:
        for each in heavier(poses, weight_sizes(at.arm, payload).columns(at.arm)):
            yield columns(each) - described


def _gains(own: Array, tilts: list[Array], data: Array) -> Array:
    """Return the gain of log evidence (K,) by each of K effects, the scatter profiled.

    Args:
        own: (P, b, n) whitened columns of all else.
        tilts: (P, b, k) whitened columns of each effect.
        data: (P, b) whitened, measured less predicted.
    """
    columns = np.stack(tilts, axis=2)  # (P, b, K, k)
    across = np.einsum("pbn,pbki->nki", own, columns)
    gram = np.einsum("pbki,pbkj->kij", columns, columns)
    projection = np.einsum("pbki,pb->ki", columns, data)
    beside = Gaussian.of(own, data).of_each_further(across, gram, projection)
    gains, _ = beside.gains(int(np.count_nonzero(data)))
    return np.asarray(gains / PROBABILITIES.blocks)
