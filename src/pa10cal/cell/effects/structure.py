"""Effects that sit in links and base."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np
from pydantic import Field

from pa10cal.cell.effects.kinds import (
    LONG_LINKS,
    Array,
    Finite,
    Loading,
    StructureEffect,
    Triple,
)
from pa10cal.cell.mechanism import Strain

SECONDS_PER_HOUR = 3600.0


class LinkBending(StructureEffect):
    """A long link bends under the moment across its axis at its far joint."""

    id: ClassVar[str] = "link_bending"
    places: ClassVar[tuple[str, ...]] = LONG_LINKS

    c: Finite = Field(description="turn of the link's end a moment [rad/(N m)]")

    def strain(self, loading: Loading) -> Strain:
        """Turn the end by c M, shift it by (2/3) L (c M) x axis, as for a force at the end."""
        link = loading.shape.link(self.of)
        length_m, axis = _length_and_axis(loading.shape.spans_m[link])
        moment = loading.moments.link_Nm[link]
        turn = self.c * (moment - (moment @ axis) * axis)
        return _moved_end(loading, link, turn, (2.0 / 3.0) * length_m * _cross(turn, axis))


class LinkTorsion(StructureEffect):
    """The forearm twists under the moment about its axis at its far joint."""

    id: ClassVar[str] = "link_torsion"
    places: ClassVar[tuple[str, ...]] = ("forearm",)

    c: Finite = Field(description="twist of the link a moment [rad/(N m)]")

    def strain(self, loading: Loading) -> Strain:
        """Turn the end about the link's axis by c M_axis."""
        link = loading.shape.link(self.of)
        _, axis = _length_and_axis(loading.shape.spans_m[link])
        moment = loading.moments.link_Nm[link]
        return _moved_end(loading, link, self.c * (moment @ axis) * axis, np.zeros(3))


class BaseCompliance(StructureEffect):
    """The base tilts under the overturning moment."""

    id: ClassVar[str] = "base_compliance"
    places: ClassVar[tuple[str, ...]] = ("base",)

    cx: Finite = Field(description="tilt about x a moment about x [rad/(N m)]")
    cy: Finite = Field(description="tilt about y a moment about y [rad/(N m)]")

    def strain(self, loading: Loading) -> Strain:
        """Turn the base about x and y by c_x M_x and c_y M_y."""
        turn = np.array([self.cx, self.cy, 0.0]) * loading.moments.base_Nm
        return replace(_none(loading), base_turn_rad=turn)


class BaseDrift(StructureEffect):
    """The base creeps at a constant rate."""

    id: ClassVar[str] = "base_drift"
    places: ClassVar[tuple[str, ...]] = ("base",)

    rate: Triple = Field(description="velocity along base axes [m/h]")

    def strain(self, loading: Loading) -> Strain:
        """Shift the base by rate times the hours since the start."""
        shift = np.array(self.rate) * loading.time_s / SECONDS_PER_HOUR
        return replace(_none(loading), base_shift_m=shift)


class ThermalGrowth(StructureEffect):
    """Pedestal (the first link) and long links grow with temperature."""

    id: ClassVar[str] = "thermal_growth"
    places: ClassVar[tuple[str, ...]] = ("arm",)

    alpha: Finite = Field(description="expansion coefficient [1/K]")

    def strain(self, loading: Loading) -> Strain:
        """Stretch the links by alpha (T - T_ref)."""
        none = _none(loading)
        stretch = none.stretch.copy()
        stretch[[0, *loading.shape.long_links]] = self.alpha * loading.warming_K
        return replace(none, stretch=stretch)


def _none(loading: Loading) -> Strain:
    return Strain.none(len(loading.shape.spans_m))


def _cross(a: Array, b: Array) -> Array:
    """Return the cross product of two vectors; numpy's own takes ten times as long for one."""
    return np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


def _length_and_axis(span_m: Array) -> tuple[float, Array]:
    length_m = float(np.linalg.norm(span_m))
    return length_m, span_m / length_m


def _moved_end(loading: Loading, link: int, turn_rad: Array, shift_m: Array) -> Strain:
    none = _none(loading)
    turn, shift = none.turn_rad.copy(), none.shift_m.copy()
    turn[link], shift[link] = turn_rad, shift_m
    return replace(none, turn_rad=turn, shift_m=shift)
