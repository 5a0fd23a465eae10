"""How far poses would separate effects that are rivals: a criterion for the choice of poses.

The separation of an effect from its rival is the expected difference of their log evidence if the
effect is present in the size found: D / 2 log(1 + S / D), where S is the sum of squares of its
signal that the rival and the model's own parameters cannot follow, and D the number of measured
components (`SeparationCriterion`). Either may be present, so the smaller of both counts.

Signal and adjustable columns are taken from the derivatives of the campaign's poses and of the
candidates (`_Rows`). No reading counts, so that candidates need not have been measured.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pa10cal.arrays import Array
from pa10cal.discovery.evidence.candidates import linearise
from pa10cal.discovery.evidence.fit import EvidenceFit
from pa10cal.discovery.evidence.noise_model import NoiseModel
from pa10cal.discovery.evidence.problem import EvidenceProblem
from pa10cal.discovery.rules import EVIDENCE
from pa10cal.numerics.pose_sets import Combined, SeparationCriterion
from pa10cal.observe.instrument import group_means
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.term import shows_torque


def separation_criteria(
    problem: EvidenceProblem,
    found: EvidenceFit,
    pairs: Sequence[tuple[Effect, Effect | None]],
    candidates: EvidenceProblem,
) -> list[Combined]:
    """Return, for every pair, the lesser separation of either effect from the other.

    Args:
        problem: the campaign.
        found: the fit of the model with what was found.
        pairs: effects, each with its rival; None for the model's own parameters alone.
        candidates: the problem of the poses that may be chosen, see `as_if_measured`.
    """
    rows = _Rows.of(problem, found, pairs, candidates)
    criteria = []
    for effect, rival in pairs:
        both_ways = [rows.separation(effect, rival)]
        if rival is not None:
            both_ways.append(rows.separation(rival, effect))
        criteria.append(Combined(both_ways))
    return criteria


@dataclass(frozen=True, eq=False)
class _Rows:
    """Derivatives at C measured poses, then at N candidates, each with b rows of unit variance."""

    # (C + N, b, k) by the model's own parameters and the errors common to all poses, each in its
    # expected size
    by_model: Array
    # (C + N, b, q) by the parameters of each effect, in its size; the largest for an effect that is
    # not in the fit
    by_effect: Mapping[Effect, Array]
    as_found: Mapping[Effect, Array]  # (C + N, b, 1) of each effect of the fit, in its amount
    measured_count: int  # C
    components: int  # components of all poses of the campaign, repeats counted once

    @classmethod
    def of(
        cls,
        problem: EvidenceProblem,
        found: EvidenceFit,
        pairs: Sequence[tuple[Effect, Effect | None]],
        candidates: EvidenceProblem,
    ) -> _Rows:
        """Return the rows by the effects of a fit and of pairs; see `separation_criteria`."""
        members = (effect for pair in pairs for effect in pair if effect is not None)
        effects = tuple(dict.fromkeys([*found.effects, *members]))
        measured = _by_parameters(problem, found, effects)
        further = _by_parameters(candidates, found, effects)
        _, pose = np.unique(problem.cells.pose, return_inverse=True)
        never_seen = group_means(problem.cells.measured.components_seen.astype(float), pose) == 0.0
        components = len(never_seen) * measured.by_model.shape[1] - int(never_seen.sum())
        rows = {e: np.concatenate([measured.by_effect[e], further.by_effect[e]]) for e in effects}
        sizes = dict.fromkeys(effects, EVIDENCE.sizes[-1])
        sizes |= {effect: EVIDENCE.sizes[size] for effect, size in found.size_of.items()}
        amounts = {e: found.at.values_of(e)[: e.linear, None] for e in found.effects}
        return cls(
            by_model=np.concatenate([measured.by_model, further.by_model]),
            by_effect={e: rows[e] @ measured.prior_factor[e] * sizes[e] for e in effects},
            as_found={e: rows[e][..., : e.linear] @ amount for e, amount in amounts.items()},
            measured_count=len(measured.by_model),
            components=round(problem.poses_a_cell * components),
        )

    def separation(self, truth: Effect, rival: Effect | None) -> SeparationCriterion:
        """Return the separation of a true effect from all that may be adjusted instead."""
        signal = self._signal(truth, rival)
        rows = np.concatenate([self._adjustable(truth, rival), signal], axis=2)
        k = rows.shape[2]
        known = np.concatenate([rows[: self.measured_count].reshape(-1, k), np.eye(k)])
        return SeparationCriterion(
            rows[self.measured_count :], known, signal.shape[2], self.components
        )

    def _adjustable(self, truth: Effect, rival: Effect | None) -> Array:
        """Return columns of all that may be adjusted if an effect is true, the rival last."""
        effects = [effect for effect in self.as_found if effect not in (truth, rival)]
        effects += [] if rival is None else [rival]
        return np.concatenate([self.by_model, *(self.by_effect[e] for e in effects)], axis=2)

    def _signal(self, truth: Effect, rival: Effect | None) -> Array:
        """Return the signal (C + N, b, m) of an effect if it is true.

        It has the amount found; or else the amount with which it best imitates its rival that was
        found; or else plausible amounts of each parameter, on average over its shapes.
        """
        if truth in self.as_found:
            return self.as_found[truth]
        by_truth = self.by_effect[truth]
        if rival is None or rival not in self.as_found:
            return np.asarray(by_truth / (EVIDENCE.sizes[-1] * np.sqrt(len(truth.starts))))
        columns = self._adjustable(rival, truth)[: self.measured_count]
        k = columns.shape[2]
        rows = np.concatenate([columns.reshape(-1, k), np.eye(k)])
        target = np.append(self.as_found[rival][: self.measured_count], np.zeros(k))
        imitating = np.linalg.lstsq(rows, target, rcond=None)[0][-by_truth.shape[2] :]
        return np.asarray(by_truth @ imitating[:, None])


class _ByParameters(NamedTuple):
    """Derivatives at the C poses of one problem, each with b rows divided by their noise."""

    # (C, b, k) by the model's own parameters and the errors common to all poses, each in its
    # expected size; candidates share these errors with the measured poses
    by_model: Array
    by_effect: dict[Effect, Array]  # (C, b, q) by the parameters of each effect
    prior_factor: dict[Effect, Array]  # (q, q) of each effect


def _by_parameters(
    problem: EvidenceProblem, found: EvidenceFit, effects: tuple[Effect, ...]
) -> _ByParameters:
    """Return the derivatives at a problem's poses, of torques after those of the components.

    An effect of a quantity that is not known of the poses has rows of zero: they cannot show it.
    """
    lin, pose = linearise(problem, found, effects), problem.pose

    def scaled(channel: NoiseModel, variance: float, rows: Array) -> Array:
        """Return rows divided by their noise with the error that all readings of a pose share."""
        divided = rows / np.sqrt(1.0 + variance * channel.shared.variance)[:, None]
        return divided.reshape(len(channel.whitener), -1, rows.shape[1])

    # by the model, then by each effect
    parts = [np.hstack([lin.own, pose.common]), *(block.pose for block in lin.blocks)]
    parts = [scaled(pose, found.variances.pose, part) for part in parts]
    if problem.torque is not None and any(shows_torque(effect) for effect in effects):
        torque = problem.torque
        # Effects alone show in poses and torques both: all other columns are zero in one of them.
        of_poses, of_torque = parts[0].shape[2], torque.common.shape[1]
        parts[0] = np.pad(parts[0], [(0, 0), (0, 0), (0, of_torque)])
        of_torques = [np.pad(torque.common, [(0, 0), (of_poses, 0)])]
        of_torques += [block.torque for block in lin.blocks]
        parts = [
            np.concatenate([part, scaled(torque, found.variances.torque, more)], axis=1)
            for part, more in zip(parts, of_torques, strict=True)
        ]
    by_model, *by_effects = parts
    known = [rows if np.all(np.isfinite(rows)) else np.zeros_like(rows) for rows in by_effects]
    return _ByParameters(
        by_model=by_model,
        by_effect=dict(zip(effects, known, strict=True)),
        prior_factor={e: block.factor for e, block in zip(effects, lin.blocks, strict=True)},
    )
