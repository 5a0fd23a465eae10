"""Effects of an instrument that reads the positions of its targets wrongly: scales, squareness."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np

from pa10cal.arm.chain import TOOL
from pa10cal.arm.statics import ObservedTargets, PoseStates
from pa10cal.arrays import Array
from pa10cal.terms.effects.context import CandidateContext
from pa10cal.terms.effects.effect import Effect, seen_in
from pa10cal.terms.term import TermParameter


@dataclass(frozen=True)
class FalseReading(Effect):
    """The instrument reads each target's position p as p + e(p), e a field.

    The model predicts readings: the end moves by the error of the pose fitted to these, and the
    targets on it by what that pose leaves.
    """

    error_of = "readings"
    sits = "instrument"
    varies_with = "the place that is read"
    coordinates = TOOL

    @classmethod
    def fields_at(cls, context: CandidateContext, joint: int) -> tuple[Any, ...] | None:
        """Return that it is possible where the instrument may be of its kind, or is not known."""
        return () if context.three_axes is None or cls._of_such(context) else None

    @classmethod
    def _of_such(cls, _context: CandidateContext) -> bool:
        """Return whether an instrument of which the axes are known may have such an error."""
        return True

    @abstractmethod
    def field(self, p_instr_m: Array) -> Array:
        """Return the derivative of e(p) by the parameters, (P, B, 3, k), at positions (P, B, 3)."""

    def derivative(self, states: PoseStates, x: Array) -> Array:
        observed = seen_in(states, self)
        return np.asarray(observed.pose_by_targets @ self._by_reading(observed))

    def targets_derivative(self, states: PoseStates, x: Array) -> Array | None:
        observed = seen_in(states, self)
        by_targets = observed.places_by_targets
        return None if by_targets is None else by_targets @ self._by_reading(observed)

    def _by_reading(self, observed: ObservedTargets) -> Array:
        """Return the derivative of the readings by the parameters, (P, 3 B, k)."""
        field = self.field(observed.p_instr_targets_m)
        return field.reshape(len(field), -1, field.shape[-1])


@dataclass(frozen=True)
class CmmScale(FalseReading):
    """Axis k of the instrument reads (1 + s_k) times the length, s without unit.

    Only a machine that moves along three axes has one scale for each; others have `Scale`.
    """

    # Only differences of the scales are identifiable: their mean goes with the lengths.
    amounts_stand_alone = False
    id = "cmm_scale"
    clauses = ("the scales of the instrument's axes are off",)
    words = "reading of x, y, z = (1 + s_x) x, (1 + s_y) y, (1 + s_z) z"
    reported = tuple(TermParameter(f"s_{axis}", "1", 3e-6, plausible=1e-4) for axis in "xyz")

    @classmethod
    def _of_such(cls, context: CandidateContext) -> bool:
        return bool(context.three_axes)

    def field(self, p_instr_m: Array) -> Array:
        return p_instr_m[..., None] * np.eye(3)


@dataclass(frozen=True)
class Scale(FalseReading):
    """The instrument reads (1 + s) times every length, whatever its direction, s without unit.

    As of trackers and cameras, by an error of a wavelength, of a base line or of a tag.
    """

    id = "scale"
    clauses = ("the instrument's scale is off",)
    words = "reading of x, y, z = (1 + s) x, (1 + s) y, (1 + s) z"
    reported = (TermParameter("s", "1", 3e-6, plausible=1e-4),)

    @classmethod
    def _of_such(cls, context: CandidateContext) -> bool:
        return not context.three_axes

    def field(self, p_instr_m: Array) -> Array:
        return p_instr_m[..., None]


@dataclass(frozen=True)
class DepthScale(FalseReading):
    """A camera reads (1 + s) times the depth, along the z axis in which it looks, s without unit.

    As by an error of its focal length: positions across the view are right where sizes are.
    """

    id = "depth_scale"
    clauses = ("the camera's scale in depth is off",)
    words = "reading of z = (1 + s) z"
    reported = (TermParameter("s", "1", 3e-5, plausible=3e-3),)

    @classmethod
    def _of_such(cls, context: CandidateContext) -> bool:
        """Return whether the targets are in front of the origin, along z, as of a camera."""
        x, y, z = context.p_instr_middle_m
        return bool(z > np.hypot(x, y)) and not context.three_axes

    def field(self, p_instr_m: Array) -> Array:
        field: Array = p_instr_m[..., 2:] * np.array([0.0, 0.0, 1.0])
        return field[..., None]


@dataclass(frozen=True)
class RangeConstant(FalseReading):
    """The instrument reads every distance from itself longer by c, in m.

    A tracker's distance meter has a zero offset, and the stated radius of a reflector an error. The
    origin of the frame must be where the beams start.
    """

    id = "range_constant"
    clauses = ("the instrument reads all distances too long by one length",)
    words = "reading of x, y, z += c times the unit vector from the instrument to the target"
    reported = (TermParameter("c", "m", 1e-6, plausible=1e-4),)

    @classmethod
    def _of_such(cls, context: CandidateContext) -> bool:
        return _may_read_along_beams(context) and not context.three_axes

    def field(self, p_instr_m: Array) -> Array:
        length_m = np.linalg.norm(p_instr_m, axis=-1, keepdims=True)
        along: Array = p_instr_m / np.maximum(length_m, np.finfo(float).tiny)
        return along[..., None]


def _may_read_along_beams(context: CandidateContext) -> bool:
    """Return whether the origin of the readings is beyond the reach, as where a tracker stands."""
    return bool(np.linalg.norm(context.p_instr_middle_m) > context.arm.reach_m)


@dataclass(frozen=True)
class CmmSquareness(FalseReading):
    """The instrument's x axis is not square to y: x reads x + xy y, xy in rad.

    Only a machine that moves along axes has such an error, and not one that reads along beams. That
    its z axis is not square to x or y has no name: it is left as a map of places.
    """

    id = "cmm_squareness"
    clauses = ("the instrument's axes are not square",)
    words = "reading of x = x + xy y"
    reported = (TermParameter("xy", "rad", 3e-6, plausible=1e-4),)

    @classmethod
    def _of_such(cls, context: CandidateContext) -> bool:
        """Return whether it may move along axes: no beams start within the arm's reach."""
        return bool(context.three_axes) or not _may_read_along_beams(context)

    def field(self, p_instr_m: Array) -> Array:
        field: Array = p_instr_m[..., 1:2] * np.array([1.0, 0.0, 0.0])
        return field[..., None]
