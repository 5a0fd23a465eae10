"""Axes that wobble as their joints turn, by the residual of a search.

A bearing that is softer about one axis than about another tilts under weights that turn with the
joint, nearly as a wobble does. So the tilts of every axis are tested beside all that may give way,
with large prior sizes: bearings about any axes, links, base and tool, under the weights as
described and, where nobody stated these, by each weight.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace

import numpy as np

from pa10cal.arm.description import weights_known
from pa10cal.arm.statics import Payload, PoseStates
from pa10cal.arrays import Array
from pa10cal.discovery import jacobians
from pa10cal.discovery.jacobians import WhitenedPoses
from pa10cal.discovery.model_columns import ModelColumns
from pa10cal.discovery.rules import LINES, PROBABILITIES, WOBBLES
from pa10cal.discovery.together import heavier
from pa10cal.fit.uncertain_weights import weight_sizes
from pa10cal.observe.observations import Observations
from pa10cal.terms.effects.context import CandidateContext
from pa10cal.terms.effects.effect import Effect, static_loads_in
from pa10cal.terms.effects.structure import AxisWobble, LateralCompliance
from pa10cal.terms.effects.vocabulary import every_effect


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
    rows = replace(rows, at=rows.at.with_bends(range(1, rows.at.arm.n)))
    at, poses, whiten = rows.at, rows.poses, rows.whitener
    of_model = ModelColumns.of(rows, *_giving_way(rows, context, payload))
    starts = [wobble.starts[0] for wobble in tried]
    tilts = np.stack(jacobians.by_scaled_effects(at, poses, tried, starts, whiten), axis=2)
    gains = of_model.with_each(tilts).gains(of_model.seen)[0] / PROBABILITIES.blocks
    best, *others = np.argsort(-gains).tolist()
    needed = float(np.log(len(tried) / error_rate))
    ambiguous = bool(others) and gains[others[0]] > gains[best] - WOBBLES.better_nats
    return () if gains[best] < needed or ambiguous else (tried[best],)


def _giving_way(
    rows: WhitenedPoses, context: CandidateContext, payload: Payload | None
) -> Iterator[Array]:
    """Yield whitened columns (P, b, k) of everything compliant but springs, in large sizes."""
    if payload is None or rows.poses.states.static_loads is None:
        return
    kinds = [kind for kind in every_effect() if kind.bends and kind is not LateralCompliance]
    soft: list[Effect] = [effect for kind in kinds for effect in kind.everywhere(context)]
    soft += _SoftAnyWay.everywhere(context)
    starts = [effect.starts[0] for effect in soft]

    def columns(poses: Observations) -> Array:
        found = jacobians.by_scaled_effects(rows.at, poses, soft, starts, rows.whitener)
        return WOBBLES.sizes * np.concatenate(found, axis=2)

    described, arm = columns(rows.poses), rows.at.arm
    yield described
    if weights_known(arm).assumed:
        for each in heavier(rows.poses, weight_sizes(arm, payload).columns(arm)):
            yield columns(each) - described


@dataclass(frozen=True)
class _SoftAnyWay(LateralCompliance):
    """A bearing that tilts about each of its two axes under the moments about both."""

    names = ("C_xx", "C_xy", "C_yx", "C_yy")

    def per_unit(self, states: PoseStates) -> Array:
        moment_Nm = static_loads_in(states, self).link_Nm[:, self.joint - 2, :2]
        return np.asarray(np.einsum("pk,ij->pijk", moment_Nm, np.eye(2)).reshape(-1, 2, 4))
