"""Joints and links that warm up, by the residual of a search in the first poses.

An arm that was not warm errs most in its first poses, less and less. Warm-ups of all joints and
long links together, with one time constant, are compared with what else may settle or move in the
first poses: base or instrument, tool, targets. All that depends on the pose, and drifts, are
integrated out besides.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pa10cal.arrays import Array
from pa10cal.discovery import jacobians
from pa10cal.discovery.jacobians import WhitenedPoses
from pa10cal.discovery.model_columns import ModelColumns
from pa10cal.discovery.pose_columns import by_pose_and_time
from pa10cal.discovery.preparation import sought
from pa10cal.discovery.rules import CHANGE, MOTION, PROBABILITIES, WARMING
from pa10cal.observe.time_order import may_show_changes, spread_over_time
from pa10cal.rules import ORDER
from pa10cal.terms.effects.context import CandidateContext
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
    if not tried or not may_show_changes(poses):
        return ()
    rows = rows.take(spread_over_time(poses, MOTION.most_readings))
    first_s, last_s = context.time_span_s
    shortest_s, longest, count = WARMING.time_constants
    if shortest_s >= longest * (last_s - first_s):
        return ()
    taus_s = np.geomspace(shortest_s, longest * (last_s - first_s), count)
    of_model = _poses_and_drifts(rows, context, logged=logged)
    gains = _gains_at_best_size(of_model, _warm_up_columns(rows, tried, taus_s))
    best, needed = int(np.argmax(gains)), np.log(count * len(CHANGE.scales) / MOTION.false_rate)
    # With the longest time constant it is a drift.
    if best == count - 1 or gains[best] < needed:
        return ()
    # Nor may it rest on one pose, of which a joint may be misread.
    since_s = rows.poses.states.time_s - first_s
    off = np.exp(-since_s / taus_s[best]) * np.linalg.norm(rows.data, axis=1)
    others = rows.take(np.delete(np.arange(len(off)), int(np.argmax(off))))
    by_others = _gains_at_best_size(
        _poses_and_drifts(others, context, logged=logged),
        _warm_up_columns(others, tried, taus_s[[best]]),
    )
    if by_others[0] < needed:
        return ()
    if gains[best] < _best_motion(rows, of_model, since_s, taus_s) + WARMING.better_nats:
        return ()
    return tuple(replace(effect, tau_s=float(taus_s[best])) for effect in tried)


def _warm_up_columns(rows: WhitenedPoses, tried: tuple[WarmsUp, ...], taus_s: Array) -> Array:
    """Return whitened columns (P, b, K, m) of m warm-ups with each of K time constants."""
    shapes = [replace(effect, tau_s=float(tau_s)) for tau_s in taus_s for effect in tried]
    starts = [shape.starts[0] for shape in shapes]
    columns = jacobians.by_scaled_effects(rows.at, rows.poses, shapes, starts, rows.whitener)
    every = np.concatenate(columns, axis=2)
    return every.reshape(*every.shape[:2], len(taus_s), len(tried))


def _poses_and_drifts(
    rows: WhitenedPoses, context: CandidateContext, *, logged: bool
) -> ModelColumns:
    """Return all that depends on the pose, and drifts."""
    at, poses, whiten = rows.at, rows.poses, rows.whitener
    effects = sought(context, at.model.terms)
    smooth = by_pose_and_time(at, poses, effects, logged=logged, weights=True)
    by_terms = jacobians.by_scaled_terms(at, poses, at.model.terms, whiten)
    columns = [
        *(CHANGE.static_sizes * each for each in by_terms),
        MOTION.targets_m * rows.by_targets,
        *(whiten @ each for each in smooth),
    ]
    return ModelColumns.dense(np.concatenate(columns, axis=2), rows.data)


def _gains_at_best_size(of_model: ModelColumns, candidates: Array) -> Array:
    """Return the gain of log evidence (K,) by each of K candidates, by columns (P, b, K, k)."""
    further, sizes = of_model.with_each(candidates), np.array(CHANGE.scales)[:, None]
    gains = [further.in_sizes(size).gains(of_model.seen)[0] for size in sizes]
    return np.asarray(np.max(gains, axis=0) / PROBABILITIES.blocks)


def _best_motion(
    rows: WhitenedPoses, of_model: ModelColumns, since_s: Array, taus_s: Array
) -> float:
    """Return the gain by motions of the base or of all targets that settle, or step early.

    By times (P,) from the first reading on, and time constants with which they may settle.
    """
    early_s = since_s[since_s < ORDER.end_share * since_s.max()]
    steps_s = np.quantile(early_s, np.linspace(0.0, 1.0, MOTION.coarse_times))
    settling = np.exp(-since_s[:, None] / taus_s)
    courses = np.concatenate([settling, since_s[:, None] <= steps_s], axis=1)[:, None, :, None]
    of_base = rows.whitener @ jacobians.by_base(rows.at, rows.poses)
    motions = [each for each in (of_base, rows.by_targets) if each.shape[2]]
    gains = (
        _gains_at_best_size(of_model, WARMING.base_m * each[:, :, None, :] * courses)
        for each in motions
    )
    return max(float(gain.max()) for gain in gains)
