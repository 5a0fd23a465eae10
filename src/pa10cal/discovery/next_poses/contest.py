"""An effect against its rival: rows of both, measured and foreseen, each way round."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular

from pa10cal.arrays import Array
from pa10cal.discovery.evidence.candidates import linearise
from pa10cal.discovery.evidence.fit import Fit
from pa10cal.discovery.evidence.likelihood import SIZES
from pa10cal.discovery.evidence.problem import NoiseModel, Problem
from pa10cal.errors import DiscoveryError
from pa10cal.terms.effects.effect import Effect
from pa10cal.terms.term import shows_torque

#: An effect and what may stand in its place: another, or the model's own parameters alone.
Pair = tuple[Effect, Effect | None]

#: Any size is granted to an effect that is not in the fit.
_ANY_SIZE = SIZES[-1]


@dataclass(frozen=True)
class _Rows:
    """Weighed rows of C poses with b components each."""

    # (C, b, k) of the model's own parameters and of the errors common to all poses, at the size
    # expected of them
    own: Array
    blocks: dict[Effect, Array]  # (C, b, k') of each effect, a unit of each parameter
    factors: dict[Effect, Array]  # (k', k') of each effect, for the size expected of it


def outlooks(
    problem: Problem, found: Fit, pairs: Sequence[Pair], ahead: Problem
) -> list[tuple[Outlook, ...]]:
    """Return, for every pair, the outlook with the effect for the truth, and with the rival.

    Args:
        problem: the campaign.
        found: a fit to it.
        pairs: effects and what may stand in their place.
        ahead: the same for poses that could be measured.

    Raises:
        DiscoveryError: when an effect needs what is not known of these poses.
    """
    members = (effect for pair in pairs for effect in pair if effect is not None)
    effects = tuple(dict.fromkeys([*found.effects, *members]))
    with_torque = any(shows_torque(effect) for effect in effects)
    poses = len(np.unique(problem.cells.pose))
    now = _rows(problem, found, effects, with_torque)
    then = _rows(ahead, found, effects, with_torque)
    both_ways = []
    for effect, rival in pairs:
        ways: list[Pair] = [(effect, rival)]
        if rival is not None:
            ways.append((rival, effect))
        both_ways.append(tuple(_outlook(found, now, then, a, b, poses) for a, b in ways))
    return both_ways


def _outlook(
    found: Fit, now: _Rows, then: _Rows, truth: Effect, rival: Effect | None, poses: int
) -> Outlook:
    """Return the outlook of telling the truth from its rival and the model's own parameters."""
    x = _taken_for_true(found, now, truth, rival)
    present, true = _adjustable(found, now, truth, rival), now.blocks[truth] @ x
    return Outlook.of(
        present.reshape(-1, present.shape[2]),
        true.reshape(-1, true.shape[2]),
        _adjustable(found, then, truth, rival),
        then.blocks[truth] @ x,
        poses,
    )


def _adjustable(found: Fit, rows: _Rows, truth: Effect, rival: Effect | None) -> Array:
    """Return rows of all that may be adjusted, the rival last, (C, b, k)."""
    sizes = {effect: SIZES[size] for effect, size in zip(found.effects, found.sizes, strict=True)}
    effects = [effect for effect in found.effects if effect not in (truth, rival)]
    columns = [
        rows.blocks[effect] @ rows.factors[effect] * sizes.get(effect, _ANY_SIZE)
        for effect in (*effects, *([] if rival is None else [rival]))
    ]
    return np.concatenate([rows.own, *columns], axis=2)


def _taken_for_true(found: Fit, now: _Rows, truth: Effect, rival: Effect | None) -> Array:
    """Return parameters (k', m) of an effect taken for the truth.

    Those found; else those with which it passes for its rival that was found; else what is
    plausible of each, on average over its shapes.
    """
    if truth in found.effects:
        return _amount(found, truth)[:, None]
    factor = now.factors[truth]
    if rival is None or rival not in found.effects:
        return np.asarray(factor / np.sqrt(len(truth.starts)))
    columns = _adjustable(found, now, rival, truth)
    k = columns.shape[2]
    rows = np.concatenate([columns.reshape(-1, k), np.eye(k)])
    target = np.concatenate([(now.blocks[rival] @ _amount(found, rival)).ravel(), np.zeros(k)])
    passes = np.linalg.lstsq(rows, target, rcond=None)[0][-len(factor) :]
    return np.asarray(_ANY_SIZE * factor @ passes)[:, None]


def _amount(found: Fit, effect: Effect) -> Array:
    """Return the parameters of an effect in the fit that it is proportional to, zero the others."""
    x = found.of(effect).copy()
    x[effect.linear :] = 0.0
    return x


def _rows(problem: Problem, found: Fit, effects: tuple[Effect, ...], with_torque: bool) -> _Rows:
    """Return the weighed rows of a problem's poses.

    Raises:
        DiscoveryError: when an effect needs what is not known of them.
    """
    lin = linearise(problem, found, effects)
    kinds = [(problem.pose, found.pose_variance, lin.own, [b.pose for b in lin.blocks])]
    if problem.torque is not None and with_torque:
        none = np.zeros((len(problem.torque.common), 0))
        blocks = [b.torque for b in lin.blocks]
        kinds.append((problem.torque, found.torque_variance, none, blocks))
    own = [
        _weighed(channel, variance, np.concatenate([own, channel.common], axis=1))
        for channel, variance, own, _ in kinds
    ]
    if len(own) == 2:  # nothing but effects is seen in poses and torques both
        own[0] = np.pad(own[0], [(0, 0), (0, 0), (0, own[1].shape[2])])
        own[1] = np.pad(own[1], [(0, 0), (0, 0), (own[0].shape[2] - own[1].shape[2], 0)])
    found_rows = _Rows(
        own=np.concatenate(own, axis=1),
        blocks={
            effect: np.concatenate(
                [_weighed(channel, v, blocks[k]) for channel, v, _, blocks in kinds], axis=1
            )
            for k, effect in enumerate(effects)
        },
        factors={effect: b.factor for effect, b in zip(effects, lin.blocks, strict=True)},
    )
    for effect, block in found_rows.blocks.items():
        if not np.all(np.isfinite(block)):
            raise DiscoveryError(
                "the effect depends on a quantity that is unknown for future poses",
                where=f"{effect.id} of {effect.of}",
                allowed="effects of logged quantities",
                remedy="omit the effect",
            )
    return found_rows


def _weighed(channel: NoiseModel, variance: float, rows: Array) -> Array:
    """Return rows (C b, k) scaled to unit variance, as (C, b, k).

    Errors common to all poses have columns of their own: future poses share them.
    """
    scaled = rows / np.sqrt(1.0 + variance * channel.shared_size)[:, None]
    return scaled.reshape(len(channel.whitener), -1, rows.shape[1])


# How well what else may be adjusted could do the work of an effect, and what poses would add.
#
# Everything is linear about a fit and every adjustable parameter has an expected size, so the rows
# of a pose are taken in as in recursive least squares: what the rest cannot follow adds to the
# separation, and what it learns sharpens what it will say of every other pose.
#
# A sum of squares S that cannot be followed costs a model S / 2 in log evidence where it is small.
# Where it is large, the model may lay it to an error of unknown cause at every pose: with the
# variance of that error chosen to suit, D components of all poses cost D / 2 log(1 + S / D).


@dataclass(frozen=True)
class Outlook:
    """What distinguishes an effect from all that may replace it."""

    # (N, b, k) weighed rows of N poses that could be measured: of the adjustable parameters, a
    # unit of each being what is expected of it
    adjustable: Array
    cov: Array  # (k, k) covariance of these parameters, as known so far
    # (N, b, m) rows of the effect in these poses, less what the rest says of them; of an effect of
    # unknown size, m equally likely contributions that add up in squares
    left: Array
    spread: Array  # (N, b, b) covariance of what the rest says
    energy: float  # sum of squares of the effect that the rest could not follow so far
    components: int  # D, of all poses measured so far

    @classmethod
    def of(
        cls,
        present: Array,
        effect: Array,
        adjustable: Array,
        ahead: Array,
        poses: int,
    ) -> Outlook:
        """Start with what was measured.

        Args:
            present: (R, k) weighed rows of the adjustable parameters in what was measured.
            effect: (R, m) of the effect, in its size.
            adjustable: (N, b, k) of the adjustable parameters in what could be measured.
            ahead: (N, b, m) of the effect there.
            poses: how many different poses were measured.
        """
        k = present.shape[1]
        q, triangle = np.linalg.qr(np.concatenate([present, np.eye(k)]))
        inverse = solve_triangular(triangle, np.eye(k))
        rest = inverse @ (q[: len(present)].T @ effect)
        missed = np.concatenate([effect - present @ rest, rest])
        spread = adjustable @ inverse
        return cls(
            adjustable=adjustable,
            cov=inverse @ inverse.T,
            left=ahead - adjustable @ rest,
            spread=spread @ spread.transpose(0, 2, 1),
            energy=float(np.sum(missed**2)),
            components=poses * adjustable.shape[1],
        )

    @property
    def nats(self) -> float:
        """Separation so far: the expected difference in log evidence."""
        return float(_nats(np.array(self.energy), self.components))

    def nats_with(self) -> Array:
        """Return the separation if one more pose were measured, for each, (N,)."""
        innovation = self.spread + np.eye(self.spread.shape[1])
        gain = np.sum(self.left * np.linalg.solve(innovation, self.left), axis=(1, 2))
        return _nats(self.energy + gain, self.components + self.left.shape[1])

    def after(self, pose: int) -> Outlook:
        """Return the outlook once a pose was measured."""
        rows = self.adjustable[pose]
        root = np.linalg.cholesky(self.spread[pose] + np.eye(len(rows)))
        learned = solve_triangular(root, rows @ self.cov, lower=True).T  # (k, b)
        news = solve_triangular(root, self.left[pose], lower=True)  # (b, m)
        elsewhere = self.adjustable @ learned
        return replace(
            self,
            cov=self.cov - learned @ learned.T,
            left=self.left - elsewhere @ news,
            spread=self.spread - elsewhere @ elsewhere.transpose(0, 2, 1),
            energy=self.energy + float(np.sum(news**2)),
            components=self.components + len(rows),
        )


def _nats(energy: Array, components: int) -> Array:
    """Return what a sum of squares that cannot be followed costs in log evidence."""
    nats: Array = 0.5 * components * np.log1p(energy / components)
    return nats
