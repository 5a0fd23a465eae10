"""Every tenth pose predicted from the others: for what the search's stretches of time hardly see.

What is tried after the search is small, and goes with time or with the way that a joint came. Maps
keep the errors found of them: they go with angles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pa10cal.arrays import Array
from pa10cal.discovery.blocked_cv.family import standard_error
from pa10cal.discovery.blocked_cv.judge import Judged, Prediction, prediction
from pa10cal.discovery.blocked_cv.refit import Refit
from pa10cal.discovery.blocked_cv.search import LEAST_SHARE, STANDARD_ERRORS
from pa10cal.discovery.blocked_cv.selection import solve
from pa10cal.discovery.blocked_cv.survey import BLOCKS, Survey
from pa10cal.discovery.in_time.channel import like_a_scan
from pa10cal.discovery.linear import by_terms, error_mm, possible_sizes
from pa10cal.discovery.preparation import computable, sought
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.in_time import BaseDrift
from pa10cal.terms.effects.joint_error_map import JointErrorMap


@dataclass(frozen=True, eq=False)
class Squares:
    """Squared errors of held-out poses, weighed."""

    total: Array  # (B,) of every block
    positions: Array  # (B,) the part of positions in it
    rms_mm: float  # root mean square of the position error

    @property
    def kinds(self) -> tuple[Array, Array]:
        """Return the squares of positions, and of all else."""
        return self.positions, self.total - self.positions


class HeldPoses:
    """Every tenth pose held out in turn, about a model whose maps stay."""

    def __init__(self, survey: Survey, found: Refit, least_gain: float) -> None:
        """Take what is predicted.

        Args:
            survey: the campaign.
            found: the model with the effects found, and what poses count in it.
            least_gain: sum of squares by which anything must help at least.
        """
        self._least_gain = least_gain
        self._survey, self._at = survey, found.at
        self._whiteners = found.weights.whiteners(np.arange(len(survey.poses)))
        self._block = np.arange(len(survey.poses)) % BLOCKS
        at, poses = found.at, survey.poses
        self._left = -survey.left_by(at)
        own = [term for term in at.model.terms if not isinstance(term, JointErrorMap | BaseDrift)]
        points = [at.x[at.model.columns_of(term)] for term in own]
        sizes = possible_sizes(at.model)
        self._own = np.concatenate(
            [
                columns * sizes[at.model.columns_of(term)]
                for term, columns in zip(own, by_terms(at, poses, own, points), strict=True)
            ],
            axis=2,
        )

    def squares(self, effects: Sequence[Effect] = (), *, lag: bool = True) -> Squares:
        """Return what is left of held-out poses with effects beside the model.

        Args:
            effects: the effects.
            lag: whether attitudes may lag behind the motion, where the survey has them so.
        """
        left = self._predicted(effects, lag)
        white = (self._whiteners @ left[:, :, None])[:, :, 0] ** 2
        measured = self._survey.poses.measured

        def summed(columns: Array) -> Array:
            return np.bincount(self._block, columns.sum(axis=1), BLOCKS).astype(np.float64)

        return Squares(
            total=summed(white),
            positions=summed(white[:, measured.position_columns]),
            rms_mm=float(np.sqrt(np.mean(error_mm(measured, left) ** 2))),
        )

    def helps(self, before: Squares, after: Squares) -> bool:
        """Return whether held-out poses come out enough better, as the search asks of an effect.

        A part of what is left of positions: in weights of the scatter all of that counts as more
        than noise.
        """
        gain = float((before.total - after.total).sum())
        return gain > LEAST_SHARE * float(after.positions.sum()) and self.matters(before, after)

    def matters(self, before: Squares, after: Squares) -> bool:
        """Return whether they come out better by more than chance makes of it."""
        gain = before.total - after.total
        return float(gain.sum()) > max(self._least_gain, STANDARD_ERRORS * standard_error(gain))

    def _predicted(self, effects: Sequence[Effect], lag: bool) -> Array:
        """Return what is left of each pose, its block held out, (P, b)."""
        own, left = [self._own], self._left.copy()
        if self._survey.lag is not None:
            poses, of_lag = self._survey.poses, self._survey.lag
            if lag:
                own.append(of_lag.columns(self._at, poses))
            elif of_lag.amounts is not None:
                left += of_lag.shift(self._survey.baseline, poses)
        starts = [effect.starts[0] for effect in effects]
        found = by_terms(self._at, self._survey.poses, effects, starts)
        added = [own @ each.prior_factor for own, each in zip(found, effects, strict=True)]
        columns = np.concatenate([*own, *added], axis=2)
        white = self._whiteners @ columns
        data = self._whiteners @ left[:, :, None]
        blocks = [self._block == b for b in range(BLOCKS)]
        rows = [(white[here].reshape(-1, white.shape[2]), data[here].ravel()) for here in blocks]
        grams = [columns.T @ columns for columns, _ in rows]
        projections = [columns.T @ values for columns, values in rows]
        unit = np.eye(columns.shape[2])
        for here, gram, projection in zip(blocks, grams, projections, strict=True):
            x = solve(sum(grams) - gram, sum(projections) - projection, unit)
            left[here] -= columns[here] @ x
        return left


def proof_of(before: Squares, after: Squares) -> Prediction:
    """Return how well held-out poses are predicted without something and with it."""
    gain = before.total - after.total
    return prediction(gain, float(before.total.sum()), (before.rms_mm, after.rms_mm))


# A base that moved slowly and smoothly while a campaign lasted: too little to be a wander.
#
# A drift is known between poses, and not past a stretch of time, so every tenth pose is held out
# in turn. The search's blocks are stretches of time, which see hardly more of it than a constant
# rate.

#: Cosines along each axis: a drift that turns back more often is a wander.
WAVES = 6
#: Part of the readings that must have a time of their own.
_OWN_TIMES = 0.95


def slow_drift(survey: Survey, held: HeldPoses, there: Sequence[Effect]) -> tuple[Judged, ...]:
    """Return a slow drift beside the effects found, where it helps.

    Args:
        survey: the campaign.
        held: its poses, predicted by the model found.
        there: the effects found.
    """
    poses = survey.poses
    time_s = poses.states.time_s
    known = len(np.unique(time_s)) > _OWN_TIMES * len(poses)
    if survey.wander is not None or poses.states.campaign is not None or not known:
        return ()
    if like_a_scan(poses) or not poses.states.tells_time:
        return ()
    drift = BaseDrift("base", float(time_s.min()), float(time_s.max()), WAVES)
    without, with_drift = held.squares(), held.squares([drift])
    if not held.helps(without, with_drift):
        return ()
    others = []
    for effect in _effects_of_time(survey, there):
        lost = held.squares([effect]).total - with_drift.total
        if lost.sum() <= standard_error(lost):
            others.append(effect)
    return (Judged(drift, proof_of(without, with_drift), tuple(others)),)


def _effects_of_time(survey: Survey, there: Sequence[Effect]) -> list[Effect]:
    """Return named effects of time that are not in the model, and can be computed."""
    held = {effect.id for effect in there}
    of_time = (
        each
        for each in sought(survey.context, survey.baseline.model.terms)
        if each.goes_with_time and not each.generic and each.id not in held
    )
    logged = survey.torques_logged
    return computable(of_time, survey.poses.states, logged=logged, weights=True)[0]
