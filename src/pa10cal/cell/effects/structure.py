"""Effects that sit in links and base."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from pa10cal.cell.effects.effect import (
    LONG_LINKS,
    Array,
    Finite,
    Loading,
    Site,
    StructureEffect,
    Triple,
    any_direction,
)
from pa10cal.cell.mechanism import Strain

SECONDS_PER_HOUR = 3600.0


class LinkBending(StructureEffect):
    """A long link bends under the moment across its axis at its far joint."""

    id: ClassVar[str] = "link_bending"
    places: ClassVar[tuple[str, ...]] = LONG_LINKS
    by_weights: ClassVar[bool] = True
    plausible_size: ClassVar[float] = 2.5

    c: Finite = Field(description="turn of the link's end a moment [rad/(N m)]")

    @classmethod
    def at_size(cls, site: Site, size: float, rng: np.random.Generator) -> dict[str, Any]:
        """Return 2e-6 rad/(N m)."""
        del site, rng
        return {"c": size * 2e-6}

    def strain(self, loading: Loading) -> Strain:
        """Turn the end by c M, shift it by (2/3) L (c M) x axis, as for a force at the end."""
        link = loading.link(self.of)
        span_m = loading.mechanism.spans_m[link]
        axis = span_m / np.linalg.norm(span_m)
        moment_Nm = loading.statics.link_Nm[:, link]
        turn = self.c * (moment_Nm - np.outer(moment_Nm @ axis, axis))
        return _moved_end(loading, link, turn, 2.0 / 3.0 * np.cross(turn, span_m))


class LinkTorsion(StructureEffect):
    """The forearm twists under the moment about its axis at its far joint."""

    id: ClassVar[str] = "link_torsion"
    places: ClassVar[tuple[str, ...]] = ("forearm",)
    by_weights: ClassVar[bool] = True
    plausible_size: ClassVar[float] = 0.67

    c: Finite = Field(description="twist of the link a moment [rad/(N m)]")

    @classmethod
    def at_size(cls, site: Site, size: float, rng: np.random.Generator) -> dict[str, Any]:
        """Return 3e-5 rad/(N m)."""
        del site, rng
        return {"c": size * 3e-5}

    def strain(self, loading: Loading) -> Strain:
        """Turn the end about the link's axis by c M_axis."""
        link = loading.link(self.of)
        span_m = loading.mechanism.spans_m[link]
        axis = span_m / np.linalg.norm(span_m)
        turn = self.c * np.outer(loading.statics.link_Nm[:, link] @ axis, axis)
        return _moved_end(loading, link, turn, np.zeros_like(turn))


class BaseCompliance(StructureEffect):
    """The base tilts under the overturning moment."""

    id: ClassVar[str] = "base_compliance"
    places: ClassVar[tuple[str, ...]] = ("base",)
    by_weights: ClassVar[bool] = True
    plausible_size: ClassVar[float] = 2.0

    cx: Finite = Field(description="tilt about x a moment about x [rad/(N m)]")
    cy: Finite = Field(description="tilt about y a moment about y [rad/(N m)]")

    @classmethod
    def at_size(cls, site: Site, size: float, rng: np.random.Generator) -> dict[str, Any]:
        """Return 1.5e-6 rad/(N m) about both axes."""
        del site, rng
        return {"cx": size * 1.5e-6, "cy": size * 1.5e-6}

    def strain(self, loading: Loading) -> Strain:
        """Turn the base about x and y by c_x M_x and c_y M_y."""
        turn = np.array([self.cx, self.cy, 0.0]) * loading.statics.base_Nm
        return replace(loading.none, base_turn_rad=turn)


class BaseDrift(StructureEffect):
    """The base creeps at a constant rate."""

    id: ClassVar[str] = "base_drift"
    places: ClassVar[tuple[str, ...]] = ("base",)
    plausible_size: ClassVar[float] = 2.6  # the plausible rate is that of one axis

    rate: Triple = Field(description="velocity along base axes [m/h]")

    @classmethod
    def at_size(cls, site: Site, size: float, rng: np.random.Generator) -> dict[str, Any]:
        """Return 20 micrometres an hour in any direction."""
        del site
        return {"rate": any_direction(size * 2e-5, rng)}

    def strain(self, loading: Loading) -> Strain:
        """Shift the base by rate times the hours since the start."""
        shift = np.outer(loading.time_s, self.rate) / SECONDS_PER_HOUR
        return replace(loading.none, base_shift_m=shift)


class ThermalGrowth(StructureEffect):
    """Pedestal (the first link) and long links grow with temperature."""

    id: ClassVar[str] = "thermal_growth"
    places: ClassVar[tuple[str, ...]] = ("arm",)
    by_temperature: ClassVar[bool] = True
    plausible_size: ClassVar[float] = 1.7

    alpha: Finite = Field(description="expansion coefficient [1/K]")

    @classmethod
    def at_size(cls, site: Site, size: float, rng: np.random.Generator) -> dict[str, Any]:
        """Return that of steel."""
        del site, rng
        return {"alpha": size * 1.2e-5}

    def strain(self, loading: Loading) -> Strain:
        """Stretch the links by alpha (T - T_ref)."""
        none = loading.none
        stretch = none.stretch.copy()
        grown = self.alpha * loading.warming_K[:, None]
        stretch[:, sorted({0, *loading.mechanism.long_links})] = grown
        return replace(none, stretch=stretch)


def _moved_end(loading: Loading, link: int, turn_rad: Array, shift_m: Array) -> Strain:
    none = loading.none
    turn, shift = none.turn_rad.copy(), none.shift_m.copy()
    turn[:, link], shift[:, link] = turn_rad, shift_m
    return replace(none, turn_rad=turn, shift_m=shift)
