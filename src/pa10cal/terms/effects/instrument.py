"""Effects of an instrument that reads the places of its targets falsely."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from pa10cal.arm.chain import TOOL
from pa10cal.arm.state import PoseStates
from pa10cal.arrays import Array
from pa10cal.terms.effects.effect import CandidateContext, NamedEffect, seen_in
from pa10cal.terms.term import Parameter


@dataclass(frozen=True)
class FalseReading(NamedEffect):
    """The instrument reads each target's place p off by a field e(p), and so the pose.

    The model predicts what is read: the end moves by what the field makes of the fitted pose.
    """

    @classmethod
    def everywhere(cls, context: CandidateContext) -> tuple[Self, ...]:
        """Return it at the instrument."""
        del context
        return (cls("instrument"),)

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Return the small motion at the end."""
        return TOOL

    @abstractmethod
    def field(self, p_instr_m: Array) -> Array:
        """Return e(p) a unit of each parameter, (P, B, 3, k), at places p (P, B, 3)."""

    def derivative(self, states: PoseStates, x: Array) -> Array:
        """Return what the field makes of the measured pose, (P, 6, k)."""
        seen = seen_in(states, self)
        count, targets, _ = seen.p_instr_targets_m.shape
        field = self.field(seen.p_instr_targets_m).reshape(count, 3 * targets, len(x))
        derivative: Array = seen.pose_by_targets @ field
        return derivative


@dataclass(frozen=True)
class CmmScale(FalseReading):
    """Axis k of the instrument reads (1 + s_k) times the length, s without unit."""

    id: ClassVar[str] = "cmm_scale"

    @property
    def formula(self) -> str:
        """Return the form in words a reader can type."""
        return "reading of x, y, z = (1 + s_x) x, (1 + s_y) y, (1 + s_z) z"

    @property
    def reported(self) -> tuple[Parameter, ...]:
        """Return the error of each axis."""
        return tuple(Parameter(f"s_{axis}", "1", 3e-6, plausible=1e-4) for axis in "xyz")

    def field(self, p_instr_m: Array) -> Array:
        """Return each coordinate along its own axis, (P, B, 3, 3)."""
        return p_instr_m[..., None] * np.eye(3)


@dataclass(frozen=True)
class CmmSquareness(FalseReading):
    """The instrument's x axis is not square to y: x reads x + xy y, xy in rad."""

    id: ClassVar[str] = "cmm_squareness"

    @property
    def formula(self) -> str:
        """Return the form in words a reader can type."""
        return "reading of x = x + xy y"

    @property
    def reported(self) -> tuple[Parameter, ...]:
        """Return the angle."""
        return (Parameter("xy", "rad", 3e-6, plausible=1e-4),)

    def field(self, p_instr_m: Array) -> Array:
        """Return the y coordinate along x, (P, B, 3, 1)."""
        field: Array = p_instr_m[..., 1:2] * np.array([1.0, 0.0, 0.0])
        return field[..., None]
