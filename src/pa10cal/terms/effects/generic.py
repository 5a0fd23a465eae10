"""Generic effects, rivals of the named ones: something smooth is missing here, of unknown cause."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations_with_replacement, product
from typing import Any, ClassVar

import numpy as np
from numpy.polynomial.legendre import legder, legval, legvander

from pa10cal.arm.chain import BASE
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array
from pa10cal.terms.effects.context import CandidateContext, Span
from pa10cal.terms.effects.effect import Effect, JointEffect, time_in
from pa10cal.terms.effects.readings import FalseReading
from pa10cal.terms.term import JointTorqueOnly, TermParameter

#: A campaign that was shorter shows no shape [s].
_LEAST_SPAN = 1e-3


def _monomials() -> Iterator[tuple[int, ...]]:
    """Yield the factors, 0 to 2 for x to z, of every monomial of degree 1 to 3."""
    for degree in (1, 2, 3):
        yield from combinations_with_replacement(range(3), degree)


def _bows() -> Iterator[tuple[int, ...]]:
    """Yield the bow of each axis along each, as places among all monomials of the three axes.

    It is of degree 2 and 3: a guideway that is not straight, or whose scale is not even. What is
    linear has a name.
    """
    every = tuple(_monomials())
    for axis, along in product(range(3), repeat=2):
        yield tuple(axis * len(every) + every.index((along,) * degree) for degree in (2, 3))


@dataclass(frozen=True)
class PlaceMap(FalseReading):
    """The reading of each axis is off by a smooth function of place.

    Monomials of degree 1 to 3 in the three coordinates about a fixed middle, in units of 0.3 m;
    each parameter [m] is the error along one axis where its monomial is one.
    """

    # where the coordinates are counted from, in the instrument's frame
    middle_instr_m: tuple[float, float, float]
    id = "place_map"
    words = "reading of each axis += polynomial of degree 3 in the place"
    generic = True
    parts = tuple(_bows())
    unit_m = 0.3
    plausible_m: ClassVar[dict[int, float]] = {1: 3e-5, 2: 1e-4, 3: 3e-5}

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...]:
        return (tuple(context.p_instr_middle_m.tolist()),)

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        """Return 19 monomials for the reading of x, then of y, then of z."""
        return tuple(
            TermParameter(
                f"{axis}_by_{''.join('xyz'[k] for k in factors)}",
                "m",
                3e-6,
                plausible=self.plausible_m[len(factors)],
            )
            for axis in "xyz"
            for factors in _monomials()
        )

    def field(self, p_instr_m: Array) -> Array:
        place = (p_instr_m - np.array(self.middle_instr_m)) / self.unit_m
        values = np.stack([place[..., list(factors)].prod(-1) for factors in _monomials()], -1)
        field: Array = np.eye(3)[:, :, None] * values[..., None, None, :]
        return field.reshape(*p_instr_m.shape, -1)


@dataclass(frozen=True)
class TorqueMap(JointTorqueOnly, JointEffect):
    """The joint carries, beyond the weights, a torque that is a smooth function of its angle.

    Legendre polynomials of degree 1 to 4 over the measured span of the angle [N m].
    """

    span_rad: Span  # lowest and highest measured angle
    rated_Nm: float  # rated torque of the joint
    id = "torque_map"
    words = "tau_{0.joint} += Legendre polynomials 1 to {0.degrees} of q_{0.joint}"
    acts_on_joint = True
    generic = True
    degrees = 4

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        return _by_degree(self.degrees, "N m", 1e-3 * self.rated_Nm, 0.02 * self.rated_Nm)

    def per_unit(self, states: PoseStates) -> Array:
        return _degrees(states.q_rad[:, self.joint - 1], self.span_rad, self.degrees)


@dataclass(frozen=True)
class WindupMap(JointEffect):
    """The joint deflects further by a smooth function of the torque it carries.

    Legendre polynomials of degree 1 to 5 over the span of the torque, either sign [rad].
    """

    span_Nm: float  # largest torque that the joint carried
    id = "windup_map"
    varies_with = "its torque"
    yields = True
    words = "theta_{0.joint} -= Legendre polynomials 1 to {0.degrees} of tau_{0.joint}"
    generic = True
    degrees = 5

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        return _by_degree(self.degrees, "rad", 1e-5, 2e-4)

    def per_unit(self, states: PoseStates) -> Array:
        tau_Nm = states.tau_Nm[:, self.joint - 1]
        return -_degrees(tau_Nm, (-self.span_Nm, self.span_Nm), self.degrees)

    def by_torque(self, states: PoseStates, x: Array) -> Array:
        slopes = legder(np.concatenate([[0.0], x]))
        slope = legval(states.tau_Nm[:, self.joint - 1] / self.span_Nm, slopes)
        return np.asarray(-slope / self.span_Nm, dtype=np.float64)


@dataclass(frozen=True)
class DirectionMap(JointEffect):
    """The joint stops elsewhere by its direction of arrival, the more or less with torque or angle.

    s_j times Legendre polynomials: of degree 0 to 3 in the torque's size, where the joint carried
    any, and of degree 1 and 2 in its angle [rad].
    """

    span_Nm: float  # largest torque that the joint carried, 0 where it carried none
    span_rad: Span  # lowest and highest angle
    id = "direction_map"
    varies_with = "the direction of arrival"
    yields = True
    words = "theta_{0.joint} += s_{0.joint} times Legendre polynomials of torque and angle"
    generic = True

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...] | None:
        span_rad = context.span_at(joint)
        return (context.carried_at(joint), span_rad) if span_rad else None

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        """Return the part that is always there, those with torque, and those with angle."""
        of_torque = ("torque_1", "torque_2", "torque_3") if self.span_Nm else ()
        names = ("constant", *of_torque, "angle_1", "angle_2")
        return tuple(TermParameter(name, "rad", 1e-5, plausible=2e-4) for name in names)

    @property
    def arriving(self) -> tuple[int, ...]:
        return (self.joint,)

    def per_unit(self, states: PoseStates) -> Array:
        q_rad = states.q_rad[:, self.joint - 1]
        parts = [np.ones((len(q_rad), 1)), _degrees(q_rad, self.span_rad, 2)]
        if self.span_Nm:
            size_Nm = np.abs(states.tau_Nm[:, self.joint - 1])
            parts.insert(1, _degrees(size_Nm, (0.0, self.span_Nm), 3))
        return np.asarray(states.arrival[:, self.joint - 1, None] * np.concatenate(parts, axis=1))

    def by_torque(self, states: PoseStates, x: Array) -> Array:
        if not self.span_Nm:
            return np.zeros(len(states))
        tau_Nm = states.tau_Nm[:, self.joint - 1]
        slopes = legval(
            2.0 * np.abs(tau_Nm) / self.span_Nm - 1.0, legder(np.concatenate([[0.0], x[1:4]]))
        )
        along = states.arrival[:, self.joint - 1] * np.sign(tau_Nm)
        return np.asarray(along * slopes * 2.0 / self.span_Nm, dtype=np.float64)


@dataclass(frozen=True)
class ArrivalMap(JointEffect):
    """The joint stops elsewhere by its direction of arrival, each angle by an amount of its own.

    s_j times a straight line from knot to knot of its angle [rad], as where a gear is worn in the
    angles at which it works. It is no candidate of the search, and predicts where `direction_map`
    shows that the direction of arrival matters.
    """

    span_rad: Span  # lowest and highest measured angle, beyond which it is as at these
    id = "arrival_map"
    varies_with = "the direction of arrival"
    words = "theta_{0.joint} += s_{0.joint} times a line through {0.knots} knots of q_{0.joint}"
    generic = True
    role_in_search = "proposed"
    knots = 17

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...] | None:
        span_rad = context.span_at(joint)
        return (span_rad,) if span_rad else None

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        """Return what the joint is off at each knot, from the lowest angle on."""
        return tuple(
            TermParameter(f"knot_{k:02d}", "rad", 1e-5, plausible=2e-4) for k in range(self.knots)
        )

    @property
    def arriving(self) -> tuple[int, ...]:
        return (self.joint,)

    def per_unit(self, states: PoseStates) -> Array:
        low, high = self.span_rad
        place = (states.q_rad[:, self.joint - 1] - low) / (high - low) * (self.knots - 1)
        away = np.abs(np.clip(place, 0.0, self.knots - 1)[:, None] - np.arange(self.knots))
        side = states.arrival[:, self.joint - 1, None]
        return np.asarray(side * np.maximum(1.0 - away, 0.0))


@dataclass(frozen=True)
class DriftMap(Effect):
    """The base shifts [m] and turns [rad] by a smooth function of time.

    Legendre polynomials of degree 1 to 3 over the campaign, for each of its six small motions.
    """

    span_s: tuple[float, float]  # first and last reading
    id = "drift_map"
    varies_with = "time"
    depends_on = "time_s"
    sits = "base"
    words = "each motion of the base += Legendre polynomials 1 to {0.degrees} of time"
    coordinates = BASE
    generic = True
    degrees = 3

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...] | None:
        first, last = context.time_span_s
        return ((first, last),) if last - first > _LEAST_SPAN else None

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        """Return three degrees of the first motion, then of the second, …"""
        return tuple(
            TermParameter(
                f"{name.removeprefix('base.')}_degree_{k}",
                "rad" if ".r" in name else "m",
                1e-6,
                plausible=3e-5,
            )
            for name in BASE
            for k in range(1, self.degrees + 1)
        )

    def per_unit(self, states: PoseStates) -> Array:
        # In poses of no time (nan) the base is where its frame has it.
        values = np.nan_to_num(_degrees(time_in(states, self), self.span_s, self.degrees))
        return np.asarray(np.eye(len(BASE))[:, :, None] * values[:, None, None, :])


def _by_degree(
    degrees: int, unit: str, scale: float, plausible: float
) -> tuple[TermParameter, ...]:
    """Return a parameter a degree, from 1, the less plausible the higher."""
    return tuple(
        TermParameter(f"degree_{k}", unit, scale, plausible=plausible / k)
        for k in range(1, degrees + 1)
    )


def _degrees(value: Array, span: tuple[float, float], degrees: int) -> Array:
    """Return Legendre polynomials 1 … degrees over a span (carried on past its ends), (P, k)."""
    low, high = span
    polynomials = legvander((2.0 * value - low - high) / (high - low), degrees)[:, 1:]
    return np.asarray(polynomials, dtype=np.float64)
