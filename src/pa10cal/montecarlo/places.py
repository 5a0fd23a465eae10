"""Where in a plane the error is looked at: places drawn by area, and the grid of a map.

Reach is the distance of the flange from the base z axis, in the plane; the attitude and posture
are those of `pa10cal.montecarlo.posture`. This reading of the paper's "uniformly selected
end-effector positions in a given plane" gives its 0.197 ± 0.096 mm at z = 500 mm within 5 % (the ±
being the spread within a position) with the arm's nominal geometry.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pa10cal.arm.chain import Chain
from pa10cal.errors import SettingsError
from pa10cal.montecarlo.posture import Reference, find_reference, follow

Array = NDArray[np.float64]

_BATCH = 500
#: Refused when fewer than one place in so many can be reached.
_MOST_REJECTED = 50
_MOST_MAP_PLACES = 20_000


@dataclass(frozen=True)
class Places:
    """Reachable places in a plane.

    Attributes:
        p_base_m: (P, 2) x and y of the flange in the base frame.
        q_rad: (P, n) joint positions there.
        rejected: places left out because the arm cannot reach them.
    """

    p_base_m: Array
    q_rad: Array
    rejected: int


def reference_in_plane(chain: Chain, height_m: float, reach_m: tuple[float, float]) -> Reference:
    """Return the posture for a plane, found as near the middle of the reach as can be.

    Raises:
        SettingsError: when no place of the plane can be reached.
    """
    near, far = reach_m
    radii = near + (far - near) * np.array([0.5, 0.25, 0.75, 0.0, 1.0])
    reference = find_reference(chain, radii, height_m)
    if reference is None:
        raise SettingsError(
            f"{chain.arm.name} cannot reach this plane with its flange pointing down",
            where="montecarlo.planes_mm (--plane-mm)",
            value=round(1e3 * height_m),
            allowed=f"heights reachable at {near} to {far} m from the base axis",
            remedy="choose another plane, or change montecarlo.reach_m",
        )
    return reference


def draw_places(
    chain: Chain,
    reference: Reference,
    reach_m: tuple[float, float],
    count: int,
    source: np.random.Generator,
) -> Places:
    """Draw places uniformly by area between the two reaches until `count` can be reached.

    Raises:
        SettingsError: when hardly any place can be reached.
    """
    near, far = reach_m
    points, joints, reached = [], [], []
    drawn = found = 0
    while found < count:
        if drawn > _MOST_REJECTED * count + _BATCH:
            raise SettingsError(
                f"{chain.arm.name} reaches hardly any place of this plane: {found} of {drawn}",
                where="montecarlo.reach_m",
                value=reach_m,
                allowed=f"a reach of which at least 1 in {_MOST_REJECTED} places can be reached",
                remedy="narrow the reach, or choose another plane",
            )
        parts = source.random((_BATCH, 2))
        radius = np.sqrt(near**2 + (far**2 - near**2) * parts[:, 0])
        azimuth = np.pi * (2.0 * parts[:, 1] - 1.0)
        postures = follow(chain, reference, radius, azimuth)
        points.append(radius[:, None] * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1))
        joints.append(postures.q_rad)
        reached.append(postures.reached)
        drawn += _BATCH
        found += int(postures.reached.sum())
    kept = np.flatnonzero(np.concatenate(reached))[:count]
    return Places(
        p_base_m=np.concatenate(points)[kept],
        q_rad=np.concatenate(joints)[kept],
        rejected=int(kept[-1]) + 1 - count,
    )


def grid_places(
    chain: Chain, reference: Reference, reach_m: tuple[float, float], spacing_m: float
) -> Places:
    """Return the reachable places of a square grid through the base axis.

    Raises:
        SettingsError: when the grid is finer than any map needs.
    """
    near, far = reach_m
    if (2.0 * far / spacing_m) ** 2 > _MOST_MAP_PLACES:
        raise SettingsError(
            "the grid of the map is too fine",
            where="montecarlo.map_spacing_mm",
            value=1e3 * spacing_m,
            allowed=f"at least {2e3 * far / np.sqrt(_MOST_MAP_PLACES):.1f} at this reach",
            remedy="widen the spacing",
        )
    along = spacing_m * np.arange(-np.floor(far / spacing_m), np.floor(far / spacing_m) + 1.0)
    points = np.stack(np.meshgrid(along, along, indexing="ij"), axis=2).reshape(-1, 2)
    radius = np.hypot(*points.T)
    points = points[(radius >= near) & (radius <= far)]
    parts = np.array_split(points, len(points) // _BATCH + 1)
    postures = [
        follow(chain, reference, np.hypot(*part.T), np.arctan2(part[:, 1], part[:, 0]))
        for part in parts
    ]
    reached = np.concatenate([part.reached for part in postures])
    return Places(
        p_base_m=points[reached],
        q_rad=np.concatenate([part.q_rad for part in postures])[reached],
        rejected=int((~reached).sum()),
    )
