"""The family of candidates: every effect at every place, and what these poses can show of it.

All of it is settled before residuals are looked at: which effects the model's own parameters
absorb, and which are indistinguishable.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pa10cal.arrays import Array
from pa10cal.discovery.evidence.fit import Fit, pose_rows, torque_rows
from pa10cal.discovery.evidence.likelihood import Block
from pa10cal.discovery.evidence.problem import Problem
from pa10cal.discovery.finding import NotTestable
from pa10cal.discovery.linear import by_end, of_weights, possible_sizes
from pa10cal.discovery.preparation import computable, why_hidden
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.term import shows_torque

#: Effects whose directions are closer than this look the same.
INDISTINGUISHABLE = 0.999


@dataclass(frozen=True)
class Linearised:
    """The rows of a fit and of candidates about it."""

    # pose_data and torque_data: whitened rows of measured minus predicted, with the linear part of
    # the fit's own effects put back, as if they had not been in it
    pose_data: Array
    torque_data: Array
    own: Array  # (R, k) whitened rows of the model's own parameters, at their possible size
    blocks: tuple[Block, ...]  # of each candidate requested, in order


def linearise(problem: Problem, found: Fit, candidates: tuple[Effect, ...]) -> Linearised:
    """Linearise the model about a fit, by its own parameters and by candidates.

    Those of the fit's effects that are among the candidates are put back.
    """
    pose = problem.pose.rows(pose_rows(problem, found.at))
    own_columns = found.own_columns()
    possible = possible_sizes(found.model, problem.cells.measured)[own_columns]
    pose_data, by_x = -pose[:, 0], pose[:, 1:]
    torque_data, torque_by_x = np.zeros(0), np.zeros((0, len(found.x)))
    if problem.torque is not None:
        torque = problem.torque.rows(torque_rows(problem, found.at))
        torque_data, torque_by_x = -torque[:, 0], torque[:, 1:]
    blocks: dict[Effect, Block] = {}
    for effect, (first, last) in zip(found.effects, found.effect_columns(), strict=True):
        linear = slice(first, first + effect.linear)
        pose_data = pose_data + by_x[:, linear] @ found.x[linear]
        torque_data = torque_data + torque_by_x[:, linear] @ found.x[linear]
        blocks[effect] = Block(
            by_x[:, first:last], torque_by_x[:, first:last], _factor(effect, found.of(effect))
        )
    # Weights are expected about what is described, not about the fit.
    weights = np.flatnonzero(of_weights(found.model))
    pose_data = pose_data + by_x[:, weights] @ found.x[weights]
    others = tuple(effect for effect in candidates if effect not in blocks)
    if others:
        blocks |= zip(others, _blocks(problem, found, others), strict=True)
    return Linearised(
        pose_data,
        torque_data,
        by_x[:, own_columns] * possible,
        tuple(blocks[effect] for effect in candidates),
    )


def _blocks(problem: Problem, found: Fit, effects: tuple[Effect, ...]) -> list[Block]:
    """Return the rows of effects that the fit has not, at each of their shapes."""
    states = problem.cells.states
    asked = [(effect, start) for effect in effects for start in effect.starts]
    terms = [effect for effect, _ in asked]
    at = found.at
    in_base = at.model.by_terms(states, at.x, terms, [start for _, start in asked])
    widths = np.cumsum([0, *(effect.linear for effect in terms)])
    turn = by_end(at, problem.cells, at.model.predict(states, at.x))
    together = np.concatenate(
        [values[:, :, : effect.linear] for values, effect in zip(in_base, terms, strict=True)],
        axis=2,
    )
    pose = problem.pose.rows(turn @ together)
    torque = np.zeros((0, widths[-1]))
    if problem.torque is not None:
        by_x = np.zeros((*states.tau_Nm.shape, widths[-1]))
        for (effect, start), first, last in zip(asked, widths[:-1], widths[1:], strict=True):
            if shows_torque(effect):
                by_x[:, :, first:last] = effect.torque_derivative(states, start)
        torque = problem.torque.rows(by_x)
    blocks, k = [], 0
    for effect in effects:
        shapes = len(effect.starts)
        columns = slice(widths[k], widths[k + shapes])
        factor = np.asarray(np.kron(np.eye(shapes), effect.prior_factor), dtype=float)
        blocks.append(Block(pose[:, columns], torque[:, columns], factor))
        k += shapes
    return blocks


def _factor(effect: Effect, x: Array) -> Array:
    """Return the factor of an effect in a fit: its shape may be anything near."""
    k, linear = len(x), effect.linear
    factor = np.zeros((k, k))
    factor[:linear, :linear] = effect.prior_factor
    factor[range(linear, k), range(linear, k)] = np.abs(x[linear:])
    return factor


def testable(
    problem: Problem, found: Fit, effects: tuple[Effect, ...]
) -> tuple[tuple[Effect, ...], tuple[NotTestable, ...]]:
    """Divide effects into those that these data can show and those that they cannot."""
    known, refused = computable(
        effects,
        problem.cells.states,
        logged=problem.torques_logged,
        weights=problem.torque is not None,
    )
    lin = linearise(problem, found, tuple(known))
    pose = problem.pose.whitening(0.0)
    own, _ = np.linalg.qr(np.concatenate([pose(lin.own), np.eye(lin.own.shape[1])]))
    own = own[: len(lin.own)]
    torque = None if problem.torque is None else problem.torque.whitening(0.0)
    uncertain = of_weights(found.model).any()
    shown = []
    for effect, block in zip(known, lin.blocks, strict=True):
        rows = pose(block.pose @ block.factor)
        left = rows - own @ (own.T @ rows)
        if uncertain:  # what weights take up of it is limited by their own uncertainty
            left = _root(rows.T @ left)
        share = float(np.linalg.norm(left) / max(float(np.linalg.norm(rows)), 1e-300))
        signal = float(np.linalg.norm(left, 2)) if left.size else 0.0
        if torque is not None and np.any(block.torque):
            bare = block.torque @ block.factor
            seen = torque(bare)
            share = max(share, float(np.linalg.norm(seen) / np.linalg.norm(bare)))
            signal = float(np.hypot(signal, np.linalg.norm(seen, 2)))
        why = _why_silent(problem) if signal == 0.0 else why_hidden(share, signal)
        if why is None:
            shown.append(effect)
        else:
            refused.append(NotTestable(effect, why))
    return tuple(shown), tuple(refused)


def _root(square: Array) -> Array:
    """Return rows whose products are those given."""
    values, vectors = np.linalg.eigh(0.5 * (square + square.T))
    root: Array = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    return root


def _why_silent(problem: Problem) -> str:
    """Return why an effect moves nothing at all in these poses."""
    if not np.any(problem.cells.states.arrival):
        return "the poses do not exercise it, or the direction of arrival was not logged"
    return "the poses do not exercise it"


def indistinguishable(
    problem: Problem, found: Fit, effects: tuple[Effect, ...]
) -> NDArray[np.bool_]:
    """Return which effects look the same in these poses, whatever is measured, (m, m).

    Two do when every canonical cosine of what the model's own parameters leave of them is close to
    one. Known before residuals are looked at; such effects stand for each other. Torques are taken
    as the weights require, so that the noise of the log distinguishes nothing.
    """
    states = problem.cells.states
    if states.static_loads is not None:
        quiet = replace(states, tau_Nm=states.static_loads.joint_Nm)
        problem = replace(problem, cells=replace(problem.cells, states=quiet))
    lin = linearise(problem, found, effects)
    pose = problem.pose.whitening(0.0)
    own, _ = np.linalg.qr(np.concatenate([pose(lin.own), np.eye(lin.own.shape[1])]))
    own = own[: len(lin.own)]
    torque = None if problem.torque is None else problem.torque.whitening(0.0)
    bases = []
    for block in lin.blocks:
        rows = pose(block.pose @ block.factor)
        rows = rows - own @ (own.T @ rows)
        if torque is not None:
            rows = np.concatenate([rows, torque(block.torque @ block.factor)])
        bases.append(np.linalg.qr(rows)[0])
    same = np.eye(len(effects), dtype=bool)
    for i, first in enumerate(bases):
        for j in range(i):
            if bases[j].shape == first.shape and not effects[i].generic and not effects[j].generic:
                least = np.linalg.svd(first.T @ bases[j], compute_uv=False)[-1]
                same[i, j] = same[j, i] = bool(least > INDISTINGUISHABLE)
    return same
