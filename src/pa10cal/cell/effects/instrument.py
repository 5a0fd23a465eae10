"""Effects that sit in the apparatus on the flange and in the measuring machine."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import Field

from pa10cal.cell.effects.kinds import Array, Finite, InstrumentEffect, ToolEffect, Triple
from pa10cal.cell.mechanism import GRAVITY_M_S2


class ToolSag(ToolEffect):
    """The apparatus sags across its axis, the flange's z."""

    id: ClassVar[str] = "tool_sag"

    c: Finite = Field(description="sag with the tool held level [m]")

    def shift_m(self, R_base_ee: Array) -> Array:
        """Return c times the part of the unit gravity vector across the tool axis."""
        down = GRAVITY_M_S2 / np.linalg.norm(GRAVITY_M_S2)
        shift: Array = self.c * np.einsum("pij,i->pj", R_base_ee, down)
        shift[:, 2] = 0.0
        return shift


class CmmScale(InstrumentEffect):
    """Scales of the machine's axes are off."""

    id: ClassVar[str] = "cmm_scale"

    s: Triple = Field(description="relative excess of each axis")

    def read_too_much_m(self, p_instr_m: Array) -> Array:
        """Return s_k times coordinate k."""
        extra: Array = p_instr_m * np.array(self.s)
        return extra


class CmmSquareness(InstrumentEffect):
    """The machine's y axis is not square to its x axis."""

    id: ClassVar[str] = "cmm_squareness"

    xy: Finite = Field(description="angle off square [rad]")

    def read_too_much_m(self, p_instr_m: Array) -> Array:
        """Return x + xy y in place of x."""
        extra = np.zeros_like(p_instr_m)
        extra[..., 0] = self.xy * p_instr_m[..., 1]
        return extra
