"""Joint positions as counts of an encoder: counts per turn, zero and signs, by the nominal arm."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arrays import Array, spread
from pa10cal.campaign.bounds import BEYOND_LIMITS
from pa10cal.campaign.nominal_fit import placed_by_points

#: Whole numbers beyond this are counts, not degrees without decimals.
LARGEST_DEG = 400.0
#: Counts a turn of usual encoders: servos, powers of two, and parts of a degree.
_POWERS = tuple(2.0**k for k in range(8, 25))
_USUAL_COUNTS = (4096.0, 1024.0, *_POWERS, 3600.0, 36e3, 36e4, 1e4, 4e4, 1e5, 1e6)
#: Counts a turn, and count at zero, of servos that move less than a turn: 1024 counts over 300 deg,
#: 1000 over 240, pulses of 500 to 2500 us over 180 or over 270.
_OF_A_PART = ((1228.8, 512.0), (1500.0, 500.0), (4000.0, 1500.0), (2e3 / 0.75, 1500.0))
#: The nominal arm agrees if its misfit is at most this part of the spread of the places.
_FITS = 0.05
#: Rows by which scales are compared; part of them that must lie within the joints' limits.
_COMPARED, _WITHIN = 60, 0.9
#: Any other scale must leave so many times the misfit.
_CLEARER = 2.0


@dataclass(frozen=True)
class CountScale:
    """How counts are read as angles."""

    per_turn: float  # counts a turn of the joint
    zero: float  # count at which the joint is at zero
    signs: tuple[int, ...]  # (n,) direction of each joint
    misfit_m: float = np.inf  # median misfit of the nominal arm so; infinite where none was tried

    def degrees(self, counts: Array) -> Array:
        """Return angles of counts (N, n)."""
        return np.asarray(self.signs) * (counts - self.zero) * (360.0 / self.per_turn)


def looks_like_counts(values: Array) -> bool:
    """Return whether positions (N, n) of joints that turn are counts: whole numbers, and large."""
    known = values[np.isfinite(values)]
    return bool(
        len(known) and (known == np.round(known)).all() and np.abs(known).max() > LARGEST_DEG
    )


def scale_of_counts(counts: Array, arm: Arm | None, p_m: Array | None) -> CountScale:
    """Return the scale of counts (N, n) of an arm whose joints all turn.

    It is the scale with which the nominal arm agrees best with positions p_m (N, 3) of a target,
    each joint in its best direction, if that is clearly better than any other. Without positions,
    or where none is, it is the smallest power of two above all counts, with zero in its middle
    where no count is negative.
    """
    below = np.nanmax(np.abs(counts))
    assumed = next(power for power in (*_POWERS, np.inf) if power > below)
    zero = assumed / 2.0 if np.nanmin(counts) >= 0.0 else 0.0
    fallback = CountScale(assumed, zero, (1,) * counts.shape[1])
    if arm is None or p_m is None or not np.isfinite(assumed):
        return fallback
    known = np.flatnonzero(np.isfinite(np.column_stack([counts, p_m])).all(axis=1))
    if not len(known):
        return fallback
    some = known[spread(len(known), _COMPARED)]
    tried = sorted(_scales_tried(counts[some], arm, p_m[some]), key=lambda scale: scale.misfit_m)
    if not tried:
        return fallback
    others = [scale.misfit_m for scale in tried if scale.per_turn != tried[0].per_turn]
    spread_m = float(np.linalg.norm(np.std(p_m[some], axis=0)))
    clear = tried[0].misfit_m < min(min(others, default=np.inf) / _CLEARER, _FITS * spread_m)
    return tried[0] if clear else fallback


def _scales_tried(counts: Array, arm: Arm, p_m: Array) -> Iterator[CountScale]:
    """Yield scales with which the counts lie within the limits of the joints."""
    limits_deg = np.degrees(arm.axis_limits_rad) + BEYOND_LIMITS["deg"] * np.array([-1.0, 1.0])

    def within(scale: CountScale) -> bool:
        q_deg = scale.degrees(counts)
        inside = (q_deg >= limits_deg[:, 0]) & (q_deg <= limits_deg[:, 1])
        return bool(inside.all(axis=1).mean() >= _WITHIN)

    whole = product(dict.fromkeys(_USUAL_COUNTS), (0.5, 0.0))
    for per_turn, zero in (*((turn, part * turn) for turn, part in whole), *_OF_A_PART):
        scale = CountScale(per_turn, zero, (1,) * len(limits_deg))
        if not within(scale):
            continue
        scale = _fitted(scale, counts, arm, p_m)
        for _ in limits_deg:
            turned = [
                _fitted(_reversed(scale, k), counts, arm, p_m) for k in range(len(limits_deg))
            ]
            better = min(turned, key=lambda other: other.misfit_m)
            if not within(better) or better.misfit_m >= scale.misfit_m / 1.2:
                break
            scale = better
        yield scale


def _reversed(scale: CountScale, joint: int) -> CountScale:
    signs = tuple(-sign if k == joint else sign for k, sign in enumerate(scale.signs))
    return CountScale(scale.per_turn, scale.zero, signs)


def _fitted(scale: CountScale, counts: Array, arm: Arm, p_m: Array) -> CountScale:
    """Return a scale with the misfit of the nominal arm."""
    q_rad = arm.coupling.to_joints(np.radians(scale.degrees(counts)))
    T_base_ee = Chain.of(arm).forward(q_rad)
    located = placed_by_points(T_base_ee, p_m[:, None], roughly=True)
    if located is None:
        return scale
    off_m = np.linalg.norm(p_m - located.targets(T_base_ee)[:, 0, :3, 3], axis=1)
    return CountScale(scale.per_turn, scale.zero, scale.signs, float(np.median(off_m)))
