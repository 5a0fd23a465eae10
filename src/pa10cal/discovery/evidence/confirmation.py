"""Confirmation of an effect: sign flips over poses, and poses and loads held out.

The unit of evidence is the pose. If an effect is absent, what it seems to explain at one pose has
either sign. All rows of a pose are flipped together, which keeps what its loads, repeats and
components share. The largest gain of any candidate under flips is what chance makes of this family
on these data (max-T), whatever the distribution of the noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from pa10cal.arrays import Array, Index
from pa10cal.discovery.evidence.candidates import linearise
from pa10cal.discovery.evidence.noise_model import NoiseModel, Whitening
from pa10cal.discovery.evidence.problem import EvidenceProblem
from pa10cal.discovery.evidence.search import EndOfSearch
from pa10cal.discovery.proof import Proof, most_influential_pose
from pa10cal.discovery.rules import EVIDENCE
from pa10cal.numerics.gaussian import Gaussian, cv_residual
from pa10cal.results.discovery import CrossValidation, EvidenceByRepeats
from pa10cal.terms.effects.effect import Effect


class Confirmation(EvidenceByRepeats, Proof):
    """The evidence of one effect, all others being in the model."""

    @property
    @override
    def explains(self) -> float:
        return self.cross_validation_over_poses.explained

    @property
    @override
    def evidence(self) -> EvidenceByRepeats:
        return self


@dataclass(frozen=True)
class WhitenedRows:
    """R rows of poses and of torques, whitened by all errors and the prior of the arm's weights."""

    own: Array  # (R, k) derivative by the model's own parameters, then by the members
    members: tuple[slice, ...]  # columns of each member in `own`
    data: Array  # (R,) measured minus predicted without the members
    family: tuple[Array, ...]  # (R, c) derivative by each candidate
    cell: Index  # (R,) number of the cell of each row, or of one of its pose


def confirm(
    problem: EvidenceProblem, found: EndOfSearch, needed: float = 0.0
) -> tuple[Confirmation, ...]:
    """Return the evidence of every effect of a search; a name needs so much log evidence.

    In addition to the loss of log evidence without it: sign flips, and poses and loads held out.
    """
    if not found.fit.effects:
        return ()
    rows = whitened_rows(problem, found, found.family)
    by_cell = _rows_by_cell(problem, found)
    labels, pose = np.unique(problem.cells.pose, return_inverse=True)
    loads, load = np.unique(problem.cells.states.load_N, return_inverse=True)
    signs = np.random.default_rng(EVIDENCE.flips_seed).choice(
        [-1.0, 1.0], (EVIDENCE.flips, int(pose.max()) + 1)
    )
    return tuple(
        Confirmation(
            lost_without_it_nats=found.score.log_evidence - without.log_evidence,
            needed_nats=needed,
            p_sign_flips_max_t=_share_of_flips(rows, k, pose, signs),
            p_needed=EVIDENCE.false_rate,
            cross_validation_over_poses=_cross_validation(rows, k, pose % EVIDENCE.folds, pose),
            cross_validation_over_loads=_cross_validation(by_cell, k, load, pose)
            if len(loads) > 1
            else None,
            influential_pose=_influential_pose(rows, k, pose, labels, needed),
        )
        for k, without in enumerate(found.without)
    )


def whitened_rows(
    problem: EvidenceProblem, found: EndOfSearch, family: tuple[Effect, ...]
) -> WhitenedRows:
    """Return rows whose errors are independent and of unit variance.

    Each is a combination of the cells of a pose: the error that these share is whitened, too.

    Args:
        problem: the campaign.
        found: the search, whose effects are the members.
        family: the candidates.
    """

    def combined(channel: NoiseModel, variance: float, rows: Array) -> Array:
        return channel.whitening(variance)(rows)

    return _whitened(problem, found, family, combined)


def _rows_by_cell(problem: EvidenceProblem, found: EndOfSearch) -> WhitenedRows:
    """Return rows of one cell each, without candidates: so the cells of a load can be held out.

    They still have the error that the cells of a pose share.
    """

    def single(channel: NoiseModel, _: float, rows: Array) -> Array:
        return np.asarray(channel.shared.rotation.T @ channel.whitening(0.0)(rows))

    return _whitened(problem, found, (), single)


def _whitened(
    problem: EvidenceProblem,
    found: EndOfSearch,
    family: tuple[Effect, ...],
    of_channel: Callable[[NoiseModel, float, Array], Array],
) -> WhitenedRows:
    """Return whitened rows of poses, and then of torques.

    `of_channel` whitens noise-whitened rows (R, k) of poses or torques, by the variance of their
    shared error.
    """
    wanted = tuple(dict.fromkeys((*family, *found.fit.effects)))
    lin, variances = linearise(problem, found.fit, wanted), found.score.variances
    blocks = dict(zip(wanted, lin.blocks, strict=True))
    channels = [problem.pose] if problem.torque is None else [problem.pose, problem.torque]

    def both(*rows: Array) -> Array:
        parts = zip(channels, variances, rows, strict=False)  # torques may not be known
        return np.concatenate([of_channel(*part) for part in parts])

    own = both(lin.own, np.zeros((len(lin.torque_data), lin.own.shape[1])))
    # Uncertain weights of the arm count as an error common to all poses: as free parameters they
    # would follow more than their uncertainty allows.
    uncertain = np.isin(
        found.fit.baseline_columns(), np.flatnonzero(found.fit.model.having("weight"))
    )
    whiten_weights = Whitening.of(np.ones(len(own)), own[:, uncertain])

    def of_effect(effect: Effect, size: float) -> Array:
        rows, factor = blocks[effect], size * blocks[effect].factor
        return whiten_weights(both(rows.pose @ factor, rows.torque @ factor))

    own = whiten_weights(own[:, ~uncertain])
    of_members = [
        of_effect(effect, EVIDENCE.sizes[found.fit.size_of[effect]]) for effect in found.fit.effects
    ]
    stops = np.cumsum([own.shape[1], *(part.shape[1] for part in of_members)]).tolist()
    cells = np.arange(len(problem.cells))
    return WhitenedRows(
        own=np.concatenate([own, *of_members], axis=1),
        members=tuple(slice(a, b) for a, b in pairwise(stops)),
        data=whiten_weights(both(lin.pose_data[:, None], lin.torque_data[:, None]))[:, 0],
        family=tuple(of_effect(effect, 1.0) for effect in family),
        cell=np.concatenate([np.repeat(cells, each.whitener.shape[1]) for each in channels]),
    )


def _share_of_flips(rows: WhitenedRows, k: int, pose: Index, signs: Array) -> float:
    """Return the share of sign flips in which some candidate gains as much as member k (max-T)."""
    others = np.delete(rows.own, rows.members[k], axis=1)
    fit_of_others = Gaussian.of(others, rows.data)

    def residual_of(columns: Array) -> Array:
        """Return what all but member k leaves of columns."""
        return np.asarray(columns - others @ fit_of_others.taken_of(others.T @ columns))

    data, of_row = residual_of(rows.data[:, None]), pose[rows.cell]

    def gain(columns: Array, signs: Array) -> Array:
        """Return the gain in log evidence for each flip of signs (F, P), at the best size."""
        columns = residual_of(columns)
        scores = np.zeros((int(of_row.max()) + 1, columns.shape[1]))  # of each pose
        np.add.at(scores, of_row, columns * data)
        values, vectors = np.linalg.eigh(columns.T @ columns)
        values = np.maximum(values, 0.0)
        sizes = np.array(EVIDENCE.sizes)[:, None] ** 2
        explained = (signs @ scores @ vectors) ** 2 @ (sizes / (1.0 + sizes * values)).T
        return np.asarray(0.5 * (explained - np.log1p(sizes * values).sum(axis=1)).max(axis=1))

    (of_member,) = gain(rows.own[:, rows.members[k]], np.ones((1, signs.shape[1])))
    highest = np.full(len(signs), -np.inf)
    for columns in rows.family:
        highest = np.maximum(highest, gain(columns, signs))
    return float((1 + np.count_nonzero(highest >= of_member)) / (1 + len(signs)))


def _influential_pose(
    rows: WhitenedRows, k: int, pose: Index, labels: NDArray[np.str_], needed: float
) -> str | None:
    """Return the pose without which member k has little evidence; None if there is none."""
    others = np.delete(np.arange(rows.own.shape[1]), rows.members[k])
    total = Gaussian.of(rows.own, rows.data)

    def evidence_of_member(equations: Gaussian) -> float:
        return equations.log_evidence - equations.along(others).log_evidence

    of_each = (pose[rows.cell] == number for number in range(len(labels)))
    of_poses = (Gaussian.of(rows.own[at], rows.data[at]) for at in of_each)
    without = np.array([evidence_of_member(total - of_pose) for of_pose in of_poses])
    return most_influential_pose(labels, without, evidence_of_member(total), needed)


def _cross_validation(
    rows: WhitenedRows, k: int, fold_of_cell: Index, pose_of_cell: Index
) -> CrossValidation:
    """Return how well member k predicts each fold, all parameters being fitted to the others."""
    fold, pose = fold_of_cell[rows.cell], pose_of_cell[rows.cell]
    without = np.delete(rows.own, rows.members[k], axis=1)
    squares = np.bincount(pose, cv_residual(rows.data, rows.own, fold) ** 2)
    squares_without = np.bincount(pose, cv_residual(rows.data, without, fold) ** 2)
    gain = squares_without - squares
    spread = float(gain.std(ddof=1)) / np.sqrt(len(gain))
    return CrossValidation(
        explained=float(gain.sum() / squares_without.sum()),
        z=float(gain.mean() / spread) if spread > 0.0 else 0.0,
    )
