"""Waves of a gear whose ratio nobody stated: their cycles a turn are found from the data."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TypeGuard

import numpy as np

from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.terms.effects.effect import AtJoint
from pa10cal.terms.effects.joint import amplitude_and_phase, sine_and_cosine
from pa10cal.terms.term import OPTIONAL, Report, Term, TermParameter


@dataclass(frozen=True)
class GearLine(AtJoint):
    """A sin(k q_j + phi) of a gear whose ratio is not stated, with k cycles a turn of the joint.

    A toothed wheel or a motor off its centre errs once a turn of its own, a harmonic drive twice a
    turn of its wave generator. Searches try it only where the spectrum of the joint's error has a
    line (`discovery/gear_lines`). If the ratio is stated, this effect is
    `transmission_error`. What repeats k times a turn and is no sine has waves at multiples of k.
    """

    order: float = 100.0  # order of the line in the spectrum, about which k is fitted
    width: float = 1.0  # what the joint's range resolves [cycles a turn]; k is fitted within half
    # further waves m, each A_m sin(m k q_j + phi_m)
    multiples: tuple[int, ...] = field(default=(), metadata={OPTIONAL: True})
    id = "gear_line"
    sits = "driven joint"
    clauses = (
        "the gear of {at} errs many times a turn",
        "the gears of {at} err many times a turn",
    )
    words = "theta_{0.joint} += A sin(k q_{0.joint} + phi), k near {0.order:.5g}"
    role_in_search = "proposed"
    amounts_stand_alone = False

    @property
    def linear(self) -> int:
        """Return the number of sines and cosines, to which it is proportional; k shapes it."""
        return 2 * len(self._waves)

    @property
    def formula(self) -> str:
        more = (f" + A_{m} sin({m} k q_{self.joint} + phi_{m})" for m in self.multiples)
        return super().formula.replace(", k near", f"{''.join(more)}, k near")

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        """Return sine and cosine parts and k, which `report` turns into amounts, phases and k."""
        parts = (
            TermParameter(name + _of_multiple(m), "rad", 1e-5, plausible=3e-4)
            for m in self._waves.astype(int).tolist()
            for name in ("sin", "cos")
        )
        low, high = self.order - 0.5 * self.width, self.order + 0.5 * self.width
        return (*parts, TermParameter("k", "1", 0.01, lower=low, upper=high))

    def same_as(self, other: Term) -> bool:
        """Return whether another line is this one: k is a parameter, and their ranges overlap."""
        if not is_gear_line(other) or (self.of, self.multiples) != (other.of, other.multiples):
            return False
        return abs(self.order - other.order) < 0.5 * (self.width + other.width)

    @property
    def starts(self) -> tuple[Array, ...]:
        return (np.array([*np.zeros(self.linear), self.order]),)

    def shift(self, states: PoseStates, x: Array) -> Array:
        shift: Array = self._sines_and_cosines(states, x[-1]) @ x[:-1]
        return shift[:, None]

    def derivative(self, states: PoseStates, x: Array) -> Array:
        waves = self._sines_and_cosines(states, x[-1])
        turned = waves.reshape(-1, len(self._waves), 2)[:, :, ::-1]
        by_phase = turned * (x[:-1].reshape(-1, 2) * [1.0, -1.0])
        by_k = states.q_rad[:, self.joint - 1] * (by_phase.sum(axis=2) @ self._waves)
        return np.concatenate([waves, by_k[:, None]], axis=1)[:, None, :]

    def report(self, x: Array) -> Report:
        parameters: list[TermParameter] = []
        values, jacobian = x.copy(), np.eye(len(x))
        for n, m in enumerate(self._waves.astype(int).tolist()):
            part = slice(2 * n, 2 * n + 2)
            known = amplitude_and_phase(x[part], "rad")
            parameters += [replace(p, name=p.name + _of_multiple(m)) for p in known.parameters]
            values[part], jacobian[part, part] = known.values, known.jacobian
        return Report((*parameters, TermParameter("k", "1", 0.01)), values, jacobian)

    @property
    def _waves(self) -> Array:
        """Return the multiples of k of all its waves (w,), the first of k itself."""
        return np.array([1.0, *self.multiples])

    def _sines_and_cosines(self, states: PoseStates, k: float) -> Array:
        """Return sine and cosine of each wave at poses (P,), (P, 2w)."""
        phases = states.q_rad[:, self.joint - 1, None] * (k * self._waves)
        return sine_and_cosine(phases).reshape(len(phases), -1)


def _of_multiple(m: int) -> str:
    """Return the end of the names of amount and phase of the wave m k."""
    return "" if m == 1 else f"_{m}"


def is_gear_line(term: Term) -> TypeGuard[GearLine]:
    """Return whether a term is a line of a gear."""
    return term.id == GearLine.id
