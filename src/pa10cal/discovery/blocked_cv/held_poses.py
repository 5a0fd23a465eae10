"""Every tenth pose predicted from the others: for what the search's stretches of time hardly see.

What is tried after the search is small, and goes with time or with the way that a joint came. Maps
keep the errors found of them: they go with angles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pa10cal.arrays import Array
from pa10cal.discovery.blocked_cv.candidate import standard_error
from pa10cal.discovery.blocked_cv.judge import Prediction
from pa10cal.discovery.blocked_cv.refit import Refit
from pa10cal.discovery.blocked_cv.search import LEAST_SHARE, STANDARD_ERRORS
from pa10cal.discovery.blocked_cv.selection import solve
from pa10cal.discovery.blocked_cv.survey import BLOCKS, Survey
from pa10cal.discovery.linear import by_terms, error_mm, possible_sizes
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.in_time import BaseDrift
from pa10cal.terms.effects.joint_error_map import JointErrorMap


@dataclass(frozen=True)
class FoundAfter:
    """An effect that was found after the search."""

    effect: Effect
    proof: Prediction  # how well it predicts every tenth pose
    alternatives: tuple[Effect, ...]  # effects that predict these as well in its place


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
    gain, whole = before.total - after.total, float(before.total.sum())
    return Prediction(
        rms_without_mm=before.rms_mm,
        rms_with_mm=after.rms_mm,
        blocks=BLOCKS,
        improved=int(np.sum(gain > 0.0)),
        gain=float(gain.sum()) / whole,
        gain_std=standard_error(gain) / whole,
    )
