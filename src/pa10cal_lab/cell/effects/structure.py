"""Effects that sit in links, base, tool and instrument."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from pa10cal.arrays import Array
from pa10cal_lab.cell.effects import effect
from pa10cal_lab.cell.mechanism import GRAVITY_M_S2, Strain

SECONDS_PER_HOUR = 3600.0
#: Pieces of a link whose bends are added up: exact for an even beam from two on.
_PIECES = 3


class SimulatedLinkEffect(effect.SimulatedEffect):
    """A long link gives way under what it carries at its far joint."""

    strains = True
    by_weights = True

    @abstractmethod
    def end_motion(self, moment_Nm: Array, force_N: Array, span_m: Array) -> tuple[Array, Array]:
        """Return by how much the link's end turns (P, 3) [rad] and shifts (P, 3) [m].

        Args:
            moment_Nm: (P, 3) moment.
            force_N: (P, 3) force.
            span_m: (3,) from the link's near joint to its far one.
        """

    def strain(self, loading: effect.Loading) -> Strain:
        """Turn and shift the end of the link."""
        link, carried = loading.link(self.of), loading.statics
        turn_rad, shift_m = self.end_motion(
            carried.link_Nm[:, link], carried.link_N[:, link], loading.mechanism.spans_m[link]
        )
        return loading.strain_of(link, turn_rad, shift_m)


class SimulatedLinkBending(SimulatedLinkEffect):
    """A long link, an even beam, bends under what acts across its axis at its far joint."""

    id = "link_bending"
    by_moment = True
    places = effect.LONG_LINKS
    usual = effect.draws(c=effect.sized(2e-6))
    plausible_size = 2.5

    c: effect.Finite = Field(
        description="rotation of the link's end per unit bending moment [rad/(N m)]"
    )

    def end_motion(self, moment_Nm: Array, force_N: Array, span_m: Array) -> tuple[Array, Array]:
        """Add up the bends of pieces of the link, each of which turns all beyond it."""
        places, weights = np.polynomial.legendre.leggauss(_PIECES)
        turn, shift = np.zeros_like(moment_Nm), np.zeros_like(moment_Nm)
        for place, weight in zip((1.0 + places) / 2.0, weights / 2.0, strict=True):
            beyond_m = (1.0 - place) * span_m
            bend = self.c * weight * _across(moment_Nm + np.cross(beyond_m, force_N), span_m)
            turn, shift = turn + bend, shift + np.cross(bend, beyond_m)
        return turn, shift


class SimulatedLinkTorsion(SimulatedLinkEffect):
    """The forearm twists under the moment about its axis at its far joint."""

    id = "link_torsion"
    places = ("forearm",)
    usual = effect.draws(c=effect.sized(3e-5))
    plausible_size = 0.67

    c: effect.Finite = Field(description="twist of the link per unit torsional moment [rad/(N m)]")

    def end_motion(self, moment_Nm: Array, _force_N: Array, span_m: Array) -> tuple[Array, Array]:
        turn = self.c * (moment_Nm - _across(moment_Nm, span_m))
        return turn, np.zeros_like(turn)


def _across(vectors: Array, span_m: Array) -> Array:
    """Return the part of vectors (P, 3) across a span (3,)."""
    axis = span_m / np.linalg.norm(span_m)
    return np.asarray(vectors - np.outer(vectors @ axis, axis))


class SimulatedLateralCompliance(effect.SimulatedEffect):
    """The bearing of a joint gives way across its axis."""

    id = "lateral_compliance"
    by_moment = True
    places = ("joint",)
    drawn = False  # no search tries it yet
    strains = True
    by_weights = True
    usual = effect.draws(C_x=effect.sized(3e-6), C_y=effect.sized(3e-6))

    C_x: effect.Finite = Field(description="tilt about x per unit moment about x [rad/(N m)]")
    C_y: effect.Finite = Field(description="tilt about y per unit moment about y [rad/(N m)]")

    def strain(self, loading: effect.Loading) -> Strain:
        """Turn the end of the link before the joint, whose z is the joint's axis."""
        link = self.joint - 1  # of the first joint the base
        compliance = np.array([self.C_x, self.C_y, 0.0])
        return loading.strain_of(link, compliance * loading.moment_Nm(link))


Waves = Annotated[tuple[effect.Finite, ...], Field(min_length=2)]

#: How far the centre of a bearing's ring runs out, root of the sum of the squares of its waves [m],
#: and how many waves a turn it has. Class Normal allows rings of 50 to 120 mm 20 to 25 um in all.
_RUN_OUT_M, _RING_WAVES = 5e-6, 3
#: Between the two bearings of a joint, and their middle from where its frame sits [m].
_APART_M, _MIDDLE_M = (0.05, 0.15), (-0.05, 0.05)


class SimulatedAxisWobble(effect.SimulatedEffect):
    """A joint turns in two bearings, each of which carries it to and fro by its own run-out.

    The axis is the straight line through the centres of the two inner rings.
    """

    id = "axis_wobble"
    places = ("turning joint",)
    drawn = False  # a study of its own hides it
    strains = True
    plausible_size = 2.0

    lower_x: Waves = Field(
        description="run-out of the bearing nearer to the base along x of the joint: cosine and "
        "sine of its angle, of twice its angle, … [m]"
    )
    lower_y: Waves = Field(description="the same along y [m]")
    upper_x: Waves = Field(description="that of the other bearing along x [m]")
    upper_y: Waves = Field(description="the same along y [m]")
    apart_m: effect.FinitePositive = Field(description="between the bearings [m]")
    middle_m: effect.Finite = Field(description="their middle, along z of the joint's frame [m]")

    @classmethod
    def at_size(cls, _site: effect.Site, size: float, rng: np.random.Generator) -> dict[str, Any]:
        """Return bearings of class Normal, with less in higher waves."""
        falls = np.repeat(np.arange(1, _RING_WAVES + 1), 2) ** 2
        drawn = rng.standard_normal((2, 2, 2 * _RING_WAVES)) / falls
        drawn *= size * _RUN_OUT_M / np.linalg.norm(drawn, axis=(1, 2), keepdims=True)
        (lower_x, lower_y), (upper_x, upper_y) = drawn.tolist()
        return {
            "lower_x": lower_x,
            "lower_y": lower_y,
            "upper_x": upper_x,
            "upper_y": upper_y,
            "apart_m": float(rng.uniform(*_APART_M)),
            "middle_m": float(rng.uniform(*_MIDDLE_M)),
        }

    def strain(self, loading: effect.Loading) -> Strain:
        """Lay the axis through the centres of both rings, and move what the joint sits on so."""
        q, half_m = loading.q[:, self.joint], 0.5 * self.apart_m
        lower, upper = (
            np.column_stack([_run_out(x, q), _run_out(y, q), np.full(len(q), self.middle_m + at)])
            for x, y, at in (
                (self.lower_x, self.lower_y, -half_m),
                (self.upper_x, self.upper_y, half_m),
            )
        )
        along = (upper - lower) / np.linalg.norm(upper - lower, axis=1, keepdims=True)
        turn = np.cross([0.0, 0.0, 1.0], along)
        # Where that line is at the height of the frame.
        shift = lower - along * (lower[:, 2] / along[:, 2])[:, None]
        if self.joint == 0:  # it stands on the base, whose origin is elsewhere
            first = loading.mechanism.placements[0]
            turn, shift = turn @ first[:3, :3].T, shift @ first[:3, :3].T
            shift = shift - np.cross(turn, first[:3, 3])
        return loading.strain_of(self.joint - 1, turn, shift)


def _run_out(waves: Sequence[float], q_rad: Array) -> Array:
    """Return where waves, a cosine and a sine of each, carry the centre of a ring, (P,)."""
    parts = np.array(waves).reshape(-1, 2)
    turned = np.exp(1j * np.multiply.outer(q_rad, np.arange(1, len(parts) + 1)))
    return np.asarray(np.real(turned @ (parts[:, 0] - 1j * parts[:, 1])))


class SimulatedBaseCompliance(effect.SimulatedEffect):
    """The base tilts under the overturning moment."""

    id = "base_compliance"
    by_moment = True
    places = ("base",)
    strains = True
    by_weights = True
    usual = effect.draws(cx=effect.sized(1.5e-6), cy=effect.sized(1.5e-6))
    plausible_size = 2.0

    cx: effect.Finite = Field(description="tilt about x per unit moment about x [rad/(N m)]")
    cy: effect.Finite = Field(description="tilt about y per unit moment about y [rad/(N m)]")

    def strain(self, loading: effect.Loading) -> Strain:
        turn = np.array([self.cx, self.cy, 0.0]) * loading.statics.base_Nm
        return replace(loading.none, base_turn_rad=turn)


class SimulatedBaseDrift(effect.SimulatedEffect):
    """The base creeps at a constant rate."""

    id = "base_drift"
    places = ("base",)
    strains = True
    usual = effect.draws(rate=effect.directed(2e-5))
    plausible_size = 2.6  # in three axes; what is plausible in the vocabulary is of one

    rate: effect.Triple = Field(description="velocity along base axes [m/h]")

    def strain(self, loading: effect.Loading) -> Strain:
        shift = np.outer(loading.time_s, self.rate) / SECONDS_PER_HOUR
        return replace(loading.none, base_shift_m=shift)


class SimulatedThermalGrowth(effect.SimulatedEffect):
    """Pedestal (the first link) and long links grow with temperature, usually as steel does."""

    id = "thermal_growth"
    places = ("arm",)
    strains = True
    by_temperature = True
    # No metal of which arms are made grows more than light metal.
    usual = effect.draws(alpha=lambda _site, size, _rng: min(size * 1.2e-5, 2.6e-5))
    plausible_size = 1.7

    alpha: effect.Finite = Field(description="expansion coefficient [1/K]")

    def strain(self, loading: effect.Loading) -> Strain:
        none = loading.none
        stretch = none.stretch.copy()
        grown = self.alpha * loading.warming_K[:, None]
        stretch[:, sorted({0, *loading.mechanism.long_links})] = grown
        return replace(none, stretch=stretch)


class SimulatedLinkGrowth(effect.SimulatedEffect):
    """One long link grows with the logged temperature, which it follows by more or less."""

    id = "link_growth"
    places = effect.LONG_LINKS
    drawn = False  # no study hides it
    strains = True
    by_temperature = True
    usual = effect.draws(alpha=effect.sized(2e-5))

    alpha: effect.Finite = Field(description="growth of the link for 1 K of the log [1/K]")

    def strain(self, loading: effect.Loading) -> Strain:
        none = loading.none
        stretch = none.stretch.copy()
        stretch[:, loading.link(self.of)] = self.alpha * loading.warming_K
        return replace(none, stretch=stretch)


# Effects that sit in the tool on the flange and in the measuring instrument.


class SimulatedToolSag(effect.SimulatedEffect):
    """The tool sags across its axis, the flange's z."""

    id = "tool_sag"
    places = ("tool",)
    usual = effect.draws(c=effect.sized(1e-4))

    c: effect.Finite = Field(description="sag with the tool held level [m]")

    def shift_m(self, R_base_ee: Array) -> Array:
        down = GRAVITY_M_S2 / np.linalg.norm(GRAVITY_M_S2)
        shift: Array = self.c * np.einsum("pij,i->pj", R_base_ee, down)
        shift[:, 2] = 0.0
        return shift


class SimulatedScale(effect.SimulatedEffect):
    """The instrument's one scale is off: a wavelength, a base line, the size of a tag."""

    id = "scale"
    places = ("instrument",)
    drawn = False  # trials hide it under its own instruments, where they go through `cmm_scale`
    usual = effect.draws(s=effect.signed(5e-5))
    plausible_size = 2.0

    s: effect.Finite = Field(description="relative excess of every length")

    def read_too_much_m(self, p_instr_m: Array) -> Array:
        return self.s * p_instr_m


class SimulatedCmmScale(effect.SimulatedEffect):
    """Scales of a machine's three axes are off, by 5e-5 rms per axis."""

    id = "cmm_scale"
    places = ("instrument",)
    without_axes = SimulatedScale
    usual = effect.draws(s=effect.directed(5e-5 * float(np.sqrt(3.0))))
    plausible_size = 2.0

    s: effect.Triple = Field(description="relative excess of each axis")

    def read_too_much_m(self, p_instr_m: Array) -> Array:
        return np.asarray(p_instr_m * np.array(self.s))


class SimulatedDepthScale(effect.SimulatedEffect):
    """A camera reads its depth, along z, too long, as by a wrong focal length."""

    id = "depth_scale"
    places = ("instrument",)
    drawn = False
    usual = effect.draws(s=effect.signed(3e-3))

    s: effect.Finite = Field(description="relative excess of the length along z")

    def read_too_much_m(self, p_instr_m: Array) -> Array:
        return np.asarray(self.s * p_instr_m * np.array([0.0, 0.0, 1.0]))


class SimulatedRangeConstant(effect.SimulatedEffect):
    """A tracker's distance meter adds a constant: its zero, or a reflector of another radius."""

    id = "range_constant"
    places = ("instrument",)
    drawn = False
    usual = effect.draws(c=effect.signed(1e-4))

    c: effect.Finite = Field(description="excess of every distance from the instrument [m]")

    def read_too_much_m(self, p_instr_m: Array) -> Array:
        """Change the distance of polar coordinates and go back, as a tracker reads them."""
        x, y, z = np.moveaxis(p_instr_m, -1, 0)
        azimuth, level = np.arctan2(y, x), np.hypot(x, y)
        elevation, distance = np.arctan2(z, level), np.hypot(level, z) + self.c
        level = distance * np.cos(elevation)
        read = (level * np.cos(azimuth), level * np.sin(azimuth), distance * np.sin(elevation))
        return np.stack(read, axis=-1) - p_instr_m


class SimulatedCmmSquareness(effect.SimulatedEffect):
    """The instrument's y axis is not square to its x axis."""

    id = "cmm_squareness"
    places = ("instrument",)
    without_axes = SimulatedRangeConstant
    usual = effect.draws(xy=effect.signed(5e-5))
    plausible_size = 2.0

    xy: effect.Finite = Field(description="angle off square [rad]")

    def read_too_much_m(self, p_instr_m: Array) -> Array:
        extra = np.zeros_like(p_instr_m)
        extra[..., 0] = self.xy * p_instr_m[..., 1]
        return extra
