"""Motion of the instrument or the base in the course of time, found by log evidence.

Readings of one pose at different times differ by noise and by motion between them, however
incomplete the model of the arm is. All single readings form one linear Gaussian model. The
parameters of the model and of every effect of the vocabulary, and an error that the readings of a
pose share, are integrated out; the time of a jump is scanned.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from copy import copy
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index, Mask, rms
from pa10cal.discovery import jacobians
from pa10cal.discovery.nuisances import (
    NO_MOTION,
    Jump,
    TimeFindings,
    Wander,
    motions_along,
    sizes_of_motions,
)
from pa10cal.discovery.preparation import why_unknown
from pa10cal.discovery.repeats import same_circumstances
from pa10cal.discovery.rules import CANDIDATES, MOTION, NOISE
from pa10cal.discovery.target_wander import rows_in_time, target_wander
from pa10cal.discovery.tuning import none_and_spaced
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.fit.position_errors import position_error_mm, position_noise_m2
from pa10cal.numerics.gaussian import Gaussian, Gaussians
from pa10cal.observe.observations import Observations
from pa10cal.observe.time_order import (
    Threshold,
    covariates,
    like_a_scan,
    measured_again,
    slow_joints,
    spread_over_time,
    step_thresholds,
    with_place_labels,
)
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.effects.joint_error_map import is_error_map
from pa10cal.terms.effects.over_time import ThermalGrowth

#: Expected root mean squares of the walk that are tried [m].
_WALKS_M = np.geomspace(*MOTION.walks_m)
#: Variances tried of the error that readings of a pose share, in units of that of a reading.
_SHARED = tuple(none_and_spaced(*MOTION.pose_variances).tolist())


def _motion_in(rows: _TimedRows, *, walks: bool) -> TimeFindings:
    """Return the jumps of the base, its walk where one is sought, and whether it drifts."""
    poses, found = rows.poses, _likeliest(rows, walks=walks)
    static = rows.without_time()
    has_drift = rows.about(found).nats - static.about(found).nats > MOTION.drift_nats
    if not found.jumps and not found.walk_m:
        return TimeFindings(None, has_drift)
    # Where no effect of time is significant, everything that follows time is due to the motion.
    amounts = (rows if has_drift else static).about(found).courses.mean
    found = replace(found, amounts=amounts)
    walk = replace(found, jumps=(), amounts=amounts[6 * len(found.jumps) :])
    all_mm, walk_mm = (
        rms(position_error_mm(poses.measured, motion.shift(rows.at, poses)))
        for motion in (found, walk)
    )
    cov = np.asarray(np.linalg.inv(np.swapaxes(rows.whitener, 1, 2) @ rows.whitener))
    variance = np.trace(position_noise_m2(poses.measured, cov), axis1=1, axis2=2)
    noise_mm = 1e3 * float(np.sqrt(np.median(variance))) * rows.about(found).noise_scale
    if all_mm < MOTION.least_noise_ratio * noise_mm:
        return TimeFindings(None, has_drift)
    return TimeFindings(replace(found, rms_mm=(all_mm, walk_mm)), has_drift)


def _likeliest(rows: _TimedRows, *, walks: bool) -> Wander:
    """Return the jumps, and the walk where one is sought, that gain enough one after the other."""
    sizes = len(MOTION.jumps_m) * len(MOTION.turns_rad_per_m)
    needed_jump = float(np.log(len(rows.poses) * sizes / MOTION.false_rate))
    needed_walk = float(np.log(len(_WALKS_M) * len(MOTION.turns_rad_per_m) / MOTION.false_rate))
    found = rows.in_pauses(needed_jump)
    in_pauses = len(found.jumps)
    nats = rows.about(found).nats
    while not in_pauses and len(found.jumps) < MOTION.most_jumps:
        with_more_nats, with_more = rows.best_jump(found)
        beyond = with_more_nats - nats - needed_jump
        if walks and not found.walk_m:
            with_walk_nats, with_walk = rows.best_walk(found)
            walk_beyond = with_walk_nats - nats - needed_walk
            if walk_beyond >= beyond:
                with_more_nats, with_more, beyond = with_walk_nats, with_walk, walk_beyond
        if beyond <= 0.0:
            break
        nats, found = with_more_nats, with_more
    if walks:  # a walk may explain a jump that was found before it
        for jump in found.jumps[in_pauses:]:
            others = tuple(other for other in found.jumps if other != jump)
            without_nats, without = rows.best_walk(replace(found, jumps=others))
            if nats - without_nats < needed_jump - needed_walk:
                nats, found = without_nats, without
    return found


class _Likelihood(NamedTuple):
    """Likelihood of motions in time, at the best variance of the shared error."""

    nats: float  # log evidence
    courses: Gaussian  # normal equations of the motions of every course, in their expected sizes
    noise_scale: float  # standard deviation of whitened rows


class _TimedRows:
    """Whitened rows of single readings, and the log evidence of motions in time."""

    def __init__(
        self,
        at: FittedModel,
        poses: Observations,
        whitener: Array,
        own: Array,
        static: Array,
        of_time: Array,
    ) -> None:
        """Whiten P complete single readings about a model with small motions of the base.

        Args:
            own: (P, b, k) columns of the model's own parameters, scaled to their expected sizes.
            static: (P, b, k) columns of effects that do not depend on time.
            of_time: (P, b, k) columns of effects that do.
        """
        held = (own, static, of_time)
        self.at, self.poses, self.whitener = at, poses, whitener
        self.time_s = poses.states.time_s
        self.times_s = np.sort(self.time_s)
        self._white = whitener @ jacobians.by_base(at, poses)
        seen = poses.measured.components_seen
        self._seen = int(seen.sum())
        self._group = same_circumstances(poses)
        self._count = np.bincount(self._group)  # readings of each group
        self._shared = _SHARED if self._count.max() > 1 else (0.0,)
        self._components = self._seen / len(seen)
        self._held = whitener @ np.concatenate(held, axis=2)
        self._widths = [columns.shape[2] for columns in held]
        self._data = whitener @ -at.compared(poses).residual[:, :, None]
        walk = Wander(self.times_s, (), walk_m=1.0)
        self._walk = motions_along(self._white, walk.courses(self.time_s))
        self._products: dict[tuple[float, ...], list[Gaussian]] = {}
        self._free: dict[tuple[float, bool], list[float]] = {}
        # The expected size of effects, in units of the plausible one, is the likeliest one.
        self._effect_size, self._with_time = 1.0, True
        nats, still = [], Wander(self.times_s, ())
        for size in MOTION.effect_sizes:
            self._effect_size = size
            nats.append(max(self.about(still).nats, self.best_walk(still)[0]))
        self._effect_size = MOTION.effect_sizes[int(np.argmax(nats))]

    def best_walk(self, wander: Wander) -> tuple[float, Wander]:
        """Return the greatest log evidence with another walk, and that motion."""
        sizes = product(_WALKS_M.tolist(), MOTION.turns_rad_per_m)
        tried = [replace(wander, walk_m=size, walk_turn=turn) for size, turn in sizes]
        reduced = self._reduced(wander.jumps)
        nats = [self.about(walk, reduced).nats for walk in tried]
        return max(nats), tried[int(np.argmax(nats))]

    def best_jump(self, wander: Wander) -> tuple[float, Wander]:
        """Return the greatest log evidence with one more jump, and that motion.

        Times are scanned coarsely first, then all those near the best one.
        """
        times_s, least = self.times_s, MOTION.least_side
        gaps = np.flatnonzero(np.diff(times_s) > 0.0)  # the jump is after such a reading
        gaps = gaps[(gaps >= least - 1) & (gaps < len(times_s) - least)]
        known_s = {jump.time_s for jump in wander.jumps}
        best = (-np.inf, wander)
        if not len(gaps):
            return best
        places = np.unique(np.linspace(0, len(gaps) - 1, MOTION.coarse_times).round().astype(int))
        for _ in range(2):
            ends = [times_s[gaps[k] : gaps[k] + 2].tolist() for k in places]
            tried = [Jump(0.5 * (before + after), before, after) for before, after in ends]
            tried = [jump for jump in tried if jump.time_s not in known_s]
            if not tried:
                break
            best = self.best_of(tried, wander)
            middle = int(np.searchsorted(times_s[gaps], best[1].jumps[-1].time_s)) - 1
            width = -(-len(gaps) // MOTION.coarse_times)  # rounded up
            places = np.arange(max(middle - width, 0), min(middle + width + 1, len(gaps)))
        return best

    def in_pauses(self, needed: float) -> Wander:
        """Return jumps in long pauses, if these explain as much as all effects of time.

        Over a pause a steady change with time or temperature looks like a step. Each jump must gain
        the log evidence that is needed.
        """
        gaps_s = np.diff(self.times_s)
        long = gaps_s > max(MOTION.pause_ratio * float(np.median(gaps_s)), MOTION.pause_s)
        long[: MOTION.least_side - 1] = False
        long[len(gaps_s) + 1 - MOTION.least_side :] = False
        ends = zip(self.times_s[:-1][long].tolist(), self.times_s[1:][long].tolist(), strict=True)
        pauses = [Jump(0.5 * (first + last), first, last, pause=True) for first, last in ends]
        static, still = self.without_time(), Wander(self.times_s, ())
        if not pauses:
            return still
        found, nats = still, static.about(still).nats
        while pauses and len(found.jumps) < MOTION.most_jumps:
            with_more_nats, with_more = static.best_of(pauses, found)
            if with_more_nats < nats + needed:
                break
            nats, found = with_more_nats, with_more
            pauses = [pause for pause in pauses if pause.time_s != found.jumps[-1].time_s]
        return found if nats > self.about(still).nats - MOTION.as_good_nats else still

    def best_of(self, tried: list[Jump], wander: Wander) -> tuple[float, Wander]:
        """Return the greatest log evidence with one of some jumps more, and that motion."""
        nats, sizes = self._scan(tried, wander)
        k = int(np.argmax(nats))
        first = last = best = tried[k]
        if not best.pause:
            as_good = np.flatnonzero(nats >= nats[k] - MOTION.as_good_nats)
            first, last = tried[as_good[0]], tried[as_good[-1]]
        size_m, turn = sizes[k]
        more = Jump(best.time_s, first.before_s, last.after_s, size_m, turn, pause=best.pause)
        return float(nats[k]), replace(wander, jumps=(*wander.jumps, more))

    def without_time(self) -> _TimedRows:
        """Return the rows without effects of time."""
        found = copy(self)
        found._with_time = False
        return found

    def _scan(self, tried: list[Jump], wander: Wander) -> tuple[Array, list[tuple[float, float]]]:
        """Return the greatest log evidence with each jump, (J,), and the size and turn with it."""
        reduced = self._reduced((*wander.jumps, *tried), keep=False)
        free = self._free_components()
        at = self._places(wander, between=len(tried))
        tried_sizes = list(product(MOTION.jumps_m, MOTION.turns_rad_per_m))
        sizes_of_step = np.array([sizes_of_motions(*each) for each in tried_sizes])
        nats = np.empty((len(tried), len(reduced), len(tried_sizes)))
        for column, motions in enumerate(reduced):
            sizes = np.ones(motions.unknowns)
            sizes[at] = wander.sizes
            steps = motions.in_sizes(sizes).without(at)  # six motions of each jump tried
            each_step = Gaussians.of(
                steps.along(np.arange(6 * k, 6 * k + 6)) for k in range(len(tried))
            )
            sized = each_step.for_each(sizes_of_step)
            nats[:, column], _ = self._log_evidence(
                sized.residual_squares, sized.log_det + sized.log_precision, free[column]
            )
        of_jump = nats.reshape(len(tried), -1)
        best = of_jump.argmax(axis=1).tolist()
        return of_jump.max(axis=1), [tried_sizes[k % len(tried_sizes)] for k in best]

    def about(self, wander: Wander, reduced: list[Gaussian] | None = None) -> _Likelihood:
        """Return the evidence of a motion at the best variance of the shared error."""
        at = self._places(wander)
        best = _Likelihood(-np.inf, Gaussian.none(0), 1.0)
        reduced = reduced or self._reduced(wander.jumps)
        for motions, free in zip(reduced, self._free_components(), strict=True):
            courses = motions.along(at).in_sizes(wander.sizes)
            alone = courses.without(np.arange(courses.unknowns))
            nats, variance = self._log_evidence(
                np.array(alone.squares), np.array(alone.log_det), free
            )
            if nats > best.nats:
                best = _Likelihood(float(nats), courses, float(np.sqrt(variance)))
        return best

    def _log_evidence(self, squares: Array, log_det: Array, free: float) -> tuple[Array, Array]:
        """Return the log evidence at the likeliest variance of whitened rows, and the variance.

        Args:
            squares, log_det: (...) of models whose unknowns are all integrated out.
            free: components that the held columns leave.
        """
        variance = np.maximum(squares / free, MOTION.least_noise_share**2)
        logarithm = free * np.log(variance) + squares / variance
        return -0.5 * (logarithm + log_det), variance

    def _free_components(self) -> list[float]:
        """Return the components that held columns leave, for each variance of the shared error.

        What parameters and effects amount to does not depend on the noise: else less noise, with an
        error that readings share in its place, would make them smaller and so likelier.
        """
        key = self._effect_size, self._with_time
        if key not in self._free:
            products = self._products[()] = self._products.get(()) or self._multiplied(())
            held, sizes = np.arange(sum(self._widths)), self._held_sizes()
            taken = [of_all.along(held).in_sizes(sizes).determined for of_all in products]
            least = NOISE.least_left_share * self._seen
            self._free[key] = [max(self._seen - each, least) for each in taken]
        return self._free[key]

    def _held_sizes(self) -> Array:
        """Return the expected sizes of the held columns, (k,), of effects of time or zero."""
        return np.repeat([1.0, self._effect_size, float(self._with_time)], self._widths)

    def _places(self, wander: Wander, between: int = 0) -> Index:
        """Return the columns of jumps and walk where more jumps are tried between them."""
        of_jumps, first = np.arange(6 * len(wander.jumps)), 6 * (len(wander.jumps) + between)
        of_walk = np.arange(first, first + 6 * MOTION.walk_waves) if wander.walk_m else of_jumps[:0]
        return np.concatenate([of_jumps, of_walk])

    def _reduced(self, jumps: tuple[Jump, ...], *, keep: bool = True) -> list[Gaussian]:
        """Return normal equations of jumps and walk for each variance of the shared error.

        Everything else is integrated out. With `keep` the products of the rows are cached.
        """
        key = tuple(jump.time_s for jump in jumps)
        products = self._products.get(key) or self._multiplied(jumps)
        if keep:
            self._products[key] = products
        sizes, held = np.ones(products[0].unknowns), np.arange(sum(self._widths))
        sizes[held] = self._held_sizes()
        return [of_all.in_sizes(sizes).without(held) for of_all in products]

    def _multiplied(self, jumps: tuple[Jump, ...]) -> list[Gaussian]:
        """Return normal equations of all columns for each variance of the shared error."""
        steps = motions_along(self._white, Wander(self.times_s, jumps).courses(self.time_s))
        rows = np.concatenate([self._held, steps, self._walk, self._data], axis=2)
        flat = rows.reshape(-1, rows.shape[2])
        total = flat.T @ flat
        of_groups = self._multiplied_by_group(rows) if any(self._shared) else {}
        found = []
        for variance in self._shared:
            products, determinant = total, 0.0
            for m, of_group in of_groups.items() if variance else ():
                products = products - (1.0 - 1.0 / (1.0 + m * variance)) * of_group
                many = int(np.sum(self._count == m))
                determinant += self._components * many * float(np.log1p(m * variance))
            found.append(Gaussian(products, determinant))
        return found

    def _multiplied_by_group(self, rows: Array) -> dict[int, Array]:
        """Return the products of the sums of rows over groups of m readings, over m, by m.

        Last come poses read once. A shared error of variance v takes m v / (1 + m v) of them from
        the products of all rows.
        """
        sums = np.zeros((len(self._count), *rows.shape[1:]))
        np.add.at(sums, self._group, rows)
        of_groups: dict[int, Array] = {}
        for m in sorted(set(self._count.tolist()), key=lambda m: (m == 1, m)):
            own = sums[self._count == m] if m > 1 else rows[self._count[self._group] == 1]
            part = own.reshape(-1, rows.shape[2]) / np.sqrt(m)
            of_groups[m] = part.T @ part
        return of_groups


def in_time_of(
    at: FittedModel,
    poses: Observations,
    whitener: Array,
    effects: Iterable[Effect],
    *,
    logged: bool,
    weights: bool,
) -> TimeFindings:
    """Return how the base moves in time, beyond what candidate effects and loads explain.

    Nothing is found where times were not recorded, nor where poses are read once and in the order
    of a scan that returns to no place: time and place then cannot be distinguished. Motion found
    where a joint or the load passes from one side to the other, or where a joint moves slowly, is
    compared with errors that depend on that joint or load: only what these leave is attributed to
    time. A walk is none where readings of single targets wander as much, each by itself.

    Args:
        at: the model, with small motions of the base.
        poses: P complete single readings.
        whitener: (P, b, b) that makes their noise white.
        effects: candidate effects.
        logged: whether torques were logged.
        weights: whether torques of the weights are known.
    """
    once, again = len(np.unique(poses.pose)) == len(poses), measured_again(poses)
    if not poses.states.tells_time or (once and not again and like_a_scan(poses)):
        return NO_MOTION
    poses = with_place_labels(poses) if again else poses
    if len(poses) > MOTION.most_readings:
        shown: Index = spread_over_time(poses, MOTION.most_readings)
        poses, whitener = poses.take(shown), whitener[shown]
    own = [term for term in at.model.terms if not is_error_map(term)]
    load_N = poses.states.load_N
    by_load = motions_along(jacobians.by_base(at, poses), load_N[:, None] == np.unique(load_N)[1:])
    held = [
        *jacobians.by_scaled_terms(at, poses, own),
        at.compared(poses).by_targets * MOTION.targets_m,
        MOTION.by_load_m * by_load,
    ]
    static, of_time = by_pose_and_time(at, poses, effects, logged=logged, weights=weights)

    def beside(rivals: tuple[Threshold, ...]) -> TimeFindings:
        own = np.concatenate([*held, _motions_by(rivals, at, poses)], axis=2)
        walks = all(np.isfinite(rival.value) for rival in rivals)
        return _motion_in(_TimedRows(at, poses, whitener, own, static, of_time), walks=walks)

    found = beside(())
    if found.wander is not None and found.wander.walk_m:
        of_targets = target_wander(at, poses, at.compared(poses).residual)
        if of_targets is not None:
            return replace(NO_MOTION, has_drift=found.has_drift, of_targets=of_targets)
    if again:  # poses measured again show that no joint and no load explains the motion
        return found
    return _beyond_rivals(found, beside, poses.states, at.arm.prismatic)


def _beyond_rivals(
    found: TimeFindings,
    beside: Callable[[tuple[Threshold, ...]], TimeFindings],
    states: PoseStates,
    prismatic: Mask,
) -> TimeFindings:
    """Return the motion that remains beside joints and loads whose errors may explain it as well.

    Args:
        found: the motion found beside none of them.
        beside: returns the motion found beside errors that depend on some of them.
    """
    rivals: tuple[Threshold, ...] = ()
    first_mm = 0.0 if found.wander is None else found.wander.rms_mm[0]
    for _ in range(MOTION.most_rivals):
        more = _rivals_of(found, states, prismatic)
        if not more:
            break
        if set(more) <= set(rivals):  # the motion found beside them still follows their order
            found = NO_MOTION
            break
        both = dict.fromkeys((*rivals, *more))
        rivals = tuple(sorted(both, key=lambda rival: rival.value == np.inf))
        found = beside(rivals)
    else:
        found = NO_MOTION
    if not rivals:
        return found
    names = tuple(dict.fromkeys(str(rival.covariate) for rival in rivals))
    return replace(found, rivals=names, rivals_mm=first_mm)


def _rivals_of(found: TimeFindings, states: PoseStates, prismatic: Mask) -> tuple[Threshold, ...]:
    """Return the joints or the load whose errors may explain the motion that was found.

    For a jump, thresholds of a joint or the load that divide the rows as it does; for a walk, slow
    joints, without a threshold.
    """
    if (wander := found.wander) is None:
        return ()
    rivals = [
        threshold
        for jump in wander.jumps
        for threshold in step_thresholds(states, jump.time_s, prismatic)
    ]
    if wander.walk_m:
        slow = slow_joints(states)
        rivals += [
            Threshold(each, np.inf)
            for each in covariates(states, prismatic)
            if each.joint is not None and slow[each.joint - 1]
        ]
    return tuple(rivals)


def _motions_by(rivals: tuple[Threshold, ...], at: FittedModel, poses: Observations) -> Array:
    """Return columns (P, b, c) of motions of the base that depend on rivals: steps and waves."""
    states = poses.states
    courses = [np.zeros((len(poses), 0))]
    courses += [
        (rival.covariate.values(states) > rival.value).astype(np.float64)[:, None]
        for rival in rivals
        if np.isfinite(rival.value)
    ]
    waves = np.arange(1, MOTION.rival_waves + 1)
    for covariate in dict.fromkeys(rival.covariate for rival in rivals):
        values = covariate.values(states)
        ends = [np.searchsorted(np.sort(values), values, side) for side in ("left", "right")]
        rank = (0.5 * sum(ends) + 0.5) / len(poses)  # of equal values the mean one
        courses.append(np.cos(np.pi * np.outer(rank, waves)) / waves)
    every = np.column_stack(courses)
    sizes = np.tile(sizes_of_motions(MOTION.rival_m, 1.0), every.shape[1])
    return motions_along(jacobians.by_base(at, poses), every - np.mean(every, axis=0)) * sizes


def grows_instead(
    drift: Effect, growth: ThermalGrowth, model: FittedModel, poses: Observations
) -> bool:
    """Return whether an arm that grows steadily in time leaves no more than a drift of the base.

    Never where temperatures were logged in all rows: then growth is sought itself. Of squared
    errors over the stated noise, beside all else in the model, whose parameters are fitted again.

    Args:
        drift: a term of the model.
        growth: of the arm, in proportion to a temperature that rises by one kelvin an hour here.
        model: the model with the drift.
        poses: P complete single readings.
    """
    if why_unknown(growth, poses.states, logged=False, weights=False) is None:
        return False
    poses = poses.take(spread_over_time(poses, MOTION.most_readings))
    others = [term for term in model.model.terms if term != drift]
    at = replace(model, covariance=None).only(*others)
    rows = rows_in_time(at, poses, at.compared(poses).residual)
    states = rows.poses.states
    hours = (states.time_s - states.time_s.min()) / 3600.0
    temperature_C = growth.reference_temperature_C + hours
    warming = rows.poses.with_states(replace(states, temperature_C=temperature_C))
    whitener = rows.whitener
    own = jacobians.by_scaled_terms(at, rows.poses, others, whitener)
    own = [*own, whitener @ jacobians.by_base(at, rows.poses), rows.by_targets]

    def left_by(effect: Effect) -> float:
        added = jacobians.by_scaled_effects(at, warming, [effect], [effect.starts[0]], whitener)
        columns = np.concatenate([*own, *added], axis=2).reshape(rows.data.size, -1)
        data = rows.data.ravel()
        return float(np.sum((data - columns @ np.linalg.lstsq(columns, data)[0]) ** 2))

    return left_by(growth) <= left_by(drift)


# Columns of all that depends on the pose, beside which something is sought in time.


def by_pose_and_time(
    at: FittedModel, poses: Observations, effects: Iterable[Effect], *, logged: bool, weights: bool
) -> tuple[Array, Array]:
    """Return columns (P, b, k) of what depends on the pose, and of effects of time.

    The former are the effects that can be predicted, and waves of the joints' errors where poses
    are read once. A change in time has to explain more than these.
    """
    known = [
        effect
        for effect in effects
        if not (is_error_map(effect) or (effect.generic and effect.depends_on))
        and why_unknown(effect, poses.states, logged=logged, weights=weights) is None
    ]
    shapes = [effect for effect in known for _ in effect.starts]
    starts = [start for effect in known for start in effect.starts]
    none = np.zeros((*poses.measured.components_seen.shape, 0))
    columns = [none, *jacobians.by_scaled_effects(at, poses, shapes, starts)]
    with_time = np.array([False, *(effect.depends_on is not None for effect in shapes)])
    with_time = np.repeat(with_time, [each.shape[2] for each in columns])
    every = np.concatenate(columns, axis=2)
    static, of_time = every[..., ~with_time], CANDIDATES.sizes_of_time * every[..., with_time]
    if len(np.unique(poses.pose)) == len(poses):
        waves = _waves(at, poses, slow_joints(poses.states))
        static = np.concatenate([static, waves], axis=2)
    return static, of_time


def _waves(at: FittedModel, poses: Observations, slow: Mask) -> Array:
    """Return columns (P, b, w) of waves of the error of every turning joint by its angle."""
    arm = at.arm
    joints = [joint for joint, slides in enumerate(arm.prismatic, start=1) if not slides]
    screws = jacobians.by_joints(at, poses, joints)
    q_rad = poses.states.q_rad[:, [joint - 1 for joint in joints]]
    columns = [np.zeros((*screws.shape[:2], 0))]
    for k, joint in enumerate(joints):
        angle = q_rad[:, k, None] * np.arange(1, CANDIDATES.waves[int(slow[joint - 1])] + 1)
        waves = np.concatenate([np.sin(angle), np.cos(angle)], axis=1)
        columns.append(screws[:, :, k, None] * waves[:, None])
    return np.asarray(CANDIDATES.wave_rad * np.concatenate(columns, axis=2))
