"""Effects that sit in the tool on the flange and in the measuring instrument."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from pa10cal.cell.effects.effect import (
    Array,
    Finite,
    InstrumentEffect,
    Site,
    ToolEffect,
    Triple,
    any_direction,
    either_sign,
)
from pa10cal.cell.mechanism import GRAVITY_M_S2


class ToolSag(ToolEffect):
    """The tool sags across its axis, the flange's z."""

    id: ClassVar[str] = "tool_sag"
    plausible_size: ClassVar[float] = 1.0

    c: Finite = Field(description="sag with the tool held level [m]")

    @classmethod
    def at_size(cls, site: Site, size: float, rng: np.random.Generator) -> dict[str, Any]:
        """Return 0.1 mm."""
        del site, rng
        return {"c": size * 1e-4}

    def shift_m(self, R_base_ee: Array) -> Array:
        """Return c times the part of the unit gravity vector across the tool axis."""
        down = GRAVITY_M_S2 / np.linalg.norm(GRAVITY_M_S2)
        shift: Array = self.c * np.einsum("pij,i->pj", R_base_ee, down)
        shift[:, 2] = 0.0
        return shift


class CmmScale(InstrumentEffect):
    """Scales of the instrument's axes are off."""

    id: ClassVar[str] = "cmm_scale"
    plausible_size: ClassVar[float] = 2.0

    s: Triple = Field(description="relative excess of each axis")

    @classmethod
    def at_size(cls, site: Site, size: float, rng: np.random.Generator) -> dict[str, Any]:
        """Return 5e-5 an axis in the mean, in any direction."""
        del site
        return {"s": any_direction(size * (5e-5 * float(np.sqrt(3.0))), rng)}

    def read_too_much_m(self, p_instr_m: Array) -> Array:
        """Return s_k times coordinate k."""
        extra: Array = p_instr_m * np.array(self.s)
        return extra


class CmmSquareness(InstrumentEffect):
    """The instrument's y axis is not square to its x axis."""

    id: ClassVar[str] = "cmm_squareness"
    plausible_size: ClassVar[float] = 2.0

    xy: Finite = Field(description="angle off square [rad]")

    @classmethod
    def at_size(cls, site: Site, size: float, rng: np.random.Generator) -> dict[str, Any]:
        """Return 5e-5 rad either way."""
        del site
        return {"xy": either_sign(size * 5e-5, rng)}

    def read_too_much_m(self, p_instr_m: Array) -> Array:
        """Return x + xy y in place of x."""
        extra = np.zeros_like(p_instr_m)
        extra[..., 0] = self.xy * p_instr_m[..., 1]
        return extra
