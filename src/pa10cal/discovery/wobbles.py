"""Axes that wobble as their joints turn, where nothing that gives way can do the same.

A bearing that is softer about one axis than about another tilts, under weights that turn with the
joint, nearly as a wobble does. So the tilts of every joint's axis are looked at beside all that may
give way, integrated out in large sizes: bearings about any axes, links, base and tool, under the
weights as described and, where nobody stated these, under each by itself. What stands out then is
no weight's doing, and joins the candidates of the search.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace

import numpy as np

from pa10cal.arm.description import weights_known
from pa10cal.arm.statics import Payload, PoseStates
from pa10cal.arrays import Array, drawn
from pa10cal.discovery import linear
from pa10cal.discovery.rules import LINES, PROBABILITIES, WOBBLES
from pa10cal.discovery.together import UnderWeights
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.observations import Observations
from pa10cal.terms.effects.effect import CandidateContext, Effect, every_effect, static_loads_in
from pa10cal.terms.effects.structure import AxisWobble, LateralCompliance
from pa10cal.terms.term import TermParameter


@dataclass(frozen=True)
class _SoftAnyWay(LateralCompliance):
    """A bearing that tilts about each of its two axes under the moments about both."""

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        usual, names = super().reported[0], ("C_xx", "C_xy", "C_yx", "C_yy")
        return tuple(replace(usual, name=name) for name in names)

    def per_unit(self, states: PoseStates) -> Array:
        moment_Nm = static_loads_in(states, self).link_Nm[:, self.joint - 2, :2]
        return np.asarray(np.einsum("pk,ij->pijk", moment_Nm, np.eye(2)).reshape(-1, 2, 4))


def wobbles(
    at: FittedModel,
    poses: Observations,
    left: Array,
    whiten: Array,
    context: CandidateContext,
    payload: Payload | None,
    error_rate: float,
    known: Collection[str] = (),
) -> tuple[AxisWobble, ...]:
    """Return the axis of which a wobble stands out most of what a model leaves; none where none is.

    Args:
        at: the model, fitted to the poses.
        poses: P complete poses.
        left: (P, b) what it leaves of them, predicted less measured.
        whiten: (P, b, b) by which their components are white.
        context: where effects may sit.
        payload: what the arm carries; None where no weight is known.
        error_rate: the probability allowed of finding a wobble where there is none.
        known: places of wobbles that were tried.
    """
    if len(poses) > LINES.most_poses:
        rows = drawn(len(poses), LINES.most_poses)
        poses, left, whiten = poses.take(rows), left[rows], whiten[rows]
    there = {*known, *(term.of for term in at.model.terms if term.id == AxisWobble.id)}
    tried = [each for each in AxisWobble.everywhere(context) if each.of not in there]
    if not tried:
        return ()
    at = at.with_bends(range(1, at.arm.n))
    own = [
        *linear.by_own_terms(at, poses, at.model.terms, whiten),
        whiten @ linear.by_targets(at, poses),
        *_giving_way(at, poses, whiten, context, payload),
    ]
    data = -(whiten @ left[:, :, None])[:, :, 0]
    starts = [each.starts[0] for each in tried]
    tilts = linear.by_effects(at, poses, tried, starts, whiten)
    gains = _gains(np.concatenate(own, axis=2), tilts, data)
    best, *others = np.argsort(-gains).tolist()
    needed = float(np.log(len(tried) / error_rate))
    if gains[best] < needed:
        return ()
    if others and gains[others[0]] > gains[best] - WOBBLES.better_nats:
        return ()
    return (tried[best],)


def _giving_way(
    at: FittedModel,
    poses: Observations,
    whiten: Array,
    context: CandidateContext,
    payload: Payload | None,
) -> Iterator[Array]:
    """Yield whitened columns of all that may give way but springs, in large sizes."""
    if payload is None or poses.states.static_loads is None:
        return
    kinds = [kind for kind in every_effect() if kind.bends and kind is not LateralCompliance]
    soft: list[Effect] = [each for kind in kinds for each in kind.everywhere(context)]
    soft += _SoftAnyWay.everywhere(context)
    starts = [each.starts[0] for each in soft]

    def columns(posed: Observations) -> Array:
        found = linear.by_effects(at, posed, soft, starts, whiten)
        return WOBBLES.sizes * np.concatenate(found, axis=2)

    described = columns(poses)
    yield described
    if weights_known(at.arm).assumed:
        for _, heavier in UnderWeights(at.arm, payload, poses).heavier():
            yield columns(heavier) - described


def _gains(own: Array, tilts: list[Array], data: Array) -> Array:
    """Return the gain of log evidence by each of K effects, scatter profiled, (K,).

    By whitened columns of all else (P, b, n), of the effects (P, b, k) each, and the data (P, b).
    """
    columns = np.stack(tilts, axis=2)  # (P, b, K, k)
    across = np.einsum("pbn,pbki->nki", own, columns)
    gram = np.einsum("pbki,pbkj->kij", columns, columns)
    projection = np.einsum("pbki,pb->ki", columns, data)
    beside = Gaussian.of(own, data).of_each_further(across, gram, projection)
    gains, _ = beside.gains(int(np.count_nonzero(data)))
    return np.asarray(gains / PROBABILITIES.blocks)
