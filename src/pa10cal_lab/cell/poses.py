"""Where the cell measures: calibration poses, held-out points, straight moves; joint positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from pa10cal.arm.description import Arm
from pa10cal.arrays import Array
from pa10cal.errors import SimulationError
from pa10cal_lab.cell.options import CellPosesOptions, SimulateOptions, TrackerOptions
from pa10cal_lab.cell.robot import BALLS_DESIGN_M, Mechanism

GRID_POINTS_A_SIDE = 3
LINE_POINTS = 11
_IK_TOLERANCE = 1e-12
_IK_STEPS = 8  #: way points from the middle of the grid to a pose, to stay on one branch
_IK_ITERATIONS = 30
_IK_DAMPING = 1e-3  #: of the first rounds at a way point; the last rounds are undamped
#: Directions in which no joint moves the flange, as a part of the easiest one.
_IK_SINGULAR = 1e-12

#: Joint angles drawn at random lie within this part of the range between the limits, about its
#: middle ...
RANGE_USED = 0.8
#: ... and within this of zero.
LARGEST_ANGLE_RAD = np.radians(150.0)
#: Flange and balls stay this far above the base's origin, and this far off the base's axis.
FLOOR_M = 0.15
COLUMN_M = 0.25
_MOST_DRAWS = 1000  #: for each pose wanted
_ROUNDING = 1e-9  #: a position at a limit may be beyond it by this [deg, mm]


@dataclass(frozen=True)
class Poses:
    """Commanded joint positions [rad, or m of a prismatic joint], of the nominal arm."""

    line_x: Array  # (11, n) straight move along the base's x axis, tool orientation fixed
    line_y: Array  # (11, n) the same along y
    # (P, n) calibration poses in the order in which a path runs through them: the 27 of the grid,
    # or those of the wide layout; then those that the settings add
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
    centre: Array = np.radians(settings.centre_deg)
    return centre


def joint_bounds(arm: Arm) -> tuple[Array, Array]:
    """Return the (n,) least and largest positions drawn [rad, or m of a prismatic joint]."""
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
    """Lay out the poses of a campaign of touched balls.

    Args:
        nominal: the arm with the geometry its maker describes.
        settings: layout, middle of the grid, spacing, orientations.
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
    """Draw poses evenly in joint space, and keep those in which the tool is clear of the robot.

    Whether links, rods and measuring machine collide otherwise is not looked at.

    Args:
        nominal: the arm with the geometry its maker describes.

    Returns:
        (P, n) joint positions, in the order in which they were drawn.

    Raises:
        SimulationError: when hardly any posture is clear.
    """
    low, high = joint_bounds(arm)
    found: list[Array] = []
    for _ in range(_MOST_DRAWS * count):
        if len(found) == count:
            break
        q = rng.uniform(low, high)
        if _is_clear(nominal.T_base_ee(q[None])[0]):
            found.append(q)
    if len(found) < count:
        few = f"{len(found)} of {count} poses after {_MOST_DRAWS * count} draws"
        raise SimulationError(
            "the arm cannot hold its tool clear of floor and column",
            where="poses.layout",
            value=few,
            allowed=f"flange and balls {FLOOR_M:g} m above the base, {COLUMN_M:g} m off its axis",
            remedy="set poses.layout: grid for this arm",
        )
    return np.array(found).reshape(count, arm.n)


def neighbours_path(q: Array) -> Array:
    """Return the poses (P, n) in an order that goes on to the nearest one not yet visited.

    It starts at the first pose; near means the root of the summed squares of joint positions.
    """
    distance = cdist(q, q)
    order = [0]
    for _ in range(len(q) - 1):
        distance[:, order[-1]] = np.inf
        order.append(int(np.argmin(distance[order[-1]])))
    path: Array = q[order]
    return path


def _is_clear(T_base_ee: Array) -> bool:
    """Return whether flange and balls are clear of the floor and of the robot's column."""
    in_ee_m = np.vstack([np.zeros(3), BALLS_DESIGN_M])
    points_m = in_ee_m @ T_base_ee[:3, :3].T + T_base_ee[:3, 3]
    off_axis_m = np.hypot(points_m[:, 0], points_m[:, 1])
    return bool(points_m[:, 2].min() > FLOOR_M and off_axis_m.min() >= COLUMN_M)


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
        self._T_base_centre = nominal.T_base_ee(centre_rad[None])[0]

    def joints(self, label: str, shift_m: Array, tilt_rad: Array | None = None) -> Array:
        """Return (P, n) joint positions that shift and tilt the flange from the middle.

        Args:
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
        """Return joint positions by damped Newton steps, and the largest error of each pose."""
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
            first = (iteration < _IK_ITERATIONS // 2) & (residual > 1e-3)
            J = self._jacobian(q, T_base_ee)
            JJ = J @ J.transpose(0, 2, 1)
            JJ[first] += _IK_DAMPING**2 * np.eye(6)
            weights = np.linalg.pinv(JJ, rcond=_IK_SINGULAR, hermitian=True) @ error[..., None]
            q[moving] += (J.transpose(0, 2, 1) @ weights)[moving, :, 0]
        return q, residual

    def _jacobian(self, q: Array, T_base_ee: Array) -> Array:
        """Return how the joints move the flange, (P, 6, n), along its own axes."""
        joints = self._nominal.T_base_joints(q)
        axes = joints[..., :3, 2].transpose(1, 0, 2)
        arms = T_base_ee[:, None, :3, 3] - joints[..., :3, 3].transpose(1, 0, 2)
        slides = self._nominal.slides[:, None]
        shift = np.where(slides, axes, np.cross(axes, arms))
        turn = np.where(slides, 0.0, axes)
        R_base_ee = T_base_ee[:, :3, :3]
        return np.concatenate([shift @ R_base_ee, turn @ R_base_ee], axis=2).transpose(0, 2, 1)


# In what order the cell measures, from where each joint comes, and when.

#: One configuration of touched balls takes this long; hanging another weight between sweeps takes a
#: pause.
BLOCK_S = 45.0
LOAD_CHANGE_S = 300.0
#: A joint that moves by less than this does not turn its drive round.
LEAST_MOVE_RAD = np.radians(0.01)


@dataclass(frozen=True)
class Schedule:
    """C configurations in the order of time."""

    kind: NDArray[np.str_]  # (C,) `line_x`, `line_y`, `grid` or `holdout`
    pose: NDArray[np.str_]  # (C,) labels; the same label is the same command
    load_N: Array  # (C,) hanging weight
    repeat: NDArray[np.int64]  # (C,) from 1
    start_s: Array  # (C,) when the robot sets out for each
    q: Array  # (C, n) commanded joint positions [rad, or m of a prismatic joint]
    q_from: Array  # (C, n) where the arm comes from

    def __len__(self) -> int:
        return len(self.pose)

    @property
    def arrival(self) -> Array:
        """(C, n) direction in which each joint arrives: -1, 0 (hardly moves) or +1."""
        move = self.q - self.q_from
        arrival: Array = np.where(np.abs(move) < LEAST_MOVE_RAD, 0.0, np.sign(move))
        return arrival


def sweeps(poses: Poses, settings: SimulateOptions, rng: np.random.Generator) -> Schedule:
    """Order the configurations of a campaign of touched balls.

    Straight moves come first, unloaded, then one sweep of repeats through the grid a load, then
    the held-out points in shuffled order. A sweep runs round a closed path, so that the first
    pose is approached as in every other repeat.
    """
    parts = [
        _sweep("line_x", "LX", poses.line_x, 0.0, 1, settings.path),
        _sweep("line_y", "LY", poses.line_y, 0.0, 1, settings.path),
        *(
            _sweep("grid", "P", poses.grid, load_N, settings.repeats, settings.path)
            for load_N in settings.loads_N
        ),
    ]
    if len(poses.holdout) and settings.holdout_loads_N:
        parts.append(_shuffled(poses, settings, rng))
    kind, pose, load_N, repeat, q, q_from = map(np.concatenate, zip(*parts, strict=True))
    first = np.cumsum([len(part[0]) for part in parts])[:-1]
    pauses = np.zeros(len(q))
    pauses[first] = LOAD_CHANGE_S * (load_N[first] != load_N[first - 1])
    start_s = BLOCK_S * np.arange(len(q)) + pauses.cumsum()
    return Schedule(kind, pose, load_N, repeat, start_s, q, q_from)


def one_after_another(commands: Array, plan: TrackerOptions, rng: np.random.Generator) -> Schedule:
    """Order the configurations of a tracker's campaign, each approached straight from the last.

    Calibration poses come first, then their repeats, then the held-out ones. The first
    configuration is approached from where the arm stands already.

    Args:
        commands: (P, n) commanded joint positions [rad, or m of a prismatic joint].
        plan: share held out, repeats and their order, loads, time a configuration takes.
    """
    count = len(commands)
    holdout = 0 if plan.holdout_every else round(plan.holdout_share * count)
    grid = count - holdout
    if plan.by_first_joint:
        first = np.argsort(commands[:grid, 0], kind="stable")
        commands = np.concatenate([commands[first], commands[grid:]])
    every = plan.repeat_every
    runs = [
        np.arange(grid),
        *(_run(grid, number, plan, rng) for number in range(1, plan.repeats)),
        np.arange(every - 1, grid, every) if every else np.arange(0),
    ]
    pose = np.concatenate([*runs, np.arange(grid, grid + holdout)])
    repeat = np.repeat(np.arange(1, len(runs) + 1), [len(run) for run in runs])
    labels = np.array(
        [f"P{number:03d}" for number in range(1, grid + 1)]
        + [f"H{number:03d}" for number in range(1, holdout + 1)]
    )
    q = commands[pose]
    return Schedule(
        kind=np.where(pose < grid, "grid", "holdout"),
        pose=labels[pose],
        load_N=np.resize(plan.loads_N, count)[pose],
        repeat=np.concatenate([repeat, np.ones(holdout, dtype=np.int64)]),
        start_s=plan.seconds_a_pose * np.arange(len(pose), dtype=float),
        q=q,
        q_from=np.concatenate([q[:1], q[:-1]]),
    )


def _run(
    count: int, number: int, plan: TrackerOptions, rng: np.random.Generator
) -> NDArray[np.int64]:
    """Return the order of `count` poses in a repeat, numbered from 0."""
    if plan.order == "shuffled":
        return rng.permutation(count)
    backwards = {
        "same": False,
        "there_and_back": number % 2 == 1,
        "there_there_back_back": number >= (plan.repeats + 1) // 2,
    }[plan.order]
    return np.arange(count)[::-1] if backwards else np.arange(count)


#: Kind, label, load, repeat, position and where from, each of some configurations.
_Columns = tuple[NDArray[Any], NDArray[Any], Array, NDArray[Any], Array, Array]


def _sweep(kind: str, letter: str, q: Array, load_N: float, repeats: int, path: str) -> _Columns:
    """Run `repeats` times round the closed path through the poses."""
    count = len(q)
    runs = [np.arange(count)] * repeats
    if path == "alternating":
        runs = [run[::-1] if repeat % 2 else run for repeat, run in enumerate(runs)]
    order = np.concatenate(runs)
    q_from = q[np.concatenate([np.roll(run, 1) for run in runs])]
    numbers = np.repeat(np.arange(1, repeats + 1), count)
    kinds, loads_N = np.full(len(order), kind), np.full(len(order), load_N)
    return kinds, _labels(letter, q)[order], loads_N, numbers, q[order], q_from


def _shuffled(poses: Poses, settings: SimulateOptions, rng: np.random.Generator) -> _Columns:
    """Shuffle points, loads and repeats of the held-out points.

    Where shuffling gives one point twice in a row, the arm goes to the first grid pose in
    between.
    """
    loads_N, repeats = np.array(settings.holdout_loads_N), settings.holdout_repeats
    shape = len(poses.holdout), len(loads_N), repeats
    shuffled = rng.permutation(int(np.prod(shape)))
    order, load, repeat = np.unravel_index(shuffled, shape)
    came_from = np.roll(order, 1)
    again = (order == came_from)[:, None]
    q = poses.holdout
    q_from = np.where(again, poses.grid[0], q[came_from])
    kinds, labels = np.full(len(order), "holdout"), _labels("H", q)
    return kinds, labels[order], loads_N[load], 1 + repeat, q[order], q_from


def _labels(letter: str, q: Array) -> NDArray[np.str_]:
    return np.array([f"{letter}{number:02d}" for number in range(1, len(q) + 1)])
