"""Effects of joints that slide: what a carriage runs on is not straight, sags and gives way."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from pa10cal.arrays import Array
from pa10cal_lab.cell.effects import effect
from pa10cal_lab.cell.mechanism import GRAVITY_M_S2, Strain

Waves = Annotated[tuple[effect.Finite, ...], Field(min_length=1)]

#: Half waves of a rail; distance of the bearings of a carriage, as a part of the stroke.
_WAVES, _BEARINGS = 3, (0.1, 0.25)
#: Out of straight of a rail, root of the sum of the squares of its waves across one axis, and its
#: sag, a metre of stroke [m].
_STRAIGHT, _SAG = 1e-4, 5e-5
_TWIST_RAD = 1e-4
#: Pieces of a column whose bends are added up: exact for an even beam from three on.
_PIECES = 4


class OnSlide(effect.SimulatedEffect):
    """An effect of what a joint slides on."""

    places = ("sliding joint",)
    drawn = False  # no arm of the trials that draw the vocabulary slides
    strains = True

    def out(self, loading: effect.Loading, stroke_m: Sequence[float]) -> Array:
        """Return how far the carriage is out, (P,), of its stroke."""
        low_m, high_m = stroke_m
        return np.asarray((loading.q[:, self.joint] - low_m) / (high_m - low_m))

    def carried(self, loading: effect.Loading, shift_m: Array, turn_rad: Array) -> Strain:
        """Return the strain by what a carriage shifts and turns, (P, 3) along its joint's axes."""
        end = loading.mechanism.link_ends[self.joint]
        at_end_m = shift_m + np.cross(turn_rad, end[:3, 3])
        return loading.strain_of(self.joint, turn_rad @ end[:3, :3], at_end_m @ end[:3, :3])


class SimulatedSlideError(OnSlide):
    """A rail that is not straight, twisted and sags under a carriage that rides on two bearings.

    The line of the rail is a sum of half waves; the carriage stands midway between its bearings, on
    the chord between them. Between its ends the rail is a beam on two supports, at which the weight
    of the carriage makes a dent where it stands.
    """

    id = "slide_error"
    plausible_size = 2.0

    across_x: Waves = Field(description="half waves of the line along x of the joint, from 1 [m]")
    across_y: Waves = Field(description="the same along y [m]")
    twist: Waves = Field(description="half waves of the turn about the stroke [rad]")
    excess: effect.Finite = Field(0.0, description="relative excess of the stroke, drawn never")
    sag: effect.Finite = Field(
        description="dent with the carriage in the middle of a level rail [m]"
    )
    stroke_m: tuple[effect.Finite, effect.Finite] = Field(description="ends of the rail [m]")
    bearings: effect.FinitePositive = Field(description="between bearings, of the stroke")

    @classmethod
    def at_size(cls, site: effect.Site, size: float, rng: np.random.Generator) -> dict[str, Any]:
        """Return a rail of 0.1 mm a metre, with less in higher waves."""
        length_m = site.stroke_m[1] - site.stroke_m[0]

        def waves(amount: float) -> list[float]:
            drawn = rng.standard_normal(_WAVES) / np.arange(1, _WAVES + 1)
            return (size * amount * drawn / np.linalg.norm(drawn)).tolist()  # type: ignore[no-any-return]

        drawn = {
            "across_x": waves(_STRAIGHT * length_m),
            "across_y": waves(_STRAIGHT * length_m),
            "twist": waves(_TWIST_RAD),
            "sag": size * _SAG * length_m,
            "stroke_m": list(site.stroke_m),
        }
        # A sign is drawn and not taken, so that what is drawn after it stays as it was.
        effect.either_sign(1.0, rng)
        return drawn | {"bearings": float(rng.uniform(*_BEARINGS))}

    def strain(self, loading: effect.Loading) -> Strain:
        """Shift and turn the carriage by the chord between its bearings, and by the dent."""
        out, length_m = self.out(loading, self.stroke_m), self.stroke_m[1] - self.stroke_m[0]
        behind, ahead = out - 0.5 * self.bearings, out + 0.5 * self.bearings
        across = self.across_x, self.across_y
        # At the bearings, (P, 2) along x and y of the joint.
        at_behind_m, at_ahead_m = (
            np.stack([_line(waves, at) for waves in across], axis=1) for at in (behind, ahead)
        )
        shift_m = 0.5 * (at_behind_m + at_ahead_m)
        slope = (at_ahead_m - at_behind_m) / (self.bearings * length_m)
        # The part of gravity's direction that acts across the rail, (P, 2).
        R = loading.mechanism.T_base_joints(loading.q)[self.joint, :, :3, :3]
        down = np.einsum("pij,i->pj", R, GRAVITY_M_S2 / np.linalg.norm(GRAVITY_M_S2))[:, :2]
        # Deflection and slope of a beam on two supports under the load at `at` of its length.
        at = np.clip(out, 0.0, 1.0)
        dent_m = 16.0 * self.sag * (at * (1.0 - at)) ** 2
        inclined = 16.0 * self.sag * at * (1.0 - at) * (1.0 - 2.0 * at) / length_m
        shift_m = shift_m + dent_m[:, None] * down
        slope = slope + inclined[:, None] * down
        along_m = self.excess * loading.q[:, self.joint]
        twist = 0.5 * (_line(self.twist, behind) + _line(self.twist, ahead))
        # z turns towards x about y, and towards y about -x.
        turn_rad = np.column_stack([-slope[:, 1], slope[:, 0], twist])
        return self.carried(loading, np.column_stack([shift_m, along_m]), turn_rad)


class SimulatedSlideBending(OnSlide):
    """A column, an even beam held at the low end of the stroke, bends under what it carries."""

    id = "slide_bending"
    by_moment = True
    by_weights = True
    usual = effect.draws(
        c=effect.sized(1.5e-6), stroke_m=lambda site, _size, _rng: list(site.stroke_m)
    )
    plausible_size = 2.0

    c: effect.Finite = Field(
        description="turn per unit bending moment of a carriage that is all out [rad/(N m)]"
    )
    stroke_m: tuple[effect.Finite, effect.Finite] = Field(
        description="where it is held, and where the carriage is all out [m]"
    )

    def strain(self, loading: effect.Loading) -> Strain:
        """Add up the bends of pieces of the column, each of which turns all beyond it."""
        mechanism, joint = loading.mechanism, self.joint
        end, carried = mechanism.link_ends[joint], loading.statics
        force_N = carried.link_N[:, joint] @ end[:3, :3].T
        moment_Nm = carried.link_Nm[:, joint] @ end[:3, :3].T + np.cross(end[:3, 3], force_N)
        out, length_m = self.out(loading, self.stroke_m), self.stroke_m[1] - self.stroke_m[0]
        places, weights = np.polynomial.legendre.leggauss(_PIECES)
        turn, shift = np.zeros_like(moment_Nm), np.zeros_like(moment_Nm)
        for place, weight in zip((1.0 + places) / 2.0, weights / 2.0, strict=True):
            beyond_m = np.outer((1.0 - place) * out * length_m, [0.0, 0.0, 1.0])
            bend = moment_Nm + np.cross(beyond_m, force_N)
            bend = self.c * weight * out[:, None] * bend * np.array([1.0, 1.0, 0.0])
            turn, shift = turn + bend, shift + np.cross(bend, beyond_m)
        return self.carried(loading, shift, turn)


def _line(waves: Sequence[float], at: Array) -> Array:
    """Return the sum of half waves, the first of them one over the whole length, at places."""
    orders = np.arange(1, len(waves) + 1)
    return np.asarray(np.cos(np.pi * np.multiply.outer(at, orders)) @ np.array(waves))
