"""Effects that sit in the tool on the flange and in the measuring instrument."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from pa10cal.arrays import Array
from pa10cal.cell.effects.effect import (
    Finite,
    InstrumentEffect,
    ToolEffect,
    Triple,
    directed,
    draws,
    signed,
    sized,
)
from pa10cal.cell.mechanism import GRAVITY_M_S2


class ToolSag(ToolEffect):
    """The tool sags across its axis, the flange's z."""

    id = "tool_sag"
    usual = draws(c=sized(1e-4))

    c: Finite = Field(description="sag with the tool held level [m]")

    def shift_m(self, R_base_ee: Array) -> Array:
        """Return c times the part of the unit gravity vector across the tool axis."""
        down = GRAVITY_M_S2 / np.linalg.norm(GRAVITY_M_S2)
        shift: Array = self.c * np.einsum("pij,i->pj", R_base_ee, down)
        shift[:, 2] = 0.0
        return shift


class CmmScale(InstrumentEffect):
    """Scales of the instrument's axes are off, by 5e-5 an axis in the mean."""

    id = "cmm_scale"
    usual = draws(s=directed(5e-5 * float(np.sqrt(3.0))))
    plausible_size = 2.0

    s: Triple = Field(description="relative excess of each axis")

    def read_too_much_m(self, p_instr_m: Array) -> Array:
        """Return s_k times coordinate k."""
        extra: Array = p_instr_m * np.array(self.s)
        return extra


class CmmSquareness(InstrumentEffect):
    """The instrument's y axis is not square to its x axis."""

    id = "cmm_squareness"
    usual = draws(xy=signed(5e-5))
    plausible_size = 2.0

    xy: Finite = Field(description="angle off square [rad]")

    def read_too_much_m(self, p_instr_m: Array) -> Array:
        """Return x + xy y in place of x."""
        extra = np.zeros_like(p_instr_m)
        extra[..., 0] = self.xy * p_instr_m[..., 1]
        return extra
