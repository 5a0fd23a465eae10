"""A base that moved slowly and smoothly while a campaign lasted: too little to be a wander.

A drift is known between poses, and not past a stretch of time, so every tenth pose is held out in
turn. The search's blocks are stretches of time, which see hardly more of it than a constant rate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.discovery.blocked_cv.candidate import standard_error
from pa10cal.discovery.blocked_cv.judge import Prediction
from pa10cal.discovery.blocked_cv.refit import Refit
from pa10cal.discovery.blocked_cv.search import LEAST_SHARE, STANDARD_ERRORS
from pa10cal.discovery.blocked_cv.selection import solve
from pa10cal.discovery.blocked_cv.survey import BLOCKS, Survey
from pa10cal.discovery.family import sought, why_unknown
from pa10cal.discovery.in_time.channel import like_a_scan
from pa10cal.discovery.linear import by_terms, error_mm, possible_sizes
from pa10cal.discovery.weights import PoseWeights
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.in_time import BaseDrift
from pa10cal.terms.effects.joint_error_map import JointErrorMap

Array = NDArray[np.float64]

#: Cosines along each axis: a drift that turns back more often is a wander.
WAVES = 6
#: Part of the readings that must have a time of their own.
_OWN_TIMES = 0.95


@dataclass(frozen=True)
class SlowDrift:
    """A slow drift that held-out poses prefer.

    Attributes:
        effect: the drift.
        proof: how well it predicts every tenth pose.
        alternatives: effects of time that predict these as well.
    """

    effect: BaseDrift
    proof: Prediction
    alternatives: tuple[Effect, ...]


def slow_drift(
    survey: Survey, found: Refit, weights: PoseWeights, least_gain: float, noise: float
) -> SlowDrift | None:
    """Return a slow drift beside the effects found, where it helps; None where it does not.

    Maps keep the errors found of them: they go with angles, and a drift goes with time.

    Args:
        survey: the campaign.
        found: the model with the effects found.
        weights: what poses counted in the search.
        least_gain: sum of squares by which it must help at least.
        noise: sum of squares that noise alone leaves.
    """
    poses = survey.poses
    time_s = poses.states.time_s
    known = len(np.unique(time_s)) > _OWN_TIMES * len(poses)
    if survey.wander is not None or poses.states.campaign is not None or not known:
        return None
    if like_a_scan(poses):
        return None
    drift = BaseDrift("base", float(time_s.min()), float(time_s.max()), WAVES)
    held = _Held(survey, found, weights)
    without, with_drift = held.squares(), held.squares(drift)
    gain = without - with_drift
    over_noise = max(float(with_drift.sum()) - noise, 0.0)
    needed = max(least_gain, LEAST_SHARE * over_noise, STANDARD_ERRORS * standard_error(gain))
    if gain.sum() <= needed:
        return None
    others = []
    for effect in _effects_of_time(survey, found.effects):
        lost = held.squares(effect) - with_drift
        if lost.sum() <= standard_error(lost):
            others.append(effect)
    whole = float(without.sum())
    proof = Prediction(
        rms_without_mm=held.rms_mm(),
        rms_with_mm=held.rms_mm(drift),
        blocks=BLOCKS,
        improved=int(np.sum(gain > 0.0)),
        gain=float(gain.sum()) / whole,
        gain_std=standard_error(gain) / whole,
    )
    return SlowDrift(drift, proof, tuple(others))


def _effects_of_time(survey: Survey, there: Sequence[Effect]) -> list[Effect]:
    """Return named effects of time that are not in the model, and can be computed."""
    held = {effect.id for effect in there}
    return [
        effect
        for effect in sought(survey.context, survey.baseline.model.terms)
        if effect.goes_with_time
        and not effect.generic
        and effect.id not in held
        and why_unknown(effect, survey.poses.states, logged=survey.torques_logged, weights=True)
        is None
    ]


class _Held:
    """Every tenth pose predicted from the others, about a model whose maps stay."""

    def __init__(self, survey: Survey, found: Refit, weights: PoseWeights) -> None:
        self._survey, self._at = survey, found.at
        self._whiteners = weights.whiteners(np.arange(len(survey.poses)))
        self._block = np.arange(len(survey.poses)) % BLOCKS
        at, poses = found.at, survey.poses
        self._left = -survey.left_by(at)
        terms = [term for term in at.model.terms if not isinstance(term, JointErrorMap | BaseDrift)]
        points = [at.x[at.model.columns_of(term)] for term in terms]
        sizes = possible_sizes(at.model)
        self._own = np.concatenate(
            [
                columns * sizes[at.model.columns_of(term)]
                for term, columns in zip(terms, by_terms(at, poses, terms, points), strict=True)
            ],
            axis=2,
        )

    def squares(self, effect: Effect | None = None) -> Array:
        """Return the sum of squares of every block, predicted with an effect or without, (B,)."""
        white = (self._whiteners @ self._predicted(effect)[:, :, None])[:, :, 0]
        return np.bincount(self._block, np.sum(white**2, axis=1), BLOCKS).astype(np.float64)

    def rms_mm(self, effect: Effect | None = None) -> float:
        """Return the root mean square of the position error of held-out poses."""
        errors_mm = error_mm(self._survey.poses.measured, self._predicted(effect))
        return float(np.sqrt(np.mean(errors_mm**2)))

    def _predicted(self, effect: Effect | None) -> Array:
        """Return what is left of each pose, its block held out, (P, b)."""
        columns = self._own
        if effect is not None:
            (own,) = by_terms(self._at, self._survey.poses, [effect], [effect.starts[0]])
            columns = np.concatenate([columns, own @ effect.prior_factor], axis=2)
        white = self._whiteners @ columns
        data = (self._whiteners @ self._left[:, :, None])[:, :, 0]
        left = self._left.copy()
        for b in range(BLOCKS):
            here = self._block == b
            rows = white[~here].reshape(-1, columns.shape[2])
            unit = np.eye(columns.shape[2])
            x = solve(rows.T @ rows, rows.T @ data[~here].ravel(), unit)
            left[here] -= columns[here] @ x
        return left
