"""Every tenth pose held out in turn: effects that the search's stretches of time hardly show.

What is tried here after the search is small, and depends on time or on the direction of arrival: a
slow drift of the base, and joints that all stop a little short. Maps of joint errors stay as they
were fitted: they depend on angles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pa10cal.arrays import Array
from pa10cal.discovery import linear
from pa10cal.discovery.blocked_cv.effect_set import as_good, surely_helps, surely_worse
from pa10cal.discovery.blocked_cv.judge import BlockPrediction, Judged, prediction
from pa10cal.discovery.blocked_cv.refit import Refit
from pa10cal.discovery.blocked_cv.survey import Survey, interleaved_blocks
from pa10cal.discovery.preparation import computable, sought
from pa10cal.discovery.rules import BLOCKS
from pa10cal.observe.order import like_a_scan
from pa10cal.results.record import EffectName
from pa10cal.terms.effects.arrivals import ArrivalError
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint import Backlash
from pa10cal.terms.effects.joint_error_map import JointErrorMap
from pa10cal.terms.effects.over_time import BaseDrift
from pa10cal.terms.effects.unnamed import DirectionMap


@dataclass(frozen=True, eq=False)
class HeldOutSquares:
    """Squared whitened errors of held-out poses."""

    by_kind: Array  # (2, B) sums of every block, of position rows and of all others
    rms_mm: float  # root mean square of the position error

    @property
    def total(self) -> Array:
        """Return the sum of squares of every block, (B,)."""
        return np.asarray(self.by_kind.sum(axis=0))


class HoldoutCheck:
    """Interleaved blocks predicted from the others, about a model whose maps stay."""

    def __init__(self, survey: Survey, found: Refit, least_gain: float) -> None:
        """Take a survey, its fitted model, and the least gain in squares of anything that helps."""
        self._survey, self._at, self._least_gain = survey, found.at, least_gain
        self._block = interleaved_blocks(len(survey.poses))
        self._whiten, self._data = found.weights.whiteners(), -survey.net_residual(found.at)
        terms = found.model.terms
        own = [term for term in terms if not isinstance(term, JointErrorMap | BaseDrift)]
        self._own = linear.by_own_terms(found.at, survey.poses, own, self._whiten)

    def squares(self, effects: Sequence[Effect] = (), *, lag: bool = True) -> HeldOutSquares:
        """Return the squares of held-out poses with effects added to the model.

        Args:
            effects: what is added to the model, each at its first start.
            lag: whether orientations may lag behind the motion, if the survey has such a lag.
        """
        data, poses, of_lag = self._data, self._survey.poses, self._survey.lag
        starts = [effect.starts[0] for effect in effects]
        added = linear.by_effects(self._at, poses, effects, starts, self._whiten)
        if of_lag is not None and lag:
            added.append(self._whiten @ of_lag.columns(self._at, poses))
        elif of_lag is not None and of_lag.amounts is not None:
            data = data + of_lag.shift(self._survey.baseline, poses)
        columns = np.concatenate([*self._own, *added], axis=2).reshape(data.size, -1)
        white_data = (self._whiten @ data[:, :, None]).ravel()
        block_of_row = np.repeat(self._block, data.shape[1])
        white = linear.left_out(white_data, columns, block_of_row).reshape(data.shape)
        measured = poses.measured
        of_positions = np.isin(np.arange(data.shape[1]), measured.position_columns)
        by_kind = [
            np.bincount(self._block, (white[:, kind] ** 2).sum(axis=1), BLOCKS.blocks)
            for kind in (of_positions, ~of_positions)
        ]
        error_m = np.asarray(np.linalg.solve(self._whiten, white[:, :, None]), np.float64)[:, :, 0]
        return HeldOutSquares(np.stack(by_kind), linear.rms(linear.error_mm(measured, error_m)))

    def helps(self, before: HeldOutSquares, after: HeldOutSquares) -> bool:
        """Return whether held-out poses are predicted enough better, as the search requires.

        By a part of the squared position errors. The noise is not subtracted from these, since the
        weights come from the scatter of the residuals.
        """
        least = BLOCKS.least_share * float(after.by_kind[0].sum())
        return surely_helps(before.total - after.total, self._least_gain, least)

    def matters(self, before: HeldOutSquares, after: HeldOutSquares) -> bool:
        """Return whether held-out poses are predicted better by more than chance makes of it."""
        return surely_helps(before.total - after.total, self._least_gain)


def proof_of(before: HeldOutSquares, after: HeldOutSquares) -> BlockPrediction:
    """Return how well held-out poses are predicted without something and with it."""
    gain = before.total - after.total
    return prediction(gain, float(before.total.sum()), (before.rms_mm, after.rms_mm))


def slow_drift(survey: Survey, check: HoldoutCheck, found: Sequence[Effect]) -> tuple[Judged, ...]:
    """Return a slow and smooth drift of the base, if it helps in addition to the effects found.

    The drift at a pose follows from poses before and after it. Stretches of time that are held out
    show little more of it than a constant rate.
    """
    poses = survey.poses
    time_s = poses.states.time_s
    timed = len(np.unique(time_s)) > BLOCKS.own_times_share * len(poses)
    if survey.wander is not None or poses.states.campaign is not None or not timed:
        return ()
    if like_a_scan(poses) or not poses.states.tells_time:
        return ()
    drift = BaseDrift("base", float(time_s.min()), float(time_s.max()), BLOCKS.drift_waves)
    without, with_drift = check.squares(), check.squares([drift])
    if not check.helps(without, with_drift):
        return ()
    in_model = {effect.id for effect in found}
    of_time = (
        each
        for each in sought(survey.context, survey.baseline.model.terms)
        if each.goes_with_time and not each.generic and each.id not in in_model
    )
    logged = survey.torques_logged
    known, _ = computable(of_time, poses.states, logged=logged, weights=True)
    others = tuple(each for each in known if as_good(check.squares([each]).total, with_drift.total))
    return (Judged(drift, proof_of(without, with_drift), others),)


def arrivals(survey: Survey, check: HoldoutCheck, found: Sequence[Effect]) -> tuple[Judged, ...]:
    """Return the arrival errors that help together, in addition to the effects found.

    The search requires of an effect a part of the remaining error, lest a small one is named in the
    place of another that is missing. A controller drives all joints, and nothing else depends on
    the direction of arrival: here all of them together have to gain that part, and each has to
    matter.
    """
    taken = {effect.of for effect in found if by_arrival(effect)}
    chosen = [each for each in ArrivalError.everywhere(survey.context) if each.of not in taken]
    if not chosen:
        return ()
    nothing, every = check.squares(), check.squares(chosen)
    without = {each: _without(check, chosen, each) for each in chosen}
    while idle := [each for each in chosen if not _is_needed(check, without[each], every)]:
        chosen.remove(min(idle, key=lambda each: float((without[each].total - every.total).sum())))
        every = check.squares(chosen)
        without = {each: _without(check, chosen, each) for each in chosen}
    if not chosen or not check.helps(nothing, every):
        return ()
    return tuple(
        Judged(each, proof_of(without[each], every), _lost_motion(check, chosen, each, every))
        for each in chosen
    )


def by_arrival(effect: Effect | EffectName) -> bool:
    """Return whether an effect depends on the direction of a joint's arrival."""
    return effect.id in (ArrivalError.id, Backlash.id, DirectionMap.id)


def _is_needed(check: HoldoutCheck, without: HeldOutSquares, every: HeldOutSquares) -> bool:
    """Return whether an effect matters among others, and neither kind of rows loses much by it."""
    gains = without.by_kind - every.by_kind
    most_lost = -BLOCKS.most_lost_share * float(gains.sum())
    contradict = any(surely_worse(gain) and float(gain.sum()) < most_lost for gain in gains)
    return check.matters(without, every) and not contradict


def _without(check: HoldoutCheck, chosen: Sequence[Effect], removed: Effect) -> HeldOutSquares:
    return check.squares([each for each in chosen if each is not removed])


def _lost_motion(
    check: HoldoutCheck, chosen: Sequence[ArrivalError], one: ArrivalError, every: HeldOutSquares
) -> tuple[Effect, ...]:
    """Return lost motion of the same joint, if it predicts held-out poses as well."""
    backlash = Backlash(one.of)
    instead = check.squares([backlash if each is one else each for each in chosen])
    return (backlash,) if as_good(instead.total, every.total) else ()
