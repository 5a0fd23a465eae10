"""Candidates linearised about a fit: which ones the data can show, and which they can distinguish.

Both are decided without the residuals.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Mask
from pa10cal.discovery.evidence.fit import EvidenceFit, pose_rows, torque_rows
from pa10cal.discovery.evidence.likelihood import CandidateRows, LinearisedCandidates
from pa10cal.discovery.evidence.problem import EvidenceProblem
from pa10cal.discovery.finding import Untestable
from pa10cal.discovery.jacobians import by_target_distortion
from pa10cal.discovery.preparation import computable, why_few_angles, why_hidden
from pa10cal.discovery.rules import EVIDENCE
from pa10cal.discovery.tuning import COMPUTING
from pa10cal.fit.joint_noise import ideal_by_end
from pa10cal.fit.problem import possible_sizes
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.term import shows_torque


def linearise(
    problem: EvidenceProblem, found: EvidenceFit, candidates: tuple[Effect, ...]
) -> LinearisedCandidates:
    """Linearise the model about a fit, by its own parameters and by candidates."""
    pose = problem.pose.noise_whitened(pose_rows(problem, found.at))
    own_columns = found.baseline_columns()
    possible = possible_sizes(found.model, problem.cells.measured)[own_columns]
    pose_data, by_x = -pose[:, 0], pose[:, 1:]
    torque_data, torque_by_x = np.zeros(0), np.zeros((0, len(found.x)))
    if problem.torque is not None:
        torque = problem.torque.noise_whitened(torque_rows(problem, found.at))
        torque_data, torque_by_x = -torque[:, 0], torque[:, 1:]
    blocks: dict[Effect, CandidateRows] = {}
    for effect in found.effects:
        at = found.columns_of(effect)
        linear = slice(at.start, at.start + effect.linear)
        pose_data = pose_data + by_x[:, linear] @ found.x[linear]
        torque_data = torque_data + torque_by_x[:, linear] @ found.x[linear]
        # The prior of a shape is as wide as its value.
        factor = np.diag(np.abs(found.at.values_of(effect)))
        factor[: effect.linear, : effect.linear] = effect.prior_factor
        blocks[effect] = CandidateRows(by_x[:, at], torque_by_x[:, at], factor)
    # The prior of the arm's weights is about those described, not about the fit.
    weights = np.flatnonzero(found.model.having("weight"))
    pose_data = pose_data + by_x[:, weights] @ found.x[weights]
    others = tuple(effect for effect in candidates if effect not in blocks)
    if others:
        blocks |= zip(others, _rows_of_others(problem, found, others), strict=True)
    return LinearisedCandidates(
        pose_data,
        torque_data,
        by_x[:, own_columns] * possible,
        tuple(blocks[effect] for effect in candidates),
    )


def _rows_of_others(
    problem: EvidenceProblem, found: EvidenceFit, effects: tuple[Effect, ...]
) -> list[CandidateRows]:
    """Return the rows of effects that are not in the fit, each at all of its shapes."""
    shapes = [(effect, start) for effect in effects for start in effect.starts]
    pose = problem.pose.noise_whitened(_poses_by_shapes(problem, found, shapes))
    torque = np.zeros((0, pose.shape[1]))
    if problem.torque is not None:
        torque = problem.torque.noise_whitened(_torques_by_shapes(problem.cells.states, shapes))
    widths = [len(effect.starts) * effect.linear for effect in effects]
    stops = np.cumsum([0, *widths]).tolist()
    factors = [np.kron(np.eye(len(each.starts)), each.prior_factor) for each in effects]
    return [
        CandidateRows(pose[:, first:last], torque[:, first:last], np.asarray(factor, dtype=float))
        for (first, last), factor in zip(pairwise(stops), factors, strict=True)
    ]


def _poses_by_shapes(
    problem: EvidenceProblem, found: EvidenceFit, shapes: Sequence[tuple[Effect, Array]]
) -> Array:
    """Return the derivative of poses by the linear parameters of effects at shapes, (C, b, k)."""
    states, at = problem.cells.states, found.at
    T_base_ee, in_base = at.model.by_terms(states, at.x, *zip(*shapes, strict=True))
    by_motion = ideal_by_end(at, problem.cells, T_base_ee)
    of_targets = at.compared(problem.cells).by_targets
    columns = []
    for (effect, start), motion in zip(shapes, in_base, strict=True):
        by_effect = by_motion @ motion[:, :, : effect.linear]
        distorted = by_target_distortion(of_targets, problem.cells, effect, start)
        columns.append(
            by_effect if distorted is None else by_effect + distorted[:, :, : effect.linear]
        )
    return np.concatenate(columns, axis=2)


def _torques_by_shapes(states: PoseStates, shapes: Sequence[tuple[Effect, Array]]) -> Array:
    """Return the same of torques, (C, n, k): zero for effects that show in none."""
    return np.concatenate(
        [
            effect.torque_derivative(states, start)
            if shows_torque(effect)
            else np.zeros((*states.tau_Nm.shape, effect.linear))
            for effect, start in shapes
        ],
        axis=2,
    )


def split_testable(
    problem: EvidenceProblem, found: EvidenceFit, effects: tuple[Effect, ...]
) -> tuple[tuple[Effect, ...], tuple[Untestable, ...]]:
    """Divide effects into those that these data can show, and those that they cannot."""
    states = problem.cells.states
    known, refused = computable(
        effects, states, logged=problem.torques_logged, weights=problem.torque is not None
    )
    uncertain = found.model.having("weight").any()
    why_silent = "the poses do not exercise it"
    if not np.any(states.arrival):
        why_silent += ", or the direction of arrival was not logged"
    shown = []
    every = _rows_beside_own(problem, found, tuple(known))
    for effect, rows in zip(known, every, strict=True):
        distinct = rows.distinct
        if uncertain:  # weights follow an effect only as far as their own uncertainty allows
            square = rows.pose.T @ distinct
            values, vectors = np.linalg.eigh(0.5 * (square + square.T))
            distinct = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
        norm = max(float(np.linalg.norm(rows.pose)), COMPUTING.tiny)
        share = float(np.linalg.norm(distinct) / norm)
        signal = float(np.linalg.norm(distinct, 2)) if distinct.size else 0.0
        if np.any(rows.torque):
            of_torque = np.linalg.norm(rows.torque_distinct) / np.linalg.norm(rows.torque)
            share = max(share, float(of_torque))
            signal = float(np.hypot(signal, np.linalg.norm(rows.torque_distinct, 2)))
        why = why_silent if signal == 0.0 else why_hidden(share, signal)
        why = why or why_few_angles(effect, states)
        if why is None:
            shown.append(effect)
        else:
            refused.append(Untestable(effect, why))
    return tuple(shown), tuple(refused)


class _RowsBesideOwn(NamedTuple):
    """Rows of an effect in its expected size, and the part that nothing else can follow."""

    pose: Array  # whitened
    distinct: Array  # less what the model's own parameters follow
    torque: Array  # by the noise of readings alone
    torque_distinct: Array  # less what the errors common to all poses follow


def _rows_beside_own(
    problem: EvidenceProblem, found: EvidenceFit, effects: tuple[Effect, ...]
) -> Iterator[_RowsBesideOwn]:
    """Yield the rows of each effect."""
    lin = linearise(problem, found, effects)
    pose = problem.pose.whitening(0.0)
    own, _ = np.linalg.qr(np.concatenate([pose(lin.own), np.eye(lin.own.shape[1])]))
    own = own[: len(lin.own)]
    torque = None if problem.torque is None else problem.torque.whitening(0.0)
    for block in lin.blocks:
        of_pose, of_torque = pose(block.pose @ block.factor), block.torque @ block.factor
        yield _RowsBesideOwn(
            pose=of_pose,
            distinct=of_pose - own @ (own.T @ of_pose),
            torque=of_torque,
            torque_distinct=of_torque if torque is None else torque(of_torque),
        )


def indistinguishable(
    problem: EvidenceProblem, found: EvidenceFit, effects: tuple[Effect, ...]
) -> Mask:
    """Return which effects are indistinguishable in these poses, whatever is measured, (m, m).

    Two are so if every canonical cosine of their rows, less what the model's own parameters follow,
    is close to one. This is known before residuals are looked at. Torques are those of the weights,
    so that the noise of the log distinguishes nothing.
    """
    states = problem.cells.states
    if states.static_loads is not None:
        quiet = replace(states, tau_Nm=states.static_loads.joint_Nm)
        problem = replace(problem, cells=replace(problem.cells, states=quiet))
    bases = [
        np.linalg.qr(np.concatenate([rows.distinct, rows.torque_distinct]))[0]
        for rows in _rows_beside_own(problem, found, effects)
    ]
    same = np.eye(len(effects), dtype=bool)
    for i, first in enumerate(bases):
        for j in range(i):
            if bases[j].shape == first.shape and not effects[i].generic and not effects[j].generic:
                least_cosine = np.linalg.svd(first.T @ bases[j], compute_uv=False)[-1]
                same[i, j] = same[j, i] = bool(least_cosine > EVIDENCE.indistinguishable)
    return same
