"""Places of the flange in a plane, and joint positions for them in one posture.

Reach is the distance of the flange from the base z axis. The flange points straight down everywhere
(straight up where an arm's own axis of the flange does not turn down, as a palletiser's) and turns
about the base axis with its azimuth. The posture (elbow up or down, wrist turned or not)
is chosen once, nearest to the middle of all joint ranges. Every place is then approached from there
along azimuth and radius, so that the posture does not change. A place that is not reached in this
way within the joint limits counts as out of reach.

By this interpretation of the paper's "uniformly selected end-effector positions in a given plane"
the nominal arm reproduces its 0.197 ± 0.096 mm at z = 500 mm within 5 %, where ± is the standard
deviation within a place.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pa10cal.arm.chain import Chain
from pa10cal.arm.description import Arm
from pa10cal.arrays import Array
from pa10cal.errors import SettingsError

#: Number of places computed at once.
_BATCH = 500
#: A plane is refused if more places than these are drawn for each that is reached.
_MOST_DRAWN = 50
#: Largest number of places of a map.
_MOST_MAP_PLACES = 20_000

# Search of the posture.

#: Directions of the flange's axis, down and, where that is not possible, up.
_VERTICAL = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])

#: Number of starts.
_STARTS = 48
#: Number of steps from each start.
_SEARCH_STEPS = 120
#: Weight of the distance from the middle of a joint's range, over half of that range, against
#: metres and radians.
_CENTRING = 1e-3

# Way from the posture to a place.

#: Number of way points.
_PATH_STEPS = 24
#: Steps at each way point.
_STEPS_ON_THE_WAY = 2
#: Steps at the last one.
_STEPS_AT_THE_END = 12
#: Damping of the normal equations.
_DAMPING = 1e-9
#: Longest step of a joint.
_LONGEST_STEP_RAD = 0.3
#: Largest component of the motion that is missing to a place that is reached [m, rad].
_REACHED_WITHIN = 1e-10


class OutOfReachError(SettingsError):
    """The arm cannot take the places of a plane."""


@dataclass(frozen=True)
class PlacesInPlane:
    """Reachable places of the flange in a plane."""

    place_base_m: Array  # (P, 2) x and y of the flange in the base frame
    q_rad: Array  # (P, n) joint positions
    rejected: int  # number of places that the arm cannot reach


@dataclass(frozen=True)
class ReferencePosture:
    """The chosen posture, at one place of the plane."""

    q_rad: Array  # (n,) joint positions
    radius_m: float  # distance of the flange from the base axis; its azimuth is zero
    height_m: float  # height of the flange above the base
    R_base_ee: Array  # (3, 3) orientation of the flange


def draw_places(
    chain: Chain,
    reference: ReferencePosture,
    reach_m: tuple[float, float],
    count: int,
    rng: np.random.Generator,
) -> PlacesInPlane:
    """Draw places uniformly by area between two reaches until `count` can be reached.

    Raises:
        OutOfReachError: when hardly any place can be reached.
    """
    near, far = reach_m
    batches = []
    drawn = reached_count = 0
    while reached_count < count:
        if drawn > _MOST_DRAWN * count + _BATCH:
            what = f"{chain.arm.name} reaches hardly any position of this plane"
            raise OutOfReachError(
                f"{what}: {reached_count} of {drawn}",
                where="montecarlo.reach_m",
                value=reach_m,
                allowed=f"a reach of which at least 1 in {_MOST_DRAWN} positions can be reached",
                remedy="narrow the reach, or choose another plane",
            )
        uniform = rng.random((_BATCH, 2))
        radius = np.sqrt(near**2 + (far**2 - near**2) * uniform[:, 0])
        azimuth = np.pi * (2.0 * uniform[:, 1] - 1.0)
        points = radius[:, None] * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
        batches.append((points, *follow(chain, reference, radius, azimuth)))
        drawn += _BATCH
        reached_count += int(batches[-1][2].sum())
    place_base_m, q_rad, reached = map(np.concatenate, zip(*batches, strict=True))
    kept = np.flatnonzero(reached)[:count]
    # What was drawn after the last that is kept depends on the size of a batch: it is not counted.
    rejected = int(kept[-1]) + 1 - count
    return PlacesInPlane(place_base_m[kept], q_rad[kept], rejected)


def grid_places(
    chain: Chain, reference: ReferencePosture, reach_m: tuple[float, float], spacing_m: float
) -> PlacesInPlane:
    """Return the reachable places of a square grid through the base axis.

    Raises:
        SettingsError: when the grid is finer than any map needs.
    """
    near, far = reach_m
    if (2.0 * far / spacing_m) ** 2 > _MOST_MAP_PLACES:
        least_mm = np.ceil(10.0 * 2e3 * far / np.sqrt(_MOST_MAP_PLACES)) / 10.0
        raise SettingsError(
            "the grid of the map is too fine",
            where="montecarlo.map_spacing_mm",
            value=1e3 * spacing_m,
            allowed=f"at least {least_mm:.1f} at this reach",
            remedy="widen the spacing",
        )
    along = spacing_m * np.arange(-np.floor(far / spacing_m), np.floor(far / spacing_m) + 1.0)
    points = np.stack(np.meshgrid(along, along, indexing="ij"), axis=2).reshape(-1, 2)
    radius = np.hypot(*points.T)
    points = points[(radius >= near) & (radius <= far)]
    batches = np.array_split(points, len(points) // _BATCH + 1)
    followed = [
        follow(chain, reference, np.hypot(*batch.T), np.arctan2(batch[:, 1], batch[:, 0]))
        for batch in batches
    ]
    q_rad, reached = map(np.concatenate, zip(*followed, strict=True))
    return PlacesInPlane(points[reached], q_rad[reached], rejected=int((~reached).sum()))


def reference_in_plane(
    chain: Chain, height_m: float, reach_m: tuple[float, float]
) -> ReferencePosture:
    """Search the posture for a plane, at azimuth zero and as near to the middle reach as possible.

    Searches start all over the joint ranges. Their residual is the distance from the place and,
    with little weight, from the middle of the ranges; the least is chosen. A flange that can point
    down nowhere in the plane points up.

    Raises:
        OutOfReachError: when no place of the plane can be reached.
    """
    low, high = _search_ranges(chain.arm).T
    starts = np.random.default_rng(0).uniform(low, high, (_STARTS, chain.arm.n))
    starts[0] = (low + high) / 2.0
    near, far = reach_m
    radii_m = near + (far - near) * np.array([0.5, 0.25, 0.75, 0.0, 1.0])
    for z, radius_m in itertools.product(_VERTICAL, radii_m):
        place_m = np.array([radius_m, 0.0, height_m])
        q_rad = starts
        for _ in range(_SEARCH_STEPS):
            residual, jacobian = _search_residual(chain, q_rad, place_m, z)
            q_rad = _step(q_rad, residual, jacobian, low, high)
        residual, _ = _search_residual(chain, q_rad, place_m, z)
        best = int(np.argmin(np.linalg.norm(residual, axis=1)))
        # The search weighs the vertical against the middle of the ranges, so the flange's axis is
        # off by a little. It is turned exactly upright, its heading unchanged: all places have its
        # orientation.
        x = chain.forward(q_rad[best : best + 1])[0, :3, 0] * [1.0, 1.0, 0.0]
        x /= np.linalg.norm(x)
        upright = np.stack([x, np.cross(z, x), z], axis=1)
        rough = ReferencePosture(q_rad[best], float(radius_m), height_m, upright)
        (exact_rad,), reached = follow(chain, rough, np.array([radius_m]), np.array([0.0]))
        if reached[0]:
            return replace(rough, q_rad=exact_rad)
    raise OutOfReachError(
        f"{chain.arm.name} cannot reach this plane with its flange pointing down",
        where="montecarlo.planes_mm (--plane-mm)",
        value=round(1e3 * height_m),
        allowed=f"heights reachable at {near} to {far} m from the base axis",
        remedy="choose another plane, or change montecarlo.reach_m",
    )


def follow(
    chain: Chain, reference: ReferencePosture, radius_m: Array, azimuth_rad: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Move from the reference to P places at its height, given by radius and azimuth.

    Returns:
        Joint positions (P, n), and which of them are reached within the limits, (P,); the others
        have no meaning.
    """
    low, high = chain.arm.joint_ranges_rad.T
    q_rad = np.tile(reference.q_rad, (len(radius_m), 1))
    height = np.full_like(radius_m, reference.height_m)
    for share in np.linspace(0.0, 1.0, _PATH_STEPS + 1)[1:]:
        radius = reference.radius_m + share * (radius_m - reference.radius_m)
        turned = Rotation.from_rotvec(share * azimuth_rad[:, None] * [0.0, 0.0, 1.0]).as_matrix()
        target_m = np.column_stack([radius[:, None] * turned[:, :2, 0], height])
        R_target = turned @ reference.R_base_ee
        for _ in range(_STEPS_AT_THE_END if share == 1.0 else _STEPS_ON_THE_WAY):
            residual, jacobian = _motion_missing(chain, q_rad, target_m, R_target)
            q_rad = _step(q_rad, residual, jacobian, low, high)
    residual, _ = _motion_missing(chain, q_rad, target_m, R_target)
    # A turn by 180 degrees has no rotation missing by its measure: the axes are then opposite.
    alike = (chain.forward(q_rad)[:, :3, :3] * R_target).sum(axis=(1, 2)) > 0.0
    return q_rad, (np.abs(residual).max(axis=1) < _REACHED_WITHIN) & alike


def flange_with_screws(chain: Chain, q_rad: Array) -> tuple[Array, Array]:
    """Return poses of the flange and its motion by each joint at joint positions (P, n).

    Returns:
        T_base_ee (P, 4, 4) [m]; velocity [m/rad] over axis of each joint, in the base, (P, 6, n).
    """
    end = chain.forward_with_screws(q_rad)
    return end.T, end.screws[:, :, chain.joint_columns]


def _motion_missing(
    chain: Chain, q_rad: Array, target_m: Array, R_target: Array
) -> tuple[Array, Array]:
    """Return the motion (P, 6) missing to a target, and the flange's derivative (P, 6, n).

    The rotation is half the sum of the cross products of both frames' axes: the rotation vector if
    it is small.
    """
    T_base_ee, screws = flange_with_screws(chain, q_rad)
    rotation = 0.5 * np.cross(T_base_ee[:, :3, :3], R_target, axis=1).sum(axis=2)
    return np.concatenate([target_m - T_base_ee[:, :3, 3], rotation], axis=1), screws


def _search_ranges(arm: Arm) -> Array:
    """Return the joint ranges (n, 2) [rad]; where a limit is infinite they are one turn wide."""
    low, high = arm.joint_ranges_rad.T
    turn_below = np.where(np.isfinite(high), high - 2.0 * np.pi, -np.pi)
    low = np.where(np.isfinite(low), low, turn_below)
    return np.column_stack([low, np.where(np.isfinite(high), high, low + 2.0 * np.pi)])


def _search_residual(
    chain: Chain, q_rad: Array, place_m: Array, vertical: Array
) -> tuple[Array, Array]:
    """Return residuals (P, 6 + n) of the search, and the derivative (P, 6 + n, n).

    Residuals are those of position, of the flange's axis, which shall be `vertical` (3,), and, with
    little weight, of the middle of the joint ranges, which determines the flange's roll.
    """
    low, high = _search_ranges(chain.arm).T
    half_range = (high - low) / 2.0
    T_base_ee, screws = flange_with_screws(chain, q_rad)
    position_m, axis = T_base_ee[:, :3, 3], T_base_ee[:, :3, 2]
    tilting = np.cross(screws[:, 3:], axis[:, :, None], axis=1)
    centred = _CENTRING * ((low + high) / 2.0 - q_rad) / half_range
    residual = np.concatenate([place_m - position_m, vertical - axis, centred], axis=1)
    centring = np.tile(np.diag(_CENTRING / half_range), (len(q_rad), 1, 1))
    return residual, np.concatenate([screws[:, :3], tilting, centring], axis=1)


def _step(q_rad: Array, residual: Array, jacobian: Array, low: Array, high: Array) -> Array:
    """Return joint positions after a damped Gauss-Newton step, bounded and within the limits."""
    transposed = jacobian.transpose(0, 2, 1)
    normal = transposed @ jacobian + _DAMPING * np.eye(q_rad.shape[1])
    step = np.linalg.solve(normal, transposed @ residual[:, :, None])[:, :, 0]
    moved: Array = q_rad + np.clip(step, -_LONGEST_STEP_RAD, _LONGEST_STEP_RAD)
    return moved.clip(low, high)
