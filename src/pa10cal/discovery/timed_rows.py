"""Log evidence of motions of the base in the course of time, by all single readings.

They form one linear Gaussian model. The parameters of the model and of every effect of the
vocabulary, and an error that the readings of a pose share, are integrated out; the time of a jump
is scanned. The order of use: `best_jump`, `best_walk` and `in_pauses` propose motions, and `about`
gives the evidence of any.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np

from pa10cal.arrays import Array, Index
from pa10cal.discovery import jacobians
from pa10cal.discovery.nuisances import (
    Jump,
    Wander,
    motions_along,
    sizes_of_motions,
)
from pa10cal.discovery.repeats import same_circumstances
from pa10cal.discovery.rules import MOTION, NOISE
from pa10cal.discovery.tuning import none_and_spaced
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.numerics.gaussian import Gaussian, Gaussians
from pa10cal.observe.observations import Observations

#: Expected root mean squares of the walk that are tried [m].
WALKS_M = np.geomspace(*MOTION.walks_m)
#: Variances tried of the error that readings of a pose share, in units of that of a reading.
_SHARED = tuple(none_and_spaced(*MOTION.pose_variances).tolist())


class MotionLikelihood(NamedTuple):
    """Likelihood of motions in time, at the best variance of the shared error."""

    nats: float  # log evidence
    courses: Gaussian  # normal equations of the motions of every course, in their expected sizes
    noise_scale: float  # standard deviation of whitened rows


class TimedRows:
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
        sizes = product(WALKS_M.tolist(), MOTION.turns_rad_per_m)
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

    def without_time(self) -> TimedRows:
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

    def about(self, wander: Wander, reduced: list[Gaussian] | None = None) -> MotionLikelihood:
        """Return the evidence of a motion at the best variance of the shared error."""
        at = self._places(wander)
        best = MotionLikelihood(-np.inf, Gaussian.none(0), 1.0)
        reduced = reduced or self._reduced(wander.jumps)
        for motions, free in zip(reduced, self._free_components(), strict=True):
            courses = motions.along(at).in_sizes(wander.sizes)
            alone = courses.without(np.arange(courses.unknowns))
            nats, variance = self._log_evidence(
                np.array(alone.squares), np.array(alone.log_det), free
            )
            if nats > best.nats:
                best = MotionLikelihood(float(nats), courses, float(np.sqrt(variance)))
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
