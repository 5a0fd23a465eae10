"""Joints and links that warm up: what the residuals of the first poses have in common in time.

An arm that was not warm errs most in its first poses, less and less. A search that holds out
stretches of time cannot see that, as a stretch that alone shows it is predicted from all others. So
warm-ups of all joints and long links together, with one time constant, are compared by their log
evidence with what else may settle or move in the first poses: the base or the instrument, the
tool, targets. All that depends on the pose, and drifts, are integrated out besides.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pa10cal.arrays import Array, Index
from pa10cal.discovery import linear
from pa10cal.discovery.in_time import by_pose_and_time
from pa10cal.discovery.linear import WhitenedPoses
from pa10cal.discovery.preparation import sought
from pa10cal.discovery.rules import CHANGE, MOTION, PROBABILITIES, WARMING
from pa10cal.numerics.gaussian import Gaussian
from pa10cal.observe.time_order import like_a_scan, spread_over_time
from pa10cal.rules import ORDER
from pa10cal.terms.effects.effect import CandidateContext
from pa10cal.terms.effects.warm_up import WarmsUp, warm_ups


def warm_ups_shown(
    rows: WhitenedPoses, context: CandidateContext, *, logged: bool
) -> tuple[WarmsUp, ...]:
    """Return the warm-up of every joint and long link if they are significant together; or none.

    With the most likely time constant. None where the base, the tool or a target that settles or
    moves explains the residual as well, and none where rows do not tell time.

    Args:
        rows: the poses about a model that was fitted to them.
        context: where effects may sit.
        logged: whether torques were logged.
    """
    tried, poses = warm_ups(context), rows.poses
    if not tried or not poses.states.tells_time or poses.measured.campaigns or like_a_scan(poses):
        return ()
    rows = _taken(rows, spread_over_time(poses, MOTION.most_readings))
    first_s, last_s = context.time_span_s
    shortest_s, longest, count = WARMING.time_constants
    if shortest_s >= longest * (last_s - first_s):
        return ()
    taus_s = np.geomspace(shortest_s, longest * (last_s - first_s), count)
    since_s = rows.poses.states.time_s - first_s
    beside = _Beside(rows, context, logged=logged)
    gains = beside.gains(_of_arm(rows, tried, taus_s))
    best, needed = int(np.argmax(gains)), np.log(count * len(CHANGE.scales) / MOTION.false_rate)
    # With the longest one it is a drift.
    if best == count - 1 or gains[best] < needed:
        return ()
    # Nor may it rest on one pose, of which a joint may be misread.
    off = np.exp(-since_s / taus_s[best]) * np.linalg.norm(rows.data, axis=1)
    others = _taken(rows, np.delete(np.arange(len(off)), int(np.argmax(off))))
    by_others = _Beside(others, context, logged=logged)
    if by_others.gains(_of_arm(others, tried, taus_s[[best]]))[0] < needed:
        return ()
    if gains[best] < _best_rival(rows, beside, since_s, taus_s) + WARMING.better_nats:
        return ()
    return tuple(replace(effect, tau_s=float(taus_s[best])) for effect in tried)


def _taken(rows: WhitenedPoses, at: Index) -> WhitenedPoses:
    """Return some of the poses."""
    return WhitenedPoses(rows.at, rows.poses.take(at), rows.residual[at], rows.whitener[at])


def _of_arm(rows: WhitenedPoses, tried: tuple[WarmsUp, ...], taus_s: Array) -> Array:
    """Return whitened columns (P, b, K, m) of m warm-ups with each of K time constants."""
    shapes = [replace(effect, tau_s=float(tau_s)) for tau_s in taus_s for effect in tried]
    starts = [shape.starts[0] for shape in shapes]
    columns = linear.by_effects(rows.at, rows.poses, shapes, starts, rows.whitener)
    every = np.concatenate(columns, axis=2)
    return every.reshape(*every.shape[:2], len(taus_s), len(tried))


class _Beside:
    """All that depends on the pose, and drifts, beside which columns gain log evidence."""

    def __init__(self, rows: WhitenedPoses, context: CandidateContext, *, logged: bool) -> None:
        at, poses, whiten = rows.at, rows.poses, rows.whitener
        effects = sought(context, at.model.terms)
        smooth = by_pose_and_time(at, poses, effects, logged=logged, weights=True)
        own = linear.by_own_terms(at, poses, at.model.terms, whiten)
        columns = [
            *(CHANGE.static_sizes * each for each in own),
            MOTION.targets_m * rows.by_targets,
            *(whiten @ each for each in smooth),
        ]
        self._own, self._data = np.concatenate(columns, axis=2), rows.data
        self._known = Gaussian.of(self._own, self._data)

    def gains(self, columns: Array) -> Array:
        """Return the gain (K,) by each of K sets of columns (P, b, K, k), at its best size."""
        across = np.einsum("pbn,pbki->nki", self._own, columns, optimize=True)
        gram = np.einsum("pbki,pbkj->kij", columns, columns, optimize=True)
        projection = np.einsum("pbki,pb->ki", columns, self._data, optimize=True)
        further = self._known.of_each_further(across, gram, projection)
        seen = int(np.count_nonzero(self._data))
        sizes = np.array(CHANGE.scales)[:, None]
        gains = [further.in_sizes(size).gains(seen)[0] for size in sizes]
        return np.asarray(np.max(gains, axis=0) / PROBABILITIES.blocks)


def _best_rival(rows: WhitenedPoses, beside: _Beside, since_s: Array, taus_s: Array) -> float:
    """Return the gain by motions of the base or of all targets that settle, or step early.

    Args:
        rows: P poses.
        beside: what the motions have to gain beside.
        since_s: (P,) times from the first reading on.
        taus_s: time constants with which they may settle.
    """
    early_s = since_s[since_s < ORDER.end_share * since_s.max()]
    steps_s = np.quantile(early_s, np.linspace(0.0, 1.0, MOTION.coarse_times))
    settling = np.exp(-since_s[:, None] / taus_s)
    courses = np.concatenate([settling, since_s[:, None] <= steps_s], axis=1)[:, None, :, None]
    of_base = rows.whitener @ linear.by_base(rows.at, rows.poses)
    motions = [each for each in (of_base, rows.by_targets) if each.shape[2]]
    gains = (beside.gains(WARMING.base_m * each[:, :, None, :] * courses) for each in motions)
    return max(float(gain.max()) for gain in gains)
