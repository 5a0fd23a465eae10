"""What changed at a row, other than where base and instrument stand.

From some row on a target sits elsewhere on the flange, all readings are longer along the beam, or
the log follows another model of the arm. Each is a step in columns of its own, and is held by
evidence against the others, a step of the base among them, at every row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from pa10cal.arrays import Array, Index
from pa10cal.discovery import linear
from pa10cal.discovery.finding import DiagnosedFault
from pa10cal.discovery.preparation import by_pose_and_time
from pa10cal.discovery.rules import CHANGE, MOTION
from pa10cal.discovery.wander import Wander, between_rows
from pa10cal.fit.fitted_model import FittedModel
from pa10cal.frame.rigid_fit import by_small_motion
from pa10cal.numerics.gaussian import Gaussian, Gaussians
from pa10cal.observe.observations import Observations
from pa10cal.observe.order import like_a_scan, measured_again, partings, spread_over_time
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.term import Offsets

Kind = Literal["base", "beam", "target", "tool", "model"]


@dataclass(frozen=True, eq=False)
class Change:
    """What changed from a time on."""

    kind: Kind
    target: int  # which target, from 0, where it is one's
    time_s: float
    before_s: float  # times of the readings between which it happened
    after_s: float
    scale: float  # times the usual sizes
    rivals: tuple[str, ...] = ()  # what explains it as well, in words
    amounts: Array | None = None  # (k,) in `sizes`; None until they are found

    @property
    def sizes(self) -> Array:
        """Return the size expected of each amount."""
        assert self.amounts is not None
        return np.full(len(self.amounts), self.scale)

    def columns(self, at: FittedModel, poses: Observations) -> Array:
        """Return how measured less predicted components follow the amounts, (P, b, k)."""
        after = poses.states.time_s > self.time_s
        of_kind = _columns(self.kind, self.target, at, poses)
        return np.asarray(self.scale * of_kind * after[:, None, None])

    def shift(self, at: FittedModel, poses: Observations) -> Array:
        """Return by how much it moves the components of poses, (P, b)."""
        assert self.amounts is not None
        return np.asarray(self.columns(at, poses) @ self.amounts)

    def fault(self, at: FittedModel, poses: Observations) -> DiagnosedFault:
        """Return it as a fault of the log."""
        assert self.amounts is not None
        later = poses.take(np.flatnonzero(poses.states.time_s > self.time_s))
        size_mm = linear.rms(linear.error_mm(later.measured, self.shift(at, later)))
        amount_mm = 1e3 * CHANGE.size * self.scale * self.amounts
        names = poses.measured.target_names
        if self.kind == "target":
            name = names[self.target] if self.target < len(names) else "the target"
            moved_mm = float(np.linalg.norm(amount_mm))
            what = f"target {name} moved on the flange by {moved_mm:.2g} mm from there on"
            remedy = "give it another name from there on, or calibrate the parts as two campaigns"
        elif self.kind == "tool":
            what = f"the tool with all targets moved on the flange, these by {size_mm:.2g} mm"
            remedy = "check how it is fixed; calibrate the parts as two campaigns"
        elif self.kind == "beam":
            along_mm = float(amount_mm[0])
            way = "longer" if along_mm > 0.0 else "shorter"
            what = (
                f"all readings are {way} by {abs(along_mm):.3g} mm along the beam from there on: a "
                "reflector of another size, or another zero of the distance"
            )
            remedy = "correct the size of the reflector there, and calibrate again"
        else:
            what = (
                f"from there on the log follows another model of the arm, {size_mm:.2g} mm (root "
                "mean square) away: the joints logged are not the same quantity before and after, "
                "as where a controller's accuracy package is switched or the arm is mastered anew"
            )
            remedy = (
                "log the same joint positions throughout (the axes' own, no corrected ones), or "
                "calibrate the readings before and after as two campaigns"
            )
        if self.rivals:
            what += f"; {' or '.join(self.rivals)} would explain it as well"
        where = between_rows(poses, self.before_s, self.after_s)
        return DiagnosedFault(kind="step_in_time", where=where, what=what, remedy=remedy)


def change_of(
    at: FittedModel,
    poses: Observations,
    whitener: Array,
    effects: Sequence[Effect],
    *,
    logged: bool,
) -> Change | None:
    """Find what changed at a row of poses that are read once; None where that is a base, or none.

    Nothing is found where no time was recorded, poses follow each other like those of a scan, or
    where a joint or the load goes from one side to the other there.
    """
    if not poses.states.tells_time or poses.measured.campaigns or like_a_scan(poses):
        return None
    shown = spread_over_time(poses, MOTION.most_readings)
    poses, whitener = poses.take(shown), whitener[shown]
    rows, kinds = _Rows(at, poses, whitener), _kinds(at)
    tried = [(kind, b, *rows.best(_columns(kind, b, at, poses))) for kind, b in kinds]
    kind, target, best, row, scale, left = max(tried, key=lambda each: each[2])
    needed = float(np.log(len(poses) * len(kinds) * len(CHANGE.scales) / CHANGE.false_rate))
    of_base = tried[0][2]
    if (
        kind == "base"
        or best < needed
        or best < of_base + CHANGE.better_nats
        or left > CHANGE.most_left_share
    ):
        return None
    time_s = poses.states.time_s
    middle_s = 0.5 * (time_s[row - 1] + time_s[row])
    if any(partings(poses.states, middle_s, at.model.chain.arm.prismatic)):
        return None
    columns = _columns(kind, target, at, poses)
    # Not where a smooth function of the pose does, nor where it comes on in the course of time.
    more = by_pose_and_time(at, poses, effects, logged=logged, weights=True)
    course = np.linspace(-1.0, 1.0, len(poses))[:, None, None]
    creeping = [columns * course**power for power in range(1, CHANGE.courses + 1)]
    beside = _Rows(at, poses, whitener, *more, *(CHANGE.static_sizes * each for each in creeping))
    gain, _, _, rest = beside.best(columns, np.array([row]))
    if gain < needed or rest > CHANGE.most_left_share:
        return None
    near = rows.as_good(columns, scale, row)
    rivals = [
        _WORDS[other]
        for other, _, value, _, _, rest in tried
        if other != kind and rows.as_well(other, best - value, rest / left)
    ]
    before_s, after_s = float(time_s[near[0] - 1]), float(time_s[near[-1]])
    found = Change(kind, target, middle_s, before_s, after_s, scale, tuple(dict.fromkeys(rivals)))
    found = replace(found, amounts=rows.amounts(columns, scale, row))
    later = poses.take(np.flatnonzero(time_s > middle_s))
    size_mm = linear.rms(linear.error_mm(later.measured, found.shift(at, later)))
    stated_mm = linear.mean_error_of_noise_mm(later.measured, later.measured.stated_covariance)
    return found if size_mm > CHANGE.least_noise_ratio * stated_mm else None


def rivals_of_steps(
    wander: Wander | None, at: FittedModel, poses: Observations, whitener: Array
) -> dict[float, tuple[str, ...]]:
    """Return what explains the steps of the base as well as it does, in words, by their times.

    Nothing does where poses are measured again on either side: there the base itself shows.
    """
    found: dict[float, tuple[str, ...]] = {}
    if wander is None or poses.measured.campaigns or measured_again(poses):
        return found
    shown = spread_over_time(poses, MOTION.most_readings)
    poses, whitener = poses.take(shown), whitener[shown]
    time_s = poses.states.time_s
    for jump in wander.jumps:
        jumps = tuple(other for other in wander.jumps if other is not jump)
        beside = replace(wander, jumps=jumps, amounts=None).columns(at, poses)
        rows = _Rows(at, poses, whitener, beside)
        row = np.array([np.searchsorted(time_s, jump.time_s)])
        tried = [(kind, rows.best(_columns(kind, b, at, poses), row)) for kind, b in _kinds(at)]
        (_, (of_base, _, _, left)), *others = tried
        told = [
            _WORDS[kind]
            for kind, (gain, _, _, rest) in others
            if rows.as_well(kind, of_base - gain, rest / left)
        ]
        found[jump.time_s] = tuple(dict.fromkeys(told))
    return found


def _kinds(at: FittedModel) -> list[tuple[Kind, int]]:
    """Return the kinds of change, the base first, and of which target."""
    targets = len(np.ravel(at.targets_m)) // 3
    found: list[tuple[Kind, int]] = [("base", 0), ("beam", 0), ("model", 0)]
    found += [("target", b) for b in range(targets)]
    return found + ([("tool", 0)] if targets > 1 else [])


_WORDS: dict[Kind, str] = {
    "base": "a motion of the instrument or the base",
    "beam": "another size of the reflector",
    "target": "a target that slipped",
    "tool": "a tool that moved on the flange",
    "model": "a log that follows another model of the arm",
}


def _columns(kind: Kind, target: int, at: FittedModel, poses: Observations) -> Array:
    """Return how measured less predicted components follow a kind of change, (P, b, k)."""
    if kind == "base":
        return CHANGE.size * linear.by_base(at, poses)
    of_targets = linear.by_targets(at, poses)
    if kind == "target":
        return CHANGE.size * of_targets[:, :, 3 * target : 3 * target + 3]
    if kind == "tool":
        places_m = np.reshape(at.targets_m, (-1, 3))
        return CHANGE.size * of_targets @ by_small_motion(places_m).reshape(-1, 6)
    if kind == "beam":
        measured = poses.measured
        places_m = measured.places_m
        length_m = np.linalg.norm(places_m, axis=2, keepdims=True)
        along = (places_m / np.maximum(length_m, np.finfo(float).tiny)).reshape(len(poses), -1)
        column = np.zeros((*measured.components_seen.shape, 1))
        column[:, measured.position_columns, 0] = np.nan_to_num(along)
        return CHANGE.size * column
    terms = [term for term in at.model.terms if type(term) is Offsets and term.of != "base"]
    own = linear.by_own_terms(at, poses, terms)
    frames = [CHANGE.frames * of_targets, CHANGE.frames * linear.by_base(at, poses)]
    return np.concatenate([*own, *frames], axis=2)


class _Rows:
    """Whitened rows in order of time, and the evidence of a step in columns at each of them."""

    def __init__(self, at: FittedModel, poses: Observations, whitener: Array, *more: Array) -> None:
        own = linear.by_own_terms(at, poses, at.model.terms)
        held = [CHANGE.static_sizes * columns for columns in own]
        held += [MOTION.targets_m * linear.by_targets(at, poses), *more]
        self._whitener, self._held = whitener, whitener @ np.concatenate(held, axis=2)
        self._data = (whitener @ -linear.residual(at, poses)[:, :, None])[:, :, 0]
        self._unchanged = Gaussian.of(self._held, self._data)
        self._seen = int(poses.measured.components_seen.sum())
        self._apart = np.flatnonzero(np.diff(poses.states.time_s, prepend=-np.inf) > 0.0)
        side = (self._apart >= CHANGE.least_side) & (self._apart <= len(poses) - CHANGE.least_side)
        self._apart = self._apart[side]

    def best(self, columns: Array, rows: Index | None = None) -> tuple[float, int, float, float]:
        """Return the greatest gain of log evidence, its row, scale and part of squares left."""
        rows = self._apart if rows is None else rows
        if not len(rows):
            return -np.inf, 0, 1.0, 1.0
        gain, left = self._gains(columns, rows, CHANGE.scales)
        row, of_scale = np.unravel_index(np.argmax(gain), gain.shape)
        scale = CHANGE.scales[int(of_scale)]
        return float(gain[row, of_scale]), int(rows[row]), scale, float(left[row, of_scale])

    def as_well(self, kind: Kind, worse: float, times: float) -> bool:
        """Return whether a kind does as well as the best, by log evidence and squares left.

        Few numbers against fewer is no reason; another model has the numbers of all other kinds.
        """
        misfit = 0.5 * self._seen * float(np.log(max(times, np.finfo(float).tiny)))
        return worse < CHANGE.as_good_nats or (kind != "model" and misfit < CHANGE.as_good_nats)

    def as_good(self, columns: Array, scale: float, row: int) -> Index:
        """Return the rows near the best one that are as good, in order."""
        gains = self._gains(columns, self._apart, (scale,))[0][:, 0]
        good = self._apart[gains > np.max(gains, initial=-np.inf) - CHANGE.row_nats]
        return good if len(good) else np.array([row])

    def amounts(self, columns: Array, scale: float, row: int) -> Array:
        """Return the most likely amounts of a step at a row, in the usual sizes times a scale."""
        steps = self._steps(columns, np.array([row])).in_sizes(np.array([scale]))
        return np.asarray(steps.mean[0])

    def _steps(self, columns: Array, rows: Index) -> Gaussians:
        """Return what is said of steps in columns (P, b, k) at each of R rows, (R,).

        What is held beside them is integrated out.
        """
        step = self._whitener @ columns
        every = np.concatenate([self._held, step, self._data[:, :, None]], axis=2)
        products = _from_each_on(every.swapaxes(1, 2) @ step)[rows]  # (R, h + k + 1, k)
        held = self._held.shape[2]
        return self._unchanged.of_each_further(
            products[:, :held].swapaxes(0, 1), products[:, held:-1], products[:, -1]
        )

    def _gains(self, columns: Array, rows: Index, scales: Sequence[float]) -> tuple[Array, Array]:
        """Return gains of log evidence and parts of squares left, (R, S), scatter profiled."""
        steps = self._steps(columns, rows)
        each = (steps.in_sizes(np.array([scale])) for scale in scales)  # all at once are large
        found = [some.gains(self._seen, CHANGE.same_squares) for some in each]
        gains, left = (np.stack(part, axis=1) for part in zip(*found, strict=True))
        return gains, left


def _from_each_on(values: Array) -> Array:
    """Return the sums of values (P, ...) from each row to the last."""
    summed: Array = np.cumsum(values[::-1], axis=0)[::-1]
    return summed
