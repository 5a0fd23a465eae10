"""Commanded poses of a simulated campaign: calibration poses, held-out points, straight moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from pa10cal.arm.description import Arm
from pa10cal.arrays import Array
from pa10cal.errors import SimulationError
from pa10cal_lab.cell.mechanism import Mechanism
from pa10cal_lab.cell.options import CellPosesOptions
from pa10cal_lab.cell.robot import BALLS_DESIGN_M

GRID_POINTS_A_SIDE = 3
LINE_POINTS = 11
_IK_TOLERANCE = 1e-12
_IK_STEPS = 8  #: way points from the middle of the grid to a pose, to stay on one branch
_IK_ITERATIONS = 30
_IK_DAMPING = 1e-3  #: in the first half of the iterations at a way point; the others are undamped
#: Squared singular value, relative to the largest, below which no joint moves the flange.
_IK_SINGULAR = 1e-12

#: Joint angles are drawn from this share of the range between the limits, about its middle, and not
#: further than this from zero.
RANGE_USED = 0.8
LARGEST_ANGLE_RAD = np.radians(150.0)
#: Least height of flange and balls over the base's origin, and distance from the base's axis.
FLOOR_M = 0.15
COLUMN_M = 0.25
_MOST_DRAWS = 1000  #: largest number of draws for each wanted pose
_ROUNDING = 1e-9  #: a position at a limit may exceed it by this [deg, mm]


@dataclass(frozen=True)
class Poses:
    """Commanded joint positions [rad, or m of a prismatic joint], of the nominal arm."""

    line_x: Array  # (11, n) straight move along the base's x axis, tool orientation fixed
    line_y: Array  # (11, n) the same along y
    # (P, n) calibration poses in the order of a path: the 27 of the grid or those of the wide
    # layout, then those that the settings add
    grid: Array
    holdout: Array  # (H, n) poses outside the grid's volume, or more of the wide ones


def centre_rad(arm: Arm, settings: CellPosesOptions) -> Array:
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
    return np.asarray(np.radians(settings.centre_deg))


def joint_bounds(arm: Arm) -> tuple[Array, Array]:
    """Return the bounds (n,) of drawn joint positions [rad, or m of a prismatic joint]."""
    low, high = arm.limits_rad.T
    unused = 0.5 * (1.0 - RANGE_USED) * (high - low)
    largest = np.where(arm.prismatic, np.inf, LARGEST_ANGLE_RAD)
    return np.maximum(low + unused, -largest), np.minimum(high - unused, largest)


def commanded_positions(arm: Arm, wanted: Sequence[Sequence[float]], where: str) -> Array:
    """Return the (P, n) joint positions that settings list [rad, or m of a prismatic joint].

    Args:
        wanted: P poses, a position a joint each [deg; mm of a prismatic joint].
        where: the option that lists them, for messages.

    Raises:
        SimulationError: when a pose has not one position a joint, or is beyond a limit.
    """
    low, high = np.where(arm.prismatic, 1e3 * arm.limits_rad.T, np.degrees(arm.limits_rad.T))
    for number, positions in enumerate(wanted):
        if len(positions) != arm.n:
            raise SimulationError(
                f"{len(positions)} joint positions for {arm.n} joints",
                where=f"{where}[{number}]",
                value=positions,
                allowed=f"{arm.n} positions",
                remedy="give one position a joint",
            )
        beyond = np.maximum(low - positions, np.array(positions) - high)
        if np.any(beyond > _ROUNDING):
            joint = int(np.argmax(beyond))
            unit = "mm" if arm.prismatic[joint] else "deg"
            raise SimulationError(
                f"joint {joint + 1} beyond its limits",
                where=f"{where}[{number}]",
                value=positions[joint],
                allowed=f"{low[joint]:.0f} to {high[joint]:.0f} {unit}",
                remedy="remove the pose",
            )
    q = np.array(wanted, dtype=float).reshape(-1, arm.n)
    return np.asarray(np.where(arm.prismatic, 1e-3 * q, np.radians(q)))


def place_poses(
    arm: Arm, nominal: Mechanism, settings: CellPosesOptions, holdout_points: int
) -> Poses:
    """Return the poses of a campaign of touched balls.

    Args:
        nominal: the arm with nominal geometry.
        settings: layout, middle of the grid, spacing, orientations.
        holdout_points: H, number of held-out points.

    Raises:
        SimulationError: when a pose is out of reach or beyond a joint limit, or one that the
            settings add has not one angle a joint.
    """
    rng = np.random.default_rng(settings.tilt_seed)
    reach = _Reach(arm, nominal, centre_rad(arm, settings))
    along = np.linspace(-0.5, 0.5, LINE_POINTS)[:, None] * settings.line_length_m
    line_x = reach.joints("LX", along * np.array([1.0, 0.0, 0.0]))
    line_y = reach.joints("LY", along * np.array([0.0, 1.0, 0.0]))
    extra = commanded_positions(arm, settings.extra_deg, "poses.extra_deg")
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


def draw_wide(arm: Arm, nominal: Mechanism, count: int, rng: np.random.Generator) -> Array:
    """Draw poses evenly in joint space with the tool clear of floor and column.

    Other collisions are not checked.

    Args:
        nominal: the arm with nominal geometry.

    Returns:
        (P, n) joint positions, in the order in which they were drawn.

    Raises:
        SimulationError: when hardly any posture is clear.
    """
    low, high = joint_bounds(arm)
    clear: list[Array] = []
    for _ in range(_MOST_DRAWS * count):
        if len(clear) == count:
            break
        q = rng.uniform(low, high)
        if _is_clear(nominal.T_base_ee(q[None])[0]):
            clear.append(q)
    if len(clear) < count:
        raise SimulationError(
            "the arm cannot hold its tool clear of floor and column",
            where="poses.layout",
            value=f"{len(clear)} of {count} poses after {_MOST_DRAWS * count} draws",
            allowed=f"flange and balls {FLOOR_M:g} m above the base, {COLUMN_M:g} m off its axis",
            remedy="set poses.layout: grid for this arm",
        )
    return np.array(clear).reshape(count, arm.n)


def neighbours_path(q: Array) -> Array:
    """Return the poses (P, n) as a path from the first that always goes to the nearest next.

    Distances are Euclidean in joint positions.
    """
    distance = cdist(q, q)
    order = [0]
    for _ in range(len(q) - 1):
        distance[:, order[-1]] = np.inf
        order.append(int(np.argmin(distance[order[-1]])))
    return np.asarray(q[order])


def _is_clear(T_base_ee: Array) -> bool:
    """Return whether flange and balls are clear of the floor and of the robot's column."""
    in_ee_m = np.vstack([np.zeros(3), BALLS_DESIGN_M])
    points_m = in_ee_m @ T_base_ee[:3, :3].T + T_base_ee[:3, 3]
    off_axis_m = np.hypot(points_m[:, 0], points_m[:, 1])
    return bool(points_m[:, 2].min() > FLOOR_M and off_axis_m.min() >= COLUMN_M)


def _grid_path() -> Array:
    """Return the points (27, 3) of a grid of -1, 0 and 1 along a path of single steps."""
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
    return np.asarray(rng.uniform(-1.0, 1.0, (count, 3)) * np.array(tilt_rad))


class _Reach:
    """Inverse kinematics of the nominal arm around the middle of the grid."""

    def __init__(self, arm: Arm, nominal: Mechanism, centre_rad: Array) -> None:
        self._arm = arm
        self._nominal = nominal
        self._centre_rad = centre_rad
        self._T_base_centre = nominal.T_base_ee(centre_rad[None])[0]

    def joints(self, label: str, shift_m: Array, tilt_rad: Array | None = None) -> Array:
        """Return (P, n) joint positions that shift and tilt the flange from the middle.

        Args:
            label: of the poses, for messages.
            shift_m: (P, 3) displacements along base axes.
            tilt_rad: (P, 3) rotation vectors along the tool's own axes; None for no tilt.
        """
        tilt = np.zeros_like(shift_m) if tilt_rad is None else tilt_rad
        q = np.tile(self._centre_rad, (len(shift_m), 1))
        residual = np.zeros(len(q))
        for share in np.linspace(0.0, 1.0, _IK_STEPS + 1)[1:]:
            T_wanted = np.tile(self._T_base_centre, (len(q), 1, 1))
            T_wanted[:, :3, 3] += share * shift_m
            turn = Rotation.from_rotvec(share * tilt).as_matrix()
            T_wanted[:, :3, :3] = T_wanted[:, :3, :3] @ turn
            q, residual = self._solve(q, T_wanted)
        low, high = self._arm.limits_rad.T
        for i, position in enumerate(q):
            beyond = np.maximum(low - position, position - high)
            joint, allowed = int(np.argmax(beyond)), "a point that the arm can reach"
            value = f"{residual[i]:.1e} m or rad short"
            if residual[i] <= _IK_TOLERANCE:
                value = f"joint {joint + 1} at {np.degrees(position[joint]):.1f} deg"
                allowed = f"{np.degrees(low[joint]):.0f} to {np.degrees(high[joint]):.0f} deg"
            if residual[i] > _IK_TOLERANCE or beyond.max() > 0.0:
                raise SimulationError(
                    f"pose {label}{i + 1:02d} cannot be taken",
                    where="poses",
                    value=value,
                    allowed=allowed,
                    remedy="move poses.centre_deg, or shrink poses.spacing_m or poses.tilt_rad",
                )
        return q

    def _solve(self, q: Array, T_wanted: Array) -> tuple[Array, Array]:
        """Return joint positions by damped Newton steps from q, and each pose's largest error."""
        q, residual = q.copy(), np.full(len(q), np.inf)
        for iteration in range(_IK_ITERATIONS):
            T_base_ee = self._nominal.T_base_ee(q)
            R_ee_base = T_base_ee[:, :3, :3].transpose(0, 2, 1)
            shift = np.einsum("pij,pj->pi", R_ee_base, (T_wanted - T_base_ee)[:, :3, 3])
            turn = Rotation.from_matrix(
                R_ee_base @ T_wanted[:, :3, :3], assume_valid=True
            ).as_rotvec()
            error = np.hstack([shift, turn])
            residual = np.abs(error).max(axis=1, initial=0.0)
            moving = residual > _IK_TOLERANCE
            if not moving.any():
                break
            damped = (iteration < _IK_ITERATIONS // 2) & (residual > 1e-3)
            J = self._jacobian(q, T_base_ee)
            JJ = J @ J.transpose(0, 2, 1)
            JJ[damped] += _IK_DAMPING**2 * np.eye(6)
            weights = np.linalg.pinv(JJ, rcond=_IK_SINGULAR, hermitian=True) @ error[..., None]
            q[moving] += (J.transpose(0, 2, 1) @ weights)[moving, :, 0]
        return q, residual

    def _jacobian(self, q: Array, T_base_ee: Array) -> Array:
        """Return the derivative of the flange by the joints, (P, 6, n), along its own axes."""
        joints = self._nominal.T_base_joints(q)
        axes = joints[..., :3, 2].transpose(1, 0, 2)
        arms = T_base_ee[:, None, :3, 3] - joints[..., :3, 3].transpose(1, 0, 2)
        slides = self._nominal.slides[:, None]
        shift = np.where(slides, axes, np.cross(axes, arms))
        turn = np.where(slides, 0.0, axes)
        R_base_ee = T_base_ee[:, :3, :3]
        return np.concatenate([shift @ R_base_ee, turn @ R_base_ee], axis=2).transpose(0, 2, 1)
