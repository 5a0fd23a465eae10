"""Where the cell measures: calibration poses, held-out points, straight moves; joint angles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pa10cal.arm.description import Arm
from pa10cal.cell.mechanism import Mechanism
from pa10cal.cell.wide import draw_wide, neighbours_path
from pa10cal.errors import SimulationError
from pa10cal.settings import CellPosesSettings

Array = NDArray[np.float64]

GRID_POINTS_A_SIDE = 3
LINE_POINTS = 11
_IK_TOLERANCE = 1e-12
_IK_STEPS = 8  #: way points from the middle of the grid to a pose, to stay on one branch
_IK_ITERATIONS = 30
_IK_DAMPING = 1e-3  #: of the first rounds at a way point; the last rounds are undamped


@dataclass(frozen=True)
class Poses:
    """Commanded joint angles [rad], of the nominal arm.

    Attributes:
        line_x: (11, n) straight move along the base's x axis, tool attitude fixed.
        line_y: (11, n) the same along y.
        grid: (P, n) calibration poses in the order in which a path runs through them: the 27 of
            the grid, or those of the wide layout; then those that the settings add.
        holdout: (H, n) poses outside the grid's volume, or more of the wide ones.
    """

    line_x: Array
    line_y: Array
    grid: Array
    holdout: Array


def centre_rad(arm: Arm, settings: CellPosesSettings) -> Array:
    """Return the (n,) joint angles in the middle of the grid.

    Raises:
        SimulationError: when they are not as many as the joints.
    """
    if len(settings.centre_deg) != arm.n:
        raise SimulationError(
            f"{len(settings.centre_deg)} joint angles for {arm.n} joints",
            where="poses.centre_deg",
            value=settings.centre_deg,
            allowed=f"{arm.n} angles",
            remedy="give one angle a joint",
        )
    centre: Array = np.radians(settings.centre_deg)
    return centre


def place_poses(
    arm: Arm, nominal: Mechanism, settings: CellPosesSettings, holdout_points: int
) -> Poses:
    """Lay out the poses of a campaign.

    Args:
        arm: gives the joint limits.
        nominal: the arm with the geometry its maker describes.
        settings: layout, middle of the grid, spacing, attitudes.
        holdout_points: H, how many held-out points.

    Raises:
        SimulationError: when a pose is out of reach or beyond a joint limit, or one that the
            settings add has not one angle a joint.
    """
    rng = np.random.default_rng(settings.tilt_seed)
    reach = _Reach(arm, nominal, centre_rad(arm, settings))
    along = np.linspace(-0.5, 0.5, LINE_POINTS)[:, None] * settings.line_length_m
    line_x = reach.joints("LX", along * np.array([1.0, 0.0, 0.0]))
    line_y = reach.joints("LY", along * np.array([0.0, 1.0, 0.0]))
    extra = _extra_rad(arm, settings)
    if settings.layout == "wide":
        wide = neighbours_path(draw_wide(arm, nominal, settings.wide_poses, rng))
        holdout = draw_wide(arm, nominal, holdout_points, rng)
        return Poses(line_x, line_y, np.concatenate([wide, extra]), holdout)
    spacing_m = np.array(settings.spacing_m)
    grid_m = _grid_path() * spacing_m
    outside_m = _points_outside(spacing_m, settings.outside_m, holdout_points, rng)
    grid = reach.joints("P", grid_m, _tilts(len(grid_m), settings.tilt_rad, rng))
    return Poses(
        line_x=line_x,
        line_y=line_y,
        grid=np.concatenate([grid, extra]),
        holdout=reach.joints("H", outside_m, _tilts(holdout_points, settings.tilt_rad, rng)),
    )


def _extra_rad(arm: Arm, settings: CellPosesSettings) -> Array:
    """Return the (E, n) joint angles that the settings add."""
    for number, angles_deg in enumerate(settings.extra_deg):
        where = f"poses.extra_deg[{number}]"
        if len(angles_deg) != arm.n:
            raise SimulationError(
                f"{len(angles_deg)} joint angles for {arm.n} joints",
                where=where,
                value=angles_deg,
                allowed=f"{arm.n} angles",
                remedy="give one angle a joint",
            )
        low, high = np.degrees(arm.limits_rad).T
        beyond = np.maximum(low - angles_deg, np.array(angles_deg) - high)
        if np.any(beyond > 0):
            joint = int(np.argmax(beyond))
            raise SimulationError(
                f"joint {joint + 1} beyond its limits",
                where=where,
                value=angles_deg[joint],
                allowed=f"{low[joint]:.0f} to {high[joint]:.0f} deg",
                remedy="leave the pose out",
            )
    extra: Array = np.radians(np.array(settings.extra_deg, dtype=float).reshape(-1, arm.n))
    return extra


def _grid_path() -> Array:
    """Return (27, 3) steps of -1, 0, 1 from the middle, to and fro so that neighbours touch."""
    side = range(-1, GRID_POINTS_A_SIDE - 1)
    points = []
    for level, z in enumerate(side):
        for row, y in enumerate(side if level % 2 == 0 else reversed(side)):
            forth = (row + level) % 2 == 0
            points += [(x, y, z) for x in (side if forth else reversed(side))]
    return np.array(points, dtype=float)


def _points_outside(half_m: Array, outside_m: float, count: int, rng: np.random.Generator) -> Array:
    """Draw (count, 3) points evenly from the shell of thickness `outside_m` around the box."""
    points: list[Array] = []
    while len(points) < count:
        point = rng.uniform(-half_m - outside_m, half_m + outside_m)
        if 0.0 < np.linalg.norm(np.maximum(np.abs(point) - half_m, 0.0)) <= outside_m:
            points.append(point)
    return np.array(points).reshape(count, 3)


def _tilts(count: int, tilt_rad: tuple[float, float, float], rng: np.random.Generator) -> Array:
    """Draw (count, 3) rotation vectors about the tool's own axes."""
    tilts: Array = rng.uniform(-1.0, 1.0, (count, 3)) * np.array(tilt_rad)
    return tilts


class _Reach:
    """Inverse kinematics of the nominal arm around the middle of the grid."""

    def __init__(self, arm: Arm, nominal: Mechanism, centre_rad: Array) -> None:
        self._arm = arm
        self._nominal = nominal
        self._centre_rad = centre_rad
        self._T_base_centre = nominal.T_base_ee(centre_rad)

    def joints(self, label: str, shift_m: Array, tilt_rad: Array | None = None) -> Array:
        """Return (P, n) joint angles that shift and tilt the flange from the middle.

        Args:
            label: letter of the poses, for messages.
            shift_m: (P, 3) displacements along base axes.
            tilt_rad: (P, 3) rotation vectors along the tool's own axes; None for no tilt.
        """
        tilts = np.zeros_like(shift_m) if tilt_rad is None else tilt_rad
        q = np.empty((len(shift_m), self._arm.n))
        for i, (shift, tilt) in enumerate(zip(shift_m, tilts, strict=True)):
            q[i] = self._reach(f"{label}{i + 1:02d}", shift, tilt)
        return q

    def _reach(self, label: str, shift_m: Array, tilt_rad: Array) -> Array:
        q = self._centre_rad.copy()
        for share in np.linspace(0.0, 1.0, _IK_STEPS + 1)[1:]:
            T_wanted = self._T_base_centre.copy()
            T_wanted[:3, 3] += share * shift_m
            T_wanted[:3, :3] = T_wanted[:3, :3] @ pin.exp3(share * tilt_rad)
            q, left = self._solve(q, T_wanted)
        low, high = self._arm.limits_rad.T
        if left > _IK_TOLERANCE:
            self._refuse(label, f"{left:.1e} m or rad short", "a point that the arm can reach")
        if np.any((q < low) | (q > high)):
            joint = int(np.argmax(np.maximum(low - q, q - high)))
            self._refuse(
                label,
                f"joint {joint + 1} at {np.degrees(q[joint]):.1f} deg",
                f"{np.degrees(low[joint]):.0f} to {np.degrees(high[joint]):.0f} deg",
            )
        return q

    def _solve(self, q: Array, T_wanted: Array) -> tuple[Array, float]:
        """Return joint angles by damped Newton steps, and the error left."""
        for iteration in range(_IK_ITERATIONS):
            error, J = self._nominal.log_error(q, T_wanted)
            left = float(np.abs(error).max())
            if left <= _IK_TOLERANCE:
                break
            damping = _IK_DAMPING if iteration < _IK_ITERATIONS // 2 and left > 1e-3 else 0.0
            q = q + J.T @ np.linalg.solve(J @ J.T + damping**2 * np.eye(6), error)
        return q, left

    def _refuse(self, label: str, value: str, allowed: str) -> None:
        raise SimulationError(
            f"pose {label} cannot be taken",
            where="poses",
            value=value,
            allowed=allowed,
            remedy="move poses.centre_deg, or shrink poses.spacing_m or poses.tilt_rad",
        )
