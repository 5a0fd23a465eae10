"""Rows along a path: poses that follow each other so closely that each is known by its neighbours.

Where every n-th of them is held out, an error there says what happens between measured places. How
well poses are predicted where nothing was measured, only whole stretches show that are held out
(block cross-validation: Roberts et al., Ecography 40, 2017).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from pa10cal.arrays import Array, Index, Mask
from pa10cal.observe.observations import Observations

#: Poses nearer to each other than this part of the spread of all of them are neighbours.
NEIGHBOURS = 0.03
#: Stretches of a path that are held out, and the part of what is held out that goes singly.
_STRETCHES, _SINGLY = 5, 0.1
#: Of held-out poses whose neighbours were mostly fitted, fewer than this part count as these.
_FEW = 0.1
#: A joint that turned less [rad, or m of one that slides] has not moved on.
_STOOD_STILL = 1e-4


def spread_of(q: Array) -> float:
    """Return the root mean square distance of joint positions (P, n) from their mean [rad, m]."""
    return float(np.sqrt(np.mean(np.sum((q - q.mean(axis=0)) ** 2, axis=1))))


def along_a_path(q: Array) -> bool:
    """Return whether joint positions (P, n), in order of time, follow each other along a path."""
    moves = np.linalg.norm(np.diff(q, axis=0), axis=1)
    moves = moves[moves > _STOOD_STILL]
    return bool(len(moves)) and float(np.median(moves)) < NEIGHBOURS * spread_of(q)


def stretches_held_out(count: int, held: int) -> Index:
    """Return which of so many poses along a path are held out, so many of them.

    Most go in stretches of equal length, the last one at the end of the path. Others go singly, out
    of what stays: they show the error between measured places.
    """
    singly, away = round(_SINGLY * held), np.zeros(count, dtype=bool)
    parts = np.array_split(np.arange(count), _STRETCHES)
    for part, out in zip(parts, np.array_split(np.arange(held - singly), _STRETCHES), strict=True):
        away[part[len(part) - len(out) :]] = True
    rest = np.flatnonzero(~away)
    away[rest[np.linspace(0, len(rest) - 1, singly + 2).round().astype(np.intp)[1:-1]]] = True
    return np.flatnonzero(away)


@dataclass(frozen=True, eq=False)
class HeldOutPlaces:
    """Which of P held-out poses lie where nothing was measured, and which beside fitted ones."""

    unseen: Mask | None = None  # (P,) at unseen stretches; None where none does
    between: Mask | None = None  # (P,) between measured places; None where none does

    @classmethod
    def of(cls, held_out: Observations, fitted: Observations) -> HeldOutPlaces:
        """Return where held-out poses lie, both averaged; neither where poses are well apart."""
        away, near = held_out.states, fitted.states
        return cls.of_positions((away.q_rad, away.time_s), (near.q_rad, near.time_s))

    @classmethod
    def of_positions(
        cls, held_out: tuple[Array, Array], fitted: tuple[Array, Array]
    ) -> HeldOutPlaces:
        """Return the same of joint positions (P, n), each with the times of its poses (P,) [s]."""
        q, away = fitted[0], held_out[0]
        if not len(q) or not len(away):
            return cls()
        beside = np.asarray(cKDTree(q).query(away)[0] < NEIGHBOURS * spread_of(q))
        time_s = np.concatenate([fitted[1], held_out[1]])
        path = along_a_path(np.concatenate([q, away])[np.argsort(time_s, kind="stable")])
        if not path and np.mean(beside) < 0.5:
            return cls()
        if np.mean(beside) >= 1.0 - _FEW:
            beside[:] = True
        return cls(*(rows if rows.any() else None for rows in (~beside, beside)))

    def counted(self, trusted: Mask) -> Mask:
        """Return the poses (P,) of a headline: those trusted (P,), at unseen stretches if any."""
        if self.unseen is None:
            return trusted
        rows = self.unseen & trusted
        return rows if rows.any() else self.unseen
