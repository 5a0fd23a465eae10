"""Effects at joints that slide: rails that are not straight or give way, leads that are off."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from pa10cal.arm.chain import TOOL, Chain, bend_coordinates, frames, link_spans_m
from pa10cal.arm.description import Arm
from pa10cal.arm.statics import PoseStates
from pa10cal.arrays import Array, Index
from pa10cal.terms.effects.context import CandidateContext, Span
from pa10cal.terms.effects.effect import AtJoint, Effect, Limits, static_loads_in
from pa10cal.terms.effects.structure import Compliance
from pa10cal.terms.term import OPTIONAL, Report, TermParameter

#: Errors of rails as they are mounted: 0.05 to 0.5 mm, 0.05 to 0.5 mrad [m, rad].
_SIZE = 2e-4
#: Degrees of the polynomials of the stroke: of the turn that goes with a third half wave of a rail
#: two leave 0.79, four 0.20, six 0.02.
DEGREES = 6


@dataclass(frozen=True)
class AtSlide(AtJoint):
    """An effect of a rail or column, on the six small motions of its carriage.

    A quill slides by a few centimetres, in which an arm that bends or tilts has nearly the same
    effect. The motions are of the frame in which the next joint moves; of the last joint those
    of the tool.
    """

    sits = "slide"
    span_m: Span  # lowest and highest measured position
    along: tuple[float, float, float]  # direction of the stroke, along the axes of that frame

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...] | None:
        """Return its fields at a joint that was moved."""
        span_m, further = context.span_at(joint), cls.fields_of(context.arm, joint)
        if span_m is None or further is None:
            return None
        return span_m, _stroke_axis(context.arm, joint), *further

    @classmethod
    @abstractmethod
    def fields_of(cls, arm: Arm, joint: int) -> tuple[Any, ...] | None:
        """Return its further fields at a joint, from 1; None for not there."""

    @property
    def coordinates(self) -> tuple[str, ...]:
        return TOOL if self.last else bend_coordinates(self.joint)

    @property
    def last(self) -> bool:
        """Return whether no joint follows."""
        return False

    def stroke(self, states: PoseStates) -> Array:
        """Return where the carriage is, (P,): from -1 to 1 over the span, and held beyond."""
        low_m, high_m = self.span_m
        middle_m, half_m = 0.5 * (low_m + high_m), 0.5 * (high_m - low_m)
        from_middle = (states.q_rad[:, self.joint - 1] - middle_m) / half_m
        return np.asarray(np.clip(from_middle, -1.0, 1.0))


@dataclass(frozen=True)
class SlideError(AtSlide):
    """A carriage turns, and shifts across its stroke, by polynomials of the sixth degree.

    Legendre polynomials of u, which is -1 to 1 over the span: of degree 1 and more for the three
    turns, 2 and more for the shifts (straightness). Constants, and shifts across the stroke that
    grow evenly, are parameters of link, base and tool already; shifts along it are
    `slide_positioning` and `gear_ratio_error`. Higher degrees are expected to be smaller. Both
    scorers seek it, alone and in sets.
    """

    at_end: bool = field(default=False, metadata={OPTIONAL: True})  # whether no joint follows
    # whether it shifts along the stroke as well, as in older model files
    also_along: bool = field(default=True, metadata={OPTIONAL: True})
    id = "slide_error"
    nouns = ("slide error", "slide errors")
    clauses = ("{at} does not slide straight and level", "{at} do not slide straight and level")
    # Makers allow a rail a few tenths of a mrad.
    limits = Limits(turn_rad=0.01, why="no carriage that slides turns by more than 10 mrad")
    amounts_stand_alone = False

    @classmethod
    def fields_of(cls, arm: Arm, joint: int) -> tuple[Any, ...]:
        return joint == arm.n, False

    @property
    def last(self) -> bool:
        return self.at_end

    @property
    def formula(self) -> str:
        low_m, high_m = self.span_m
        what = "tool" if self.last else f"frame of joint {self.joint + 1}"
        shifts = "along" if self.also_along else "across the stroke"
        return (
            f"the {what} shifts {shifts} and turns about its axes by sums of Legendre polynomials "
            f"of u, from degree 1 to {DEGREES}, u from -1 at {low_m:g} m to 1 at {high_m:g} m of "
            f"joint {self.joint}; shifts and turns are root mean squares over u"
        )

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        """Return the coefficients, of which `report` makes root mean squares over the stroke."""
        return tuple(
            TermParameter(
                f"{motion}_{degree}",
                "rad" if motion.startswith("r") else "m",
                3e-6,
                plausible=_SIZE / degree,
            )
            for motion, degree in self._series
        )

    def report(self, x: Array) -> Report:
        """Return the root mean square over the stroke of each shift and each turn."""
        directions = self._directions
        # In older files the shift along the stroke has a part along each axis.
        share = np.stack([*directions.values()]) @ self._motions
        values, slope = _rms_over_stroke(share * x, self._degrees)
        names = tuple(
            TermParameter(f"turn_{motion[1]}", "rad", 3e-6)
            if motion.startswith("r")
            else TermParameter(f"shift_{motion}", "m", 3e-6)
            for motion in directions
        )
        return Report(names, values, share * slope)

    def per_unit(self, states: PoseStates) -> Array:
        series = _legendre(self.stroke(states))[:, self._degrees]
        return np.asarray(series[:, None, :] * self._motions)

    @property
    def _directions(self) -> dict[str, Array]:
        """Return the directions (6,) of its shifts and turns, by names."""
        axes = dict(zip(("x", "y", "z", "rx", "ry", "rz"), np.eye(6), strict=True))
        if self.also_along:
            return axes
        # The two axes that are nearest to across the stroke; what they have along it is dropped.
        along = np.array(self.along)
        one, other = sorted(np.argsort(np.abs(along), kind="stable")[:2].tolist())
        first = np.eye(3)[one] - along[one] * along
        first /= np.linalg.norm(first)
        second = np.cross(along, first)
        across = {one: first, other: second * np.sign(second[other])}
        shifts = {"xyz"[axis]: np.append(shift, np.zeros(3)) for axis, shift in across.items()}
        return shifts | {name: axes[name] for name in ("rx", "ry", "rz")}

    @property
    def _series(self) -> tuple[tuple[str, int], ...]:
        """Return motion and degree of each parameter's polynomial."""
        shifts = [name for name in self._directions if not name.startswith("r")]
        return (
            *((("s", 1),) if self.also_along else ()),
            *((name, degree) for degree in range(2, DEGREES + 1) for name in shifts),
            *((name, degree) for degree in range(1, DEGREES + 1) for name in ("rx", "ry", "rz")),
        )

    @property
    def _degrees(self) -> Index:
        return np.array([degree for _, degree in self._series])

    @property
    def _motions(self) -> Array:
        """Return what a unit of each parameter moves, (6, k), where its polynomial is 1."""
        motions = {"s": np.append(self.along, np.zeros(3)), **self._directions}
        return np.stack([motions[name] for name, _ in self._series], axis=1)


@dataclass(frozen=True)
class SlidePositioning(AtSlide):
    """Linear positioning error (ISO 230-2) of a joint that slides, of a lead that is not even.

    As of a rack in pieces, a scale that is stretched or a cable track that pulls. Legendre
    polynomials of degree 2 and more along the stroke, as those of `slide_error`; of degree 1 it is
    `gear_ratio_error`. Both scorers seek it, alone and in sets.
    """

    id = "slide_positioning"
    nouns = ("positioning error along the slide", "positioning errors along the slides")
    clauses = (
        "{at} slides by a wrong length that depends on its position",
        "{at} slide by wrong lengths that depend on their positions",
    )
    amounts_stand_alone = False

    @classmethod
    def fields_of(cls, arm: Arm, joint: int) -> tuple[Any, ...]:
        return ()

    @property
    def formula(self) -> str:
        low_m, high_m = self.span_m
        return (
            f"d_{self.joint} += a sum of Legendre polynomials of u, from degree 2 to {DEGREES}, "
            f"u from -1 at {low_m:g} m to 1 at {high_m:g} m of joint {self.joint}; the shift is a "
            "root mean square over u"
        )

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        """Return the coefficients, of which `report` makes a root mean square over the stroke."""
        return tuple(
            TermParameter(f"s_{degree}", "m", 3e-6, plausible=_SIZE / degree)
            for degree in range(2, DEGREES + 1)
        )

    def report(self, x: Array) -> Report:
        """Return the root mean square of the shift over the stroke."""
        values, slope = _rms_over_stroke(x[None], np.arange(2, DEGREES + 1))
        return Report((TermParameter("shift", "m", 3e-6),), values, slope)

    @property
    def coordinates(self) -> tuple[str, ...]:
        return (f"d_{self.joint}",)

    def per_unit(self, states: PoseStates) -> Array:
        return _legendre(self.stroke(states))[:, 2:]


@dataclass(frozen=True)
class SlideBending(Compliance, AtSlide):
    """A column or ram bends the more the farther its carriage is out, c in rad/(N m).

    An even beam, held o below where the carriage is lowest: with s the stroke and o it turns by
    c (M + s x F / 2) across them for each length of the stroke, with M and F moment and force on
    the carriage there. A compliance that does not depend on the stroke is `lateral_compliance` of
    the next joint. Both scorers seek it, alone and in sets; not at a last joint, as no moments are
    computed beyond it.
    """

    # from the carriage to the frame in which the next joint moves, along that frame's axes
    to_end_m: tuple[float, float, float]
    moment_of_arm_Nm: float | None = field(default=None, metadata={OPTIONAL: True})
    id = "slide_bending"
    clauses = (
        "what {at} slides on bends the more the farther it is out",
        "what {at} slide on bends the more the farther they are out",
    )
    words = (
        "the carriage of joint {0.joint} turns by c (M + s x F / 2) v and shifts by "
        "c (M / 2 + s x F / 3) x s v, M and F what it carries there across s, s the way from "
        "{0.span_m[0]:g} m and o more, v its length over that from there to {0.span_m[1]:g} m"
    )
    limits = replace(SlideError.limits, positive=True)

    @classmethod
    def fields_of(cls, arm: Arm, joint: int) -> tuple[Any, ...] | None:
        if joint == arm.n:
            return None
        return tuple(link_spans_m(arm)[joint - 1].tolist()), cls.moment_of(arm)

    linear = 1  # proportional to c; o shapes it

    @property
    def starts(self) -> tuple[Array, ...]:
        """Return zero amount of beams as long as the stroke, and half a stroke longer."""
        stroke_m = self.span_m[1] - self.span_m[0]
        return np.zeros(2), np.array([0.0, 0.5 * stroke_m])

    @property
    def reported(self) -> tuple[TermParameter, ...]:
        """Return the compliance, and by how much the beam is longer than the stroke."""
        stroke_m = self.span_m[1] - self.span_m[0]
        beyond = TermParameter("o", "m", 0.1 * stroke_m, lower=0.0, upper=2.0 * stroke_m)
        return *super().reported, beyond

    def report(self, x: Array) -> Report:
        """Return its parameters; compliances are proportional to the inverse of the weights."""
        return replace(super().report(x), by_weights=np.array([-x[0], 0.0]))

    def shift(self, states: PoseStates, x: Array) -> Array:
        return np.asarray(x[0] * self._per_compliance(states, x[1])[0])

    def derivative(self, states: PoseStates, x: Array) -> Array:
        by_c, by_o = self._per_compliance(states, x[1])
        return np.stack([by_c, x[0] * by_o], axis=2)

    def _per_compliance(self, states: PoseStates, beyond_m: float) -> tuple[Array, Array]:
        """Return its motions for a unit of c (P, 6), and their derivative by the overhang."""
        loads, axis = static_loads_in(states, self), np.array(self.along)
        force_N, to_end_m = loads.link_N[:, self.joint - 1], np.array(self.to_end_m)
        moment_Nm = loads.link_Nm[:, self.joint - 1] + np.cross(to_end_m, force_N)
        moment_Nm = moment_Nm - np.outer(moment_Nm @ axis, axis)
        force_Nm = np.cross(axis, force_N)  # for a lever of a metre
        stroke_m = self.span_m[1] - self.span_m[0]
        out_m = states.q_rad[:, [self.joint - 1]] - self.span_m[0]
        way_m = np.maximum(out_m + beyond_m, 0.0)
        turn = way_m * (moment_Nm + way_m * force_Nm / 2.0)
        by_turn = moment_Nm + way_m * force_Nm
        shift = way_m**2 * np.cross(moment_Nm / 2.0 + way_m * force_Nm / 3.0, axis)
        by_shift = way_m * np.cross(moment_Nm + way_m * force_Nm, axis)
        unit, by_o = (
            np.hstack([along + np.cross(turned, to_end_m), turned]) / stroke_m
            for along, turned in ((shift, turn), (by_shift, by_turn))
        )
        return unit, by_o


@dataclass(frozen=True)
class SlideScale(Effect):
    """All joints that slide move (1 + s) times as far as their positions say, s without unit.

    As of the screws, racks or glass scales of a gantry at one temperature. The wrong lead of one
    axis is its `gear_ratio_error`. Where lengths of the arm are parameters, a scale of the
    instrument has the same effect.
    """

    joints: tuple[int, ...]  # those that slide, from 1
    id = "slide_scale"
    varies_with = "the positions of the axes that slide"
    clauses = ("the leads of all axes that slide are off by one factor",)
    sits = "arm"
    reported = (TermParameter("s", "1", 1e-5, plausible=1e-4),)

    @property
    def as_scale_of_instrument(self) -> bool:
        return True

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...] | None:
        slides = tuple((np.flatnonzero(context.arm.prismatic) + 1).tolist())
        return (slides,) if len(slides) > 1 else None

    @property
    def formula(self) -> str:
        terms = (f"d_{joint} += s q_{joint}" for joint in self.joints)
        return ", ".join(terms)

    @property
    def coordinates(self) -> tuple[str, ...]:
        return tuple(f"d_{joint}" for joint in self.joints)

    def per_unit(self, states: PoseStates) -> Array:
        return states.q_rad[:, np.array(self.joints) - 1]


def _legendre(u: Array) -> Array:
    """Return Legendre polynomials of degree 0 and more, (P, degrees), at u (P,)."""
    return np.asarray(np.polynomial.legendre.legvander(u, DEGREES))


def _rms_over_stroke(parts: Array, degrees: Index) -> tuple[Array, Array]:
    """Return the root mean square (m,) of m sums of polynomials, and its derivative by each part.

    Args:
        parts: (m, k) coefficients of Legendre polynomials.
        degrees: (k,) of these.
    """
    # Legendre polynomials are orthogonal, each of a mean square of 1 / (2 degree + 1)
    squares = 1.0 / (2.0 * degrees + 1.0)
    rms = np.sqrt(parts**2 @ squares)
    return rms, parts * squares / np.maximum(rms, np.finfo(float).tiny)[:, None]


def _stroke_axis(arm: Arm, joint: int) -> tuple[float, float, float]:
    """Return along what a joint, from 1, slides, by the axes in which the next one moves."""
    chain = Chain.of(arm)
    found = frames(chain, chain.nominal[None])
    end = (found.T_base_ee if joint == arm.n else found.T_base_joints[joint])[0]
    x, y, z = (end[:3, :3].T @ found.T_base_joints[joint - 1, 0, :3, 2]).tolist()
    return x, y, z
