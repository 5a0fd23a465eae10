"""Where poses lie among others: along a path, near them, or outside the positions of their joints.

An error at every n-th pose held out shows only how well the model interpolates between measured
poses. How well it predicts where nothing was measured needs whole stretches held out (block
cross-validation: Roberts et al., Ecography 40, 2017).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from pa10cal.arrays import Array, Index, Mask
from pa10cal.observe.observations import Observations
from pa10cal.rules import ORDER


def spread_of(q: Array) -> float:
    """Return the root mean square distance of joint positions (P, n) from their mean [rad, m]."""
    return float(np.sqrt(np.mean(np.sum((q - q.mean(axis=0)) ** 2, axis=1))))


def outside_ranges(q: Array, others: Array) -> Mask:
    """Return which joint positions (P, n) lie outside the ranges of others (N, n), (P,)."""
    low, high = others.min(axis=0), others.max(axis=0)
    return np.asarray(np.any((q < low) | (q > high), axis=1))


def along_a_path(q: Array) -> bool:
    """Return whether joint positions (P, n) in order of time lie close together along a path."""
    moves = np.linalg.norm(np.diff(q, axis=0), axis=1)
    moves = moves[moves > ORDER.stood_still]
    return bool(len(moves)) and float(np.median(moves)) < ORDER.neighbours * spread_of(q)


def stretches_held_out(count: int, held: int) -> Index:
    """Return which `held` of `count` poses along a path are held out, rising.

    Most are held out in stretches of equal length, the last one at the end of the path. The others
    are single poses among those that stay: they show the error between measured poses.
    """
    single_count, held_out = round(ORDER.singly_share * held), np.zeros(count, dtype=bool)
    sections = np.array_split(np.arange(count), ORDER.stretches)
    stretches = np.array_split(np.arange(held - single_count), ORDER.stretches)
    for section, stretch in zip(sections, stretches, strict=True):
        held_out[section[len(section) - len(stretch) :]] = True
    stay = np.flatnonzero(~held_out)
    # Evenly spread, without the first and the last.
    single = np.linspace(0, len(stay) - 1, single_count + 2).round().astype(np.intp)[1:-1]
    held_out[stay[single]] = True
    return np.flatnonzero(held_out)


@dataclass(frozen=True, eq=False)
class HeldOutPlaces:
    """Which of P held-out poses lie near fitted poses, and which do not.

    Both masks are None where poses are so far apart that each is a place of its own.
    """

    unseen: Mask | None = None  # (P,) in stretches without fitted poses; None if there is none
    between: Mask | None = None  # (P,) between fitted poses; None if there is none

    @classmethod
    def of(cls, held_out: Observations, fitted: Observations) -> HeldOutPlaces:
        """Return where averaged held-out poses lie."""
        out, fit = held_out.states, fitted.states
        return cls.of_positions(out.q_rad, out.time_s, fit.q_rad, fit.time_s)

    @classmethod
    def of_positions(
        cls, q_out: Array, time_out_s: Array, q_fitted: Array, time_fitted_s: Array
    ) -> HeldOutPlaces:
        """Return where P held-out joint positions (P, n) lie among N fitted ones (N, n)."""
        if not len(q_fitted) or not len(q_out):
            return cls()
        distance = cKDTree(q_fitted).query(q_out)[0]
        near_fitted = np.asarray(distance < ORDER.neighbours * spread_of(q_fitted))
        in_time = np.argsort(np.concatenate([time_fitted_s, time_out_s]), kind="stable")
        path = along_a_path(np.concatenate([q_fitted, q_out])[in_time])
        if not path and np.mean(near_fitted) < ORDER.beside_share:
            return cls()
        if np.mean(near_fitted) >= 1.0 - ORDER.few_share:
            near_fitted[:] = True
        unseen = ~near_fitted
        return cls(unseen if unseen.any() else None, near_fitted if near_fitted.any() else None)

    def counted(self, trusted: Mask) -> Mask:
        """Return the poses (P,) whose errors are reported: unseen ones if there are any.

        Of these only trusted ones, without a suspected outlier. Where no unseen pose is trusted,
        all of them count: the model may be what is wrong there, and errors between fitted poses
        say nothing of it.
        """
        if self.unseen is None:
            return trusted
        rows = self.unseen & trusted
        return rows if rows.any() else self.unseen
