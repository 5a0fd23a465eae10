"""Small effects of time and of arrival, tried after the search with every tenth pose left out.

Ten folds, each of every tenth pose, are predicted in turn from the other nine. The search leaves
out stretches of time, which hardly show a slow drift of the base, or joints that all stop a little
short.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from pa10cal.arrays import Array, rms
from pa10cal.discovery import jacobians
from pa10cal.discovery.blocked_cv.effect_set import as_good, surely_helps, surely_worse
from pa10cal.discovery.blocked_cv.judge import BlockPrediction, Judged, prediction
from pa10cal.discovery.blocked_cv.normal_equations import summed
from pa10cal.discovery.blocked_cv.refit import Refit
from pa10cal.discovery.blocked_cv.survey import Survey, interleaved_blocks
from pa10cal.discovery.preparation import computable, sought
from pa10cal.discovery.rules import BLOCKS, EVIDENCE, PROBABILITIES
from pa10cal.fit.position_errors import position_error_mm
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.time_order import like_a_scan
from pa10cal.results.record import EffectName
from pa10cal.terms.effects.arrivals import ArrivalError
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.generic import DirectionMap
from pa10cal.terms.effects.joint import Backlash
from pa10cal.terms.effects.joint_error_map import is_error_map
from pa10cal.terms.effects.over_time import BaseDrift


@dataclass(frozen=True, eq=False)
class SquaresByBlock:
    """Squared whitened errors of poses, each block predicted from the others."""

    by_kind: Array  # (2, B) sums of every block, of position rows and of all others
    rms_mm: float  # root mean square of the position error

    @property
    def total(self) -> Array:
        """Return the sum of squares of every block, (B,)."""
        return np.asarray(self.by_kind.sum(axis=0))


@dataclass(frozen=True, eq=False)
class _Fold:
    """The R whitened rows of one fold of poses."""

    model: Array  # (R, k) columns of the model, and of a lag
    added: Array  # (R, m + 1) columns of effects that are added, then the data
    gram: Array  # (k, k) products of the columns of the model

    @cached_property
    def equations(self) -> Gaussian:
        """Return the normal equations in the columns of the model, then of the effects."""
        across = self.model.T @ self.added
        return Gaussian(np.block([[self.gram, across], [across.T, self.added.T @ self.added]]))

    def residual(self, x: Array) -> Array:
        """Return the residual (R,) at amounts (k + m,) of model and effects."""
        of_model, of_added = np.split(x, [self.model.shape[1]])
        return self.added[:, -1] - self.model @ of_model - self.added[:, :-1] @ of_added


class InterleavedCheck:
    """Ten interleaved folds of poses, each predicted from the others, about a fitted model.

    The model's own parameters are fitted again in each fold, linearly. What keeps the values fitted
    to all poses is known too well, so that what is added gains rather too little: maps of joint
    errors, which depend on angles; a constant drift, which a slow drift would replace; a base that
    wandered or changed.
    """

    def __init__(self, survey: Survey, fit: Refit, least_gain: float) -> None:
        """Take a survey, its fitted model, and the least gain in squares of anything that helps."""
        self._survey, self._operating_point, self._least_gain = survey, fit.at, least_gain
        self._fold = interleaved_blocks(len(survey.poses))
        self._whiteners = fit.weights.whiteners()
        self._measured_minus_predicted = -survey.net_residual(fit.at)
        #: Columns (R, k) of effects that were tried, in each fold.
        self._columns_of: dict[Effect, list[Array]] = {}

    def squares(self, effects: Sequence[Effect] = (), *, lag: bool = True) -> SquaresByBlock:
        """Return the squares of left-out poses with effects added to the model.

        Args:
            effects: what is added to the model, each at its first start.
            lag: whether orientations may lag behind the motion, if the survey has such a lag.
        """
        white, measured = self._left_out_residuals(effects, lag=lag), self._survey.poses.measured
        of_positions = np.isin(np.arange(white.shape[1]), measured.position_columns)
        by_kind = [
            np.bincount(self._fold, (white[:, columns] ** 2).sum(axis=1), BLOCKS.blocks)
            for columns in (of_positions, ~of_positions)
        ]
        solved = np.linalg.solve(self._whiteners, white[:, :, None])
        unwhitened = np.asarray(solved, np.float64)[:, :, 0]
        return SquaresByBlock(np.stack(by_kind), rms(position_error_mm(measured, unwhitened)))

    def amounts(self, effect: Effect, beside: Sequence[Effect] = ()) -> Array:
        """Return the amounts of an effect that is added to the model, in plausible sizes, (k,)."""
        folds = self._folds([*beside, effect], lag=True)
        return summed([fold.equations for fold in folds]).mean[-effect.linear :]

    def nats(self, chosen: SquaresByBlock, instead: SquaresByBlock) -> Array:
        """Return the log score of something in the place of what was chosen, of every block."""
        rows = int(self._survey.poses.measured.components_seen.sum())
        variance = float(chosen.total.sum()) / rows
        return 0.5 * (chosen.total - instead.total) / variance / PROBABILITIES.blocks

    def _left_out_residuals(self, effects: Sequence[Effect], *, lag: bool) -> Array:
        """Return the whitened residuals (P, b) of poses that are left out of the fit."""
        folds = self._folds(effects, lag=lag)
        total = summed([fold.equations for fold in folds])
        residual = np.empty_like(self._measured_minus_predicted)
        for number, fold in enumerate(folds):
            left_out = fold.residual((total - fold.equations).mean)
            residual[self._fold == number] = left_out.reshape(-1, residual.shape[1])
        return residual

    def _folds(self, effects: Sequence[Effect], *, lag: bool) -> list[_Fold]:
        """Return the rows of each fold, with effects added, and with a lag if the survey has one.

        A lag is fitted again in each fold; without one, what the survey subtracted is put back.
        """
        data, of_lag = self._measured_minus_predicted, self._survey.lag
        count = self._model_columns[0].shape[1]
        if of_lag is not None and not lag:
            count -= len(of_lag.sizes)
            if of_lag.amounts is not None:
                data = data + of_lag.shift(self._survey.baseline, self._survey.poses)
        parts = [*map(self._columns, effects), self._by_fold(self._whiteners @ data[:, :, None])]
        of_folds = zip(self._model_columns, self._model_gram, *parts, strict=True)
        return [
            _Fold(model[:, :count], np.concatenate(added, axis=1), gram[:count, :count])
            for model, gram, *added in of_folds
        ]

    @cached_property
    def _model_columns(self) -> list[Array]:
        """Return the columns (R, k) of the model's own parameters, then of a lag, in each fold."""
        at, terms = self._operating_point, self._operating_point.model.terms
        own = [each for each in terms if not (is_error_map(each) or each.id == BaseDrift.id)]
        poses, of_lag = self._survey.poses, self._survey.lag
        columns = jacobians.by_scaled_terms(at, poses, own, self._whiteners)
        if of_lag is not None:
            columns.append(self._whiteners @ of_lag.columns(at, poses))
        return self._by_fold(np.concatenate(columns, axis=2))

    @cached_property
    def _model_gram(self) -> list[Array]:
        """Return the products of these columns in each fold, (k, k)."""
        return [columns.T @ columns for columns in self._model_columns]

    def _columns(self, effect: Effect) -> list[Array]:
        """Return the columns (R, k) of an effect at its first start, in each fold."""
        if effect not in self._columns_of:
            at, poses = self._operating_point, self._survey.poses
            starts = [effect.starts[0]]
            found = jacobians.by_scaled_effects(at, poses, [effect], starts, self._whiteners)
            self._columns_of[effect] = self._by_fold(found[0])
        return self._columns_of[effect]

    def _by_fold(self, columns: Array) -> list[Array]:
        """Return columns (P, b, k) as the rows (R, k) of each fold."""
        folds = range(BLOCKS.blocks)
        return [columns[self._fold == k].reshape(-1, columns.shape[2]) for k in folds]

    def gains_a_share(self, before: SquaresByBlock, after: SquaresByBlock) -> bool:
        """Return whether left-out poses are predicted enough better, as the search requires.

        By a share of the squared position errors. The noise is not subtracted from these, since the
        weights come from the scatter of the residuals.
        """
        least = BLOCKS.least_share * float(after.by_kind[0].sum())
        return surely_helps(before.total - after.total, self._least_gain, least)

    def gains_significantly(self, before: SquaresByBlock, after: SquaresByBlock) -> bool:
        """Return whether left-out poses are predicted better by more than chance, if by little."""
        return surely_helps(before.total - after.total, self._least_gain)


def proof_of(before: SquaresByBlock, after: SquaresByBlock) -> BlockPrediction:
    """Return how well left-out poses are predicted without something and with it."""
    gain = before.total - after.total
    return prediction(gain, float(before.total.sum()), (before.rms_mm, after.rms_mm))


def slow_drift(
    survey: Survey, check: InterleavedCheck, found: Sequence[Effect]
) -> tuple[Judged, ...]:
    """Return a slow and smooth drift of the base, if it helps in addition to the effects found.

    The drift at a pose follows from poses before and after it. Stretches of time that are left out
    show little more of it than a constant rate.
    """
    if not _may_show_drift(survey):
        return ()
    drift = _drift_with_waves(survey)
    without, with_drift = check.squares(), check.squares([drift])
    if not check.gains_a_share(without, with_drift):
        return ()
    others = tuple(
        each
        for each in _rivals_in_time(survey, found)
        if as_good(check.squares([each]).total, with_drift.total)
    )
    return (Judged(drift, proof_of(without, with_drift), others),)


def steady_courses(
    survey: Survey, check: InterleavedCheck, found: Sequence[Effect], *, moves: bool
) -> tuple[Effect, ...]:
    """Return effects in proportion to time or temperature that predict no worse than a slow drift.

    The best first, each helping beyond the effects found; none where growth or warming up was. A
    stretch of time that is left out may be the one in which the temperature rose: poses outside it
    do not tell how much the arm grew. A steady drift that was found need not help again where
    readings show another motion (`moves`), which takes it up. Else it stands as it was found: left
    out stretches of time tell it from smooth functions of time, which interleaved blocks do not.
    """
    of_time = [each for each in found if each.depends_on and each.id != BaseDrift.id]
    if not _may_show_drift(survey) or of_time:
        return ()
    without, with_drift = check.squares(), check.squares([_drift_with_waves(survey)])
    growth = [each for each in _rivals_in_time(survey, found) if each.varies_with == "temperature"]
    time_s = survey.poses.states.time_s
    # A drift may be far larger than waves are expected to be.
    drifts = [BaseDrift.over(time_s, size) for size in EVIDENCE.sizes[EVIDENCE.usual_size :]]
    squares = {each: check.squares([each]) for each in (*drifts, *growth)}

    def left(effect: Effect) -> float:
        return float(squares[effect].total.sum())

    drift = min(drifts, key=left)
    was_found = any(each.id == BaseDrift.id for each in found)
    most = float(with_drift.total.sum())
    return tuple(
        each
        for each in sorted((drift, *growth), key=left)
        if left(each) <= most
        and ((moves and was_found and each is drift) or check.gains_a_share(without, squares[each]))
    )


def _drift_with_waves(survey: Survey) -> BaseDrift:
    """Return a drift of the base with waves of time, over the poses of a survey."""
    time_s = survey.poses.states.time_s
    return BaseDrift("base", float(time_s.min()), float(time_s.max()), BLOCKS.drift_waves)


def _may_show_drift(survey: Survey) -> bool:
    """Return whether the poses of a survey can show a slow drift."""
    poses = survey.poses
    if survey.wander is not None:  # it follows a drift already
        return False
    if poses.states.campaign is not None:  # each campaign of a group has a base of its own
        return False
    times = len(np.unique(poses.states.time_s))
    if times <= BLOCKS.own_times_share * len(poses) or not poses.states.tells_time:
        return False
    # In the order of a scan, an error that depends on joint positions looks like a drift.
    return not like_a_scan(poses)


def _rivals_in_time(survey: Survey, found: Sequence[Effect]) -> tuple[Effect, ...]:
    """Return the effects of time that may be there in the place of a slow drift of the base.

    A constant drift is none: it has the same name.
    """
    names = {BaseDrift.id, *(effect.id for effect in found)}
    of_time = (
        each
        for each in sought(survey.context, survey.baseline.model.terms)
        if each.depends_on and not each.generic and each.id not in names
    )
    states, logged = survey.poses.states, survey.torques_logged
    known, _ = computable(of_time, states, logged=logged, weights=True)
    return tuple(known)


def arrivals(
    survey: Survey, check: InterleavedCheck, found: Sequence[Effect]
) -> tuple[Judged, ...]:
    """Return the arrival errors that help together, in addition to the effects found.

    The search requires of an effect a part of the remaining error, lest a small one is named in the
    place of another that is missing. A controller drives all joints, and nothing else depends on
    the direction of arrival: here all of them together have to gain that part, and each has to gain
    significantly.
    """
    taken = {effect.of for effect in found if by_arrival(effect)}
    every = [each for each in ArrivalError.everywhere(survey.context) if each.of not in taken]
    if not every:
        return ()
    needed = _backward_elimination(check, every)
    if not needed.effects or not check.gains_a_share(check.squares(), needed.squares):
        return ()
    return tuple(
        Judged(
            each,
            proof_of(needed.without[each], needed.squares),
            _lost_motion(check, needed, each),
        )
        for each in needed.effects
    )


def by_arrival(effect: Effect | EffectName) -> bool:
    """Return whether an effect depends on the direction of a joint's arrival."""
    return effect.id in (ArrivalError.id, Backlash.id, DirectionMap.id)


class _Together(NamedTuple):
    """Arrival errors that are in the model together."""

    effects: Sequence[ArrivalError]
    squares: SquaresByBlock  # with all of them
    without: Mapping[ArrivalError, SquaresByBlock]  # with all but each

    @classmethod
    def of(cls, check: InterleavedCheck, effects: Sequence[ArrivalError]) -> _Together:
        without = {
            removed: check.squares([each for each in effects if each is not removed])
            for removed in effects
        }
        return cls(effects, check.squares(effects), without)


def _backward_elimination(check: InterleavedCheck, effects: Sequence[ArrivalError]) -> _Together:
    """Remove the effect whose removal costs least, until each is needed."""
    together = _Together.of(check, effects)
    while idle := [each for each in together.effects if not _is_needed(check, together, each)]:
        loss = {
            each: float((together.without[each].total - together.squares.total).sum())
            for each in idle
        }
        removed = min(idle, key=loss.__getitem__)
        together = _Together.of(check, [each for each in together.effects if each is not removed])
    return together


def _is_needed(check: InterleavedCheck, together: _Together, effect: ArrivalError) -> bool:
    """Return whether an effect gains among others, and neither kind of rows loses much by it."""
    without = together.without[effect]
    gains = without.by_kind - together.squares.by_kind
    allowed_loss = BLOCKS.most_lost_share * float(gains.sum())
    contradict = any(surely_worse(gain) and float(gain.sum()) < -allowed_loss for gain in gains)
    return check.gains_significantly(without, together.squares) and not contradict


def _lost_motion(
    check: InterleavedCheck, together: _Together, replaced: ArrivalError
) -> tuple[Effect, ...]:
    """Return lost motion of the same joint, if it predicts left-out poses as well."""
    backlash = Backlash(replaced.of)
    instead = [backlash if each is replaced else each for each in together.effects]
    is_as_good = as_good(check.squares(instead).total, together.squares.total)
    return (backlash,) if is_as_good else ()
